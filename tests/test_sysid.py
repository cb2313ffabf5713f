"""Beside `mujoco.sysid` (`python -m benchmarks sysid`): on short motions; needs the package's optional parts."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("absl", reason="mujoco[sysid] is not installed")
pytest.importorskip("imageio", reason="mujoco[sysid] is not installed")
pytest.importorskip("plotly", reason="mujoco[sysid] is not installed")
pytest.importorskip("tabulate", reason="mujoco[sysid] is not installed")

from benchmarks import sysid
from flexspline.diagnosis.trials.draw import Challenge, Draw, draw
from flexspline.models.calibration import Calibration

SHORT = """
format: 1
name: short
description: a short motion
joint: test-joint
mounting: link
duration: 1.5
controller: {kp: 8, kd: 0.08, ki: 20}
trajectory:
  - {time: 0.1, position: 0}
  - {time: 1.4, position: 0.3}
"""


@pytest.fixture(scope="module")
def one(tmp_path_factory) -> Draw:
    """A joint within its tolerances, recorded for a short motion."""
    path = tmp_path_factory.mktemp("scenarios") / "short.yaml"
    path.write_text(SHORT, encoding="utf-8")
    return draw(Challenge(seed=sysid.SEED, hidden="none", scenarios=(str(path),)), 0)


def truth(one: Draw) -> np.ndarray:
    """The calibration variables that the draw was made of."""
    calibration = Calibration(one.nominal)
    x = calibration.draw(np.random.default_rng([sysid.SEED, 0, 1]))
    record = calibration.record(x, one.measurement.recordings[0].link)
    assert record[0]["K1"] == one.records[0][0]["K1"]
    return x


def test_rollouts_at_the_true_numbers_leave_little_more_than_noise(one: Draw):
    problem = sysid.Rollouts(one, exact=True)
    with sysid.described_laws():
        left = problem.rms(truth(one))["short"]
        nominal = problem.rms(np.zeros(problem.calibration.size))["short"]
    noise = one.nominal.sensors.joint_torque.noise
    assert left[2] < 1.5 * noise, left
    assert nominal[2] > 1.5 * left[2] and nominal[1] > 10 * left[1], (nominal, left)


def test_numbers_and_their_intervals_are_read_off_a_fit(one: Draw, tmp_path: Path):
    x = truth(one)
    variance = 0.1**2 * np.eye(len(x))
    found = sysid.numbers(one, sysid.Found(x, variance, 0.0, ""))
    assert all(n.covered and n.value == pytest.approx(n.true) for n in found.values())
    assert found["Kt"].std == pytest.approx(0.1 * 0.02 * found["Kt"].nominal, rel=1e-3)
    # K1 has a tolerance of its own, 2 %, and one that it shares, 7 %.
    assert found["K1"].std == pytest.approx(0.1 * np.hypot(0.02, 0.07) * found["K1"].true, rel=0.2)
    fits = [sysid.Fitted("", 0, tool, found, 1.0, "") for tool in sysid.TOOLS]
    sysid.write(tmp_path / "kept.json", fits)
    assert sysid.read(tmp_path / "kept.json") == sorted(fits, key=lambda f: sysid.TOOLS.index(f.tool))
    tables = sysid.tables(fits)
    assert "1 of 1" in tables["numbers"] and sysid.EXACT in tables["time"]


@pytest.mark.slow
@pytest.mark.parametrize("exact", [True, False])
def test_a_fit_by_rollouts_brings_the_torque_constant_closer(one: Draw, exact: bool):
    found = sysid.rolled_out(one, exact, iterations=(2, 2))
    assert found.covariance.shape == (len(found.x),) * 2
    numbers = sysid.numbers(one, found)
    # A short motion tells weight and stiffness: what the springs hold.
    assert abs(numbers["K1"].value / numbers["K1"].true - 1) < abs(numbers["K1"].nominal / numbers["K1"].true - 1)


@pytest.mark.slow
def test_what_is_hidden_can_be_drawn():
    """Names that the library does not have were once asked for: the table stayed empty."""
    for hidden in sysid.HIDDEN:
        made = draw(Challenge(seed=sysid.SEED, hidden="one", only=(hidden,)), 0)
        assert [effect.name for effect in made.effects] == [hidden]
