"""Tables and figures of limits and tuning: they say what the numbers say."""

from __future__ import annotations

from dataclasses import replace

import matplotlib.image
import numpy as np
import pytest
from terminal import rendered

from flexspline.estimator import registry
from flexspline.estimator.consistency import Mean
from flexspline.scenarios.evaluation.limits import Assessment, Limits
from flexspline.scenarios.evaluation.tuning import Front, Tuned, with_parameters
from flexspline.views import limit_figures, limit_tables, tables
from flexspline.views.figures.sheet import save


@pytest.fixture
def limits() -> Limits:
    time = 0.05 + 0.1 * np.arange(40)
    mean = Mean(0.5, 0.9, 1.1, 100)
    return Limits(
        "external_push", np.arange(1, 4), time, 1.0, 1.3, 1.3, np.full(40, 0.01), 0.01, 0.7, np.full(40, 0.02), 0.02,
        1.0, np.full(40, 0.015), 0.015, 0.02,
        (
            Assessment("RAREKF", True, np.array([0.05, 0.06, 0.055]), np.full(40, 0.055), mean, mean, np.ones(40), 0.9,
                       np.linspace(0.3, 0, 50), 0.4, 0.01),
            Assessment("rts_smoother", False, np.full(3, 0.008), np.full(40, 0.008)),
            Assessment("lost", True, np.full(3, np.nan), np.zeros(0)),
        ),
    )  # fmt: skip


def test_rows(limits):
    rows = {row["estimator"]: row for row in limit_tables.summary_rows([limits])}
    assert rows["RAREKF"]["ratio"] == pytest.approx(5.52, abs=0.005) and rows["RAREKF"]["nis_low"] == 0.9
    assert rows["rts_smoother"]["nis"] is None and np.isnan(rows["lost"]["rms"])
    shown = [line.split()[0] for line in rendered(limit_tables.limits_table(limits)).splitlines() if line.strip()]
    assert [name for name in shown if name in rows] == ["rts_smoother", "RAREKF", "lost"]  # by error, diverged last


def test_tuned_rows():
    ekf = registry.get("EKF")
    one = Tuned(
        "EKF",
        ekf,
        with_parameters(ekf, {"W": 1e-8}),
        {"W": 1e-8},
        (0.1, 0.05),
        9,
        np.array([[0.1, 0.12]]),
        np.array([[0.06, 0.06]]),
        ("W",),
    )
    (row,) = limit_tables.tuned_rows([one])
    assert row[0] == "EKF" and row[1:3] == ("0.1000", "0.0500") and row[4] == "0.0600"
    assert row[5].startswith("-0.0500 [") and row[6] == "W 1e-08!"
    assert tables.markdown_table(("a", "b"), [("x", "1")]) == "| a | b |\n|---|---:|\n| x | 1 |"


def test_limits_are_whole_at_80_columns(limits):
    longest = replace(limits.estimators[0], name="x" * 24)  # five more than any estimator's name has
    text = rendered(limit_tables.limits_table(replace(limits, estimators=(*limits.estimators[:2], longest))))
    head = text.split("─")[0].split("model 0.0200 N·m")[1].split()
    assert {"estimator", "RMS", "[N·m]", "times", "bound", "NIS", "NEES", "inside", "ρ", "outside"} <= set(head)
    assert head.count("[%]") == 2 and " ".join(head).count("95") == 2
    lines = [line.split() for line in text.splitlines()]
    assert ["x" * 24, "0.0552", "5.52", "0.50", "0.50", "90", "40"] in lines
    assert ["0.90–1.10", "0.90–1.10"] in lines
    assert ["(not", "causal)"] in lines
    assert any(
        line.split()[:2] == ["lost", "diverged"] for line in rendered(limit_tables.limits_table(limits)).splitlines()
    )


def test_tuned_is_whole_at_80_columns():
    ekf = replace(registry.get("dynamics_ekf"), name="dynamics_ekf_by_another_name")
    default, better = np.array([[0.1, 0.12]]), np.array([[0.06, 0.061]])
    one = Tuned(ekf.name, ekf, ekf, {"W": 1e-8, "rho": 0.25}, (0.1, 0.05), 9, default, better, ("W",))
    text = rendered(limit_tables.tuned_table([one], "external_push: tuned on seeds 1-5"))
    head = text.split("─")[0].split()
    assert {"filter", "training", "test", "difference", "tuning"} <= set(head) and head.count("[N·m]") == 3
    row = limit_tables.tuned_rows([one])[0]
    flat = " ".join(text.split())
    for cell in (*row[:5], *row[5].replace("[", "").replace("]", "").replace(",", "").split(), "W 1e-08!", "rho 0.25"):
        assert cell in flat, cell


def test_limits_figure(limits, tmp_path):
    figure = limit_figures.limits_figure(limits)
    top, nis, nees, whiteness = figure.axes
    labels = [line.get_label() for line in top.lines]
    assert {"RAREKF", "rts_smoother", "bound, joint's dynamics"} <= set(labels) and "lost" not in labels
    assert top.get_yscale() == "log" and [t.get_text() for t in nis.get_yticklabels()] == ["RAREKF"]
    assert len(nees.lines) == 3 and len(whiteness.lines) == 1
    path = save(figure, tmp_path / "limits.png", 110)
    assert np.ptp(matplotlib.image.imread(path)) > 0.5


def test_pareto_figure():
    front = Front("RAREKF", np.array([[-0.4, 0.05], [0.5, 0.03], [8.0, 0.01]]), ({}, {}, {}), (2.0, 0.03), (1.0, 0.02))
    alone = Front("model", np.array([[0.3, 0.04]]), ({},), (0.3, 0.04))
    figure = limit_figures.pareto_figure([front, alone], "external_push", 5)
    curve = figure.axes[0].lines[0]
    assert list(curve.get_xdata()) == [0.1, 0.5, 8.0]  # what is early is drawn at the axis' end
    assert {line.get_label() for line in figure.axes[0].lines} >= {"RAREKF", "model"}
