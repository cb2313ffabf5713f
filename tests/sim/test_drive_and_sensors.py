"""The DC motor, the position controller and the sensors against closed forms."""

from __future__ import annotations

import itertools

import mujoco
import numpy as np
import pytest
from driving import JOINT, record_of

from flexspline.models.controller import Controller, control
from flexspline.models.joint_parts import AnalogSpec, EncoderSpec
from flexspline.models.signals import READINGS, SENSED
from flexspline.sim import plant
from flexspline.sim.sensors import SENSOR, distort, flicker, low_pass, noise, quantise, sample, sensor_records, stream

R, L, KT = 1.16, 0.33e-3, 0.0603


def currents(command, timestep, steps, locked=True, **changes):
    """Motor current [A] and torque [N·m] after each step at a constant command [A], and the rotor's velocity."""
    record = record_of("no_load", **changes)
    model = plant.build(JOINT, JOINT.mount("no_load"), timestep=timestep, record=record, locked_rotor=locked)
    data = mujoco.MjData(model)
    plant.start(model, data)
    data.ctrl[0] = KT * command
    at = model.actuator("motor").actadr[0]
    found = []
    for _ in range(steps):
        mujoco.mj_step(model, data)
        found.append((data.act[at], data.actuator_force[0], data.qvel[0]))
    return np.array(found).T


def test_current_lags_by_L_over_R():
    time = np.arange(1, 31) * 2e-4
    got, _, _ = currents(2.0, 2e-4, 30)
    np.testing.assert_allclose(got, 2.0 * (1 - np.exp(-time * R / L)), rtol=1e-6)


def test_supply_limits_the_voltage():
    """Locked, at 2 V: not more than 2 V/R however much is asked for."""
    got, torque, _ = currents(3.0, 2e-4, 60, supply_voltage=2.0)
    time = np.arange(1, 61) * 2e-4
    np.testing.assert_allclose(got, 2.0 / R * (1 - np.exp(-time * R / L)), rtol=1e-6)
    assert torque[-1] == pytest.approx(KT * 2.0 / R, rel=1e-6)


def test_back_emf_limits_the_speed():
    """Without friction the motor runs up to the speed at which back-EMF is the supply: V/Kt."""
    free = {name: 0.0 for name in ("bm", "bw", "bl", "df", "dw", "s1")} | {"s0": 1e-300, "Mg": 0.0}
    got, _, speed = currents(1.0, 2e-4, 40_000, locked=False, supply_voltage=2.0, amplitude=0.0, **free)
    top = 2.0 / KT
    mean = speed[-5000:].mean()
    print(f"speed {mean:.3f} rad/s of {top:.3f} rad/s")
    assert mean == pytest.approx(top, rel=0.02)
    assert abs(got[-5000:].mean()) < 0.05


def test_current_limit_caps_the_torque():
    _, torque, _ = currents(10.0, 2e-4, 60)
    assert torque.max() == pytest.approx(KT * 3.3, rel=1e-6)


# --- position controller -----------------------------------------------------------------------------------------


def controller(**changes):
    return Controller(**changes).record(record_of()[0], 1e-3, feedback=changes.pop("torque_feedback", 0) > 0)[0]


def test_controller_is_pd_on_the_measured_angle():
    c = controller(velocity_filter=0.0)
    state = np.array([0.5, 0.0, 0.0])
    got = control(0.0060, 0.02, 0.51, 0.0, state, 1e-3, c)
    assert got == pytest.approx(8 * (0.6 - 0.51) + 0.08 * (2.0 - 10.0))
    assert state[:2] == pytest.approx([0.51, 10.0])


def test_velocity_filter_time_constant():
    """A ramp of the encoder: the filtered velocity comes up with the filter's time constant."""
    c = controller(velocity_filter=0.005)
    state = np.zeros(3)
    velocities = []
    for k in range(1, 51):
        control(0.0, 0.0, 3.0 * k * 1e-3, 0.0, state, 1e-3, c)
        velocities.append(state[1])
    np.testing.assert_allclose(velocities, 3.0 * (1 - np.exp(-np.arange(1, 51) / 5)), rtol=1e-9)


def test_current_is_clipped_and_the_integral_waits():
    c = controller(ki=100.0, kp=8.0)
    state = np.zeros(3)
    assert control(1.0, 0.0, 0.0, 0.0, state, 1e-3, c) == 3.3
    assert state[2] == 0.0
    assert control(-1.0, 0.0, 0.0, 0.0, state, 1e-3, c) == -3.3
    control(0.001, 0.0, 0.0, 0.0, state, 1e-3, c)
    assert state[2] == pytest.approx(0.1 * 1e-3)


def test_torque_feedback_compensates_the_load():
    c = controller(torque_feedback=0.8)
    assert control(0.0, 0.0, 0.0, 5.0, np.zeros(3), 1e-3, c) == pytest.approx(0.8 * 5.0 / (100 * KT))


