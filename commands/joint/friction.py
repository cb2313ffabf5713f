"""`flexspline joint friction`: a friction map and its feed-forward."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

from ...models.output import check_output, made_from, output_folder
from .._measurement import load_measurement
from .._options import AsJson, ResultFolder, argument, option, with_plugins

EXAMPLES = (
    "flexspline joint friction csg-25-100-tbm2g --out friction",
    "flexspline joint friction diagnosis/joint.yaml --measurement measurement --out friction",
)


@with_plugins
def command(
    joint: Annotated[str, argument("Name of a shipped joint, or a joint description.", metavar="JOINT")],
    out: ResultFolder,
    measurement: Annotated[Path | None, option("measurement to test the feed-forward with")] = None,
    as_json: AsJson = False,
) -> Any:
    """Write friction over speed, load and temperature, with driving and back-driving efficiency, as CSV and C function.

    `friction.csv` is the map with standard deviations; `friction.c` is the same in closed form, to add to a controller's torque.
    With `--measurement`, the RMS current error on held-out motion is reported, with and without the feed-forward.
    """
    import pandas as pd

    from ...models.characteristics import COLUMNS, c_function, friction_map
    from ...models.joint import load_joint

    described = load_joint(joint)
    maker, names = made_from("friction", joint), ["friction.csv", "friction.c"]
    data = load_measurement(measurement, joint)[0] if measurement is not None else None
    inputs = data.files if data is not None else []
    check_output(out, maker, inputs=inputs, writes=names)
    columns, relative = friction_map(described)
    summary: dict[str, object] = {"joint": described.name, "relative_std": relative}
    notes = [
        f"Friction of {described.name}, for feed-forward.",
        f"Standard deviation by the description: {100 * relative:.2g} % (RMS over the map in friction.csv).",
    ]
    if data is not None:
        from ...diagnosis.collapse import feed_forward_error

        error = feed_forward_error(data, described)
        summary |= {"current": error.to_json()}
        notes.append(
            f"RMS current error on held-out motion of {measurement}: {error.with_friction:.4g} A with it, "
            f"{error.without:.4g} A without ({error.samples} samples)."
        )
    with output_folder(out, maker, inputs=inputs, writes=names) as folder:
        table = {f"{name} [{COLUMNS[name] or 1}]": values for name, values in columns.items()}
        pd.DataFrame(table).to_csv(folder / "friction.csv", index=False)
        (folder / "friction.c").write_text(c_function(described, notes), encoding="utf-8")
    if as_json:
        return summary | {"files": [str(out / name) for name in names]}
    for line in [*notes, *(str(out / name) for name in names)]:
        print(line)
