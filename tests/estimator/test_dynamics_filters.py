"""The estimators that know the joint's dynamics: discretisation, quantised update, consistency, and accuracy."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from filterpy.kalman import KalmanFilter
from scipy.integrate import solve_ivp
from scipy.stats import chi2, truncnorm
from test_symmetry import seen

from flexspline.estimator import KnownJoint, SensorNoise, get, joint_model, quantised
from flexspline.estimator.dynamics_filter import SETTINGS
from flexspline.estimator.estimator import CausalEstimator
from flexspline.estimator.filters import dynamics_kalman
from flexspline.estimator.joint_model import (
    BRISTLE,
    CONSTANT,
    DAHL,
    EXTERNAL,
    LINK,
    LINK_RATE,
    MESH,
    SIZE,
    STIFFNESS,
    WAVE_RATE,
    ProcessNoise,
)  # fmt: skip
from flexspline.models import dynamics, laws
from flexspline.models.joint import load_joint
from flexspline.models.signals import Signals
from flexspline.scenarios.evaluation.draws import varied
from flexspline.scenarios.run import simulate_scenario
from flexspline.scenarios.scenario import load_scenario

SCENARIOS = ("no_load", "link_sweep", "external_push")
REFERENCE = 25.0  # °C


@pytest.fixture(scope="module")
def record() -> np.ndarray:
    joint = load_joint("test-joint")
    return joint.record(joint.mount("link"))


@pytest.mark.parametrize("effects", [
    {}, {"hysteresis_torque": 0.4, "friction_load": 0.1, "backlash": 1e-5}, {"flexible_share": 0.3, "flexible_frequency": 15.0},
])  # fmt: skip
def test_step_against_an_independent_integrator(effects, record):
    """50 ms of sticking and sliding: the compiled step against scipy's Radau on the equations themselves."""
    p = record.copy()
    for name, value in effects.items():
        p[name] = value
    q = p[0]
    x = np.zeros(SIZE)
    x[[0, 2, LINK]] = 0.3, 0.28, 0.0025
    x[[1, 3, LINK_RATE]] = 5.0, 5.0, 0.05
    x[[EXTERNAL, MESH, STIFFNESS, CONSTANT]] = 1.5, 1e-3, 0.02, -0.01

    def rate(t, y):
        out = np.zeros(SIZE)
        current = 1.2 * (1 - np.exp(-t * q["R"] / q["L"]))
        joint_model.rates(y, current, t, REFERENCE, q, out)
        state = joint_model.state_of(y, current, t, REFERENCE)
        between = joint_model.transmission(y, state, q)
        out[BRISTLE] = laws.bristle_rate(y[BRISTLE], y[WAVE_RATE], dynamics.sliding_friction(state, between.load, q), q)
        v = between.torsion_rate
        out[DAHL] = v - abs(v) * y[DAHL] / q["hysteresis_extent"]
        return out

    reference = solve_ivp(rate, (0, 0.05), x, method="Radau", rtol=1e-8, atol=1e-11, max_step=1e-3).y[:, -1]
    errors = []
    for finer in (1, 2, 4):
        ours, work, current = x.copy(), np.zeros((3, SIZE)), 0.0
        for k in range(50):
            steps = finer * joint_model.substeps(ours, 1e-3, q)
            joint_model.advance(ours, current, 1.2, k * 1e-3, 1e-3, steps, REFERENCE, q, work)
            current = joint_model.next_current(current, 1.2, 1e-3, q)
        errors.append(joint_model.joint_torque(ours, 0.05, q) - joint_model.joint_torque(reference, 0.05, q))
    print(f"error of the torque [N·m] at one, two, four times the substeps: {np.round(errors, 5)}")
    assert abs(errors[0]) < 0.01
    assert abs(errors[2]) < 0.4 * abs(errors[0])
    assert np.allclose(ours[[0, 2]], reference[[0, 2]], atol=5e-5) and ours[LINK] == pytest.approx(
        reference[LINK], abs=1e-6
    )


