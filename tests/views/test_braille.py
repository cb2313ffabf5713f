"""Curves in a terminal: as wide as asked for, from corner to corner."""

from __future__ import annotations

import numpy as np

from flexspline.views.braille import plotted

EMPTY = "\u2800"


def test_a_straight_line_goes_from_corner_to_corner():
    x = np.linspace(0, 3, 7)
    title, *rows, below = plotted("a line", x, [2 * x - 1], 40, 5, ("0", "3"), "N·m")
    assert title.rstrip() == "a line [N·m]" and len(rows) == 5
    assert all(len(line) == 40 for line in (title, *rows, below))
    assert rows[0].split()[0] == "5" and rows[-1].split()[0] == "-1"
    assert rows[-1][3] != EMPTY and rows[0][-1] != EMPTY and rows[0][3] == EMPTY == rows[-1][-1]
    assert all(any(c > EMPTY for c in row) for row in rows)
    assert below.strip() == "0" + below.strip()[1:-1] + "3"


def test_a_curve_that_does_not_move_is_drawn_too():
    rows = plotted("rest", np.arange(3.0), [np.ones(3)], 20, 3, ("", ""), "A")
    assert any(c > EMPTY for c in "".join(rows))
