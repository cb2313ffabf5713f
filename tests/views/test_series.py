"""An envelope keeps ends, peaks, gaps and given samples; a moving share is defined up to the ends."""

from __future__ import annotations

import numpy as np
import pytest

from flexspline.views.series import envelope, extremes, share


def test_an_envelope_keeps_ends_peaks_and_given_samples(rng):
    values = rng.normal(size=50_003)
    values[31_234] = 50.0
    values[7] = -50.0
    values[50_001] = 60.0  # in the last, shorter column
    keep = np.zeros(len(values), dtype=bool)
    keep[1000:1100] = True
    i = envelope(values, 1000, keep)
    assert np.all(np.diff(i) > 0)
    assert {0, 7, 31_234, 50_001, 50_002} <= set(i)
    assert np.isin(np.arange(1000, 1100), i).all()
    assert len(i) <= 2200


def test_no_spike_of_any_column_vanishes(rng):
    values = rng.normal(size=8000)
    drawn = values[envelope(values, 100)]
    for column in range(100):
        part = values[80 * column : 80 * (column + 1)]
        assert part.min() in drawn and part.max() in drawn


def test_a_short_series_is_left_alone():
    assert np.array_equal(envelope(np.arange(10.0), 32), np.arange(10))


@pytest.mark.parametrize("gap", [slice(300, 400), slice(701, 702), slice(9_990, 10_000)])
def test_a_gap_stays_a_gap(gap):
    values = np.sin(np.arange(10_000.0))
    values[gap] = np.nan
    i = envelope(values, 100)
    assert np.isnan(values[i]).any()
    inside = (i >= gap.start) & (i < gap.stop)
    assert np.isnan(values[i[inside]]).all() and inside.any()
    assert np.nanmax(values[i]) == np.nanmax(values)


def test_extremes_are_of_every_column(rng):
    values = rng.normal(size=1003)
    middle, low, high = extremes(values, 100)
    assert len(middle) == len(low) == len(high) == 92  # columns of 11 samples
    assert low.min() == values.min() and high.max() == values.max()
    assert np.all((low <= values[middle]) & (values[middle] <= high))


def test_share_of_constant_flags_is_constant_to_the_ends():
    assert np.allclose(share(np.ones(50, dtype=bool), 11), 1.0)
    assert np.allclose(share(np.zeros(50, dtype=bool), 11), 0.0)
    assert np.isclose(share(np.arange(1000) % 4 == 0, 400)[500], 0.25, atol=0.01)


@pytest.mark.parametrize("samples", [1, 8, 9, 500])
def test_share_is_the_mean_of_the_window(rng, samples):
    flags = rng.random(200) < 0.3
    expected = [flags[max(k - samples // 2, 0) : k + (samples + 1) // 2].mean() for k in range(200)]
    if samples <= 200:
        np.testing.assert_allclose(share(flags, samples), expected, atol=1e-12)
    assert np.all((share(flags, samples) >= -1e-12) & (share(flags, samples) <= 1 + 1e-12))
