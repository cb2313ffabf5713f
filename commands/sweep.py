"""`flexspline sweep`: a study over seeds, parameters, scenarios and filters into a dataset."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from ..models.output import at_end, check_output, output_folder
from ..models.processes import single_threaded
from ._console import console, progress
from ._options import AsJson, Jobs, argument, option, shipped, with_plugins

if TYPE_CHECKING:
    from ..scenarios.studies.statistics import Swept, WorstRun

EXAMPLES = (
    "flexspline sweep noise_and_load --seeds 3 --out sweep",
    "flexspline sweep my_study.yaml --scheduler tcp://head:8786 --out sweep",
)


@with_plugins
def command(
    study: Annotated[
        str, argument("Name of a shipped study, or path of a YAML file.", autocompletion=shipped("scenarios/studies"))
    ],
    out: Annotated[Path, option("Folder of the dataset; an unfinished one is continued.")],
    jobs: Jobs = None,
    scheduler: Annotated[str, option("address of a Dask scheduler, `tcp://…`: compute on its workers")] = "",
    chunk: Annotated[int | None, option("runs per file; the rows do not depend on it", min=1)] = None,
    seeds: Annotated[int | None, option("number of seeds, instead of the study's", min=1)] = None,
    figures: Annotated[bool, option("Draw the figures.")] = True,
    as_json: AsJson = False,
) -> Any:
    """Sweep a study: seeds × parameters × scenarios × filters.

    Rows are written to `OUT/rows` (partitioned Parquet) while they are computed. An interrupted sweep continues when it is called
    again; the rows are the same to the bit. At the end it writes `summary.md` and `summary.csv`, means with 95 % intervals and
    differences paired over seeds, figures, and the worst run of every scenario, to run again.
    """
    single_threaded()
    from ..scenarios.studies.statistics import open_study, summarise, summary_rows
    from ..scenarios.studies.sweep import sweep
    from ..views.sweep_tables import metric_column, sweep_table

    dataset = open_study(study, out, seeds)
    design, asked = dataset.design, dataset.design.study
    check_output(out, "sweep", writes=("summary.csv", "summary.md"))
    with progress(counting=True, remaining=True) as bar:
        task = bar.add_task(f"{asked.name}: runs", total=design.runs, completed=dataset.done())

        def stopped() -> str:
            return f"stopped; {dataset.done()} of {design.runs} runs are in {out}; the same command continues"

        with at_end(stopped):
            sweep(
                design, dataset, jobs or os.cpu_count() or 1, chunk, scheduler or None,
                lambda runs: bar.update(task, advance=runs),
            )  # fmt: skip
        bar.update(task, description=f"{asked.name}: summary", total=None)
        found = summarise(dataset)
        write_summary(found, figures)
    if as_json:
        return list(summary_rows(list(found.aggregates), design))
    terminal = console()
    terminal.print(sweep_table(list(found.aggregates), asked, asked.metrics[0]))
    if found.failed:
        text = f"{found.failed} estimates have no metrics; `failure` in the rows has the reason, summary.md the place"
        terminal.print(text, style="red")
    column = metric_column(asked.metrics[0])
    for run in found.worst:
        text = f"{run.scenario}: largest {column.heading} {column.scale * run.value:.3g} {column.unit} by {run.filter}"
        terminal.print(f"{text}, seed {run.seed}{_again(run, out)}", soft_wrap=True)
    terminal.print(f"{out / 'summary.md'}, {out / 'summary.csv'}; rows in {out / 'rows'}")


def _again(run: WorstRun, out: Path) -> str:
    from ..models.command_lines import command_line

    if run.again is None:
        return " (its joint is drawn)"
    return f"; again: {command_line('run', out / 'worst' / f'{run.scenario}.yaml')}"


def write_summary(swept: Swept, figures: bool = True) -> None:
    """Write `summary.csv`, `summary.md`, the worst runs as scenarios, and figures into the dataset's folder."""
    from ..models.files import yaml_text
    from ..scenarios.studies.statistics import write_csv
    from ..views.sweep_tables import sweep_markdown

    found, study = list(swept.aggregates), swept.study
    with output_folder(swept.folder, "sweep") as new:
        write_csv(found, swept.dataset.design, new / "summary.csv")
        (new / "summary.md").write_text(sweep_markdown(found, study), encoding="utf-8")
        for run in swept.worst:
            if run.again is not None:
                (new / "worst").mkdir(exist_ok=True)
                text = yaml_text(run.again.model_dump(mode="json", exclude_none=True))
                (new / "worst" / f"{run.scenario}.yaml").write_text(text, encoding="utf-8")
        if figures:
            from ..views.sweep_figures import save_sweep_figures

            save_sweep_figures(found, study, new / "figures")
