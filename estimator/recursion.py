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

from .gain import EKF, LARGEST_FACTOR, ROBUST, compensation_factor, redundancy_factor

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


@njit(cache=True, nogil=True, error_model="numpy")
def state_size(n, m):
    """Return the length of the flat array of a filter with n states and m measurements."""
    return n + n * n + m + 3 * m * m + 4


@njit(cache=True, nogil=True, error_model="numpy")
def workspace(n, m):
    """Return the scratch array of `update`; one serves any number of filters with n states and m measurements."""
    return np.zeros(n + m + 5 * n * n + 2 * m * n + 3 * m * m)


# The matrices of a step lie row by row in one scratch array; the helpers take it and where each begins.
# Few arrays and inlining matter: each array that a compiled call takes costs as much as the arithmetic of one state.


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def _propagate(A, source, P, B, work, out, AP, rows, columns):
    """out = A P Aᵀ + B: A (rows, columns), P symmetric in `source`, B (rows, rows); leaves A P in `AP`."""
    for i in range(rows):
        for j in range(columns):
            total = 0.0
            for l in range(columns):
                total += A[i, l] * source[P + l * columns + j]
            work[AP + i * columns + j] = total
    for i in range(rows):
        for j in range(i + 1):
            total = B[i, j]
            for l in range(columns):
                total += work[AP + i * columns + l] * A[j, l]
            work[out + i * rows + j] = total
            work[out + j * rows + i] = total


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def _cholesky(work, S, out, size):
    """Factor S = C Cᵀ, lower C into `out`; return whether S is finite and positive definite."""
    for i in range(size):
        for j in range(i + 1):
            total = work[S + i * size + j]
            for l in range(j):
                total -= work[out + i * size + l] * work[out + j * size + l]
            if i > j:
                work[out + i * size + j] = total / work[out + j * size + j]
            elif total > 0.0 and total < math.inf:
                work[out + i * size + i] = math.sqrt(total)
            else:
                return False
    return True


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def _solve(work, C, b, size, columns):
    """Overwrite b (size, columns) with the solution of C Cᵀ z = b."""
    for c in range(columns):
        for i in range(size):
            total = work[b + i * columns + c]
            for l in range(i):
                total -= work[C + i * size + l] * work[b + l * columns + c]
            work[b + i * columns + c] = total / work[C + i * size + i]
        for i in range(size - 1, -1, -1):
            total = work[b + i * columns + c]
            for l in range(i + 1, size):
                total -= work[C + l * size + i] * work[b + l * columns + c]
            work[b + i * columns + c] = total / work[C + i * size + i]


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def _trace(work, S, size):
    total = 0.0
    for i in range(size):
        total += work[S + i * size + i]
    return total


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def _robust_covariance(work, P, L, inverse_gamma_squared, sigma, LP, M, factor, n):
    """Eq. (18), without inverting P: Σ = P + γ⁻² P Lᵀ M⁻¹ L P, M = I - γ⁻² L P Lᵀ.

    For P > 0, M is positive definite exactly when P⁻¹ - γ⁻²LᵀL is; return whether it is. γ = ∞ gives P to the bit.
    """
    for i in range(n):
        for j in range(n):
            total = 0.0
            for l in range(n):
                total += L[i, l] * work[P + l * n + j]
            work[LP + i * n + j] = total
    for i in range(n):
        for j in range(n):
            total = 0.0
            for l in range(n):
                total += work[LP + i * n + l] * L[j, l]
            work[M + i * n + j] = (1.0 if i == j else 0.0) - inverse_gamma_squared * total
    if not _cholesky(work, M, factor, n):
        return False
    for i in range(n * n):
        work[M + i] = work[LP + i]
    _solve(work, factor, M, n, n)
    for i in range(n):
        for j in range(i + 1):
            total = 0.0
            for l in range(n):
                total += work[LP + l * n + i] * work[M + l * n + j]
            work[sigma + i * n + j] = work[P + i * n + j] + inverse_gamma_squared * total
            work[sigma + j * n + i] = work[sigma + i * n + j]
    return True


