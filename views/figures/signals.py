"""Signals of a run as lines, and texts for captions."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes

from ..posteriors import robust_shares, settled
from ..series import envelope, extremes
from ..style import SENSOR, TRUTH, filter_colors, main_filter
from .sheet import PIXELS

if TYPE_CHECKING:
    from ...scenarios.run import Run

_DENSE = 8  # samples per column of pixels above which a noisy line is drawn as a band
_NOISY = 60.0  # sum of changes relative to the range above which a line is noisy


def line(axes: Axes, time: np.ndarray, values: np.ndarray, color: str, label: str | None = None, **style: Any) -> None:
    """Draw a series, shape (n,), as a line with two points per column of pixels; a noisy one as a band, which is faster."""
    i = envelope(values, PIXELS)
    drawn = values[i]
    if len(values) < _DENSE * PIXELS or np.abs(np.diff(drawn)).sum() < _NOISY * np.ptp(drawn):
        axes.plot(time[i], drawn, color=color, label=label, **style)
        return
    middle, low, high = extremes(values, PIXELS)
    axes.fill_between(time[middle], low, high, facecolor=color, edgecolor=color, **style)
    axes.plot([], [], color=color, label=label, **style)  # for the legend


def torques(run: Run, axes: Axes, names: Sequence[str], truth_on_top: bool = False) -> None:
    """Draw sensor, truth and estimates: the truth as a broad band below them, or on top, where noise would hide it."""
    colors = filter_colors(run.estimates)
    line(axes, run.time, run.reading("joint_torque"), SENSOR, "torque sensor", lw=0.7)
    style = {"lw": 1.0, "zorder": 4} if truth_on_top else {"lw": 2.4, "alpha": 0.75}
    line(axes, run.time, run.truth("joint_torque"), TRUTH, "truth", **style)
    for name in names:
        line(axes, run.time, run.estimate(name), colors[name], name, lw=0.8)
    axes.set_ylabel("joint torque [N·m]")


def mode(run: Run, axes: Axes, names: Sequence[str], fill: str = "") -> None:
    """Draw the share of the time in robust mode."""
    colors = filter_colors(run.estimates)
    for name in names:
        values = robust_shares(run, name)
        i = envelope(values, PIXELS)
        if name == fill:
            axes.fill_between(run.time[i], values[i], color=colors[name], alpha=0.35, lw=0)
        axes.plot(run.time[i], values[i], color=colors[name], lw=0.9, label=name)
    axes.set(ylabel="robust mode\n[% of the time]", xlabel="time [s]", ylim=(0, 105), yticks=[0, 50, 100])


def main(run: Run) -> tuple[str, dict[str, str]]:
    """Return the main filter, and the colours of all."""
    moding = [name for name, found in run.estimates.items() if found.robust is not None]
    return main_filter(moding or run.estimates), filter_colors(run.estimates)


def rms(values: np.ndarray) -> float:
    """Return the root mean square."""
    return float(np.sqrt(np.mean(np.square(values))))


def peak(values: np.ndarray) -> float:
    """Return the largest absolute value."""
    return float(np.abs(values).max())


def against(run: Run, name: str) -> str:
    """Return `after … s against the truth RMS …, largest … N·m; against the sensor …`."""
    found = run.metrics["filters"][name]
    sensor = (run.estimate(name) - run.reading("joint_torque"))[settled(run)]
    return (
        f"after {run.scenario.transient:g} s against the truth RMS {found['rms']:.3f}, largest {found['max']:.3f} N·m; "
        f"against the sensor RMS {found['rms_to_sensor']:.3f}, largest {peak(sensor):.3f} N·m"
    )


def response(run: Run) -> str:
    """Return response times and noise of all filters; empty without pushes."""
    values = {name: (m.get("response_ms"), m.get("noise_ratio")) for name, m in run.metrics.get("filters", {}).items()}
    parts = [
        f"{name} {time:.1f} ms" + (f" (noise {noise:.2f})" if noise is not None else "")
        for name, (time, noise) in values.items()
        if time is not None
    ]
    if not parts:
        return ""
    return "; response, 90 % of a push after the truth (noise relative to the raw model): " + ", ".join(parts)
