"""Every filter against a closed form or a library."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from filterpy.kalman import KalmanFilter
from matrix_filter import FilterModel, run
from paper_compliance import compliance
from scipy.optimize import minimize
from scipy.signal import butter, lfilter

from flexspline.estimator import FilterDiverged, PaperFilter, get
from flexspline.estimator.compliance import torque_variance
from flexspline.estimator.filters.kalman import STATE, correct_huber
from flexspline.models import laws
from flexspline.models.causes.base import put_discrepancy
from flexspline.models.signals import Signals


def of(time, motor, link, current) -> Signals:
    """Signals with a command that is the current."""
    columns = {"motor_position": motor, "link_position": link, "motor_current": current, "current_command": current}
    return Signals(time, columns)


@pytest.mark.parametrize("name", ["current", "current_smoothed"])
def test_current_at_constant_speed(name, known):
    """N·(Kt·i − (bm + bw)·ω − g(ω)) − bl·ω/N, once transients are over."""
    joint = known.with_numbers(amplitude=0.0)
    w, i, time = 20.0, 1.5, np.arange(1000) * 1e-3
    signals = of(time, w * time, w / 100 * time, np.full(1000, i))
    torque = get(name).estimate(signals, joint).mean[-1]
    q = joint.p
    g = laws.stribeck_friction(w, 0.2, 0.0, 1.0, 25.0, q)
    expected = q["N"] * (q["Kt"] * i - (q["bm"] + q["bw"]) * w - g) - q["bl"] * w / q["N"]
    assert torque == pytest.approx(expected, abs=1e-6)


def test_a_lead_follows_a_ramp_without_lag(known):
    """Of a current that rises evenly: a lag of √2/ω without lead, none with it."""
    joint = known.with_numbers(amplitude=0.0)
    time = np.arange(3000) * 1e-3
    w, slope = 20.0, 0.5
    signals = of(time, w * time, w / 100 * time, slope * time)
    lags = []
    for lead in (0.0, 1.0):
        torque = replace(get("current"), cutoff=5.0, lead=lead).estimate(signals, joint).mean
        at_rest = 100 * joint.p["Kt"] * slope * time
        off = torque - torque[2500] - (at_rest - at_rest[2500])
        assert np.abs(off[2000:]).max() < 1e-6
        friction = 100 * (laws.stribeck_friction(w, 0.2, 0.0, 1.0, 25.0, joint.p) + (joint.p["bm"] + joint.p["bw"]) * w)
        lags.append((at_rest[-1] - friction - joint.p["bl"] * w / 100 - torque[-1]) / (100 * joint.p["Kt"] * slope))
    print("lags [s]", lags)
    assert lags[0] == pytest.approx(np.sqrt(2) / (2 * np.pi * 5.0), rel=0.02) and abs(lags[1]) < 1e-3


def test_compliance_model(known, signals):
    current = np.r_[0.0, signals["current_command"][:-1]]
    expected = compliance(
        signals["motor_position"], signals["link_position"], known.p["Kt"] * current, known.record
    ).torque
    assert np.allclose(get("model").estimate(signals, known).mean, expected, rtol=0, atol=1e-10)


@pytest.mark.parametrize("name, order", [("lowpass", 2), ("lowpass_first_order", 1)])
def test_lowpass(name, order, known, signals):
    """Gain 1/√2 at the cutoff, the closed form of a Butterworth filter; and scipy's direct form on any signal."""
    joint = known.with_numbers(amplitude=0.0)
    time = np.arange(4000) * 1e-3
    at_cutoff = of(time, 0 * time, -1e-4 * np.sin(2 * np.pi * 20 * time), 0 * time)
    torque = replace(get(name), cutoff=20.0).estimate(at_cutoff, joint).mean[-1000:]
    assert np.sqrt(2 * np.mean(torque**2)) == pytest.approx(joint.p["K1"] * 1e-4 / np.sqrt(2), rel=1e-6)

    raw = get("model").estimate(signals, known).mean
    b, a = butter(order, 30.0, fs=1000.0)
    expected = lfilter(b, a, raw - raw[0]) + raw[0]
    assert np.allclose(get(name).estimate(signals, known).mean, expected, atol=1e-10)


