"""Readings that a log holds longer than it samples: a sensor of 100 Hz in a log of 1 kHz says everything ten times.

Taken as they are, such steps are late by half the sensor's period, each channel by its own, and their noise comes ten
times too. Only fresh readings are news: the log is thinned to the encoders', and slower channels are interpolated between
theirs.
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
