"""Error of every filter, and its distribution."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure

from ..posteriors import settled
from ..style import MODEL, filter_colors
from .sheet import decades, legend, sheet, styled
from .signals import line, peak

if TYPE_CHECKING:
    from ...scenarios.run import Run


@styled
def error(run: Run) -> Figure:
    """Error of every filter, and its distribution."""
    names = list(run.estimates)
    colors = filter_colors(names)
    truth, kept = run.truth("joint_torque"), settled(run)
    errors = {name: run.estimate(name) - truth for name in names}
    model = run.model_torque - truth
    caption = (
        f"Estimate − truth after {run.scenario.transient:g} s, RMS (largest) in N·m: raw model {_said(run.metrics['model'])}; "
        + "; ".join(f"{name} {_said(run.metrics['filters'][name])}" for name in errors)
        + "."
    )
    count = len(names)
    heights = [*([1.05] * count), 1.6]
    figure, rows = sheet(f"Error  ·  {run.name}", caption, heights, shared=range(count - 1))
    *panels, last = (axes for (axes,) in rows)
    limit = 1.1 * max(peak(e[kept]) for e in errors.values())
    for panel, name in zip(panels, names, strict=True):
        line(panel, run.time, model, MODEL, "raw model", lw=0.5)
        line(panel, run.time, errors[name], colors[name], name, lw=0.8)
        panel.set(ylabel="[N·m]", ylim=(-limit, limit), xlim=(run.time[0], run.time[-1]))
        legend(panel)
    panels[-1].set_xlabel("time [s]")
    shares = 100 * (1 - np.arange(1, 1001) / 1001)
    for name, values in {"raw model": model, **errors}.items():
        size = np.quantile(np.abs(values[kept]), 1 - shares / 100)
        last.plot(np.maximum(size, 1e-6), shares, color=colors.get(name, MODEL), label=name, lw=1.4)
    last.set(xlabel="size of the error [N·m]", ylabel="time above it [%]")
    decades(last.xaxis, last.yaxis)
    last.set_xlim(left=1e-3 * 10 ** np.floor(np.log10(max(limit, 1e-3))))
    legend(last)
    return figure


def _said(measures: Mapping[str, float | None]) -> str:
    return f"{measures['rms']:.3f} ({measures['max']:.3f})"
