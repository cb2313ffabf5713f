"""The shipped studies: `python -m benchmarks studies` runs them and writes the tables, figures and CSVs of docs/studies.md.

Together they take hours of a core: `noise_and_load` an hour and a half, `model_error` three quarters of one. These two run in
part (`REDUCED`) unless `--whole` is given. The datasets are kept (`--out`), and an interrupted run continues.
`--tables` writes tables and figures from the CSVs.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from flexspline.models.files import write_rows
from flexspline.scenarios.studies.dataset import Dataset
from flexspline.scenarios.studies.design import Design
from flexspline.scenarios.studies.statistics import Aggregate, aggregate, read_csv, summary_rows
from flexspline.scenarios.studies.study import Study, Value, load_study
from flexspline.scenarios.studies.sweep import sweep, versions
from flexspline.views.figures.sheet import save
from flexspline.views.sweep_figures import sweep_figure
from flexspline.views.sweep_tables import cell, metric_column, value_text
from flexspline.views.tables import markdown_table

from . import plots
from .pages import ROOT, fill

STUDIES = ("load_dependent_alpha", "noise_and_load", "model_error")
"""On the page; `tolerance` is what docs/estimators.md measures."""
REDUCED: Mapping[str, Mapping[str, Any]] = {
    "noise_and_load": {
        "seeds": {"first": 1, "count": 30},
        "axes": {"noise_level": {"values": [1, 10]}, "load": {"values": [3, 12]}},
    },
    "model_error": {
        "scenarios": ["link_sweep"],
        "axes": {
            "cause": {
                "causes": [
                    "stiffness", "kinematic_error", "hysteresis", "backlash", "mesh_friction", "torque_constant",
                    "gravity_moment", "encoder_delay",
                ],
                "sizes": [0, 1],
            }
        },
    },
}  # fmt: skip
"""What of a study runs, unless it is to be whole: keys that take other values, and of its axes, by name or kind."""
SHOWN: Mapping[str, tuple[str, ...]] = {name: ("rms",) for name in STUDIES}
"""Measures of a study's table on the page; its CSV has all."""
AT: Mapping[str, Mapping[str, tuple[Any, ...]]] = {
    "load_dependent_alpha": {"load": (1.0, 4.0, 12.0)},
    "noise_and_load": {"load": (3.0, 12.0), "noise_level": (1.0, 3.0, 10.0)},
    "model_error": {
        "size": (0.0, 1.0),
        "scenario": ("link_sweep",),
        "cause": (
            "none", "stiffness", "kinematic_error", "hysteresis", "backlash", "mesh_friction", "load_dependent_friction",
            "torque_constant", "cogging", "gravity_moment", "encoder_delay", "link_encoder_eccentricity",
        ),
    },
}  # fmt: skip
"""Points of a study's table on the page, by axis; its CSV has all."""
FIGURES: Mapping[str, tuple[str, str]] = {
    "load_dependent_alpha": ("external_push", "rms"),
    "noise_and_load": ("external_push", "rms"),
}
"""Of a study's figures the one on the page: scenario and measure."""
DIGITS = 4
"""Of a CSV's numbers, which have intervals of a per cent and more."""


def chosen(name: str, whole: bool) -> tuple[Study, Path]:
    """A shipped study, or what of it runs, and its folder."""
    study, folder = load_study(name)
    change = {} if whole else REDUCED.get(name, {})
    data, axes = study.model_dump(mode="json", exclude_none=True), change.get("axes", {})
    for axis in data["axes"]:
        axis.update(axes.get(axis["name"], axes.get(axis["kind"], {})))
    return Study.model_validate(data | {key: value for key, value in change.items() if key != "axes"}), folder


def table(found: Sequence[Aggregate], design: Design, metrics: Sequence[str], at: Mapping[str, Sequence[Any]]) -> str:
    """Make a table of means: a row for each point of the plant's axes and measure, a column for each variant of a filter."""
    filters = [axis.name for axis in design.study.filter_axes]
    of: dict[tuple, dict[tuple, Aggregate]] = {}
    for one in found:
        place = (one.scenario, *(v for k, v in one.columns.items() if k not in filters))
        variant = (one.filter, *(one.columns[k] for k in filters))
        of.setdefault(place, {})[variant] = one
    axes = [k for k in found[0].columns if k not in filters]
    variants = list(dict.fromkeys(v for some in of.values() for v in some))
    heads = [_head(name, zip(filters, values, strict=True)) for name, *values in variants]
    rows: list[tuple[str, ...]] = []
    for (scenario, *values), some in of.items():
        places = zip(("scenario", *axes), (scenario, *values), strict=True)
        if any(value not in at.get(axis, (value,)) for axis, value in places):
            continue
        for metric in metrics:
            column = metric_column(metric)
            cells = [cell(some.get(v), metric) for v in variants]
            if any(c != "–" for c in cells):
                rows.append((scenario, *map(value_text, values), column.title, *cells))
    return markdown_table(("scenario", *axes, "measure", *heads), rows)


