"""The raw compliance model, Eqs. (1)-(7) (`compliance.measure`): torque from torsion, sample by sample."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numba import carray

from ...models.pointers import pointer_to, record_at
from ...models.step import NOT_FINITE, OK, Step, sample_at
from ..compliance import TORSION, measure, torque_variance
from ..estimator import CausalEstimator, KnownJoint, fields_of

SETTINGS = np.dtype([("variance", np.float64)])
OUT = np.dtype([(n, np.float64) for n in ("torque", "variance", "torsion", "link_position")])
_memory_at, _settings_at, _out_at = pointer_to(TORSION), pointer_to(SETTINGS), pointer_to(OUT)


@Step
def _step(memory, sample, record, settings, out):
    m, s, p = carray(_memory_at(memory), 1)[0], carray(sample_at(sample), 1)[0], carray(record_at(record), 1)[0]
    o = carray(_out_at(out), 1)[0]
    found = measure(m, s, p)
    o.torque, o.torsion, o.link_position = found.torque, found.torsion, found.link_position
    o.variance = carray(_settings_at(settings), 1)[0].variance
    return OK if math.isfinite(found.torque) else NOT_FINITE


@dataclass(frozen=True)
class ComplianceModel(CausalEstimator):
    """The compliance model as it is."""

    name: str = "model"
    description: ClassVar[str] = "torque from torsion by the compliance model alone (Shi & Liu, Eqs. 1-7)"
    reads_command: ClassVar[bool] = True
    compiled: ClassVar[Step] = _step
    remembers: ClassVar[np.dtype] = TORSION
    outputs: ClassVar[tuple[str, ...]] = fields_of(OUT)

    def settings(self, joint: KnownJoint, interval: float) -> np.ndarray:
        return np.array([(torque_variance(joint),)], SETTINGS)


ESTIMATORS = (ComplianceModel(),)
