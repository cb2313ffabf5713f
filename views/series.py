"""Time series for drawing: as few points as pixels can show, with all peaks."""

from __future__ import annotations

import numpy as np


def envelope(values: np.ndarray, columns: int, keep: np.ndarray | None = None) -> np.ndarray:
    """Return the increasing indices, shape (k,), of samples that draw the same line as all values, shape (n,): lowest
    and highest of each column, the first and the last; all if there are at most 2 · columns.

    Samples that are not finite are gaps, and a column that has one keeps one. `columns`: of pixels; `keep`: samples to
    keep in any case, shape (n,), bool.
    """
    values = np.asarray(values)
    n = len(values)
    if n <= 2 * columns:
        return np.arange(n)
    kept = np.zeros(n, dtype=bool) if keep is None else np.array(keep, dtype=bool)
    columns = max(columns, 1)
    left = max(columns - int(np.count_nonzero(kept)) // 2, min(columns, 32))
    kept[[0, -1]] = True
    size = -(-n // left)
    start = np.arange(0, n, size)
    buckets = np.pad(values.astype(float), (0, -n % size), constant_values=np.nan).reshape(-1, size)
    there = np.isfinite(buckets)
    kept[start + np.where(there, buckets, np.inf).argmin(axis=1)] = True
    kept[start + np.where(there, buckets, -np.inf).argmax(axis=1)] = True
    gap = (start + there.argmin(axis=1))[~there.all(axis=1)]
    kept[gap[gap < n]] = True
    return np.flatnonzero(kept)


def extremes(values: np.ndarray, columns: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the outline of a noisy line of finite values, shape (n,): index of the middle sample, lowest and highest
    value of each column of pixels, shape (about columns,) each."""
    n = len(values)
    start = np.arange(0, n, -(-n // columns))
    middle = (start + np.append(start[1:], n)) // 2
    return middle, np.minimum.reduceat(values, start), np.maximum.reduceat(values, start)


def share(flags: np.ndarray, samples: int) -> np.ndarray:
    """Return the mean of flags or values over a centred window of `samples`, fewer at the ends; shape (n,)."""
    n, width = len(flags), max(min(samples, len(flags)), 1)
    total = np.concatenate([[0.0], np.cumsum(flags, dtype=float)])
    low = np.clip(np.arange(n) - width // 2, 0, n)
    high = np.clip(np.arange(n) + (width + 1) // 2, 0, n)
    return (total[high] - total[low]) / (high - low)