def linear_model(signals, known, q):
    """F, H, W, V, P0 of the constant-rate model at 1 kHz, and the measurement."""
    y, V = get("model").estimate(signals, known).mean, torque_variance(known)
    h = 1e-3
    F = np.array([[1, h], [0, 1]])
    W = q * np.array([[h**3 / 3, h**2 / 2], [h**2 / 2, h]])
    P0 = np.diag([V, float(known.p["T2"]) ** 2])
    return y, FilterModel(F, np.array([[1.0, 0.0]]), W, np.array([[V]]), P0)


def states(found):
    """Torque and its rate, shape (n, 2)."""
    return np.column_stack([found.mean, found.columns["torque_rate"]])


def test_kalman_against_filterpy(known, signals):
    estimator = get("kalman")
    y, model = linear_model(signals, known, (estimator.acceleration * known.p["T2"]) ** 2)
    f = KalmanFilter(2, 1)
    f.x, f.P, f.F, f.H, f.Q, f.R = np.array([y[0], 0.0]), model.P0.copy(), model.F, model.H, model.W, model.V
    ours = estimator.estimate(signals, known)
    for k in range(1, len(y)):
        f.predict()
        f.update(y[k])
        assert np.allclose(states(ours)[k], f.x, rtol=1e-10, atol=1e-10)
        assert ours.variance[k] == pytest.approx(f.P[0, 0], rel=1e-9)
        assert ours.innovation_covariance[k, 0, 0] == pytest.approx(f.S[0, 0], rel=1e-9)


@pytest.mark.parametrize(
    "name, neutral", [("h_infinity", {"gamma": 1e9}), ("huber", {"k": 1e9}), ("strong_tracking", {"soften": 1e12})]
)
def test_neutral_tuning_gives_the_kalman_filter(name, neutral, known, signals):
    estimator = replace(get(name), acceleration=10.0, **neutral)
    kalman = replace(get("kalman"), acceleration=10.0).estimate(signals, known)
    ours = estimator.estimate(signals, known)
    assert np.allclose(ours.mean, kalman.mean, atol=1e-9)
    assert np.allclose(ours.variance, kalman.variance, rtol=1e-9)


def test_h_infinity_is_equation_18(known, signals):
    """Simon's form and the paper's Eq. (18) are one recursion on the same model, if both exist."""
    estimator = get("h_infinity")
    y, model = linear_model(signals, known, (estimator.acceleration * known.p["T2"]) ** 2)
    gamma = estimator.gamma * np.sqrt(model.V[0, 0])
    paper = FilterModel(model.F, model.H, model.W, model.V, model.P0, L=np.diag([1.0, 0.0]))
    history = run(PaperFilter(rule="robust", gamma=gamma), y, model=paper, initial_state=np.array([y[0], 0.0]))
    ours = estimator.estimate(signals, known)
    assert np.allclose(ours.mean, history.torque, atol=1e-9)
    assert np.allclose(ours.innovation_covariance[1:], history.innovation_covariance[1:], rtol=1e-9)
    with pytest.raises(FilterDiverged, match="γ is too small"):
        replace(estimator, gamma=0.5).estimate(signals, known)


def test_strong_tracking_against_its_equations(known, signals):
    estimator = replace(get("strong_tracking"), soften=1.0)
    y, m = linear_model(signals, known, (estimator.acceleration * known.p["T2"]) ** 2)
    x, P, V0, faded = np.array([y[0], 0.0]), m.P0.copy(), None, 0
    ours = estimator.estimate(signals, known)
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
        assert np.allclose(states(ours)[k], x, rtol=1e-8, atol=1e-8)
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
        f = np.array([(x[0], x[1], P[0, 0], P[0, 1], P[1, 1])], STATE)
        correct_huber(f[0], y - x[0], V, k, 1e-12, 500)
        ours = np.array([f["torque"][0], f["torque_rate"][0]])
        assert cost(ours) <= cost(best) + 1e-9
        assert np.allclose(ours, best, atol=1e-4)


