"""Realistic sensors, clock and drive: a force at a point of the link in the wrench, crosstalk, a drive that lags, jitter."""

from __future__ import annotations

import math

import mujoco
import numpy as np
import pytest
from driving import JOINT
from looping import motion, simulate

from flexspline.models.controller import Controller
from flexspline.models.joint_parts import WrenchSpec
from flexspline.models.signals import SENSED, WRENCH
from flexspline.sim import plant
from flexspline.sim.loop import CONTROL_PERIOD
from flexspline.sim.sensors import noise, realistic, sensor_records, time_stamps, wrench_crosstalk


def run(joint=JOINT, controller=None, **more):
    """The loop of `looping.run`, with options."""
    mounted = joint.mount("link")
    record = joint.record(mounted)
    position, velocity, external = motion(seconds=1.0)
    return simulate(
        plant.build(joint, mounted, record=record), record, position, velocity, external,
        sensor_records(joint, 0.0, CONTROL_PERIOD), noise(joint, 3, len(position), CONTROL_PERIOD),
        (controller or Controller()).record(record[0], CONTROL_PERIOD, False), **more,
    )  # fmt: skip


@pytest.mark.parametrize("angle", [0.0, 0.7, -1.9])
def test_wrench_of_a_force_at_a_point(angle):
    """MuJoCo's own force and torque sensor, under a force at the point and under its torque alone: 12.5 N for 5 N·m at 0.4 m."""
    lever, torque = 0.4, 5.0
    model = plant.build(JOINT, JOINT.mount("link"))
    link = model.body("link").id
    force = int(model.sensor("force").adr[0])
    found, moved = [], []
    for at_a_point in (False, True):
        data = mujoco.MjData(model)
        data.qpos[:3] = 100 * angle, 100 * angle, angle
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        if at_a_point:
            frame = data.xmat[link].reshape(3, 3)
            push = frame @ [torque / lever, 0.0, 0.0]
            arm = data.xpos[link] + frame @ [0.0, 0.0, -lever] - data.xipos[link]
            data.xfrc_applied[link] = np.r_[push, np.cross(arm, push)]
        else:
            data.xfrc_applied[link, 4] = -torque
        mujoco.mj_forward(model, data)
        found.append(data.sensordata[force : force + 6].copy())
        moved.append(data.qacc.copy())
    np.testing.assert_allclose(moved[1], moved[0], rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(found[0] - found[1], [torque / lever, 0, 0, 0, 0, 0], atol=1e-9)


def test_the_loops_wrench_shows_the_force_and_other_channels_do_not_change():
    external = motion(seconds=1.0)[2]
    plain, pushed = run(), run(tip_force=external / 0.4)
    assert plain.truth.tobytes() == pushed.truth.tobytes() and plain.command.tobytes() == pushed.command.tobytes()
    for name in SENSED:
        if name != "force_x":
            assert np.array_equal(plain.readings[name], pushed.readings[name]), name
    held = np.r_[0.0, external[:-1]] == external  # but for the ticks at which it changes
    change = plain.readings["force_x"] - pushed.readings["force_x"]
    np.testing.assert_allclose(change[held], external[held] / 0.4, atol=1e-9)
    assert np.abs(change).max() == pytest.approx(10.0)


def test_crosstalk_mixes_axes_by_their_rated_loads():
    joint = JOINT.model_copy(
        update={"sensors": JOINT.sensors.model_copy(update={"wrench": WrenchSpec(crosstalk=0.02, rated_force=200.0)})}
    )
    mixed = wrench_crosstalk(joint, 5)
    assert np.all(np.diag(mixed) == 0.0) and not np.array_equal(mixed, wrench_crosstalk(joint, 6))
    rated = np.r_[200.0, 200.0, 200.0, 30.0, 30.0, 30.0]
    assert np.abs(mixed * rated[None, :] / rated[:, None]).max() <= 0.02
    plain, crossed = run(joint), run(joint, crosstalk=mixed)
    a, b = (np.column_stack([s.readings[name] for name in WRENCH]) for s in (plain, crossed))
    np.testing.assert_allclose(b, a + a @ mixed.T, atol=1e-9)
    assert np.abs(b - a).max() > 0.01


@pytest.mark.parametrize("delay", [0.0, 0.4e-3, 2e-3, 3.8e-3])
def test_a_drive_that_lags(delay):
    """The current is that of a winding, L i' = R (command − i), whose command came `delay` ago: exactly, step by step."""
    found = run(controller=Controller().lagging(delay))
    p = JOINT.record()[0]
    h, substeps = plant.TIMESTEP, round(CONTROL_PERIOD / plant.TIMESTEP)
    late = round(delay / h)
    steps = np.repeat(found.command, substeps)
    steps = np.r_[np.zeros(late), steps][: len(steps)]
    inputs = 0.5 * (steps + np.r_[0.0, steps[:-1]])
    current, decay = np.zeros(len(steps) + 1), math.exp(-h * p["R"] / p["L"])
    for k, wanted in enumerate(inputs):
        current[k + 1] = wanted + (current[k] - wanted) * decay
    np.testing.assert_allclose(found.truth["motor_current"], current[:-1:substeps], atol=1e-9)


def test_gains_of_a_lagging_drive_keep_its_phase_margin():
    """At the crossover of the rigid motor, Kt·(kp + kd·s·lag)/(J s²) with all dead times: by frequency response."""
    p = JOINT.record()[0]

    def margin(c):
        w = np.geomspace(5.0, 2000.0, 20_000)
        s = 1j * w
        late = c.delay + 0.5e-3
        open_loop = (
            p["Kt"] * (c.kp + c.kd * s / (1 + c.velocity_filter * s)) / ((p["Jm"] + p["Jw"]) * s**2) * np.exp(-late * s)
        )
        at = np.flatnonzero(np.abs(open_loop) > 1.0)[-1]
        return 180 + np.degrees(np.unwrap(np.angle(open_loop)))[at]

    own = margin(Controller())
    for delay in (1e-3, 2e-3, 4e-3):
        assert margin(Controller().lagging(delay)) > own - 8.0
    assert margin(Controller(delay=4e-3)) < own - 30.0


def test_time_stamps_increase_with_the_stated_jitter():
    time = np.arange(20_000) * 1e-3
    assert time_stamps(time, 0.0, 1) is time
    found = time_stamps(time, 1e-4, 1)
    assert (np.diff(found) > 0).all() and np.std(found - time) == pytest.approx(1e-4, rel=0.03)
    assert not np.array_equal(found, time_stamps(time, 1e-4, 2))


def test_realistic_sensors_keep_what_a_joint_states():
    assert set(realistic(JOINT)["motor_current"]) == {"step", "ripple"}
    stated = JOINT.sensors.motor_current.model_copy(update={"step": 0.01})
    joint = JOINT.model_copy(update={"sensors": JOINT.sensors.model_copy(update={"motor_current": stated})})
    assert "step" not in realistic(joint)["motor_current"]
