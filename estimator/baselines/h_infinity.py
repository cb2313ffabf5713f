"""Fixed-γ H∞ filter in Simon's form on the constant-rate torque model ("Optimal State Estimation", 2006, Eq. 11.89).

    K = P (I − θ S̄ P + HᵀV⁻¹H P)⁻¹ HᵀV⁻¹      x⁺ = x + K (y − H x)      P⁺ = P (I − θ S̄ P + HᵀV⁻¹H P)⁻¹

with S̄ = diag(1, 0), the torque is what matters, and θ = γ⁻². A solution exists while P⁻¹ − θ S̄ + HᵀV⁻¹H > 0.

Against the paper's robust EKF, Eq. (18), Σ = (P⁻¹ − γ⁻² LᵀL)⁻¹ followed by a Kalman update: for S̄ = LᵀL that is the *same
recursion*, P⁺⁻¹ = Σ⁻¹ + HᵀV⁻¹H. What differs is the condition, Eq. (18) asks for P⁻¹ > γ⁻² LᵀL before the measurement
is taken, and here the model (two states instead of one). A test runs both.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numba import njit

from ..errors import FilterDiverged
from ..knobs import Knob
from .kalman import ACCELERATION, TorqueFilter, predict


@njit(cache=True, nogil=True, error_model="numpy")
def correct(x, P, e, V, theta):
    """Update with the innovation `e` [N·m], in place; returns V + HΣHᵀ with Σ of Eq. (18), or −1 without a solution."""
    # P (I + c HᵀH P)⁻¹ with c = 1/V − θ, as S̄ = HᵀH: Sherman and Morrison.
    c = 1.0 / V - theta
    bottom = 1.0 + c * P[0, 0]
    if not bottom > 0.0:
        return -1.0
    p00, p01 = P[0, 0], P[0, 1]
    P[0, 0] = p00 / bottom
    P[0, 1] = P[1, 0] = p01 / bottom
    P[1, 1] -= c * p01 * p01 / bottom
    x[0] += P[0, 0] / V * e
    x[1] += P[1, 0] / V * e
    before = 1.0 - theta * p00
    return V + p00 / before if before > 0.0 else np.inf


@njit(cache=True, nogil=True, error_model="numpy")
def run(time, y, q, V, theta, x, P, states, variance, e, S):
    """Filter y as `kalman.run`; θ [1/(N·m)²]. Returns n, or the sample without a solution."""
    for k in range(len(y)):
        if k > 0:
            predict(x, P, time[k] - time[k - 1], q)
            e[k] = y[k] - x[0]
            S[k] = correct(x, P, e[k], V, theta)
            if S[k] < 0.0:
                return k
        states[k] = x
        variance[k] = P[0, 0]
    return len(y)


@dataclass(frozen=True)
class HInfinity(TorqueFilter):
    """Fixed-γ H∞ filter.

    Attributes:
        gamma: attenuation γ in standard deviations of the measurement [√V]; infinity is the Kalman filter. Near 1 the
            gain is near 1 too, and the filter gives back the measurement.
    """

    name: str = "h_infinity"
    gamma: float = 2.0
    knobs: ClassVar[tuple[Knob, ...]] = (ACCELERATION, Knob("gamma", 1.05, 100.0))

    def _run(self, time, y, q, V, x, P, states, variance, e, S) -> None:
        k = run(time, y, q, V, 1.0 / (self.gamma**2 * V), x, P, states, variance, e, S)
        if k < len(y):
            raise FilterDiverged(self.name, k, time[k], "γ is too small: no H∞ filter attains it")


ESTIMATORS = (HInfinity(),)