def test_substeps_resolve_the_fastest_spring(record):
    """Eigenvalues of the springs between the bodies at their present stiffness: no mode turns by more than 0.8 rad in a substep,
    and with one substep less it would, or the substep be longer than half a millisecond; ten at most where that fails."""
    soft = record.copy()
    soft["Kw0"], soft["K3"] = 0.05, 3e6
    for q, dt, wound in product((record[0], soft[0]), (1e-4, 1e-3, 4e-3), (0.0, 4e-3, 8e-3)):
        x = np.zeros(SIZE)
        x[0] = wound
        stiff = q["Kw0"] * np.exp(q["Cw"] * abs(laws.wave_generator_spring(wound, q)))
        drive = np.array([[stiff / q["Jm"], -stiff / q["Jm"]], [-stiff / q["Jw"], stiff / q["Jw"]]])
        N = q["N"]
        output = q["K3"] * np.array([[1 / N**2 / q["Jw"], -1 / N / q["Jw"]], [-1 / N / q["Jl"], 1 / q["Jl"]]])
        modes = [np.linalg.eigvals(springs).real.max() for springs in (drive, output)]
        assert (modes[1] > max(modes[0], (0.8 / 0.5e-3) ** 2)) == (q["K3"] == 3e6), "each of them decides once"
        fastest = np.sqrt(max(modes))
        steps = joint_model.substeps(x, dt, q)
        fine = max(dt / 0.5e-3, dt * fastest / 0.8)
        assert fine < 10 * max(1.0, dt / 0.5e-3) and steps == max(1, int(np.ceil(fine * (1 - 1e-9)))), (dt, wound)
    for dt in (1e-4, 1e-3, 4e-3):
        x = np.zeros(SIZE)
        x[0] = 1e3
        assert joint_model.substeps(x, dt, record[0]) == int(10 * max(1.0, dt / 0.5e-3))


def test_both_predictions_agree_before_the_first_link_reading():
    """With a link encoder delay of 4 ms only the prior is known before, propagated by a Jacobian or by sigma points."""
    signals, known = seen("late")
    first = signals.part(slice(0, 12))
    ekf, ukf = (get(name).estimate(first, known) for name in ("dynamics_ekf", "dynamics_ukf"))
    apart = np.abs(np.sqrt(ekf.variance / ukf.variance) - 1.0)
    print(apart.max(), np.abs(ekf.mean - ukf.mean).max())
    assert apart.max() < 0.02 and np.all(np.abs(ekf.mean - ukf.mean) < 0.1 * np.sqrt(ukf.variance))
    assert np.all(ekf.variance[:5] > 0.5 * ekf.variance[0])


@pytest.mark.parametrize("residual, S, q", [(0.3, 1.0, 2.0), (-0.9, 0.01, 2.0), (4.0, 0.5, 3.0), (1e-3, 1e-6, 1e-2)])
def test_moments_of_a_cell(residual, S, q):
    mean, variance = quantised.cell_moments(residual, S, q)
    s = np.sqrt(S)
    exact = truncnorm((residual - q / 2) / s, (residual + q / 2) / s, scale=s)
    assert mean == pytest.approx(exact.mean(), rel=1e-6, abs=1e-9 * s)
    assert variance == pytest.approx(exact.var(), rel=1e-4, abs=1e-6 * S)


def test_moments_far_outside_and_fine():
    """Far outside a cell the mean is at its near edge; a fine cell is its middle with q²/12."""
    for residual in (30.0, -30.0):
        mean, variance = quantised.cell_moments(residual, 1.0, 2.0)
        assert mean == pytest.approx(np.sign(residual) * (29 + 1 / 29), rel=1e-4) and 0 < variance < 2e-3
    assert quantised.cell_moments(0.5, 1.0, 1e-3) == pytest.approx((0.5, 1e-6 / 12), rel=1e-9)


