"""Innovations of the filters with ±√P_Y, normalised innovation squared, working mode."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure

from ..posteriors import SHARE_WINDOW, innovations, settled, switching
from ..series import share
from ..style import filter_colors
from .sheet import decades, legend, sheet, styled
from .signals import line, mode, period

if TYPE_CHECKING:
    from ...scenarios.run import Run

_DARK = "#30353B"


@styled
def filters(run: Run) -> Figure:
    """Innovations of the filters with ±√P_Y, normalised innovation squared, working mode."""
    found = innovations(run)
    colors = filter_colors(run.estimates)
    kept = settled(run)
    mean = ", ".join(f"{name} {np.mean(one.nis[kept]):.2f}" for name, one in found.items())
    caption = (
        "Innovation of each filter with ±√P_Y (line), P_Y of Eq. (14), the highest peaks cut off; "
        "NIS = innovation² / P_Y, moving mean over "
        f"{SHARE_WINDOW:g} s, is 1 where P_Y is right, below where W and V are conservative. Mean NIS: {mean}."
    )
    figure, rows = sheet(f"Filters  ·  {run.name}", caption, [*([1.0] * len(found)), 1.2, 1.1])
    panels = [axes for (axes,) in rows]
    limit = 1.2 * max(np.quantile(np.abs(one.values[kept]), 0.99) for one in found.values())
    nis, below = panels[-2:]
    window = round(SHARE_WINDOW / period(run))
    for panel, (name, one) in zip(panels, found.items(), strict=False):
        line(panel, run.time, one.values, colors[name], f"{name} innovation", lw=0.6)
        for sign in (1, -1):
            line(panel, run.time, sign * one.deviation, _DARK, "±√P_Y" if sign > 0 else None, lw=0.7)
        panel.set(ylabel="[N·m]", ylim=(-limit, limit))
        legend(panel)
        line(nis, run.time, np.maximum(share(one.nis, window), 1e-3), colors[name], name)
    nis.axhline(1, color=_DARK, lw=0.8, ls="--")
    nis.set(ylabel="NIS")
    decades(nis.yaxis)
    legend(nis)
    mode(run, below, switching(run))
    legend(below)
    return figure
