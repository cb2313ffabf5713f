"""Smooth motion from quantised encoders: one linear, zero-phase filter for every channel of a recording.

Each channel is smoothed by the spline that minimises Σ (y − s)² + λ ∫ (s''')² dt, computed as a Kalman filter and a
backward (Rauch–Tung–Striebel) pass of a triple integrator. Its passband is 1 / (1 + (f/fc)⁶), and times may be
irregular. It is the *same linear operator* for all channels: where the joint is linear, smoothing commutes with its
equations, and causes no error in a comparison of computed and measured torques. Between samples the minimiser is a
quintic, given exactly by position, velocity and acceleration at both ends.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from .chunks import kept, large
from .kernels import kernel

CUTOFF = 120.0  # passband fc of the smoother [Hz], or `SHARE` of the sampling rate if that is less
SHARE = 0.25  # passband over sampling rate of a slow log: half of the Nyquist frequency, for two derivatives
BLOCK = 1 << 15  # samples that the smoother keeps in memory at a time
_FEWEST = 5  # samples that can be differentiated


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
    """Write the inverse of a positive 3×3 matrix into B, by its factors L D Lᵀ. At the start of a recording the
    velocity is unknown, and minors would be differences of numbers 10¹² times as large."""
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
    """C = A B of 3×3 matrices; faster than a library call."""
    for i in range(3):
        for j in range(3):
            C[i, j] = A[i, 0] * B[0, j] + A[i, 1] * B[1, j] + A[i, 2] * B[2, j]


@kernel
def _predict(d, q, x, M, F, Q, work):
    """Predict motion x, shape (3, c), and its covariance M over a time d, in place."""
    _transition(d, F, Q, q)
    for j in range(x.shape[1]):
        x[0, j] += d * x[1, j] + 0.5 * d * d * x[2, j]
        x[1, j] += d * x[2, j]
    _product(F, M, work)
    _product(work, F.T, M)
    for i in range(3):
        for j in range(i + 1):
            M[i, j] = M[j, i] = 0.5 * (M[i, j] + M[j, i]) + Q[i, j]


@kernel
def _correct(y, offset, x, M, column):
    """Update motion x and its covariance M with a sample y, shape (c,), in place."""
    s = M[0, 0] + 1.0
    for j in range(x.shape[1]):
        e = (y[j] - offset[j] - x[0, j]) / s
        for i in range(3):
            x[i, j] += M[i, 0] * e
    column[:] = M[:, 0]
    for i in range(3):
        for j in range(3):
            M[i, j] -= column[i] * column[j] / s


@kernel
def _smooth(time, y, offset, q, scale, square, step, every, block, value, rate, acceleration):
    """Smooth channels y, shape (n, c), at `time`, shape (n,), and evaluate them every `step`: value and two
    derivatives, shape (c, m) each; of the first channels only if the derivatives' arrays have fewer.

    The filter runs forward once and keeps its state at the start of every `block` of samples. From the last block to
    the first it runs again, keeps every sample, and runs back: the same numbers as with all samples, in a block's
    memory.

    Args:
      offset: of the channels, shape (c,), subtracted first. q: the jerk's intensity at unit measurement noise.
      scale: of time, for covariances near one; square: its square.
      every: steps per evaluated point.
    """
    n, c = y.shape
    F, Q, inverse = np.zeros((3, 3)), np.zeros((3, 3)), np.zeros((3, 3))
    work, gain, column, M = np.zeros((3, 3)), np.zeros((3, 3)), np.zeros(3), np.eye(3) * 1e6
    x = np.zeros((3, c))
    for j in range(c):
        x[0, j] = y[0, j] - offset[j]
    blocks = (n + block - 1) // block
    size = min(block, n)
    known, sure = np.empty((blocks, 3, c)), np.empty((blocks, 3, 3))
    for b in range(blocks):
        known[b], sure[b] = x, M
        if b == blocks - 1:
            break
        for k in range(b * block, (b + 1) * block):
            if k:
                _predict(scale * (time[k] - time[0]) - scale * (time[k - 1] - time[0]), q, x, M, F, Q, work)
            _correct(y[k], offset, x, M, column)
    # One more than a block: the first sample of the next one, smoothed.
    t, state = np.empty(size + 1), np.empty((size + 1, 3, c))
    P, predicted = np.empty((size, 3, 3)), np.empty((size + 1, 3, 3))
    end = value.shape[1]
    for b in range(blocks - 1, -1, -1):
        begin = b * block
        count = min(block, n - begin)
        last = b == blocks - 1
        if not last:
            t[count], state[count], predicted[count] = t[0], state[0], predicted[0]
        x[:], M[:] = known[b], sure[b]
        for i in range(count):
            k = begin + i
            t[i] = scale * (time[k] - time[0])
            if k:
                _predict(t[i] - scale * (time[k - 1] - time[0]), q, x, M, F, Q, work)
            predicted[i] = M
            _correct(y[k], offset, x, M, column)
            state[i], P[i] = x, M
        for i in range(count - 2 if last else count - 1, -1, -1):
            d = t[i + 1] - t[i]
            _transition(d, F, Q, q)
            _inverse(predicted[i + 1], inverse)
            _product(P[i], F.T, work)
            _product(work, inverse, gain)
            for j in range(c):
                e2 = state[i + 1, 2, j] - state[i, 2, j]
                e1 = state[i + 1, 1, j] - state[i, 1, j] - d * state[i, 2, j]
                e0 = state[i + 1, 0, j] - state[i, 0, j] - d * state[i, 1, j] - 0.5 * d * d * state[i, 2, j]
                for r in range(3):
                    state[i, r, j] += gain[r, 0] * e0 + gain[r, 1] * e1 + gain[r, 2] * e2
        first = end
        if last and count == 1 and b > 0:  # the interval before covers it
            continue
        while first > 0 and (b == 0 or scale * (step * (every * (first - 1))) > t[0]):
            first -= 1
        i = 0
        for k in range(first, end):
            at = scale * (step * (every * k))
            while i < (count - 2 if last else count - 1) and t[i + 1] < at:
                i += 1
            d = t[i + 1] - t[i]
            u = at - t[i]
            for j in range(c):
                p, v, a = state[i, 0, j], state[i, 1, j], state[i, 2, j]
                e0 = state[i + 1, 0, j] - p - v * d - 0.5 * a * d * d
                e1 = state[i + 1, 1, j] - v - a * d
                e2 = state[i + 1, 2, j] - a
                b3 = (10.0 * e0 - 4.0 * e1 * d + 0.5 * e2 * d * d) / d**3
                b4 = (-15.0 * e0 + 7.0 * e1 * d - e2 * d * d) / d**4
                b5 = (6.0 * e0 - 3.0 * e1 * d + 0.5 * e2 * d * d) / d**5
                value[j, k] = p + u * (v + u * (0.5 * a + u * (b3 + u * (b4 + u * b5)))) + offset[j]
                if j < rate.shape[0]:
                    rate[j, k] = (v + u * (a + u * (3.0 * b3 + u * (4.0 * b4 + u * 5.0 * b5)))) * scale
                    acceleration[j, k] = (a + u * (6.0 * b3 + u * (12.0 * b4 + u * 20.0 * b5))) * square
        end = first


@dataclass(frozen=True)
class Smooth:
    """Smoothed channels on a uniform grid."""

    time: np.ndarray  # grid [s], shape (n,)
    value: np.ndarray  # shape (n, c), the channels
    # rate, acceleration: their first two derivatives in time, shape (n, c), or of the first channels, as requested
    rate: np.ndarray
    acceleration: np.ndarray


def passband(time: np.ndarray, cutoff: float = CUTOFF, share: float = SHARE) -> float:
    """Return the passband fc [Hz] of the smoother for samples at these times [s], at most `share` of their rate."""
    return min(cutoff, share / _interval(time))


def _interval(time: np.ndarray) -> float:
    return float(np.median(np.diff(time), overwrite_input=True))


def smooth(
    time: np.ndarray,
    channels: np.ndarray,
    step: float,
    cutoff: float = CUTOFF,
    every: int = 1,
    block: int = BLOCK,
    moving: int | None = None,
    share: float = SHARE,
) -> Smooth:
    """Smooth channels sampled at `time` and evaluate them on a uniform grid; each as it would be alone, to the bit.

    Args:
      time: shape (n,) [s]. channels: shape (n, c).
      step: of the grid [s]. cutoff: passband [Hz].
      every: evaluate every so many-th point of the grid, from the first.
      block: samples in memory at a time; the result does not depend on it.
      moving: number of channels, the first ones, with derivatives; all by default.
      share: largest passband over the sampling rate.
    """
    interval = _interval(time)
    scale = 2 * np.pi * min(cutoff, share / interval)  # time in units of 1/ωc keeps the covariances near one
    since, y = (np.ascontiguousarray(x, dtype=np.float64) for x in (time, channels))
    # A last sample on the grid counts in spite of rounding.
    count = int((time[-1] - time[0]) / step + 1e-3) // every + 1
    c = y.shape[1]
    value, rate, acceleration = (large(size, count) for size in (c, *[c if moving is None else moving] * 2))
    _smooth(since, y, y[0].copy(), scale * interval, scale, scale**2, step, every, block, value, rate, acceleration)
    grid = np.arange(count, dtype=np.float64)
    grid *= every
    grid *= step
    grid += time[0]
    return Smooth(kept(grid), value.T, rate.T, acceleration.T)


NOISY = 0.02  # largest noise share of the acceleration's power
_LEAST, _STEPS = 0.5, 32  # candidate passbands: lowest [Hz], number
_WINDOW = 4.0  # s of a spectrum
_LONGEST, _SHORTEST, _WINDOWS = 1 << 15, 32, 48  # samples of a window, windows of a long log
_ABOVE = (1.5, 4.0)  # times a passband: band in which the noise is measured


def candidates(limit: float) -> np.ndarray:
    """Return passbands to try, up to a limit [Hz], in ascending order."""
    return np.geomspace(min(_LEAST, limit), limit, _STEPS)


def windows(x: np.ndarray, parts: Sequence[slice], size: int, count: int, step: int) -> list[int]:
    """Return the first samples of windows of a size, every `step` samples; of more than `count`, those with the most
    travel of a position x, shape (n,)."""
    begins = [b for part in parts for b in range(part.start, part.stop - size + 1, step)]
    if len(begins) > count:
        travel = [float(np.ptp(x[b : b + size : max(size // 64, 1)])) for b in begins]
        begins = sorted(begins[k] for k in np.argsort(travel)[-count:])
    return begins


def spectrum(
    time: np.ndarray, x: np.ndarray, interval: float, parts: Sequence[slice]
) -> tuple[np.ndarray, np.ndarray] | None:
    """Return frequencies [Hz] and power density [rad²/Hz] of a position [rad] over the `parts` without gaps; None for
    one that is too short. `time`, `x`: shape (n,); `interval`: between samples [s]."""
    longest = max((part.stop - part.start for part in parts), default=0)
    size = min(_LONGEST, max(round(_WINDOW / interval), 2 * _SHORTEST), longest // 3)
    if size < _SHORTEST:
        return None
    begins = windows(x, parts, size, _WINDOWS, max(size // 2, 1))
    window = np.hanning(size - 2)
    total = np.zeros((size - 2) // 2 + 1)
    for b in begins:
        t = time[b : b + size]
        even = np.interp(t[0] + interval * np.arange(size), t, x[b : b + size])
        total += np.abs(np.fft.rfft(window * np.diff(even, 2))) ** 2
    frequency = np.fft.rfftfreq(size - 2, interval)
    gain = (2 * np.sin(np.pi * frequency * interval)) ** 4
    power = 2 * interval * total / (len(begins) * np.sum(window**2))
    return frequency[1:], power[1:] / gain[1:]


def noise_share(frequency: np.ndarray, power: np.ndarray, cutoff: float) -> tuple[float, float, float]:
    """Return, for an acceleration up to a passband [Hz], the noise share of its power, its noise and its rms [rad/s²
    rms]. Noise above the passband is assumed to be the same below."""
    above = (frequency > _ABOVE[0] * cutoff) & (frequency < _ABOVE[1] * cutoff)
    if not above.any():
        return 1.0, np.inf, np.inf
    density = float(np.median(power[above]))
    passed = (2 * np.pi * frequency) ** 4 / (1 + (frequency / cutoff) ** 6) ** 2
    width = float(frequency[1] - frequency[0])
    noise, whole = density * float(passed.sum()) * width, float((passed * power).sum()) * width
    return noise / max(whole, 1e-300), float(np.sqrt(noise)), float(np.sqrt(whole))


def differentiated(time: np.ndarray, angle: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return angle, velocity and acceleration [rad, rad/s, rad/s²] of samples, in the passband in which the acceleration
    has the least mean square error (motion that is cut off, and noise), of those in which noise is a small share."""
    if len(time) < _FEWEST:  # between gaps
        return angle, np.zeros_like(angle), np.zeros_like(angle)
    step = float(np.median(np.diff(time)))
    tried = candidates(min(CUTOFF, SHARE / step))
    cutoff = tried[0]
    if (power := spectrum(time, angle, step, [slice(0, len(time))])) is not None:
        share, noise, whole = np.array([noise_share(*power, f) for f in tried]).T
        # Power of the motion that is passed, less that of the noise.
        clear = share <= NOISY
        gained = np.full(len(tried), -np.inf)
        gained[clear] = whole[clear] ** 2 - 2 * noise[clear] ** 2
        cutoff = tried[np.argmax(gained)]
    s = smooth(time, angle[:, None], step, float(cutoff))
    position, velocity, acceleration = (np.interp(time, s.time, x[:, 0]) for x in (s.value, s.rate, s.acceleration))
    return position, velocity, acceleration
