"""Means over seeds with Student's t intervals, `mean ± t(0.975, n − 1)·s/√n`, and medians with distribution-free ones."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import stdtrit

LEVEL = 0.95


@dataclass(frozen=True)
class Interval:
    """A mean of n values with its confidence interval; NaN for too few values."""

    mean: float
    low: float
    high: float
    n: int

    @property
    def half(self) -> float:
        """Half the interval's width."""
        return 0.5 * (self.high - self.low)

    @property
    def sign(self) -> int:
        """−1 or 1 if the interval is below or above zero, else 0."""
        return -1 if self.high < 0 else 1 if self.low > 0 else 0


def interval(values: np.ndarray | Sequence[float], level: float = LEVEL) -> Interval:
    """Return the mean of independent values, shape (n,), with Student's t interval, without NaN."""
    x = np.asarray(values, dtype=np.float64)
    x = x[np.isfinite(x)]
    n = len(x)
    if n == 0:
        return Interval(math.nan, math.nan, math.nan, 0)
    mean = float(np.mean(x))
    if n == 1:
        return Interval(mean, math.nan, math.nan, 1)
    half = float(stdtrit(n - 1, 0.5 + 0.5 * level) * np.std(x, ddof=1) / math.sqrt(n))
    return Interval(mean, mean - half, mean + half, n)


def paired(values: np.ndarray, reference: np.ndarray) -> Interval:
    """Return the mean of values − reference, shape (n,) each, without NaN."""
    return interval(np.asarray(values, dtype=np.float64) - np.asarray(reference, dtype=np.float64))
