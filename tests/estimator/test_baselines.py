"""The estimators to compare with: each against a closed form or a library."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest
from filterpy.kalman import KalmanFilter
from flexspline.estimator.baselines import JointSignals, SensorNoise, huber
from flexspline.estimator.baselines.compliance_model import compliance_measurement
from scipy.optimize import minimize
from scipy.signal import butter, lfilter

from flexspline.estimator import FilterDiverged, FilterModel, FilterSettings, baselines, compliance, run
from flexspline.models import laws
from flexspline.models.errors import InputError
from flexspline.models.joint import load_joint

TORQUE_FILTERS = ("kalman", "h_infinity", "strong_tracking", "huber")
NOISE = SensorNoise()


@pytest.fixture(scope="module")
def record() -> np.ndarray:
    joint = load_joint("test-joint")
    return joint.record(joint.mount("link"))


@pytest.fixture(scope="module")
def signals() -> JointSignals:
    """Two seconds of something that turns, loads and stops; quantised and noisy. Not a joint's, but a joint's size."""
    rng = np.random.default_rng(5)
    time = np.arange(2000) * 1e-3
    motor = 4.0 * np.sin(2.0 * np.minimum(time, 1.2))
    link = motor / 100 - 4e-4 * np.sin(5 * time) - 3e-4 * (time > 1.5)
    current = 0.5 * np.sin(5 * time) + 0.3
    return JointSignals(
        time,
        np.round(motor / NOISE.motor_resolution) * NOISE.motor_resolution,
        link + 2e-6 * rng.standard_normal(2000),
        current + 0.01 * rng.standard_normal(2000),
        current,
    )


def test_registry_and_errors(record, signals):
    assert {"motor_current", "compliance_model", "lowpass", *TORQUE_FILTERS} <= set(baselines.names())
    assert {"momentum", "momentum_torsion", "dynamics_ekf", "dynamics_ukf", "rts_smoother"} <= set(baselines.names())
    assert all(baselines.get(name).name == name for name in baselines.names())
    with pytest.raises(InputError, match="did you mean 'kalman'"):
        baselines.get("kalmann")
    with pytest.raises(InputError, match="motor_position"):
        JointSignals(signals.time, signals.motor_position[:-1], signals.link_position, signals.motor_current)
    with pytest.raises(InputError, match="record"):
        baselines.get("motor_current").estimate(signals, np.zeros(1), NOISE)
    with pytest.raises(InputError, match="cutoff"):
        replace(baselines.get("lowpass"), cutoff=900.0).estimate(signals, record, NOISE)


def test_no_estimator_can_read_a_torque():
    assert {f.name for f in fields(JointSignals)} == {
        "time", "motor_position", "link_position", "motor_current", "current_command",
    }  # fmt: skip


@pytest.mark.parametrize("name", baselines.names())
def test_finite_and_causal(name, record, signals):
    """What comes later changes nothing, where an estimator says so; it runs with and without the current command."""
    estimator = baselines.get(name)
    whole = estimator.estimate(signals, record, NOISE)
    assert whole.torque.shape == (2000,) and np.isfinite(whole.torque).all()
    part = JointSignals(*(getattr(signals, f.name)[:1400] for f in fields(signals)))
    short = estimator.estimate(part, record, NOISE)
    same = np.array_equal(short.torque, whole.torque[:1400])
    assert same == estimator.causal
    blind = estimator.estimate(replace(signals, current_command=None), record, NOISE)
    assert np.isfinite(blind.torque).all()


def test_torque_is_what_the_sensor_would_read(record, signals):
    """Gain, offset and drift of the torque sensor are part of every estimate."""
    for name in baselines.names():
        gain = 1.0 if name in TORQUE_FILTERS else 1.02  # these are not linear in their measurement
        sensed = record.copy()
        sensed["torque_gain"], sensed["torque_offset"], sensed["torque_rate"] = gain, 0.3, 0.1
        plain = baselines.get(name).estimate(signals, record, NOISE).torque
        read = baselines.get(name).estimate(signals, sensed, NOISE).torque
        tolerance = 0.02 if name in TORQUE_FILTERS or name.startswith("lowpass") else 1e-9
        assert np.allclose(read[300:], (gain * plain + 0.3 + 0.1 * signals.time)[300:], atol=tolerance), name


def test_motor_current_at_constant_speed(record):
    """N·(Kt·i − (bm + bw)·ω − g(ω)) − bl·ω/N, once transients are over."""
    p = record.copy()
    p["amplitude"] = 0.0
    w, i, time = 20.0, 1.5, np.arange(1000) * 1e-3
    signals = JointSignals(time, w * time, w / 100 * time, np.full(1000, i), np.full(1000, i))
    torque = baselines.get("motor_current").estimate(signals, p, NOISE).torque[-1]
    q = p[0]
    g = laws.friction_level(w, 0.2, 0.0, 1.0, q)
    expected = q["N"] * (q["Kt"] * i - (q["bm"] + q["bw"]) * w - g) - q["bl"] * w / q["N"]
    assert torque == pytest.approx(expected, abs=1e-6)


def test_compliance_model(record, signals):
    current = np.r_[signals.motor_current[0], signals.current_command[:-1]]
    expected = compliance(signals.motor_position, signals.link_position, record[0]["Kt"] * current, record).torque
    assert np.array_equal(baselines.get("compliance_model").estimate(signals, record, NOISE).torque, expected)


@pytest.mark.parametrize("name, order", [("lowpass", 2), ("lowpass_first_order", 1)])
def test_lowpass(name, order, record, signals):
    """Gain 1/√2 at the cutoff, the closed form of a Butterworth filter; and scipy's direct form on any signal."""
    p = record.copy()
    p["amplitude"] = 0.0
    time = np.arange(4000) * 1e-3
    at_cutoff = JointSignals(time, 0 * time, -1e-4 * np.sin(2 * np.pi * 20 * time), 0 * time, 0 * time)
    torque = replace(baselines.get(name), cutoff=20.0).estimate(at_cutoff, p, NOISE).torque[-1000:]
    assert np.sqrt(2 * np.mean(torque**2)) == pytest.approx(p[0]["K1"] * 1e-4 / np.sqrt(2), rel=1e-6)

    raw, _ = compliance_measurement(signals, record, NOISE)
    b, a = butter(order, 30.0, fs=1000.0)
    expected = lfilter(b, a, raw - raw[0]) + raw[0]
    assert np.allclose(baselines.get(name).estimate(signals, record, NOISE).torque, expected, atol=1e-10)


