"""`flexspline run`: scenarios into run folders."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ._options import Changes, Out, Scenarios, Seed, with_plugins


@with_plugins
def command(
    scenarios: Scenarios,
    out: Out = Path("runs"),
    seed: Seed = None,
    changes: Changes = None,
    figures: Annotated[bool, typer.Option(help="Draw the figures.")] = True,
    recording: Annotated[bool, typer.Option(help="Write the Rerun recording.")] = True,
) -> None:
    """Run scenarios and keep signals, estimates, metrics, figures and a Rerun recording."""
    from ._console import console
    from ._runs import run_all, tell

    runs = run_all(scenarios, out, seed, changes, figures, recording)
    from ..views.tables import comparison_table

    terminal = console()
    terminal.print(comparison_table({run.name: run.metrics for run, _ in runs}))
    tell(terminal, runs)
    for _, folder in runs:
        terminal.print(f"{folder}", highlight=False, markup=False)