@njit(cache=True, nogil=True, error_model="numpy")
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
    work = np.empty(m * m + m * n)
    _propagate(H, state, n, V, work, 0, m * m, m, n)
    for i in range(m * m):
        state[at + i] = work[i]
        state[at + m * m + i] = work[i]
    at += 3 * m * m
    state[at] = 1.0
    state[at + 1] = 1.0


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def _step(state, y, F, H, W, V, L, gain, work, n, m):
    """Eqs. (11)-(25) after `work` holds the predicted state and measurement. Constant n, m are unrolled."""
    nn, mm = n * n, m * m
    at_P, at_innovation = n, n + nn
    at_PY = at_innovation + m
    at_unadjusted, at_memory, at_last = at_PY + mm, at_PY + 2 * mm, at_PY + 3 * mm

    # Where things lie in `work`; the predictions come first.
    x_predicted, y_predicted = 0, n
    P = n + m
    sigma, A, B, C = P + nn, P + 2 * nn, P + 3 * nn, P + 4 * nn
    KT = P + 5 * nn
    KV = KT + n * m
    PY = KV + n * m
    unadjusted_PY, factor = PY + mm, PY + 2 * mm

    _propagate(F, state, at_P, W, work, P, A, n, n)  # Eq. (11)
    _propagate(H, work, P, V, work, unadjusted_PY, KT, m, n)  # Eq. (14) of the unadjusted prediction

    # Memory, Eq. (20). The state is not written before the step is known to succeed: only the trace for now.
    # As printed, it is the past P_Y of Eq. (14), the adjusted one, that is carried.
    rho = gain.rho
    at_past = at_PY if gain.printed_memory != 0.0 else at_memory
    memory = 0.0
    for i in range(m):
        innovation = y[i] - work[y_predicted + i]  # Eq. (13)
        memory += (rho * state[at_past + i * m + i] + innovation * innovation) / (rho + 1.0)
    if not math.isfinite(memory):
        return NOT_FINITE

    # Gain adjustment, Eqs. (12), (18)-(25). ω is the filter's own last estimate.
    alpha = redundancy_factor(state[int(gain.load_index)], gain)
    robust = gain.rule == ROBUST
    f = 1.0
    if robust:
        if not _robust_covariance(work, P, L, gain.inverse_gamma_squared, sigma, A, B, C, n):
            return GAMMA_TOO_SMALL
        trace = _trace(work, P, n)
        f = _trace(work, sigma, n) / trace if trace > 0.0 else 1.0
    else:
        if gain.rule != EKF:
            noise = 0.0
            for i in range(m):
                noise += V[i, i]
            f = compensation_factor(memory, _trace(work, unadjusted_PY, m), noise, alpha, gain)
            robust = f != 1.0
        if not f <= LARGEST_FACTOR:
            return FACTOR_OVERFLOW
        for i in range(nn):
            work[sigma + i] = f * work[P + i]

    # Gain, Eq. (15), with the adjusted P_Y: Kᵀ = P_Y⁻¹ H Σ.
    _propagate(H, work, sigma, V, work, PY, KT, m, n)
    if not _cholesky(work, PY, factor, m):
        return NOT_POSITIVE
    _solve(work, factor, KT, m, n)

    # Eq. (17) in Joseph's form, which needs no inverse of Σ and stays positive: (I - KH) Σ (I - KH)ᵀ + K V Kᵀ.
    for i in range(n):
        for j in range(n):
            total = 1.0 if i == j else 0.0
            for l in range(m):
                total -= work[KT + l * n + i] * H[l, j]
            work[A + i * n + j] = total
    for i in range(n):
        for j in range(n):
            total = 0.0
            for l in range(n):
                total += work[A + i * n + l] * work[sigma + l * n + j]
            work[B + i * n + j] = total
        for j in range(m):
            total = 0.0
            for l in range(m):
                total += work[KT + l * n + i] * V[l, j]
            work[KV + i * m + j] = total
    for i in range(n):
        for j in range(i + 1):
            total = 0.0
            for l in range(n):
                total += work[B + i * n + l] * work[A + j * n + l]
            for l in range(m):
                total += work[KV + i * m + l] * work[KT + l * n + j]
            if not math.isfinite(total):
                return NOT_FINITE
            work[C + i * n + j] = total
            work[C + j * n + i] = total

    for i in range(n):
        total = work[x_predicted + i]
        for l in range(m):
            total += work[KT + l * n + i] * (y[l] - work[y_predicted + l])  # Eq. (16)
        if not math.isfinite(total):
            return NOT_FINITE
        work[x_predicted + i] = total

    # The step has succeeded: write it. First P̄_Y, since as printed it is made of the past P_Y.
    for i in range(m):
        state[at_innovation + i] = y[i] - work[y_predicted + i]
    for i in range(m):
        for j in range(m):
            product = state[at_innovation + i] * state[at_innovation + j]
            state[at_memory + i * m + j] = (rho * state[at_past + i * m + j] + product) / (rho + 1.0)
    for i in range(mm):
        state[at_PY + i] = work[PY + i]
        state[at_unadjusted + i] = work[unadjusted_PY + i]
    for i in range(nn):
        state[at_P + i] = work[C + i]
    for i in range(n):
        state[i] = work[x_predicted + i]
    # NIS ỹᵀ P_Y⁻¹ ỹ = |z|² with C z = ỹ.
    nis = 0.0
    for i in range(m):
        total = state[at_innovation + i]
        for l in range(i):
            total -= work[factor + i * m + l] * work[KV + l]
        work[KV + i] = total / work[factor + i * m + i]
        nis += work[KV + i] * work[KV + i]
    state[at_last] = alpha
    state[at_last + 1] = f
    state[at_last + 2] = 1.0 if robust else 0.0
    state[at_last + 3] = nis
    return OK