def linear_model(signals, record, q):
    """F, H, W, V, P0 of the constant-rate model at 1 kHz, and the measurement."""
    y, V = compliance_measurement(signals, record, NOISE)
    h = 1e-3
    F = np.array([[1, h], [0, 1]])
    W = q * np.array([[h**3 / 3, h**2 / 2], [h**2 / 2, h]])
    P0 = np.diag([V, float(record[0]["T2"]) ** 2])
    return y, FilterModel(F, np.array([[1.0, 0.0]]), W, np.array([[V]]), P0)


def test_kalman_against_filterpy(record, signals):
    estimator = baselines.get("kalman")
    y, model = linear_model(signals, record, (estimator.acceleration * record[0]["T2"]) ** 2)
    f = KalmanFilter(2, 1)
    f.x, f.P, f.F, f.H, f.Q, f.R = np.array([y[0], 0.0]), model.P0.copy(), model.F, model.H, model.W, model.V
    ours = estimator.estimate(signals, record, NOISE)
    for k in range(1, len(y)):
        f.predict()
        f.update(y[k])
        assert np.allclose(ours.states[k], f.x, rtol=1e-10, atol=1e-10)
        assert ours.variance[k] == pytest.approx(f.P[0, 0], rel=1e-9)
        assert ours.innovation_covariance[k, 0, 0] == pytest.approx(f.S[0, 0], rel=1e-9)


@pytest.mark.parametrize(
    "name, neutral", [("h_infinity", {"gamma": 1e9}), ("huber", {"k": 1e9}), ("strong_tracking", {"soften": 1e12})]
)
def test_neutral_knobs_give_the_kalman_filter(name, neutral, record, signals):
    estimator = replace(baselines.get(name), acceleration=10.0, **neutral)
    kalman = replace(baselines.get("kalman"), acceleration=10.0).estimate(signals, record, NOISE)
    ours = estimator.estimate(signals, record, NOISE)
    assert np.allclose(ours.torque, kalman.torque, atol=1e-9)
    assert np.allclose(ours.variance, kalman.variance, rtol=1e-9)


def test_h_infinity_is_equation_18(record, signals):
    """Simon's form and the paper's Eq. (18) are one recursion on the same model, wherever both exist."""
    estimator = baselines.get("h_infinity")
    y, model = linear_model(signals, record, (estimator.acceleration * record[0]["T2"]) ** 2)
    gamma = estimator.gamma * np.sqrt(model.V[0, 0])
    paper = FilterModel(model.F, model.H, model.W, model.V, model.P0, L=np.diag([1.0, 0.0]))
    history = run(FilterSettings(rule="robust", gamma=gamma), y, model=paper, initial_state=np.array([y[0], 0.0]))
    ours = estimator.estimate(signals, record, NOISE)
    assert np.allclose(ours.torque, history.torque, atol=1e-9)
    assert np.allclose(ours.innovation_covariance[1:], history.innovation_covariance[1:], rtol=1e-9)
    with pytest.raises(FilterDiverged, match="γ is too small"):
        replace(estimator, gamma=0.5).estimate(signals, record, NOISE)


