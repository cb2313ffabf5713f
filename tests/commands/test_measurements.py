"""check, import and estimate as a user calls them."""

from __future__ import annotations

import json
import subprocess
import sys

import numpy as np
import pyarrow.parquet as pq
import pytest

from flexspline.estimator import registry
from flexspline.models.recording import Recording, read_recording, write_recording


@pytest.fixture
def measurement(tmp_path):
    t = np.concatenate([np.arange(4000) * 1e-3, 5 + np.arange(3000) * 1e-3])
    theta = 3.0 * np.sin(2 * np.pi * 0.2 * t)
    current = np.minimum(3.4 * np.sin(2 * np.pi * 0.2 * t), 3.3)
    columns = {"motor_position": 100 * theta, "link_position": theta, "motor_current": current}
    write_recording(Recording("slow", t, columns), tmp_path / "m")
    return tmp_path / "m"


def one_line(err: str) -> str:
    lines = [line for line in err.splitlines() if line.strip()]
    assert len(lines) == 1, err
    return lines[0]


def test_check_says_what_is_there(flexspline, measurement):
    code, out, _ = flexspline("check", measurement)
    assert code == 0
    for text in ("gap of 1.00", "reversals", "joint_torque", "torque_sensor_gain", "current at its limit in"):
        assert text in out


def test_check_says_what_cannot_show(flexspline, tmp_path, rng):
    n = 3000
    noise = 0.01 * rng.standard_normal(n)
    columns = {"motor_position": np.full(n, 0.1), "link_position": np.full(n, 0.001), "motor_current": noise}
    write_recording(Recording("still", np.arange(n) * 1e-3, columns, external="unmeasured"), tmp_path)
    code, out, _ = flexspline("check", tmp_path)
    assert code == 0
    for cause in ("cogging", "hysteresis", "stiffness", "gravity_moment", "friction_drift", "mesh_friction"):
        assert cause in out


def test_estimate_scores_and_writes(flexspline, measurement, tmp_path):
    code, out, _ = flexspline("estimate", measurement, "--out", tmp_path / "e")
    assert code == 0
    assert sorted(p.name for p in (tmp_path / "e").iterdir()) == [".flexspline", "metrics.json", "slow.parquet"]
    report = json.loads((tmp_path / "e" / "metrics.json").read_text())["slow"]
    columns = set(pq.read_table(tmp_path / "e" / "slow.parquet").column_names)
    for name in registry.names():
        assert (f"torque_{name}" in columns) != (name in report["left_out"]), name
        assert name in out
    assert set(report["external_torque"]) == set(registry.names()) - set(report["left_out"])


def test_estimate_by_name(flexspline, measurement, tmp_path):
    code, out, _ = flexspline(
        "estimate", measurement, "--out", tmp_path / "e", "--filter", "current", "--filter", "EKF"
    )
    assert code == 0 and "RAREKF" not in out
    assert pq.read_table(tmp_path / "e" / "slow.parquet").column_names == [
        "time", "torque_current", "torque_EKF", "external_torque_current", "external_torque_EKF"
    ]  # fmt: skip


def test_estimate_does_not_overwrite_the_measurement(flexspline, measurement):
    before = (measurement / "slow.parquet").read_bytes()
    code, _, err = flexspline("estimate", measurement, "--out", measurement)
    assert code == 2 and "another folder" in one_line(err)
    assert (measurement / "slow.parquet").read_bytes() == before


def test_an_estimator_that_is_named_must_be_there_and_find_its_channels(flexspline, measurement, tmp_path):
    code, _, err = flexspline("estimate", measurement, "--out", tmp_path / "e", "--filter", "curent")
    assert code == 2 and "did you mean 'current'" in one_line(err)
    recording = read_recording(measurement / "slow.parquet").without("link_position")
    path = write_recording(recording, tmp_path)
    code, _, err = flexspline("estimate", path, "--out", tmp_path / "e", "--filter", "EKF")
    assert code == 2 and "EKF" in one_line(err) and "link_position" in err
    assert not (tmp_path / "e").exists()


def test_bad_input_is_one_line_and_exit_code_2(tmp_path):
    (tmp_path / "a.csv").write_text("time,motor_position,link_position,motor_current\n0,1,2,3\n0,1,2,3\n")
    (tmp_path / "a.yaml").write_text("format: 1\njoint: test-joint\nlink: {inertia: 1, gravity_moment: 0}\n")
    done = subprocess.run([sys.executable, "-m", "flexspline", "check", str(tmp_path)], capture_output=True, text=True)
    assert done.returncode == 2
    assert done.stderr.count("\n") == 1 and "a.csv" in done.stderr and "row 2" in done.stderr