# --- sensors -----------------------------------------------------------------------------------------------------


def one(**values):
    record = np.zeros(1, SENSOR)
    record["period"], record["pass_now"] = 1e-3, 1.0
    for name, value in values.items():
        record[name] = value
    return record[0]


def with_sensor(name, spec):
    """The test joint with one of its sensors changed."""
    return JOINT.model_copy(update={"sensors": JOINT.sensors.model_copy(update={name: spec})})


def record_of_channel(channel, joint=JOINT, link_delay=0.0):
    return sensor_records(joint, link_delay, 1e-3)[SENSED.index(channel)]


def sampled(history, sensor, noise=None):
    noise = np.zeros(len(history)) if noise is None else noise
    return np.array([sample(history, k, 1e-3, noise, sensor) for k in range(len(history))])


def test_quantisation_rounds_to_steps():
    step = 2 * np.pi / 4096
    for value in (0.0, 0.4 * step, 0.6 * step, -0.6 * step, 123.4567):
        got = quantise(value, step)
        assert abs(got - value) <= step / 2 + 1e-12
        assert got / step == pytest.approx(round(got / step), abs=1e-7)
    assert quantise(1.23456, 0.0) == 1.23456


def test_encoder_counts_and_bits():
    assert EncoderSpec(counts=4096).resolution == pytest.approx(2 * np.pi / 4096)
    assert EncoderSpec(bits=20).resolution == pytest.approx(2 * np.pi / 2**20)
    assert record_of_channel("motor_position")["step"] == pytest.approx(2 * np.pi / 4096)
    link = record_of_channel("link_position", link_delay=0.004)
    assert link["step"] == pytest.approx(2 * np.pi / 2**20)
    assert link["delay"] == 0.004


@pytest.mark.parametrize("delay", [0.0, 0.003, 0.0045])
def test_delay(delay):
    history = np.linspace(0, 1, 201) ** 2
    got = sampled(history, one(delay=delay))
    time = np.arange(201) * 1e-3
    np.testing.assert_allclose(got, np.interp(time - delay, time, history), atol=1e-12)


@pytest.mark.parametrize("rate", [1000.0, 250.0, 400.0])
def test_slower_sensors_hold(rate):
    """A sensor at 400 Hz gives at each tick the value at the last tick that lies at or before its own sample instant."""
    history = np.arange(100.0)
    got = sampled(history, one(period=1 / rate))
    instants = np.floor(np.arange(100) * 1e-3 * rate + 1e-9) / rate
    np.testing.assert_array_equal(got, np.floor(instants / 1e-3 + 1e-9))
    assert len(np.unique(got)) == pytest.approx(rate / 10, abs=1)


def test_noise_level_and_held_noise():
    current = noise(JOINT, 3, 50_000, 1e-3)["motor_current"]
    got = sampled(np.zeros(50_000), one(), current)
    assert got.std() == pytest.approx(0.01, rel=0.02)
    held = sampled(np.zeros(1000), one(period=0.004), current)
    assert (np.diff(held.reshape(-1, 4), axis=1) == 0).all()


def test_every_channel_has_its_own_noise_in_its_unit():
    """Named streams: another sensor, or more of them, changes nothing; other names and seeds share nothing."""
    found = noise(JOINT, 5, 4000, 1e-3)
    assert found.dtype == READINGS and found.shape == (4000,)
    rms = {"link_position": 1.5e-6, "motor_current": 0.01, "joint_torque": 0.03}
    rms |= {f"force_{axis}": 0.1 for axis in "xyz"} | {f"torque_{axis}": 0.03 for axis in "xyz"}
    for name in SENSED:
        expected = rms.get(name, 0.0) * stream(5, name).standard_normal(4000)
        np.testing.assert_array_equal(found[name], expected, err_msg=name)
        np.testing.assert_array_equal(noise(JOINT, 5, 8000, 1e-3)[name][:4000], expected, err_msg=name)
    louder = with_sensor("joint_torque", AnalogSpec(noise=1.0, flicker=0.2))
    for name in SENSED:
        same = np.array_equal(noise(louder, 5, 4000, 1e-3)[name], found[name])
        assert same == (name != "joint_torque"), name
    both = [record[name] / rms[name] for record in (found, noise(JOINT, 6, 4000, 1e-3)) for name in rms]
    correlation = np.corrcoef(both)
    assert np.abs(correlation - np.eye(len(both))).max() < 0.08


def test_an_analog_sensor_has_steps_too():
    record = record_of_channel("joint_torque", with_sensor("joint_torque", AnalogSpec(noise=0.02, step=0.1, rate=500)))
    assert record["step"] == 0.1 and record["period"] == pytest.approx(0.002)


# --- imperfections of real sensors ---------------------------------------------------------------------------


