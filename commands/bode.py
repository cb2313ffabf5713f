"""`flexspline bode`: a frequency response."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

from ..models.output import check_output, made_from, output_folder
from ._measurement import load_measurement
from ._options import AsJson, OtherJoint, ResultFolder, argument, with_plugins

EXAMPLES = ("flexspline bode measurement --out bode", "flexspline bode my_chirp.yaml --out bode")


@with_plugins
def command(
    source: Annotated[str, argument("a measurement, or a scenario (name or YAML file) to run")],
    out: ResultFolder,
    joint: OtherJoint = None,
    as_json: AsJson = False,
) -> Any:
    """Compute the frequency response from motor current to velocity, measured and simulated.

    Excite the joint with a chirp or multisine (docs/scenarios.md). Writes `bode.csv` and `bode.png`, and prints resonances.
    """
    import numpy as np
    import pandas as pd

    from ..diagnosis.bode import response
    from ..models.recording import Measurement
    from ..views.figures.bode import bode_figure
    from ..views.figures.sheet import save

    maker, names = made_from("bode", source), ["bode.csv", "bode.png"]
    path = Path(source)
    measured = path.exists() and path.suffix not in (".yaml", ".yml")
    if measured:
        data, described = load_measurement(path, joint)
    inputs = data.files if measured else [path] if path.exists() else []
    check_output(out, maker, inputs=inputs, writes=names)
    if not measured:
        from ..models.joint import load_joint
        from ..scenarios.run import run_scenario
        from ..scenarios.scenario import load_scenario

        run = run_scenario(*load_scenario(source))
        data = Measurement(run.name, path, (run.as_recording(),))
        described = load_joint(joint) if joint is not None else run.known_joint
    found = response(data, described)
    columns = {
        "frequency [Hz]": found.frequency,
        "measured [rad/(s·A)]": np.abs(found.measured), "measured phase [°]": np.degrees(np.angle(found.measured)),
        "simulated [rad/(s·A)]": np.abs(found.simulated), "simulated phase [°]": np.degrees(np.angle(found.simulated)),
        "coherence [1]": found.coherence,
    }  # fmt: skip
    with output_folder(out, maker, inputs=inputs, writes=names) as made:
        pd.DataFrame(columns).to_csv(made / "bode.csv", index=False)
        save(bode_figure(found, f"{data.name}: {described.name}"), made / "bode.png")
    summary = found.to_json()
    if as_json:
        return summary | {"files": [str(out / name) for name in names]}
    for name in ("measured", "simulated"):
        for what, values in summary[name].items():
            print(f"{name} {what}: {', '.join(f'{f:.4g}' for f in values) or 'none'}{' Hz' if values else ''}")
    print(f"coherent (> 0.5): {100 * summary['coherent_share']:.0f} % of the frequencies to {summary['to']:.3g} Hz")
    for name in names:
        print(out / name)
