"""Time series made fit to be drawn: as few points as pixels can show, without losing a peak."""

from __future__ import annotations

import numpy as np


def envelope(values: np.ndarray, columns: int, keep: np.ndarray | None = None) -> np.ndarray:
    """Indices of the samples that draw a line as well as all do: lowest and highest of each column, in their order.

    Args:
      values: shape (n,); samples that are not finite are gaps, and a column that has one keeps one.
      columns: of pixels that the line is drawn on, at least one; at most about two samples of each stay.
      keep: samples that stay whatever they are (the interesting parts) and count among them, shape (n,), bool.

    Returns:
      Increasing indices, shape (k,), first and last sample included; all where there are no more than 2 · columns.
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
    whole = n // size * size
    finite = np.isfinite(values)
    for part in (slice(0, whole), slice(whole, n)):
        piece, there = values[part], finite[part]
        width = size if part.start == 0 else n - whole
        if not width:
            continue
        start = np.arange(part.start, part.stop, width)
        buckets, there = piece.reshape(-1, width), there.reshape(-1, width)
        if there.all():
            kept[start + buckets.argmin(axis=1)] = True
            kept[start + buckets.argmax(axis=1)] = True
            continue
        kept[start + np.where(there, buckets, np.inf).argmin(axis=1)] = True
        kept[start + np.where(there, buckets, -np.inf).argmax(axis=1)] = True
        gaps = ~there.all(axis=1)
        kept[start[gaps] + there[gaps].argmin(axis=1)] = True
    return np.flatnonzero(kept)


def extremes(values: np.ndarray, columns: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Lowest and highest value of each column: the outline of a line that fills what it runs through.

    Args:
      values: shape (n,), finite.
      columns: of pixels.

    Returns:
      Index of the middle sample, lowest and highest value of each column, shape (about columns,) each.
    """
    n = len(values)
    start = np.arange(0, n, -(-n // columns))
    middle = (start + np.append(start[1:], n)) // 2
    return middle, np.minimum.reduceat(values, start), np.maximum.reduceat(values, start)


def share(flags: np.ndarray, samples: int) -> np.ndarray:
    """Moving share of true flags (or mean of values) over a centred window, shape (n,); shorter at both ends.

    Args:
      flags: shape (n,).
      samples: width of the window.
    """
    flags = np.asarray(flags, dtype=float)
    n, width = len(flags), min(max(samples, 1), len(flags))
    total = np.concatenate([[0.0], np.cumsum(flags)])
    low = np.clip(np.arange(n) - width // 2, 0, n)
    high = np.clip(np.arange(n) + (width + 1) // 2, 0, n)
    return (total[high] - total[low]) / (high - low)
