"""The rules in which EKF, robust EKF, AREKF and RAREKF differ: Eqs. (12), (18)-(25).

A rule takes the predicted covariance P(k|k-1) to the adjusted one, Σ(k|k-1). The rest of the recursion is the
same for all. The functions are compiled; what a person chooses is in `estimator.settings`.

Eqs. (21) and (24) together give `γ⁻²LᵀL = (1 - 1/f_α)·P⁻¹`, so that robust mode, Eq. (19), is `Σ = f_α·P` in any
dimension: γ and L cancel. Only the fixed-γ rule, Eq. (18), needs them.

Robust mode multiplies all of P. In a direction that H and F never observe nothing takes that back: with such a
model AREKF and RAREKF let P grow without bound and end in `FilterDiverged`.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

EKF = 0
"""Σ = P: the optimal filter."""
ROBUST = 1
"""Eq. (18) with a fixed γ, at every step."""
AREKF = 2
"""Eq. (19) with α = 1."""
RAREKF = 3
"""Eq. (19) with α of the load, Eq. (23)."""

RULES = {"ekf": EKF, "robust": ROBUST, "arekf": AREKF, "rarekf": RAREKF}

GAIN = np.dtype(
    [
        ("rule", np.float64),  # one of RULES
        ("inverse_gamma_squared", np.float64),  # γ⁻²; zero is γ = ∞
        ("k", np.float64),  # Eq. (23), 1/(N·m)²
        ("rho", np.float64),  # Eq. (20)
        ("printed_alpha", np.float64),  # 1: Eq. (23) as printed
        ("printed_memory", np.float64),  # 1: Eq. (20) as printed
        ("adjusted_covariance", np.float64),  # 1: P_Y of Eqs. (19), (25) is that of Σ
        ("load_index", np.float64),  # which state is the torque load ω
    ]
)
"""A gain rule as one flat record of float64, for compiled code."""

LARGEST_FACTOR = 1.0 / np.finfo(np.float64).eps
"""An f_α above this leaves nothing of V in P_Y: the filter has stopped weighing model against measurement."""


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def redundancy_factor(load, gain):
    """Return α of Eq. (23) for the torque load ω [N·m]; 1 for every rule but RAREKF.

    `max(1, kω²)`, or, as printed, `min(kω², 1)`, which is zero at zero load.
    """
    if gain.rule != RAREKF:
        return 1.0
    alpha = gain.k * load * load
    if gain.printed_alpha != 0.0:
        return min(alpha, 1.0)
    return max(alpha, 1.0)


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def compensation_factor(memory, total, noise, alpha, gain):
    """Return f_α of Eq. (25) where Eq. (19) switches to robust mode, and exactly 1 where it does not.

    Args:
        memory: tr P̄_Y, Eq. (20).
        total: tr P_Y = tr(H·P·Hᵀ + V), of the unadjusted prediction.
        noise: tr V.
        alpha: redundancy factor.
        gain: `GAIN` record.

    With the unadjusted P_Y: `f_α = P̄_Y / (α·P_Y)`. With the adjusted one, P_Y = f_α·HPHᵀ + V contains what it
    decides; f_α is then the positive root of `α·(f·HPHᵀ + V)·f = P̄_Y`. Both exceed 1 under the same condition.
    The result is infinite at α = 0.
    """
    threshold = alpha * total
    if not memory > threshold:
        return 1.0
    if gain.adjusted_covariance != 0.0:
        half = alpha * noise
        denominator = 0.5 * (half + math.sqrt(half * half + 4.0 * alpha * (total - noise) * memory))
    else:
        denominator = threshold
    return memory / denominator if denominator > 0.0 else math.inf
