"""What a dataset says: means over seeds with confidence intervals, and differences between filters paired over seeds.

Intervals are Student's t at 95 %: `mean ± t(0.975, n − 1)·s/√n`. Runs of different seeds are independent, and the mean of
dozens of them is close to normal whatever a single measure's distribution. A difference between two filters is taken run by
run, on the same signals: what both have in common cancels, and the interval is that of the differences.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ...models.errors import InputError
from ...models.files import write_rows
from ..evaluation.intervals import Interval, interval, paired
from .dataset import Dataset
from .design import Design
from .study import Study, Value


@dataclass(frozen=True)
class Aggregate:
    """What a filter is worth at a point of a study.

    Attributes:
      scenario: its name.
      columns: axis → value, of the plant's and of the filter's axes; of those that vary the reference alone, the variant of the
        reference that it is compared to.
      filter: its name.
      runs, failed: how many there are, and how many of them have no measures (diverged).
      values: metric → mean over seeds.
      differences: metric → mean of this filter less the reference, on the same runs.
    """

    scenario: str
    columns: dict[str, Value | None]
    filter: str
    runs: int
    failed: int
    values: dict[str, Interval]
    differences: dict[str, Interval]


def aggregate(dataset: Dataset) -> Iterator[Aggregate]:
    """What filters are worth in all cells that have rows, one cell in memory at a time.

    A filter stands once beside every variant of the reference that it has to be compared to.
    """
    design = dataset.design
    for cell in design.cells:
        table = dataset.read(cell.index)
        if not table.num_rows:
            continue
        width = len(design.variants)
        failed = np.array([bool(f) for f in table["failure"].to_pylist()]).reshape(-1, width)
        values = {}
        for name in design.study.metrics:
            column = table[name].to_numpy(zero_copy_only=False).astype(np.float64)
            values[name] = column.reshape(-1, width)  # (runs, variants): rows come run by run
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
    """The variants of the reference that the i-th variant is compared to, and where on the filters' axes either stands.

    Those with the same settings of the axes that vary both; of a variant of the reference, itself.
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
    """All aggregates, a row each: for each metric mean, lower and upper end, and the same of the paired difference."""
    axes = list(aggregates[0].columns) if aggregates else []
    metrics = design.study.metrics
    ends = ("mean", "low", "high")
    head = ["scenario", *axes, "filter", "runs", "failed"]
    head += [f"{m}_{e}" for m in metrics for e in ends] + [f"{m}_difference_{e}" for m in metrics for e in ends]

    def cells(found: dict[str, Interval]) -> list[float | None]:
        return [None if m not in found else getattr(found[m], e) for m in metrics for e in ends]

    for s in aggregates:
        at = [s.columns[a] for a in axes]
        row = [s.scenario, *at, s.filter, s.runs, s.failed, *cells(s.values), *cells(s.differences)]
        yield dict(zip(head, row, strict=True))


def read_csv(path: Path, study: Study) -> list[Aggregate]:
    """Aggregates that `write_csv` wrote.

    Raises:
      InputError: a file that is none of this study.
    """

    def cells(row: dict[str, str], kind: str, n: int) -> dict[str, Interval]:
        ends = {m: [row[f"{m}_{kind}{end}"] for end in ("mean", "low", "high")] for m in study.metrics}
        numbers = {m: [float(x or math.nan) for x in three] for m, three in ends.items() if any(three) or not kind}
        return {m: Interval(a, b, c, n) for m, (a, b, c) in numbers.items()}

    def value(text: str) -> Value | None:
        try:
            return float(text) if text else None
        except ValueError:
            return text

    found = []
    try:
        with path.open(newline="", encoding="utf-8") as file:
            for row in csv.DictReader(file):
                if None in row or None in row.values():
                    raise ValueError("a row that is shorter or longer than the header")
                head = list(row)
                axes = head[1 : head.index("filter")]
                runs, failed = int(row["runs"]), int(row["failed"])
                values, differences = cells(row, "", runs - failed), cells(row, "difference_", runs - failed)
                at = {axis: value(row[axis]) for axis in axes}
                found.append(Aggregate(row["scenario"], at, row["filter"], runs, failed, values, differences))
    except (OSError, ValueError, KeyError) as error:
        raise InputError(f"{path}: expected the summary of a sweep of {study.name}, got something else") from error
    if not found:
        raise InputError(f"{path}: expected a summary with rows, got none; the sweep has not begun")
    return found


def write_csv(aggregates: list[Aggregate], design: Design, path: Path, digits: int | None = None) -> None:
    """`summary_rows` as CSV; `digits`: of its numbers, all of them by default."""

    def text(value: Any) -> Any:
        return f"{value:.{digits}g}" if digits is not None and isinstance(value, float) else value

    rows = [{key: text(value) for key, value in row.items()} for row in summary_rows(aggregates, design)]
    write_rows(path, rows)
