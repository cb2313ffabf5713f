"""Joint torque from the motor current: what reaches the output when friction and the rotor's inertia are taken off.

    T = (Kt·i + cogging − (Jm + Jw)·ωm' − (bm + bw)·ωm − Fmesh(ωm)) / (1/N − θerr'(θm)) − bl·ωm/N

the torque balance of rotor and wave generator as one body (`models.laws`), with the LuGre bristle driven by the measured
velocity. Velocity and acceleration are the motor encoder's, through a causal second-order low-pass; current and inertia
torque pass the same one, so that they stay in step. It needs no second encoder; at rest, friction may be anything up to its
level, and so may the error.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numba import njit

from ...models import laws
from ..knobs import Knob
from .base import Estimator, JointSignals, SensorNoise, TorqueEstimate
from .joint_dynamics import drive_current, known


@njit(cache=True, nogil=True, error_model="numpy")
def run(time, motor, link, current, record, cutoff, torque, states):
    """Write torque [N·m], shape (n,); filtered ωm, ωm', current, and bristle, shape (n, 4). `cutoff` in [rad/s].

    The low-pass is y'' = ω²(u − y) − √2·ω·y' (Butterworth), stepped semi-implicitly; its y' is a velocity for free.
    """
    p = record[0]
    y, w, i_low, i_rate, z, T = motor[0], 0.0, current[0], 0.0, 0.0, 0.0
    for k in range(len(time)):
        a = 0.0
        if k > 0:
            h = time[k] - time[k - 1]
            damping = 1.0 + math.sqrt(2.0) * cutoff * h + (cutoff * h) ** 2  # implicit: stable at any step
            before = w
            w = (w + cutoff**2 * h * (motor[k] - y)) / damping
            y += h * w
            a = (w - before) / h
            i_rate = (i_rate + cutoff**2 * h * (current[k] - i_low)) / damping
            i_low += h * i_rate
            z = laws.bristle_step(z, w, laws.friction_level(w, link[k], T, time[k], p), h, p)
        g = laws.friction_level(w, link[k], T, time[k], p)
        drive = p.Kt * i_low + laws.rotor_torque(motor[k], p) - (p.Jm + p.Jw) * a - (p.bm + p.bw) * w
        T = (drive - laws.mesh_friction(z, w, g, p)) / (1.0 / p.N - laws.kinematic_error_slope(motor[k], p))
        torque[k] = laws.torque_reading(T - p.bl * w / p.N, time[k], p)
        states[k, 0], states[k, 1], states[k, 2], states[k, 3] = w, a, i_low, z


@dataclass(frozen=True)
class MotorCurrent(Estimator):
    """Joint torque from motor current.

    Attributes:
        cutoff: of the low-pass [Hz].
    """

    name: str = "motor_current"
    cutoff: float = 40.0
    knobs: ClassVar[tuple[Knob, ...]] = (Knob("cutoff", 1.0, 300.0),)

    def estimate(self, signals: JointSignals, record: np.ndarray, noise: SensorNoise) -> TorqueEstimate:
        p = known(record)
        torque, states = np.empty(len(signals.time)), np.empty((len(signals.time), 4))
        current = drive_current(signals, p)
        link = signals.link_position - p["link_zero"]
        cutoff = 2 * math.pi * self.cutoff
        run(signals.time, signals.motor_position, link, current, record, cutoff, torque, states)
        names = ("motor_velocity", "motor_acceleration", "motor_current", "bristle")
        return TorqueEstimate(self.name, torque, None, states, names)


ESTIMATORS = (MotorCurrent(),)