def test_update_without_rounding_is_kalmans():
    rng = np.random.default_rng(1)
    A = rng.standard_normal((3, 3))
    x, P, H = rng.standard_normal(3), A @ A.T, rng.standard_normal(3)
    f = KalmanFilter(3, 1)
    f.x, f.P, f.H, f.R = x.copy(), P.copy(), H[None], np.array([[0.2]])
    f.update(1.3)
    S = quantised.update(x, P, np.arange(3), H, 1.3 - H @ x, 0.2, 0.0, np.zeros(3))
    assert np.allclose(x, f.x) and np.allclose(P, f.P) and S == pytest.approx(f.S[0, 0])


def test_smoother_against_filterpy(record):
    """The smoother's recursion on a linear model of its size."""
    rng = np.random.default_rng(4)
    n, m = 60, SIZE
    F = np.eye(m) + 0.1 * rng.standard_normal((m, m)) / m
    H = rng.standard_normal((2, m))
    f = KalmanFilter(m, 2)
    f.x, f.P, f.F, f.H, f.Q, f.R = (
        0.01 * rng.standard_normal(m),
        1e-4 * np.eye(m),
        F,
        H,
        1e-6 * np.eye(m),
        1e-4 * np.eye(2),
    )
    means, covariances, predicted, before, _, _, _, _ = [
        *f.batch_filter(0.02 * rng.standard_normal((n, 2))),
        *[None] * 4,
    ]
    expected, expected_P, _, _ = f.rts_smoother(means, covariances)
    states, filtered, torque, variance = means.copy(), covariances.copy(), np.zeros(n), np.zeros(n)
    time, Fs = np.arange(n) * 1e-3, np.tile(F, (n, 1, 1))
    settings = np.zeros(1, SETTINGS)
    joint_model.activate(settings[0]["noise"], list(range(m)))
    dynamics_kalman.backward(time, states, record, settings, Fs, predicted, before, filtered, torque, variance)
    assert np.allclose(states, expected, atol=1e-8) and np.allclose(filtered, expected_P, atol=1e-9)


MATCHED = ProcessNoise(push=0.0, mesh_push=0.0, external=0.05, floor=0.0)
EXACT = SensorNoise(motor_resolution=0.0, motor_noise=4e-4, link_resolution=0.0, link_noise=2e-6, current_noise=0.0)


def sample(record: np.ndarray, seed: int, n: int = 2500) -> tuple[Signals, np.ndarray]:
    """Signals of the stochastic model itself, and its joint torque, shape (n,)."""
    rng = np.random.default_rng(seed)
    p = record[0]
    time = np.arange(n) * 1e-3
    command = 1.6 * np.sin(2 * np.pi * 0.7 * time)
    noise = MATCHED.record(KnownJoint(record, EXACT), 1e-3)[0]
    forget = np.exp(-1e-3 / MATCHED.mesh_time)
    x, work, current = np.zeros(SIZE), np.zeros((3, SIZE)), 0.0
    used = np.zeros(SIZE)
    active = noise["active"][: int(noise["count"])].astype(int)
    used[active] = np.sqrt(noise["walk"][active] * 1e-3)
    x[EXTERNAL] = rng.standard_normal()
    motor, link, torque = np.zeros(n), np.zeros(n), np.zeros(n)
    for k in range(n):
        if k > 0:
            steps = joint_model.substeps(x, 1e-3, p)
            joint_model.advance(x, current, command[k - 1], time[k - 1], 1e-3, steps, REFERENCE, p, work)
            x[joint_model.MESH] *= forget
            current = joint_model.next_current(current, command[k - 1], 1e-3, p)
            x += used * rng.standard_normal(SIZE)
        motor[k], link[k], torque[k] = x[0], x[LINK], joint_model.joint_torque(x, time[k], p)
    motor += EXACT.motor_noise * rng.standard_normal(n)
    link += EXACT.link_noise * rng.standard_normal(n)
    columns = {"motor_position": motor, "link_position": link, "motor_current": np.r_[0.0, command[:-1]]}
    return Signals(time, columns), torque


