"""A legend in one row above the right end of a panel; the panel's title is on the left."""

from __future__ import annotations

from functools import cache
from typing import Any

from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import RendererAgg
from matplotlib.font_manager import FontProperties
from matplotlib.lines import Line2D

from .sheet import STYLE

_SAMPLE, _PAD, _BETWEEN, _ABOVE = 0.2, 0.07, 0.17, 0.09  # in: of a line, to its text, to the next, above the panel
_PATCH = 6.0  # pt: line width for an area


def legend(axes: Axes, *more: Axes, above: float = _ABOVE) -> None:
    """Draw the legend of a panel and of more axes on it; `above` the panel [in]. matplotlib's legend takes ten times longer."""
    handles, labels = [], []
    for one in (axes, *more):
        found = one.get_legend_handles_labels()
        handles += found[0]
        labels += found[1]
    figure = axes.get_figure(root=True)
    assert figure is not None
    place = axes.get_position()
    x, y = place.x1 * figure.get_figwidth(), place.y1 * figure.get_figheight() + above
    size = STYLE["legend.fontsize"]
    for handle, label in reversed(list(zip(handles, labels, strict=True))):
        x -= _width(label, size)
        figure.text(x, y, label, fontsize=size, va="center_baseline", transform=figure.dpi_scale_trans)
        ends = [x - _PAD - _SAMPLE, x - _PAD], [y, y]
        look: dict[str, Any]
        if isinstance(handle, Line2D):
            look = {"color": handle.get_color(), "ls": handle.get_linestyle(), "alpha": handle.get_alpha(), "lw": 2.0}
        else:
            look = {"color": handle.get_facecolor(), "lw": _PATCH}
        figure.add_artist(Line2D(*ends, transform=figure.dpi_scale_trans, solid_capstyle="butt", **look))
        x -= _PAD + _SAMPLE + _BETWEEN


@cache
def _width(text: str, size: float) -> float:
    """Width of a text [in]."""
    dpi = 100
    font = FontProperties(family=STYLE["font.family"], size=size)
    return RendererAgg(1, 1, dpi).get_text_width_height_descent(text, font, ismath=False)[0] / dpi
