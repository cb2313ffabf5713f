"""The replay: with the true numbers only the sensors' noise is left; with wrong ones only the right balance breaks."""

import numpy as np
import pytest
from flexspline.diagnosis.replay import READ_OUT, drives, residual, residuals, transmission
from flexspline.models import causes
from flexspline.models.joint import Mounting, load_joint
from hidden_joint import measure


@pytest.fixture(scope="module")
def joint():
    return load_joint("test-joint")


@pytest.fixture(scope="module")
def stretches(joint):
    measurement, _ = measure(joint, seed=3, exact=True)
    return drives(list(measurement.recordings), joint.sensors)[0]


def rms(joint, stretches, change=lambda p: None):
    """RMS of each channel while the rotor moves."""
    left = [[], [], []]
    for drive in stretches:
        record = joint.record(Mounting(inertia=drive.inertia, gravity_moment=drive.gravity_moment))
        change(record[0])
        r = residual(drive, record)
        for c in range(3):
            left[c].append(r[drive.usable[:, c] & ~drive.at_rest, c])
    return np.array([np.sqrt(np.mean(np.concatenate(x) ** 2)) for x in left])


def test_true_numbers_leave_the_sensors_noise(joint, stretches):
    current, torque, link = rms(joint, stretches)
    assert current < 0.01
    assert torque < 0.02
    assert link < 0.02


@pytest.mark.parametrize(
    ("name", "values", "broken"),
    [
        ("torque_constant", {"value": 0.066}, [0]),
        ("current_offset", {"value": 0.1}, [0]),
        ("link_inertia", {"scale": 1.5}, [2]),
        ("gravity_moment", {"scale": 1.1}, [2]),
        ("torque_sensor_gain", {"gain": 1.1}, [1, 2]),
    ],
)
def test_an_effect_breaks_only_the_balances_that_it_touches(joint, stretches, name, values, broken):
    before, after = (rms(joint, stretches, f) for f in (lambda p: None, lambda p: causes.get(name).apply(p, values)))
    assert [c for c in range(3) if after[c] > 1.5 * before[c]] == broken


def test_numbers_that_are_read_out_move_nothing_inside_the_transmission(joint, stretches):
    drive = stretches[0]
    record = joint.record(Mounting(inertia=drive.inertia, gravity_moment=drive.gravity_moment))
    inner = transmission(drive, record)
    for name in READ_OUT:
        changed = record.copy()
        changed[name] = 1.1 * changed[name] + 1e-3
        assert np.array_equal(transmission(drive, changed), inner), name
        assert np.array_equal(residuals([(drive, record), (drive, changed)])[1], residual(drive, changed)), name
    inside = [name for name in record.dtype.names if name not in READ_OUT]
    moving = [name for name in ("K1", "Kw0", "Fc", "bw", "Jw", "link_zero", "amplitude", "df") if name in inside]
    assert len(moving) == 8
    for name in moving:
        changed = record.copy()
        changed[name] = 1.1 * changed[name] + 1e-6
        assert not np.array_equal(transmission(drive, changed), inner), name
