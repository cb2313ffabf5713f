"""Joint-dynamics unscented Kalman filter: as `dynamics_ekf`, with sigma points instead of a Jacobian.

The encoders are linear in the state, so the update is the EKF's.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numba import carray

from ...models.pointers import floats_at, pointer_to, record_at
from ...models.step import Step, sample_at
from ..dynamics_filter import FILTER, SETTINGS, filter_step, tell
from ..estimator import KnownJoint
from .dynamics_ekf import DynamicsEKF

_memory_at, _settings_at = pointer_to(FILTER), pointer_to(SETTINGS)


@Step
def _step(memory, sample, record, settings, out):
    m, s, p = carray(_memory_at(memory), 1)[0], carray(sample_at(sample), 1)[0], carray(record_at(record), 1)[0]
    torque, variance = filter_step(m, s, carray(_settings_at(settings), 1)[0], p, True)
    return tell(m, torque, variance, floats_at(out))


@dataclass(frozen=True)
class DynamicsUKF(DynamicsEKF):
    """Unscented Kalman filter on the joint's dynamics.

    Attributes:
        process: how far the joint departs from its equations.
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
