"""Meaning of readings: a low-pass with derivatives, and the past of a sample."""

from __future__ import annotations

import numpy as np
import pytest

from flexspline.estimator.external import lowpassed
from flexspline.estimator.sensing import RING, line_in_ring, place_in_ring


def ring(times: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Samples from the first on, each at its number modulo the ring's length."""
    held = np.zeros(RING), np.zeros(RING)
    for k, both in enumerate(zip(times, values, strict=True)):
        held[0][k % RING], held[1][k % RING] = both
    return held


@pytest.mark.parametrize("newest", [1, 7, RING - 1, RING, 3 * RING + 100])
def test_an_instant_lies_between_its_neighbours(rng, newest):
    times = 5.0 + np.cumsum(rng.uniform(5e-4, 2e-3, newest + 1))
    values = rng.standard_normal(newest + 1)
    held = slice(max(newest - RING + 1, 0), None)
    of_times, of_values = ring(times, values)
    for then in rng.uniform(times[held][0] - 3e-3, times[-1] + 3e-3, 50):
        a, b, share = place_in_ring(of_times, newest, then)
        assert 0.0 <= share <= 1.0
        found = of_values[a] + share * (of_values[b] - of_values[a])
        assert found == pytest.approx(np.interp(then, times[held], values[held]), abs=1e-9)


def test_an_instant_at_a_sample_is_that_sample(rng):
    times, values = ring(np.arange(20) * 1e-3, rng.standard_normal(20))
    for k in range(20):
        a, b, share = place_in_ring(times, 19, times[k])
        assert values[a] + share * (values[b] - values[a]) == values[k]


@pytest.mark.parametrize("newest", [4, 30, RING + 40])
@pytest.mark.parametrize("window", [1e-4, 0.02, 9.0])
def test_a_line_through_the_last_samples_is_that_of_least_squares(rng, newest, window):
    times = 5.0 + np.cumsum(rng.uniform(5e-4, 2e-3, newest + 1))
    values = 3.0 * times + 0.1 * rng.standard_normal(newest + 1)
    last = times >= times[-1] - window
    last[-5:], last[:-RING] = True, False  # no more than the ring holds
    at = times[-1] + 2e-3
    _, offset = np.polyfit(times[last] - at, values[last], 1)
    assert last.sum() == 5 or window > 1e-3
    assert line_in_ring(*ring(times, values), newest, window, at) == pytest.approx(offset, rel=1e-9)


def test_a_line_of_few_samples_is_the_last():
    times, values = ring(np.arange(4) * 1e-3, np.array([1.0, 2.0, 3.0, 5.0]))
    assert line_in_ring(times, values, 3, 1.0, 0.1) == 5.0


def test_the_low_pass_knows_its_derivatives():
    """A second-order Butterworth low-pass of ωc: at ω = ωc half the power passes, a quarter of a turn late."""
    cutoff, step = 5.0, 1e-5
    time = np.arange(200_000) * step
    w = 2 * np.pi * cutoff
    value, rate, acceleration = lowpassed(time, np.cos(w * time), cutoff).T
    late = time > 1.0
    expected = np.sqrt(0.5) * np.exp(1j * (w * time - np.pi / 2))
    np.testing.assert_allclose(value[late], expected.real[late], atol=1e-3)
    np.testing.assert_allclose(rate[late], (1j * w * expected).real[late], atol=1e-3 * w)
    np.testing.assert_allclose(acceleration[late], (-(w**2) * expected).real[late], atol=1e-3 * w**2)
    assert (value[0], rate[0], acceleration[0]) == (1.0, 0.0, 0.0), "it starts at rest where the signal is"
