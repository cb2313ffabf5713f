"""The paper's recursion, Eqs. (10)-(25), compiled, for its torque filter, F = H = 1.

EKF, robust EKF, AREKF and RAREKF are one recursion and differ in one rule from the predicted covariance P(k|k-1) to
the adjusted one, Σ(k|k-1): Eqs. (12), (18)-(25). Eqs. (21) and (24) together give `γ⁻²LᵀL = (1 - 1/f_α)·P⁻¹`, so that
robust mode, Eq. (19), is `Σ = f_α·P` in any dimension: γ and L cancel. Only the fixed-γ rule, Eq. (18), needs them.

Robust mode multiplies all of P. A direction that H and F never observe keeps that increase: with such a model AREKF
and RAREKF let P grow without bound and end in `FilterDiverged`.
"""

from __future__ import annotations

import math

import numpy as np

from ..models.kernels import kernel
from ..models.parameters import floats
from ..models.step import NOT_FINITE, OK

EKF, ROBUST, AREKF, RAREKF = 0, 1, 2, 3
RULES = {"ekf": EKF, "robust": ROBUST, "arekf": AREKF, "rarekf": RAREKF}
"""Σ = P; Eq. (18) with a fixed γ at every step; Eq. (19) with α = 1; Eq. (19) with α of the load, Eq. (23)."""

MAX, PRINTED, INVERSE = 0, 1, 2
ALPHAS = {"max": MAX, "printed": PRINTED, "inverse": INVERSE}
"""Readings of Eq. (23): max(1, kω²); min(kω², 1); max(1, 1/(kω²))."""

SETTINGS = floats(
    "rule", "W", "V", "P0", "L", "inverse_gamma_squared", "k", "rho", "alpha", "printed_memory", "adjusted_covariance"
)
"""A filter's numbers as a record: of `RULES`; W, V, P(0), L; γ⁻² (zero is γ = ∞), k, ρ; of `ALPHAS`; whether Eq. (20)
is as printed; whether P_Y of Eqs. (19), (25) is that of Σ."""

STATE = floats(
    "torque", "variance", "innovation", "innovation_variance", "unadjusted_innovation_variance",
    "innovation_memory_variance", "alpha", "f_alpha", "robust", "nis",
)  # fmt: skip
"""Memory and outputs of a filter: X̂, P, Ỹ, P_Y of Eq. (14), P_Y of the unadjusted prediction, P̄_Y, α, f_α, mode,
NIS."""

GAMMA_TOO_SMALL, NOT_POSITIVE, FACTOR_OVERFLOW = range(2, 5)
LARGEST_FACTOR = 1.0 / np.finfo(np.float64).eps
"""Largest f_α: above it V has no influence on P_Y, and the filter no longer weighs model against measurement."""


@kernel
def start(f, y, c):
    """Start at X̂ = Y(0). P_Y(0) is the initial value of Eq. (20) as printed; P̄_Y(0) = Ỹ(0)Ỹ(0)ᵀ is zero."""
    f.torque, f.variance, f.alpha, f.f_alpha = y, c.P0, 1.0, 1.0
    f.innovation_variance = f.unadjusted_innovation_variance = c.P0 + c.V


@kernel
def update(f, y, c):
    """Update the torque filter, a record of `STATE`, with one step, F = H = 1, by the torque y of the compliance model
    [N·m]; unchanged if the step fails. Return OK, or why there is no next estimate: NOT_FINITE, GAMMA_TOO_SMALL,
    NOT_POSITIVE (P_Y), FACTOR_OVERFLOW (f_α)."""
    P = f.variance + c.W  # (11)
    unadjusted = P + c.V  # (14), of the unadjusted prediction
    innovation = y - f.torque  # (10), (13)
    past = f.innovation_variance if c.printed_memory != 0.0 else f.innovation_memory_variance
    memory = (c.rho * past + innovation * innovation) / (c.rho + 1.0)  # (20)
    if not math.isfinite(memory):
        return NOT_FINITE
    alpha = redundancy_factor(f.torque, c)
    if c.rule == ROBUST:  # (18)
        left = 1.0 - c.inverse_gamma_squared * c.L * P * c.L
        if not left > 0.0:
            return GAMMA_TOO_SMALL
        f_alpha = 1.0 / left
    else:
        f_alpha = compensation_factor(memory, unadjusted, c.V, alpha, c)
        if not f_alpha <= LARGEST_FACTOR:
            return FACTOR_OVERFLOW
    sigma = f_alpha * P  # (12), (19)
    P_Y = sigma + c.V  # (14)
    if not (P_Y > 0.0 and P_Y < math.inf):
        return NOT_POSITIVE
    K = sigma / P_Y  # (15)
    torque = f.torque + K * innovation  # (16)
    variance = (1.0 - K) * sigma * (1.0 - K) + K * c.V * K  # (17) in Joseph's form
    if not math.isfinite(torque + variance):
        return NOT_FINITE
    f.torque, f.variance, f.innovation, f.innovation_variance = torque, variance, innovation, P_Y
    f.unadjusted_innovation_variance, f.innovation_memory_variance = unadjusted, memory
    f.alpha, f.f_alpha, f.nis = alpha, f_alpha, innovation * innovation / P_Y
    f.robust = 1.0 if c.rule == ROBUST or f_alpha != 1.0 else 0.0
    return OK


@kernel
def redundancy_factor(load, c):
    """Return α of Eq. (23) for the torque load ω [N·m], the filter's last estimate; 1 for every rule but RAREKF."""
    if c.rule != RAREKF:
        return 1.0
    alpha = c.k * load * load
    if c.alpha == PRINTED:
        return min(alpha, 1.0)
    if c.alpha == INVERSE:
        return max(1.0 / alpha, 1.0)  # infinite without load: never robust
    return max(alpha, 1.0)


@kernel
def compensation_factor(memory, total, noise, alpha, c):
    """Return f_α of Eq. (25) if Eq. (19) switches to robust mode, else exactly 1, by tr P̄_Y of Eq. (20) in `memory`,
    tr P_Y of the unadjusted prediction, tr V and the redundancy factor α.

    With the unadjusted P_Y: `f_α = P̄_Y / (α·P_Y)`. The adjusted one, P_Y = f_α·HPHᵀ + V, depends on f_α, which is then
    the positive root of `α·(f·HPHᵀ + V)·f = P̄_Y`. Both exceed 1 under the same condition. The result is infinite at α
    = 0.
    """
    threshold = alpha * total
    if c.rule == EKF or not memory > threshold:
        return 1.0
    if c.adjusted_covariance != 0.0:
        half = alpha * noise
        denominator = 0.5 * (half + math.sqrt(half * half + 4.0 * alpha * (total - noise) * memory))
    else:
        denominator = threshold
    return memory / denominator if denominator > 0.0 else math.inf


@kernel
def surprise(y, settings, most):
    """Return minus twice the log likelihood of a filter's innovations over measurements y, shape (T,), each limited
    to `most`, the sample at which the filter failed, and the status; T and OK if it did not."""
    c = settings[0]
    history = np.zeros(1, STATE)
    start(history[0], y[0], c)
    total = 0.0
    for t in range(1, len(y)):
        status = update(history[0], y[t], c)
        if status != OK:
            return total, t, status
        S, e = history[0].innovation_variance, history[0].innovation
        total += math.log(S) + min(e * e / S, most)
    return total, len(y), OK
