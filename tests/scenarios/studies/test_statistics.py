"""Intervals against scipy's; their coverage; pairing; what a dataset's summary says."""

from __future__ import annotations

import csv
import math
from types import SimpleNamespace

import numpy as np
import pytest
from scipy import stats
from small import column, run, study

from flexspline.scenarios.studies.statistics import aggregate, interval, paired, reference_of, write_csv


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
    assert [(s.filter, s.columns["load"], s.columns["k"]) for s in found[:4]] == [
        ("EKF", 3.0, None),
        ("RAREKF", 3.0, 0.0),
        ("RAREKF", 3.0, 2.0),
        ("current", 3.0, None),
    ]
    ekf = np.array(column(dataset, 0, "EKF", "rms"))
    assert found[0].values["rms"] == interval(ekf)
    first = np.array([r["rms"] for r in dataset.read(0).to_pylist() if r["k"] == 0.0])
    assert found[0].differences["rms"] == paired(ekf, first)
    assert not found[1].differences and not found[2].differences
    write_csv(found, dataset.design, tmp_path / "summary.csv")
    with (tmp_path / "summary.csv").open(encoding="utf-8") as file:
        lines = list(csv.DictReader(file))
    assert len(lines) == len(found)
    assert float(lines[0]["rms_mean"]) == found[0].values["rms"].mean
    assert float(lines[0]["rms_difference_high"]) == found[0].differences["rms"].high


def test_a_variant_is_compared_with_its_own_counterpart():
    """With two axes of filters, the reference's variant with the same settings; the reference itself with nothing."""

    def variant(name, **columns):
        return SimpleNamespace(name=name, columns=columns)

    variants = (
        variant("EKF", W=1.0), variant("EKF", W=2.0), variant("current"),
        variant("RAREKF", W=1.0, k=0.0), variant("RAREKF", W=2.0, k=0.0), variant("RAREKF", W=2.0, k=0.5),
    )  # fmt: skip
    design = SimpleNamespace(study=SimpleNamespace(compared_to="RAREKF"), variants=variants)
    assert [reference_of(design, i) for i in range(6)] == [3, 4, 3, 3, 4, 5]
