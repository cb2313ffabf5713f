"""One recursion, Eqs. (10)-(25): against an independent Kalman filter, and its gain rules against the formulas."""

from __future__ import annotations

import numpy as np
import pytest
from filterpy.kalman import ExtendedKalmanFilter, KalmanFilter
from matrix_filter import FilterModel, run, run_extended

from flexspline.estimator import (
    FilterDiverged,
    KnownJoint,
    PaperFilter,
    get,
    recursion,
)
from flexspline.models.joint import load_joint
from flexspline.models.signals import Signals

RULES = ("ekf", "robust", "arekf", "rarekf")


def covariance(rng, size, scale=1.0):
    A = rng.standard_normal((size, size))
    return scale * (A @ A.T + 0.5 * np.eye(size))


def random_model(rng, n, m):
    F = np.eye(n) + 0.1 * rng.standard_normal((n, n))
    F /= max(1.0, np.abs(np.linalg.eigvals(F)).max())
    return FilterModel(
        F,
        rng.standard_normal((m, n)),
        covariance(rng, n, 0.01),
        covariance(rng, m, 0.1),
        covariance(rng, n),
    )


def square_root(A):
    values, vectors = np.linalg.eigh(A)
    return vectors @ np.diag(np.sqrt(values)) @ vectors.T


@pytest.mark.parametrize(("n", "m"), [(1, 1), (3, 2), (2, 3), (4, 1)])
def test_ekf_is_the_kalman_filter(rng, n, m):
    model = random_model(rng, n, m)
    x0, y = rng.standard_normal(n), rng.standard_normal((300, m))
    ours = run(PaperFilter(rule="ekf"), y, model=model, initial_state=x0)

    theirs = KalmanFilter(dim_x=n, dim_z=m)
    theirs.x, theirs.P = x0[:, None].copy(), model.P0.copy()
    theirs.F, theirs.H, theirs.Q, theirs.R = model.F, model.H, model.W, model.V
    for t in range(1, len(y)):
        theirs.predict()
        theirs.update(y[t][:, None])
        np.testing.assert_allclose(ours.x[t], theirs.x[:, 0], rtol=0, atol=1e-10)
        np.testing.assert_allclose(ours.P[t], theirs.P, rtol=0, atol=1e-10)
        np.testing.assert_allclose(ours.innovation[t], theirs.y[:, 0], rtol=0, atol=1e-10)
        np.testing.assert_allclose(ours.innovation_covariance[t], theirs.S, rtol=0, atol=1e-10)
        z = theirs.y[:, 0]
        assert ours.nis[t] == pytest.approx(z @ np.linalg.solve(theirs.S, z), abs=1e-10)
    assert not ours.robust.any()
    assert (ours.f_alpha == 1.0).all()


def test_nonlinear_ekf_against_filterpy(rng):
    """A pendulum seen through its sine: f and h nonlinear, through the same compiled update."""
    h = 0.01

    def transition(k, x):
        f = np.array([x[0] + h * x[1], x[1] - h * 9.81 * np.sin(x[0])])
        return f, np.array([[1.0, h], [-h * 9.81 * np.cos(x[0]), 1.0]])

    def observation(k, x):
        return np.array([np.sin(x[0])]), np.array([[np.cos(x[0]), 0.0]])

    model = FilterModel(np.eye(2), np.ones((1, 2)), 1e-4 * np.eye(2), np.array([[0.01]]), np.eye(2))
    x0 = np.array([0.6, 0.0])
    y = np.sin(0.5 * np.cos(3.1 * h * np.arange(400))) + 0.1 * rng.standard_normal(400)
    ours = run_extended(PaperFilter(rule="ekf"), model, y, transition, observation, x0)

    theirs = ExtendedKalmanFilter(dim_x=2, dim_z=1)
    theirs.x, theirs.P, theirs.Q, theirs.R = x0[:, None].copy(), np.eye(2), model.W, model.V
    for t in range(1, len(y)):
        x, theirs.F = transition(t, theirs.x[:, 0])
        theirs.P = theirs.F @ theirs.P @ theirs.F.T + theirs.Q
        theirs.x = x[:, None]
        theirs.update(
            np.array([[y[t]]]),
            lambda x: observation(0, x[:, 0])[1],
            lambda x: observation(0, x[:, 0])[0][:, None],
        )
        np.testing.assert_allclose(ours.x[t], theirs.x[:, 0], rtol=0, atol=1e-10)
        np.testing.assert_allclose(ours.P[t], theirs.P, rtol=0, atol=1e-10)


