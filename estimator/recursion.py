"""The recursion, Eqs. (10)-(25): one compiled update for any number of states n and measurements m.

A filter lives in one flat float64 array, so that a compiled loop can hold many. Its layout, in this order:

    x n | P n² | innovation m | P_Y m² | unadjusted P_Y m² | P̄_Y m² | α, f_α, robust, NIS

`unpack` gives these parts names. A copy of the array at each step is the history of the filter.
Matrices inside are row by row. The model matrices F (n,n), H (m,n), W (n,n), V (m,m), L (n,n) are C-contiguous.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from .gain import LARGEST_FACTOR, ROBUST, compensation_factor, redundancy_factor

OK = 0
NOT_FINITE = 1
GAMMA_TOO_SMALL = 2
NOT_POSITIVE = 3
FACTOR_OVERFLOW = 4


class FilterBank(NamedTuple):
    """The model and gain rule of N filters, as arrays that compiled code takes. Made by `filters.filter_bank`.

    Attributes:
        F: Shape (N, n, n), transition.
        H: Shape (N, m, n), observation.
        W: Shape (N, n, n), process noise covariance of one step.
        V: Shape (N, m, m), measurement noise covariance.
        L: Shape (N, n, n), of Eq. (18).
        gains: Shape (N,), records of `gain.GAIN`.
    """

    F: np.ndarray
    H: np.ndarray
    W: np.ndarray
    V: np.ndarray
    L: np.ndarray
    gains: np.ndarray


@njit(cache=True, nogil=True)
def state_size(n, m):
    """Return the length of the flat array of a filter with n states and m measurements."""
    return n + n * n + m + 3 * m * m + 4


@njit(cache=True, nogil=True)
def work_size(n, m):
    """Return the length of the scratch array that `update` needs; one serves any number of filters."""
    return n + m + 4 * n * n + 3 * n * m + 2 * m * m


@njit(cache=True, nogil=True)
def _propagate(A, P, B, out, work):
    """out = A P Aᵀ + B with A (r,c), P flat (c,c) symmetric, B (r,r) symmetric; `work` ends as A P, flat (r,c)."""
    rows, columns = A.shape
    for i in range(rows):
        for j in range(columns):
            total = 0.0
            for l in range(columns):
                total += A[i, l] * P[l * columns + j]
            work[i * columns + j] = total
    for i in range(rows):
        for j in range(i + 1):
            total = B[i, j]
            for l in range(columns):
                total += work[i * columns + l] * A[j, l]
            out[i * rows + j] = total
            out[j * rows + i] = total


@njit(cache=True, nogil=True)
def _cholesky(S, out, size):
    """Factor S = C Cᵀ, lower C into `out`; return whether S is finite and positive definite."""
    for i in range(size):
        for j in range(i + 1):
            total = S[i * size + j]
            for l in range(j):
                total -= out[i * size + l] * out[j * size + l]
            if i > j:
                out[i * size + j] = total / out[j * size + j]
            elif total > 0.0 and total < math.inf:
                out[i * size + i] = math.sqrt(total)
            else:
                return False
    return True


@njit(cache=True, nogil=True)
def _solve(C, b, size, columns):
    """Overwrite b, flat (size, columns), with the solution of C Cᵀ z = b."""
    for c in range(columns):
        for i in range(size):
            total = b[i * columns + c]
            for l in range(i):
                total -= C[i * size + l] * b[l * columns + c]
            b[i * columns + c] = total / C[i * size + i]
        for i in range(size - 1, -1, -1):
            total = b[i * columns + c]
            for l in range(i + 1, size):
                total -= C[l * size + i] * b[l * columns + c]
            b[i * columns + c] = total / C[i * size + i]


@njit(cache=True, nogil=True)
def _trace(S, size):
    total = 0.0
    for i in range(size):
        total += S[i * size + i]
    return total


@njit(cache=True, nogil=True)
def _robust_covariance(P, L, inverse_gamma_squared, sigma, LP, M, factor, n):
    """Eq. (18), without inverting P: Σ = P + γ⁻² P Lᵀ M⁻¹ L P, M = I - γ⁻² L P Lᵀ.

    For P > 0, M is positive definite exactly when P⁻¹ - γ⁻²LᵀL is; return whether it is. γ = ∞ gives P to the bit.
    """
    for i in range(n):
        for j in range(n):
            total = 0.0
            for l in range(n):
                total += L[i, l] * P[l * n + j]
            LP[i * n + j] = total
    for i in range(n):
        for j in range(n):
            total = 0.0
            for l in range(n):
                total += LP[i * n + l] * L[j, l]
            M[i * n + j] = (1.0 if i == j else 0.0) - inverse_gamma_squared * total
    if not _cholesky(M, factor, n):
        return False
    for i in range(n * n):
        M[i] = LP[i]
    _solve(factor, M, n, n)
    for i in range(n):
        for j in range(i + 1):
            total = 0.0
            for l in range(n):
                total += LP[l * n + i] * M[l * n + j]
            sigma[i * n + j] = P[i * n + j] + inverse_gamma_squared * total
            sigma[j * n + i] = sigma[i * n + j]
    return True


@njit(cache=True, nogil=True)
def start(state, x, P, H, V):
    """Set a flat filter state to the estimate x (n,) with covariance P (n,n), before any innovation."""
    m, n = H.shape
    state[:] = 0.0
    for i in range(n):
        state[i] = x[i]
        for j in range(n):
            state[n + i * n + j] = P[i, j]
    at = n + n * n + m
    # P_Y(0) is what Eq. (20) as printed begins with; P̄_Y(0) = Ỹ(0)Ỹ(0)ᵀ is zero at X̂ = Y(0).
    _propagate(H, state[n : n + n * n], V, state[at : at + m * m], np.empty(m * n))
    for i in range(m * m):
        state[at + m * m + i] = state[at + i]
    at += 3 * m * m
    state[at] = 1.0
    state[at + 1] = 1.0


@njit(cache=True, nogil=True)
def update_predicted(state, x_predicted, y, y_predicted, F, H, W, V, L, gain, work):
    """One step of the filter from a predicted state and measurement: Eqs. (11)-(25).

    For nonlinear f, h (EKF): x_predicted = f(x), F = ∂f/∂x at x, y_predicted = h(x_predicted), H = ∂h/∂x there.

    Args:
        state: Shape (state_size(n, m),), overwritten; left as it was where the step fails.
        x_predicted: Shape (n,), Eq. (10).
        y: Shape (m,), the measurement.
        y_predicted: Shape (m,).
        F, H, W, V, L: see the module.
        gain: `gain.GAIN` record.
        work: Shape (≥ work_size(n, m),), scratch; x_predicted and y_predicted must not lie in it.

    Returns:
        OK, or why there is no next estimate: NOT_FINITE, GAMMA_TOO_SMALL, NOT_POSITIVE (P_Y), FACTOR_OVERFLOW (f_α).
    """
    m, n = H.shape
    nn, mn, mm = n * n, m * n, m * m
    at_P, at_innovation = n, n + nn
    at_PY = at_innovation + m
    at_unadjusted, at_memory, at_last = at_PY + mm, at_PY + 2 * mm, at_PY + 3 * mm

    P = work[:nn]
    sigma = work[nn : 2 * nn]
    square = work[2 * nn : 3 * nn]
    square2 = work[3 * nn : 4 * nn]
    at = 4 * nn
    HS = work[at : at + mn]
    KT = work[at + mn : at + 2 * mn]
    KV = work[at + 2 * mn : at + 3 * mn]
    at += 3 * mn
    PY = work[at : at + mm]
    factor = work[at + mm : at + 2 * mm]

    _propagate(F, state[at_P : at_P + nn], W, P, square)  # Eq. (11)
    _propagate(H, P, V, PY, HS)  # Eq. (14), unadjusted

    # Memory, Eq. (20); only its trace decides, its entries go into the state at the end.
    rho, printed_memory = gain.rho, gain.printed_memory != 0.0
    trace_memory = 0.0
    finite = True
    for i in range(m):
        innovation = y[i] - y_predicted[i]  # Eq. (13)
        finite = finite and math.isfinite(innovation)
        before = state[(at_PY if printed_memory else at_memory) + i * m + i]
        trace_memory += (rho * before + innovation * innovation) / (rho + 1.0)
    if not (finite and math.isfinite(trace_memory)):
        return NOT_FINITE

    # Gain adjustment, Eqs. (12), (18)-(25).
    load = state[int(gain.load_index)]
    alpha = redundancy_factor(load, gain)
    robust = False
    f = 1.0
    if gain.rule == ROBUST:
        if not _robust_covariance(P, L, gain.inverse_gamma_squared, sigma, HS_or(square), square2, state_free(work, n, m), n):
            return GAMMA_TOO_SMALL
    return OK
