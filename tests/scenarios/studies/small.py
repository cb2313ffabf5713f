"""A small study and what tests compare of it."""

from __future__ import annotations

from pathlib import Path

import pyarrow as pa

from flexspline.scenarios.studies.dataset import Dataset
from flexspline.scenarios.studies.design import Design
from flexspline.scenarios.studies.study import Study
from flexspline.scenarios.studies.sweep import sweep, versions

SECONDS = 1.5


def study(**changes) -> Study:
    """One and a half seconds of two scenarios, two axes of the plant, three seeds."""
    data = {
        "name": "small",
        "seeds": {"first": 4, "count": 3},
        "scenarios": ["link_sweep", "no_load"],
        "set": {"duration": SECONDS, "transient": 0.5},
        "axes": [{"kind": "scale", "name": "level", "keys": {"sensors.link_encoder.noise": 1e-6}, "values": [1, 8]}],
        "filters": ["EKF", "RAREKF", "current"],
    } | changes
    return Study.model_validate(data)


def run(folder: Path, asked: Study | None = None, home: Path = Path(), **how) -> Dataset:
    """Sweep a study into a folder."""
    design = Design.of(asked or study(), home)
    dataset = Dataset.open(folder, design, versions())
    sweep(design, dataset, **how)
    return dataset


def rows(dataset: Dataset) -> pa.Table:
    """All rows in order of the grid, without the files' notes."""
    tables = [
        dataset.read(cell.index).append_column("cell", pa.array([cell.index] * dataset.read(cell.index).num_rows))
        for cell in dataset.design.cells
    ]
    return pa.concat_tables(t for t in tables if t.num_rows).combine_chunks().replace_schema_metadata(None)


def same(a: Dataset, b: Dataset) -> bool:
    """Whether all rows are the same to the bit."""
    return rows(a).equals(rows(b))


def column(dataset: Dataset, cell: int, filter: str, metric: str) -> list[float]:
    """A metric of a filter in a cell, by seed."""
    return [r[metric] for r in dataset.read(cell).to_pylist() if r["filter"] == filter]