def test_extended_with_linear_functions_is_the_linear_filter(rng):
    model = random_model(rng, 3, 2)
    x0, y = rng.standard_normal(3), rng.standard_normal((50, 2))
    settings = PaperFilter(rule="rarekf", k=1.0)
    linear = run(settings, y, model=model, initial_state=x0)
    extended = run_extended(
        settings, model, y, lambda k, x: (model.F @ x, model.F), lambda k, x: (model.H @ x, model.H), x0
    )
    np.testing.assert_allclose(extended.x, linear.x, rtol=0, atol=1e-12)
    np.testing.assert_array_equal(extended.robust, linear.robust)


def written_out(settings, y, W, V, P0):
    """The one-state filters as joint.md states them, without a matrix: an independent second reading."""
    x, P, memory = y[0], P0, 0.0
    rows = [(x, P, memory, 1.0, 1.0)]
    for value in y[1:]:
        P = P + W
        P_Y = P + V
        innovation = value - x
        memory = (settings.rho * memory + innovation**2) / (settings.rho + 1)
        alpha = max(1.0, settings.k * x**2) if settings.rule == "rarekf" else 1.0
        f = memory / (alpha * P_Y) if settings.rule != "ekf" and memory > alpha * P_Y else 1.0
        sigma = f * P
        x = x + sigma / (sigma + V) * innovation
        P = 1 / (1 / sigma + 1 / V)  # Eq. (17)
        rows.append((x, P, memory, alpha, f))
    return np.array(rows).T


@pytest.mark.parametrize("rule", ["ekf", "arekf", "rarekf"])
def test_one_state_collapses(rng, rule):
    """With one state robust mode is Σ = f_α·P, f_α = P̄_Y/(α·P_Y), and the posterior that of Eq. (17)."""
    y = np.where(np.arange(600) > 300, 9.0, 0.0) + 0.07 * rng.standard_normal(600)
    settings = PaperFilter(rule=rule)
    got = run(settings, y)
    x, P, memory, alpha, f = written_out(settings, y, settings.W, settings.V, settings.P0)
    np.testing.assert_allclose(got.torque, x, rtol=1e-12)
    np.testing.assert_allclose(got.P[:, 0, 0], P, rtol=1e-10)
    np.testing.assert_allclose(got.memory[:, 0, 0], memory, rtol=1e-9, atol=1e-18)
    np.testing.assert_allclose(got.alpha, alpha, rtol=1e-12)
    np.testing.assert_allclose(got.f_alpha, f, rtol=1e-9)
    np.testing.assert_array_equal(got.robust, f > 1)
    if rule != "ekf":
        assert got.robust[301]
        assert got.f_alpha.max() > 2
    sigma = got.f_alpha[1:] * (got.P[:-1, 0, 0] + settings.W)
    np.testing.assert_allclose(got.innovation_covariance[1:, 0, 0], sigma + settings.V, rtol=1e-12)


@pytest.mark.parametrize(("n", "m"), [(1, 1), (3, 2)])
def test_robust_mode_is_equation_19_with_21_24_25(rng, n, m):
    """Build L of Eq. (21) from the compensation of Eq. (24), put it into Eq. (19): Σ, and with it x and P, agree."""
    model = random_model(rng, n, m)
    y = 3.0 * rng.standard_normal((40, m))
    settings = PaperFilter(rule="rarekf", k=0.5, gamma=2.0)
    got = run(settings, y, model=model, initial_state=np.zeros(n))
    assert got.robust.any()
    assert not got.robust[1:].all()
    for t in range(1, len(y)):
        P = model.F @ got.P[t - 1] @ model.F.T + model.W
        P_Y = model.H @ P @ model.H.T + model.V
        np.testing.assert_allclose(got.unadjusted_covariance[t], P_Y, rtol=1e-9, atol=1e-12)
        alpha = max(1.0, settings.k * got.x[t - 1, 0] ** 2)
        f = np.trace(got.memory[t]) / (alpha * np.trace(P_Y))
        assert got.robust[t] == (f > 1)
        sigma = P
        if f > 1:
            assert got.f_alpha[t] == pytest.approx(f, rel=1e-12)
            L = settings.gamma * square_root(np.linalg.inv(P) - np.linalg.inv(P) / f)
            sigma = np.linalg.inv(np.linalg.inv(P) - settings.gamma**-2 * L.T @ L)
        information = np.linalg.inv(np.linalg.inv(sigma) + model.H.T @ np.linalg.inv(model.V) @ model.H)  # (17)
        np.testing.assert_allclose(got.P[t], information, rtol=0, atol=1e-10)
        gain = sigma @ model.H.T @ np.linalg.inv(model.H @ sigma @ model.H.T + model.V)
        x = model.F @ got.x[t - 1] + gain @ got.innovation[t]
        np.testing.assert_allclose(got.x[t], x, rtol=0, atol=1e-10)