@pytest.mark.parametrize("e", [0.1, -2.0, 9.0])
def test_hubers_covariance_is_that_of_the_weighted_regression(e, rng):
    """The inverse of A⁻ᵀ diag(ψ₀, 1) A⁻¹ + ψ HᵀH/V with the weights min(1, k/|r|) of the solution's own residuals."""
    A = rng.standard_normal((2, 2))
    P, V, k, H = A @ A.T + np.eye(2), 0.5, 1.345, np.array([1.0, 0.0])
    f = np.array([(0.3, -0.2, P[0, 0], P[0, 1], P[1, 1])], STATE)
    S = correct_huber(f[0], e, V, k, 1e-13, 1000)
    moved = np.array([f["torque"][0] - 0.3, f["torque_rate"][0] + 0.2])
    factor = np.linalg.inv(np.linalg.cholesky(P))
    inside, measured = factor @ moved, (e - moved[0]) / np.sqrt(V)
    weights = np.minimum(1.0, k / np.maximum(np.abs(inside), 1e-300))
    weight = min(1.0, k / abs(measured))
    information = factor.T @ np.diag(weights) @ factor + weight * np.outer(H, H) / V
    after = np.array([[f["P00"][0], f["P01"][0]], [f["P01"][0], f["P11"][0]]])
    assert np.allclose(after, np.linalg.inv(information), rtol=1e-6)
    prior = np.linalg.inv(factor.T @ np.diag(weights) @ factor)
    assert pytest.approx(prior[0, 0] + V / weight, rel=1e-6) == S


def test_momentum_observer(known):
    """A joint without friction under constant current and push: first-order lags with the closed form 1 − exp(−K t);
    the external torque is De Luca's residual of the joint as one rigid body."""
    none = dict.fromkeys(("Fc", "Fs", "bm", "bw", "bl", "Mg", "amplitude", "s1"), 0.0)
    joint = known.with_numbers(**none, s0=1e-9)
    q = joint.p
    N, J = q["N"], q["Jl"] + q["N"] ** 2 * (q["Jm"] + q["Jw"])
    i, push, h = 0.5, 3.0, 1e-4
    a = (N * q["Kt"] * i + push) / J  # both bodies as one
    time = np.arange(5000) * h
    link = 0.5 * a * time**2
    signals = of(time, N * link, link, np.full(5000, i))
    estimator = replace(get("momentum"), bandwidth=5.0, cutoff=1e5)
    ours = estimator.estimate(signals, joint)
    lag = 1.0 - np.exp(-2 * np.pi * 5.0 * time)
    assert np.allclose(ours.mean, (q["Jl"] * a - push) * lag, atol=0.02)
    assert np.allclose(ours.external, push * lag, atol=0.02)

    rng = np.random.default_rng(3)  # any motion
    link = link + np.cumsum(np.cumsum(rng.standard_normal(5000))) * 1e-10
    ours = estimator.estimate(of(time, N * link, link, np.full(5000, i)), joint)
    v, K, total, residual = ours.columns["link_velocity"], 2 * np.pi * 5.0, 0.0, np.zeros(5000)
    for k in range(1, 5000):
        total += h * N * q["Kt"] * i
        residual[k] = K * (J * v[k] - total) / (1 + K * h)
        total += h * residual[k]
    assert np.allclose(ours.external, residual, atol=1e-3)


@pytest.mark.parametrize("name", ["momentum", "momentum_torsion", "current", "current_smoothed"])
def test_power_passes_the_gear_with_any_kinematic_error(name, known):
    """Without friction and inertia what the current puts in comes out: Kt·i·ωm = T·ωl, ωl where the torsion is that of no torque.
    A kinematic error by which the ratio goes up and down by a fifth, passed slowly."""
    none = dict.fromkeys(("Fc", "Fs", "bm", "bw", "bl", "Mg", "s1", "Jl", "Jm", "Jw"), 0.0)
    amplitude = np.zeros(8)
    amplitude[0] = 0.2 / (known.p["N"] * known.p["order"][0])
    joint = known.with_numbers(**none, s0=1e-9, amplitude=amplitude, Kw0=1e9)
    time, w, i = np.arange(4000) * 1e-3, 2.0, 0.4
    motor = w * time
    torsion = compliance(motor, motor / joint.p["N"], 0 * time, joint.record).flexspline_torsion
    link = motor / joint.p["N"] + torsion  # turned on by what seemed torsion: none is left
    settings = {"cutoff": 1e4} if name == "current" else {"bandwidth": 200.0, "cutoff": 1e4}
    estimator = replace(get(name), **settings) if name != "current_smoothed" else get(name)
    found = estimator.estimate(of(time, motor, link, np.full(4000, i)), joint)
    torque = found.columns.get("joint_torque_observed", found.mean)
    inside = slice(500, 3500)
    ratio = np.gradient(link, time)[inside] / w
    assert np.ptp(ratio) * joint.p["N"] > 0.35
    np.testing.assert_allclose(torque[inside], joint.p["Kt"] * i / ratio, rtol=0.01)


