"""`flexspline validate`: a measurement beside what a joint's description says it should have been."""

from __future__ import annotations

import warnings
from typing import TYPE_CHECKING

from ._listing import AsJson
from ._measurement import parted_measurement
from ._options import MeasurementPath, OtherJoint, ResultFolder, with_plugins

if TYPE_CHECKING:
    from rich.console import Console

    from ..diagnosis.validate import Validation

EXAMPLES = ("flexspline validate measurement --joint diagnosis/joint.yaml --out check",)


@with_plugins
def command(
    measurement: MeasurementPath,
    out: ResultFolder,
    joint: OtherJoint = None,
    as_json: AsJson = False,
) -> None:
    """Say how well a joint's description predicts a measurement: nothing is fitted."""
    from ..models.command_lines import mending
    from ..models.errors import InputWarning
    from ..models.files import json_text
    from ..models.output import check_output, made_from, output_folder
    from ..models.tables import write_table
    from ._console import console

    data, described = parted_measurement(measurement, joint)
    maker = made_from("validate", measurement)
    names = ["validation.json", *(f"{r.name}.parquet" for r in data.recordings)]
    check_output(out, maker, inputs=data.files, writes=names)

    from ..diagnosis.data.mistakes import mended_if_possible
    from ..diagnosis.validate import validate

    found = validate(data, described)
    with output_folder(out, maker, inputs=data.files, writes=names) as folder:
        of = {"measurement": str(measurement), "description": joint or data.recordings[0].joint}
        text = json_text(found.to_json() | of)
        (folder / "validation.json").write_text(text + "\n", encoding="utf-8")
        for recording in found.recordings:
            write_table(folder / f"{recording.name}.parquet", recording.columns, recording.column_units)
    if not found.residual:
        why = "nothing moved: errors are taken in motion, and there are none to tell"
        warnings.warn(f"{measurement}: {why}", InputWarning, stacklevel=2)
    if as_json:
        print(text)
        return
    possible = mended_if_possible(data, described, found.mistakes) is not None
    _show(console(), found, mending(data, described) if possible else "")
    console().print(f"{out}: {', '.join(names)}")


def _show(terminal: Console, found: Validation, mend: str) -> None:
    from rich.table import Table
    from rich.text import Text

    from ..models.joint import beyond_sentence
    from ._mistakes import print_mistakes

    if found.mistakes:
        print_mistakes(terminal, found.mistakes, mend)
    if not found.residual:
        return
    table = Table(title=f"{found.joint}: error of the simulation in motion (RMS)")
    for heading in ("", "error", "mean", "noise", "unit", "inside the 95 % band"):
        table.add_column(heading, justify="left" if heading in ("", "unit") else "right")
    for name, e in found.residual.items():
        table.add_row(
            name.replace("_", " "), f"{e.rms:.4g}", f"{e.mean:.3g}", f"{e.noise:.4g}", e.unit, f"{100 * e.inside:.0f} %"
        )
    terminal.print(table)
    table = Table(title="by region")
    columns = [f"{name.replace('_', ' ')} [{e.unit}]" for name, e in found.residual.items()]
    for heading in ("", "from", "to", "unit", *columns):
        table.add_column(Text(heading), justify="left" if heading in ("", "unit") else "right")
    starred = False
    for r in found.regions:
        cells = [f"{r.rms[name]:.4g}" if name in r.rms else "–" for name in found.residual]
        star = r.beyond > 0.5
        starred |= star
        by, ends = r.by, (f"{r.low:.3g}", f"{r.high:.3g}")
        if by == "direction":
            by, ends = "backward" if r.high <= 0 else "forward", ("", "")
        table.add_row(by + (" *" if star else ""), *ends, r.unit, *cells)
    terminal.print(table)
    if found.untared:
        terminal.print(
            "link encoder: the description leaves its zero open, and most of the error of link position may be that: "
            "torsion, and with it joint torque and current, is off by it. `flexspline diagnose` tares it in the joint it writes."
        )
    sentence = beyond_sentence(found.beyond)
    if sentence:
        terminal.print(sentence + (" (*: most of the region)" if starred else ""))
