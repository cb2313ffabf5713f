"""Huber's M-estimator in a Kalman filter on the constant-rate torque model (Karlgaard & Schaub, "Huber-based divided
difference filtering", J. Guidance, Control and Dynamics 30, 2007).

Each update is the regression of prediction and measurement, whitened by P⁻ = A Aᵀ and √V, on the state, with Huber's loss
instead of the square,

    x⁺ = argmin Σ ρ(rᵢ),   r = [A⁻¹ (x − x⁻); (y − H x)/√V],   ρ(r) = r²/2 within ±k, k|r| − k²/2 beyond

by iterated reweighting: weights ψᵢ = min(1, k/|rᵢ|) divide the variances. It protects from outliers of the measurement; a
push, which is an outlier of the prediction, is the worse followed the more the measurement is doubted.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

from numba import njit

from ..knobs import Knob
from .kalman import ACCELERATION, TorqueFilter, predict


@njit(cache=True, nogil=True, error_model="numpy")
def correct(x, P, y, V, k, tolerance, most):
    """Update x, P with a measurement y of variance V, in place; returns the innovation's variance with the last weights."""
    # A is lower triangular and the measurement sees the first state alone: the regression is one-dimensional in u0, the
    # whitened first state; u1, the second, follows the prediction and keeps its weight 1.
    a00 = math.sqrt(P[0, 0])
    a10 = P[1, 0] / a00
    rest = P[1, 1] - a10 * a10
    e = y - x[0]
    u, prior, weight = 0.0, 1.0, 1.0
    for _ in range(most):
        r = (e - a00 * u) / math.sqrt(V)
        weight = k / abs(r) if abs(r) > k else 1.0
        prior = k / abs(u) if abs(u) > k else 1.0
        before = u
        u = weight * a00 * e / (weight * a00 * a00 + prior * V)
        if abs(u - before) < tolerance:
            break
    x[0] += a00 * u
    x[1] += a10 * u
    left = V / (weight * a00 * a00 + prior * V)  # variance of u
    P[0, 0] = a00 * a00 * left
    P[0, 1] = P[1, 0] = a00 * a10 * left
    P[1, 1] = a10 * a10 * left + rest
    return a00 * a00 / prior + V / weight


@njit(cache=True, nogil=True, error_model="numpy")
def run(time, y, q, V, k, x, P, states, variance, e, S):
    """Filter y as `kalman.run`; k [1]."""
    for t in range(len(y)):
        if t > 0:
            predict(x, P, time[t] - time[t - 1], q)
            e[t] = y[t] - x[0]
            S[t] = correct(x, P, y[t], V, k, 1e-9, 50)
        states[t] = x
        variance[t] = P[0, 0]


@dataclass(frozen=True)
class Huber(TorqueFilter):
    """Huber's robust Kalman filter.

    Attributes:
        k: where the loss turns linear [standard deviations]; 1.345 is 95 % efficient at normal noise.
    """

    name: str = "huber"
    k: float = 1.345
    knobs: ClassVar[tuple[Knob, ...]] = (ACCELERATION, Knob("k", 0.3, 10.0))

    def _run(self, time, y, q, V, x, P, states, variance, e, S) -> None:
        run(time, y, q, V, self.k, x, P, states, variance, e, S)


ESTIMATORS = (Huber(),)
