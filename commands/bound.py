"""`flexspline bound`: errors of estimators relative to the Cramér-Rao bound."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

from ..models.errors import InputError
from ..models.output import check_output, output_folder
from ._console import console, progress
from ._options import AsJson, Changes, Estimators, SomeScenarios, Vary, option, with_plugins

EXAMPLES = (
    "flexspline bound link_sweep --seeds 5",
    "flexspline bound external_push --filter RAREKF --filter dynamics_ekf --out limits",
)


@with_plugins
def command(
    scenarios: SomeScenarios = None,
    seeds: Annotated[int, option("How many seeds: 1, 2, …", min=1)] = 10,
    filter_: Estimators = None,
    intensity: Annotated[
        float | None,
        option(
            "Of the external torque's random walk in the bound, N·m/√s; by default fitted to the scenario's external "
            "torque up to 20 Hz.",
            min=0,
        ),
    ] = None,
    tolerance: Annotated[
        float, option("Share of the joint's tolerances that are the prior of the second bound; 0 omits it.", min=0)
    ] = 1.0,
    walk: Annotated[
        bool, option("Replace the disturbances by draws of that random walk, which is the bound's model.")
    ] = False,
    vary: Vary = True,
    out: Annotated[Path | None, option("Folder for limits.parquet, summary.csv and a figure per scenario.")] = None,
    changes: Changes = None,
    as_json: AsJson = False,
) -> Any:
    """Compare every estimator with the posterior Cramér-Rao bound; NIS, NEES and whiteness of the innovations.

    The bound is for an exactly known joint with a random-walk external torque and the encoders' noise. A second bound is for a
    joint that is known within its tolerances. In a scripted scenario, an adaptive filter may be below the bound; with
    `--walk` it cannot.
    """
    from ..models.files import write_rows
    from ..scenarios.evaluation.limits import assess, fitted_intensity, matched
    from ..scenarios.filters import estimators
    from ..views.limit_tables import SUMMARY, limits_table, summary_rows, write_limits
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
        from ..views.figures.sheet import save
        from ..views.limit_figures import limits_figure

        with output_folder(out, "bound") as folder:
            for limits in found:
                write_limits(limits, folder / limits.scenario / "limits.parquet")
                save(limits_figure(limits), folder / limits.scenario / "limits.png", 110)
            write_rows(folder / "summary.csv", list(summary_rows(found)), SUMMARY)
        if not as_json:
            terminal.print(f"{out / 'summary.csv'}; limits.parquet and limits.png per scenario")
    return list(summary_rows(found)) if as_json else None
