"""What pages are made of: numbers as people write them, charts whose paths stay where the data are."""

from __future__ import annotations

import math
import re

import numpy as np
import pytest
from jinja2 import UndefinedError

from flexspline.views.numbers import number, percent, with_std
from flexspline.views.pages.chart import Chart, limits, ticks
from flexspline.views.pages.rendering import render, sentence


@pytest.mark.parametrize(
    ("value", "text"),
    [(0.0, "0"), (-0.5, "−0.5"), (8400.0, "8400"), (10059.8, "10060"), (6e-5, "6·10⁻⁵"), (-1.25e7, "−1.25·10⁷")],
)
def test_numbers_for_people(value, text):
    assert number(value) == text


@pytest.mark.parametrize(
    ("value", "std", "unit", "text"),
    [
        (0.28213, 0.00021, "", "0.2821 ± 0.0002"), (8790.4, 14.2, "N·m/rad", "8790 ± 14 N·m/rad"),
        (1.731e-4, 2.4e-7, "rad", "(1.731 ± 0.002)·10⁻⁴ rad"), (-1.4483e-3, 4.2e-7, "rad", "(−1.4483 ± 0.0004)·10⁻³ rad"),
        (2.0, 0.0, "1", "2"), (0.0, 0.012, "A", "0.000 ± 0.012 A"), (3.0, float("inf"), "A", "3 A"),
    ],
)  # fmt: skip
def test_as_many_digits_as_the_deviation_bears(value, std, unit, text):
    assert with_std(value, std, unit) == text


def test_numbers_that_are_none_are_shown_as_such():
    assert [number(x) for x in (math.inf, -math.inf, math.nan)] == ["inf", "−inf", "nan"]


def test_shares_and_sentences():
    assert percent(0.987) == "99 %"
    assert (
        percent(-0.431, sign=True) == "−43 %"
        and percent(0.05, sign=True) == "+5 %"
        and percent(-1e-9, sign=True) == "0 %"
    )
    assert sentence("mesh friction is scaled.") == "Mesh friction is scaled."


def test_what_a_template_needs_and_does_not_get_is_an_error():
    with pytest.raises(UndefinedError):
        render("diagnosis.html.j2", {})


def points(d: str) -> np.ndarray:
    return np.array(re.findall(r"[ML](-?[\d.]+) (-?[\d.]+)", d), float)


def test_a_line_keeps_its_peaks_and_its_gaps():
    chart = Chart((0.0, 10.0), (-1.0, 1.0))
    y = np.zeros(10_000)
    y[7003], y[2000:3000] = 1.0, np.nan
    chart.line(np.linspace(0, 10, 10_000), y, "measured")
    (mark,) = chart.marks
    assert mark.kind == "line measured" and mark.d.count("M") == 2
    drawn = points(mark.d)
    assert drawn[:, 1].min() == 0.0  # the peak, at the upper end
    assert np.max(np.diff(drawn[:, 0])) == pytest.approx(chart.inner[0] / 10, rel=0.05)
    assert len(drawn) <= 2.5 * chart.inner[0]
    assert drawn[-1] == pytest.approx([chart.inner[0], chart.inner[1] / 2], abs=0.1)  # and no fall to zero


def test_boxes_bands_and_stripes_stand_at_their_places():
    chart = Chart((0.0, 2.0), (0.0, 4.0))
    chart.boxes([(1.0, 2.0, 0.0, 2.0)], "before")
    w, h = chart.inner
    assert chart.marks[0].d == f"M{w / 2:.1f} {h / 2:.1f}H{w:.1f}V{h:.1f}H{w / 2:.1f}z"
    chart.band(1.0, 3.0, "noise")
    assert chart.marks[1].d == f"M0.0 {h / 4:.1f}H{w:.1f}V{3 * h / 4:.1f}H0.0z"
    chart.stripes([(0.0, 1.0)], "held-out")
    assert chart.marks[2].d == f"M0.0 0.0H{w / 2:.1f}V{h:.1f}H0.0z"


def test_ticks_are_round_and_within():
    np.testing.assert_allclose(ticks(-0.31, 0.52, 4), [-0.25, 0, 0.25, 0.5])
    chart = Chart((0.0, 3.0), (-1.0, 1.0), labels=((1.0, "one"),))
    assert [(t.text, t.at) for t in chart.xticks] == [("one", pytest.approx(chart.inner[0] / 3))]
    assert all(0 <= t.at <= chart.inner[1] for t in chart.yticks)


def test_limits_leave_out_what_is_rare_and_missing():
    values = np.concatenate([np.linspace(-1, 1, 2001), [1e6, np.nan]])
    low, high = limits(values, share=0.5, margin=0.0)
    assert -1 <= low < -0.98 and 0.98 < high <= 1
    assert limits(values * 0, least=2.0, margin=0.0) == (-2.0, 2.0)
    assert limits(np.array([np.nan])) == (-1.0, 1.0)
