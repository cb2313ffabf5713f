"""`flexspline verify`: the plant against independent solutions of its equations."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from ._listing import AsJson

EXAMPLES = ("flexspline verify reference",)


def command(
    folder: Annotated[Path, typer.Argument(help="Folder with the reference solutions (Parquet).")],
    joint: Annotated[str, typer.Option(help="The joint that they were solved for: name or path.")] = "test-joint",
    timestep: Annotated[float, typer.Option(help="Timestep of the plant [s].", min=1e-6, max=1e-3)] = 0.0002,
    as_json: AsJson = False,
) -> None:
    """Compare the plant with reference solutions; exit code 1 when a limit is missed."""
    from rich.table import Table
    from rich.text import Text

    from ..models.joint import load_joint
    from ..sim.verify import verify
    from ._console import console

    out = console()
    with out.status("driving the plant as the reference solutions describe"):
        differences = verify(folder, load_joint(joint), timestep)
    if as_json:
        from ..models.files import json_text

        print(json_text([asdict(d) | {"passed": d.passed} for d in differences]))
        raise typer.Exit(0 if all(d.passed for d in differences) else 1)
    table = Table(title=f"RMS difference relative to the reference, timestep {timestep * 1e3:g} ms")
    for heading in ("reference", "channel", "difference", "limit", ""):
        table.add_column(heading, justify="right" if heading in ("difference", "limit") else "left")
    for d in differences:
        verdict = Text("met", "green") if d.passed else Text("missed", "red")
        table.add_row(d.file, d.channel, f"{100 * d.relative:.3f} %", f"{100 * d.limit:g} %", verdict)
    out.print(table)
    if not all(d.passed for d in differences):
        raise typer.Exit(1)
