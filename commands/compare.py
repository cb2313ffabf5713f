"""`flexspline compare`: filters on identical disturbances, in one table."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

from ..models.output import output_folder
from ._console import console
from ._options import AsJson, Changes, Out, Seed, SomeScenarios, option, with_plugins

EXAMPLES = (
    "flexspline compare",
    'flexspline compare link_sweep --set "filters=[RAREKF, dynamics_ekf]" --json',
    'flexspline compare --plugin my_filter.py --set "filters=[RAREKF, moving_average]"',
)


@with_plugins
def command(
    scenarios: SomeScenarios = None,
    out: Out = Path("runs"),
    seed: Seed = None,
    changes: Changes = None,
    figures: Annotated[bool, option("Draw the figures.")] = True,
    recording: Annotated[bool, option("Write the Rerun recordings.")] = True,
    as_json: AsJson = False,
) -> Any:
    """Compare filters: error, noise, delay, response time, robust share, NIS."""
    from ..models.files import json_text
    from ._runs import PAPER, metrics_of, print_notes, run_all

    with output_folder(out, "compare", writes=("comparison.json", "comparison.md")) as folder:
        runs = run_all(scenarios or PAPER, out, seed, changes, figures, recording)
        from ..views.tables import comparison_markdown, comparison_table

        metrics = {run.name: run.metrics for run, _ in runs}
        text = json_text(metrics)
        (folder / "comparison.json").write_text(text, encoding="utf-8")
        (folder / "comparison.md").write_text(comparison_markdown(metrics), encoding="utf-8")
    if as_json:
        return metrics_of(runs)
    terminal = console()
    terminal.print(comparison_table(metrics))
    print_notes(terminal, runs)
    terminal.print(f"{out / 'comparison.md'}, {out / 'comparison.json'}; figures and recordings in {out}")
