"""Draw the intervals of a page's table: one panel per case, one line per row, one colour per series."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from flexspline.models.files import write_into_place
from flexspline.scenarios.evaluation.intervals import Interval
from flexspline.views import style

Point = tuple[str, str, Interval]
"""Row, series, value with its interval."""


def intervals(
    path: Path, panels: Mapping[str, Sequence[Point]], label: str, log: bool = True, shared: bool = True
) -> None:
    """Draw values with their 95 % intervals as a PNG.

    Args:
      path: of the figure.
      panels: points by title of the panel; all panels have the same rows.
      label: of the horizontal axis, with its unit.
      log: whether that axis is logarithmic.
      shared: whether all panels have the same axis.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    rows = list(dict.fromkeys(row for points in panels.values() for row, _, _ in points))
    series = list(dict.fromkeys(name for points in panels.values() for _, name, _ in points))
    colors = dict(zip(series, (*style.FILTERS.values(), *style.SPARE), strict=False))
    figure = Figure(figsize=(8.6, 1.1 + (0.28 if len(series) < 4 else 0.36) * len(rows)), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(1, len(panels), sharey=True, sharex=shared, squeeze=False)[0]
    for ax, (title, points) in zip(axes, panels.items(), strict=True):
        for row, name, value in points:
            if not np.isfinite(value.mean):
                continue
            shift = 0.16 * (series.index(name) - 0.5 * (len(series) - 1))
            y = rows.index(row) + shift
            ax.plot([value.low, value.high], [y, y], color=colors[name], lw=1.2)
            ax.plot(value.mean, y, "o", ms=4, color=colors[name])
        ax.set_title(title, fontsize=9)
        ax.set_xlabel(label, fontsize=8)
        if log:
            ax.set_xscale("log")
            ax.xaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
            ax.xaxis.set_major_formatter(FuncFormatter(lambda x, _: f"{x:g}"))
            ax.xaxis.set_minor_formatter(NullFormatter())
        ax.set_yticks(range(len(rows)), rows, fontsize=8)
        ax.tick_params(labelsize=8)
        ax.grid(axis="x", alpha=0.3, lw=0.5)
    axes[0].invert_yaxis()
    if len(series) > 1:
        handles = [Line2D([], [], marker="o", ms=4, lw=1.2, color=colors[name], label=name) for name in series]
        figure.legend(handles=handles, loc="outside upper right", ncols=len(series), fontsize=8, frameon=False)
    with write_into_place(path) as temporary:
        figure.savefig(temporary, format="png", dpi=110)
