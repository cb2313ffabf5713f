"""Strong tracking filter on the constant-rate torque model (Zhou & Frank, "Strong tracking filtering of nonlinear
time-varying stochastic systems with coloured noise", Int. J. Control 65, 1996).

A fading factor λ ≥ 1 on the propagated covariance keeps the innovations orthogonal when the torque jumps:

    P⁻ = λ F P Fᵀ + W      λ = max(1, tr N / tr M)      M = H F P Fᵀ Hᵀ      N = V₀ − H W Hᵀ − β V
    V₀ = (ρ V₀ + e eᵀ)/(1 + ρ), V₀ = e₁ e₁ᵀ at first
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from numba import njit

from ..knobs import Knob
from .kalman import ACCELERATION, TorqueFilter, correct


@njit(cache=True, nogil=True, error_model="numpy")
def run(time, y, q, V, rho, beta, x, P, states, variance, e, S):
    """Filter y as `kalman.run`; ρ, β [1]."""
    V0 = 0.0
    for k in range(len(y)):
        if k > 0:
            h = time[k] - time[k - 1]
            x[0] += h * x[1]
            e[k] = y[k] - x[0]
            V0 = e[k] ** 2 if k == 1 else (rho * V0 + e[k] ** 2) / (1.0 + rho)
            P[0, 0] += h * (2.0 * P[0, 1] + h * P[1, 1])
            P[0, 1] += h * P[1, 1]
            fade = max(1.0, (V0 - q * h**3 / 3.0 - beta * V) / P[0, 0])
            P[0, 0] = fade * P[0, 0] + q * h**3 / 3.0
            P[0, 1] = fade * P[0, 1] + q * h**2 / 2.0
            P[1, 0] = P[0, 1]
            P[1, 1] = fade * P[1, 1] + q * h
            S[k] = correct(x, P, e[k], V)
        states[k] = x
        variance[k] = P[0, 0]


@dataclass(frozen=True)
class StrongTracking(TorqueFilter):
    """Strong tracking filter.

    Attributes:
        acceleration: as `TorqueFilter`, smaller: fading does what process noise need not.
        forget: ρ [1]: 0.95 as in the source, a memory of two samples.
        soften: β ≥ 1 [1]: how much larger than expected innovations must be. A memory of two samples scatters widely: less
            would fade at noise.
    """

    name: str = "strong_tracking"
    acceleration: float = 2.0
    forget: float = 0.95
    soften: float = 7.0
    knobs: ClassVar[tuple[Knob, ...]] = (ACCELERATION, Knob("soften", 1.0, 100.0), Knob("forget", 0.1, 50.0))

    def _run(self, time, y, q, V, x, P, states, variance, e, S) -> None:
        run(time, y, q, V, self.forget, self.soften, x, P, states, variance, e, S)


ESTIMATORS = (StrongTracking(),)
