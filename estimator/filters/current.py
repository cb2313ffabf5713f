"""Joint torque from the motor current: current less friction and the rotor's inertia.

    T = (Kt·i + cogging − bm·ωm − Fmesh(ωm) − (Jm + Jw)·ωm') / (1/N − θerr'(θm)) − bl·ωl

the balance of rotor and wave generator as one body (`models.dynamics.transmitted_torque`), with the LuGre bristle
driven by the measured velocity and friction under the last torque's load. Velocity and acceleration are the motor
encoder's, through a causal second-order low-pass. Everything that depends on the motor's angle (current, cogging, the
transmission's ratio) passes the same one, so that both sides stay in phase. It needs no second encoder. At rest,
friction and the error are unknown up to the friction's level.

If noise needs a low cutoff, its lag √2/ω outweighs the noise. With `lead` the current's low-pass is (1 + lead·√2
s/ω)/(1 + √2 s/ω + s²/ω²): at 1 a ramp of the load has no lag, at √3 times the noise.

`current_smoothed` is the same offline, without lag: motion, current and friction pass one zero-phase smoother (`smoothed`) with
the largest bandwidth that the readings' noise allows.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from ...models import dynamics, laws
from ...models.parameters import floats
from ...models.signals import Signals
from ...models.step import NOT_FINITE, OK, Step, step_of
from .. import smoothed
from ..estimator import CausalEstimator, Estimator, KnownJoint, Posterior, TuningParameter
from ..sensing import LOWPASS, lowpass, motor_current, temperature

MEMORY = floats("torque", "bristle", ("motor", LOWPASS), ("drive", LOWPASS), ("ratio", LOWPASS))
SETTINGS = floats("cutoff", "lead")  # of the low-pass [rad/s]; [s]
OUT = floats("torque", "motor_velocity", "motor_acceleration", "drive_torque", "bristle")


@step_of(MEMORY, SETTINGS, OUT)
def _step(m, s, p, c, o):
    cutoff = c.cutoff
    motor = dynamics.actual_motor_position(s.motor_position, p)
    lowpass(m.motor, motor, s.interval, cutoff)
    w, a = m.motor.rate, m.motor.acceleration
    # Without a link encoder, friction depends on the motor's angle.
    link = motor / p.N
    if not math.isnan(s.link_position):
        link = dynamics.actual_link_position(s.link_position, motor, w, s.time, p)
    current = motor_current(s, motor, link, w, m.torque, p)
    state = dynamics.drive_state(motor, w, link, w / p.N, m.bristle, current, s.time, temperature(s, p))
    lowpass(m.drive, dynamics.rotor_torque(state, 0.0, m.torque, p), s.interval, cutoff)
    lowpass(m.ratio, 1.0 / p.N - laws.kinematic_error_slope(motor, p), s.interval, cutoff)
    g = dynamics.sliding_friction(state, m.torque, p)
    if s.interval > 0.0:
        m.bristle = laws.bristle_step(m.bristle, w, g, s.interval, p)
        state = dynamics.drive_state(motor, w, link, w / p.N, m.bristle, current, s.time, temperature(s, p))
    friction = dynamics.mesh_torque(state, m.torque, g, p)
    drive, ratio = m.drive.value + c.lead * m.drive.rate, m.ratio.value + c.lead * m.ratio.rate
    m.torque = (drive - friction - (p.Jm + p.Jw) * a) / ratio
    o.torque = m.torque - p.bl * w / p.N
    o.motor_velocity, o.motor_acceleration, o.drive_torque, o.bristle = w, a, m.drive.value, m.bristle
    return OK if math.isfinite(o.torque) else NOT_FINITE


@dataclass(frozen=True)
class MotorCurrent(CausalEstimator):
    """Joint torque from motor current."""

    name: str = "current"
    cutoff: float = 40.0  # of the low-pass [Hz]
    lead: float = 0.0  # corrected share of the low-pass's lag [1]
    needs: ClassVar[tuple[str, ...]] = ("motor_position", "motor_current")
    tuning: ClassVar[tuple[TuningParameter, ...]] = (
        TuningParameter("cutoff", 1.0, 300.0), TuningParameter("lead", 0.0, 1.5, "linear"),
    )  # fmt: skip
    description: ClassVar[str] = "motor current less friction and the drive's inertia; needs no second encoder"
    compiled: ClassVar[Step] = _step

    def settings(self, joint: KnownJoint, interval: float) -> np.ndarray:
        cutoff = 2 * math.pi * self.cutoff
        return np.array([(cutoff, self.lead * math.sqrt(2.0) / cutoff)], SETTINGS)


@dataclass(frozen=True)
class CurrentSmoothed(Estimator):
    """Joint torque from motor current, smoothed; not causal."""

    name: str = "current_smoothed"
    quiet: float = smoothed.QUIET  # allowed noise [rated torques], which decides its bandwidth (`smoothed.bandwidth`)
    causal: ClassVar[bool] = False
    needs: ClassVar[tuple[str, ...]] = ("motor_position", "motor_current")
    tuning: ClassVar[tuple[TuningParameter, ...]] = (TuningParameter("quiet", 1e-4, 0.1),)
    description: ClassVar[str] = "motor current less friction and the drive's inertia, through a zero-phase smoother"

    def estimate(self, signals: Signals, joint: KnownJoint) -> Posterior:
        for name in self.needs:
            signals[name]
        motion = smoothed.smooth_motion(signals, joint, smoothed.bandwidth(signals, joint, self.quiet))
        torque = smoothed.torque_from_current(motion, joint)
        grid, velocity = motion.time, motion.link_velocity.copy()
        del motion  # 350 MB less for an hour
        velocity *= joint.p["bl"]
        torque -= velocity
        return Posterior(self.name, signals.time, np.interp(signals.time, grid, torque))


ESTIMATORS = (MotorCurrent(), CurrentSmoothed())
