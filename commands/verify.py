"""`flexspline verify`: the plant compared with independent solutions of its equations."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from ._console import console, print_table
from ._options import AsJson, argument, option

EXAMPLES = ("flexspline verify reference",)


def command(
    folder: Annotated[Path, argument("Folder with the reference solutions (Parquet).")],
    joint: Annotated[str, option("Joint of these solutions: name or path.")] = "test-joint",
    timestep: Annotated[float, option("Timestep of the plant [s].", min=1e-6, max=1e-3)] = 0.0002,
    as_json: AsJson = False,
) -> None:
    """Compare the plant with reference solutions; exit code 1 when a limit is missed."""
    from ..models.files import json_text
    from ..models.joint import load_joint
    from ..sim.verify import verify

    terminal = console()
    with terminal.status("simulating the reference solutions"):
        differences = verify(folder, load_joint(joint), timestep)
    if as_json:
        print(json_text([asdict(d) | {"passed": d.passed} for d in differences]))
    else:
        title = f"RMS difference relative to the reference, timestep {timestep * 1e3:g} ms"
        rows = [
            (d.file, d.channel, "met" if d.passed else "missed", f"{100 * d.relative:.3f} %", f"{100 * d.limit:g} %")
            for d in differences
        ]
        print_table(terminal, title, ("reference", "channel", "", "difference", "limit"), rows, 3)
    if not all(d.passed for d in differences):
        raise typer.Exit(1)
