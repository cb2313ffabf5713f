"""Standard Kalman filter on the compliance model with a constant-rate torque: states torque and its rate.

    x = [T, T']     F = [[1, h], [0, 1]]     W = q·[[h³/3, h²/2], [h²/2, h]]     y = T + v,  v ~ (0, V)

the continuous white-noise-acceleration model (Bar-Shalom, Li & Kirubarajan 2001, section 6.2). The other torque
filters of this folder share the model and differ in their gain.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from ...models.kernels import kernel
from ...models.parameters import floats
from ...models.step import NOT_FINITE, OK, Step, step_of
from ..compliance import TORSION, measure, torque_variance
from ..estimator import CausalEstimator, KnownJoint
from ..tuning_parameters import TuningParameter

STATE = floats("torque", "torque_rate", "P00", "P01", "P11")
"""Torque [N·m], its rate [N·m/s] and their covariance."""
MEMORY = floats(("torsion", TORSION), ("filter", STATE), "expected")
"""`expected`: squared innovation in the memory of a fading filter [(N·m)²]."""
SETTINGS = floats("q", "V", "rate_variance", "first", "second")
"""q [(N·m)²/s³], V [(N·m)²], variance of the first rate; two tuning parameters of subclasses."""
OUT = floats("torque", "variance", "innovation", "innovation_variance", "torque_rate")
ACCELERATION = TuningParameter("acceleration", 1e-3, 1e3)


@kernel
def start(f, y, c):
    """Begin at the first measurement, at rest."""
    f.torque, f.torque_rate = y, 0.0
    f.P00, f.P01, f.P11 = c.V, 0.0, c.rate_variance


@kernel
def predict(f, h, q):
    """Predict a record of `STATE` over `h` [s], in place; q [(N·m)²/s³]."""
    f.torque += h * f.torque_rate
    f.P00 += h * (2.0 * f.P01 + h * f.P11) + q * h**3 / 3.0
    f.P01 += h * f.P11 + q * h**2 / 2.0
    f.P11 += q * h


@kernel
def innovation(m, s, p, c):
    """Start at the first sample, else predict a record of `MEMORY`; return the innovation [N·m]."""
    f, y = m.filter, measure(m.torsion, s, p).torque
    if s.interval == 0.0:
        start(f, y, c)
        return 0.0
    predict(f, s.interval, c.q)
    return y - f.torque


@kernel
def correct(f, e, V):
    """Update with the innovation `e` [N·m] of a measurement with variance V, in place; returns its variance S."""
    S = f.P00 + V
    k0, k1 = f.P00 / S, f.P01 / S
    f.torque += k0 * e
    f.torque_rate += k1 * e
    f.P11 -= k1 * f.P01
    f.P01 *= 1.0 - k0
    f.P00 *= 1.0 - k0
    return S


@kernel
def write_out(f, e, S, o):
    """Write the outputs; return the status."""
    o.torque, o.variance, o.innovation, o.innovation_variance, o.torque_rate = f.torque, f.P00, e, S, f.torque_rate
    return OK if math.isfinite(f.torque + f.P00) else NOT_FINITE


@step_of(MEMORY, SETTINGS, OUT)
def _step(m, s, p, c, o):
    e = innovation(m, s, p, c)
    S = correct(m.filter, e, c.V) if s.interval != 0.0 else 0.0
    return write_out(m.filter, e, S, o)


@dataclass(frozen=True)
class TorqueFilter(CausalEstimator):
    """A filter of the compliance model's torque with the constant-rate model."""

    name: str = "kalman"
    # intensity √q of the torque's second derivative [T2/s² per √Hz]. The steady filter's natural frequency is
    # (q/(V·h))^(1/4): with 10·12 N·m and V = 0.05² at 1 kHz, 274 rad/s.
    acceleration: float = 10.0
    rate: float = 1.0  # standard deviation of the first rate [T2/s]
    tuning: ClassVar[tuple[TuningParameter, ...]] = (ACCELERATION,)
    description: ClassVar[str] = "Kalman filter of the compliance model's torque and its rate (Bar-Shalom et al. 2001)"
    reads_command: ClassVar[bool] = True
    compiled: ClassVar[Step] = _step

    def settings(self, joint: KnownJoint, interval: float) -> np.ndarray:
        scale, V = float(joint.p["T2"]), torque_variance(joint)
        own = self._own(V)
        return np.array([((self.acceleration * scale) ** 2, V, (self.rate * scale) ** 2, *own)], SETTINGS)

    def _own(self, V: float) -> tuple[float, float]:
        return 0.0, 0.0


ESTIMATORS = (TorqueFilter(),)
