"""The layout of figures: one style, panels at fixed positions, title above and caption below, PNG.

Margins are fixed lengths, so that nothing is drawn twice to measure it.
"""

from __future__ import annotations

import itertools
import textwrap
from collections.abc import Callable, Sequence
from functools import wraps
from pathlib import Path
from typing import Any, ParamSpec, TypeVar

import matplotlib
from matplotlib.axes import Axes
from matplotlib.axis import Axis, XAxis
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullLocator

from ...models.files import write_into_place

_DPI = 150
STYLE: dict[Any, Any] = {
    "font.family": "DejaVu Sans",
    "font.size": 9.0,
    "axes.titlesize": 9.5,
    "axes.titlelocation": "left",
    "axes.titley": 1.0,  # fixed: not computed
    "axes.labelsize": 9.0,
    "axes.grid": True,
    "axes.axisbelow": True,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.edgecolor": "#8A9099",
    "axes.labelcolor": "#22262B",
    "xtick.color": "#444A52",
    "ytick.color": "#444A52",
    "grid.color": "#E4E7EB",
    "grid.linewidth": 0.7,
    "legend.frameon": False,
    "legend.fontsize": 8.5,
    "lines.linewidth": 1.1,
    "figure.dpi": _DPI,
    "figure.facecolor": "white",
    "path.simplify": False,  # lines come as envelopes
}
"""One style for all figures."""

WIDTH = 8.6  # width of a figure [in]
LEFT, RIGHT, TOP, GAP, BELOW = 0.82, 0.14, 0.62, 0.34, 0.52
"""Margins [in]: left and right of the panels, above them, between them (a legend's row), and below for an axis label."""
BETWEEN = 0.78  # horizontal distance [in] between two panels
PIXELS = round((WIDTH - LEFT - RIGHT) * _DPI)  # columns of pixels of a panel that has the whole width
_CAPTION, _LINE = 8.2, 0.165  # size [pt], height of a line [in]
_COMPRESSION = 3  # of 9: higher levels are slow and gain little

P = ParamSpec("P")
F = TypeVar("F", Figure, Figure | None)


def styled(make: Callable[P, F]) -> Callable[P, F]:
    """Draw in this module's style, without a change of matplotlib's settings."""

    @wraps(make)
    def wrapped(*args: P.args, **kwargs: P.kwargs) -> F:
        with matplotlib.rc_context(STYLE):
            return make(*args, **kwargs)

    return wrapped


def blank(title: str, caption: str, height: float) -> Figure:
    """Return a figure without panels: a title above, a wrapped caption below a height [in]."""
    lines = textwrap.wrap(" ".join(caption.split()).replace(" -", " −"), 132)
    total = height + _LINE * len(lines) + 0.16
    figure = Figure(figsize=(WIDTH, total))
    FigureCanvasAgg(figure)
    figure.text(0.012, 1 - 0.12 / total, title, fontsize=11, fontweight="bold", color="#22262B", va="top")
    text = "\n".join(lines)
    figure.text(0.012, 0.1 / total, text, fontsize=_CAPTION, color="#444A52", va="bottom", linespacing=1.4)
    return figure


def place(
    figure: Figure, left: float, above: float, width: float, height: float, x: Axes | None = None, y: Axes | None = None
) -> Axes:
    """Return axes at a position [in] from the figure's left and upper edges; `x`, `y`: axes to share."""
    total = figure.get_figheight()
    at = (left / WIDTH, (total - above - height) / total, width / WIDTH, height / total)
    return figure.add_axes(at, sharex=x, sharey=y)


def sheet(
    title: str,
    caption: str,
    heights: Sequence[float],
    columns: int = 1,
    right: float = RIGHT,
    shared: Sequence[int] | None = None,
) -> tuple[Figure, list[list[Axes]]]:
    """Return a figure with rows of panels, and the panels by row. `heights`: of the rows [in]; `right`: margin [in],
    for an axis there; `shared`: rows that share the horizontal axis with the one below them, all but the last by
    default."""
    shared = range(len(heights) - 1) if shared is None else shared
    gaps = [*(GAP if row in shared else GAP + BELOW - 0.1 for row in range(len(heights) - 1)), BELOW]
    figure = blank(title, caption, TOP + sum(heights) + sum(gaps))
    width = (WIDTH - LEFT - right - BETWEEN * (columns - 1)) / columns
    rows: list[list[Axes]] = []
    above = TOP
    for row, (height, gap) in enumerate(zip(heights, gaps, strict=True)):
        over = rows[-1] if row and row - 1 in shared else [None] * columns
        rows.append(
            [place(figure, LEFT + k * (width + BETWEEN), above, width, height, over[k]) for k in range(columns)]
        )
        for axes in rows[-1]:
            axes.margins(x=0.01)
            axes.yaxis.set_major_locator(
                MaxNLocator(8 if height > 3 else 6 if height > 1.2 else 4, steps=[1, 2, 2.5, 5, 10])
            )
            axes.tick_params(axis="x", labelbottom=row not in shared)
        above += height + gap
    return figure, rows


def legend(axes: Axes, *more: Axes, above: float = 0.0) -> None:
    """Draw the legend of a panel and of more axes on it, in a row above its right end; `above`: distance from it [in]."""
    drawn = [one.get_legend_handles_labels() for one in (axes, *more)]
    handles, labels = ([*itertools.chain(*parts)] for parts in zip(*drawn, strict=True))
    figure = axes.get_figure(root=True)
    assert figure is not None
    corner = (1.0, 1.0 + above / (axes.get_position().height * figure.get_figheight()))
    axes.legend(
        handles,
        labels,
        loc="lower right",
        bbox_to_anchor=corner,
        ncols=len(labels),
        borderaxespad=0.0,
        borderpad=0.3,
        columnspacing=1.2,
    )


def decades(*several: Axis) -> None:
    """Make axes logarithmic, with a tick per decade and plain numbers."""
    for axis in several:
        axis.axes.set(**{"xscale" if isinstance(axis, XAxis) else "yscale": "log"})
        axis.set_major_locator(LogLocator(numticks=6))
        axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        axis.set_minor_locator(NullLocator())


def save(figure: Figure, path: Path, dpi: int = _DPI) -> Path:
    """Write a figure as PNG, moved into place when complete. Raises `InputError`: the file cannot be written."""
    with matplotlib.rc_context(STYLE), write_into_place(path) as temporary:
        figure.savefig(temporary, format="png", dpi=dpi, pil_kwargs={"compress_level": _COMPRESSION})
    return path
