"""Curves for a terminal: eight dots a character, axes in words."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

_DOTS = ((0x01, 0x08), (0x02, 0x10), (0x04, 0x20), (0x40, 0x80))
_EMPTY = 0x2800


def plotted(
    title: str, x: np.ndarray, curves: Sequence[np.ndarray], width: int, height: int, ends: tuple[str, str], unit: str
) -> list[str]:
    """Curves over one axis as lines of text.

    Args:
      title: above.
      x: shape (n,); curves: shape (n,) each.
      width, height: of the plot in characters, with numbers.
      ends: what stands at the left and right end of the horizontal axis; unit: of the vertical one.

    Returns:
      `height` + 2 lines of `width` characters.
    """
    low, high = min(float(c.min()) for c in curves), max(float(c.max()) for c in curves)
    high = high if high > low else low + 1.0
    labels = [f"{high:.3g}", f"{low:.3g}"]
    margin = max(len(label) for label in labels) + 1
    columns = width - margin
    grid = np.zeros((4 * height, 2 * columns), bool)
    left, right = float(x.min()), float(x.max())
    # Enough dots between two points that none is missing.
    at = np.linspace(0, len(x) - 1, 2 * columns * (len(x) - 1))
    across = (np.interp(at, np.arange(len(x)), x) - left) / (right - left)
    column = np.rint(across * (2 * columns - 1)).astype(int)
    for curve in curves:
        up = (np.interp(at, np.arange(len(x)), curve) - low) / (high - low)
        grid[np.rint((1 - up) * (4 * height - 1)).astype(int), column] = True
    lines = [f"{title} [{unit}]".ljust(width)]
    for r in range(height):
        label = labels[0] if r == 0 else labels[1] if r == height - 1 else ""
        cells = grid[4 * r : 4 * r + 4].reshape(4, columns, 2)
        codes = [sum(_DOTS[i][j] for i in range(4) for j in range(2) if cells[i, c, j]) for c in range(columns)]
        lines.append(label.rjust(margin - 1) + " " + "".join(chr(_EMPTY + code) for code in codes))
    begin, end = ends
    lines.append(" " * margin + begin + end.rjust(columns - len(begin)))
    return lines
