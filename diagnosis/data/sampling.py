"""What a log does to readings: slow sensors are held, time stamps are wrong.

A sensor of 100 Hz in a log of 1 kHz says everything ten times. Taken as they are, such steps are late by half the
sensor's period, each channel by its own, and their noise comes ten times too. Only fresh readings are news: the log is
thinned to the encoders', and slower channels are interpolated between theirs.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline


@dataclass(frozen=True)
class SamplingSettings:
    """When a log's times are not those of the readings.

    Attributes:
      slower: a sensor is slower than the log where its rate is below so much of the log's.
      fewest: samples in motion below which nothing is said about the time stamps.
      together: correlation of what both encoders are off their own smooth motion, from which on it is the time that is wrong.
      alone: share of what one encoder is off its own smooth motion that must go with the speed, for the time to be wrong.
      least: error of the time [s] below which it is none: no motion is smoother.
      ripple: angle [rad] by which a ripple of the gear or the motor may go on between two samples that are looked at for that.
      periods: parts of the median interval that are tried as the period of the clock behind a log.
      steadier: a log's samples are even and its stamps are not where the clock's own times make the motion so much smoother.
    """

    slower: float = 0.75
    fewest: int = 50
    together: float = 0.5
    alone: float = 0.7
    least: float = 5e-6
    ripple: float = 0.5
    periods: int = 8
    steadier: float = 0.7


SETTINGS = SamplingSettings()
_BLOCK = 1 << 16
"""Samples that are looked at together, for an hour to fit into memory."""


def is_slower(time: np.ndarray, rate: float) -> bool:
    """Whether a sensor of a rate [Hz] is slower than a log of samples at times [s], shape (n,)."""
    return rate * float(np.median(np.diff(time))) <= SETTINGS.slower


def fresh(time: np.ndarray, reading: np.ndarray, rate: float) -> np.ndarray:
    """Which samples the sensor read anew, shape (n,), bool: where the value changed, or its period was over.

    Args:
      time: of the samples [s], shape (n,).
      reading: shape (n,).
      rate: of the sensor [Hz]; everything is fresh where the log is not faster.
    """
    found = np.ones(len(time), bool)
    if len(time) < 3 or not is_slower(time, rate):
        return found
    changed = np.diff(reading) != 0
    period, last = 0.999 / rate, time[0]
    for k in range(1, len(time)):
        found[k] = changed[k - 1] or time[k] - last >= period
        if found[k]:
            last = time[k]
    return found


def between(time: np.ndarray, at: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Values known at some times, at other times: the cubic spline through them, constant beyond its ends."""
    if len(at) < 4 or len(at) == len(time):
        return np.interp(time, at, values)
    return CubicSpline(at, values)(np.clip(time, at[0], at[-1]))


@np.errstate(over="ignore", invalid="ignore")  # of readings that no encoder gives
def timing_error(time: np.ndarray, motor: np.ndarray, link: np.ndarray) -> float:
    """Standard deviation [s] of the error of a recording's time stamps; zero where the encoders do not show any.

    A sample with a wrong time is off the motion at both encoders at once, by their speeds times that error: encoder noise
    is not, and a rotor that trembles leaves the link where it is.

    Args:
      time: of the samples of one segment [s], shape (n,).
      motor, link: readings of both encoders [rad], shape (n,).
    """
    if len(time) < SETTINGS.fewest:
        return 0.0
    (a, v), (b, u) = (_off(time, x) for x in (motor, link))
    moving = np.abs(v) > 0.2 * np.sqrt(np.mean(v * v))
    if moving.sum() < SETTINGS.fewest:
        return 0.0
    a, b, speeds = a[moving], b[moving], np.mean((v * u)[moving])
    common = np.mean(a * b)
    if speeds <= 0 or common <= SETTINGS.together * np.sqrt(np.mean(a * a) * np.mean(b * b)):
        return 0.0
    return float(np.sqrt(common / speeds))


