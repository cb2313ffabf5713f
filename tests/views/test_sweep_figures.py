"""A study's figures: what runs across, what has panels, and that the points are the aggregates' means and intervals."""

from __future__ import annotations

import io
import itertools

import numpy as np
import pytest
from rich.console import Console

from flexspline.scenarios.studies.statistics import Aggregate, Interval
from flexspline.scenarios.studies.study import Study
from flexspline.views.sweep_figures import sweep_figure
from flexspline.views.sweep_tables import layout, sweep_rows, sweep_table


def study(axes) -> Study:
    return Study.model_validate(
        {
            "name": "s", "seeds": {"count": 9}, "scenarios": ["link_sweep"], "axes": axes, "metrics": ["rms", "delay_ms"],
            "filters": [{"name": "EKF", "rule": "ekf"}, {"name": "RAREKF", "rule": "rarekf"}],
        }
    )  # fmt: skip


def summary(filter: str, mean: float, **columns) -> Aggregate:
    one, none = Interval(mean, mean - 0.1, mean + 0.1, 9), Interval(np.nan, np.nan, np.nan, 0)
    differences = {} if filter == "RAREKF" else {"rms": Interval(0.5, 0.4, 0.6, 9), "delay_ms": none}
    return Aggregate("link_sweep", columns, filter, 9, 0, {"rms": one, "delay_ms": none}, differences)


CAUSES = study([{"kind": "cause", "causes": ["stiffness", "hysteresis"], "sizes": [0, 1, 2]}])
OF_CAUSES = [
    summary(f, m + i, cause=c, size=s)
    for (c, s, m) in [("none", 0.0, 1.0), ("stiffness", 1.0, 2.0), ("stiffness", 2.0, 3.0), ("hysteresis", 1.0, 4.0),
                      ("hysteresis", 2.0, 5.0)]
    for i, f in enumerate(("EKF", "RAREKF"))
]  # fmt: skip


def test_a_cause_has_a_panel_that_begins_without_any():
    assert layout(OF_CAUSES, CAUSES) == ("size", [{"cause": "stiffness"}, {"cause": "hysteresis"}])
    figure = sweep_figure(OF_CAUSES, CAUSES, "rms")
    panels = [axes for axes in figure.axes if axes.get_visible()]
    assert [axes.get_title(loc="left") for axes in panels] == ["stiffness", "hysteresis"]
    for axes, means in zip(panels, ([1, 2, 3], [1, 4, 5]), strict=True):
        line = axes.containers[0]  # error bars of the first filter
        np.testing.assert_allclose(line.lines[0].get_ydata(), means)
        low, high = np.array([segment[:, 1] for segment in line.lines[2][0].get_segments()]).T
        np.testing.assert_allclose(high - low, 0.2)
        assert [t.get_text() for t in axes.get_xticklabels()] == ["0", "1", "2"]


def test_differences_leave_out_the_reference():
    figure = sweep_figure(OF_CAUSES, CAUSES, "rms", differences=True)
    assert [[c.get_label() for c in axes.containers] for axes in figure.axes if axes.get_visible()] == [["EKF"]] * 2
    np.testing.assert_allclose(figure.axes[0].containers[0].lines[0].get_ydata(), 0.5)


def test_no_figure_of_what_has_no_value():
    assert sweep_figure(OF_CAUSES, CAUSES, "delay_ms") is None


@pytest.fixture
def of_k() -> list[Aggregate]:
    """EKF is varied by the load alone, RAREKF by k too."""
    found = []
    for load in (3.0, 9.0):
        found.append(summary("EKF", load, load=load, k=None))
        found += [summary("RAREKF", load + k, load=load, k=k) for k in (0.0, 1.0)]
    return found


def test_a_filter_that_an_axis_does_not_vary_stands_all_along_it(of_k):
    asked = study(
        [
            {"kind": "load", "values": [3, 9]},
            {"kind": "set", "name": "k", "key": "filters.RAREKF.k", "values": [0, 1]},
        ]
    )
    assert layout(of_k, asked) == ("k", [{"load": 3.0}, {"load": 9.0}])
    figure = sweep_figure(of_k, asked, "rms")
    for axes, load in zip([a for a in figure.axes if a.get_visible()], (3, 9), strict=True):
        ekf, rarekf = (c.lines[0].get_ydata() for c in axes.containers)
        np.testing.assert_allclose(ekf, [load, load])
        np.testing.assert_allclose(rarekf, [load, load + 1])
    table = [(columns["load"], columns["k"], set(of)) for _, columns, of in sweep_rows(of_k)]
    assert table == [(load, k, {"EKF", "RAREKF"}) for load, k in itertools.product((3.0, 9.0), (0.0, 1.0))]


def rendered(table, width: int) -> list[str]:
    out = io.StringIO()
    Console(file=out, width=width).print(table)
    lines = out.getvalue().splitlines()
    assert max(map(len, lines)) <= width and "…" not in out.getvalue()
    return lines


@pytest.mark.parametrize("width", [80, 132])
def test_a_sweep_is_whole_in_narrow_and_in_wide_terminals(width):
    filters = [{"name": name, "estimator": estimator} for name, estimator in
               (("EKF", "EKF"), ("AREKF", "AREKF"), ("RAREKF", "RAREKF"), ("my_own_filter", "EKF"))]  # fmt: skip
    asked = CAUSES.model_validate(
        {
            "name": "s", "seeds": {"count": 9}, "scenarios": ["external_push"], "metrics": ["rms", "response_ms"],
            "filters": filters,
            "axes": [{"kind": "load", "values": [3, 9]}, {"kind": "set", "name": "level", "key": "plant.K1", "values": [1, 2]}],
        }
    )  # fmt: skip
    one = Interval(0.14524, 0.14494, 0.14554, 9)
    found = [
        Aggregate(
            "external_push", {"load": load, "level": level}, f["name"], 9, 0, {"rms": one, "response_ms": one}, {"rms": one}
        )
        for load in (3.0, 9.0) for level in (1.0, 2.0) for f in filters
    ]  # fmt: skip
    lines = rendered(sweep_table(found, asked, "rms"), width)
    text = " ".join(" ".join(lines).split())
    for part in ("external_push", "load", "level", "RMS error [N·m]", "EKF", "AREKF", "RAREKF", "my_own_filter"):
        assert part in text, part
    assert text.count("0.1452 ± 0.0003") == 16
    many = [line for line in lines if line.count("0.1452 ±") > 1]
    assert bool(many) == (width > 80)  # a column per filter where there is room, else a row
    assert "response [ms]" in " ".join(" ".join(rendered(sweep_table(found, asked, "response_ms"), width)).split())
