"""The posterior Cramér-Rao bound: against closed forms, scipy's Riccati solver, filterpy, and filters on the model itself."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import solve_discrete_are

from flexspline.estimator import KnownJoint, SensorNoise, bound, joint_model
from flexspline.estimator.filters import dynamics_kalman
from flexspline.estimator.joint_model import BRISTLE, EXTERNAL, LINK, LINK_RATE, MOTOR, SIZE, ProcessNoise
from flexspline.models.errors import InputError
from flexspline.models.joint import load_joint
from flexspline.models.signals import Signals

NOISE = SensorNoise(motor_resolution=0.0, motor_noise=4e-4, link_resolution=0.0, link_noise=2e-6, current_noise=0.0)
PRIOR = np.r_[[4e-4, 1.0, 4e-3, 1.0, 2e-3, 2e-6, 1e-2, 2.4], np.zeros(4)]


@pytest.fixture(scope="module")
def record() -> np.ndarray:
    joint = load_joint("test-joint")
    return joint.record(joint.mount("link"))


def test_random_walk_settles_at_the_closed_form():
    W, V = 1e-4, 1e-2
    steady = 0.5 * (-W + np.sqrt(W * W + 4.0 * W * V))
    riccati = solve_discrete_are(np.eye(1), np.eye(1), W * np.eye(1), V * np.eye(1))[0, 0]  # of the prediction
    assert steady == pytest.approx(riccati - W, rel=1e-10)
    assert bound.random_walk_bound(W, np.full(500, V), V)[-1] == pytest.approx(steady, rel=1e-9)
    # Without process noise n readings leave V/n.
    assert bound.random_walk_bound(0.0, np.full(100, V), V)[-1] == pytest.approx(V / 100, rel=1e-12)


def walk(record, seed: int, intensity: float, n: int = 1500):
    """Time, states, current, command and encoder readings of the bound's own model, drawn."""
    rng = np.random.default_rng(seed)
    p = record[0]
    time = np.arange(n) * 1e-3
    command = 1.6 * np.sin(2 * np.pi * 0.7 * time)
    x, work, states, current = np.zeros(SIZE), np.zeros((3, SIZE)), np.zeros((n, SIZE)), np.zeros(n)
    for k in range(n):
        if k > 0:
            steps = joint_model.substeps(x, 1e-3, p)
            joint_model.advance(x, current[k - 1], command[k - 1], time[k - 1], 1e-3, steps, 25.0, p, work)
            current[k] = joint_model.next_current(current[k - 1], command[k - 1], 1e-3, p)
            x[EXTERNAL] += intensity * np.sqrt(1e-3) * rng.standard_normal()
        states[k] = x
    motor = states[:, MOTOR] + NOISE.motor_noise * rng.standard_normal(n)
    link = states[:, LINK] + NOISE.link_noise * rng.standard_normal(n)
    return time, states, current, command, motor, link


@pytest.mark.parametrize("delay, warmer", [(0.0, 0.0), (6e-3, 20.0)])
def test_joint_bound_is_the_covariance_recursion(record, delay, warmer):
    """Against the Riccati recursion of the covariance with separate Jacobians and a little noise on every state. That of the
    information would take the difference of numbers of 1e10 there, 5 % off on some processors. A link encoder that is late reads
    the link where it was, θl − delay·ωl; a warm gear has another friction."""
    time, states, current, command, _, _ = walk(record, 3, 1.0, 121)
    record = record.copy()
    record["link_delay"], record["friction_temperature"] = delay, -0.01
    p, active = record[0], np.r_[0:7, EXTERNAL]
    at = list(active).index
    F = np.empty((120, 8, 8))
    for k in range(120):
        for j, state in enumerate(active):
            width = 1e-2 * joint_model.STEPS[state]
            moved = []
            for sign in (1, -1):
                x, work = states[k].copy(), np.zeros((3, SIZE))
                x[state] += sign * width
                steps = joint_model.substeps(states[k], 1e-3, p)
                joint_model.advance(x, current[k], command[k], time[k], 1e-3, steps, 25.0 + warmer, p, work)
                moved.append(x[active])
            F[k, :, j] = (moved[0] - moved[1]) / (2 * width)
    scale = joint_model.STEPS[active]  # units that differ by ten decades
    F = F / scale[:, None] * scale[None, :]
    H = np.zeros((2, 8))
    H[0, at(MOTOR)], H[1, at(LINK)] = joint_model.STEPS[MOTOR], joint_model.STEPS[LINK]
    H[1, at(LINK_RATE)] = -delay * joint_model.STEPS[LINK_RATE]
    Q = 1e-10 * np.eye(8)
    Q[at(EXTERNAL), at(EXTERNAL)] = 1e-3 / joint_model.STEPS[EXTERNAL] ** 2
    start = ProcessNoise().record(KnownJoint(record, NOISE), 1e-3)[0]["start"][active] / scale**2
    P = np.empty((121, 8, 8))
    P[0] = np.diag(start)
    for k in range(120):
        P[k + 1] = F[k] @ P[k] @ F[k].T + Q
        for h, std in zip(H, (NOISE.motor_noise, NOISE.link_noise), strict=True):
            gain = P[k + 1] @ h / (h @ P[k + 1] @ h + std**2)
            rest = np.eye(8) - np.outer(gain, h)
            P[k + 1] = rest @ P[k + 1] @ rest.T + std**2 * np.outer(gain, gain)  # Joseph's form
    heat = np.full(121, 25.0 + warmer)
    ours = bound.joint_bound(time, states, current, command, record, NOISE, 1.0, heat)
    for k in (20, 60, 120):
        x, gradient = states[k], np.empty(8)
        T = joint_model.joint_torque(x, time[k], p)
        for j, state in enumerate(active):
            y = x.copy()
            y[state] += joint_model.STEPS[state]
            gradient[j] = joint_model.joint_torque(y, time[k], p) - T
        assert ours[k] == pytest.approx(gradient @ P[k] @ gradient, rel=0.02)


