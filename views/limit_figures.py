"""Figures of limits: errors and the bound, consistency, noise against delay."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from .figures.sheet import LEFT, RIGHT, WIDTH, blank, place, styled
from .style import COMMAND, FILTERS, TRUTH

if TYPE_CHECKING:
    from ..scenarios.evaluation.limits import Assessment, Limits
    from ..scenarios.evaluation.tuning import Front

BASELINES = {
    "model": "#C8B68E", "current": "#9AA3AD", "lowpass": "#17BECF", "lowpass_first_order": "#0E7C8A",
    "kalman": "#2CA02C", "h_infinity": "#8C9A2B", "strong_tracking": "#E377C2", "huber": "#8C6D4F",
    "momentum": "#B5BCC4", "momentum_torsion": "#6B7BB8", "dynamics_ekf": "#111418", "augmented": "#5B6670",
    "dynamics_ukf": "#7A3E9D", "rts_smoother": "#C0392B",
}  # fmt: skip
"""Colour of each baseline; the paper's filters have theirs in `style`."""
_SHOWN = (  # estimators whose error is drawn over time, if there are many
    "EKF", "AREKF", "RAREKF", "kalman", "lowpass", "strong_tracking", "dynamics_ekf", "dynamics_ukf", "rts_smoother",
)  # fmt: skip


def contender_color(name: str) -> str:
    """Return the colour of an estimator, which is the same in all figures."""
    return FILTERS.get(name) or BASELINES.get(name, "#444A52")


