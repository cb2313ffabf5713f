"""Time stamps of a log: whether they are the sample times, and the sample times if not.

A sample with a wrong time deviates from the smooth motion by speed times time error: not at rest, and equally at both
encoders. An encoder's noise does not depend on speed, except for its counts, which do not show at rest.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from ..models.chunks import parts

_BLOCK = 1 << 16  # samples processed together, to limit memory
_LOOKED_AT, _STRETCH = 1 << 18, 1 << 14  # samples of a long log that are used, and the length of a stretch
FEWEST = 50  # fewest samples in motion for a result
LEAST = 2e-3  # least time error, in intervals, that counts
_COUNTS = 3.0  # largest mean square of a pattern of counts, over their mean square
_PASSED = 100.0  # squared motion between samples over an encoder's squared noise
_STILL = 1e-4  # squared speed at rest, over its largest
_BINS = 8  # of the speed, with as many samples each
_SURE = 4.0  # least significance of the time error, in standard deviations
_PART = 0.25  # least share of the time error in the deviation of the fastest samples
_CLIPPED = 36.0  # largest square of a sample over the median: a shock is not a time error
_ALIKE = 1.5  # largest ratio of speeds that count as one speed
_PERIODS = 8  # fractions of the median interval that are tried as the clock's period
_STEADIER = 0.7  # roughness with even times over that with stamps, for even samples
_EVEN = 1e-3  # of an interval: largest deviation of even stamps
_TICK = 0.1  # of an interval: least tick of a coarse clock

Kind = Literal["exact", "row numbers", "coarse clock", "arrival"]


@dataclass(frozen=True)
class Clock:
    """The kind of a log's time stamps."""

    # `exact`; `row numbers`: even, while the samples are not; of a `coarse clock`; or `arrival`, later than the samples
    kind: Kind
    error: float  # remaining error of the times [s rms]
    found: float = 0.0  # error of the stamps [s rms]
    tick: float = 0.0  # of a coarse clock [s]

    @property
    def text(self) -> str:
        """Description in words."""
        what = {
            "exact": "time stamps are right",
            "row numbers": "time is even, the samples are not: it is a row number",
            "coarse clock": f"time stamps are of a clock of {1e3 * self.tick:.3g} ms",
            "arrival": "time stamps jitter: they are of the arrival, not of the sampling",
        }[self.kind]
        off = f"{what}; off by {1e3 * max(self.found, self.error):.2g} ms rms"
        return (
            f"{off}; samples are taken as even, {1e3 * self.error:.2g} ms is left" if self.found > self.error else off
        )


def stretches(parts: Sequence[slice]) -> list[slice]:
    """Return all parts, or evenly spread stretches of a long log."""
    total = sum(part.stop - part.start for part in parts)
    if total <= _LOOKED_AT:
        return list(parts)
    apart = total * _STRETCH // _LOOKED_AT
    begins = (range(part.start, max(part.stop - _STRETCH, part.start + 1), apart) for part in parts)
    return [slice(b, min(b + _STRETCH, p.stop)) for p, some in zip(parts, begins, strict=True) for b in some]


def read_stamps(
    time: np.ndarray, encoders: Sequence[np.ndarray], parts: Sequence[slice], floors: Sequence[float]
) -> Clock:
    """Return the kind of the stamps, shape (n,) [s], by one or two encoders' readings, the motor's first, shape (n,)
    each [rad]. `parts`: without gaps; `floors`: noise of each in motion with an exact clock [rad]."""
    parts = stretches(parts)
    if not parts:
        return Clock("exact", 0.0)
    error = max(timing_error(time[k], [x[k] for x in encoders], floors) for k in parts)
    if not error:
        return Clock("exact", 0.0)
    steps = np.concatenate([np.diff(time[k]) for k in parts])
    interval = float(np.median(steps))
    tick = _tick(steps, interval)
    if tick > 0.9 * interval or np.percentile(np.abs(steps - interval), 90) < _EVEN * interval:
        return Clock("row numbers", error)
    return Clock("coarse clock", error, tick=tick) if tick else Clock("arrival", error)


