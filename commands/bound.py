"""`flexspline bound`: how far every estimator is from what is possible, and whether it knows."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ._listing import AsJson
from ._options import Changes, Estimators, SomeScenarios, Vary, with_plugins

EXAMPLES = (
    "flexspline bound link_sweep --seeds 5",
    "flexspline bound external_push --filter RAREKF --filter dynamics_ekf --out limits",
)


@with_plugins
def command(
    scenarios: SomeScenarios = None,
    seeds: Annotated[int, typer.Option(min=1, help="How many seeds: 1, 2, …")] = 10,
    filter_: Estimators = None,
    intensity: Annotated[
        float | None,
        typer.Option(
            min=0,
            help="Of the external torque's random walk in the bound, N·m/√s; by default fitted to what the scenario's "
            "own changes up to 20 Hz.",
        ),
    ] = None,
    tolerance: Annotated[
        float,
        typer.Option(
            min=0, help="Share of the joint's tolerances that are the prior of the second bound; 0 leaves it out."
        ),
    ] = 1.0,
    walk: Annotated[
        bool, typer.Option(help="Replace the disturbances by draws of that random walk: the bound's own model.")
    ] = False,
    vary: Vary = True,
    out: Annotated[
        Path | None, typer.Option(help="Folder for limits.parquet, summary.csv and a figure per scenario.")
    ] = None,
    changes: Changes = None,
    as_json: AsJson = False,
) -> None:
    """Hold every estimator against the posterior Cramér-Rao bound; NIS, NEES and whiteness of the innovations.

    The bound holds for the joint's dynamics, exactly known, with a random-walk external torque, and the encoders' noise; beside
    it stands the one for a joint that is known within its tolerances. Of a scripted scenario it is a yardstick: a filter that
    adapts may fall below it. With `--walk` it may not.
    """
    from ..models.errors import InputError
    from ..models.output import check_output, output_folder
    from ..scenarios.evaluation.limits import assess, fitted_intensity, matched
    from ..scenarios.filters import estimators
    from ..views.limit_tables import limits_table
    from ._console import console, progress
    from ._runs import PAPER, load_all

    chosen = estimators(filter_ or ())
    loaded = load_all(scenarios or PAPER, changes)
    if out is not None:
        names = [f"{s.name}/{file}" for s, _ in loaded for file in ("limits.parquet", "limits.png")]
        check_output(out, "bound", writes=["summary.csv", *names])
    terminal, found = console(), []
    with progress() as bar:
        task = bar.add_task("", total=seeds * len(loaded))
        for scenario, folder in loaded:
            bar.update(task, description=scenario.name)
            level = intensity
            if walk:
                level = intensity if intensity is not None else fitted_intensity(scenario)
                if level == 0.0:
                    raise InputError(
                        f"scenario {scenario.name}: --walk: expected an --intensity, it has no disturbance to fit"
                    )
                scenario = matched(scenario, level)
            found.append(
                assess(scenario, folder, range(1, seeds + 1), chosen, level, tolerance, lambda: bar.advance(task), vary)
            )
    if not as_json:
        for limits in found:
            terminal.print(limits_table(limits))
    if out is not None:
        from ..views.limit_figures import limits_figure, save_figure
        from ..views.limit_files import write_limits, write_summary

        with output_folder(out, "bound") as folder:
            for limits in found:
                write_limits(limits, folder / limits.scenario / "limits.parquet")
                save_figure(limits_figure(limits), folder / limits.scenario / "limits.png")
            write_summary(found, folder / "summary.csv")
        if not as_json:
            terminal.print(f"{out / 'summary.csv'}; limits.parquet and limits.png per scenario")
    if as_json:
        from ..models.files import json_text
        from ..views.limit_files import summary_rows

        print(json_text(list(summary_rows(found))))