def test_momentum_torsion_follows_torsion_at_rest(known):
    """At rest a change of torsion is a change of torque, for any current."""
    time = np.arange(2000) * 1e-3
    link = np.where(time > 1.0, -1e-4, 0.0)
    ours = get("momentum_torsion").estimate(of(time, 0 * time, link, 0 * time), known).mean
    assert ours[-1] - ours[900] == pytest.approx(known.p["K1"] * 1e-4, rel=1e-6)


@pytest.mark.parametrize("name", ["momentum", "momentum_torsion"])
def test_momentum_takes_friction_off(name, known):
    """At constant speed N·(Kt·i − (bm + bw)·ω − g(ω)) − bl·ω/N, and no external torque beyond the gravity error."""
    joint = known.with_numbers(amplitude=0.0)
    q, time = joint.p, np.arange(3000) * 1e-3
    for w in (20.0, -20.0):
        i = 1.5 * np.sign(w)
        signals = of(time, w * time, w / 100 * time, np.full(3000, i))
        found = get(name).estimate(signals, joint)
        g = np.sign(w) * laws.stribeck_friction(w, 0.2, 0.0, 1.0, 25.0, q)
        expected = q["N"] * (q["Kt"] * i - (q["bm"] + q["bw"]) * w - g) - q["bl"] * w / q["N"]
        assert found.columns["joint_torque_observed"][-1] == pytest.approx(expected, abs=1e-3)
        late = time > 1.0
        short = q["Mg"] * np.sin(w / 100 * time) - expected
        lag = 1 / (2 * np.pi * 20.0) * q["Mg"] * abs(w) / 100
        assert np.abs(found.external + found.mean - expected - short)[late].max() < 1.1 * lag + 0.01


def test_momentum_observers_velocity_has_the_stated_cutoff(known):
    """A step of the rotor's velocity: 1 − exp(−2π f t), f the cutoff."""
    time, w, cutoff = np.arange(1, 400) * 1e-3, 30.0, 8.0
    motor = w * (time - time[0])
    columns = replace(get("momentum"), cutoff=cutoff).estimate(of(time, motor, motor / 100, 0 * time), known).columns
    expected = 1.0 - np.exp(-2 * np.pi * cutoff * (time - time[0]))
    assert np.allclose(columns["motor_velocity"], w * expected, rtol=0, atol=1e-9)
    assert np.allclose(columns["link_velocity"], w / 100 * expected, rtol=0, atol=1e-9)


@pytest.mark.parametrize("speed", [0.5, 1.0, 4.0])
def test_momentum_torsion_goes_over_to_the_observer(speed, known):
    """At an even speed, in Stribeck velocities: the observer's weight settles on ω²/(ω² + ω₀²) with the stated time constant."""
    joint = known.with_numbers(amplitude=0.0)
    time, w, smoothing = np.arange(1500) * 1e-3, speed * joint.p["vs"], 0.15
    signals = of(time, w * time, w * time / 100 - 1e-4, np.full(1500, 0.8))
    settings = {"turning": 1.0, "smoothing": smoothing, "follow": 1e12, "cutoff": 1e6}
    found = replace(get("momentum_torsion"), **settings).estimate(signals, joint)
    torsion, observed = get("model").estimate(signals, joint).mean, found.columns["joint_torque_observed"]
    apart = (np.abs(observed - torsion) > 0.5) & (time > 0.01)
    weight = ((found.mean - torsion) / (observed - torsion))[apart]
    expected = speed**2 / (speed**2 + 1.0) * (1.0 - np.exp(-time / smoothing))
    assert apart.sum() > 1000
    assert np.allclose(weight, expected[apart], rtol=0, atol=1e-6)


