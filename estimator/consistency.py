"""Consistency of a filter's covariance: NIS, NEES and whiteness of innovations (Bar-Shalom, Li & Kirubarajan,
"Estimation with Applications to Tracking and Navigation", 2001, section 5.4).

A filter with the right model has white innovations ν with its covariance S, and errors e with its covariance P. Then
νᵀS⁻¹ν and eᵀP⁻¹e are χ² with as many degrees of freedom as ν and e have components. A mean above the interval: the
filter is overconfident; below: conservative.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..models.errors import InputError

LEVEL = 0.95  # probability with which a matched filter is within an interval or a band


@dataclass(frozen=True)
class Mean:
    """A mean over samples with the two-sided χ² interval of a matched filter."""

    value: float  # mean per degree of freedom; 1 is expected
    low: float  # of the interval
    high: float  # of the interval
    samples: int  # number of independent samples

    @property
    def verdict(self) -> str:
        """`consistent`, `overconfident` (its covariance is too small) or `conservative` (too large)."""
        if self.value > self.high:
            return "overconfident"
        return "conservative" if self.value < self.low else "consistent"


def normalised_squares(vectors: np.ndarray, covariances: np.ndarray) -> np.ndarray:
    """Return vᵀC⁻¹v, shape (...): vectors (..., m), covariances (..., m, m). NIS of innovations, NEES of errors."""
    vectors, covariances = np.asarray(vectors), np.asarray(covariances)
    if covariances.shape != (*vectors.shape, vectors.shape[-1]):
        raise InputError(f"consistency: covariances: expected (..., m, m) to {vectors.shape}, got {covariances.shape}")
    return np.einsum("...i,...i->...", vectors, np.linalg.solve(covariances, vectors[..., None])[..., 0])


def chi_square_interval(dof: int, samples: int, level: float = LEVEL) -> tuple[float, float]:
    """Return the interval of the mean of `samples` independent χ² of `dof` degrees with probability `level`, per
    degree."""
    from scipy.stats import chi2

    total = dof * samples
    low, high = chi2.ppf([0.5 - 0.5 * level, 0.5 + 0.5 * level], total)
    return float(low / total), float(high / total)


def mean_consistency(squares: np.ndarray, dof: int, samples: int | None = None, level: float = LEVEL) -> Mean:
    """Return the mean of normalised squares, of any shape, per degree of freedom, with its interval. `samples`:
    independent ones; all by default. Innovations of a matched filter are independent; its errors are correlated in
    time, and independent between runs only."""
    samples = int(np.size(squares)) if samples is None else samples
    low, high = chi_square_interval(dof, samples, level)
    return Mean(float(np.mean(squares)) / dof, low, high, samples)


def share_inside(squares: np.ndarray, dof: int, level: float = LEVEL) -> float:
    """Return the share of times at which the mean over M runs is in its interval; squares (M, T). `level` is
    expected."""
    low, high = chi_square_interval(dof, squares.shape[0], level)
    mean = squares.mean(axis=0) / dof
    return float(np.mean((mean >= low) & (mean <= high)))


def autocorrelation(innovations: np.ndarray, lags: int) -> np.ndarray:
    """Return the normalised autocorrelation ρ(1 … lags) of normalised innovations, shape (T,): Σ ν(k) ν(k + l) / Σ ν².
    Their mean is not subtracted: a matched filter's is zero, and an offset shows as correlation."""
    v = np.asarray(innovations, dtype=np.float64)
    if v.ndim != 1 or not 0 < lags < len(v):
        raise InputError(f"autocorrelation: expected shape (T,) with more than {lags} samples, got {v.shape}")
    from scipy.signal import correlate

    covariance = correlate(v, v, method="fft")[len(v) - 1 : len(v) + lags]
    return covariance[1:] / covariance[0] if covariance[0] > 0.0 else np.zeros(lags)


def white_band(samples: int) -> float:
    """Return the half-width of the band of ρ of white innovations with probability `LEVEL`: 1.96/√n."""
    from scipy.special import ndtri

    return float(ndtri(0.5 + 0.5 * LEVEL) / np.sqrt(samples))


def ljung_box(rho: np.ndarray, samples: int) -> float:
    """Return the probability of autocorrelations, shape (L,), as large as these for white innovations (Ljung & Box
    1978)."""
    from scipy.special import chdtrc

    squares = np.asarray(rho) ** 2 / (samples - np.arange(1, len(rho) + 1))
    return float(chdtrc(len(rho), samples * (samples + 2) * np.sum(squares)))
