"""Own sines and exponentials against the C library's, and their derivatives by dual numbers."""

from __future__ import annotations

import math

import numba
import numpy as np
import pytest

from flexspline.models.dual import LANES, decayed, dual_table, sincos

EPS = np.finfo(float).eps


@numba.njit
def _sines(angles, out):
    for i in range(len(angles)):
        out[i, 0], out[i, 1] = sincos(angles[i])


@pytest.mark.parametrize("reach", [1.0, 1e3, 9.9e5, 1e9])
def test_sine_and_cosine(rng, reach):
    """To an ulp of one; beyond what is reduced here the C library's."""
    angles = np.concatenate([reach * rng.uniform(-1, 1, 20000), np.arange(-40, 41) * 0.25 * np.pi, [0.0, -0.0, 1e-300]])
    out = np.empty((len(angles), 2))
    _sines(angles, out)
    np.testing.assert_allclose(out[:, 0], [math.sin(x) for x in angles], rtol=0, atol=EPS)
    np.testing.assert_allclose(out[:, 1], [math.cos(x) for x in angles], rtol=0, atol=EPS)


def test_infinite_angles_have_no_sine():
    out = np.empty((2, 2))
    _sines(np.array([np.nan, np.inf]), out)
    assert np.isnan(out).all()


def test_decayed(rng):
    x = np.concatenate([10.0 ** rng.uniform(-12, 2, 20000), [0.0, 0.5, np.nextafter(0.5, 1)]])
    np.testing.assert_allclose([decayed(v) for v in x], -np.expm1(-x), rtol=2 * EPS)


table = dual_table(3)


@numba.njit
def _of_duals(values, tangents, out, slopes):
    x, y = table(values, tangents), table(out, slopes)
    for i in range(len(values)):
        y[i, 0], y[i, 1] = sincos(x[i, 0])
        y[i, 2] = decayed(abs(x[i, 0]))


def test_derivatives(rng):
    """Of sine, cosine and what has decayed, on either side of where the latter changes its form."""
    values, tangents = np.zeros((50, 3)), np.zeros((50, 3, LANES))
    values[:, 0], tangents[:, 0] = rng.uniform(-2, 2, 50), rng.standard_normal((50, LANES))
    out, slopes = np.empty((50, 3)), np.empty((50, 3, LANES))
    _of_duals(values, tangents, out, slopes)
    x = values[:, 0]
    np.testing.assert_allclose(out, np.column_stack([np.sin(x), np.cos(x), -np.expm1(-abs(x))]), rtol=1e-14)
    expected = np.column_stack([np.cos(x), -np.sin(x), np.sign(x) * np.exp(-abs(x))])
    np.testing.assert_allclose(slopes, expected[..., None] * tangents[:, :1], rtol=1e-13)