def test_momentum_torsions_offset_follows_while_it_turns(known):
    """In motion, the torsion's offset follows the observer, more slowly at a smaller weight; at rest it is constant."""
    joint = known.with_numbers(amplitude=0.0)
    time, w, follow = np.arange(4000) * 1e-3, joint.p["vs"], 0.4
    turning = np.minimum(time, 2.5)
    signals = of(time, w * turning, w * turning / 100 - 1e-4, np.full(4000, 0.8))
    settings = {"turning": 1.0, "smoothing": 1e-6, "bandwidth": 100.0, "cutoff": 1e6, "follow": follow}
    found = replace(get("momentum_torsion"), **settings).estimate(signals, joint)
    torsion, observed = get("model").estimate(signals, joint).mean, found.columns["joint_torque_observed"]
    steady = (time > 0.5) & (time < 2.5)
    off = 2.0 * (found.mean - 0.5 * observed) - torsion  # both count half
    away = observed - torsion - off
    rate = -np.diff(np.log(np.abs(away[steady][:500]))) / 1e-3
    assert np.allclose(rate, 0.5 / follow, rtol=1e-3)
    assert np.ptp(found.mean[time > 2.6] - torsion[time > 2.6]) < 1e-9  # the motor's current says nothing of rest
    assert found.mean[-1] - torsion[-1] == pytest.approx(off[steady][-1], abs=0.02)


def with_a_payload(joint) -> tuple[Signals, np.ndarray, np.ndarray]:
    """Signals of a joint that moves a rigid payload, its torque in the current; joint torque and the payload's [N·m]."""
    q = joint.p
    N, J = q["N"], q["Jm"] + q["Jw"]
    time = np.arange(8000) * 1e-3
    link = 0.9 * np.sin(0.8 * time) + 0.3 * np.sin(2.1 * time)
    v = 0.72 * np.cos(0.8 * time) + 0.63 * np.cos(2.1 * time)
    a = -0.576 * np.sin(0.8 * time) - 1.323 * np.sin(2.1 * time)
    payload = -4.0 * np.sin(link) + 1.5 * np.cos(link) - 0.2 * a
    torque = q["Jl"] * a + q["Mg"] * np.sin(link) - payload
    w = N * v
    g = np.array([laws.stribeck_friction(x, 0.0, 0.0, 0.0, 25.0, q) for x in w])
    current = ((torque + q["bl"] * v) / N + J * N * a + (q["bm"] + q["bw"]) * w + g * np.tanh(w)) / q["Kt"]
    signals = Signals(time, {"motor_position": N * link, "link_position": link, "motor_current": current})
    return signals, torque, payload


def test_observers_find_a_payload(known):
    """A rigid payload that moves with the joint, its torque in the current: its moments, for any weight of the link."""
    joint = known.with_numbers(amplitude=0.0)
    signals, torque, payload = with_a_payload(joint)
    late = signals.time > 4.0
    for name in ("payload", "payload_smoothed"):
        found = get(name).estimate(signals, joint)
        error = np.sqrt(np.mean((found.external - payload)[late] ** 2) / np.mean(payload[late] ** 2))
        print(name, [round(found.columns[c][-1], 3) for c in ("payload_sin", "payload_cos", "payload_inertia")], error)
        assert error < 0.25
        assert np.allclose((found.mean + found.external)[late], (torque + payload)[late], atol=0.1)


@pytest.mark.parametrize("place", ["motor_current", "rotor"])
@pytest.mark.parametrize("name", ["current", "current_smoothed", "momentum", "payload_smoothed"])
def test_discrepancies_over_the_load_are_corrected(name, place, known):
    """A current sensor that reads 30 mA more for every newton metre, or a rotor that gets 2 mN·m more: known as a model
    discrepancy in the load, estimates are those of a joint without, though a fifth of the current is wrong."""
    joint = known.with_numbers(amplitude=0.0)
    signals, torque, _ = with_a_payload(joint)
    load = torque + joint.p["bl"] * np.gradient(signals["link_position"], signals.time)
    per = {"motor_current": 0.03, "rotor": 2e-3}[place]
    wrong = per * load if place == "motor_current" else -per * load / joint.p["Kt"]
    spoiled = signals.with_columns(motor_current=signals["motor_current"] + wrong)
    aware = joint.with_numbers()
    put_discrepancy(
        aware.p, place, "load", -40.0, 40.0, per * 40.0 * np.arange(-2.0, 3.0)
    )  # a straight line, its ends beyond
    late = slice(2000, 7500)
    estimator = get(name)
    expected, found, blind = (
        estimator.estimate(s, j).mean[late] for s, j in ((signals, joint), (spoiled, aware), (spoiled, joint))
    )
    off, without = (np.sqrt(np.mean((x - expected) ** 2)) for x in (found, blind))
    print(f"{name}, {place}: {off:.4f} N·m, unknown {without:.3f} N·m")
    assert off < 0.05 * without
