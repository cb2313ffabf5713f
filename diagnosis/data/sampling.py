"""What a log does to readings: slow sensors are held, time stamps are wrong.

A sensor of 100 Hz in a log of 1 kHz says everything ten times. Taken as they are, such steps are late by half the
sensor's period, each channel by its own, and their noise comes ten times too. Only fresh readings are news: the log is
thinned to the encoders', and slower channels are interpolated between theirs.
"""

from __future__ import annotations

import numpy as np
from scipy.interpolate import CubicSpline

_SLOWER = 0.75
"""A sensor is slower than the log where its rate is below so much of the log's."""


def fresh(time: np.ndarray, reading: np.ndarray, rate: float) -> np.ndarray:
    """Which samples the sensor read anew, shape (n,), bool: where the value changed, or its period was over.

    Args:
      time: of the samples [s], shape (n,).
      reading: shape (n,).
      rate: of the sensor [Hz]; everything is fresh where the log is not faster.
    """
    found = np.ones(len(time), bool)
    if len(time) < 3 or rate * float(np.median(np.diff(time))) > _SLOWER:
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


_FEWEST = 50
"""Samples in motion below which nothing is said about the time stamps."""
_TOGETHER = 0.5
"""Correlation of what both encoders are off their own smooth motion, from which on it is the time that is wrong."""


def timing_error(time: np.ndarray, motor: np.ndarray, link: np.ndarray) -> float:
    """Standard deviation [s] of the error of a recording's time stamps; zero where the encoders do not show any.

    A sample with a wrong time is off the motion at both encoders at once, by their speeds times that error: encoder noise
    is not, and a rotor that trembles leaves the link where it is.

    Args:
      time: of the samples of one stretch [s], shape (n,).
      motor, link: readings of both encoders [rad], shape (n,).
    """
    if len(time) < _FEWEST:
        return 0.0
    (a, v), (b, u) = (_off(time, x) for x in (motor, link))
    moving = np.abs(v) > 0.2 * np.sqrt(np.mean(v * v))
    if moving.sum() < _FEWEST:
        return 0.0
    a, b, speeds = a[moving], b[moving], np.mean((v * u)[moving])
    common = np.mean(a * b)
    if speeds <= 0 or common <= _TOGETHER * np.sqrt(np.mean(a * a) * np.mean(b * b)):
        return 0.0
    return float(np.sqrt(common / speeds))


def _off(t: np.ndarray, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Samples less the cubic through two neighbours on either side, as noise of one sample; and the speed there."""
    i = np.arange(2, len(t) - 2)
    others = [i - 2, i - 1, i + 1, i + 2]
    weights = [np.prod([(t[i] - t[b]) / (t[a] - t[b]) for b in others if b is not a], axis=0) for a in others]
    off = x[i] - sum(w * x[a] for w, a in zip(weights, others, strict=True))
    speed = (x[i + 1] - x[i - 1]) / (t[i + 1] - t[i - 1])
    return off / np.sqrt(1 + sum(w * w for w in weights)), speed
