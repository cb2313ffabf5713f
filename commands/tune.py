"""`flexspline tune`: tuning parameters of estimators, found on training seeds, tested on others."""

from __future__ import annotations

import os
import re
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from ..models.errors import InputError
from ..models.output import check_output, output_folder
from ._console import console, progress
from ._options import AsJson, Changes, Estimators, Jobs, SomeScenarios, Vary, option, with_plugins

if TYPE_CHECKING:
    from rich.progress import Progress, TaskID

_MOST_SEEDS = 100_000

EXAMPLES = (
    "flexspline tune link_sweep --filter RAREKF --out tuned",
    "flexspline tune --together --evaluations 100 --out tuned",
)


@with_plugins
def command(
    out: Annotated[Path, option("Folder for tuned.yaml, tuned.md and the figure.")],
    scenarios: SomeScenarios = None,
    filter_: Estimators = None,
    train: Annotated[str, option("Seeds for tuning.", metavar="A-B")] = "1-5",
    test: Annotated[str, option("Seeds for the report.", metavar="A-B")] = "101-110",
    together: Annotated[
        bool, option("One tuning for all scenarios (geometric mean), instead of one for each.")
    ] = False,
    evaluations: Annotated[
        int, option("Settings to try per filter; a tenth for filters that simulate the joint.", min=1)
    ] = 300,
    vary: Vary = True,
    jobs: Jobs = None,
    pareto: Annotated[bool, option("Sweep noise against delay if a scenario has pushes.")] = True,
    changes: Changes = None,
    as_json: AsJson = False,
) -> Any:
    """Tune filters for the RMS error on training seeds, report on test seeds; noise against delay as a curve per filter.

    Writes `tuned.yaml`, whose `filters` can be copied into a scenario, per scenario or, with --together, once.
    """
    training, testing = _seeds(train, "--train"), _seeds(test, "--test")
    from ..scenarios.evaluation import tuning
    from ..scenarios.filters import estimators
    from ..views.limit_tables import TUNED_HEADS, tuned_rows, tuned_table
    from ..views.tables import markdown_table
    from ._runs import PAPER, load_all

    tuning.check_seeds(training, testing)
    chosen, threads = estimators(filter_ or ()), jobs or os.cpu_count() or 1
    loaded = load_all(scenarios or PAPER, changes)
    groups = [loaded] if together else [[one] for one in loaded]
    terminal, answer = console(), {}
    folders = [out if together or len(groups) == 1 else out / group[0][0].name for group in groups]
    for folder in folders:
        check_output(folder, "tune", writes=("tuned.yaml", "tuned.md", "pareto.png"), within=out)
    for group, folder in zip(groups, folders, strict=True):
        names = ", ".join(scenario.name for scenario, _ in group)
        with progress() as bar:
            task = bar.add_task(f"{names}: simulating", total=len(chosen))
            advance = partial(_advance, bar, task, names)
            found = tuning.tune_all(chosen, group, training, testing, evaluations, vary, pareto, threads, advance)
            bar.update(task, completed=len(chosen))
        title = f"{names}: tuned on seeds {train}, tested on {test}"
        answer[names] = found.to_json()
        results = list(found.tuned.values())
        if not as_json:
            terminal.print(tuned_table(results, title))
        with output_folder(folder, "tune", within=out) as new:
            found.write(new / "tuned.yaml")
            text = f"# {title}\n\n{markdown_table(TUNED_HEADS, tuned_rows(results))}\n"
            (new / "tuned.md").write_text(text, encoding="utf-8")
            if found.fronts:
                from ..views.figures.sheet import save
                from ..views.limit_figures import pareto_figure

                save(pareto_figure(found.fronts, found.pushed, len(testing)), new / "pareto.png", 110)
        if not as_json:
            terminal.print(f"{folder / 'tuned.yaml'}, tuned.md{', pareto.png' if found.fronts else ''}")
    return answer if as_json else None


def _advance(bar: Progress, task: TaskID, names: str, done: int, name: str) -> None:
    bar.update(task, description=f"{names}: {name}", completed=done)


def _seeds(text: str, option: str) -> list[int]:
    """Return the seeds of `A-B`, or of one number."""
    first, dash, last = text.partition("-")
    if not all(re.fullmatch("[0-9]{1,18}", part) for part in ([first, last] if dash else [first])) or (
        dash and not 0 <= int(last) - int(first) < _MOST_SEEDS
    ):
        raise InputError(f"{option}: expected seeds as A-B with A ≤ B, at most {_MOST_SEEDS} of them, got {text!r}")
    return list(range(int(first), int(last or first) + 1))
