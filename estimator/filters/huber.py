"""Huber's M-estimator in a Kalman filter on the constant-rate torque model (Karlgaard & Schaub, "Huber-based divided
difference filtering", J. Guidance, Control and Dynamics 30, 2007).

Each update is the regression of prediction and measurement, whitened by P⁻ = A Aᵀ and √V, on the state, with Huber's
loss instead of the square,

    x⁺ = argmin Σ ρ(rᵢ),   r = [A⁻¹ (x − x⁻); (y − H x)/√V],   ρ(r) = r²/2 within ±k, k|r| − k²/2 beyond

by iterated reweighting: weights ψᵢ = min(1, k/|rᵢ|) divide the variances. It protects from outliers of the
measurement. A push is an outlier of the prediction: the less the measurement counts, the more slowly the filter
follows.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

from ...models.kernels import kernel
from ...models.step import Step, step_of
from ..tuning_parameters import TuningParameter
from .kalman import ACCELERATION, MEMORY, OUT, SETTINGS, TorqueFilter, innovation, write_out

_TOLERANCE, _MOST = 1e-9, 50


@kernel
def correct(f, e, V, k, tolerance, most):
    """Update with the innovation `e` [N·m] of a measurement of variance V, in place; returns its variance, last weights."""
    # A is lower triangular and the measurement depends on the first state only: the regression is one-dimensional in u0, the
    # whitened first state; u1, the second, follows the prediction and keeps its weight 1.
    a00 = math.sqrt(f.P00)
    a10 = f.P01 / a00
    rest = f.P11 - a10 * a10
    u, prior, weight = 0.0, 1.0, 1.0
    for _ in range(most):
        r = (e - a00 * u) / math.sqrt(V)
        weight = k / abs(r) if abs(r) > k else 1.0
        prior = k / abs(u) if abs(u) > k else 1.0
        before = u
        u = weight * a00 * e / (weight * a00 * a00 + prior * V)
        if abs(u - before) < tolerance:
            break
    f.torque += a00 * u
    f.torque_rate += a10 * u
    left = V / (weight * a00 * a00 + prior * V)  # variance of u
    f.P00 = a00 * a00 * left
    f.P01 = a00 * a10 * left
    f.P11 = a10 * a10 * left + rest
    return a00 * a00 / prior + V / weight


@step_of(MEMORY, SETTINGS, OUT)
def _step(m, s, p, c, o):
    e = innovation(m, s, p, c)
    S = correct(m.filter, e, c.V, c.first, _TOLERANCE, _MOST) if s.interval != 0.0 else 0.0
    return write_out(m.filter, e, S, o)


@dataclass(frozen=True)
class Huber(TorqueFilter):
    """Huber's robust Kalman filter."""

    name: str = "huber"
    # residual from which the loss is linear [standard deviations]; 1.345 is 95 % efficient at normal noise
    k: float = 1.345
    tuning: ClassVar[tuple[TuningParameter, ...]] = (ACCELERATION, TuningParameter("k", 0.3, 10.0))
    description: ClassVar[str] = "Kalman filter with Huber's loss instead of the square (Karlgaard & Schaub 2007)"
    compiled: ClassVar[Step] = _step

    def _own(self, V: float) -> tuple[float, float]:
        return self.k, 0.0


ESTIMATORS = (Huber(),)
