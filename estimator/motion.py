"""Smooth motion from quantised encoders: one linear, zero-phase filter for every channel of a recording.

Each channel is smoothed by the spline that minimises Σ (y − s)² + λ ∫ (s''')² dt, computed as a Kalman filter and a
backward (Rauch–Tung–Striebel) pass of a triple integrator. It takes irregular time as it is, its passband is
1 / (1 + (f/fc)⁶), and it is the *same linear operator* for all channels: where the joint is linear, smoothing commutes
with its equations, so that no smoothing error enters the comparison of torques computed from motion with torques
that were measured. Between samples the minimiser is a quintic, so that position, velocity and acceleration at both ends
give it exactly at any other time.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..models.kernels import kernel

CUTOFF = 120.0
"""Passband fc of the smoother [Hz]; at half of the Nyquist frequency where sampling is slower than that."""


@kernel
def _transition(d, F, Q, q):
    F[:] = 0.0
    F[0, 0] = F[1, 1] = F[2, 2] = 1.0
    F[0, 1] = F[1, 2] = d
    F[0, 2] = 0.5 * d * d
    Q[0, 0] = q * d**5 / 20.0
    Q[0, 1] = Q[1, 0] = q * d**4 / 8.0
    Q[0, 2] = Q[2, 0] = q * d**3 / 6.0
    Q[1, 1] = q * d**3 / 3.0
    Q[1, 2] = Q[2, 1] = q * d**2 / 2.0
    Q[2, 2] = q * d


@kernel
def _inverse(A, B):
    """Inverse of a positive 3×3 matrix into B, by its factors L D Lᵀ: where a recording begins nothing is known of the velocity,
    and its minors would be differences of numbers that are 10¹² times as large."""
    a, b, c, d, e, f = A[0, 0], A[0, 1], A[0, 2], A[1, 1], A[1, 2], A[2, 2]
    l10, l20 = b / a, c / a
    d1, rest = d - l10 * b, e - l20 * b
    l21 = rest / d1
    d2, m = f - l20 * c - l21 * rest, l10 * l21 - l20
    B[2, 2] = 1.0 / d2
    B[1, 2] = B[2, 1] = -l21 / d2
    B[0, 2] = B[2, 0] = m / d2
    B[1, 1] = 1.0 / d1 + l21 * l21 / d2
    B[0, 1] = B[1, 0] = -l10 / d1 - m * l21 / d2
    B[0, 0] = 1.0 / a + l10 * l10 / d1 + m * m / d2


@kernel
def _product(A, B, C):
    """C = A B of 3×3 matrices: a library's product of matrices costs more to call than this to compute."""
    for i in range(3):
        for j in range(3):
            C[i, j] = A[i, 0] * B[0, j] + A[i, 1] * B[1, j] + A[i, 2] * B[2, j]


@kernel
def _smooth(t, y, q):
    """Smooth channels y, shape (n, c), at times t, shape (n,); q is the jerk's intensity at unit measurement noise.

    Returns value, first and second derivative, shape (n, 3, c).
    """
    n, c = y.shape
    F, Q, inverse = np.zeros((3, 3)), np.zeros((3, 3)), np.zeros((3, 3))
    work, gain, column, M = np.zeros((3, 3)), np.zeros((3, 3)), np.zeros(3), np.eye(3) * 1e6
    state = np.empty((n, 3, c))
    P = np.empty((n, 3, 3))
    predicted = np.empty((n, 3, 3))
    x = np.zeros((3, c))
    x[0] = y[0]
    for k in range(n):
        if k:
            d = t[k] - t[k - 1]
            _transition(d, F, Q, q)
            for j in range(c):
                x[0, j] += d * x[1, j] + 0.5 * d * d * x[2, j]
                x[1, j] += d * x[2, j]
            _product(F, M, work)
            _product(work, F.T, M)
            for i in range(3):
                for j in range(i + 1):
                    M[i, j] = M[j, i] = 0.5 * (M[i, j] + M[j, i]) + Q[i, j]
        predicted[k] = M
        s = M[0, 0] + 1.0
        for j in range(c):
            e = (y[k, j] - x[0, j]) / s
            for i in range(3):
                x[i, j] += M[i, 0] * e
        column[:] = M[:, 0]
        for i in range(3):
            for j in range(3):
                M[i, j] -= column[i] * column[j] / s
        state[k] = x
        P[k] = M
    for k in range(n - 2, -1, -1):
        d = t[k + 1] - t[k]
        _transition(d, F, Q, q)
        _inverse(predicted[k + 1], inverse)
        _product(P[k], F.T, work)
        _product(work, inverse, gain)
        for j in range(c):
            e2 = state[k + 1, 2, j] - state[k, 2, j]
            e1 = state[k + 1, 1, j] - state[k, 1, j] - d * state[k, 2, j]
            e0 = state[k + 1, 0, j] - state[k, 0, j] - d * state[k, 1, j] - 0.5 * d * d * state[k, 2, j]
            for i in range(3):
                state[k, i, j] += gain[i, 0] * e0 + gain[i, 1] * e1 + gain[i, 2] * e2
    return state


