"""Generalised-momentum observers (De Luca & Mattone, "Actuator failure detection and isolation using generalized
momenta", ICRA 2003; "Sensorless robot collision detection and hybrid force/motion control", ICRA 2005). For a
momentum p with p' = known torques + unknown,

    r = K (p − p(0) − ∫ (known + r) dt)        so that  r' = K (unknown − r)

One for each body: the drive's, p_m = (Jm + Jw)·ωm, whose unknown is the flexspline's load −Tf·(1/N − θerr'); and the
link's, p_l = Jl·ωl, whose unknown is Ts + τext.

    known_m = Kt·i + cogging − bm·ωm − Fmesh           Ts = −r_m/(1/N − θerr') − bl·ωl
    known_l = −Mg·sin θl + link torques                τext = r_l − Ts

With one K for both, τext is De Luca's residual of the joint as one rigid body, momentum p_l + N·p_m (tested), and Ts
is the joint torque through the same first-order lag, which the transmission's ratio passes too. Friction is the LuGre
law's at the measured velocity.

`momentum_torsion` combines it with the torsion, which does not depend on friction. While the joint turns, friction
follows its model and the observer has no mean error. At rest, friction is unknown up to its level, and only the
torsion shows changes. The observer's weight is s = ωm²/(ωm² + ω₀²), through a low-pass. The torsion's offset follows
the observer in motion, and is constant at rest:

    T = s·T_observer + (1 − s)·(T_torsion + b)        b' = s·(T_observer − T_torsion − b)/time

A combination of this kind is Graabæk & Sloth's (2025). Their text was not available: this follows the name, not the
paper.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from ...models import dynamics, laws
from ...models.kernels import kernel
from ...models.parameters import floats
from ...models.step import NOT_FINITE, OK, Step, step_of
from ..compliance import TORSION, measure
from ..estimator import CausalEstimator, KnownJoint, TuningParameter
from ..sensing import arm_torque, motor_current, temperature

OBSERVER = floats(
    "motor_position", "link_position", "motor_velocity", "link_velocity", "bristle", "drive_sum", "link_sum", "drive_residual",
    "link_residual", "ratio", "load", "joint_torque",
)  # fmt: skip
"""Memory of both observers: corrected angles and velocities, sums ∫ (known + r) dt, residuals r, joint torque Ts."""
MEMORY = floats(("torsion", TORSION), ("observer", OBSERVER), "weight", "offset")
SETTINGS = floats("gain", "cutoff", "turning", "smoothing", "follow")  # turning 0: without the torsion
OUT = floats("torque", "external_torque", "joint_torque_observed", "motor_velocity", "link_velocity", "bristle")


@kernel
def observe(m, s, found, c, p):
    """Update both observers, a record of `OBSERVER`, with a sample; `found`: of `compliance.measure`; `c`: record of
    `SETTINGS`, gain K [1/s] and cutoff of the velocities' first-order low-pass [rad/s]."""
    h, K = s.interval, c.gain
    motor, link = found.motor_position, found.link_position
    ratio = 1.0 / p.N - laws.kinematic_error_slope(motor, p)
    if h == 0.0:
        m.motor_position, m.link_position, m.ratio = motor, link, ratio
        return
    share = 1.0 - math.exp(-c.cutoff * h)
    m.motor_velocity += share * ((motor - m.motor_position) / h - m.motor_velocity)
    m.link_velocity += share * ((link - m.link_position) / h - m.link_velocity)
    m.motor_position, m.link_position = motor, link
    w, v = m.motor_velocity, m.link_velocity
    current = motor_current(s, motor, link, w, m.load, p)
    state = dynamics.drive_state(motor, w, link, v, m.bristle, current, s.time, temperature(s, p))
    g = dynamics.sliding_friction(state, m.load, p)
    m.bristle = laws.bristle_step(m.bristle, w, g, h, p)
    state = dynamics.drive_state(motor, w, link, v, m.bristle, current, s.time, temperature(s, p))
    m.drive_sum += h * (dynamics.rotor_torque(state, 0.0, m.load, p) - dynamics.mesh_torque(state, m.load, g, p))
    m.drive_residual = K * ((p.Jm + p.Jw) * w - m.drive_sum) / (1.0 + K * h)  # implicit in r: stable at any K
    m.drive_sum += h * m.drive_residual
    m.ratio += K * h * (ratio - m.ratio) / (1.0 + K * h)
    m.load = -m.drive_residual / m.ratio
    m.joint_torque = m.load - p.bl * v
    m.link_sum += h * (dynamics.link_torque(state, m.load, p) + arm_torque(s))
    m.link_residual = K * (p.Jl * v - m.link_sum) / (1.0 + K * h)
    m.link_sum += h * m.link_residual