@styled
def limits_figure(limits: Limits) -> Figure:
    """Draw RMS errors and bounds of a scenario over time; NIS and NEES with intervals; autocorrelation of the innovations."""
    every = limits.estimators
    names = [e.name for e in every if len(every) <= len(_SHOWN) or e.name in _SHOWN]
    tolerant = (
        f"Dotted: for a joint that is known within {limits.tolerance:g} × its tolerances, which are the prior; RMS "
        f"{limits.tolerance_bound_rms:.4f} N·m. "
        if limits.tolerance > 0.0
        else ""
    )
    caption = (
        f"{limits.scenario}, {len(limits.seeds)} seeds. RMS error over seeds in bins of 0.1 s. Bound: posterior Cramér-Rao, the "
        f"joint's dynamics with encoders and current command, external torque a random walk of {limits.intensity:.3g} N·m/√s "
        f"(the scenario's own: {limits.fitted:.3g}); RMS {limits.bound_rms:.4f} N·m. Dashed: the paper's model, joint torque "
        f"as a random walk of {limits.torsion_intensity:.3g} N·m/√s seen through the torsion; RMS "
        f"{limits.torsion_bound_rms:.4f} N·m. {tolerant}All are means over the seeds' truths, with encoder counts as Gaussian "
        "noise: a single run may be below. Bars: 95 % intervals (χ²) of a filter with the right covariance, NIS of all samples, "
        "NEES of one error per run. Shaded at the right: 95 % band of white innovations."
    )
    shown_ones = [e for e in every if e.name in names and e.error.size]
    rows = -(-(len(shown_ones) + 2) // 4)
    above = 0.5 + 0.18 * rows
    rated = max(len(every), 4) * 0.16 + 0.5
    figure = blank("Error and bound", caption, above + 3.6 + 0.75 + rated + 0.6)
    top = place(figure, LEFT, above, WIDTH - LEFT - RIGHT, 3.6)
    top.margins(x=0.01)
    for one in shown_ones:
        top.plot(limits.time, one.error, color=contender_color(one.name), lw=0.9, label=one.name)
    top.plot(limits.time, limits.torsion_bound, color=COMMAND, ls="--", lw=1.6, label="bound, paper's model")
    if limits.tolerance > 0.0:
        top.plot(limits.time, limits.tolerance_bound, color=TRUTH, ls=":", lw=1.8, label="bound, tolerances as prior")
    top.plot(limits.time, limits.bound, color=TRUTH, lw=2.4, label="bound, joint's dynamics")
    after = limits.time >= limits.transient
    floor = 0.5 * min(limits.bound[after].min(), *(e.error[after].min() for e in every if e.error.size), np.inf)
    top.set(yscale="log", xlabel="time [s]", ylabel="RMS error [N·m]", ylim=(max(floor, 1e-5), None))
    top.legend(ncols=4, loc="lower left", bbox_to_anchor=(0, 1.0), borderaxespad=0.2, fontsize=8)
    below = above + 3.6 + 0.75
    for column, (which, label) in enumerate((("nis", "NIS per degree of freedom"), ("nees", "NEES"))):
        axes = place(figure, _NAMES + column * (_NAMES + _SMALL), below, _SMALL, rated)
        _consistency(axes, every, which, label)
    left = 2 * (_NAMES + _SMALL) + 0.85
    _whiteness(place(figure, left, below, WIDTH - RIGHT - left, rated), every, limits.band)
    return figure


@styled
def pareto_figure(fronts: Sequence[Front], scenario: str, seeds: int) -> Figure:
    """Draw noise in steady state over delay to a push: a curve per filter, with its defaults and tuned settings."""
    caption = (
        f"{scenario}, {seeds} test seeds. Along a curve, a filter's tuning parameters change; only settings are drawn that no "
        "other setting of the filter beats in both noise and delay. Circle: defaults; star: tuned for the RMS error. Delay: the "
        "shift of the truth that explains the estimate best around the pushes; noise: standard deviation of the error's part "
        "faster than 0.2 s, in steady state. Lower left is better."
    )
    figure = blank("Noise against delay", caption, 0.6 + 5.0 + 0.6)
    axes = place(figure, LEFT, 0.6, WIDTH - LEFT - _LEGEND, 5.0)
    for front in fronts:
        color = contender_color(front.name)
        inside = front.points[:, 0] > -5.0
        x, y = np.maximum(front.points[inside, 0], _LEAST_DELAY), front.points[inside, 1]
        line: dict[str, Any] = {"marker": ".", "ms": 4} if len(x) > 1 else {"marker": "s", "ms": 5}
        axes.plot(x, y, color=color, lw=1.2, label=front.name, **line)
        for point, marker, size in ((front.default, "o", 6), (front.tuned, "*", 10)):
            if point is not None and np.isfinite(point).all():
                at = max(point[0], _LEAST_DELAY)
                axes.plot(at, point[1], marker, ms=size, mfc="white", mec=color, mew=1.4, zorder=5)
    axes.set(xscale="log", yscale="log", xlabel=f"delay [ms] (less than {_LEAST_DELAY:g} is drawn there)")
    axes.set_ylabel("noise [N·m]")
    for axis in (axes.xaxis, axes.yaxis):
        _plain(axis, (1.0, 2.0))
    axes.legend(ncols=1, loc="center left", bbox_to_anchor=(1.01, 0.5), fontsize=8)
    return figure


_LEAST_DELAY = 0.1  # ms
_NAMES, _SMALL, _LEGEND = 1.45, 1.35, 2.05  # in: names left of a panel, a small panel, a legend


def _consistency(axes: Axes, estimators: Sequence[Assessment], which: str, label: str) -> None:
    having = [e for e in estimators if getattr(e, which) is not None]
    for row, one in enumerate(having):
        mean = getattr(one, which)
        axes.plot([mean.low, mean.high], [row, row], color="#CBD2D9", lw=5, solid_capstyle="butt", zorder=1)
        axes.plot(mean.value, row, "o", ms=4.5, color=contender_color(one.name), zorder=3)
    axes.axvline(1.0, color="#30353B", lw=0.8, ls="--")
    axes.set(xscale="log", yticks=range(len(having)), ylim=(len(having) - 0.4, -0.6), xlabel=label)
    axes.set_yticklabels([e.name for e in having], fontsize=6.8)
    axes.grid(axis="y", visible=False)
    _plain(axes.xaxis, axes.get_xlim())


def _plain(axis: Axis, limits: tuple[float, float]) -> None:
    """Use plain numbers, at 1, 2, 5 of each decade on a short axis."""
    axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0) if limits[1] < 30 * limits[0] else (1.0,)))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_formatter(NullFormatter())


def _whiteness(axes: Axes, estimators: Sequence[Assessment], band: float) -> None:
    for one in estimators:
        if one.autocorrelation is not None:
            lags = np.arange(1, len(one.autocorrelation) + 1)
            axes.plot(lags, one.autocorrelation, color=contender_color(one.name), lw=1.0)
    axes.axhspan(-band, band, color="#DDE2E7", lw=0)
    axes.set(xlabel="lag [samples]", ylabel="autocorrelation of innovations")
