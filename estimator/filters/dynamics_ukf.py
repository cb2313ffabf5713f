"""Joint-dynamics unscented Kalman filter: as `dynamics_ekf`, with sigma points instead of a Jacobian.

The encoders are linear in the state, so the update is the EKF's.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from ...models.step import Step, step_of
from ..dynamics_filter import FILTER, OUT, SETTINGS, filter_step, write_out
from ..estimator import KnownJoint
from .dynamics_ekf import DynamicsEKF


@step_of(FILTER, SETTINGS, OUT)
def _step(m, s, p, c, o):
    torque, variance = filter_step(m, s, c, p, True)
    return write_out(m, torque, variance, o)


@dataclass(frozen=True)
class DynamicsUKF(DynamicsEKF):
    """Unscented Kalman filter on the joint's dynamics.

    Attributes:
      process: deviation of the joint from its equations.
      kappa: κ [1], spread of the sigma points.
    """

    name: str = "dynamics_ukf"
    kappa: float = 1.0
    description: ClassVar[str] = (
        "unscented Kalman filter on the joint's own equations of motion (Julier & Uhlmann 1997)"
    )
    compiled: ClassVar[Step] = _step

    def settings(self, joint: KnownJoint, interval: float) -> np.ndarray:
        found = super().settings(joint, interval)
        found["kappa"] = self.kappa
        return found


ESTIMATORS = (DynamicsUKF(),)