def test_numbers_with_a_prior_are_constant_states(record):
    """Against the dense recursion of states and numbers together, with separate Jacobians."""
    time, states, current, command, _, _ = walk(record, 3, 1.0, 81)
    others = np.concatenate([record, record, record, record])
    others[0]["K1"] *= 1.07
    others[0]["K2"] *= 1.07
    others[1]["Mg"] *= 1.01
    others[2]["phase"][0] += 0.2
    others[3]["link_zero"] += 3e-5
    active = np.r_[0:7, EXTERNAL]
    n, scale = 12, np.r_[joint_model.STEPS[active], np.ones(4)]

    def after(x, k, p):
        y = x.copy()
        steps = joint_model.substeps(states[k], 1e-3, record[0])
        joint_model.advance(y, current[k], command[k], time[k], 1e-3, steps, 25.0, p, np.zeros((3, SIZE)))
        return y[active]

    def gradient(of, x):
        found = []
        for state in active:
            y = x.copy()
            y[state] += joint_model.STEPS[state]
            found.append((of(y, record[0]) - of(x, record[0])) / joint_model.STEPS[state])
        return np.array(found + [of(x, p) - of(x, record[0]) for p in others])

    start = ProcessNoise().record(KnownJoint(record, NOISE), 1e-3)[0]["start"][active]
    P = np.diag(np.r_[start, np.ones(4)] / scale**2)
    ours = bound.joint_bound(time, states, current, command, record, NOISE, 1.0, others=others)
    exact = bound.joint_bound(time, states, current, command, record, NOISE, 1.0)
    for k in range(1, 81):
        F = np.eye(n)
        for j, state in enumerate(active):
            width = 1e-2 * joint_model.STEPS[state]
            low, high = states[k - 1].copy(), states[k - 1].copy()
            low[state] -= width
            high[state] += width
            F[:8, j] = (after(high, k - 1, record[0]) - after(low, k - 1, record[0])) / (2 * width)
        for j, p in enumerate(others):
            F[:8, 8 + j] = after(states[k - 1], k - 1, p) - after(states[k - 1], k - 1, record[0])
        F = F / scale[:, None] * scale[None, :]
        P = F @ P @ F.T
        P[7, 7] += 1e-3 / scale[7] ** 2
        H = np.array([
            gradient(joint_model.read_motor, states[k]),
            gradient(lambda x, p, k=k: joint_model.read_link(x, time[k], p), states[k]),
        ])  # fmt: skip
        H *= scale
        S = H @ P @ H.T + np.diag([NOISE.motor_noise**2, NOISE.link_noise**2])
        P = P - P @ H.T @ np.linalg.solve(S, H @ P)
        if k % 20 == 0:
            of_torque = gradient(lambda x, p, k=k: joint_model.joint_torque(x, time[k], p), states[k]) * scale
            assert ours[k] == pytest.approx(of_torque @ P @ of_torque, rel=1e-3)
    assert (ours[1:] >= exact[1:] * (1 - 1e-9)).all() and ours[-1] > 1.05 * exact[-1]


