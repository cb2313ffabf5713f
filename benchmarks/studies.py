"""The shipped studies, smaller: `python -m benchmarks studies` writes the tables of docs/studies.md.

Whole, they take hours of a core. Here every study has 30 seeds and some values of its own axes (`REDUCED`), which the page
names. The datasets are kept (`--out`): interrupted, the same command goes on.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from flexspline.scenarios.studies.dataset import Dataset
from flexspline.scenarios.studies.design import Design
from flexspline.scenarios.studies.statistics import aggregate
from flexspline.scenarios.studies.study import Study, load_study
from flexspline.scenarios.studies.sweep import sweep, versions
from flexspline.views.limit_tables import markdown
from flexspline.views.sweep_tables import cell, metric_column, sweep_rows, value_text

from .estimators import ROOT, fill

REDUCED: dict[str, dict[str, Any]] = {
    "load_dependent_alpha": {"axes": {"noise_level": {"values": [1]}, "load": {"values": [4, 12]}}},
    "noise_and_load": {"axes": {"noise_level": {"values": [1, 10]}, "load": {"values": [3, 12]}}},
    "model_error": {
        "scenarios": ["link_sweep"],
        "filters": ["EKF", "AREKF", "RAREKF", "REKF", "current", "momentum"],
        "axes": {
            "cause": {
                "causes": ["stiffness", "kinematic_error", "mesh_friction", "gravity_moment"],
                "sizes": [1],
            }
        },
    },
}
"""What of each study runs: keys that take other values, and of its axes, by name or kind."""
SHOWN = ("rms", "response_ms", "robust_share")
"""Measures of the page's tables, as far as a study has them."""


def reduced(name: str, seeds: int) -> tuple[Study, Path]:
    """A shipped study with fewer values on its axes, and its folder."""
    whole, folder = load_study(name)
    data, change = whole.model_dump(mode="json", exclude_none=True), REDUCED[name]
    for axis in data["axes"]:
        axis.update(change["axes"].get(axis.get("name") or axis["kind"], change["axes"].get(axis["kind"], {})))
    data.update({key: value for key, value in change.items() if key != "axes"})
    return Study.model_validate(data).with_seeds(seeds), folder


def table(study: Study, folder: Path, out: Path, jobs: int) -> str:
    """A study's measures: one table, a row for each point and measure."""
    design = Design.of(study, folder)
    dataset = Dataset.open(out, design, versions())
    sweep(design, dataset, jobs, None, None, lambda runs: None)
    rows: list[tuple[str, ...]] = []
    axes: list[str] = []
    for scenario, columns, of in sweep_rows(list(aggregate(dataset))):
        axes = list(columns)
        for metric in (m for m in SHOWN if m in study.metrics):
            column = metric_column(metric)
            cells = [cell(of.get(name), metric, column) for name in study.names]
            if any(c.strip() not in ("–", "") for c in cells):
                rows.append((scenario, *(value_text(columns[a]) for a in axes), column.title, *cells))
    return markdown(("scenario", *axes, "measure", *study.names), rows)


def main(arguments: Sequence[str] = ()) -> None:
    """Run the studies and write the page's tables."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.studies", description=__doc__)
    parser.add_argument("names", nargs="*", default=list(REDUCED), help="of the studies; all by default")
    parser.add_argument("--seeds", type=int, default=30)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--out", type=Path, default=Path("runs/studies"), help="folder of the datasets")
    parser.add_argument("--page", type=Path, default=ROOT / "docs" / "studies.md")
    asked = parser.parse_args(arguments)
    for name in asked.names:
        study, folder = reduced(name, asked.seeds)
        fill(asked.page, {name: table(study, folder, asked.out / name, asked.jobs)})
        print(name, flush=True)


if __name__ == "__main__":
    import sys

    main(sys.argv[1:])