def _tick(steps: np.ndarray, interval: float) -> float:
    """Return the tick [s] of the clock of which all steps are multiples; 0 for a fine clock."""
    different = np.abs(steps - interval)
    different = different[different > 1e-3 * interval]
    if not len(different):
        return 0.0
    tick = float(np.percentile(different, 1))
    whole = steps / tick
    return tick if tick > _TICK * interval and np.mean(np.abs(whole - np.round(whole)) < 0.05) > 0.98 else 0.0


@np.errstate(over="ignore", invalid="ignore", divide="ignore")  # of readings that no encoder gives
def timing_error(time: np.ndarray, encoders: Sequence[np.ndarray], floors: Sequence[float]) -> float:
    """Return the standard deviation [s] of the time error of a part without gaps; zero if the encoders do not show any.
    The arguments are as of `read_stamps`.

    Squared deviations from the smooth motion are sorted by speed. The part that grows with the squared speed is the
    time's. With two encoders it is the product of both, which noise of either does not contain.
    """
    if len(time) < FEWEST:
        return 0.0
    off, speed = zip(*(off_motion(time, x) for x in encoders), strict=True)
    both = len(off) == 2
    squares, speeds = off[0] * off[-1], np.abs(speed[0] * speed[-1])
    if both:
        squares = squares * np.sign(speed[0] * speed[-1])
    moving = speeds > _STILL * speeds.max(initial=0.0)
    order = np.flatnonzero(moving)[np.argsort(speeds[moving])]
    if len(order) < FEWEST:
        return 0.0
    bins = [*np.array_split(order, _BINS), *([np.flatnonzero(~moving)] if np.sum(~moving) >= FEWEST else [])]
    mean, spread = np.array([_steady(squares[b]) for b in bins]).T
    v = np.array([np.mean(speeds[b]) for b in bins])
    # Fast samples deviate by counts, which do not show at rest, and described noise, without any time error.
    floor = 0.0 if both else floors[0] ** 2
    spread = np.max([spread, 0.15 * np.abs(mean), np.full(len(mean), 0.02 * np.abs(mean).max() + 1e-300)], axis=0)
    interval = float(np.median(np.diff(time)))
    varied = v.max() > _ALIKE**2 * v.min()
    if counted := [m for m, s in zip(mean, v, strict=True) if varied and s * interval**2 > _PASSED * floor]:
        floor = min(floor, *counted)  # samples many counts apart limit the sensor's noise
    rest, slope, sure = _line(v, mean, spread**-2)
    if rest < floor or not varied:
        mean, weight = mean - floor, (v / spread) ** 2
        slope, sure = float(np.sum(mean * v / spread**2) / np.sum(weight)), float(np.sqrt(np.sum(weight)))
    fast = range(_BINS // 2, _BINS)
    whole = [np.sqrt(_steady(off[0][bins[k]] ** 2)[0] * _steady(off[-1][bins[k]] ** 2)[0]) for k in fast]
    if (
        np.median(whole) < _COUNTS * floor
        or slope * sure < _SURE
        or slope <= (LEAST * interval) ** 2
        or slope < _PART * np.median(whole / v[list(fast)])
    ):
        return 0.0
    return float(np.sqrt(slope))


def _steady(x: np.ndarray) -> tuple[float, float]:
    """Return the mean of x, shape (n,), and its standard deviation for correlated neighbours; shocks are limited to
    `_CLIPPED`."""
    most = _CLIPPED * float(np.median(np.abs(x)))
    kept = np.clip(x, -most, most)
    return float(np.mean(kept)), float(np.std(kept) * np.sqrt(5 / len(x)))


def _line(x: np.ndarray, y: np.ndarray, weight: np.ndarray) -> tuple[float, float, float]:
    """Return the weighted line through points, shape (n,): intercept, slope, and one over the slope's standard
    deviation."""
    middle = np.average(x, weights=weight)
    square = float(np.sum(weight * (x - middle) ** 2))
    slope = float(np.sum(weight * (x - middle) * y) / max(square, 1e-300))
    return float(np.average(y, weights=weight) - slope * middle), slope, float(np.sqrt(square))


def off_motion(t: np.ndarray, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return samples less the cubic through two neighbours on either side, as noise of one sample, and the speed
    there."""
    n = max(len(t) - 4, 0)
    off, speed = np.empty(n), np.empty(n)
    for part in parts(n, _BLOCK):
        tb, xb = (y[part.start : part.stop + 4] for y in (t, x))
        i = np.arange(2, len(tb) - 2)
        others = [i - 2, i - 1, i + 1, i + 2]
        weights = [np.prod([(tb[i] - tb[b]) / (tb[a] - tb[b]) for b in others if b is not a], axis=0) for a in others]
        left = xb[i] - sum(w * xb[a] for w, a in zip(weights, others, strict=True))
        off[part] = left / np.sqrt(1 + sum(w * w for w in weights))
        speed[part] = (xb[i + 2] - xb[i - 2]) / (tb[i + 2] - tb[i - 2])
    return off, speed


def clock_times(time: np.ndarray, encoders: Sequence[np.ndarray]) -> np.ndarray | None:
    """Return the sample times of one part [s] by the controller's clock, shape (n,), if the stamps are not; None if
    they are.

    Controllers sample evenly and stamp late. Times at whole periods are used if they make the motion of every encoder
    [rad] smoother.
    """
    rough = _roughness(time, encoders)
    best: np.ndarray | None = None
    interval = float(np.median(np.diff(time)))
    for part in range(1, _PERIODS + 1):
        even = _on_clock(time, interval / part)
        if even is None:
            continue
        now = _roughness(even, encoders)
        if np.all(now < _STEADIER * rough):
            best, rough = even, now
    return best


def _on_clock(time: np.ndarray, period: float) -> np.ndarray | None:
    """Return the nearest times at whole periods, with a fitted period; None if the stamps do not follow such a clock.

    The period is fitted to a beginning that doubles, so that no tick is missed.
    """
    n = len(time)
    begin = time[: min(64, n)] - time[0]
    tried = period * np.linspace(0.94, 1.06, 121)
    off = [float(np.std(begin / q - np.round(begin / q))) for q in tried]
    known, slope, start = 64, float(tried[int(np.argmin(off))]), float(time[0])
    while True:
        known = min(known, n)
        ticks = np.round((time[:known] - start) / slope)
        slope, start = (float(x) for x in np.polyfit(ticks, time[:known], 1))
        if known == n:
            break
        known *= 2
    ticks = np.round((time - start) / slope)
    # Two samples of one tick: move the later to the next tick, or the earlier to the one before.
    for k in np.flatnonzero(np.diff(ticks) <= 0):
        if k + 2 >= n or ticks[k + 2] > ticks[k] + 1:
            ticks[k + 1] = ticks[k] + 1
        elif k == 0 or ticks[k - 1] < ticks[k + 1] - 1:
            ticks[k] = ticks[k + 1] - 1
    return start + slope * ticks if np.all(np.diff(ticks) >= 1) else None


def _roughness(time: np.ndarray, encoders: Sequence[np.ndarray]) -> np.ndarray:
    """Return the root mean square deviation of each encoder from its own smooth motion where it moves [rad], shape
    (2,) or (1,)."""
    found = []
    for x in encoders:
        off, speed = off_motion(time, x)
        moving = np.abs(speed) > 0.2 * np.sqrt(np.mean(speed * speed))
        found.append(np.sqrt(np.mean(off[moving] ** 2)))
    return np.array(found)
