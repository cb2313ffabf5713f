"""`flexspline sweep`: a study over seeds, parameters, scenarios and filters into a dataset."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated

import typer

from ._listing import AsJson
from ._options import shipped, with_plugins

EXAMPLES = (
    "flexspline sweep noise_and_load --seeds 3 --out sweep",
    "flexspline sweep my_study.yaml --scheduler tcp://head:8786 --out sweep",
)


@with_plugins
def command(
    study: Annotated[
        str,
        typer.Argument(
            help="Name of a shipped study, or path of a YAML file.", autocompletion=shipped("scenarios/studies")
        ),
    ],
    out: Annotated[Path, typer.Option("--out", help="Folder of the dataset; one that was begun goes on.")],
    jobs: Annotated[int | None, typer.Option(min=1, help="threads; all cores by default")] = None,
    scheduler: Annotated[str, typer.Option(help="address of a Dask scheduler, `tcp://…`: compute on its workers")] = "",
    chunk: Annotated[int | None, typer.Option(min=1, help="runs per file; the rows do not depend on it")] = None,
    seeds: Annotated[int | None, typer.Option(min=1, help="how many seeds, instead of the study's")] = None,
    figures: Annotated[bool, typer.Option(help="Draw the figures.")] = True,
    as_json: AsJson = False,
) -> None:
    """Sweep a study: seeds × parameters × scenarios × filters.

    Rows arrive in `OUT/rows` (partitioned Parquet) as they are computed. Interrupted, it goes on where it was when called
    again; the rows are the same to the bit. At the end: `summary.md` and `summary.csv`, means with 95 % intervals and
    differences paired over seeds, and figures.
    """
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(name, "1")  # one joint a thread is enough
    from ..models.output import at_end, check_output, output_folder
    from ..scenarios.studies.dataset import Dataset
    from ..scenarios.studies.design import Design
    from ..scenarios.studies.statistics import aggregate, summary_rows, write_csv
    from ..scenarios.studies.study import load_study, shipped_studies
    from ..scenarios.studies.sweep import sweep, versions
    from ..views.sweep_tables import sweep_markdown, sweep_table
    from ._console import console, progress

    asked, folder = load_study(study)
    if seeds is not None:
        asked = asked.with_seeds(seeds)
    terminal = console()
    design = Design.of(asked, folder)
    source = (
        study if study in shipped_studies() else Path(os.path.relpath(Path(study).resolve(), out.resolve())).as_posix()
    )
    dataset = Dataset.open(out, design, versions(), source)
    check_output(out, "sweep", writes=("summary.csv", "summary.md"))
    with progress(counting=True, remaining=True) as bar:
        task = bar.add_task(f"{asked.name}: runs", total=design.runs, completed=dataset.done())

        def stopped() -> str:
            return f"stopped; {dataset.done()} of {design.runs} runs are in {out}; the same command goes on"

        with at_end(stopped):
            sweep(
                design, dataset, jobs or os.cpu_count() or 1, chunk, scheduler or None,
                lambda runs: bar.update(task, advance=runs),
            )  # fmt: skip
        bar.update(task, description=f"{asked.name}: summary", total=None)
        found = list(aggregate(dataset))
        with output_folder(out, "sweep") as new:
            write_csv(found, design, new / "summary.csv")
            (new / "summary.md").write_text(sweep_markdown(found, asked), encoding="utf-8")
            if figures:
                from ..views.sweep_figures import save_sweep_figures

                save_sweep_figures(found, asked, new / "figures")
    if as_json:
        from ..models.files import json_text

        print(json_text(list(summary_rows(found, design))))
        return
    terminal.print(sweep_table(found, asked, asked.metrics[0]))
    failed = sum(s.failed for s in found)
    if failed:
        terminal.print(
            f"{failed} estimates have no measures; `failure` in the rows says why, summary.md where", style="red"
        )
    terminal.print(f"{out / 'summary.md'}, {out / 'summary.csv'}; rows in {out / 'rows'}")
