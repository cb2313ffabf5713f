"""The compliance model, Eqs. (1)-(7) (`compliance.measure`): torque from torsion, sample by sample, raw (`model`) or through a
Butterworth low-pass of first or second order (`lowpass`).

Zhang, Ahmad & Liu, "Torque Estimation Technique of Robotic Joint with Harmonic Drive Transmission", ICRA 2013, filter
the torsion's torque in this way. Digital design by the bilinear transform, in steady state at the first sample.
Uneven samples use their median interval.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from ...models.errors import InputError
from ...models.parameters import floats
from ...models.step import NOT_FINITE, OK, Step, step_of
from ..compliance import TORSION, measure, torque_variance
from ..estimator import CausalEstimator, KnownJoint, TuningParameter

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


MEMORY = floats(("torsion", TORSION), "z1", "z2")
COEFFICIENTS = floats("b0", "b1", "b2", "a1", "a2")


@step_of(MEMORY, COEFFICIENTS, ("torque",))
def _lowpass_step(m, s, p, c, o):
    u = measure(m.torsion, s, p).torque
    if s.interval == 0.0:  # settled: its gain at rest is 1
        m.z2 = (c.b2 - c.a2) * u
        m.z1 = (c.b1 - c.a1) * u + m.z2
    y = c.b0 * u + m.z1  # direct form II, transposed
    m.z1 = c.b1 * u - c.a1 * y + m.z2
    m.z2 = c.b2 * u - c.a2 * y
    o.torque = y
    return OK if math.isfinite(y) else NOT_FINITE


@dataclass(frozen=True)
class LowPass(CausalEstimator):
    """Butterworth low-pass of the compliance model."""

    name: str = "lowpass"
    cutoff: float = 30.0  # −3 dB frequency [Hz]
    order: int = 2  # 1 or 2
    tuning: ClassVar[tuple[TuningParameter, ...]] = (TuningParameter("cutoff", 1.0, 400.0),)
    description: ClassVar[str] = "compliance model through a Butterworth low-pass (Zhang, Ahmad & Liu 2013)"
    reads_command: ClassVar[bool] = True
    compiled: ClassVar[Step] = _lowpass_step

    def settings(self, joint: KnownJoint, interval: float) -> np.ndarray:
        nyquist = 0.5 / interval
        if not 0.0 < self.cutoff < nyquist or self.order not in (1, 2):
            raise InputError(
                f"{self.name}: expected a cutoff between 0 and {nyquist:g} Hz and order 1 or 2, "
                f"got {self.cutoff:g} Hz and {self.order}"
            )
        w = math.tan(math.pi * self.cutoff * interval)  # bilinear transform, prewarped
        if self.order == 1:
            return np.array([(w / (1 + w), w / (1 + w), 0.0, (w - 1) / (1 + w), 0.0)], COEFFICIENTS)
        bottom = 1 + math.sqrt(2.0) * w + w * w
        b = w * w / bottom
        return np.array(
            [(b, 2 * b, b, 2 * (w * w - 1) / bottom, (1 - math.sqrt(2.0) * w + w * w) / bottom)], COEFFICIENTS
        )


ESTIMATORS = (ComplianceModel(), LowPass(), LowPass("lowpass_first_order", 30.0, 1))
