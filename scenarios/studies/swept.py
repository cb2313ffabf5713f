"""A study's dataset with its statistics, and its worst runs, as scenarios to run again."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ...models.files import parse
from ...models.notebook import shortened
from ..scenario import Scenario
from .dataset import Dataset
from .design import Design
from .statistics import Aggregate, aggregate, summary_rows
from .study import Study, load_study, shipped_studies
from .sweep import versions

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True)
class WorstRun:
    """The run with the largest value of a metric in a scenario."""

    scenario: str  # its name in the study
    filter: str  # its name
    seed: int  # of the study
    value: float  # of the metric
    again: Scenario | None  # the scenario to run again; None if the plant's parameters were drawn


@dataclass(frozen=True)
class Swept:
    """A study's dataset with its statistics.

    Attributes:
      dataset: rows in `dataset.folder`.
      aggregates: means over seeds with 95 % intervals, a filter at a point of the study each.
      worst: the run with the largest value of the first metric, of every scenario.
    """

    dataset: Dataset
    aggregates: tuple[Aggregate, ...]
    worst: tuple[WorstRun, ...]

    @property
    def study(self) -> Study:
        """The study."""
        return self.dataset.design.study

    @property
    def folder(self) -> Path:
        """Folder of the dataset; `rows` in it is partitioned Parquet."""
        return self.dataset.folder

    @property
    def failed(self) -> int:
        """Number of estimates without metrics."""
        return sum(one.failed for one in self.aggregates)

    def table(self) -> pd.DataFrame:
        """Return the content of `summary.csv`, a row per aggregate: mean, low and high end of each metric in its unit, and of
        its differences to the reference filter on the same runs; NaN if undefined."""
        import pandas as pd

        return pd.DataFrame(list(summary_rows(list(self.aggregates), self.dataset.design)))

    def __repr__(self) -> str:
        metric = self.study.metrics[0]

        def line(one: Aggregate) -> str:
            point = ", ".join([one.scenario, *(f"{k}={v}" for k, v in one.columns.items() if v is not None)])
            return f"  {point}, {one.filter}: {one.values[metric].mean:.4g}"

        head = f"Swept({self.study.name!r} in {self.folder}, {self.dataset.design.runs} runs; mean {metric}:"
        return shortened(head, [line(one) for one in self.aggregates], most=6)


def open_study(source: str | Path | Mapping[str, Any], out: Path, seeds: int | None = None) -> Dataset:
    """Load a study (a shipped name, a YAML file, or its content), and make its dataset in a folder or continue it;
    `seeds`: their number, instead of the study's. Raises `InputError`: a wrong study, or a folder with other content.
    """
    if isinstance(source, Mapping):
        study, folder, place = parse(dict(source), Study, "study"), Path(), ""
    else:
        study, folder = load_study(source)
        shipped = str(source) in shipped_studies()
        place = str(source) if shipped else Path(os.path.relpath(Path(source).resolve(), out.resolve())).as_posix()
    if seeds is not None:
        study = study.with_seeds(seeds)
    return Dataset.open(out, Design.of(study, folder), versions(), place)


def summarise(dataset: Dataset) -> Swept:
    """Compute the statistics of a dataset, and its worst runs."""
    found = tuple(aggregate(dataset))
    return Swept(dataset, found, tuple(worst_runs(dataset, dataset.design.study.metrics[0])))


def worst_runs(dataset: Dataset, metric: str) -> list[WorstRun]:
    """Return for every scenario of a dataset the run with the largest value of a metric."""
    design = dataset.design
    worst: dict[str, tuple[float, int, int, str]] = {}
    for cell in design.cells:
        table = dataset.read(cell.index, ["run", "seed", "filter", metric])
        values = table[metric].to_numpy(zero_copy_only=False).astype(float) if table.num_rows else np.zeros(0)
        if not np.isfinite(values).any():
            continue
        i = int(np.nanargmax(values))
        if values[i] > worst.get(cell.scenario, (-np.inf,))[0]:
            worst[cell.scenario] = (float(values[i]), cell.index, table["seed"][i].as_py(), table["filter"][i].as_py())
    found = []
    for name, (value, index, seed, label) in worst.items():
        cell = design.cells[index]
        experiment, record = design.drawn(cell, seed, design.experiment(cell))
        again = None
        if record is None:
            update = {"name": f"{name}-{seed}", "mounting": "", "link": experiment.mounting}
            again = experiment.scenario.model_copy(update=update)
        found.append(WorstRun(name, label, seed, value, again))
    return found
