"""The compliance model, Eqs. (1)-(7): its own inverse, its breakpoints, and the reference data."""

from __future__ import annotations

import numpy as np
import pytest
from matrix_filter import run
from paper_compliance import compliance

from flexspline.estimator import PaperFilter, get
from flexspline.models.signals import Signals

N, K1, K2, K3, T1, T2, KW0, CW = 100.0, 8400.0, 9400.0, 13000.0, 3.9, 12.0, 1.14, 20.0


def flexspline_torsion(T):
    """Eq. (2), odd, written out a second time."""
    x = np.abs(T)
    first, second = T1 / K1, T1 / K1 + (T2 - T1) / K2
    torsion = np.where(x <= T1, x / K1, np.where(x < T2, first + (x - T1) / K2, second + (x - T2) / K3))
    return np.sign(T) * torsion


def readings(Tf, Tw, theta_w):
    """Eqs. (1), (2), (5): the encoders' readings of a joint with these torques and this wave generator angle."""
    wave_generator = np.sign(Tw) / (CW * KW0) * (1 - np.exp(-CW * np.abs(Tw)))
    error = 1.2e-4 * np.sin(2 * theta_w + 0.3) + 2e-5 * np.sin(4 * theta_w + 1.1)
    torsion = flexspline_torsion(Tf) + wave_generator / N + error  # Eq. (1)
    motor = theta_w + wave_generator
    return motor, motor / N - torsion, torsion, wave_generator, error


def test_round_trip(calibration, rng):
    """Torques → torsions → torques, to 1e-12 of what 1 rad of angle allows."""
    Tf, Tw = rng.uniform(-30, 30, 5000), rng.uniform(-0.2, 0.2, 5000)
    theta_w = rng.uniform(-3, 3, 5000)
    motor, link, torsion, wave_generator, error = readings(Tf, Tw, theta_w)
    got = compliance(motor, link, Tw, calibration)
    np.testing.assert_allclose(got.torsion, torsion, rtol=0, atol=1e-15)
    np.testing.assert_allclose(got.wave_generator_torsion, wave_generator, rtol=1e-13, atol=1e-17)
    np.testing.assert_allclose(got.kinematic_error, error, rtol=0, atol=1e-17)
    np.testing.assert_allclose(got.flexspline_torsion, flexspline_torsion(Tf), rtol=0, atol=1e-15)
    np.testing.assert_allclose(got.torque, Tf, rtol=0, atol=3e-12)  # 1e-16 rad of an angle is 1.3e-12 N·m


def test_breakpoints_and_oddness(calibration):
    """Torques at and around the breakpoints, and the same with the sign turned."""
    T = np.array([0.0, 1.0, T1 - 1e-9, T1, T1 + 1e-9, 8.0, T2 - 1e-9, T2, T2 + 1e-9, 25.0])
    flat = calibration.copy()
    flat["amplitude"] = 0.0
    link = -flexspline_torsion(T)
    plus = compliance(0.0, link, 0.0, flat).torque
    np.testing.assert_allclose(plus, T, rtol=0, atol=1e-11)
    np.testing.assert_array_equal(compliance(0.0, -link, 0.0, flat).torque, -plus)
    for low, high, slope in ((0.0, T1, K1), (T1, T2, K2), (T2, 30.0, K3)):
        x = flexspline_torsion(np.array([low, high]))
        inside = x[0] + np.array([0.25, 0.75]) * (x[1] - x[0])
        torque = compliance(0.0, -inside, 0.0, flat).torque
        assert np.diff(torque)[0] / np.diff(inside)[0] == pytest.approx(slope, rel=1e-9)


def test_link_encoder_zero_is_calibration(calibration):
    shifted = calibration.copy()
    shifted["link_zero"] = 1e-3
    motor, link, *_ = readings(5.0, 0.05, 1.0)
    assert compliance(motor, link + 1e-3, 0.05, shifted).torque == pytest.approx(5.0, abs=1e-9)


@pytest.mark.parametrize("name", ["no_load", "link_sweep", "external_push"])
def test_reference(reference, calibration, name):
    """With the true Tw, Eq. (7) gives the flexspline's elastic torque: all but the damping df·Δθf' and dw·δ'."""
    data = reference(name)
    got = compliance(data["motor_position"], data["link_position"], data["wave_generator_torque"], calibration)
    elastic = data["flexspline_torque"] - 4.0 * np.gradient(got.flexspline_torsion, data["time"])
    error = (got.torque - elastic)[10:-10]
    print(f"{name}: rms {error.std():.2e} N·m, largest {np.abs(error).max():.2e} N·m")
    assert np.sqrt(np.mean(error**2)) < 0.005
    assert np.abs(error[1000:]).max() < 0.15


