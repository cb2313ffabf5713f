"""Generalized momentum observers: external and joint torque without accelerations.

De Luca & Mattone ("Actuator failure detection and isolation using generalized momenta", ICRA 2003; "Sensorless robot
collision detection and hybrid force/motion control", ICRA 2005). For a momentum p with p' = known torques + unknown,

    r = K (p − p(0) − ∫ (known + r) dt)        so that  r' = K (unknown − r)

Two of them, one a body: the drive's, p_m = (Jm + Jw)·ωm, whose unknown is what the flexspline takes, −Tf/N; and the
link's, p_l = Jl·ωl, whose unknown is Ts + τext.

    known_m = Kt·i + cogging − (bm + bw)·ωm − Fmesh        Ts = −N·r_m − bl·ωl
    known_l = −Mg·sin θl + link torques                    τext = r_l − Ts

With one K for both, τext is De Luca's residual of the joint as one rigid body, momentum p_l + N·p_m (a test says so), and
Ts is the joint torque through the same first-order lag. Friction is the LuGre law's at the measured velocity.

`momentum_torsion` combines it with the torsion, which knows nothing of friction: while the joint turns, friction is its
model's and the observer is right in the mean; at rest, friction is anything up to its level and only the torsion tells
of changes. Weight of the observer s = ωm²/(ωm² + ω₀²), through a low-pass; the torsion's offset follows the observer
while it turns, and holds at rest:

    T = s·T_observer + (1 − s)·(T_torsion + b)        b' = s·(T_observer − T_torsion − b)/time

Graabæk & Sloth (2025) is what issue 4 calls this combination. Their text was not at hand: this is a reading of that name,
not of the paper.
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
from .compliance_model import compliance_measurement
from .joint_dynamics import drive_current, known

STATES = ("joint_torque_observed", "external_torque", "motor_velocity", "link_velocity", "bristle")


@njit(cache=True, nogil=True, error_model="numpy")
def observe(time, motor, link, current, record, gain, cutoff, states):
    """Run both observers; states: output, shape (n, 5), Ts [N·m] at the output before the sensor, τext [N·m], velocities.

    gain: K [1/s]; cutoff: of the velocities' first-order low-pass [rad/s]. Steps are implicit in r: stable at any K.
    """
    p = record[0]
    w, v, z, rm, rl, T = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    drive_sum, link_sum = 0.0, 0.0
    for k in range(len(time)):
        if k > 0:
            h = time[k] - time[k - 1]
            share = 1.0 - math.exp(-cutoff * h)
            w += share * ((motor[k] - motor[k - 1]) / h - w)
            v += share * ((link[k] - link[k - 1]) / h - v)
            z = laws.bristle_step(z, w, laws.friction_level(w, link[k], T, time[k], p), h, p)
            g = laws.friction_level(w, link[k], T, time[k], p)
            known_m = p.Kt * current[k] + laws.rotor_torque(motor[k], p) - (p.bm + p.bw) * w
            drive_sum += h * (known_m - laws.mesh_friction(z, w, g, p))
            rm = gain * ((p.Jm + p.Jw) * w - drive_sum) / (1.0 + gain * h)
            drive_sum += h * rm
            T = -rm / (1.0 / p.N - laws.kinematic_error_slope(motor[k], p)) - p.bl * v
            link_sum += h * (laws.gravity_torque(link[k], p) + laws.link_torque(link[k], p))
            rl = gain * (p.Jl * v - link_sum) / (1.0 + gain * h)
            link_sum += h * rl
        states[k, 0], states[k, 1], states[k, 2], states[k, 3], states[k, 4] = T, rl - T, w, v, z


@njit(cache=True, nogil=True, error_model="numpy")
def combine(time, observed, torsion, w, turning, smoothing, follow, out):
    """Blend observer and torsion, shape (n,), by velocity; turning ω₀ [rad/s], smoothing and follow [s]."""
    s = b = 0.0
    for k in range(len(time)):
        h = time[k] - time[k - 1] if k > 0 else 0.0
        now = w[k] ** 2 / (w[k] ** 2 + turning**2)
        s += (1.0 - math.exp(-h / smoothing)) * (now - s)
        b += (1.0 - math.exp(-h * s / follow)) * (observed[k] - torsion[k] - b)
        out[k] = s * observed[k] + (1.0 - s) * (torsion[k] + b)


@dataclass(frozen=True)
class MomentumObserver(Estimator):
    """Momentum observers of drive and link.

    Attributes:
        bandwidth: K/2π [Hz].
        cutoff: of the velocities' low-pass [Hz].
    """

    name: str = "momentum"
    bandwidth: float = 20.0
    cutoff: float = 40.0
    knobs: ClassVar[tuple[Knob, ...]] = (Knob("bandwidth", 0.5, 200.0), Knob("cutoff", 2.0, 400.0))

    def estimate(self, signals: JointSignals, record: np.ndarray, noise: SensorNoise) -> TorqueEstimate:
        p = known(record)
        states = np.empty((len(signals.time), len(STATES)))
        link = signals.link_position - p["link_zero"]
        gain, cutoff = 2 * math.pi * self.bandwidth, 2 * math.pi * self.cutoff
        current = drive_current(signals, p)
        observe(signals.time, signals.motor_position, link, current, record, gain, cutoff, states)
        torque = p["torque_gain"] * states[:, 0] + p["torque_offset"] + p["torque_rate"] * signals.time
        return TorqueEstimate(self.name, torque, None, states, STATES)


@dataclass(frozen=True)
class MomentumTorsion(MomentumObserver):
    """Momentum observer while turning, torsion at rest.

    Attributes:
        turning: motor velocity ω₀ from which on the observer counts [vs, the Stribeck velocity].
        smoothing: of the weight [s].
        follow: time in which the torsion's offset follows the observer [s].
    """

    name: str = "momentum_torsion"
    turning: float = 1.0
    smoothing: float = 0.02
    follow: float = 1.0
    knobs: ClassVar[tuple[Knob, ...]] = (
        *MomentumObserver.knobs, Knob("turning", 0.05, 50.0), Knob("smoothing", 1e-3, 1.0), Knob("follow", 0.02, 100.0),
    )  # fmt: skip

    def estimate(self, signals: JointSignals, record: np.ndarray, noise: SensorNoise) -> TorqueEstimate:
        observed = super().estimate(signals, record, noise)
        torsion, _ = compliance_measurement(signals, record, noise)
        torque = np.empty_like(torsion)
        turning = self.turning * float(record[0]["vs"])
        velocity = np.ascontiguousarray(observed.states[:, 2])
        combine(signals.time, observed.torque, torsion, velocity, turning, self.smoothing, self.follow, torque)
        return TorqueEstimate(self.name, torque, None, observed.states, STATES)


ESTIMATORS = (MomentumObserver(), MomentumTorsion())
