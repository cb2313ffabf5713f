"""Offline estimators: on a joint in equilibrium and on the independent simulator's recordings."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from flexspline.diagnosis.estimate import ESTIMATORS, estimate, score, track_zero, white_noise
from flexspline.models.joint import load_joint
from flexspline.sim.recording import Recording, read_measurement


@pytest.fixture(scope="module")
def sweep(shared):
    return read_measurement(shared / "data" / "examples" / "exact" / "00" / "sweep.parquet").recordings[0]


def test_the_sensor_columns_are_not_read(sweep):
    joint = load_joint("test-joint")
    part = slice(0, 8000)
    cut = {name: values[part] for name, values in sweep.columns.items()}
    blind = estimate(replace(sweep, **{**cut, "joint_torque": None}), joint)
    seeing = estimate(replace(sweep, **{**cut, "joint_torque": 7 + cut["time"]}), joint)
    pushed = replace(sweep, **cut, external_torque=np.full(8000, 3.0), external="measured")
    told = estimate(pushed, joint)
    for name in ESTIMATORS:
        np.testing.assert_array_equal(blind.torque[name], seeing.torque[name])
        np.testing.assert_array_equal(blind.external_torque[name], told.external_torque[name])


def test_an_exact_joint_is_estimated_to_the_sensors_noise(sweep):
    joint = load_joint("test-joint")
    found = estimate(sweep, joint)
    scores = score(sweep, found, joint)["joint_torque"]
    for name in ("model", "EKF", "AREKF", "RAREKF", "current"):
        assert scores[name].rms < 0.25, name  # of 9 N·m
    assert list(found.columns) == [
        "time", *(f"torque_{n}" for n in ESTIMATORS), *(f"external_torque_{n}" for n in ESTIMATORS),
    ]  # fmt: skip
    assert abs(found.notes[0]["zero"]) < 3e-5 and abs(found.notes[0]["payload_sin"]) < 0.3


def test_an_unknown_zero_comes_from_the_current(sweep):
    moved = replace(sweep, link_position=sweep.link_position + 3e-3)  # 25 N·m in the compliance model
    joint = load_joint("test-joint")
    found = estimate(moved, joint)
    assert found.notes[0]["zero"] == pytest.approx(3e-3, abs=3e-5)
    assert score(moved, found, joint)["joint_torque"]["model"].rms < 0.3


def test_gaps_and_short_stretches(sweep):
    keep = np.r_[0:5000, 6000:6005, 7000:12000]
    cut = replace(sweep, **{name: values[keep] for name, values in sweep.columns.items()})
    found = estimate(cut, load_joint("test-joint"))
    assert len(found.notes) == 2
    assert np.isnan(found.torque["EKF"][5000:5005]).all()
    assert np.isfinite(np.delete(found.torque["EKF"], np.s_[5000:5005])).all()


def test_zero_of_a_joint_that_moves_both_ways(rng):
    n = 400
    direction = np.where(np.arange(n) // 100 % 2, -1.0, 1.0)
    compliance = np.full(n, 1e-4)
    seen = 2e-4 + compliance * (0.4 * direction + 0.1 * rng.standard_normal(n))
    zero, std = track_zero(seen, compliance, direction, np.zeros(n), np.full(n, 0.01), 1e-3, 0.0, 0.5, 0.1)
    assert np.all(np.abs(zero - 2e-4) < 4 * std) and std.max() < 3e-5


def test_white_noise_ignores_motion_and_uneven_time(rng):
    t = np.cumsum(rng.uniform(0.5e-3, 6e-3, 4000))
    y = 50 * np.sin(2 * t) + 0.01 * rng.standard_normal(4000)
    assert white_noise(t, y) == pytest.approx(0.01, rel=0.1)


def test_a_joint_at_rest(rng):
    joint = load_joint("test-joint")
    n = 500
    r = Recording(
        "rest", np.arange(n) * 1e-3, np.zeros(n), np.zeros(n), 0.01 * rng.standard_normal(n),
        link=joint.mount("link"),
    )  # fmt: skip
    found = estimate(r, joint)
    assert all(np.isfinite(values).all() for values in found.columns.values())
