"""Intervals against scipy's; their coverage; pairing; what a dataset's summary says."""

from __future__ import annotations

import csv
import math
from types import SimpleNamespace

import numpy as np
import pytest
from scipy import stats
from small import column, run, study

from flexspline.models.files import yaml_text
from flexspline.scenarios.run import run_scenario
from flexspline.scenarios.scenario import load_scenario
from flexspline.scenarios.studies.statistics import aggregate, counterparts, interval, paired, worst_runs, write_csv
from flexspline.views.sweep_tables import sign_of, sweep_rows


def test_an_interval_is_the_one_of_the_t_test(rng):
    x, y = rng.normal(3, 2, 17), rng.normal(2.5, 1, 17)
    ci = stats.ttest_1samp(x, 0).confidence_interval(0.95)
    got = interval(x)
    assert (got.low, got.high) == pytest.approx((ci.low, ci.high), rel=1e-12)
    assert got.mean == pytest.approx(x.mean(), rel=1e-15) and got.n == 17
    ci = stats.ttest_rel(x, y).confidence_interval(0.95)
    got = paired(x, y)
    assert (got.low, got.high) == pytest.approx((ci.low, ci.high), rel=1e-12)


def test_few_values_and_gaps():
    assert math.isnan(interval(np.array([])).mean)
    one = interval(np.array([2.0]))
    assert one.mean == 2.0 and math.isnan(one.low) and one.sign == 0
    assert interval(np.array([1.0, np.nan, 3.0])).n == 2
    got = paired(np.array([1.0, np.nan, 3.0]), np.array([0.5, 0.5, np.nan]))
    assert (got.mean, got.n) == (0.5, 1)
    assert (interval(np.array([-1.0, -1.1])).sign, interval(np.array([1.0, -1.1])).sign) == (-1, 0)


def test_95_percent_of_intervals_hold_the_mean(rng):
    """Exponential values, n = 30: 2000 intervals, within the binomial's 4 σ of 95 % less what skewness takes (≈ 2 %)."""
    hits = 0
    for x in rng.exponential(1.0, (2000, 30)):
        got = interval(x)
        hits += got.low <= 1.0 <= got.high
    print(f"coverage {hits / 2000:.3f}")
    assert 0.91 < hits / 2000 < 0.965


def test_pairing_takes_out_what_is_common(rng):
    common = rng.normal(0, 1, 50)
    a, b = common + rng.normal(0, 0.01, 50), common + 0.02 + rng.normal(0, 0.01, 50)
    assert paired(a, b).half < 0.05 * interval(a).half
    assert paired(a, b).sign == -1


def test_a_summary_is_of_its_rows(tmp_path):
    axes = [
        {"kind": "set", "name": "k", "key": "filters.RAREKF.k", "values": [0.0, 2.0]},
        {"kind": "load", "values": [3.0, 9.0]},
    ]
    dataset = run(tmp_path / "a", study(scenarios=["link_sweep"], axes=axes, reference="RAREKF"), jobs=1)
    found = list(aggregate(dataset))
    names = ("EKF", "RAREKF", "current")
    assert [(s.filter, s.columns["load"], s.columns["k"]) for s in found[:6]] == [
        (name, 3.0, k) for name in names for k in (0.0, 2.0)
    ]
    assert not found[2].differences and not found[3].differences
    for i, name in ((0, "EKF"), (4, "current")):
        own = np.array(column(dataset, 0, name, "rms"))
        for s, k in zip(found[i : i + 2], (0.0, 2.0), strict=True):
            counterpart = np.array([r["rms"] for r in dataset.read(0).to_pylist() if r["k"] == k])
            assert s.values["rms"] == interval(own)
            assert s.differences["rms"] == paired(own, counterpart)
    write_csv(found, dataset.design, tmp_path / "summary.csv")
    with (tmp_path / "summary.csv").open(encoding="utf-8") as file:
        lines = list(csv.DictReader(file))
    assert len(lines) == len(found)
    assert float(lines[0]["rms_mean"]) == found[0].values["rms"].mean
    assert float(lines[0]["rms_difference_high"]) == found[0].differences["rms"].high


def test_a_variant_is_compared_with_its_own_counterpart():
    """With two axes of filters, the reference's variants with the same settings, all; the reference itself with nothing."""

    def variant(name, **columns):
        return SimpleNamespace(name=name, columns=columns)

    variants = (
        variant("EKF", W=1.0), variant("EKF", W=2.0), variant("current"),
        variant("RAREKF", W=1.0, k=0.0), variant("RAREKF", W=2.0, k=0.0), variant("RAREKF", W=2.0, k=0.5),
    )  # fmt: skip
    design = SimpleNamespace(study=SimpleNamespace(compared_to="RAREKF"), variants=variants)
    found = [counterparts(design, i) for i in range(6)]
    assert [[j for j, _ in some] for some in found] == [[3], [4, 5], [3, 4, 5], [3], [4], [5]]
    assert [columns for _, columns in found[1]] == [{"W": 2.0, "k": 0.0}, {"W": 2.0, "k": 0.5}]


def test_marks_are_against_the_variant_in_the_same_row(tmp_path):
    """Settings of all filters, and of the reference alone: no mark of a row is of another row's reference."""
    axes = [
        {"kind": "set", "name": "W", "key": "filters.*.W", "values": [1e-5, 1e-4]},
        {"kind": "set", "name": "V", "key": "filters.RAREKF.V", "values": [1e-4, 10.0]},
    ]
    dataset = run(
        tmp_path / "a", study(scenarios=["link_sweep"], axes=axes, metrics=["noise_ratio"], reference="RAREKF"), jobs=1
    )
    rows, signs = dataset.read(0).to_pylist(), set()
    for _, columns, of in sweep_rows(list(aggregate(dataset))):
        reference = [
            r["noise_ratio"]
            for r in rows
            if r["filter"] == "RAREKF" and all(r[name] == v for name, v in columns.items())
        ]
        for name in ("EKF", "current"):
            own = [
                r["noise_ratio"]
                for r in rows
                if r["filter"] == name and all(r[a] in (v, None) for a, v in columns.items())
            ]
            assert len(own) == len(reference) == 3
            sign = paired(np.array(own), np.array(reference)).sign
            assert sign_of(of[name], "noise_ratio") == sign, (name, columns)
            signs.add((name, columns["W"], columns["V"], sign))
    assert {(V, sign) for name, W, V, sign in signs if name == "EKF" and W == 1e-4} == {(1e-4, -1), (10.0, 1)}


@pytest.mark.parametrize("vary", [False, True])
def test_the_worst_run_can_be_run_again(tmp_path, vary):
    """Its scenario gives the value of the row, to the bit."""
    axes = [{"kind": "load", "values": [6.0, 9.0]}]
    dataset = run(tmp_path, study(scenarios=["link_sweep"], axes=axes, vary=vary))
    (worst,) = worst_runs(dataset, "rms")
    rows = [row for cell in dataset.design.cells for row in dataset.read(cell.index).to_pylist()]
    assert worst.value == max(row["rms"] for row in rows)
    path = tmp_path / "again.yaml"
    path.write_text(yaml_text(worst.again.model_dump(mode="json", exclude_none=True)))
    again = run_scenario(*load_scenario(path))
    assert again.metrics["filters"][worst.filter]["rms"] == worst.value
