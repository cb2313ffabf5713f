"""Joint-dynamics extended Kalman filter: encoders and current through the joint's own equations.

State and laws: `joint_model`; the filter: `dynamics_filter`. The current is an input, the encoders are the measurements.

It takes the record as it is. With `process.stiffness` and `process.motor_constant` (0.07 and 0.02, the tolerances of a data
sheet) it estimates those two; kinematic error that is off then passes for stiffness, and on joints known within tolerance
that is worse than leaving them (`augmented` is for those).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np
from numba import carray

from ...models.pointers import floats_at, pointer_to, record_at
from ...models.step import Step, sample_at
from ..dynamics_filter import FILTER, OUT, SETTINGS, filter_step, tell
from ..estimator import CausalEstimator, KnownJoint, fields_of
from ..joint_model import TUNING, ProcessNoise
from ..tuning_parameters import TuningParameter

_memory_at, _settings_at = pointer_to(FILTER), pointer_to(SETTINGS)


@Step
def _step(memory, sample, record, settings, out):
    m, s, p = carray(_memory_at(memory), 1)[0], carray(sample_at(sample), 1)[0], carray(record_at(record), 1)[0]
    torque, variance = filter_step(m, s, carray(_settings_at(settings), 1)[0], p, False)
    return tell(m, torque, variance, floats_at(out))


@dataclass(frozen=True)
class DynamicsEKF(CausalEstimator):
    """Extended Kalman filter on the joint's dynamics; see the module.

    Attributes:
        process: how far the joint departs from its equations.
    """

    name: str = "dynamics_ekf"
    process: ProcessNoise = field(default_factory=ProcessNoise)
    costly: ClassVar[bool] = True
    innovation_unit: ClassVar[str] = "rad"
    tuning: ClassVar[tuple[TuningParameter, ...]] = TUNING
    description: ClassVar[str] = (
        "extended Kalman filter on the joint's own equations of motion (`estimator.joint_model`)"
    )
    compiled: ClassVar[Step] = _step
    remembers: ClassVar[np.dtype] = FILTER
    outputs: ClassVar[tuple[str, ...]] = fields_of(OUT)

    def settings(self, joint: KnownJoint, interval: float) -> np.ndarray:
        found = np.zeros(1, SETTINGS)
        found["noise"] = self.process.record(joint, interval)
        return found


ESTIMATORS = (DynamicsEKF(),)