@np.errstate(over="ignore", invalid="ignore")
def timing_error_of_one(time: np.ndarray, reading: np.ndarray, order: float) -> float:
    """Standard deviation [s] of the error of a recording's time stamps, as one encoder has it; zero where it does not show any.

    By how much its samples are off the smooth motion goes with the speed then, and nearly all of it does: an encoder's noise
    is the same at any speed. A ripple that two samples hardly resolve would look like it: such speeds are not asked.

    Args:
      time: of the samples of one segment [s], shape (n,).
      reading: of the encoder [rad], shape (n,).
      order: largest of a ripple, per turn of the encoder's own shaft.
    """
    if len(time) < SETTINGS.fewest:
        return 0.0
    off, v = _off(time, reading)
    slow = np.abs(v) * order * float(np.median(np.diff(time))) < SETTINGS.ripple
    if slow.sum() < SETTINGS.fewest:
        return 0.0
    squares, speeds = off[slow] ** 2, v[slow] ** 2
    spread = speeds - np.mean(speeds)
    slope = float(np.sum(spread * squares) / max(np.sum(spread**2), 1e-300))
    if slope <= SETTINGS.least**2 or slope * np.mean(speeds) <= SETTINGS.alone * np.mean(squares):
        return 0.0
    return float(np.sqrt(slope))


def _off(t: np.ndarray, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Samples less the cubic through two neighbours on either side, as noise of one sample; and the speed there."""
    n = max(len(t) - 4, 0)
    off, speed = np.empty(n), np.empty(n)
    for begin in range(0, n, _BLOCK):
        part = slice(begin, begin + _BLOCK + 4)
        off[begin : begin + _BLOCK], speed[begin : begin + _BLOCK] = _off_within(t[part], x[part])
    return off, speed


def _off_within(t: np.ndarray, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    i = np.arange(2, len(t) - 2)
    others = [i - 2, i - 1, i + 1, i + 2]
    weights = [np.prod([(t[i] - t[b]) / (t[a] - t[b]) for b in others if b is not a], axis=0) for a in others]
    off = x[i] - sum(w * x[a] for w, a in zip(weights, others, strict=True))
    speed = (x[i + 1] - x[i - 1]) / (t[i + 1] - t[i - 1])
    return off / np.sqrt(1 + sum(w * w for w in weights)), speed


def clock_times(time: np.ndarray, motor: np.ndarray, link: np.ndarray) -> np.ndarray | None:
    """Times [s] of the samples by the clock that took them, shape (n,), where they are not the stamps; None where they are.

    Controllers sample evenly and stamp late: a wrong stamp throws both encoders off their smooth motion at once. Times
    that are whole periods apart are believed where they make both motions smoother.

    Args:
      time: stamps of one segment [s], shape (n,).
      motor, link: readings of both encoders [rad], shape (n,).
    """
    if timing_error(time, motor, link) == 0.0:
        return None
    rough = _roughness(time, motor, link)
    best: np.ndarray | None = None
    interval = float(np.median(np.diff(time)))
    for part in range(1, SETTINGS.periods + 1):
        even = _on_clock(time, interval / part)
        if even is None:
            continue
        now = _roughness(even, motor, link)
        if np.all(now < SETTINGS.steadier * rough):
            best, rough = even, now
    return best


def _on_clock(time: np.ndarray, period: float) -> np.ndarray | None:
    """The nearest times that are whole periods apart, the period fitted; None where the stamps do not follow such a clock.

    The period is known better the longer one looks: it is fitted to a beginning that doubles, so that ticks never slip.
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
    # Two samples of one tick: the later one belongs to the next, or the earlier one to the one before.
    for k in np.flatnonzero(np.diff(ticks) <= 0):
        if k + 2 >= n or ticks[k + 2] > ticks[k] + 1:
            ticks[k + 1] = ticks[k] + 1
        elif k == 0 or ticks[k - 1] < ticks[k + 1] - 1:
            ticks[k] = ticks[k + 1] - 1
    return start + slope * ticks if np.all(np.diff(ticks) >= 1) else None


def _roughness(time: np.ndarray, motor: np.ndarray, link: np.ndarray) -> np.ndarray:
    """Root mean square by which both encoders are off their own smooth motion where they move [rad], shape (2,)."""
    found = []
    for x in (motor, link):
        off, speed = _off(time, x)
        moving = np.abs(speed) > 0.2 * np.sqrt(np.mean(speed * speed))
        found.append(np.sqrt(np.mean(off[moving] ** 2)))
    return np.array(found)
