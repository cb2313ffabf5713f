"""The raw compliance model, Eqs. (1)-(7) (`compliance.measure`): torque from torsion, sample by sample."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from ...models.parameters import floats
from ...models.step import NOT_FINITE, OK, Step, step_of
from ..compliance import TORSION, measure, torque_variance
from ..estimator import CausalEstimator, KnownJoint

SETTINGS = floats("variance")


@step_of(TORSION, SETTINGS, ("torque", "variance", "torsion", "link_position"))
def _step(m, s, p, c, o):
    found = measure(m, s, p)
    o.torque, o.torsion, o.link_position = found.torque, found.torsion, found.link_position
    o.variance = c.variance
    return OK if math.isfinite(found.torque) else NOT_FINITE


@dataclass(frozen=True)
class ComplianceModel(CausalEstimator):
    """The compliance model, unfiltered."""

    name: str = "model"
    description: ClassVar[str] = "torque from torsion by the compliance model alone (Shi & Liu, Eqs. 1-7)"
    reads_command: ClassVar[bool] = True
    compiled: ClassVar[Step] = _step

    def settings(self, joint: KnownJoint, interval: float) -> np.ndarray:
        return np.array([(torque_variance(joint),)], SETTINGS)


ESTIMATORS = (ComplianceModel(),)
