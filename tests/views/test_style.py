"""One colour per signal; thinning keeps peaks."""

from __future__ import annotations

import numpy as np
from flexspline.views.style import FILTERS, SPARE, filter_colors, main_filter, share, thin


def test_a_filter_has_the_same_colour_whatever_stands_beside_it():
    assert (
        filter_colors(["EKF", "RAREKF"])["RAREKF"] == filter_colors(["RAREKF", "mine"])["RAREKF"] == FILTERS["RAREKF"]
    )
    own = filter_colors(["one", "EKF", "two"])
    assert (own["one"], own["two"]) == SPARE[:2]


def test_main_filter_is_the_papers_or_the_last():
    assert main_filter(["RAREKF", "EKF"]) == "RAREKF"
    assert main_filter(["EKF", "mine"]) == "mine"


def test_thinning_keeps_ends_peaks_and_what_it_is_told_to(rng):
    values = rng.normal(size=50_000)
    values[31_234] = 50.0
    values[7] = -50.0
    keep = np.zeros(len(values), dtype=bool)
    keep[1000:1100] = True
    i = thin(values, 2000, keep)
    assert np.all(np.diff(i) > 0)
    assert {0, 7, 31_234, 49_999} <= set(i)
    assert np.isin(np.arange(1000, 1100), i).all()
    assert len(i) <= 2200


def test_thinning_leaves_short_series_alone():
    assert np.array_equal(thin(np.arange(10.0), 100), np.arange(10))


def test_share_of_constant_flags_is_constant_to_the_ends():
    assert np.allclose(share(np.ones(50, dtype=bool), 11), 1.0)
    assert np.allclose(share(np.zeros(50, dtype=bool), 11), 0.0)
    assert np.isclose(share(np.arange(1000) % 4 == 0, 400)[500], 0.25, atol=0.01)
