"""`flexspline validate`: a measurement compared with the prediction of a joint's description."""

from __future__ import annotations

import warnings
from typing import TYPE_CHECKING, Any

from ..models.errors import InputWarning
from ..models.output import check_output, made_from, output_folder
from ._console import console, print_table
from ._measurement import load_measurement, print_mistakes
from ._options import AsJson, MeasurementPath, OtherJoint, ResultFolder, with_plugins

if TYPE_CHECKING:
    from rich.console import Console

    from ..diagnosis.validate import Validation

EXAMPLES = ("flexspline validate measurement --joint diagnosis/joint.yaml --out check",)


@with_plugins
def command(measurement: MeasurementPath, out: ResultFolder, joint: OtherJoint = None, as_json: AsJson = False) -> Any:
    """Compare a measurement with the prediction of a joint's description; nothing is fitted."""
    from ..models.command_lines import mending
    from ..models.files import write_json
    from ..models.tables import write_table

    data, described = load_measurement(measurement, joint)
    maker = made_from("validate", measurement)
    names = ["validation.json", *(f"{r.name}.parquet" for r in data.recordings)]
    check_output(out, maker, inputs=data.files, writes=names)

    from ..diagnosis.data.mistakes import mended_if_possible
    from ..diagnosis.validate import validate

    found = validate(data, described)
    answer = found.to_json() | {"measurement": str(measurement), "description": joint or data.recordings[0].joint}
    with output_folder(out, maker, inputs=data.files, writes=names) as folder:
        write_json(folder / "validation.json", answer)
        for recording in found.recordings:
            write_table(folder / f"{recording.name}.parquet", recording.columns, recording.column_units)
    if not found.residual:
        why = "nothing moves: there are no errors, which are computed in motion"
        warnings.warn(f"{measurement}: {why}", InputWarning, stacklevel=2)
    if as_json:
        return answer
    possible = mended_if_possible(data, described, found.mistakes) is not None
    _show(console(), found, mending(data, described) if possible else "")
    console().print(f"{out}: {', '.join(names)}")


def _show(terminal: Console, found: Validation, correction: str) -> None:
    from ..models.joint_parts import beyond_sentence

    if found.mistakes:
        print_mistakes(terminal, found.mistakes, correction)
    if not found.residual:
        return
    rows = [
        (
            name.replace("_", " "), e.unit, f"{e.rms:.4g}", f"{e.mean:.3g}", f"{e.noise:.4g}", f"{100 * e.inside:.0f} %"
        )
        for name, e in found.residual.items()
    ]  # fmt: skip
    heads = ("", "unit", "error", "mean", "noise", "inside the 95 % band")
    print_table(terminal, f"{found.joint}: error of the simulation in motion (RMS)", heads, rows, 2)
    regions = []
    for r in found.regions:
        by, low, high = r.by, f"{r.low:.3g}", f"{r.high:.3g}"
        if by == "direction":
            by, low, high = "backward" if r.high <= 0 else "forward", "", ""
        errors = (f"{r.rms[name]:.4g}" if name in r.rms else "–" for name in found.residual)
        regions.append((by + (" *" if r.beyond > 0.5 else ""), r.unit, low, high, *errors))
    columns = [f"{name.replace('_', ' ')} [{e.unit}]" for name, e in found.residual.items()]
    print_table(terminal, "by region", ("", "unit", "from", "to", *columns), regions, 2)
    if found.mostly_offset:
        terminal.print(
            "link encoder: the description does not know its zero, which may explain most of the error of link position, "
            "joint torque and current. `flexspline diagnose` determines it in the joint that it writes."
        )
    sentence = beyond_sentence(found.beyond)
    if sentence:
        outside = any(r.beyond > 0.5 for r in found.regions)
        terminal.print(sentence + (" (*: most of the region)" if outside else ""))
