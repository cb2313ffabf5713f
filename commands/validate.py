"""`flexspline validate`: a measurement beside what a joint's description says it should have been."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from rich.console import Console

    from ..diagnosis.validate import Validation

_NAMES = {
    "link_position": "link angle", "link_velocity": "link speed", "joint_torque": "load",
    "driving": "motion that the motor drives", "driven": "motion that the load drives",
}  # fmt: skip


def command(
    measurement: Annotated[Path, typer.Argument(help="a recording, or a folder of several")],
    out: Annotated[Path, typer.Option(help="folder to write to")],
    joint: Annotated[str | None, typer.Option(help="name of, or path to, a joint; the recordings' by default")] = None,
) -> None:
    """Say how well a joint's description predicts a measurement: nothing is fitted."""
    from ..models.output import check_output, made_from, output_folder
    from ..models.recording import read_measurement
    from ..models.tables import write_table
    from ._console import console
    from .diagnose import finite

    data = read_measurement(measurement)
    described = data.load_joint(joint)
    maker = made_from("validate", measurement)
    sources = [r.source for r in data.recordings if r.source]
    names = ["validation.json", *(f"{r.name}.parquet" for r in data.recordings)]
    check_output(out, maker, inputs=sources, writes=names)

    from ..diagnosis.validate import validate

    found = validate(data, described)
    with output_folder(out, maker, inputs=sources, writes=names) as folder:
        text = json.dumps(finite(found.to_json()), indent=1, ensure_ascii=False, allow_nan=False)
        (folder / "validation.json").write_text(text + "\n", encoding="utf-8")
        for recording in found.recordings:
            write_table(folder / f"{recording.name}.parquet", recording.columns, recording.column_units)
    _show(console(), found)
    console().print(f"{out}: {', '.join(names)}", highlight=False, markup=False)


def beyond_sentence(beyond: dict[str, float]) -> str:
    """What of a motion lies beyond a joint's range of validity, for people; empty where nothing does."""
    if not beyond:
        return ""
    parts = [f"{_NAMES.get(name, name)} {100 * share:.2g} %" for name, share in beyond.items()]
    return (
        f"beyond the range of the data behind this joint (share of the samples in motion): {', '.join(parts)}; "
        "what is said there is extrapolated"
    )


def _show(terminal: Console, found: Validation) -> None:
    from rich.table import Table
    from rich.text import Text

    for mistake in found.mistakes:
        terminal.print(f"mistake in the data: {mistake.description}", highlight=False, markup=False)
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
    for r in found.regions:
        cells = [f"{r.rms[name]:.4g}" if name in r.rms else "–" for name in found.residual]
        table.add_row(r.by + (" *" if r.beyond > 0.5 else ""), f"{r.low:.3g}", f"{r.high:.3g}", r.unit, *cells)
    terminal.print(table)
    sentence = beyond_sentence(found.beyond)
    if sentence:
        terminal.print(f"{sentence} (*: most of the region)", highlight=False, markup=False)
