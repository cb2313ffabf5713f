"""The measures on signals whose delay, response, noise and error are known."""

from __future__ import annotations

import numpy as np
import pytest

from flexspline.estimator.estimator import Posterior
from flexspline.scenarios.evaluation import metrics

DT = 1e-3
T = np.arange(0, 20, DT)


def lagged(signal, ticks):
    return np.concatenate([np.full(ticks, signal[0]), signal[: len(signal) - ticks]])


def test_errors():
    truth = np.sin(T)
    kept = T >= 10
    estimate = truth + np.where(T < 10, 5.0, 0.1)
    reading = truth - 0.1
    got = metrics.errors(estimate, truth, reading, kept)
    assert got == pytest.approx({"rms": 0.1, "max": 0.1, "rms_to_sensor": 0.2})


@pytest.mark.parametrize("ticks", [0, 3, 10, 40])
def test_delay_of_whole_samples(ticks):
    truth = 3 * np.sin(2 * np.pi * 0.7 * T) + np.sin(2 * np.pi * 2.1 * T)
    got = metrics.delay(lagged(truth, ticks), truth, DT, T > 1)
    assert got == pytest.approx(ticks * DT, abs=2e-5)


def test_delay_between_samples_and_under_noise(rng):
    truth = 3 * np.sin(2 * np.pi * 0.7 * T)
    late = 3 * np.sin(2 * np.pi * 0.7 * (T - 0.0074))
    assert metrics.delay(late, truth, DT, T > 1) == pytest.approx(0.0074, abs=2e-5)
    noisy = late + 0.05 * rng.standard_normal(len(T))
    assert metrics.delay(noisy, truth, DT, T > 1) == pytest.approx(0.0074, abs=5e-4)


def test_delay_of_a_first_order_filter():
    """1/(τs + 1) delays what is slower than τ by τ."""
    truth = 3 * np.sin(2 * np.pi * 0.5 * T)
    out, state, tau = np.zeros_like(truth), 0.0, 0.010
    for k, x in enumerate(truth):
        state += (1 - np.exp(-DT / tau)) * (x - state)
        out[k] = state
    assert metrics.delay(out, truth, DT, T > 1) == pytest.approx(tau, abs=1e-3)


def test_no_delay_without_change():
    assert metrics.delay(np.ones_like(T), np.ones_like(T), DT, T > 1) is None
    assert metrics.delay(np.sin(T), np.sin(T), DT, T > 100) is None


def test_noise_is_what_is_fast(rng):
    truth = np.full_like(T, 2.0)
    drifting = truth + 0.5 * np.sin(2 * np.pi * 0.05 * T)
    kept = metrics.steady(truth, DT, T >= 1)
    assert kept.mean() > 0.9
    got = metrics.noise(drifting + 0.04 * rng.standard_normal(len(T)), truth, DT, kept)
    assert got == pytest.approx(0.04, rel=0.03)
    assert np.isnan(metrics.noise(truth, truth, DT, np.zeros_like(kept)))


def test_steady_leaves_motion_out():
    truth = np.where(T < 10, 0.0, np.minimum(2 * (T - 10), 6.0))  # 2 N·m/s from 10 s to 13 s
    calm = metrics.steady(truth, DT, T >= 1)
    assert calm[(T > 2) & (T < 9)].all() and calm[(T > 14) & (T < 19)].all()
    assert not calm[(T > 10.3) & (T < 12.7)].any()


def test_moving_mean():
    x = np.arange(50.0)
    np.testing.assert_allclose(metrics.moving_mean(x, 11)[5:45], x[5:45])
    np.testing.assert_allclose(metrics.moving_mean(np.ones(50), 11), 1)
    assert metrics.moving_mean(x, 11)[0] == pytest.approx(2.5)


def test_pushes():
    torque = np.zeros(100)
    torque[10:20], torque[30:35], torque[90:] = 3, -2, 1
    assert metrics.pushes(torque, DT) == [(10, 20), (30, 35), (90, 100)]
    assert metrics.pushes(np.zeros(10), DT) == []