@pytest.mark.parametrize(("n", "m"), [(1, 1), (3, 2)])
def test_fixed_gamma(rng, n, m):
    """Eq. (18) by its formula; γ = ∞ is the EKF to the bit, a large γ to 1e-12."""
    model = random_model(rng, n, m)
    L = 0.3 * rng.standard_normal((n, n))
    model = FilterModel(model.F, model.H, model.W, model.V, 0.1 * model.P0, L)
    y, x0 = rng.standard_normal((60, m)), np.zeros(n)
    ekf = run(PaperFilter(rule="ekf"), y, model=model, initial_state=x0)
    infinite = run(PaperFilter(rule="robust", gamma=np.inf), y, model=model, initial_state=x0)
    np.testing.assert_array_equal(infinite.x, ekf.x)
    np.testing.assert_array_equal(infinite.P, ekf.P)
    large = run(PaperFilter(rule="robust", gamma=1e8), y, model=model, initial_state=x0)
    np.testing.assert_allclose(large.x, ekf.x, rtol=0, atol=1e-12)
    got = run(PaperFilter(rule="robust", gamma=2.0), y, model=model, initial_state=x0)
    assert np.abs(got.x - ekf.x).max() > 1e-6
    for t in range(1, len(y)):
        P = model.F @ got.P[t - 1] @ model.F.T + model.W
        sigma = np.linalg.inv(np.linalg.inv(P) - 2.0**-2 * L.T @ L)
        P_Y = model.H @ sigma @ model.H.T + model.V
        np.testing.assert_allclose(got.innovation_covariance[t], P_Y, rtol=0, atol=1e-10)
        assert got.f_alpha[t] == pytest.approx(np.trace(sigma) / np.trace(P))


def test_robust_is_faster_after_a_step():
    y = np.where(np.arange(200) >= 100, 5.0, 0.0)
    rise = {}
    for rule in RULES:
        torque = run(PaperFilter(rule=rule), y).torque
        rise[rule] = int(np.argmax(torque[100:] > 4.5))
    print("steps to 90 %:", rise)
    assert rise["arekf"] <= rise["rarekf"] < rise["robust"] <= rise["ekf"]
    assert rise["rarekf"] <= 2 < 10 <= rise["ekf"]


def test_redundancy_keeps_optimal_mode_under_load(rng):
    """Modelling error that grows with load: AREKF goes robust on it, RAREKF tolerates it, both are equal at no load."""
    quiet = 0.05 * rng.standard_normal(3000)
    loaded = 12.0 + 0.15 * rng.standard_normal(3000)
    assert run(PaperFilter(rule="arekf"), loaded).robust.mean() > 0.5
    assert run(PaperFilter(rule="rarekf"), loaded).robust.mean() < 0.01
    arekf, rarekf = (run(PaperFilter(rule=rule), quiet) for rule in ("arekf", "rarekf"))
    np.testing.assert_array_equal(arekf.torque, rarekf.torque)
    assert rarekf.robust.mean() < 0.05


def test_start():
    """X̂(0) = Y(0), P(0) = P0, empty memory."""
    settings = PaperFilter(P0=0.5)
    got = run(settings, [3.0, 3.1])
    assert got.torque[0] == 3.0
    assert got.P[0, 0, 0] == 0.5
    assert got.innovation_covariance[0, 0, 0] == 0.5 + settings.V
    assert got.memory[0, 0, 0] == got.innovation[0, 0] == got.nis[0] == 0.0
    assert got.alpha[0] == got.f_alpha[0] == 1.0
    assert not got.robust[0]


