"""The paper's equations as printed: each test shows their effect."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from matrix_filter import FilterModel, run

from flexspline.estimator import FilterDiverged, PaperFilter, get


def test_printed_alpha_diverges_at_zero_load():
    """α = kω² is zero at zero load and f_α = P̄_Y/(α·P_Y) infinite: an exception with the reason, not NaN."""
    y = np.zeros(100)
    y[40:] = 1e-3
    assert np.isfinite(run(PaperFilter(), y).torque).all()
    with pytest.raises(FilterDiverged) as caught:
        run(PaperFilter(name="as printed", alpha="printed"), y, time=0.5 + 1e-3 * np.arange(100))
    error = caught.value
    assert (error.filter, error.step) == ("as printed", 40)
    assert error.time == pytest.approx(0.54)
    for part in ("as printed", "step 40", "0.54 s", "Eq. (23)", "last estimate is 0 N·m"):
        assert part in str(error)
    assert "\n" not in str(error)
    with pytest.raises(FilterDiverged) as caught:
        run(PaperFilter(alpha="printed"), y)
    assert caught.value.time == pytest.approx(0.04)  # at 1 kHz where no time is given


def test_printed_alpha_diverges_on_the_no_load_reference(reference, calibration):
    """The no-load motion starts from rest at zero; as printed the filter diverges at its first torque."""
    torque = reference("no_load")["joint_torque"]
    with pytest.raises(FilterDiverged, match="α = kω²"):
        run(PaperFilter(alpha="printed"), torque)


def test_printed_alpha_works_backwards(rng):
    """It loosens the filter at small loads and equals AREKF at large ones."""
    quiet = 0.3 + 0.02 * rng.standard_normal(2000)
    loaded = 9.0 + 0.02 * rng.standard_normal(2000)
    printed = PaperFilter(alpha="printed")
    assert run(printed, quiet).robust.mean() > 0.9
    assert run(PaperFilter(), quiet).robust.mean() < 0.01
    got = run(printed, loaded)
    assert (got.alpha == 1.0).all()
    np.testing.assert_array_equal(got.torque, run(PaperFilter(rule="arekf"), loaded).torque)


def test_inverse_alpha_is_what_the_figures_show(rng):
    """α = max(1, 1/(kω²)): optimal mode without load, for any innovations; AREKF under load."""
    inverse = PaperFilter(alpha="inverse")
    quiet = run(inverse, np.r_[np.zeros(50), 1e-3 * rng.standard_normal(500)])
    assert np.isfinite(quiet.torque).all() and not quiet.robust.any()
    assert np.isinf(quiet.alpha[1:51]).all() and quiet.alpha.min() == 1.0 == quiet.alpha[0]
    loaded = 9.0 + 0.3 * rng.standard_normal(2000)
    got = run(inverse, loaded)
    assert (got.alpha == 1.0).all()
    np.testing.assert_array_equal(got.torque, run(PaperFilter(rule="arekf"), loaded).torque)
    between = run(inverse, np.full(10, 2.0))
    assert between.alpha[-1] == pytest.approx(1 / (inverse.k * 2.0**2))


def test_printed_memory_forgets():
    """One outlier: carried forward, P̄_Y keeps the filter robust for a while; as printed it is over at once.

    The printed P̄_Y is (ρ·P_Y(k-1) + Ỹ²)/(ρ+1): it restarts at every step from the filter's own P_Y.
    """
    y = np.zeros(60)
    y[30] = 2.0
    y[31:] = 0.3
    source = run(PaperFilter(rule="arekf"), y)
    printed = run(PaperFilter(rule="arekf", memory="printed"), y)
    for got, past in ((source, source.memory), (printed, printed.innovation_covariance)):
        expected = (9.0 * past[:-1] + got.innovation[1:, :, None] ** 2) / 10.0
        np.testing.assert_allclose(got.memory[1:], expected, rtol=1e-13)
    assert source.robust[30]
    assert printed.robust[30]
    assert source.robust.sum() > printed.robust.sum() >= 1


def test_adjusted_covariance_solves_both_equations():
    """P_Y of Eq. (14) contains the Σ that Eq. (19) chooses by it; `adjusted` satisfies both, and adjusts less."""
    y = np.where(np.arange(60) >= 30, 9.0, 0.0)
    got = run(PaperFilter(covariance="adjusted"), y)
    plain = run(PaperFilter(), y)
    on = got.robust
    assert on.any()
    f = got.memory[on, 0, 0] / (got.alpha[on] * got.innovation_covariance[on, 0, 0])
    np.testing.assert_allclose(got.f_alpha[on], f, rtol=1e-12)
    # The switch is at the same place: up to the first robust step both are the same filter.
    first = int(np.argmax(on))
    assert first == int(np.argmax(plain.robust))
    assert 1 < got.f_alpha[first] < plain.f_alpha[first]


def test_gamma_too_small():
    with pytest.raises(FilterDiverged, match=r"γ⁻²LᵀL of Eq. \(18\) is not positive definite") as caught:
        run(PaperFilter(rule="robust", gamma=0.05), np.zeros(10))
    needed = np.sqrt(1e-2 + 1e-4)
    assert f"more than {needed:g} N·m" in str(caught.value)
    assert caught.value.step == 1
    assert np.isfinite(run(PaperFilter(rule="robust", gamma=1.01 * needed), np.zeros(10)).torque).all()


@pytest.mark.parametrize("L", [1.0, 3.0])
def test_slightly_more_than_the_reported_gamma_is_enough(L, known, signals):
    """At the step that failed, over measurements and in the estimator alike."""
    settings = PaperFilter(rule="robust", gamma=0.01, L=L)
    torque = get("model").estimate(signals, known).mean
    for estimate in (lambda one: run(one, torque), lambda one: one.estimate(signals, known)):
        with pytest.raises(FilterDiverged, match="at step 1,") as caught:
            estimate(settings)
        asked = float(re.search(r"expected more than ([\d.e-]+) N·m", str(caught.value)).group(1))
        for share, step in ((0.99, 1), (1.01, 2)):
            try:
                estimate(replace(settings, gamma=share * asked))
                reached = len(torque)
            except FilterDiverged as wrong:
                reached = wrong.step
            assert reached == 1 if step == 1 else reached > 1, (L, share)


def test_overflow_ends_in_the_exception():
    """Extreme numbers, in every rule: the exception or finite estimates, never NaN."""
    y = np.array([0.0, 1.0, 1e200, -1e300, 0.0])
    for rule in ("ekf", "robust", "arekf", "rarekf"):
        with pytest.raises(FilterDiverged, match="diverged at step"):
            run(PaperFilter(rule=rule), y)


def test_unstable_model_ends_in_the_exception():
    model = FilterModel([[1e200]], [[1.0]], [[1.0]], [[1.0]], [[1.0]])
    with pytest.raises(FilterDiverged):
        run(PaperFilter(rule="ekf"), np.ones(30), model=model)


def test_unobserved_state_grows_without_bound(rng):
    """Σ = f_α·P inflates unobserved directions, too: a limit of the method, reported and not NaN."""
    model = FilterModel(np.eye(2), [[1.0, 0.0]], 0.01 * np.eye(2), [[1.0]], [[1.0, 0.5], [0.5, 1.0]])
    y = 3.0 * rng.standard_normal(5000)
    assert np.isfinite(run(PaperFilter(rule="ekf"), y, model=model, initial_state=np.zeros(2)).x).all()
    with pytest.raises(FilterDiverged, match=r"grown without bound|not finite"):
        run(PaperFilter(rule="arekf"), y, model=model, initial_state=np.zeros(2))