@pytest.mark.parametrize("name, inflation", [("dynamics_ekf", 1.0), ("dynamics_ukf", 1.0)])
def test_consistent_on_data_of_its_own_model(name, inflation, record):
    """NIS and NEES over seeds within the 99.9 % chi-square intervals (Bar-Shalom et al. 2001, section 5.4)."""
    seeds = range(100, 112)
    print("seeds", list(seeds))
    estimator = replace(get(name), process=MATCHED)
    nis, nees = [], []
    for seed in seeds:
        signals, torque = sample(record, seed)
        ours = estimator.estimate(signals, KnownJoint(record, EXACT))
        S = np.diagonal(ours.innovation_covariance, axis1=1, axis2=2)
        nis.append((ours.innovation[500:] ** 2 / S[500:]).sum(axis=1))
        nees.append(((ours.mean - torque) ** 2 / ours.variance)[500::250])  # far enough apart to be independent
    nis, nees = np.array(nis), np.array(nees)
    low, high = chi2.ppf([0.0005, 0.9995], 2 * nis.size) / nis.size
    print(f"{name}: mean NIS {nis.mean():.3f} in [{low:.3f}, {high:.3f}]")
    assert low < nis.mean() < high
    low, high = chi2.ppf([0.0005, 0.9995], nees.size) / nees.size
    print(f"{name}: mean NEES {nees.mean():.3f} in [{low:.3f}, {high:.3f}]")
    assert low < nees.mean() < high


def test_smoother_beats_filter_on_its_own_model(record):
    signals, torque = sample(record, 7)
    errors = {}
    for name in ("dynamics_ekf", "rts_smoother"):
        estimate = replace(get(name), process=MATCHED).estimate(signals, KnownJoint(record, EXACT))
        errors[name] = np.sqrt(np.mean((estimate.mean - torque)[500:] ** 2))
    print(errors)
    assert errors["rts_smoother"] < 0.8 * errors["dynamics_ekf"]


def compare(
    name: str, seed: int, estimators: tuple[str, ...], change: dict[str, float] | None = None, vary: bool = False
):
    """RMS error after the transient of RAREKF and of estimators [N·m]; `vary`: of a draw."""
    scenario, folder = load_scenario(name, seed=seed)
    ran = simulate_scenario(varied(scenario, seed) if vary else scenario, folder, seed)
    record = ran.known.record.copy()
    for field, factor in (change or {}).items():
        record[field] *= factor
    kept, truth = ran.time >= ran.scenario.transient, ran.truth("joint_torque")
    rms = {}
    for estimator in ("RAREKF", *estimators):
        known = ran.known if estimator == "RAREKF" else replace(ran.known, record=record)
        torque = get(estimator).estimate(ran.signals, known).mean
        rms[estimator] = np.sqrt(np.mean((torque - truth)[kept] ** 2))
    return rms


def test_half_of_rarekf_under_pushes():
    rms = compare("external_push", 1, ("dynamics_ekf",))
    print(rms)
    assert rms["dynamics_ekf"] <= 0.5 * rms["RAREKF"]


def test_variance_of_the_torque_at_rest_is_at_least_a_count():
    """The position within the count drifts at rest, and the variance grows: NEES is about 1 or below."""
    changes = ["duration=7", "trajectory=[{time: 0.2, position: 0.8}, {time: 3, position: 1.2}]"]
    scenario, folder = load_scenario("link_sweep", changes)
    nees = []
    for seed in range(1, 5):
        run = simulate_scenario(varied(scenario, seed), folder, seed)
        found = get("dynamics_ekf").estimate(run.signals, run.known)
        rest = run.time > 4.0
        nees.append(float(np.mean((found.mean - run.truth("joint_torque"))[rest] ** 2 / found.variance[rest])))
    print(f"NEES at rest, seeds 1 to 4: {np.round(nees, 2)}")
    assert np.mean(nees) < 1.5


