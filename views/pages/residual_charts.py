"""Charts of residuals over time and over the variables that they may depend on."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ..numbers import percent
from ..report import plain
from ..residuals import ORDERS, VARIABLES, Overlay, ResidualSeries, explained, means, orders, strongest_variable
from .chart import Chart, limits

if TYPE_CHECKING:
    from ...diagnosis.improvement import Improvement

_DOTS = 600  # samples in a chart of a balance


@dataclass(frozen=True)
class Group:
    """Charts of one channel, with the RMS of its residual before and after, and the noise."""

    channel: str
    unit: str
    charts: list[list[Chart]]
    before: float = 0.0
    after: float = 0.0
    noise: float = 0.0


def over_time(rows: list[list[Overlay]]) -> list[Group]:
    """Return a group per channel: for each recording its values, if measured, above its residuals."""
    found = []
    for row in rows:
        both = np.concatenate([x for o in row for x in (o.before, o.after)])
        y = limits(both, 0.3, 0.1, 2.5 * row[0].noise)
        found.append(Group(row[0].channel, row[0].unit, [_overlay(o, y) for o in row]))
    return found


def _overlay(o: Overlay, y: tuple[float, float]) -> list[Chart]:
    x = (float(o.time[0]), float(o.time[-1]))
    charts = []
    if o.measured is not None:
        curves = {"measured broad": o.measured, "before": o.measured - o.before, "after": o.measured - o.after}
        y_values = limits(np.concatenate([*curves.values()]), 0.05)
        charts.append(Chart(x, y_values, o.name, ylabel=o.unit, height=166).lines(o.time, curves))
    residual = Chart(x, y, "measured − simulated" if charts else o.name, "time [s]", o.unit, height=152)
    residual.stripes(o.held_out, "held-out")
    residual.band(-2 * o.noise, 2 * o.noise, "noise")
    return [*charts, residual.lines(o.time, {"before thin": o.before, "after thin": o.after})]


def trace(improvement: Improvement) -> dict[str, Any]:
    """Return charts of the main estimator's estimate before and after, with its error, for the recording with the largest
    load."""
    t = max(improvement.traces, key=lambda t: float(np.ptp(t.measured)))
    x = (float(t.time[0]), float(t.time[-1]))
    curves = {"measured broad": t.measured, "before": t.before, "after": t.after}
    values = Chart(x, limits(t.measured, 0.05), plain(improvement.quantity), ylabel="N·m", width=660, height=170)
    errors = {"before thin": t.before - t.measured, "after thin": t.after - t.measured}
    y = limits(np.concatenate([*errors.values()]), 0.3, 0.1)
    below = Chart(x, y, "estimate − measured", "time [s]", "N·m", width=660, height=152)
    return {"name": t.name, "charts": [values.lines(t.time, curves), below.lines(t.time, errors)]}


def main_variable(found: list[ResidualSeries]) -> dict[str, Any] | None:
    """Return the variable that explains most of the discrepancy: channel, key, and shares before and after."""
    most = strongest_variable(found)
    if most is None:
        return None
    b, key, share = most
    return {"channel": b.channel, "key": key, "before": share, "after": explained(b, b.after, key)}


def by_variable(found: list[ResidualSeries]) -> list[Group]:
    """Return a group per balance: its residual over every variable."""
    most = strongest_variable(found)
    groups = []
    for b in found:
        accent = most[1] if most is not None and most[0] is b else ""
        rms = [float(np.sqrt(np.mean(x**2))) for x in (b.before, b.after)]
        charts = [[chart] for chart in _charts(b, accent)]
        groups.append(Group(b.channel, b.unit, charts, rms[0], rms[1], b.noise))
    return groups


def _charts(b: ResidualSeries, accent: str) -> list[Chart]:
    y = limits(np.concatenate([b.before, b.after]), 0.3, 0.1, 2.5 * b.noise)
    some = np.random.default_rng(0).choice(len(b.before), min(_DOTS, len(b.before)), replace=False)
    charts = []
    for key, label in VARIABLES.items():
        shares = [percent(explained(b, r, key)) for r in (b.before, b.after)]
        text = f"explains {shares[0]}, then {shares[1]}"
        if key == "direction":
            charts.append(_direction(b, y, text, accent == key))
            continue
        x, reach = b.variable(key), b.limits(key)
        chart = Chart(reach, y, text, label, b.unit, accent == key)
        chart.band(-2 * b.noise, 2 * b.noise, "noise")
        chart.dots(x[some], b.before[some], "measured faint")
        for side, kind in zip(b.sides(key), ("forward", "backward"), strict=True):
            if side.sum() > 50:
                chart.line(*means(x[side], b.before[side], reach), f"{kind} mean")
        chart.line(*means(x, b.after, reach), "after mean")
        charts.append(chart)
    charts.insert(3, _orders(b))
    return charts


def _orders(b: ResidualSeries) -> Chart:
    label = "order per turn of the motor"
    moving = np.flatnonzero(np.abs(b.velocity) > 2.0)[:: max(len(b.velocity) // 6000, 1)]
    if len(moving) < 200:
        return Chart((0, 14), (0, 1), "the motor hardly turns", label, b.unit)
    before, after = (orders(b.motor[moving], r[moving]) for r in (b.before, b.after))
    top = 1.1 * max(float(before.max()), float(after.max()), b.noise)
    chart = Chart((0, 14.5), (0.0, top), "orders", label, b.unit)
    for place, values, kind in ((-0.2, before, "before"), (0.0, after, "after")):
        boxes = [(o + place, o + place + 0.2, 0.0, float(v)) for o, v in zip(ORDERS, values, strict=True)]
        chart.boxes(boxes, f"{kind} bar")
    return chart


def _direction(b: ResidualSeries, y: tuple[float, float], text: str, accent: bool) -> Chart:
    labels = ((-0.6, "backward"), (0.6, "forward"))
    chart = Chart((-1.2, 1.2), y, text, VARIABLES["direction"], b.unit, accent, labels)
    chart.band(-2 * b.noise, 2 * b.noise, "noise")
    for x, side in ((-0.6, b.velocity < 0), (0.6, b.velocity > 0)):
        for offset, r, kind in ((-0.16, b.before, "before"), (0.16, b.after, "after")):
            if side.sum() > 50:
                low, high = np.percentile(r[side], [16, 84])
                chart.line(np.array([x + offset] * 2), np.array([low, high]), f"{kind} spread")
                chart.dots(np.array([x + offset]), np.array([np.mean(r[side])]), f"{kind} point")
    return chart
