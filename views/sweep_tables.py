"""A study's aggregates as tables: means with confidence intervals, and marks of differences from the reference."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from rich.console import Console, ConsoleOptions, RenderResult
from rich.measure import Measurement
from rich.table import Table
from rich.text import Text

from .style import filter_colors
from .tables import COLUMNS, Column, markdown_table, narrow_table

if TYPE_CHECKING:
    from ..scenarios.studies.statistics import Aggregate, Interval
    from ..scenarios.studies.study import Study, Value

BETTER, WORSE = "▾", "▴"
"""Marks of a mean below or above the reference's: the interval of the paired difference excludes zero."""
_SPREAD = 0.3  # of the distance between two points: offset of filters
_UNLIMITED = 10_000  # characters: width without limit
_BEYOND_RUNS = (
    Column("noise", "noise", "N·m", 1, 4, "of the error, faster than 0.2 s, in steady state"),
    Column(
        "untrusted", "not to be trusted", "%", 100, 0, "share of the runs in which the estimate is not to be trusted"
    ),
)
"""Metrics of studies that are not in tables of runs."""


def metric_column(metric: str) -> Column:
    """Return heading, unit and scale of a metric."""
    return next(c for c in (*_BEYOND_RUNS, *COLUMNS) if c.key == metric)


def with_interval(value: Interval, scale: float = 1.0) -> str:
    """Return `0.1452 ± 0.0003`: one digit of the interval, or two if the first is 1; `–` without a mean.

    An interval below the fourth digit of the mean is omitted. A mean that would be rounded to 0 gets one more digit.
    """
    if not math.isfinite(value.mean):
        return "–"
    mean, half = scale * value.mean, scale * value.half
    if not math.isfinite(half) or half <= 5e-4 * abs(mean):
        return f"{mean:.4g}"
    decimals = -math.floor(math.log10(half))
    if round(half * 10**decimals) == 1 or (mean != 0.0 and round(mean * 10**decimals) == 0):
        decimals += 1
    if decimals < 0:
        return f"{mean:.0f} ± {half:.0f}"
    return f"{mean:.{decimals}f} ± {half:.{decimals}f}"


def sweep_rows(aggregates: Sequence[Aggregate]) -> Iterator[tuple[str, dict, dict[str, Aggregate]]]:
    """Yield rows: scenario, point of the axes, filter → summary. A filter that an axis does not vary is in all its rows."""
    whole = [s for s in aggregates if None not in s.columns.values()] or list(aggregates)
    points: dict[tuple, Aggregate] = {}
    for s in whole:
        points.setdefault((s.scenario, *s.columns.values()), s)
    for s in points.values():
        here = (o for o in aggregates if o.scenario == s.scenario)
        at = {o.filter: o for o in here if all(v is None or v == s.columns[k] for k, v in o.columns.items())}
        yield s.scenario, s.columns, at


class FirstThatFits:
    """The first of several tables that fits into the terminal, or else the last."""

    def __init__(self, *tables: Table):
        self.tables = tables

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        for table in self.tables[:-1]:
            if Measurement.get(console, options.update(max_width=_UNLIMITED), table).maximum <= options.max_width:
                yield table
                return
        yield self.tables[-1]


def sweep_table(aggregates: Sequence[Aggregate], study: Study, metric: str) -> FirstThatFits:
    """Return one metric for the terminal: a column per filter, or a row per filter if that is too wide."""
    return FirstThatFits(_wide(aggregates, study, metric), _long(aggregates, study, metric))


def _empty(aggregates: Sequence[Aggregate], study: Study, metric: str) -> Table:
    column = metric_column(metric)
    table = narrow_table(
        f"{study.name}: {column.title}, {column.meaning}",
        f"mean ± 95 % interval over seeds (Student's t), no ± where it is below the digits shown; {BETTER} below, "
        f"{WORSE} above {study.compared_to}: paired over seeds, 95 %",
    )
    for name in ("scenario", *aggregates[0].columns):
        table.add_column(Text(name), justify="left" if name in ("scenario", "cause") else "right", overflow="fold")
    return table


def _wide(aggregates: Sequence[Aggregate], study: Study, metric: str) -> Table:
    table, colors = _empty(aggregates, study, metric), filter_colors(study.names)
    for name in study.names:
        table.add_column(Text(name, style=colors[name]), justify="right", no_wrap=True)
    before = None
    for scenario, columns, of in sweep_rows(aggregates):
        if before not in (None, scenario):
            table.add_section()
        cells = [_colored(of.get(name), metric) for name in study.names]
        at = (Text(value_text(value)) for value in columns.values())
        table.add_row(Text(scenario if before != scenario else ""), *at, *cells)
        before = scenario
    return table


def _long(aggregates: Sequence[Aggregate], study: Study, metric: str) -> Table:
    table, colors = _empty(aggregates, study, metric), filter_colors(study.names)
    table.add_column("filter", overflow="fold")
    table.add_column(Text(metric_column(metric).title), justify="right", no_wrap=True)
    for scenario, columns, of in sweep_rows(aggregates):
        place = [Text(scenario), *(Text(value_text(value)) for value in columns.values())]
        for i, name in enumerate(study.names):
            first = place if i == 0 else [Text("")] * len(place)
            table.add_row(
                *first,
                Text(name, style=colors[name]),
                _colored(of.get(name), metric),
                end_section=i + 1 == len(study.names),
            )
    return table


