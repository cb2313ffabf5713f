"""The dynamics filters against textbook recursions in NumPy: predictions, variances, counts and delays."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
from scipy.stats import truncnorm
from test_symmetry import seen

from flexspline.estimator import KnownJoint, SensorNoise, joint_model, registry
from flexspline.estimator.dynamics_filter import FILTER
from flexspline.estimator.estimator import as_samples, go_on
from flexspline.estimator.joint_model import EXTERNAL, LINK, LINK_RATE, MESH, MOTOR, MOTOR_RATE, SIZE, STEPS
from flexspline.models.signals import Signals


@dataclass
class Reference:
    """A Gaussian filter on `joint_model`, extended (`kappa` is None) or unscented, with matrices; counts by SciPy's truncated
    normal distribution.

    Attributes:
      known: of the joint. noise: the record of what is random. x: shape (SIZE,). P: shape (m, m), of the active states.
    """

    known: KnownJoint
    noise: np.void
    kappa: float | None
    x: np.ndarray
    P: np.ndarray
    current: float = 0.0
    ratios: tuple[float, float] = (1.0, 1.0)

    @classmethod
    def of(cls, known: KnownJoint, noise: np.void, kappa: float | None, motor: float, link: float) -> Reference:
        x = np.zeros(SIZE)
        joint_model.start(motor, link, 0.0, 0.0, known.p, x)
        active = noise["active"][: int(noise["count"])].astype(int)
        return cls(known, noise, kappa, x, np.diag(noise["start"][active]))

    @property
    def active(self) -> np.ndarray:
        return self.noise["active"][: int(self.noise["count"])].astype(int)

    def moved(self, x: np.ndarray, command: float, time: float, dt: float) -> np.ndarray:
        y, steps = x.copy(), joint_model.substeps(self.x, dt, self.known.p)
        forget = np.exp(-dt / self.noise["mesh_time"])
        joint_model.advance(y, self.current, command, time, dt, steps, 25.0, self.known.p, np.zeros((3, SIZE)))
        y[joint_model.MESH] *= forget
        return y

    def predict(self, command: float, time: float, dt: float) -> None:
        active, m = self.active, len(self.active)
        if self.kappa is None:
            after = self.moved(self.x, command, time, dt)
            F = np.empty((m, m))
            for j, a in enumerate(active):
                x = self.x.copy()
                x[a] += STEPS[a]
                F[:, j] = (self.moved(x, command, time, dt) - after)[active] / STEPS[a]
            self.x, self.P = after, F @ self.P @ F.T
        else:
            scale = np.sqrt(np.diag(self.P)) + 1e-300
            root = scale[:, None] * np.linalg.cholesky(self.P / np.outer(scale, scale))
            points = [self.x]
            for sign in (1.0, -1.0):
                for column in root.T:
                    x = self.x.copy()
                    x[active] += sign * np.sqrt(m + self.kappa) * column
                    points.append(x)
            after = np.array([self.moved(x, command, time, dt) for x in points])
            weights = np.r_[self.kappa, np.full(2 * m, 0.5)] / (m + self.kappa)
            self.x = after[0].copy()
            self.x[active] = (after[0] + weights @ (after - after[0]))[active]
            apart = (after - self.x)[:, active]
            self.P = apart.T @ (weights[:, None] * apart)
        self.grow(dt)
        self.current = joint_model.next_current(self.current, command, dt, self.known.p)

    def grow(self, dt: float) -> None:
        share = np.clip((np.array(self.ratios) - self.noise["low"]) / (self.noise["high"] - self.noise["low"]), 0, 1)
        per_second = self.noise["walk"].copy()
        per_second[MESH] += share[0] * self.noise["mesh_surge"]
        per_second[EXTERNAL] += share[1] * self.noise["external_surge"]
        per_second[MOTOR_RATE] += self.noise["current_walk"]
        self.P = self.P + dt * np.diag(per_second[self.active])

    def see(self, state: int, reading: float, predicted: float, variance: float, count: float) -> tuple[float, float]:
        """Update with a reading whose derivative by a state is one; its innovation and what it was expected to vary by."""
        H = (self.active == state).astype(float)
        S, e = H @ self.P @ H + variance, reading - predicted
        mean, left = e, 0.0
        if count > 0.0:
            s = np.sqrt(S)
            cell = truncnorm((e - count / 2) / s, (e + count / 2) / s, scale=s)
            mean, left = cell.mean(), cell.var()
        K = self.P @ H / S
        self.x[self.active] += K * mean
        self.P = self.P - np.outer(K, K) * (S - left)
        return e, S + count**2 / 12.0

    def measure(self, motor: float, link: float, time: float) -> list[tuple[float, float]]:
        n, p = self.noise, self.known.p
        seen = [self.see(MOTOR, motor, joint_model.read_motor(self.x, p), n["motor_variance"], n["motor_step"])]
        seen.append(self.see(LINK, link, joint_model.read_link(self.x, time, p), n["link_variance"], n["link_step"]))
        self.ratios = tuple(
            n["memory"] * r + (1.0 - n["memory"]) * e * e / S for r, (e, S) in zip(self.ratios, seen, strict=True)
        )
        return seen

    def variance(self, time: float) -> float:
        gradient, p = [], self.known.p
        for a in self.active:
            low, high = self.x.copy(), self.x.copy()
            low[a] -= STEPS[a]
            high[a] += STEPS[a]
            gradient.append(joint_model.joint_torque(high, time, p) - joint_model.joint_torque(low, time, p))
        gradient = np.array(gradient) / (2.0 * STEPS[self.active])
        return float(gradient @ self.P @ gradient)


COUNTS = SensorNoise(motor_resolution=4e-3, motor_noise=1e-3, link_resolution=2e-6, link_noise=2e-6, current_noise=0.02)
SMOOTH = replace(COUNTS, motor_resolution=0.0, link_resolution=0.0)


CALIBRATING = joint_model.ProcessNoise(stiffness=0.07, motor_constant=0.02)


@pytest.mark.parametrize("noise", [SMOOTH, COUNTS], ids=["smooth", "counts"])
@pytest.mark.parametrize(
    "name, process", [("dynamics_ekf", {}), ("dynamics_ukf", {}), ("dynamics_ekf", {"process": CALIBRATING})]
)
def test_it_is_the_textbooks_filter(name, process, noise):
    """State, covariance, innovations and variances over 40 samples in motion, a push among them that nobody expected."""
    signals, known = seen("plain")
    known = replace(known, noise=noise)
    estimator = replace(registry.get(name), **process)
    signals = signals.part(slice(600, 641))
    push = 5e-5 * np.clip(np.arange(41) - 25, 0, 4) / 4
    columns = {c: signals[c] for c in ("motor_position", "motor_current")}
    signals = Signals(signals.time, {**columns, "link_position": signals["link_position"] + push})
    record = estimator.process.record(known, 1e-3)[0]
    kappa = None if name == "dynamics_ekf" else float(estimator.settings(known, 1e-3)[0]["kappa"])
    step = estimator.step(known, 1e-3)
    arrays = step.arrays()
    samples = as_samples(signals, (), known)
    time = samples["time"]
    m, out = arrays[1].view(FILTER)[0], np.zeros((1, step.outputs))
    motor, link, current = (signals[c] for c in ("motor_position", "link_position", "motor_current"))
    loudest = 0.0
    for k in range(len(time)):
        assert go_on(arrays, samples[k : k + 1], out) == (1, 0)
        if k == 0:
            ours = Reference.of(known, record, kappa, motor[0], link[0])
            ours.current = current[0] - known.p["current_offset"]
            continue
        # Each step from the filter's own state: differences do not pile up.
        ours.predict(current[k], time[k - 1], time[k] - time[k - 1])
        innovations = ours.measure(motor[k], link[k], time[k])
        active = ours.active
        np.testing.assert_array_less(np.abs(m["x"] - ours.x), 1e-5 * np.abs(ours.x) + 1e-3 * STEPS)
        scale = np.sqrt(np.diag(ours.P))
        size = len(active)
        np.testing.assert_allclose(
            m["P"][:size, :size] / np.outer(scale, scale), ours.P / np.outer(scale, scale), atol=2e-3
        )
        for j, (e, S) in enumerate(innovations):
            assert out[0, 2 + j] == pytest.approx(e, rel=1e-4, abs=1e-10) and out[0, 4 + j] == pytest.approx(
                S, rel=1e-4
            )
        assert out[0, 1] == pytest.approx(ours.variance(time[k]), rel=0.03)
        assert m["current"] == pytest.approx(ours.current)
        assert (m["motor_ratio"], m["link_ratio"]) == pytest.approx(ours.ratios, rel=1e-3)
        loudest = max(loudest, *ours.ratios)
        ours.x, ours.P = m["x"].copy(), m["P"][:size, :size].copy()
        ours.ratios = (float(m["motor_ratio"]), float(m["link_ratio"]))
    assert loudest > record["high"]


def test_variance_of_the_torque_at_one_count_grows_to_the_counts():
    """A drive at rest: a count wide, uniform, through wave generator and flexspline in series; all of it from 0.1 s."""
    _, known = seen("plain")
    count, q = 4e-3, known.p
    known = replace(known, noise=replace(COUNTS, motor_resolution=count))
    n = 300
    time = np.arange(n) * 1e-3
    columns = {"motor_position": np.zeros(n), "link_position": np.zeros(n), "motor_current": np.zeros(n)}
    columns["motor_position"][200:] = count
    found = registry.get("dynamics_ekf").estimate(Signals(time, columns), known).variance
    slope = q["N"] ** -1.0 - float(np.sum(q["order"] * q["amplitude"] * np.cos(q["phase"])))
    series = 1.0 / (1.0 / (q["K1"] * slope) + slope / q["Kw0"])
    assert found[150] == pytest.approx((count * series) ** 2 / 12.0, rel=0.1)
    assert found[199] == pytest.approx(found[150], rel=0.05)
    assert found[201] < 0.5 * found[199], "another count is news"


@pytest.mark.parametrize("name", ["dynamics_ekf", "dynamics_ukf"])
def test_a_delayed_link_encoder_makes_a_delayed_filter_that_predicts_to_now(name):
    """At the instant of the link reading it is the filter without delay; now it is close to it."""
    delay, samples = 6e-3, 6
    signals, known = seen("plain")
    signals = signals.part(slice(600, 1400))
    known = replace(known, noise=replace(SMOOTH, motor_noise=4e-4))
    n = len(signals.time)
    link = signals["link_position"]
    late = signals.with_columns(link_position=np.r_[np.full(samples, link[0]), link[:-samples]])
    delayed = known.with_numbers(link_delay=delay)
    estimator = registry.get(name)
    memories = []
    for given, joint in ((signals, known), (late, delayed)):
        arrays, kept = estimator.step(joint, 1e-3).arrays(), []
        for k in range(n):
            sample = as_samples(given, (), joint)[k : k + 1]
            go_on(arrays, sample, np.zeros((1, estimator.step(joint, 1e-3).outputs)))
            m = arrays[1].view(FILTER)[0]
            kept.append((float(m["time"]), m["x"].copy(), m["P"].copy(), m["now"].copy(), m["now_P"].copy()))
        memories.append(kept)
    prompt, behind = memories
    for k in range(100, n):
        time, x, P, _, now_P = behind[k]
        then = round((time - behind[0][0]) * 1e3)
        assert k - samples - 1 <= then <= k - samples
        np.testing.assert_allclose(x, prompt[then][1], rtol=1e-6, atol=1e-9)
        np.testing.assert_allclose(P, prompt[then][2], rtol=1e-4, atol=1e-12)
        assert np.array_equal(prompt[k][1], prompt[k][3])
        assert now_P[MOTOR, MOTOR] > 0.0
    apart = {
        state: np.array([behind[k][3][state] - prompt[k][1][state] for k in range(300, n)])
        for state in (MOTOR, LINK, LINK_RATE, EXTERNAL)
    }
    active = estimator.process.record(delayed, 1e-3)[0]["active"].astype(int)
    for state, most in ((MOTOR, 4e-4), (LINK, 2.5e-5), (LINK_RATE, 6e-3), (EXTERNAL, 0.8)):
        size = np.sqrt(np.mean(apart[state] ** 2))
        i = int(np.flatnonzero(active == state)[0])
        believed = np.sqrt(np.mean([behind[k][4][i, i] for k in range(300, n)]))
        print(f"state {state}: apart {size:.2g}, deviation now {believed:.2g}")
        assert size < most
        if state != EXTERNAL:
            assert 0.1 < size / believed < 5.0


@pytest.mark.parametrize("name", ["dynamics_ekf", "dynamics_ukf"])
def test_prediction_to_now_by_the_model_and_the_motor_encoder(name):
    """Sample by sample, through what the drive was given since: the external torque along the line through its last six delays,
    known as that; the covariance by the last Jacobian and the process noise, less by every reading of the motor encoder."""
    delay = 5.7e-3
    signals, known = seen("plain")
    known = replace(known, noise=replace(SMOOTH, motor_noise=4e-4)).with_numbers(link_delay=delay)
    signals = signals.part(slice(600, 760))
    estimator = registry.get(name)
    record = estimator.process.record(known, 1e-3)[0]
    step = estimator.step(known, 1e-3)
    arrays, samples, p = step.arrays(), as_samples(signals, (), known), known.p
    m, out, external = arrays[1].view(FILTER)[0], np.zeros((1, step.outputs)), {}
    active = record["active"][: int(record["count"])].astype(int)
    of_external = int(np.flatnonzero(active == EXTERNAL)[0])
    ahead = 0
    for k in range(len(samples)):
        assert go_on(arrays, samples[k : k + 1], out) == (1, 0)
        external[round(float(m["time"]) * 1e6)] = float(m["x"][EXTERNAL])
        if k < 60:
            continue
        size, time = len(active), float(m["time"])
        ours = Reference(known, record, None, m["x"].copy(), m["P"][:size, :size].copy())
        ours.current, ours.ratios = float(m["current"]), (float(m["motor_ratio"]), float(m["link_ratio"]))
        F = m["F"][:size, :size].copy()
        ours.P[of_external, :] = ours.P[:, of_external] = 0.0
        last = [t for t in external if t >= 1e6 * (time - 6.0 * delay)]
        line = np.polyfit([1e-6 * t - time for t in last], [external[t] for t in last], 1)
        for s in samples[: k + 1][samples["time"][: k + 1] > time + 1e-9]:
            dt, command = s["time"] - time, s["motor_current"] - p["current_offset"]
            ours.x[EXTERNAL] = np.polyval(line, time + 0.5 * dt - float(m["time"]))
            ours.x = ours.moved(ours.x, command, time, dt)
            ours.P = F @ ours.P @ F.T
            ours.grow(dt)
            ours.current = joint_model.next_current(ours.current, command, dt, p)
            ours.P[of_external, of_external] = 0.0
            ours.see(MOTOR, s["motor_position"], joint_model.read_motor(ours.x, p), record["motor_variance"], 0.0)
            time = float(s["time"])
            ahead += 1
        np.testing.assert_allclose(m["now"], ours.x, rtol=1e-6, atol=1e-9)
        scale = np.sqrt(np.diag(ours.P)) + 1e-30
        apart = (m["now_P"][:size, :size] - ours.P) / np.outer(scale, scale)
        assert np.abs(apart).max() < 1e-6
        assert out[0, 0] == joint_model.joint_torque(m["now"], samples[k]["time"], p)
        assert out[0, 1] == pytest.approx(ours.variance(samples[k]["time"]), rel=0.03)
    assert ahead > 5 * 100