@step_of(MEMORY, SETTINGS, OUT)
def _step(m, s, p, c, o):
    observer, h, found = m.observer, s.interval, measure(m.torsion, s, p)
    observe(observer, s, found, c, p)
    w, observed = observer.motor_velocity, observer.joint_torque
    o.torque = observed
    if c.turning > 0.0:  # combined with the torsion
        m.weight += (1.0 - math.exp(-h / c.smoothing)) * (w**2 / (w**2 + c.turning**2) - m.weight)
        m.offset += (1.0 - math.exp(-h * m.weight / c.follow)) * (observed - found.torque - m.offset)
        o.torque = m.weight * observed + (1.0 - m.weight) * (found.torque + m.offset)
    o.external_torque, o.joint_torque_observed = observer.link_residual - o.torque, observed
    o.motor_velocity, o.link_velocity, o.bristle = w, observer.link_velocity, observer.bristle
    return OK if math.isfinite(o.torque + observer.link_residual) else NOT_FINITE


@dataclass(frozen=True)
class MomentumObserver(CausalEstimator):
    """Momentum observers of drive and link."""

    name: str = "momentum"
    bandwidth: float = 20.0  # K/2π [Hz]
    cutoff: float = 40.0  # of the velocities' low-pass [Hz]
    tuning: ClassVar[tuple[TuningParameter, ...]] = (
        TuningParameter("bandwidth", 0.5, 200.0), TuningParameter("cutoff", 2.0, 400.0),
    )  # fmt: skip
    description: ClassVar[str] = "momentum observers of drive and link (De Luca & Mattone 2003, 2005)"
    compiled: ClassVar[Step] = _step

    def settings(self, joint: KnownJoint, interval: float) -> np.ndarray:
        found = np.zeros(1, SETTINGS)
        found["gain"], found["cutoff"] = 2 * math.pi * self.bandwidth, 2 * math.pi * self.cutoff
        return found


@dataclass(frozen=True)
class MomentumTorsion(MomentumObserver):
    """Momentum observer while turning, torsion at rest."""

    name: str = "momentum_torsion"
    turning: float = 1.0  # motor velocity ω₀ of equal weights [vs, the Stribeck velocity]
    smoothing: float = 0.02  # of the weight [s]
    follow: float = 1.0  # time constant of the torsion's offset [s]
    tuning: ClassVar[tuple[TuningParameter, ...]] = (
        *MomentumObserver.tuning, TuningParameter("turning", 0.05, 50.0), TuningParameter("smoothing", 1e-3, 1.0),
        TuningParameter("follow", 0.02, 100.0),
    )  # fmt: skip
    description: ClassVar[str] = "momentum observer while turning, torsion at rest (after Graabæk & Sloth 2025)"

    def settings(self, joint: KnownJoint, interval: float) -> np.ndarray:
        found = super().settings(joint, interval)
        found["turning"] = self.turning * joint.p["vs"]
        found["smoothing"], found["follow"] = self.smoothing, self.follow
        return found


ESTIMATORS = (MomentumObserver(), MomentumTorsion())