def _head(name: str, values: Iterable[tuple[str, Value | None]]) -> str:
    """Name a variant of a filter: `RAREKF, k 0.25`."""
    return ", ".join([name, *(f"{axis} {value_text(value)}" for axis, value in values if value is not None)])


def about(runs: Sequence[int], failed: int, whole: Design) -> str:
    """How many points and draws there are, of how many of the whole study, and how many estimates failed."""
    least, most = min(runs), max(runs)
    draws, of = f"{least}" if least == most else f"{least} to {most}", len(whole.study.seed_list)
    if len(runs) < len(whole.cells) or least < of:
        points = f"{len(runs)}" if len(runs) == len(whole.cells) else f"{len(runs)} of {len(whole.cells)}"
        text = f"{points} points, {draws} of {of} draws at each"
    else:
        text = f"whole: {len(runs)} points, {of} draws at each"
    return f"({text}; {failed} estimates diverged and are left out)" if failed else f"({text})"


def write(name: str, dataset: Dataset, design: Design, whole: Design, page: Path) -> None:
    """Write a study's CSV, and its part of the page.

    Args:
      design: of the dataset, or with more draws than it has.
      whole: the shipped study.
    """
    found = list(aggregate(dataset))
    runs = [len(dataset.read(cell.index, ["run"])) // len(design.variants) for cell in design.cells]
    fill(page, {f"{name} about": about([n for n in runs if n], sum(one.failed for one in found), whole)})
    rows = (
        {k: f"{v:.{DIGITS}g}" if isinstance(v, float) else v for k, v in row.items()}
        for row in summary_rows(found, design)
    )
    write_rows(page.with_name(f"study_{name}.csv"), list(rows))
    write_page(name, found, design, page)


def write_page(name: str, found: Sequence[Aggregate], design: Design, page: Path) -> None:
    """Write a study's table and figure."""
    fill(page, {name: table(found, design, SHOWN[name], AT.get(name, {}))})
    figures = page.parent / "figures"
    if name in FIGURES:
        scenario, metric = FIGURES[name]
        figure = sweep_figure([one for one in found if one.scenario == scenario], design.study, metric)
        assert figure is not None  # every study measures it
        save(figure, figures / f"study_{name}.png")
    if name == "model_error":
        panels: dict[str, list[plots.Point]] = {}
        for one in found:
            if one.filter in ("RAREKF", "current", "momentum_torsion", "augmented") and one.columns["size"] in (
                0.0,
                1.0,
            ):
                point = (str(one.columns["cause"]), one.filter, one.values["rms"])
                panels.setdefault(one.scenario, []).append(point)
        plots.intervals(figures / f"study_{name}.png", panels, "RMS error [N·m]")


def main(arguments: Sequence[str] = ()) -> None:
    """Run the studies and write the page's tables."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks studies", description=__doc__)
    parser.add_argument("names", nargs="*", default=list(STUDIES), help="of the studies; all by default")
    parser.add_argument("--seeds", type=int, help="how many draws, instead of the study's")
    parser.add_argument("--whole", action="store_true", help="all points of studies that run in part otherwise")
    parser.add_argument("--tables", action="store_true", help="tables and figures from the CSVs; nothing is computed")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--chunk", type=int, help="runs per file")
    parser.add_argument("--out", type=Path, default=Path("runs/studies"), help="folder of the datasets")
    parser.add_argument("--page", type=Path, default=ROOT / "docs" / "studies.md")
    asked = parser.parse_args(arguments)
    if unknown := [name for name in asked.names if name not in STUDIES]:
        parser.error(f"unknown study {unknown[0]!r}: expected any of {', '.join(STUDIES)}")
    for name in asked.names:
        whole = Design.of(*load_study(name))
        if asked.tables:
            found = read_csv(asked.page.with_name(f"study_{name}.csv"), whole.study)
            write_page(name, found, whole, asked.page)
            continue
        study, folder = chosen(name, asked.whole)
        design = Design.of(study, folder)
        fewer = design if asked.seeds is None else Design.of(study.with_seeds(asked.seeds), folder)
        dataset = Dataset.open(asked.out / name, fewer, versions())
        sweep(fewer, dataset, asked.jobs, asked.chunk)
        write(name, dataset, design, whole, asked.page)
        print(name, flush=True)