@njit(cache=True, nogil=True, error_model="numpy")
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
        work: scratch from `workspace(n, m)`.

    Returns:
        OK, or why there is no next estimate: NOT_FINITE, GAMMA_TOO_SMALL, NOT_POSITIVE (P_Y), FACTOR_OVERFLOW (f_α).
    """
    m, n = H.shape
    for i in range(n):
        work[i] = x_predicted[i]
    for i in range(m):
        work[n + i] = y_predicted[i]
    return _step(state, y, F, H, W, V, L, gain, work, n, m)


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def _linear(state, y, F, H, W, V, L, gain, work, n, m):
    for i in range(n):
        total = 0.0
        for j in range(n):
            total += F[i, j] * state[j]  # Eq. (10)
        work[i] = total
    for i in range(m):
        total = 0.0
        for j in range(n):
            total += H[i, j] * work[j]
        work[n + i] = total
    return _step(state, y, F, H, W, V, L, gain, work, n, m)


@njit(cache=True, nogil=True, error_model="numpy")
def update(state, y, F, H, W, V, L, gain, work):
    """One step of the linear filter, Eqs. (10)-(25); arguments and result as `update_predicted`."""
    m, n = H.shape
    if n == 1 and m == 1:
        # The same code, with constants for n and m: without its loops it takes a fraction of the time.
        return _linear(state, y, F, H, W, V, L, gain, work, 1, 1)
    return _linear(state, y, F, H, W, V, L, gain, work, n, m)


@njit(cache=True, nogil=True, error_model="numpy")
def update_bank(states, y, bank, work):
    """One step of N filters: states (N, S), measurements y (N, m), in place.

    Returns:
        (index, status) of the first filter that failed, or (-1, OK). The others are updated nonetheless.
    """
    failed, why = -1, OK
    for i in range(states.shape[0]):
        status = update(states[i], y[i], bank.F[i], bank.H[i], bank.W[i], bank.V[i], bank.L[i], bank.gains[i], work)
        if status != OK and failed < 0:
            failed, why = i, status
    return failed, why


@njit(cache=True, nogil=True, error_model="numpy")
def run_bank(states, y, bank, history, status):
    """Run N filters over T measurements.

    Args:
        states: Shape (N, S), the filters at sample 0; at the end the last good state of each.
        y: Shape (N, T, m).
        bank: FilterBank of N filters.
        history: Shape (N, T, s), receives the first s values of each state: s = S keeps all, s = n only x̂.
        status: Shape (N, 2) integer, receives (status, step) where a filter ended; (OK, T) where it did not.
    """
    count, steps, _ = y.shape
    m, n = bank.H.shape[1:]
    kept = history.shape[2]
    work = workspace(n, m)
    for i in range(count):
        F, H, W, V, L, gain = bank.F[i], bank.H[i], bank.W[i], bank.V[i], bank.L[i], bank.gains[i]
        state = states[i]
        for l in range(kept):
            history[i, 0, l] = state[l]
        status[i, 0], status[i, 1] = OK, steps
        for t in range(1, steps):
            code = update(state, y[i, t], F, H, W, V, L, gain, work)
            if code != OK:
                status[i, 0], status[i, 1] = code, t
                break
            for l in range(kept):
                history[i, t, l] = state[l]
