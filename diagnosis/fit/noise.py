"""Noise of the residuals: coloured, and different where the joint rests; and the filter that makes it white.

The residual of a channel is modelled as autoregressive noise (sensors, smoothing, differentiation) plus, where the
rotor rests, a slow disturbance: the encoder's quantisation, which does not average out without motion, and friction
whose bristle depends on it. Both are estimated from the residual itself, after everything that a candidate explains has
been taken out of it. A Kalman filter of the slow disturbance turns residuals, and every column of a Jacobian alike,
into innovations of unit variance; samples that do not count are skipped.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

from .replay import DECIMATION, STEP, Drive, parallel

ORDER = 3
"""Order of the autoregression."""
MEMORY = 0.6
"""Correlation time of the slow disturbance at rest [s]."""
_ROBUST = 1.4826  # standard deviation of a normal distribution per median absolute deviation


@njit(cache=True, nogil=True)
def _whiten(x, usable, at_rest, ar, white, slow, keep, out):
    """Innovations of x, shape (k, c), over their standard deviation; zero where unusable."""
    k, c = x.shape
    p = len(ar)
    state = np.zeros(c)
    P = 0.0
    run = 0
    for i in range(k):
        s = slow[1] if at_rest[i] else slow[0]
        state *= keep
        P = keep * keep * P + (1.0 - keep * keep) * s * s
        run = run + 1 if usable[i] else 0
        if run <= p:
            out[i] = 0.0
            continue
        S = P + white * white
        gain = P / S
        norm = 1.0 / np.sqrt(S)
        for j in range(c):
            y = x[i, j]
            for m in range(p):
                y -= ar[m] * x[i - 1 - m, j]
            e = y - state[j]
            out[i, j] = e * norm
            state[j] += gain * e
        P -= gain * P


@dataclass(frozen=True)
class ChannelNoise:
    """Noise of one channel in one stretch.

    Attributes:
      ar: autoregressive coefficients, shape (ORDER,).
      white: standard deviation of the innovation.
      slow: standard deviation of the slow disturbance, in motion and at rest, after the autoregression.
    """

    ar: np.ndarray
    white: float
    slow: tuple[float, float]


Noise = list[list[ChannelNoise]]
"""Noise by stretch and channel."""


def whiten(drives: list[Drive], noise: Noise, series: list[np.ndarray]) -> np.ndarray:
    """Whitened stack of series, one of shape (k, 3, c) a stretch: shape (total, c), channel by channel."""
    keep = np.exp(-STEP * DECIMATION / MEMORY)

    def one(task):
        drive, channels, x = task
        out = np.empty((3, len(drive.at), x.shape[2]))
        for c in range(3):
            n = channels[c]
            usable = drive.usable[:, c]
            _whiten(np.ascontiguousarray(x[:, c]), usable, drive.at_rest, n.ar, n.white, np.array(n.slow), keep, out[c])
        return _blocks(out, np.any(out != 0, axis=2), drive.block).reshape(-1, x.shape[2])

    return np.concatenate(parallel(one, list(zip(drives, noise, series, strict=True))))


def _blocks(white: np.ndarray, counts: np.ndarray, block: int) -> np.ndarray:
    """Sums of `block` innovations each, shape (3, k, c), over the root of how many count: of unit variance again."""
    if block == 1:
        return white
    starts = np.arange(0, white.shape[1], block)
    number = np.add.reduceat(counts.astype(np.float64), starts, axis=1)
    return np.add.reduceat(white, starts, axis=1) / np.sqrt(np.maximum(number, 1.0))[..., None]


def first_guess(drives: list[Drive], residuals: list[np.ndarray], quantum: np.ndarray) -> Noise:
    """Noise before anything is fitted: white noise from the differences of what counts as one, rest from one count.

    Args:
      residuals: shape (k, 3) a stretch.
      quantum: what the rotor encoder's quantisation rms leaves in each channel, shape (3,).
    """
    found = []
    for drive, r in zip(drives, residuals, strict=True):
        channels = []
        for c in range(3):
            use = drive.usable[:, c] & ~drive.at_rest
            x = r[use, c]
            x = x[: len(x) // drive.block * drive.block].reshape(-1, drive.block).sum(axis=1) / np.sqrt(drive.block)
            difference = np.diff(x, 2) if len(x) > 10 else np.ones(1)
            white = _ROBUST * np.median(np.abs(difference)) / np.sqrt(6.0)
            channels.append(ChannelNoise(np.zeros(ORDER), max(float(white), 1e-6), (0.0, float(quantum[c]))))
        found.append(channels)
    return found


def louder(noise: Noise, factor: float) -> Noise:
    """The same noise, `factor` times as large."""
    return [
        [ChannelNoise(c.ar, factor * c.white, (factor * c.slow[0], factor * c.slow[1])) for c in channels]
        for channels in noise
    ]


def estimate(
    drives: list[Drive],
    residuals: list[np.ndarray],
    quantum: np.ndarray,
    sensors: list[np.ndarray] | None = None,
    raw: list[np.ndarray] | None = None,
) -> Noise:
    """Noise from residuals, shape (k, 3) a stretch, that nothing systematic is left in.

    Args:
      sensors: what the sensors' stated noise alone leaves, likewise. No residual can be quieter than that: where it
        looks so, columns that carry the same noise (torsion, where no sensor reads the torque) have explained it away.
      raw: the residuals before that. At rest friction's bristle creeps by what the encoder does not see: a slow
        disturbance with which the derivatives of everything that acts at rest have much in common.
    """
    found = []
    raw = residuals if raw is None else raw
    for stretch, (drive, cleaned) in enumerate(zip(drives, residuals, strict=True)):
        channels = []
        for c in range(3):
            r = cleaned
            if sensors is not None:
                where = drive.usable[:, c] & ~drive.at_rest
                if where.any() and _spread(sensors[stretch][where, c]) > _spread(cleaned[where, c]):
                    r = sensors[stretch]
            moving = drive.usable[:, c] & ~drive.at_rest
            resting = drive.usable[:, c] & drive.at_rest
            if moving.sum() < 50:
                moving = drive.usable[:, c]
            if moving.sum() < 50:
                channels.append(ChannelNoise(np.zeros(ORDER), 1.0, (0.0, 0.0)))
                continue
            ar, white = _autoregression(r[:, c], moving)
            dc = abs(1.0 - ar.sum())
            slow = float(quantum[c])
            if resting.sum() > 50:
                loudest = max(np.mean(x[resting, c] ** 2) for x in (r, cleaned, raw[stretch]))
                slow = max(slow, np.sqrt(max(loudest - np.var(r[moving, c]), 0.0)))
            channels.append(ChannelNoise(ar, white, (0.0, slow * dc)))
        found.append(channels)
    return found


def _spread(x: np.ndarray) -> float:
    return float(np.median(np.abs(x)))


def _autoregression(x: np.ndarray, use: np.ndarray) -> tuple[np.ndarray, float]:
    """Coefficients and innovation standard deviation from the usable samples; clipped, so that no outlier decides."""
    limit = 4 * _ROBUST * np.median(np.abs(x[use]))
    y = np.where(use, np.clip(x, -limit, limit), 0.0)
    gamma = np.empty(ORDER + 1)
    for lag in range(ORDER + 1):
        both = use[lag:] & use[: len(use) - lag]
        gamma[lag] = np.sum(y[lag:] * y[: len(y) - lag] * both) / max(both.sum(), 1)
    R = gamma[np.abs(np.subtract.outer(np.arange(ORDER), np.arange(ORDER)))] + 1e-9 * gamma[0] * np.eye(ORDER)
    ar = np.linalg.solve(R, gamma[1:])
    variance = gamma[0] - ar @ gamma[1:]
    return ar, float(np.sqrt(max(variance, 1e-3 * gamma[0])))
