"""Driving the plant open loop, as the closed loop does: inputs change at the ticks, half a step spans each of them."""

from __future__ import annotations

import mujoco
import numpy as np

from flexspline.models.joint import load_joint
from flexspline.sim import plant
from flexspline.sim.plugin import DAHL, TEMPERATURE, transmission_at

JOINT = load_joint("test-joint")
PIECES = [(0.15, 0.06, 0.0), (0.15, -0.06, 3.0), (0.15, 0.03, -4.0), (0.05, 0.0, 0.0)]
"""(duration [s], motor torque [N·m], torque on the link [N·m]): forward, back, loads in both directions, let go."""


def record_of(mounting="link", **changes) -> np.ndarray:
    """The test joint's record in a mounting, with numbers changed; of array fields the first element."""
    record = JOINT.record(JOINT.mount(mounting))
    for name, value in changes.items():
        if record[0][name].ndim:
            record[0][name][0] = value
        else:
            record[0][name] = value
    return record


def drive(record, pieces=PIECES, timestep=plant.TIMESTEP, period=1e-3, start=None, mounting="link", temperature=None):
    """Run the plant with ideal current; `temperature` [°C]: a function of time, held over each period.

    Returns:
      Positions, velocities (n, 3) and joint torque Ts (n,) at the ticks, and what the wrench's torque sensor gave (n, 3).
    """
    model = plant.build(JOINT, JOINT.mount(mounting), timestep=timestep, record=record, ideal_current=True)
    data = mujoco.MjData(model)
    plant.start(model, data, start)
    p = record[0]
    substeps = round(period / timestep)
    body = model.body("link").id
    sensor = int(model.sensor("torque").adr[0])
    memory = plant.memory(model, data)
    theta, omega, torque, wrench = [], [], [], []
    last = (0.0, 0.0)
    for duration, motor, external in pieces:
        for _ in range(round(duration / period)):
            if temperature is not None:
                memory[TEMPERATURE] = temperature(len(theta) * period)
            theta.append(data.qpos.copy())
            before = data.qvel.copy()
            data.ctrl[0] = 0.5 * (motor + last[0])
            data.xfrc_applied[body, 4] = -0.5 * (external + last[1])
            mujoco.mj_step(model, data)
            omega.append(0.5 * (before + data.qvel))
            wrench.append(data.sensordata[sensor : sensor + 3].copy())
            torque.append(
                transmission_at(theta[-1][:3], omega[-1][:3], memory[DAHL], p).flexspline_torque
                - p["bl"] * omega[-1][2]
            )
            data.ctrl[0] = motor
            data.xfrc_applied[body, 4] = -external
            if substeps > 1:
                mujoco.mj_step(model, data, nstep=substeps - 1)
            last = (motor, external)
    return np.array(theta), np.array(omega), np.array(torque), np.array(wrench)


def relative(ours, theirs) -> float:
    """RMS difference relative to the standard deviation of `theirs`."""
    return float(np.sqrt(np.mean((ours - theirs) ** 2)) / np.std(theirs))
