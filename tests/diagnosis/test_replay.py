"""The replay: with the true numbers only the sensors' noise is left; with wrong ones only the right balance breaks."""

import numpy as np
import pytest
from hidden_joint import measure

from flexspline.diagnosis.data.segments import _encoder_noise, segments
from flexspline.diagnosis.fit.replay import READ_OUT, residual, residuals, transmission
from flexspline.estimator.motion import smooth
from flexspline.models import causes
from flexspline.models.joint import load_joint


@pytest.fixture(scope="module")
def joint():
    return load_joint("test-joint")


@pytest.fixture(scope="module")
def replayed(joint):
    """Segments of a joint that has exactly its nominal numbers."""
    measurement, _ = measure(joint, seed=3, exact=True)
    return segments(list(measurement.recordings), joint)[0]


def rms(joint, replayed, change=lambda p: None):
    """RMS of each channel while the rotor moves."""
    left = [[], [], []]
    for segment in replayed:
        record = joint.record(segment.mounting)
        change(record[0])
        r = residual(segment, record)
        for c in range(3):
            left[c].append(r[segment.usable[:, c] & ~segment.at_rest, c])
    return np.array([np.sqrt(np.mean(np.concatenate(x) ** 2)) for x in left])


def test_true_numbers_leave_the_sensors_noise(joint, replayed):
    current, torque, link = rms(joint, replayed)
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
def test_an_effect_breaks_only_the_balances_that_it_touches(joint, replayed, name, values, broken):
    before, after = (rms(joint, replayed, f) for f in (lambda p: None, lambda p: causes.get(name).apply(p, values)))
    assert [c for c in range(3) if after[c] > 1.5 * before[c]] == broken


def test_numbers_that_are_read_out_move_nothing_inside_the_transmission(joint, replayed):
    segment = replayed[0]
    record = joint.record(segment.mounting)
    inner = transmission(segment, record)
    for name in READ_OUT:
        changed = record.copy()
        changed[name] = 1.1 * changed[name] + 1e-3
        assert np.array_equal(transmission(segment, changed), inner), name
        assert np.array_equal(residuals([(segment, record), (segment, changed)])[1], residual(segment, changed)), name
    inside = [name for name in record.dtype.names if name not in READ_OUT]
    moving = [name for name in ("K1", "Kw0", "Fc", "bw", "Jw", "link_zero", "amplitude", "df") if name in inside]
    assert len(moving) == 8
    for name in moving:
        changed = record.copy()
        changed[name] = 1.1 * changed[name] + 1e-6
        assert not np.array_equal(transmission(segment, changed), inner), name


def test_at_the_true_numbers_nothing_is_left_but_noise_at_any_speed(joint):
    """The noise replicates draw the sensors' noise again: as much as that, and no more, is left of torque and link balance."""
    measurement, _ = measure(joint, seed=11, exact=True)
    for segment, replicate in zip(*segments(list(measurement.recordings), joint), strict=True):
        record = joint.record(segment.mounting)
        left = residual(segment, record)
        share = residual(replicate, record) - left
        speed = np.abs(segment.state[:, 2])
        # The fourth order of the gear leaves the smoother's passband at the fastest.
        for slowest, fastest in ((15.0, 40.0), (40.0, 70.0), (70.0, 200.0)):
            for c in (1, 2):
                use = segment.usable[:, c] & (speed > slowest) & (speed < fastest)
                if use.sum() > 200:
                    # Below one where the counts happen to beat with the sampling.
                    assert 0.75 < np.std(left[use, c]) / np.std(share[use, c]) < 1.15, (segment.recording, slowest, c)


@pytest.mark.parametrize("interval", [1e-3, 4e-3])
def test_noise_replicates_are_as_noisy_as_the_encoder(interval, joint, rng):
    """Counts of a smooth motion, drawn again, leave as much of position, rate and acceleration as the first time."""
    time = np.arange(0, 6, interval) + rng.uniform(0, 0.05 * interval, round(6 / interval))
    true = 60 * (1 - np.cos(0.9 * time)) + 2e-3 * np.sin(40 * time)
    encoder = joint.sensors.motor_encoder
    read = np.round(true / encoder.resolution) * encoder.resolution
    again = _encoder_noise(time, read, encoder, rng)
    s = smooth(time, np.column_stack([read - true, again]), 1e-3)
    inside = slice(500, -500)
    for part in (s.value, s.rate, s.acceleration):
        first, second = np.std(part[inside], axis=0)
        assert 0.8 < second / first < 1.25
