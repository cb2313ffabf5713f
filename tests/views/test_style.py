"""One colour per signal."""

from __future__ import annotations

from flexspline.views.style import FILTERS, SPARE, filter_colors, main_filter


def test_a_filter_has_the_same_colour_whatever_stands_beside_it():
    assert (
        filter_colors(["EKF", "RAREKF"])["RAREKF"] == filter_colors(["RAREKF", "mine"])["RAREKF"] == FILTERS["RAREKF"]
    )
    own = filter_colors(["one", "EKF", "two"])
    assert (own["one"], own["two"]) == SPARE[:2]


def test_main_filter_is_the_papers_or_the_last():
    assert main_filter(["RAREKF", "EKF"]) == "RAREKF"
    assert main_filter(["EKF", "mine"]) == "mine"