@pytest.mark.parametrize("name", ["no_load", "link_sweep", "external_push"])
def test_filters_on_the_reference(reference, calibration, name, rng):
    """Sensors of the test joint, the current for Tw: every filter below 0.1 N·m rms, and their order."""
    data = reference(name)
    count = len(data["time"])
    motor_step, link_step = 2 * np.pi / 4096, 2 * np.pi / 2**20
    motor = motor_step * (np.floor(data["motor_position"] / motor_step) + 0.5)
    link = link_step * np.round((data["link_position"] + 1.5e-6 * rng.standard_normal(count)) / link_step)
    current = data["motor_current"] + 0.01 * rng.standard_normal(count)
    y = compliance(motor, link, calibration["Kt"][0] * current, calibration).torque
    rms, robust = {}, {}
    for rule in ("ekf", "robust", "arekf", "rarekf"):
        got = run(PaperFilter(rule=rule), y)
        rms[rule] = np.sqrt(np.mean((got.torque - data["joint_torque"]) ** 2))
        robust[rule] = got.robust.mean()
    print(name, "rms", {k: round(v, 4) for k, v in rms.items()}, "robust", {k: round(v, 4) for k, v in robust.items()})
    assert max(rms.values()) < 0.1
    assert robust["rarekf"] <= robust["arekf"]
    if name == "no_load":
        assert robust["rarekf"] < 0.02
    if name == "external_push":
        assert max(rms["arekf"], rms["rarekf"]) < 0.7 * rms["ekf"]


def test_a_delayed_link_encoder_is_compared_with_past_motor_and_torque(known):
    """In uniform motion, readings 1.6 samples old give the torque of readings without delay."""
    time = np.arange(300) * 1e-3
    delay = 1.6e-3
    motor, current = 3.0 + 2.0 * time, 4.0 + 3.0 * time

    def link(t):
        return (3.0 + 2.0 * t) / 100 - 6e-4 - 5e-4 * t

    columns = {"motor_position": motor, "motor_current": current}
    model = get("model")
    in_time = model.estimate(Signals(time, {**columns, "link_position": link(time)}), known).mean
    late = Signals(time, {**columns, "link_position": link(time - delay)})
    found = model.estimate(late, known.with_numbers(link_delay=delay)).mean
    np.testing.assert_allclose(found[50:], in_time[50:], atol=2e-3)
    assert np.abs(model.estimate(late, known).mean - in_time)[50:].min() > 0.1  # had nobody known


def test_a_delayed_link_encoder_uses_the_past_motor_torque(known):
    """A rising current winds the wave generator: its past torsion counts, not the present one."""
    time = np.arange(400) * 1e-3
    delay, slope = 2.6e-3, 40.0
    p = known.p
    current = slope * (time - 0.2)
    columns = {"motor_position": np.full(400, 1.0), "motor_current": current}

    def link(t):  # no torque in the flexspline: the wave generator's angle through the gear, Eqs. (3) to (6)
        torque = p["Kt"] * slope * (t - 0.2)
        return compliance(np.full(len(t), 1.0), np.zeros(len(t)), torque, known.record).flexspline_torsion

    model = get("model")
    in_time = model.estimate(Signals(time, {**columns, "link_position": link(time)}), known).mean
    late = Signals(time, {**columns, "link_position": link(time - delay)})
    found = model.estimate(late, known.with_numbers(link_delay=delay)).mean
    assert np.abs(in_time[5:]).max() < 1e-9
    print("as known", np.abs(found[20:]).max(), "had nobody known", np.abs(model.estimate(late, known).mean)[20:].max())
    np.testing.assert_allclose(found[20:], 0.0, atol=0.05 * np.abs(model.estimate(late, known).mean)[20:].max())


def test_observers_extrapolate_a_delayed_link_encoder(known):
    """During acceleration the link's velocity and torque are those of readings without delay."""
    time = np.arange(600) * 1e-3
    delay, speed = 4e-3, 30.0
    joint = known.with_numbers(amplitude=0.0)
    motor = speed * time**2  # it speeds up

    def signals(t):
        link = speed * t**2 / 100 - 2e-3 * t
        return Signals(time, {"motor_position": motor, "link_position": link, "motor_current": np.full(600, 1.0)})

    in_time = get("momentum").estimate(signals(time), joint)
    found = get("momentum").estimate(signals(time - delay), joint.with_numbers(link_delay=delay))
    velocity = in_time.columns["link_velocity"]
    np.testing.assert_allclose(found.columns["link_velocity"][100:], velocity[100:], rtol=1e-3)
    np.testing.assert_allclose(found.mean[200:], in_time.mean[200:], atol=0.01)
    unknown = get("momentum").estimate(signals(time - delay), joint).columns["link_velocity"]
    assert np.abs(unknown - velocity)[100:].min() > 5e-4