def test_strong_tracking_against_its_equations(record, signals):
    estimator = replace(baselines.get("strong_tracking"), soften=1.0)
    y, m = linear_model(signals, record, (estimator.acceleration * record[0]["T2"]) ** 2)
    x, P, V0, faded = np.array([y[0], 0.0]), m.P0.copy(), None, 0
    ours = estimator.estimate(signals, record, NOISE)
    for k in range(1, len(y)):
        x = m.F @ x
        e = y[k] - m.H @ x
        V0 = np.outer(e, e) if V0 is None else (0.95 * V0 + np.outer(e, e)) / 1.95
        propagated = m.F @ P @ m.F.T
        fade = np.trace(V0 - m.H @ m.W @ m.H.T - m.V) / np.trace(m.H @ propagated @ m.H.T)
        faded += fade > 1
        P = max(1.0, fade) * propagated + m.W
        K = P @ m.H.T @ np.linalg.inv(m.H @ P @ m.H.T + m.V)
        x, P = x + K @ e, (np.eye(2) - K @ m.H) @ P
        assert np.allclose(ours.states[k], x, rtol=1e-8, atol=1e-8)
    assert faded > 20


def test_huber_minimises_hubers_cost():
    rng = np.random.default_rng(2)
    for e in (0.1, -2.0, 9.0):
        A = rng.standard_normal((2, 2))
        P, V, x = A @ A.T + np.eye(2), 0.5, rng.standard_normal(2)
        y, k = x[0] + e, 1.345
        factor = np.linalg.inv(np.linalg.cholesky(P))

        def cost(s, x=x, y=y, V=V, k=k, factor=factor):
            r = np.abs(np.append(factor @ (s - x), (y - s[0]) / np.sqrt(V)))
            return np.sum(np.where(r <= k, 0.5 * r**2, k * r - 0.5 * k**2))

        best = minimize(cost, x, method="Nelder-Mead", options={"xatol": 1e-9, "fatol": 1e-14, "maxiter": 4000}).x
        ours, covariance = x.copy(), P.copy()
        huber.correct(ours, covariance, y, V, k, 1e-12, 500)
        assert cost(ours) <= cost(best) + 1e-9
        assert np.allclose(ours, best, atol=1e-4)


def test_momentum_observer(record):
    """A joint without friction under constant current and push: first-order lags with the closed form 1 − exp(−K t);
    the external torque is De Luca's residual of the joint as one rigid body."""
    p = record.copy()
    for name in ("Fc", "Fs", "bm", "bw", "bl", "Mg", "amplitude"):
        p[name] = 0.0
    p["s1"] = 0.0
    p["s0"] = 1e-9
    q = p[0]
    N, J = q["N"], q["Jl"] + q["N"] ** 2 * (q["Jm"] + q["Jw"])
    i, push, h = 0.5, 3.0, 1e-4
    a = (N * q["Kt"] * i + push) / J  # both bodies as one
    time = np.arange(5000) * h
    link = 0.5 * a * time**2
    signals = JointSignals(time, N * link, link, np.full(5000, i), np.full(5000, i))
    estimator = replace(baselines.get("momentum"), bandwidth=5.0, cutoff=1e5)
    ours = estimator.estimate(signals, p, NOISE)
    lag = 1.0 - np.exp(-2 * np.pi * 5.0 * time)
    assert np.allclose(ours.torque, (q["Jl"] * a - push) * lag, atol=0.02)
    assert np.allclose(ours.states[:, 1], push * lag, atol=0.02)

    rng = np.random.default_rng(3)  # any motion
    link = link + np.cumsum(np.cumsum(rng.standard_normal(5000))) * 1e-10
    ours = estimator.estimate(
        JointSignals(time, N * link, link, signals.motor_current, signals.current_command), p, NOISE
    )
    v, K, total, residual = ours.states[:, 3], 2 * np.pi * 5.0, 0.0, np.zeros(5000)
    for k in range(1, 5000):
        total += h * N * q["Kt"] * i
        residual[k] = K * (J * v[k] - total) / (1 + K * h)
        total += h * residual[k]
    assert np.allclose(ours.states[:, 1], residual, atol=1e-3)


def test_momentum_torsion_follows_torsion_at_rest(record):
    """At rest a change of torsion is a change of torque, whatever the current says."""
    time = np.arange(2000) * 1e-3
    link = np.where(time > 1.0, -1e-4, 0.0)
    signals = JointSignals(time, 0 * time, link, 0 * time, 0 * time)
    ours = baselines.get("momentum_torsion").estimate(signals, record, NOISE).torque
    assert ours[-1] - ours[900] == pytest.approx(record[0]["K1"] * 1e-4, rel=1e-6)
