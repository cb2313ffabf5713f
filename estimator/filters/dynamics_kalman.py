"""Joint-dynamics extended and unscented Kalman filters: encoders and current through the joint's own equations.

State and laws: `joint_model`; the filter: `dynamics_filter`. The current is an input, the encoders are the
measurements. The record counts as exact. With `process.stiffness` and `process.motor_constant` (0.07 and 0.02, the
tolerances of a datasheet) it estimates these two. An error of the kinematic error then appears as stiffness: on
joints known within tolerance that is worse than without (`augmented` is for those).
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import ClassVar

import numpy as np

from ...models.signals import Signals
from ...models.step import Step, step_of
from ..dynamics_filter import FILTER, OUT, SETTINGS, filter_step, write_out
from ..estimator import CausalEstimator, KnownJoint, Posterior
from ..joint_model import TUNING, ProcessNoise
from ..tuning_parameters import TuningParameter


@step_of(FILTER, SETTINGS, OUT)
def _step(m, s, p, c, o):
    torque, variance = filter_step(m, s, c, p, False)
    return write_out(m, torque, variance, o)


@dataclass(frozen=True)
class DynamicsEKF(CausalEstimator):
    """Extended Kalman filter on the joint's dynamics; see the module."""

    name: str = "dynamics_ekf"
    process: ProcessNoise = field(default_factory=ProcessNoise)  # deviation of the joint from its equations
    costly: ClassVar[bool] = True
    innovation_unit: ClassVar[str] = "rad"
    tuning: ClassVar[tuple[TuningParameter, ...]] = TUNING
    description: ClassVar[str] = (
        "extended Kalman filter on the joint's own equations of motion (`estimator.joint_model`)"
    )
    compiled: ClassVar[Step] = _step

    def torques(self, signals: Signals, joint: KnownJoint) -> Posterior:
        known, process, column, untrusted = signals.__dict__.get("_filtered", (None, None, {}, None))
        if type(self) is DynamicsEKF and known is joint and process == self.process:  # by rts_smoother
            return replace(self.posterior(signals.time, column), untrusted=untrusted)
        return super().torques(signals, joint)

    def settings(self, joint: KnownJoint, interval: float) -> np.ndarray:
        found = np.zeros(1, SETTINGS)
        found["noise"] = self.process.record(joint, interval)
        return found


@step_of(FILTER, SETTINGS, OUT)
def _unscented_step(m, s, p, c, o):
    torque, variance = filter_step(m, s, c, p, True)
    return write_out(m, torque, variance, o)


@dataclass(frozen=True)
class DynamicsUKF(DynamicsEKF):
    """Unscented Kalman filter on the joint's dynamics; the update is the EKF's, as the encoders are linear in the
    state."""

    name: str = "dynamics_ukf"
    kappa: float = 1.0  # κ [1], spread of the sigma points
    description: ClassVar[str] = (
        "unscented Kalman filter on the joint's own equations of motion (Julier & Uhlmann 1997)"
    )
    compiled: ClassVar[Step] = _unscented_step

    def settings(self, joint: KnownJoint, interval: float) -> np.ndarray:
        found = super().settings(joint, interval)
        found["kappa"] = self.kappa
        return found


ESTIMATORS = (DynamicsEKF(), DynamicsUKF())