def test_a_filter_of_the_same_model_attains_it(record):
    """Mean square error over draws of the model: not below the bound, and not far above."""
    intensity, seeds = 2.0, range(40, 64)
    print("seeds", list(seeds))
    process = ProcessNoise(
        external=intensity / float(record[0]["T2"]), push=0.0, mesh=0.0, mesh_push=0.0, torque=0.0, bristle=1e-4,
        floor=0.0,
    )  # fmt: skip
    filtered = dynamics_kalman.DynamicsEKF(process=process)
    errors, limits = [], []
    for seed in seeds:
        time, states, current, command, motor, link = walk(record, seed, intensity)
        torque = np.array([joint_model.joint_torque(x, 0.0, record[0]) for x in states[500:]])
        columns = {"motor_position": motor, "link_position": link, "motor_current": current, "current_command": command}
        estimate = filtered.estimate(Signals(time, columns), KnownJoint(record, NOISE))
        errors.append(np.mean((estimate.mean[500:] - torque) ** 2))
        limits.append(bound.joint_bound(time, states, current, command, record, NOISE, intensity)[500:].mean())
    ratio = np.sqrt(np.mean(errors) / np.mean(limits))
    spread = np.std(errors) / np.mean(errors) / np.sqrt(len(errors)) / 2
    print(f"RMS error / bound: {ratio:.3f} ± {spread:.3f}")
    assert 1 - 3 * spread < ratio < 1.15 + 3 * spread


def test_bound_of_the_joint_behaves(record):
    """A louder torque and a coarser encoder raise it; presliding friction near rest adds no instability."""
    time, states, current, command, _, _ = walk(record, 5, 0.0, 800)
    quiet = bound.joint_bound(time, states, current, command, record, NOISE, 0.1)
    loud = bound.joint_bound(time, states, current, command, record, NOISE, 1.0)
    coarse = SensorNoise(motor_resolution=2e-2, link_resolution=1e-5, link_noise=2e-6, motor_noise=4e-4)
    assert (loud[100:] > quiet[100:]).all()
    assert (bound.joint_bound(time, states, current, command, record, coarse, 0.1)[100:] > quiet[100:]).all()
    rest = np.zeros((2000, SIZE))
    rest[:, BRISTLE] = 1e-3
    rest[:, 1] = rest[:, 3] = 1e-9 * (-1.0) ** np.arange(2000)
    t, zero = np.arange(2000) * 1e-3, np.zeros(2000)
    still = bound.joint_bound(t, rest, zero, zero, record, NOISE, 0.0)
    assert still[-1] < still[200] < still[20]


def test_intensity():
    rng = np.random.default_rng(0)
    time = np.arange(20001) * 1e-3
    steps = 0.7 * np.sqrt(1e-3) * rng.standard_normal(20000)
    walk = np.r_[0.0, np.cumsum(steps)]
    # Of increments that overlap, h samples long, h/(3n) is the relative variance of q.
    for bandwidth, lag in ((500.0, 1), (20.0, 25)):
        spread = np.sqrt(max(lag / 3, 0.5) / 20000)
        assert bound.walk_intensity(walk, time, bandwidth) == pytest.approx(0.7, rel=3 * spread)
    assert bound.walk_intensity(np.zeros(10), time[:10]) == 0.0


def test_intensity_of_a_smooth_torque_does_not_depend_on_how_fast_it_is_sampled():
    """A sine of whole periods: (2 A sin(ω h/2))² is twice the mean square of its changes over h; a step has its size alone."""
    A, omega, h, end = 3.0, 2 * np.pi * 2.0, 0.025, 20.0
    closed = np.sqrt(2.0) * A * np.sin(0.5 * omega * h) / np.sqrt(h)
    for rate in (400, 1000, 4000):
        time = np.arange(int(end * rate) + 1) / rate
        found = bound.walk_intensity(A * np.sin(omega * time), time, 20.0)
        assert found == pytest.approx(closed, rel=2e-3), rate  # the ends, held
        step = np.where(time > 3.0, A, 0.0)
        assert bound.walk_intensity(step, time, 20.0) == pytest.approx(A / np.sqrt(end), rel=1e-9)


def test_bad_input(record):
    time, states, current, command, _, _ = walk(record, 1, 0.0, 5)
    with pytest.raises(InputError, match="intensity"):
        bound.joint_bound(time, states, current, command, record, NOISE, -1.0)


def test_the_walk_of_a_few_samples():
    """Of a ramp over one second in five samples, over one second at a time: 2·(¼² + ½² + ¾²) + 1² in four steps of a quarter."""
    time = np.linspace(0.0, 1.0, 5)
    assert bound.walk_intensity(3.0 * time, time, 0.5) == pytest.approx(3.0 * np.sqrt(2.75 / 4))
    assert bound.walk_intensity(3.0 * time, time, 2.0) == pytest.approx(3.0 * np.sqrt(4 / 16))