@pytest.mark.slow
@pytest.mark.long
@pytest.mark.parametrize("scenario", SCENARIOS)
def test_half_of_rarekf_everywhere(scenario):
    """In the mean over starts, paces and pushes: the position of a count at rest changes either by a factor of three."""
    seeds = range(1, 7)
    results = [compare(scenario, seed, ("dynamics_ekf",), vary=True) for seed in seeds]
    ratios = [rms["dynamics_ekf"] / rms["RAREKF"] for rms in results]
    print(f"{scenario}, seeds {list(seeds)}: {ratios}")
    assert np.exp(np.mean(np.log(ratios))) <= 0.5


@pytest.mark.fast_every(3)
@pytest.mark.slow
@pytest.mark.parametrize("scenario", SCENARIOS)
def test_friction_error_is_absorbed(scenario):
    """In the mean over draws, as above."""
    seeds = range(1, 5)
    results = [compare(scenario, seed, ("dynamics_ekf",), {"Fc": 1.5, "Fs": 1.5}, vary=True) for seed in seeds]
    ratios = [rms["dynamics_ekf"] / rms["RAREKF"] for rms in results]
    print(f"{scenario}, seeds {list(seeds)}: {ratios}")
    assert np.exp(np.mean(np.log(ratios))) < 1.0


def test_a_delayed_link_encoder_does_not_affect_the_smoother(record):
    """Readings are shifted in time: the same estimate, except for the last samples."""
    signals, _ = sample(record, 9)
    late = signals.with_columns(link_position=np.interp(signals.time - 6e-3, signals.time, signals["link_position"]))
    known = KnownJoint(record, EXACT)
    smoother = replace(get("rts_smoother"), process=MATCHED)
    expected = smoother.estimate(signals, known).mean
    found = smoother.estimate(late, known.with_numbers(link_delay=6e-3)).mean
    assert np.sqrt(np.mean((found - expected)[200:-100] ** 2)) < 0.02
    blind = smoother.estimate(late, known).mean
    assert np.sqrt(np.mean((blind - expected)[200:-100] ** 2)) > 1.0


def test_the_smoother_in_blocks_is_that_of_the_whole(record, monkeypatch):
    (signals, _), known = sample(record, 7, 1500), KnownJoint(record, EXACT)
    smoother = replace(get("rts_smoother"), process=MATCHED)
    whole = smoother.estimate(signals, known)
    n = len(signals.time)
    for block in (n, n - 1, 333):
        monkeypatch.setattr("flexspline.estimator.filters.dynamics_kalman.BLOCK", block)
        found, torques = smoother.estimate(signals, known), smoother.torques(signals, known)
        for name in ("mean", "variance", "external", "innovation", "innovation_covariance"):
            assert getattr(found, name).tobytes() == getattr(whole, name).tobytes()
        assert all(found.columns[name].tobytes() == values.tobytes() for name, values in whole.columns.items())
        assert torques.mean.tobytes() == whole.mean.tobytes() and torques.external.tobytes() == whole.external.tobytes()
        assert not torques.columns and torques.innovation is None


def test_the_filter_after_its_smoother_over_the_same_signals_is_not_run_again(record, monkeypatch):
    """The smoother's forward pass is `dynamics_ekf`, to the bit; for another joint or other numbers it runs."""
    (signals, _), known = sample(record, 7, 1500), KnownJoint(record, EXACT)
    expected = get("dynamics_ekf").torques(signals, known)
    get("rts_smoother").torques(signals, known)
    monkeypatch.setattr(CausalEstimator, "_watched", lambda *given: pytest.fail("it runs"))
    found = get("dynamics_ekf").torques(signals, known)
    for name in ("time", "mean", "variance", "external"):
        assert getattr(found, name).tobytes() == getattr(expected, name).tobytes()
    assert found.untrusted == expected.untrusted
    ekf, ukf = get("dynamics_ekf"), get("dynamics_ukf")
    for other, joint in (
        (ekf, replace(known, friction=0.1)),
        (ukf, known),
        (replace(ekf, process=MATCHED), known),
    ):
        with pytest.raises(pytest.fail.Exception, match="it runs"):
            other.torques(signals, joint)