@kernel
def _interpolate(t, state, at):
    """Evaluate the quintic through (value, slope, curvature) at the knots t: shape (len(at), 3, c)."""
    c = state.shape[2]
    out = np.empty((len(at), 3, c))
    i = 0
    for k in range(len(at)):
        while i < len(t) - 2 and t[i + 1] < at[k]:
            i += 1
        d = t[i + 1] - t[i]
        u = at[k] - t[i]
        for j in range(c):
            p, v, a = state[i, 0, j], state[i, 1, j], state[i, 2, j]
            e0 = state[i + 1, 0, j] - p - v * d - 0.5 * a * d * d
            e1 = state[i + 1, 1, j] - v - a * d
            e2 = state[i + 1, 2, j] - a
            b3 = (10.0 * e0 - 4.0 * e1 * d + 0.5 * e2 * d * d) / d**3
            b4 = (-15.0 * e0 + 7.0 * e1 * d - e2 * d * d) / d**4
            b5 = (6.0 * e0 - 3.0 * e1 * d + 0.5 * e2 * d * d) / d**5
            out[k, 0, j] = p + u * (v + u * (0.5 * a + u * (b3 + u * (b4 + u * b5))))
            out[k, 1, j] = v + u * (a + u * (3.0 * b3 + u * (4.0 * b4 + u * 5.0 * b5)))
            out[k, 2, j] = a + u * (6.0 * b3 + u * (12.0 * b4 + u * 20.0 * b5))
    return out


@dataclass(frozen=True)
class Smooth:
    """Smoothed channels on a uniform grid.

    Attributes:
      time: grid [s], shape (n,).
      value, rate, acceleration: shape (n, c), the channels and their first two derivatives in time.
    """

    time: np.ndarray
    value: np.ndarray
    rate: np.ndarray
    acceleration: np.ndarray


def passband(time: np.ndarray, cutoff: float = CUTOFF) -> float:
    """Passband fc [Hz] of the smoother for samples at these times [s]."""
    return min(cutoff, 0.25 / float(np.median(np.diff(time))))


def smooth(time: np.ndarray, channels: np.ndarray, step: float, cutoff: float = CUTOFF) -> Smooth:
    """Smooth channels, shape (n, c), sampled at `time` [s] and evaluate them on a uniform grid of `step` [s]."""
    interval = float(np.median(np.diff(time)))
    cutoff = passband(time, cutoff)
    scale = 2 * np.pi * cutoff  # time in units of 1/ωc keeps the covariances near one
    offset = channels[0]
    since = time - time[0]
    state = _smooth(scale * since, np.ascontiguousarray(channels - offset, dtype=np.float64), scale * interval)
    # A last sample on the grid counts as such, whatever its time has lost by rounding.
    grid = step * np.arange(int(since[-1] / step + 1e-3) + 1)
    out = _interpolate(scale * since, state, scale * grid)
    return Smooth(time[0] + grid, out[:, 0] + offset, out[:, 1] * scale, out[:, 2] * scale**2)