def response_time(estimate, truth, dt, events):
    times = metrics.responses(estimate, truth, dt, events)
    return float(np.nanmean(times)) if np.isfinite(times).any() else None


def missed(estimate, truth, dt, events):
    times = metrics.responses(estimate, truth, dt, events)
    return float(np.mean(np.isnan(times))) if len(times) else None


def test_response_time():
    """A push that swings as 4·sin² in 0.4 s: 90 % of the first swing is made as much after the truth as one is late."""
    truth = np.zeros_like(T)
    inside = (T >= 5) & (T < 5.4)
    truth[inside] = 4 * np.sin(np.pi * (T[inside] - 5) / 0.4) ** 2
    events = [(5000, 5400)]
    assert response_time(truth, truth, DT, events) == 0.0
    reached = 0.4 / np.pi * np.arcsin(np.sqrt(0.9))  # s after the onset
    early = np.where(inside, 10.0, 0.0)
    assert response_time(early, truth, DT, events) == pytest.approx(-reached, abs=1.5e-3)
    for ticks in (5, 20):
        got = response_time(lagged(truth, ticks), truth, DT, events)
        assert got == pytest.approx(ticks * DT)
    assert response_time(-truth, truth, DT, events) is None
    assert response_time(truth, truth, DT, []) is None
    assert response_time(-lagged(truth, 7), -truth, DT, events) == pytest.approx(7 * DT)


def test_response_counts_from_ones_own_level():
    """An estimate that is off by a constant is neither early nor late, and a push that is never followed is missed."""
    truth = np.zeros_like(T)
    events = []
    for start in (2.0, 5.0, 8.0):
        inside = (T >= start) & (T < start + 0.4)
        truth[inside] = 4 * np.sin(np.pi * (T[inside] - start) / 0.4) ** 2
        events.append((round(start / DT), round((start + 0.4) / DT)))
    for offset in (-3.0, 1.0, 5.0):
        found = metrics.responses(lagged(truth, 7) + offset, truth, DT, events)
        assert found == pytest.approx(np.full(3, 7 * DT))
    once = np.where(T < 4.0, truth, 0.0)
    found = metrics.responses(once, truth, DT, events)
    assert found[0] == 0.0 and np.isnan(found[1:]).all()
    assert response_time(once, truth, DT, events) == 0.0
    assert missed(once, truth, DT, events) == pytest.approx(2 / 3)
    assert missed(truth, truth, DT, events) == 0.0 and missed(truth, truth, DT, []) is None


def test_evaluate_puts_it_together(rng):
    truth = 3 * np.sin(2 * np.pi * 0.05 * T)
    external = np.zeros_like(T)
    raw = truth + 0.08 * rng.standard_normal(len(T))
    estimate = truth + 0.02 * rng.standard_normal(len(T))
    reference = metrics.Reference(truth, truth, raw, external, DT, 1.0)
    got = reference.evaluate(estimate)
    assert set(got) == {"rms", "max", "rms_to_sensor", "noise", "noise_ratio", "delay_ms", "response_ms", "missed"}
    assert got["rms"] == pytest.approx(0.02, rel=0.05)
    assert got["noise_ratio"] == pytest.approx(0.25, rel=0.1)
    assert got["response_ms"] is None
    assert got["delay_ms"] == pytest.approx(0, abs=1.0)
    nothing = reference.evaluate_posterior(Posterior("plain", T, estimate))
    assert nothing == got | {"robust_share": None, "mean_nis": None, "untrusted": 0.0}
    S = np.full((len(T), 1, 1), 4.0)
    all_of_it = Posterior("full", T, estimate, None, np.full((len(T), 1), 6.0), S, T < 10.5)
    assert reference.evaluate_posterior(all_of_it) == got | {
        "robust_share": pytest.approx(0.5), "mean_nis": 9.0, "untrusted": 0.0,
    }  # fmt: skip
