"""Accelerations of a built plant against the equations of motion of its record."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np

from flexspline.models import dynamics, laws
from flexspline.sim import native
from flexspline.sim.plugin import (
    BRISTLE,
    DAHL,
    FLEXIBLE,
    LINK,
    MEMORY,
    TEMPERATURE,
    WAVE_GENERATOR,
    at_positions,
    reduced_inertia,
)  # fmt: skip

_STATES = (
    (0.3, 0.28, 0.0021, 4.0, 3.5, 0.05),
    (-57.1, -57.12, -0.5719, -30.0, -31.0, -0.2),
    (160.0, 160.01, 1.6, 0.2, 9.0, 0.4),
)
"""States in which a model is checked: positions and velocities of rotor, wave generator (of a ratio of 100) and link."""
_CLOSE = 1e-6


def check_motion(model: mujoco.MjModel, record: np.ndarray, locked: float = 0.0) -> None:
    """Compare a built model's accelerations with the equations of motion of its description.

    Args:
      model: of `plant.build`; record: its parameters, shape (1,); locked: inertia that locks the rotor [kg·m²].
    """
    p = record[0]
    h = model.opt.timestep
    data = mujoco.MjData(model)
    memory = data.plugin_state
    current_at = int(model.actuator_actadr[model.actuator("motor").id])
    torque_at = int(model.sensor("torque").adr[0])
    for numbers in _STATES:
        theta, velocity = np.array(numbers[:3]), np.array(numbers[3:])
        # Torsions are those of a ratio of 100; of another the same.
        theta[LINK] += theta[WAVE_GENERATOR] * (1.0 / p["N"] - 0.01)
        bristle, dahl, current = 0.3 * p["Fc"] / p["s0"] if p["s0"] > 0 else 0.0, 0.0, 0.2 * p["current_limit"]
        data.qpos[:3], data.qvel[:3], data.act[:] = theta, velocity, 0.0
        if model.nv > FLEXIBLE:
            data.qpos[FLEXIBLE], data.qvel[FLEXIBLE] = 1e-3, 0.02
        memory[MEMORY : MEMORY + model.nv] = data.qvel
        if p["hysteresis_torque"] != 0:
            dahl = 0.3 * p["hysteresis_extent"]
        memory[BRISTLE], memory[DAHL] = bristle, dahl
        if current_at >= 0:
            data.act[current_at], data.ctrl[0] = current, 0.0
        else:
            data.ctrl[0] = p["Kt"] * current
        with native.quiet():
            mujoco.mj_forward(model, data)
        state, t, g = at_positions(theta, velocity, velocity, bristle, dahl, 0.0, h, memory[TEMPERATURE], p)
        b = dynamics.balance_with(state, t, g, p)
        drive = float(data.actuator_force[model.actuator("motor").id])  # its current, within a step, is MuJoCo's own
        force, inertia = _expected(b, drive, data, p, h, locked)
        expected = np.linalg.solve(inertia, force)
        error = inertia @ (data.qacc - expected)
        scale = (
            np.abs(force) + abs(b.wave_generator_torque) + np.r_[0.0, 0.0, np.full(model.nv - 2, abs(b.load) + p["Mg"])]
        )
        wrong = np.flatnonzero(~(np.abs(error) <= _CLOSE * scale + 1e-12))
        if len(wrong):
            name = model.joint(int(wrong[0])).name
            raise AssertionError(
                f"{name} accelerates by {data.qacc[wrong[0]]:.6g} rad/s², expected {expected[wrong[0]]:.6g} rad/s²"
            )
        # The torque that the sensor reads about y, against the axis: what moves link and flexible part against their weight.
        through = p["Jl"] * data.qacc[LINK] - b.gravity
        if model.nv > FLEXIBLE:
            through += laws.flexible_inertia(p) * data.qacc[FLEXIBLE]
        reading = data.sensordata[torque_at + 1]
        if not abs(reading + through) <= 1e-3 * (abs(through) + abs(b.load)):
            raise AssertionError(
                f"sensor torque: expected {-through:.6g} N·m about its y, the joint's axis, got {reading:.6g} N·m"
            )


def _expected(
    b: Any, drive: float, data: mujoco.MjData, p: np.void, h: float, locked: float
) -> tuple[np.ndarray, np.ndarray]:
    """Generalised forces and inertia matrix of the joint's coordinates, with the plant's corrections of order h²."""
    force = np.array([b.on_rotor + drive, b.on_wave_generator, b.on_link])
    inertia = np.diag([p["Jm"] + locked, p["Jw"], p["Jl"]])
    reduced = reduced_inertia(p)
    more = h**2 / 12 * p["K1"] / reduced * p["df"] * b.torsion_rate
    force[WAVE_GENERATOR] -= more * b.ratio
    force[LINK] += more
    across = np.array([0.0, 1.0 / p["N"], -1.0])
    inertia += (
        h**2 / 12 * (p["K1"] + p["df"] ** 2 / reduced) * np.diag(across**2)
    )  # MuJoCo has no entry across branches
    if data.qpos.size > FLEXIBLE:
        flexible = laws.flexible_inertia(p)
        force = np.append(force, -laws.flexible_torque(data.qpos[FLEXIBLE], data.qvel[FLEXIBLE], p))
        whole = np.zeros((4, 4))
        whole[:3, :3] = inertia
        whole[LINK, FLEXIBLE] = whole[FLEXIBLE, LINK] = whole[FLEXIBLE, FLEXIBLE] = flexible
        inertia = whole
    return force, inertia
