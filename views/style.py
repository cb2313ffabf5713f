"""What all pictures share: one colour per signal, and fewer points per line without losing its peaks.

The colours (after Okabe and Ito, safe for colour-blind eyes) are legible on white figures and in Rerun's dark viewer.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

TRUTH = "#00A878"
"""Noise-free truth of the plant."""
SENSOR = "#9AA3AD"
"""Torque sensor."""
MODEL = "#C8B68E"
"""Raw compliance model, before any filter."""
EXTERNAL = "#CC6FA8"
"""Torque on the link from outside."""
COMMAND = "#7D8690"
"""What the drive is asked for."""
FILTERS = {"EKF": "#3D8FE0", "AREKF": "#E8A100", "RAREKF": "#E0533D", "REKF": "#9A6FCB"}
"""Filters by name; others take `SPARE` in their order."""
SPARE = ("#17BECF", "#8C9A2B", "#E377C2", "#8C6D4F")
PARTS = {
    "total": "#9AA3AD", "flexspline": "#3D8FE0", "wave_generator": "#E8A100", "kinematic_error": "#CC6FA8",
}  # fmt: skip
"""Torsion and its parts."""

MAIN = "RAREKF"
"""The paper's filter, which pictures of one filter show."""


def filter_colors(names: Iterable[str]) -> dict[str, str]:
    """Colour of each filter; the same name has the same colour everywhere."""
    names = list(names)
    spare = [name for name in names if name not in FILTERS]
    return {name: FILTERS.get(name) or SPARE[spare.index(name) % len(SPARE)] for name in names}


def main_filter(names: Iterable[str]) -> str:
    """The filter that a picture of only one shows: the paper's, or else the last."""
    names = list(names)
    return MAIN if MAIN in names else names[-1]


def thin(values: np.ndarray, points: int, keep: np.ndarray | None = None) -> np.ndarray:
    """Indices of the samples that draw a line as well as all do: the lowest and the highest of each bucket.

    Args:
      values: shape (n,).
      points: about how many samples to leave, at least those of `keep`.
      keep: samples that stay whatever they are (the interesting stretches), shape (n,), bool.

    Returns:
      Increasing indices, first and last sample included.
    """
    n = len(values)
    if n <= points:
        return np.arange(n)
    kept = np.zeros(n, dtype=bool) if keep is None else np.array(keep, dtype=bool)
    kept[[0, -1]] = True
    size = int(np.ceil(2 * n / max(points - np.count_nonzero(kept), 64)))
    whole = n // size * size
    buckets = np.asarray(values)[:whole].reshape(-1, size)
    start = np.arange(0, whole, size)
    kept[start + buckets.argmin(axis=1)] = True
    kept[start + buckets.argmax(axis=1)] = True
    return np.flatnonzero(kept)


def share(flags: np.ndarray, samples: int) -> np.ndarray:
    """Moving share of true flags over a centred window, shape (n,), from 0 to 1; shorter at both ends."""
    window = np.ones(min(max(samples, 1), len(flags)))
    count = np.convolve(np.asarray(flags, dtype=float), window, mode="same")
    return count / np.convolve(np.ones(len(flags)), window, mode="same")
