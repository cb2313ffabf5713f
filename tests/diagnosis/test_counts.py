"""How coarse a log's readings are, and what a description that says otherwise would make of them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from swing import recording

from flexspline.diagnosis.data.counts import as_logged, coarser, rate_of, step_of
from flexspline.diagnosis.diagnose import diagnose
from flexspline.diagnosis.trials.draw import Challenge, draw
from flexspline.models.joint import load_joint
from flexspline.models.recording import Measurement, Recording

JOINT = load_joint("test-joint")
BITS = 2 * np.pi / 2**16


def rounded(r: Recording, column: str, step: float) -> Recording:
    return replace(r, columns={**r.columns, column: step * np.round(r[column] / step)})


def held(r: Recording, column: str, samples: int) -> Recording:
    x = r[column]
    return replace(r, columns={**r.columns, column: x[np.arange(len(x)) // samples * samples]})


@pytest.mark.parametrize("step", [BITS, 1e-3, 0.1])
def test_a_step_is_found(step):
    rng = np.random.default_rng(3)
    x = np.cumsum(rng.normal(0.0, 2 * step, 5000))
    assert step_of(step * np.round(x / step)) == pytest.approx(step, rel=1e-6)
    assert step_of(x) == 0.0
    assert step_of(np.zeros(5000)) == 0.0


def test_a_rate_is_found():
    rng = np.random.default_rng(4)
    time, x = np.arange(5000) * 1e-3, rng.normal(size=5000)
    assert rate_of(time, np.repeat(x[:500], 10)) == pytest.approx(100.0)
    assert rate_of(time, x) == 0.0
    assert rate_of(time, np.round(x)) == 0.0  # of few steps, not held


@pytest.mark.parametrize("column", ["link_position", "motor_position"])
def test_an_encoder_that_is_held_is_read_at_its_rate(column):
    """On a bus of 125 Hz: one held for eight samples was a delay of 3.5 ms at 0.99, with a link inertia beside it."""
    swing = recording(rate=1000.0)
    rest = np.concatenate(
        [np.full(3000, swing[column][0]), swing[column][:-3000]]
    )  # it does not change there, held or not
    r = held(replace(swing, columns={**swing.columns, column: rest}), column, 8)
    assert [(one.column, one.what, round(one.found)) for one in coarser((r,), JOINT)] == [(column, "rate", 125)]
    encoder = column.replace("position", "encoder")
    found, described = (getattr(j.sensors, encoder) for j in (as_logged(JOINT, (r,)), JOINT))
    assert found.rate == pytest.approx(125.0) and found.resolution == described.resolution
    assert coarser((swing,), JOINT) == ()


def test_a_log_that_is_as_described_leaves_the_joint_as_it_is():
    r = recording()
    assert coarser((r,), JOINT) == () and as_logged(JOINT, (r,)) is JOINT


def test_a_coarser_log_is_told_and_taken_as_it_is():
    r = held(rounded(recording(), "link_position", BITS), "joint_torque", 10)
    assert [(one.column, one.what) for one in coarser((r,), JOINT)] == [
        ("link_position", "step"),
        ("joint_torque", "rate"),
    ]
    sensors = as_logged(JOINT, (r,)).sensors
    assert sensors.link_encoder.resolution == pytest.approx(BITS)
    assert sensors.joint_torque.rate == pytest.approx(50.0)
    assert sensors.motor_encoder == JOINT.sensors.motor_encoder


@pytest.mark.slow
@pytest.mark.parametrize("spoilt", [pytest.param("bits", marks=pytest.mark.long), "held"])
def test_coarse_readings_are_no_resonance(spoilt):
    """A link encoder of 16 bits described with 20 was a `link_flexibility` at 0.99, a torque sensor held for 10 ms at 0.70."""
    drawn = draw(Challenge(seed=981, hidden="none"), 0)
    change = {
        "bits": lambda r: rounded(r, "link_position", BITS),
        "held": lambda r: held(r, "joint_torque", 10),
    }[spoilt]
    log = Measurement("log", Path(), tuple(change(r) for r in drawn.measurement.recordings))
    found = diagnose(log, drawn.nominal)
    assert found.verdict == "consistent" and not found.causes and not found.minor
