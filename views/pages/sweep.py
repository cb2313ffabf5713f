"""The page of a study: the best filter by scenario and settings, with intervals, and charts."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np

from ...models.command_lines import command_line
from ..numbers import number
from ..sweep_tables import cell, metric_column, panels_of, sign_of, sweep_rows, value_text
from .chart import WIDTH, Chart, limits
from .rendering import render
from .run import line_kinds

if TYPE_CHECKING:
    from ...scenarios.studies.statistics import Aggregate
    from ...scenarios.studies.study import Study

Values = Mapping[str, Mapping[str, tuple[np.ndarray, np.ndarray]]]
"""Scenario → filter → a metric of all runs, ascending, and their seeds, shape (n,) each."""
_SHOWN = 12  # charts at most
_WORST = 3  # seeds


def sweep_html(
    study: Study,
    found: Sequence[Aggregate],
    versions: dict[str, str],
    digest: str,
    folder: Path,
    source: str = "",
    worst: Sequence[Path] = (),
    values: Values = MappingProxyType({}),
) -> str:
    """Return the page as text, one file without references to others.

    Args:
      versions, digest: of the packages, and of the study.
      source: name or path of the study for `flexspline sweep`; empty if unknown.
      worst: files of the run with the largest first metric of each scenario.
      values: of the first metric.
    """
    kinds = line_kinds(study.names)
    metric = study.metrics[0]
    titles = {axis.name: axis.title for axis in study.axes}
    listed = isinstance(study.seeds, list)
    more = () if listed else ("--seeds", 2 * max(s.runs for s in found))
    context = {
        "study": study,
        "sentence": _verdict(study, found),
        "best": _best(study, found),
        "against": _against(study, found),
        "runs": sorted({s.runs for s in found}),
        "rows": len(found),
        "failed": [(s.filter, s.scenario, s.failed, s.runs) for s in found if s.failed],
        "column": metric_column(metric),
        "entries": [(kinds[name], name) for name in study.names],
        "spread": _spread(values, metric, kinds),
        "largest": _largest(values, metric),
        "charts": _charts(study, found, metric, kinds),
        "tables": [_table(study, found, m) for m in study.metrics],
        "axes": [titles.get(name, name) for name in found[0].columns],
        "commands": [command_line("sweep", source or f"{study.name}.yaml", *more, "--out", folder)],
        "worst": [command_line("run", path) for path in worst],
        "listed": listed,
        "unknown": not source,
        "folder": str(folder),
        "versions": versions,
        "digest": digest,
    }
    return render("sweep.html.j2", context)


def _best(study: Study, found: Sequence[Aggregate]) -> list[tuple[str, int]]:
    """Number of scenarios and points at which each filter has the lowest mean of the first metric, the most first."""
    counts = dict.fromkeys(study.names, 0)
    for _, _, of in sweep_rows(found):
        means = {
            n: s.values[study.metrics[0]].mean for n, s in of.items() if math.isfinite(s.values[study.metrics[0]].mean)
        }
        if means:
            counts[min(means, key=lambda n: means[n])] += 1
    return sorted(((n, c) for n, c in counts.items() if c), key=lambda one: -one[1])


def _against(study: Study, found: Sequence[Aggregate]) -> list[tuple[str, int, int, int]]:
    """For every filter except the reference: number of rows with a surely lower, a surely higher, and an equal first metric."""
    signs: dict[str, list[int]] = {name: [] for name in study.names if name != study.compared_to}
    for _, _, of in sweep_rows(found):
        for name in signs.keys() & of.keys():
            signs[name].append(sign_of(of[name], study.metrics[0]))
    return [(name, own.count(-1), own.count(1), own.count(0)) for name, own in signs.items()]


def _verdict(study: Study, found: Sequence[Aggregate]) -> str:
    column, best = metric_column(study.metrics[0]), _best(study, found)
    total = sum(count for _, count in best)
    if not best:
        return "No filter has a metric."
    name, count = best[0]
    what = f"the lowest {column.heading}"
    return f"{name} has {what} in {'all' if count == total else f'{count} of'} {total} combinations of scenario and settings."


def _table(study: Study, found: Sequence[Aggregate], metric: str) -> dict[str, Any]:
    column = metric_column(metric)
    rows = []
    for scenario, columns, of in sweep_rows(found):
        at = [value_text(columns[axis]) for axis in found[0].columns]
        cells = [(cell(of.get(name), metric), sign_of(of.get(name), metric)) for name in study.names]
        rows.append((scenario, at, cells))
    return {"title": column.title, "meaning": column.meaning, "rows": rows}


def _spread(values: Values, metric: str, kinds: dict[str, str]) -> list[list[Chart]]:
    """Charts of the distribution of a metric over seeds and settings: the share of the runs with at most this value."""
    column, charts = metric_column(metric), []
    for scenario, of in values.items():
        x = limits(np.append(column.scale * np.concatenate([v for v, _ in of.values()]), 0.0), 0.0)
        chart = Chart(x, (0.0, 105.0), scenario, column.title, "runs [%]", width=WIDTH, height=260)
        for name, (found, _) in of.items():
            share = 100 * np.arange(len(found) + 1) / max(len(found), 1)
            chart.line(np.repeat(column.scale * found, 2), np.repeat(share, 2)[1:-1], kinds[name])
        charts.append([chart])
    return charts[:_SHOWN]


def _largest(values: Values, metric: str) -> list[tuple[str, str, list[str]]]:
    """Scenario, filter, and median, 95 % quantile, maximum and the seeds with the largest values of a metric."""
    column = metric_column(metric)
    return [
        (scenario, name, [
            *(number(column.scale * float(x), 3) for x in (np.median(v), np.quantile(v, 0.95), v[-1])),
            ", ".join(map(str, list(dict.fromkeys(seeds[::-1].tolist()))[:_WORST])),
        ])
        for scenario, of in values.items() for name, (v, seeds) in of.items() if len(v)
    ]  # fmt: skip


def _charts(study: Study, found: Sequence[Aggregate], metric: str, kinds: dict[str, str]) -> list[list[Chart]]:
    """Charts of the metric over one axis, one for every scenario and point of the other axes, with 95 % intervals."""
    column = metric_column(metric)
    titles = {axis.name: axis.title for axis in study.axes}
    charts = []
    for scenario in dict.fromkeys(s.scenario for s in found):
        across, places, panels = panels_of([s for s in found if s.scenario == scenario], study, metric)
        labels = tuple((float(k), value_text(v)) for k, v in enumerate(places))
        for panel in panels:
            if not panel.lines:
                continue
            ends = np.concatenate([(mean - half, mean + half) for _, mean, half in panel.lines.values()], axis=None)
            x_limits, y_limits = (-0.5, len(places) - 0.5), limits(np.append(ends, 0.0), 0.0)
            title = ", ".join([scenario, *(f"{titles.get(a, a)} {value_text(v)}" for a, v in panel.at.items())])
            of = titles.get(across, ""), column.title
            chart = Chart(x_limits, y_limits, title, *of, labels=labels, width=WIDTH, height=260)
            for name, (x, mean, half) in panel.lines.items():
                chart.line(x, mean, kinds[name])
                chart.dots(x, mean, f"{kinds[name]} small")
                for a, b, h in zip(x, mean, half, strict=True):
                    chart.line(np.array([a, a]), np.array([b - h, b + h]), f"{kinds[name]} whisker spread")
            charts.append([chart])
    return charts[:_SHOWN]
