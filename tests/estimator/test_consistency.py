"""Consistency of filters: a matched one passes, mismatched ones fail in the right direction."""

from __future__ import annotations

import numpy as np
import pytest
from matrix_filter import FilterModel, run
from scipy.stats import chi2

from flexspline.estimator import PaperFilter, consistency
from flexspline.models.errors import InputError

F = np.array([[1.0, 0.1], [0.0, 0.95]])
H = np.array([[1.0, 0.0]])
W, V = np.diag([1e-3, 2e-3]), np.array([[0.05]])


def monte_carlo(rng, process: float = 1.0, runs: int = 40, steps: int = 400):
    """NIS (runs, steps), NEES (runs, steps), normalised innovations of a filter that believes `process` times W."""
    model = FilterModel(F, H, process * W, V, np.eye(2))
    nis, nees, innovations = [], [], []
    for _ in range(runs):
        x, states = rng.standard_normal(2), []
        start = x + rng.standard_normal(2)
        for _ in range(steps):
            states.append(x)
            x = F @ x + np.sqrt(np.diag(W)) * rng.standard_normal(2)
        states = np.array(states)
        y = states[:, 0] + np.sqrt(V[0, 0]) * rng.standard_normal(steps)
        h = run(PaperFilter(rule="ekf"), y, model=model, initial_state=start)
        nis.append(consistency.normalised_squares(h.innovation[1:], h.innovation_covariance[1:]))
        nees.append(consistency.normalised_squares(h.x - states, h.P))
        innovations.append(h.innovation[1:, 0] / np.sqrt(h.innovation_covariance[1:, 0, 0]))
        np.testing.assert_allclose(nis[-1], h.nis[1:], rtol=1e-9, atol=1e-12)
    return np.array(nis), np.array(nees), np.array(innovations)


def test_a_matched_filter_passes(rng):
    nis, nees, innovations = monte_carlo(rng)
    mean = consistency.mean_consistency(nis, 1, level=0.999)
    print(mean)
    assert mean.verdict == "consistent" and mean.samples == nis.size
    assert consistency.mean_consistency(nees[:, ::40], 2, level=0.999).verdict == "consistent"
    # 400 times, correlated over about ten: the share scatters by about √(0.05·0.95·10/400).
    assert abs(consistency.share_inside(nees, 2) - 0.95) < 3.5 * np.sqrt(0.05 * 0.95 * 10 / 400)
    rho = np.array([consistency.autocorrelation(v, 20) for v in innovations])
    band = consistency.white_band(innovations.shape[1])
    outside = np.mean(np.abs(rho) > band)
    print("outside", outside)
    assert abs(outside - 0.05) < 4 * np.sqrt(0.05 * 0.95 / rho.size)
    p = np.array([consistency.ljung_box(r, innovations.shape[1]) for r in rho])
    assert 0.3 < p.mean() < 0.7 and p.min() > 1e-5


@pytest.mark.parametrize("runs, times, dof", [(5, 8000, 1), (60, 4000, 3)])
def test_the_share_inside_is_the_intervals_level(runs, times, dof, rng):
    """Of means over so many runs, at each of so many independent times."""
    for level in (0.95, 0.6):
        share = consistency.share_inside(chi2.rvs(dof, size=(runs, times), random_state=rng), dof, level)
        assert abs(share - level) < 4 * np.sqrt(level * (1 - level) / times)


@pytest.mark.parametrize("process, verdict", [(0.02, "overconfident"), (50.0, "conservative")])
def test_a_mismatched_filter_fails_in_the_right_direction(process, verdict, rng):
    nis, nees, innovations = monte_carlo(rng, process)
    assert consistency.mean_consistency(nis, 1).verdict == verdict
    assert consistency.mean_consistency(nees[:, ::40], 2).verdict == verdict
    assert consistency.share_inside(nees, 2) < 0.7
    rho = np.mean([consistency.autocorrelation(v, 20) for v in innovations], axis=0)
    band = consistency.white_band(innovations.size)
    # A slow filter lags, its innovations keep their sign; a fast one overshoots, they change it.
    assert (rho[0] > 3 * band) == (verdict == "overconfident") and (rho[0] < -3 * band) == (verdict == "conservative")
    assert np.mean([consistency.ljung_box(consistency.autocorrelation(v, 20), 399) for v in innovations]) < 0.05


def test_intervals_are_chi_squares():
    low, high = consistency.chi_square_interval(2, 50)
    assert (100 * low, 100 * high) == pytest.approx(chi2.interval(0.95, 100))
    assert consistency.white_band(10000) == pytest.approx(0.0196, rel=1e-3)


def test_autocorrelation_against_its_sum(rng):
    v = rng.standard_normal(500) + 0.3
    expected = [np.sum(v[l:] * v[:-l]) / np.sum(v * v) for l in (1, 2, 7)]
    assert consistency.autocorrelation(v, 7)[[0, 1, 6]] == pytest.approx(expected, abs=1e-12)
    assert consistency.autocorrelation(v, 1) == pytest.approx(expected[:1], abs=1e-12)
    assert (consistency.autocorrelation(np.zeros(9), 3) == 0).all()
    with pytest.raises(InputError, match="more than 500"):
        consistency.autocorrelation(v, 500)
    with pytest.raises(InputError, match="covariances"):
        consistency.normalised_squares(np.zeros((3, 2)), np.zeros((3, 2)))
