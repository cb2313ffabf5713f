"""Whitening against the Gaussian density of the noise, its covariance written down; and that what does not count is not read."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import cholesky, solve_triangular, toeplitz
from scipy.signal import lfilter
from swing import recording

from flexspline.diagnosis.data.segments import BALANCES, CURRENT, Segment, segments
from flexspline.diagnosis.fit.noise import BANDS as TIMES
from flexspline.diagnosis.fit.noise import INTERVAL, AutoregressiveNoise, Noise, whiten
from flexspline.models.joint import load_joint

AR = np.array([0.5, -0.2])
WHITE, BANDS = 0.3, np.array([0.2, 0.1, 0.4, 0.7])


@pytest.fixture(scope="module")
def segment() -> Segment:
    (one,), _ = segments([recording(seconds=4.0)], load_joint("test-joint"))
    usable = one.usable.copy()
    usable[::7] = False
    usable[40:90] = False
    return replace(one, usable=usable, at_rest=np.zeros(len(one.at), bool), block=1)


@pytest.fixture(scope="module")
def noise() -> Noise:
    sensors = (AutoregressiveNoise(AR, WHITE),) * len(BALANCES)
    return Noise((sensors,), np.tile(BANDS, (len(BALANCES), 1)), np.zeros((1, len(BALANCES))))


def covariance(k: int) -> np.ndarray:
    """Of k samples: the autoregression by its impulse response, and exponentials."""
    response = WHITE * lfilter([1.0], [1.0, *-AR], np.eye(1, 400)[0])
    lags = np.correlate(response, response, "full")[len(response) - 1 :][:k]
    found = np.pad(lags, (0, k - len(lags)))
    for size, time in zip(BANDS, TIMES, strict=True):
        found = found + size**2 * np.exp(-INTERVAL * np.arange(k) / time)
    return toeplitz(found)


def test_whitened_rows_are_the_gaussian_density_of_the_noise(segment, noise, rng):
    k, use = len(segment.at), segment.usable[:, CURRENT]
    x = rng.standard_normal((k, len(BALANCES), 11))  # more than one group of series side by side, the last not full
    white = whiten([segment], noise, [x])
    rows = white.rows.reshape(len(BALANCES), k, -1)[CURRENT]
    factor = cholesky(covariance(k)[np.ix_(use, use)], lower=True)
    np.testing.assert_allclose(rows[use], solve_triangular(factor, x[use, CURRENT], lower=True), atol=1e-5)
    assert not rows[~use].any()
    alone = whiten([replace(segment, usable=segment.usable & (np.arange(len(BALANCES)) == CURRENT))], noise, [x])
    assert alone.log_determinant == pytest.approx(2 * np.sum(np.log(np.diag(factor))), rel=1e-6)


def test_what_does_not_count_is_not_read(segment, noise, rng):
    x = rng.standard_normal((len(segment.at), len(BALANCES), 11))
    holes = np.where(segment.usable[..., None], x, np.nan)
    np.testing.assert_array_equal(whiten([segment], noise, [holes]).rows, whiten([segment], noise, [x]).rows)