def sweep_markdown(aggregates: Sequence[Aggregate], study: Study) -> str:
    """Return all metrics as Markdown, a table each."""
    axes = list(aggregates[0].columns)
    runs = sorted({s.runs for s in aggregates})
    lines = [
        f"# {study.name}",
        "",
        study.description,
        "",
        f"Means over {'–'.join(str(n) for n in dict.fromkeys((runs[0], runs[-1])))} seeds with 95 % intervals (Student's t), "
        "no ± where it is below the digits shown. "
        f"{BETTER} lower, {WORSE} higher than {study.compared_to}: the 95 % interval of the difference, paired over seeds, "
        "excludes zero. `summary.csv` has the differences.",
        "",
    ]
    failed = [s for s in aggregates if s.failed]
    for s in failed:
        at = ", ".join(f"{k} {value_text(v)}" for k, v in s.columns.items() if v is not None)
        lines += [
            f"{s.scenario}, {at}: {s.filter} has no estimate in {s.failed} of {s.runs} runs, which are not counted.",
            "",
        ]
    for metric in study.metrics:
        column = metric_column(metric)
        lines += [f"## {column.title}", "", f"{column.meaning[0].upper()}{column.meaning[1:]}.", ""]
        rows = [
            (scenario, *(value_text(columns[a]) for a in axes), *(cell(of.get(n), metric) for n in study.names))
            for scenario, columns, of in sweep_rows(aggregates)
        ]
        lines += [markdown_table(("scenario", *axes, *study.names), rows), ""]
    return "\n".join(lines)


def cell(summary: Aggregate | None, metric: str) -> str:
    """Return mean, interval and mark of a metric as text."""
    if summary is None:
        return "–"
    text = with_interval(summary.values[metric], metric_column(metric).scale)
    return f"{text} {(' ', WORSE, BETTER)[sign_of(summary, metric)]}".rstrip()


def sign_of(summary: Aggregate | None, metric: str) -> int:
    """Return −1 or 1 if the difference from the reference is surely below or above zero, else 0."""
    return summary.differences[metric].sign if summary is not None and metric in summary.differences else 0


def _colored(summary: Aggregate | None, metric: str) -> Text:
    return Text(cell(summary, metric), style=("", "red", "green")[sign_of(summary, metric)])


def value_text(value: float | str | None) -> str:
    """Return a value of an axis as text."""
    return "–" if value is None else value if isinstance(value, str) else f"{value:g}"


@dataclass(frozen=True)
class Panel:
    """A point of the axes that are not horizontal, with a line for every filter."""

    at: dict[str, Value]  # axis → value
    # filter → horizontal positions, means, half intervals, shape (3, k), in the unit of the metric's column
    lines: dict[str, np.ndarray]


def panels_of(
    aggregates: Sequence[Aggregate], study: Study, metric: str, differences: bool = False
) -> tuple[str, list[Value | None], list[Panel]]:
    """Return the horizontal axis, its values, and the panels of a metric of one scenario, or of its differences from
    the reference."""
    across, points = layout(aggregates, study)
    values = [v for v in dict.fromkeys(s.columns.get(across) for s in aggregates) if v is not None]
    places: list[Value | None] = [*values] or [None]
    scale = metric_column(metric).scale
    names = [name for name in study.names if not (differences and name == study.compared_to)]
    panels = []
    for at in points:
        lines = {}
        for i, name in enumerate(names):
            offset = _SPREAD * (i - 0.5 * (len(names) - 1)) / max(len(names), 2)
            found = []
            for k, value in enumerate(places):
                s = place_of(aggregates, name, across, value, at)
                one = (s.differences if differences else s.values).get(metric) if s is not None else None
                if one is not None and math.isfinite(one.mean):
                    found.append((k + offset, scale * one.mean, scale * np.nan_to_num(one.half)))
            if found:
                lines[name] = np.array(found).T
        panels.append(Panel(at, lines))
    return across, places, panels


def layout(aggregates: Sequence[Aggregate], study: Study) -> tuple[str, list[dict[str, Value]]]:
    """Return the horizontal axis, and the values of the others, a panel each.

    Sizes of causes are horizontal, causes have panels. The first axis of filters is horizontal. The point without a cause is the
    first of every cause's line.
    """
    axes = list(aggregates[0].columns)
    if not axes:
        return "", [{}]
    of_filters = next((axis.name for axis in study.filter_axes), axes[0])
    across = axes[axes.index("cause") + 1] if "cause" in axes else of_filters
    others = [a for a in axes if a != across]
    values = {a: [v for v in dict.fromkeys(s.columns[a] for s in aggregates) if v is not None] for a in others}
    if len(values.get("cause", [])) > 1:
        values["cause"] = [v for v in values["cause"] if v != "none"]
    return across, [dict(zip(others, at, strict=True)) for at in itertools.product(*values.values())]


def place_of(
    aggregates: Sequence[Aggregate], name: str, across: str, value: Value | None, panel: dict[str, Value]
) -> Aggregate | None:
    """Return a filter's summary at a point of a panel; a filter that an axis does not vary is the same at all its points."""

    def there(s: Aggregate, axis: str, wanted: Value | None) -> bool:
        return s.columns.get(axis) in (wanted, None) or (axis == "cause" and s.columns["cause"] == "none")

    at = {across: value} | panel
    return next((s for s in aggregates if s.filter == name and all(there(s, *one) for one in at.items())), None)
