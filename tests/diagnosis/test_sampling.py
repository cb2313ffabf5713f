"""Logs faster than the sensors, and logs whose time stamps are wrong: seen, and no reason for a wrong answer."""

import numpy as np
import pytest

from flexspline.diagnosis.data.sampling import between, fresh, timing_error, timing_error_of_one
from flexspline.diagnosis.data.segments import segments
from flexspline.diagnosis.fit.replay import residual
from flexspline.diagnosis.trials.draw import Challenge, draw


def hold(time, signal, rate):
    """What a sensor of that rate puts into a faster log."""
    return signal(np.floor(time * rate + 1e-9) / rate)


@pytest.mark.parametrize("rate", [100.0, 250.0])
def test_only_readings_that_changed_are_fresh(rate):
    time = np.arange(2000) * 1e-3
    reading = hold(time, lambda t: np.sin(5 * t), rate)
    found = fresh(time, reading, rate)
    assert found.sum() == pytest.approx(2.0 * rate, abs=1)
    np.testing.assert_allclose(reading[found], np.sin(5 * time[found]), atol=1e-9)


def test_reading_that_stands_still_stays_fresh_once_a_period():
    time = np.arange(1000) * 1e-3
    assert fresh(time, np.zeros(1000), 100.0).sum() == pytest.approx(100, abs=1)
    assert fresh(time, np.zeros(1000), 1000.0).all()


def test_between_fresh_readings_the_signal_is_there_again():
    time = np.arange(3000) * 1e-3
    held = hold(time, lambda t: np.sin(20 * t), 100.0)
    found = fresh(time, held, 100.0)
    again = between(time, time[found], held[found])
    inside = slice(20, -20)
    assert np.abs(again - np.sin(20 * time))[inside].max() < 1e-4
    assert np.abs(held - np.sin(20 * time))[inside].max() > 0.15


def test_wrong_time_stamps_are_seen_and_measured(rng):
    time = np.arange(4000) / 250.0
    position, ratio = 2.0 * np.sin(0.8 * time), 100.0
    late = time + 0.2e-3 * rng.standard_normal(len(time))
    motor, link = ratio * position, position + 1e-6 * rng.standard_normal(len(time))
    assert timing_error(late, motor, link) == pytest.approx(0.2e-3, rel=0.15)


@pytest.mark.parametrize("step", [1e-3, 4e-3])
def test_one_encoder_shows_wrong_time_stamps(step, rng):
    """What it is off its smooth motion goes with its speed; counts, noise and a ripple are there at any speed."""
    time = np.arange(20_000) * step
    position, counts = np.sin(0.5 * time), 2 * np.pi / 4096
    motor = np.round(100 * position / counts) * counts
    link = position + 1e-6 * rng.standard_normal(len(time))
    late = time + 0.2e-3 * rng.standard_normal(len(time))
    assert timing_error_of_one(late, motor, 4.0) == pytest.approx(0.2e-3, rel=0.15)
    assert timing_error_of_one(late, link, 400.0) == pytest.approx(0.2e-3, rel=0.15)
    assert timing_error_of_one(time, motor, 4.0) == 0.0
    assert timing_error_of_one(time, link, 400.0) == 0.0
    # A ripple that grows as it nears a resonance: at 125 Hz its samples look like noise that goes with the speed.
    slow = np.arange(4000) * 8e-3
    shaken = np.sin(0.5 * slow) + 1e-4 * (0.5 * np.cos(0.5 * slow)) ** 2 * np.sin(202 * np.sin(0.5 * slow))
    assert timing_error_of_one(slow, shaken, 202.0) == 0.0
    assert timing_error_of_one(time[:3], motor[:3], 4.0) == 0.0


def test_noise_of_encoders_is_no_error_of_time(rng):
    time = np.cumsum(rng.uniform(2e-3, 6e-3, 4000))
    position = 2.0 * np.sin(0.8 * time)
    counts = 2 * np.pi / 4096
    motor = np.round(100 * position / counts) * counts
    link = position + 1e-6 * rng.standard_normal(len(time))
    trembling = motor + 0.01 * rng.standard_normal(len(time))  # the rotor alone
    assert timing_error(time, motor, link) == 0.0
    assert timing_error(time, trembling, link) == 0.0
    assert timing_error(time, np.zeros(len(time)), np.zeros(len(time))) == 0.0
    assert timing_error(time[:3], motor[:3], link[:3]) == 0.0


@pytest.mark.slow
def test_slow_sensors_in_a_fast_log_leave_their_noise_alone():
    """The LARA8 joint: encoders of 250 Hz and a torque sensor of 100 Hz, logged at 1 kHz; torques six times the test joint's."""
    drawn = draw(Challenge(joint="lara8-joint3", hidden="none", seed=5), 0)
    found, replicates = segments(list(drawn.measurement.recordings), drawn.nominal)
    for segment, replicate, record in zip(found, replicates, drawn.records, strict=True):
        r, again = residual(segment, record), residual(replicate, record)
        for c in (1, 2):  # the current has what the controller does between the encoders' readings, too
            use = segment.usable[:, c] & ~segment.at_rest
            if use.any():
                assert np.std(r[use, c]) == pytest.approx(np.std((again - r)[use, c]), rel=0.12)
