"""The paper's recursion, Eqs. (10)-(25): `update`, compiled, for its torque filter, and `vector_update` for any model.

EKF, robust EKF, AREKF and RAREKF are one recursion and differ in one rule, which takes the predicted covariance P(k|k-1) to
the adjusted one, Σ(k|k-1): Eqs. (12), (18)-(25). Eqs. (21) and (24) together give `γ⁻²LᵀL = (1 - 1/f_α)·P⁻¹`, so that robust
mode, Eq. (19), is `Σ = f_α·P` in any dimension: γ and L cancel. Only the fixed-γ rule, Eq. (18), needs them.

Robust mode multiplies all of P. In a direction that H and F never observe nothing takes that back: with such a model AREKF
and RAREKF let P grow without bound and end in `FilterDiverged`.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from ..models.kernels import kernel
from ..models.step import NOT_FINITE, OK

EKF, ROBUST, AREKF, RAREKF = 0, 1, 2, 3
RULES = {"ekf": EKF, "robust": ROBUST, "arekf": AREKF, "rarekf": RAREKF}
"""Σ = P; Eq. (18) with a fixed γ at every step; Eq. (19) with α = 1; Eq. (19) with α of the load, Eq. (23)."""

MAX, PRINTED, INVERSE = 0, 1, 2
ALPHAS = {"max": MAX, "printed": PRINTED, "inverse": INVERSE}
"""Readings of Eq. (23): max(1, kω²); min(kω², 1); max(1, 1/(kω²))."""

SETTINGS = np.dtype(
    [(name, np.float64) for name in (
        "rule", "W", "V", "P0", "L", "inverse_gamma_squared", "k", "rho", "alpha", "printed_memory", "adjusted_covariance",
    )]
)  # fmt: skip
"""A filter's numbers as a record: of `RULES`; W, V, P(0), L; γ⁻² (zero is γ = ∞), k, ρ; of `ALPHAS`; whether Eq. (20) is as
printed; whether P_Y of Eqs. (19), (25) is that of Σ."""

STATE = np.dtype(
    [(name, np.float64) for name in (
        "torque", "variance", "innovation", "innovation_variance", "unadjusted_innovation_variance",
        "innovation_memory_variance", "alpha", "f_alpha", "robust", "nis",
    )]
)  # fmt: skip
"""What a filter remembers and tells: X̂, P, Ỹ, P_Y of Eq. (14), P_Y of the unadjusted prediction, P̄_Y, α, f_α, mode, NIS."""

GAMMA_TOO_SMALL, NOT_POSITIVE, FACTOR_OVERFLOW = range(2, 5)
LARGEST_FACTOR = 1.0 / np.finfo(np.float64).eps
"""An f_α above this leaves nothing of V in P_Y: the filter has stopped weighing model against measurement."""


@kernel
def start(f, y, c):
    """Begin at X̂ = Y(0). P_Y(0) is what Eq. (20) as printed begins with; P̄_Y(0) = Ỹ(0)Ỹ(0)ᵀ is zero."""
    f.torque, f.variance, f.alpha, f.f_alpha = y, c.P0, 1.0, 1.0
    f.innovation_variance = f.unadjusted_innovation_variance = c.P0 + c.V


@kernel
def update(f, y, c):
    """One step of the torque filter, F = H = 1.

    Args:
        f: record of `STATE`, moved on; left as it was where the step fails.
        y: torque of the compliance model [N·m].
        c: record of `SETTINGS`.

    Returns:
        OK, or why there is no next estimate: NOT_FINITE, GAMMA_TOO_SMALL, NOT_POSITIVE (P_Y), FACTOR_OVERFLOW (f_α).
    """
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
    """α of Eq. (23) for the torque load ω [N·m], the filter's own last estimate; 1 for every rule but RAREKF."""
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
    """f_α of Eq. (25) where Eq. (19) switches to robust mode, and exactly 1 where it does not.

    Args:
        memory: tr P̄_Y, Eq. (20).
        total: tr P_Y = tr(H·P·Hᵀ + V), of the unadjusted prediction.
        noise: tr V.
        alpha: redundancy factor.
        c: record of `SETTINGS`.

    With the unadjusted P_Y: `f_α = P̄_Y / (α·P_Y)`. With the adjusted one, P_Y = f_α·HPHᵀ + V contains what it
    decides; f_α is then the positive root of `α·(f·HPHᵀ + V)·f = P̄_Y`. Both exceed 1 under the same condition.
    The result is infinite at α = 0.
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
def run(y, settings, history):
    """Run a filter over measurements, shape (T,), into `history`, shape (T,), records of `STATE`.

    Returns:
        The sample at which it failed, and the status; (T, OK) where it did not.
    """
    c = settings[0]
    start(history[0], y[0], c)
    for t in range(1, len(y)):
        history[t] = history[t - 1]
        status = update(history[t], y[t], c)
        if status != OK:
            return t, status
    return len(y), OK


@kernel
def surprise(y, settings, most):
    """Minus twice the log likelihood of a filter's innovations over measurements y, shape (T,); none counts more than `most`.

    Returns:
        It, the sample at which the filter failed, and the status; T and OK where it did not.
    """
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


def vector_update(
    f: dict[str, Any],
    x: np.ndarray,
    y_predicted: np.ndarray,
    y: np.ndarray,
    F: np.ndarray,
    H: np.ndarray,
    W: np.ndarray,
    V: np.ndarray,
    L: np.ndarray,
    load_index: int,
    c: np.void,
) -> dict[str, Any] | int:
    """One step of the recursion for n states and m measurements, from a predicted state and measurement.

    Args:
        f: the filter, a dictionary of `x` (n,), `P` (n, n), `innovation_covariance`, `memory` (m, m).
        x: Shape (n,), the prediction of Eq. (10), F·X̂ or f(X̂). y_predicted: Shape (m,), H·x or h(x).
        y: Shape (m,), the measurement.
        F, H: Shape (n, n), (m, n): the model, or the Jacobians of f at X̂ and of h at x.
        W, V, L: Shape (n, n), (m, m), (n, n): noise covariances; L of Eq. (18).
        load_index: which state is the torque load ω.
        c: record of `SETTINGS`; its W, V, P0, L are not looked at.

    Returns:
        The next filter, with `unadjusted_covariance`, `innovation` (m,), `alpha`, `f_alpha`, `robust`, `nis`; or the status, an
        integer, where there is none.
    """
    P = F @ f["P"] @ F.T + W  # (11)
    unadjusted = H @ P @ H.T + V  # (14), of the unadjusted prediction
    innovation = y - y_predicted  # (13)
    past = f["innovation_covariance"] if c["printed_memory"] else f["memory"]
    memory = (c["rho"] * past + np.outer(innovation, innovation)) / (c["rho"] + 1.0)  # (20)
    if not np.isfinite(np.trace(memory)):
        return NOT_FINITE
    alpha = redundancy_factor(f["x"][load_index], c)
    if c["rule"] == ROBUST:  # (18), without inverting P: Σ = P + γ⁻² P Lᵀ (I − γ⁻² L P Lᵀ)⁻¹ L P
        LP, g = L @ P, c["inverse_gamma_squared"]
        M = np.eye(len(P)) - g * LP @ L.T
        # For P > 0, M is positive definite exactly when P⁻¹ − γ⁻²LᵀL is. γ = ∞ gives P to the bit.
        if not _positive(M):
            return GAMMA_TOO_SMALL
        sigma = P + g * LP.T @ np.linalg.solve(M, LP)
        f_alpha = np.trace(sigma) / np.trace(P) if np.trace(P) > 0.0 else 1.0
    else:
        f_alpha = compensation_factor(np.trace(memory), np.trace(unadjusted), np.trace(V), alpha, c)
        if not f_alpha <= LARGEST_FACTOR:
            return FACTOR_OVERFLOW
        sigma = f_alpha * P  # (12), (19)
    P_Y = H @ sigma @ H.T + V  # (14)
    if not _positive(P_Y):
        return NOT_POSITIVE
    K = np.linalg.solve(P_Y, H @ sigma).T  # (15)
    x = x + K @ innovation  # (16)
    A = np.eye(len(P)) - K @ H
    P = A @ sigma @ A.T + K @ V @ K.T  # (17) in Joseph's form, which needs no inverse of Σ and stays positive
    if not (np.isfinite(x).all() and np.isfinite(P).all()):
        return NOT_FINITE
    P = 0.5 * (P + P.T)
    if not _positive(P):
        P = _without_negative(P)
    return {
        "x": x, "P": P, "innovation": innovation, "innovation_covariance": P_Y,
        "unadjusted_covariance": unadjusted, "memory": memory, "alpha": alpha, "f_alpha": f_alpha,
        "robust": bool(c["rule"] == ROBUST or f_alpha != 1.0), "nis": innovation @ np.linalg.solve(P_Y, innovation),
    }  # fmt: skip


def _without_negative(P: np.ndarray) -> np.ndarray:
    """The nearest covariance to a symmetric P, which is none by rounding where a state is known exactly.

    Left alone, what is negative there and not observed is multiplied by f_α in every step.
    """
    values, vectors = np.linalg.eigh(P)
    if values[0] >= 0.0:
        return P
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    return root @ root.T


def _positive(S: np.ndarray) -> bool:
    """Whether a symmetric matrix is finite and positive definite."""
    if not np.isfinite(S).all():
        return False
    try:
        np.linalg.cholesky(S)
    except np.linalg.LinAlgError:
        return False
    return True