@pytest.mark.parametrize("settings", [
    *(PaperFilter(rule=rule) for rule in RULES), PaperFilter(memory="printed"), PaperFilter(covariance="adjusted"),
    PaperFilter(alpha="inverse"), PaperFilter(rule="robust", L=0.5),
], ids=str)  # fmt: skip
def test_scalar_is_vector(rng, settings):
    """The compiled filter of one state and the matrices of any dimension are one recursion."""
    y = np.where(np.arange(1500) % 700 > 300, 9.0, 0.2) + 0.07 * rng.standard_normal(1500)
    one = np.eye(1)
    model = FilterModel(one, one, settings.W * one, settings.V * one, settings.P0 * one, settings.L * one)
    scalar, vector = run(settings, y), run(settings, y, model=model)
    for field in (
        "x",
        "P",
        "innovation",
        "innovation_covariance",
        "unadjusted_covariance",
        "memory",
        "alpha",
        "f_alpha",
        "nis",
    ):
        np.testing.assert_allclose(
            getattr(scalar, field), getattr(vector, field), rtol=1e-11, atol=1e-15, err_msg=field
        )
    np.testing.assert_array_equal(scalar.robust, vector.robust)


@pytest.mark.parametrize("rule", RULES)
def test_step_by_address_is_run(rng, rule):
    """The closed loop's step gives `run`'s results of the compliance model's torque, to the bit."""
    joint = KnownJoint.of(load_joint("test-joint"))
    time = np.arange(2000) * 1e-3
    motor = 4.0 * np.sin(2 * time)
    columns = {
        "motor_position": motor, "link_position": motor / 100 - 4e-4 * (time > 1.0) + 2e-6 * rng.standard_normal(2000),
        "motor_current": 0.3 + 0 * time,
    }  # fmt: skip
    signals = Signals(time, columns)
    ours = PaperFilter(rule=rule).estimate(signals, joint)
    measured = get("model").estimate(signals, joint).mean
    np.testing.assert_array_equal(ours.columns["measurement"], measured)
    history = run(PaperFilter(rule=rule), measured)
    np.testing.assert_array_equal(ours.mean, history.torque)
    np.testing.assert_array_equal(ours.variance, history.P[:, 0, 0])
    np.testing.assert_array_equal(ours.innovation_covariance, history.innovation_covariance)
    np.testing.assert_array_equal(ours.robust, history.robust)
    np.testing.assert_array_equal(ours.columns["alpha"], history.alpha)


def test_surprise_is_the_likelihood_of_the_innovations(rng):
    """Σ log S + e²/S, no sample counting more than `most`; where the filter fails, the sample and why."""
    y = np.cumsum(0.01 * rng.standard_normal(300))
    y[100] += 5.0
    settings = get("EKF")
    found, end, status = recursion.surprise(y, settings.record(), 25.0)
    history = run(settings, y)
    S, e = history.innovation_covariance[:, 0, 0], history.innovation[:, 0]
    assert (end, status) == (300, recursion.OK)
    assert found == pytest.approx(float(np.sum(np.log(S[1:]) + np.minimum(e[1:] ** 2 / S[1:], 25.0))))
    y[50:] = 0.0
    settings = PaperFilter(alpha="printed")
    with pytest.raises(FilterDiverged) as caught:
        run(settings, y)
    _, end, status = recursion.surprise(y, settings.record(), 25.0)
    assert end == caught.value.step and status != recursion.OK


@pytest.mark.parametrize(
    "model", [None, FilterModel(np.eye(2), np.array([[1.0, 0.0]]), np.eye(2), np.eye(1), 2.0 * np.eye(2))]
)
def test_one_measurement_gives_the_start_only(model):
    found = run(
        PaperFilter(), np.array([3.0]), model=model, initial_state=None if model is None else np.array([3.0, 1.0])
    )
    assert found.x.shape == (1, 1 if model is None else 2) and found.torque == [3.0] and found.nis == [0.0]
    assert found.P[0, 0, 0] == (PaperFilter().P0 if model is None else 2.0)
