"""Ticks, grid and labels of a figure's panels, drawn as few objects.

matplotlib's axes make five objects per tick and measure all of them, which doubles the time of a figure.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from typing import Any, ParamSpec

import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis, XAxis
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator
from matplotlib.transforms import Transform

from .sheet import LEFT, STYLE, styled

P = ParamSpec("P")


def ruled(make: Callable[P, Figure]) -> Callable[P, Figure]:
    """Draw in the common style, and rule the panels when their limits are known."""

    @wraps(make)
    def wrapped(*args: P.args, **kwargs: P.kwargs) -> Figure:
        figure = make(*args, **kwargs)
        for axes in figure.axes:
            rule(axes)
        return figure

    return styled(wrapped)


def rule(axes: Axes) -> None:
    """Draw grid, numbers and labels of both axes: a single line for the grid of an axis, a text for each number."""
    points = axes.figure.dpi / 72
    width, height = axes.bbox.width / points, axes.bbox.height / points  # [pt]
    right = axes.yaxis.get_label_position() == "right"
    x, y = (_ticks(axis) for axis in (axes.xaxis, axes.yaxis))
    edge, sign, side = (1.0, 1.0, "left") if right else (0.0, -1.0, "right")
    small: dict[str, Any] = {
        "fontsize": axes.yaxis.get_tick_params().get("labelsize", STYLE["font.size"]),
        "color": STYLE["xtick.color"],
    }
    numbers: dict[str, Any] = {"transform": axes.get_yaxis_transform(), "ha": side, "va": "center_baseline"} | small
    for place, text in y:
        axes.text(edge + sign * 5 / width, place, text, **numbers)
    if not right:
        _grid(axes, [place for place, _ in x], axes.get_xaxis_transform(), upright=True)
        if axes.yaxis.get_tick_params().get("gridOn", True):
            _grid(axes, [place for place, _ in y], axes.get_yaxis_transform(), upright=False)
    label: dict[str, Any] = {
        "color": STYLE["axes.labelcolor"],
        "fontsize": STYLE["axes.labelsize"],
        "transform": axes.transAxes,
    }
    far = edge + sign * (LEFT - 0.12 if not right else 0.42) * 72 / width
    axes.text(far, 0.5, axes.get_ylabel(), rotation=90, ha="center" if right else "left", va="center", **label)
    if axes.xaxis.get_visible() and not right:
        for place, text in x:
            axes.text(place, -5 / height, text, transform=axes.get_xaxis_transform(), ha="center", va="top", **small)
        axes.text(0.5, -20 / height, axes.get_xlabel(), ha="center", va="top", **label)
    axes.xaxis.set_visible(False)
    axes.yaxis.set_visible(False)


def _ticks(axis: Axis) -> list[tuple[float, str]]:
    """Positions within the limits, and their texts."""
    low, high = sorted(axis.get_view_interval())
    slack = 1e-9 * (high - low)
    places = [float(t) for t in axis.get_majorticklocs() if low - slack <= t <= high + slack]
    return list(zip(places, axis.get_major_formatter().format_ticks(places), strict=True))


def _grid(axes: Axes, places: list[float], transform: Transform, upright: bool) -> None:
    along, across = np.repeat(places, 3), np.tile([0.0, 1.0, np.nan], len(places))
    style: dict[str, Any] = {
        "color": STYLE["grid.color"],
        "lw": STYLE["grid.linewidth"],
        "zorder": 0.5,
        "solid_capstyle": "butt",
    }
    axes.add_line(Line2D(*((along, across) if upright else (across, along)), transform=transform, **style))


def decades(*several: Axis) -> None:
    """Make axes logarithmic, with a tick per decade and plain numbers."""
    for axis in several:
        axis.axes.set(**{"xscale" if isinstance(axis, XAxis) else "yscale": "log"})
        axis.set_major_locator(LogLocator(numticks=6))
        axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        axis.set_minor_locator(NullLocator())
