"""The smoother: exact where it should not change anything, and correct for irregular time."""

import numpy as np
import pytest
from scipy.interpolate import BPoly

from flexspline.models.motion import smooth


@pytest.mark.parametrize("irregular", [False, True])
def test_slow_motion_comes_back_with_its_derivatives(irregular):
    rng = np.random.default_rng(1)
    time = np.cumsum(rng.choice([2e-3, 4e-3, 8e-3], 2000)) if irregular else 1e-3 * np.arange(4000)
    s = smooth(time, np.sin(3 * time)[:, None], 1e-3)
    inside = (s.time > time[0] + 0.2) & (s.time < time[-1] - 0.2)
    t = s.time[inside]
    np.testing.assert_allclose(s.value[inside, 0], np.sin(3 * t), atol=1e-5)
    np.testing.assert_allclose(s.rate[inside, 0], 3 * np.cos(3 * t), atol=1e-3)
    np.testing.assert_allclose(s.acceleration[inside, 0], -9 * np.sin(3 * t), atol=0.05)


def least_rough(time: np.ndarray, y: np.ndarray, cutoff: float) -> BPoly:
    """The spline that minimises Σ (y − s)² + λ ∫ (s''')² dt with a passband 1 / (1 + (f/fc)⁶), λ = 1 / (h·(2π·fc)⁶) at a median
    interval h: by least squares over value and derivatives at every sample, with the quintics' jerk at Gauss' points."""
    n, unit = len(time), 1.0 / (2 * np.pi * cutoff)
    t = (time - time[0]) / unit
    rough = np.sqrt(1.0 / np.median(np.diff(t)))
    nodes, weights = np.polynomial.legendre.leggauss(3)
    rows, values = [], []
    for i in range(n):
        rows.append(np.eye(3 * n)[3 * i])
        values.append(y[i])
    for i, d in enumerate(np.diff(t)):
        powers = np.arange(6)
        ends = [
            [np.prod(powers[k] - np.arange(m)) * (u ** (k - m) if k >= m else 0.0) for k in powers]
            for u in (0.0, d)
            for m in range(3)
        ]
        jerks = [
            [k * (k - 1) * (k - 2) * (u ** (k - 3) if k > 2 else 0.0) for k in powers] for u in d * (1 + nodes) / 2
        ]
        of_ends = np.array(jerks) @ np.linalg.inv(np.array(ends, dtype=float))
        for weight, jerk in zip(weights, of_ends, strict=True):
            row = np.zeros(3 * n)
            row[3 * i : 3 * i + 6] = rough * np.sqrt(weight * d / 2) * jerk
            rows.append(row)
            values.append(0.0)
    knots = np.linalg.lstsq(np.array(rows), np.array(values), rcond=None)[0].reshape(n, 3)
    return BPoly.from_derivatives(time, knots / unit ** np.arange(3))


@pytest.mark.parametrize("irregular", [False, True])
@pytest.mark.parametrize("cutoff", [40.0, 1e3])
def test_it_is_the_spline_of_least_roughness(irregular, cutoff, rng):
    """At and between samples, with both derivatives, from the first sample to the last; at most half of Nyquist's frequency."""
    time = 3.0 + (np.cumsum(rng.uniform(1e-3, 5e-3, 60)) if irregular else 3e-3 * np.arange(60))
    y = rng.standard_normal((60, 2)).cumsum(axis=0)
    s = smooth(time, y, 7e-4, cutoff)
    for j in range(2):
        spline = least_rough(time, y[:, j], min(cutoff, 0.25 / np.median(np.diff(time))))
        for found, m in ((s.value, 0), (s.rate, 1), (s.acceleration, 2)):
            expected = spline(s.time, m) if m == 0 else spline.derivative(m)(s.time)
            np.testing.assert_allclose(found[:, j], expected, rtol=0, atol=2e-4 * np.abs(expected).max())


@pytest.mark.parametrize("step", [1e-3, 2e-2])
def test_a_recording_may_begin_in_motion(step):
    """Of a motion without jerk the smoother changes nothing, from the first sample to the last."""
    time = step * np.arange(2000)
    s = smooth(time, (0.3 + 2.0 * time + 1.5 * time**2)[:, None], step)
    np.testing.assert_allclose(s.value[:, 0], 0.3 + 2.0 * s.time + 1.5 * s.time**2, rtol=1e-4)
    np.testing.assert_allclose(s.rate[:, 0], 2.0 + 3.0 * s.time, rtol=1e-3)
    np.testing.assert_allclose(s.acceleration[:, 0], 3.0, rtol=0.02)


def test_rate_and_acceleration_are_derivatives_between_samples_too(rng):
    """For any signal, on a grid far finer than its samples: by differences of the integrals."""
    time = np.cumsum(rng.uniform(0.01, 0.03, 200))
    s = smooth(time, rng.standard_normal((200, 1)), 1e-4)
    for of, derivative in ((s.value, s.rate), (s.rate, s.acceleration)):
        by_differences = (of[2:, 0] - of[:-2, 0]) / 2e-4
        np.testing.assert_allclose(derivative[1:-1, 0], by_differences, atol=2e-3 * np.abs(derivative).max())


def test_counts_of_an_encoder_average_out_in_motion():
    time = 1e-3 * np.arange(5000)
    count = 2 * np.pi / 4096
    angle = 30 * time + np.sin(time)
    s = smooth(time, (np.round(angle / count) * count)[:, None], 1e-3)
    error = s.value[200:-200, 0] - angle[200 : len(s.time) - 200]
    assert np.std(error) < 0.6 * count / np.sqrt(12)


def test_the_smoother_is_linear_and_the_same_for_every_channel():
    rng = np.random.default_rng(2)
    time = np.cumsum(rng.uniform(3e-3, 5e-3, 500))
    a, b = rng.standard_normal((2, 500))
    together = smooth(time, np.column_stack([a, b, 2 * a - 3 * b]), 1e-3).value
    np.testing.assert_allclose(together[:, 2], 2 * together[:, 0] - 3 * together[:, 1], atol=1e-8)


@pytest.mark.parametrize("irregular", [False, True])
def test_blocks_and_other_channels_change_no_bit(irregular):
    rng = np.random.default_rng(3)
    for n in (2, 3, 100, 1003):
        time = 50.0 + (np.cumsum(rng.uniform(2e-4, 2e-3, n)) if irregular else 1e-3 * np.arange(n))
        y = 5.0 + rng.standard_normal((n, 2))
        whole = smooth(time, y, 1e-3, 40.0)
        for block in (1, 2, 7, 64):
            for name in ("time", "value", "rate", "acceleration"):
                cut = getattr(smooth(time, y, 1e-3, 40.0, block=block), name)
                assert np.array_equal(cut, getattr(whole, name)), (n, block, name)
        alone = smooth(time, y[:, 1:], 1e-3, 40.0, every=3)
        assert np.array_equal(alone.time, whole.time[::3])
        assert np.array_equal(alone.acceleration[:, 0], whole.acceleration[::3, 1])


def test_derivatives_of_the_first_channels_only_are_the_same():
    rng = np.random.default_rng(4)
    time, channels = 1e-3 * np.arange(300), rng.standard_normal((300, 3))
    every, first = smooth(time, channels, 1e-3), smooth(time, channels, 1e-3, moving=2)
    assert first.value.tobytes() == every.value.tobytes() and first.rate.shape == (300, 2)
    assert np.array_equal(first.rate, every.rate[:, :2])
    assert np.array_equal(first.acceleration, every.acceleration[:, :2])
