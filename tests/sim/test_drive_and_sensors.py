"""The DC motor, the position controller and the sensors against closed forms."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from driving import JOINT, record_of
from flexspline.models.joint import AnalogSpec, EncoderSpec
from flexspline.sim import plant
from flexspline.sim.drive import Controller, control
from flexspline.sim.sensors import NAMES, SENSOR, WRENCH, noise, quantise, sample, sensor_records, stream

R, L, KT = 1.16, 0.33e-3, 0.0603


def currents(command, timestep, steps, locked=True, **changes):
    """Motor current [A] and torque [N·m] after each step at a constant command [A], and the rotor's velocity."""
    record = record_of("no_load", **changes)
    model = plant.build(JOINT, JOINT.mount("no_load"), timestep=timestep, record=record, locked_rotor=locked)
    data = mujoco.MjData(model)
    plant.start(model, data)
    data.ctrl[0] = KT * command
    at = plant.activation(model, "motor")
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
    record["period"] = 1e-3
    for name, value in values.items():
        record[name] = value
    return record[0]


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
    records = sensor_records(JOINT, 0.004)
    assert records["step"][0] == pytest.approx(2 * np.pi / 4096)
    assert records["step"][1] == pytest.approx(2 * np.pi / 2**20)
    assert records["delay"][1] == 0.004


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
    normal = stream(3, "motor_current").standard_normal(50_000)
    got = sampled(np.zeros(50_000), one(noise=0.01), normal)
    assert got.std() == pytest.approx(0.01, rel=0.02)
    held = sampled(np.zeros(1000), one(noise=0.01, period=0.004), normal)
    assert (np.diff(held.reshape(-1, 4), axis=1) == 0).all()


def test_streams_are_independent():
    """Named streams: another sensor, or more of them, changes nothing; other names and seeds share nothing."""
    all_noise = noise(5, 4000)
    assert all_noise.shape == (10, 4000)
    for i, name in enumerate((*NAMES, *WRENCH)):
        np.testing.assert_array_equal(all_noise[i], stream(5, name).standard_normal(4000))
    np.testing.assert_array_equal(noise(5, 8000)[:, :4000], all_noise)
    correlation = np.corrcoef(np.concatenate([all_noise, noise(6, 4000)]))
    assert np.abs(correlation - np.eye(20)).max() < 0.08


def test_an_analog_sensor_has_steps_too():
    joint = JOINT.model_copy(
        update={
            "sensors": JOINT.sensors.model_copy(update={"joint_torque": AnalogSpec(noise=0.02, step=0.1, rate=500)})
        }
    )
    record = sensor_records(joint, 0.0)[3]
    assert record["noise"] == 0.02 and record["step"] == 0.1 and record["period"] == pytest.approx(0.002)