def test_ripple_crosstalk_and_error_within_counts(rng):
    current = record_of_channel(
        "motor_current",
        with_sensor("motor_current", AnalogSpec(ripple={"order": 18, "amplitude": 4e-3, "phase": 0.7})),
    )
    torque = record_of_channel("joint_torque", with_sensor("joint_torque", AnalogSpec(crosstalk=0.16)))
    encoder = record_of_channel(
        "motor_position", with_sensor("motor_encoder", EncoderSpec(counts=4096, cyclic_error=0.2))
    )
    count = 2 * np.pi / 4096
    for motor, link, value in rng.uniform(-5, 5, (50, 3)):
        assert distort(value, motor, link, current) == pytest.approx(value + 4e-3 * np.sin(18 * motor + 0.7), abs=1e-15)
        assert distort(value, motor, link, torque) == pytest.approx(value + 0.16 * np.cos(link), abs=1e-15)
        error = 0.2 * count * np.sin(2 * np.pi * value / (4 * count))
        assert distort(value, motor, link, encoder) == pytest.approx(value + error, abs=1e-12)
        assert distort(value, motor, link, one()) == value


def test_error_within_counts_makes_them_uneven():
    """The edges of a line's four counts: each lies where the angle with its error crosses half a count."""
    sensor = record_of_channel(
        "motor_position", with_sensor("motor_encoder", EncoderSpec(counts=4096, cyclic_error=0.3))
    )
    count = sensor["step"]
    angle = np.linspace(0, 400 * count, 400_001)
    counts = np.array([round(quantise(distort(x, 0.0, 0.0, sensor), count) / count) for x in angle])
    edges = angle[1:][np.diff(counts) > 0] / count
    for line in range(0, 400, 4):
        for j, edge in enumerate(edges[line : line + 4]):
            assert edge + 0.3 * np.sin(2 * np.pi * edge / 4) == pytest.approx(line + j + 0.5, abs=2e-3)
    assert np.ptp(np.diff(edges)) > 0.2


def filtered(values, bandwidth):
    sensor = record_of_channel("motor_current", with_sensor("motor_current", AnalogSpec(bandwidth=bandwidth)))
    got = [values[0]]
    for before, now in itertools.pairwise(values):
        got.append(low_pass(now, before, got[-1], sensor))
    return np.array(got)


@pytest.mark.parametrize("bandwidth", [150.0, 300.0])
def test_low_pass_is_the_analog_one(bandwidth):
    """A ramp comes through late by the time constant, exactly; sinusoids as 1/(1 + jf/fc) where sampling sees them."""
    tau = 1 / (2 * np.pi * bandwidth)
    time = np.arange(400) * 1e-3
    expected = 3.0 * (time - tau * (1 - np.exp(-time / tau)))
    np.testing.assert_allclose(filtered(3.0 * time, bandwidth), expected, atol=1e-12)
    for f in (5.0, 20.0, 60.0):
        time = np.arange(2000) * 1e-3
        got = filtered(np.sin(2 * np.pi * f * time), bandwidth)[1000:]
        response = 2 * np.mean(got * np.exp(-2j * np.pi * f * time[1000:])) * 1j
        assert abs(response - 1 / (1 + 1j * f / bandwidth)) < 0.015, f
    assert filtered(np.array([1.0, 5.0, -2.0]), 1e5) == pytest.approx([1.0, 5.0, -2.0], abs=0.02)


def test_flicker_is_one_over_f(rng):
    """Over ten octaves the power spectrum falls with the frequency: −1 in a double logarithm, and its rms is as stated."""
    n = 1 << 15
    power = np.mean([np.abs(np.fft.rfft(flicker(n, rng))) ** 2 for _ in range(60)], axis=0)[1:]
    f = np.arange(1, len(power) + 1)
    octaves = [(np.mean(f[a:b]), np.mean(power[a:b])) for a, b in ((2**k, 2 ** (k + 1)) for k in range(3, 13))]
    x, y = np.log(np.array(octaves)).T
    slope = np.polyfit(x, y, 1)[0]
    print(f"slope {slope:.3f}")
    assert slope == pytest.approx(-1.0, abs=0.05)
    found = noise(with_sensor("joint_torque", AnalogSpec(flicker=0.02)), 4, 20_000, 1e-3)["joint_torque"]
    assert found.std() == pytest.approx(0.02, rel=1e-9)
    assert found.mean() == pytest.approx(0.0, abs=1e-12)


def test_vibration_has_its_rms_and_frequency():
    spec = AnalogSpec(vibration={"frequency": 40.0, "amplitude": 0.012})
    found = noise(with_sensor("joint_torque", spec), 4, 20_000, 1e-3)["joint_torque"]
    assert np.sqrt(np.mean(found**2)) == pytest.approx(0.012, rel=1e-6)
    peak = np.abs(np.fft.rfft(found)).argmax() / 20.0
    assert peak == 40.0
    other = noise(with_sensor("joint_torque", spec), 5, 20_000, 1e-3)["joint_torque"]
    assert abs(np.corrcoef(found, other)[0, 1]) < 0.999  # the phase is drawn
