"""check, import and estimate as a user calls them."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest
from flexspline.sim.recording import Recording, write_recording
from typer.testing import CliRunner

from flexspline import commands
from flexspline.models.errors import InputError


@pytest.fixture
def run():
    commands._register()
    return lambda *arguments: CliRunner().invoke(commands.app, [str(a) for a in arguments])


@pytest.fixture
def measurement(tmp_path):
    t = np.concatenate([np.arange(4000) * 1e-3, 5 + np.arange(3000) * 1e-3])
    theta = 3.0 * np.sin(2 * np.pi * 0.2 * t)
    r = Recording("slow", t, 100 * theta, theta, np.minimum(3.4 * np.sin(2 * np.pi * 0.2 * t), 3.3))
    write_recording(r, tmp_path / "m")
    return tmp_path / "m"


def test_check_says_what_is_there(run, measurement):
    done = run("check", measurement)
    assert done.exit_code == 0
    for text in ("gap of 1.00", "reversals", "joint_torque", "torque_sensor_gain", "current at its limit in"):
        assert text in done.output


def test_check_says_what_cannot_show(run, tmp_path):
    n = 3000
    t = np.arange(n) * 1e-3
    still = Recording("still", t, np.full(n, 0.1), np.full(n, 0.001), np.zeros(n), external="unmeasured")
    write_recording(still, tmp_path)
    output = run("check", tmp_path).output
    for cause in ("cogging", "hysteresis", "stiffness", "gravity_moment", "friction_drift", "mesh_friction"):
        assert cause in output


def test_estimate_scores_and_writes(run, measurement, tmp_path):
    done = run("estimate", measurement, "--out", tmp_path / "e")
    assert done.exit_code == 0, done.output
    assert sorted(p.name for p in (tmp_path / "e").iterdir()) == ["metrics.json", "slow.parquet"]


def test_estimate_does_not_overwrite_the_measurement(run, measurement):
    done = run("estimate", measurement, "--out", measurement)
    assert isinstance(done.exception, InputError) and "another folder" in str(done.exception)


def test_bad_input_is_one_line_and_exit_code_2(tmp_path):
    (tmp_path / "a.csv").write_text("time,motor_position,link_position,motor_current\n0,1,2,3\n0,1,2,3\n")
    (tmp_path / "a.yaml").write_text("format: 1\njoint: test-joint\nlink: {inertia: 1, gravity_moment: 0}\n")
    program = (
        "import sys; from flexspline.commands import main; sys.argv = ['flexspline', 'check', sys.argv[1]]; main()"
    )
    done = subprocess.run([sys.executable, "-c", program, str(tmp_path)], capture_output=True, text=True)
    assert done.returncode == 2
    assert done.stderr.count("\n") == 1 and "a.csv" in done.stderr and "row 2" in done.stderr
