"""Statistics of a dataset: means over seeds with confidence intervals, differences between filters paired over seeds, and the
worst runs, as scenarios to run again.

Intervals are Student's t at 95 %: `mean ± t(0.975, n − 1)·s/√n`. Runs of different seeds are independent, and the mean of dozens
of them is nearly normal. A difference between two filters is computed run by run on the same signals, so that common variation
cancels.
"""

from __future__ import annotations

import math
import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ...models.errors import InputError
from ...models.files import parse, write_rows
from ...models.notebook import shortened
from ..evaluation.intervals import Interval, interval, paired
from ..scenario import Scenario
from .dataset import Dataset
from .design import Design
from .study import Study, Value, load_study, shipped_studies
from .sweep import versions

if TYPE_CHECKING:
    import pandas as pd

_ENDS = ("mean", "low", "high")


@dataclass(frozen=True)
class Aggregate:
    """The metrics of a filter at a point of a study."""

    scenario: str  # its name
    # axis → value, of the plant's and of the filter's axes; of axes that vary the reference only, the value of the
    # reference that it is compared with
    columns: dict[str, Value | None]
    filter: str  # its name
    # runs, failed: number of runs, and of those without metrics (diverged)
    runs: int
    failed: int
    values: dict[str, Interval]  # metric → mean over seeds
    differences: dict[str, Interval]  # metric → mean of this filter minus the reference, on the same runs


def aggregate(dataset: Dataset) -> Iterator[Aggregate]:
    """Yield the metrics of all filters in all cells that have rows, one cell in memory at a time.

    A filter occurs once for every variant of the reference that it is compared with.
    """
    design = dataset.design
    for cell in design.cells:
        table = dataset.read(cell.index)
        if not table.num_rows:
            continue
        width = len(design.variants)
        failed = np.array([bool(f) for f in table["failure"].to_pylist()]).reshape(-1, width)
        values = {  # (runs, variants): rows are sorted by run
            name: table[name].to_numpy(zero_copy_only=False).astype(np.float64).reshape(-1, width)
            for name in design.study.metrics
        }
        for i, variant in enumerate(design.variants):
            for other, columns in counterparts(design, i):
                yield Aggregate(
                    cell.scenario,
                    {**cell.columns, **{a.name: columns.get(a.name) for a in design.study.filter_axes}},
                    variant.name,
                    len(failed),
                    int(failed[:, i].sum()),
                    {name: interval(v[:, i]) for name, v in values.items()},
                    {name: paired(v[:, i], v[:, other]) for name, v in values.items()} if other != i else {},
                )


def counterparts(design: Design, i: int) -> list[tuple[int, dict[str, Value]]]:
    """Return the variants of the reference that the i-th variant is compared with, and their values of the filters' axes.

    They have the same settings of axes that vary both. A variant of the reference is its own counterpart.
    """
    own = design.variants[i]
    if own.name == design.study.compared_to:
        return [(i, own.columns)]
    return [
        (j, {**other.columns, **own.columns})
        for j, other in enumerate(design.variants)
        if other.name == design.study.compared_to
        and all(own.columns.get(k, value) == value for k, value in other.columns.items())
    ]


def summary_rows(aggregates: list[Aggregate], design: Design) -> Iterator[dict[str, Any]]:
    """Yield a row per aggregate: mean, lower and upper end of each metric, and of each paired difference."""

    def cells(found: dict[str, Interval], kind: str) -> dict[str, float | None]:
        return {
            f"{m}_{kind}{e}": None if m not in found else getattr(found[m], e)
            for m in design.study.metrics
            for e in _ENDS
        }

    for s in aggregates:
        head = {"scenario": s.scenario, **s.columns, "filter": s.filter, "runs": s.runs, "failed": s.failed}
        yield head | cells(s.values, "") | cells(s.differences, "difference_")


def write_csv(aggregates: list[Aggregate], design: Design, path: Path) -> None:
    """Write `summary_rows` as CSV."""
    write_rows(path, list(summary_rows(aggregates, design)))


def read_csv(path: Path, study: Study) -> list[Aggregate]:
    """Read the aggregates of `write_csv`. Raises `InputError`: a file with other content."""
    import pandas as pd

    def cells(row: dict[Any, Any], kind: str, n: int) -> dict[str, Interval]:
        ends = {m: [float(row[f"{m}_{kind}{end}"]) for end in _ENDS] for m in study.metrics}
        return {m: Interval(e[0], e[1], e[2], n) for m, e in ends.items() if not kind or not all(map(math.isnan, e))}

    found = []
    try:
        table = pd.read_csv(path, dtype=str, keep_default_na=False, na_values=[""], engine="python").fillna(math.nan)
        if not isinstance(table.index, pd.RangeIndex):
            raise ValueError("a row that is longer than the header")
        axes = list(table.columns)[1 : list(table.columns).index("filter")]
        for row in table.to_dict("records"):
            runs, failed = int(row["runs"]), int(row["failed"])
            at = {axis: None if pd.isna(row[axis]) else _value(row[axis]) for axis in axes}
            values, differences = cells(row, "", runs - failed), cells(row, "difference_", runs - failed)
            found.append(Aggregate(row["scenario"], at, row["filter"], runs, failed, values, differences))
    except (OSError, ValueError, KeyError) as error:
        raise InputError(f"{path}: expected the summary of a sweep of {study.name}, got something else") from error
    if not found:
        raise InputError(f"{path}: expected a summary with rows, got none; the sweep has not begun")
    if foreign := {s.filter for s in found} - set(study.names):
        raise InputError(f"{path}: filter: expected one of {', '.join(study.names)}, got {min(foreign)!r}")
    return found


def _value(value: Any) -> Value:
    try:
        return float(value)
    except ValueError:
        return str(value)


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
