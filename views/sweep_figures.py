"""Figures of a study: a metric against an axis, a panel for every value of the others, confidence intervals on all points.

For each scenario and metric two figures: the means, and the differences to the reference filter, paired over seeds.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from .figures.sheet import RIGHT, WIDTH, blank, place, save, styled
from .style import filter_colors
from .sweep_tables import metric_column, panels_of

if TYPE_CHECKING:
    from ..scenarios.studies.statistics import Aggregate
    from ..scenarios.studies.study import Study, Value

_COLUMNS = 4
_HEIGHT, _GAP = 2.2, 0.5  # in: of a row of panels, of it between them
_LEFT, _BETWEEN = 0.85, 0.14  # in
_LEGEND = 8  # filters in a line of the legend
_LOGARITHMIC = 15.0  # ratio of largest and smallest mean above which an axis is logarithmic
_LINEAR = 1e-3  # of the largest difference: the axis is linear below
_LOOK: dict[str, Any] = {"marker": "o", "ms": 3, "lw": 1.0, "elinewidth": 1.4, "capsize": 2.5}
_CHARACTERS = 80  # of horizontal ticks in a row of panels


def save_sweep_figures(aggregates: Sequence[Aggregate], study: Study, folder: Path) -> list[Path]:
    """Write all figures of a study as PNG; return their paths."""
    paths = []
    for scenario in dict.fromkeys(s.scenario for s in aggregates):
        here = [s for s in aggregates if s.scenario == scenario]
        for metric, differences in itertools.product(study.metrics, (False, True)):
            figure = sweep_figure(here, study, metric, differences)
            if figure is not None:
                paths.append(save(figure, folder / f"{scenario}_{metric}{'_difference' if differences else ''}.png"))
    return paths


@styled
def sweep_figure(
    aggregates: Sequence[Aggregate], study: Study, metric: str, differences: bool = False
) -> Figure | None:
    """Draw a metric of one scenario, or its paired differences from the reference; None if it has no values. The
    study's axes give the panels."""
    column = metric_column(metric)
    across, places, panels = panels_of(aggregates, study, metric, differences)
    names = [n for n in study.names if not (differences and n == study.compared_to)]
    if not names or not any(panel.lines for panel in panels):
        return None
    titles = {axis.name: axis.title for axis in study.axes}
    rows = math.ceil(len(panels) / _COLUMNS)
    columns = math.ceil(len(panels) / rows)
    what = f"difference to {study.compared_to}, paired over seeds" if differences else column.meaning
    runs = sorted({s.runs for s in aggregates})
    caption = (
        f"{study.name}, {aggregates[0].scenario}. {column.heading}: {what}; means over "
        f"{'–'.join(map(str, dict.fromkeys((runs[0], runs[-1]))))} seeds with 95 % intervals (Student's t)."
    )
    ticks = [_tick(v) for v in places]
    slanted = sum(map(len, ticks)) > _CHARACTERS / columns
    lines = -(-len(names) // _LEGEND)
    above = 0.55 + 0.18 * lines + 0.25 * max(len(panel.at) for panel in panels)
    foot = 0.6 + (0.075 * max(map(len, ticks)) if slanted else 0.0)
    figure = blank(f"{column.title}  ·  {aggregates[0].scenario}", caption, above + _HEIGHT * rows - _GAP + foot)
    width = (WIDTH - _LEFT - RIGHT - _BETWEEN * (columns - 1)) / columns
    grid: list[Axes] = []
    for k in range(len(panels)):
        row, across_ = divmod(k, columns)
        first = grid[0] if grid else None
        left = _LEFT + across_ * (width + _BETWEEN)
        grid.append(place(figure, left, above + row * _HEIGHT, width, _HEIGHT - _GAP, first, first))
        grid[-1].tick_params(labelleft=across_ == 0, labelbottom=k + columns >= len(panels))
    colors = filter_colors(study.names)
    for axes, panel in zip(grid, panels, strict=True):
        for name, (x, mean, half) in panel.lines.items():
            axes.errorbar(x, mean, yerr=half, color=colors[name], label=name, **_LOOK)
        if differences:
            axes.axhline(0, color=colors[study.compared_to], lw=1.0)
        axes.set_title(
            "\n".join(v if isinstance(v, str) else f"{titles.get(k, k)}: {v:g}" for k, v in panel.at.items()),
            fontsize=8.5,
        )
        axes.set_xticks(range(len(places)), ticks, rotation=35 if slanted else 0, ha="right" if slanted else "center")
    means = np.abs(np.concatenate([mean for panel in panels for _, mean, _ in panel.lines.values()]))
    if differences and means.max() > _LOGARITHMIC * (usual := np.median(means)) > 0:
        grid[0].set_yscale("symlog", linthresh=max(usual, _LINEAR * means.max()))
    elif not differences and means.min() > 0 and means.max() / means.min() > _LOGARITHMIC:
        grid[0].set_yscale("log")
    for i, axes in enumerate(grid):
        if i % columns == 0:
            axes.set_ylabel(f"Δ {column.title}" if differences else column.title)
        if i + columns >= len(panels):
            axes.set_xlabel(titles.get(across, ""))
    handles, labels = next(
        (h for axes in grid if len((h := axes.get_legend_handles_labels())[0]) == len(names)),
        grid[0].get_legend_handles_labels(),
    )
    corner = (_LEFT / WIDTH, 1 - 0.4 / figure.get_figheight())
    figure.legend(
        handles, labels, loc="upper left", bbox_to_anchor=corner, borderaxespad=0, ncols=min(len(names), _LEGEND)
    )
    return figure


def _tick(value: Value | None) -> str:
    return "" if value is None else value if isinstance(value, str) else f"{value:.3g}"
