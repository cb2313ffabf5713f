"""The compiled laws inside MuJoCo: batches, rollouts, threads, several models."""

from __future__ import annotations

import ctypes

import mujoco
import numpy as np
import pytest
from driving import JOINT, record_of
from mujoco import batch, rollout

from flexspline.models.calibration import Calibration
from flexspline.models.parameters import as_floats
from flexspline.sim import native, plant, plugin

STATE = mujoco.mjtState.mjSTATE_FULLPHYSICS


def started(record, mounting="link", start=None):
    model = plant.build(JOINT, JOINT.mount(mounting), record=record, ideal_current=True)
    data = mujoco.MjData(model)
    plant.start(model, data, start)
    return model, data


def single(model, data, control):
    """Step by step in Python: the states after each step."""
    states = []
    for u in control:
        data.ctrl[:] = u
        mujoco.mj_step(model, data)
        state = np.empty(mujoco.mj_stateSize(model, STATE))
        mujoco.mj_getState(model, data, state, STATE)
        states.append(state)
    return np.array(states)


@pytest.fixture(params=["all that is remembered", "plain"])
def record(request):
    if request.param != "plain":
        return record_of(friction_asymmetry=0.2, friction_load=0.1, hysteresis_torque=0.5, hysteresis_extent=8e-5)
    return record_of()


def runs(record, rng, n=6, steps=400):
    """Initial states and controls of n runs, and their states stepped one by one."""
    initial, controls, expected = [], [], []
    for i in range(n):
        model, data = started(record, start=np.array([100, 100, 1.0]) * 0.05 * i)
        state = np.empty(mujoco.mj_stateSize(model, STATE))
        mujoco.mj_getState(model, data, state, STATE)
        control = np.zeros((steps, model.nu))
        control[:, 0] = 0.02 * np.repeat(rng.standard_normal(steps // 50), 50)
        initial.append(state)
        controls.append(control)
        expected.append(single(model, data, control))
    return model, np.array(initial), np.array(controls), np.array(expected)


def test_rollout_on_threads_is_single_stepping_to_the_bit(record, rng):
    model, initial, control, expected = runs(record, rng)
    data = [mujoco.MjData(model) for _ in range(3)]
    states, _ = rollout.rollout(model, data, initial, control)
    np.testing.assert_array_equal(states, expected)


def test_batch_on_threads_is_single_stepping_to_the_bit(record, rng):
    model, initial, control, expected = runs(record, rng)
    simulations = batch.Batch(model, len(initial), nthread=3)
    for name in ("time", "qpos", "qvel", "act", "plugin_state"):
        simulations.bind(name)[:] = _component(model, initial, name)
    got = simulations.rollout(control.shape[1], control, record=[int(STATE)])[int(STATE)]
    np.testing.assert_array_equal(got, expected)


def _component(model, states, name):
    data = mujoco.MjData(model)
    found = []
    for state in states:
        mujoco.mj_setState(model, data, state, STATE)
        found.append(np.array(getattr(data, name)))
    return np.array(found)


def test_the_plants_numbers_are_the_records_to_the_bit():
    """Also those with seventeen digits, of a joint within its tolerances."""
    calibration = Calibration(JOINT)
    drawn = calibration.record(np.linspace(-1.0, 1.0, calibration.size))
    data = mujoco.MjData(plant.build(JOINT, record=drawn))
    assert np.array_equal(as_floats(plugin.instance(data, 0)[1]), as_floats(drawn))


def test_two_joints_in_one_process_do_not_mix():
    """The record travels in the model, not in the process."""
    stiff, soft = record_of(K1=8400.0), record_of(K1=4200.0)
    first = started(stiff)
    alone = single(*first, np.full((200, 1), 0.05))
    a, b = started(stiff), started(soft)
    interleaved = []
    for _ in range(200):
        for model, data in (a, b):
            data.ctrl[0] = 0.05
            mujoco.mj_step(model, data)
        state = np.empty(mujoco.mj_stateSize(a[0], STATE))
        mujoco.mj_getState(*a, state, STATE)
        interleaved.append(state)
    np.testing.assert_array_equal(interleaved, alone)
    assert not np.array_equal(a[1].qpos, b[1].qpos)


def test_offsets_point_at_what_python_sees():
    _, data = started(record_of())
    at = native.offsets()
    for name in ("qpos", "qvel", "ctrl", "qfrc_passive", "xfrc_applied", "sensordata", "plugin_state"):
        pointer = ctypes.c_uint64.from_address(data._address + 8 * at[name]).value
        assert pointer == getattr(data, name).ctypes.data, name
    assert ctypes.c_double.from_address(data._address + 8 * at["time"]).value == data.time


def timed(data):
    """How often MuJoCo has timed a step of this data, and the time that it took, in all [s]."""
    timer = data.timer[mujoco.mjtTimer.mjTIMER_STEP]
    return timer.number, timer.duration


def test_the_clock_stands_still_inside_and_is_back_afterwards():
    """Of several threads the last one to leave puts it back; motion does not depend on it."""
    before = ctypes.c_void_p.in_dll(native.library(), "mjcb_time").value
    assert before
    model, data = started(record_of())
    _, other = started(record_of())
    for _ in range(20):
        mujoco.mj_step(model, other)
    with native.untimed():
        with native.untimed():
            for _ in range(10):
                mujoco.mj_step(model, data)
        for _ in range(10):
            mujoco.mj_step(model, data)
        assert timed(data) == (20, 0.0)
    assert ctypes.c_void_p.in_dll(native.library(), "mjcb_time").value == before
    assert timed(other)[1] > 0.0
    np.testing.assert_array_equal(np.concatenate([data.qpos, data.qvel]), np.concatenate([other.qpos, other.qvel]))


def test_another_clock_is_kept():
    asked = []
    model, data = started(record_of())
    mujoco.set_mjcb_time(lambda: float(asked.append(None) or len(asked)))
    try:
        with native.untimed():
            mujoco.mj_step(model, data)
    finally:
        mujoco.set_mjcb_time(None)
    assert asked
