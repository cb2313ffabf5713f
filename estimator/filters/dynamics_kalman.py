"""Joint-dynamics Kalman filters, extended and unscented, and a smoother: encoders and current through the joint's own equations.

State and laws: `joint_model`; the filter: `dynamics_filter`. The current is an input, the encoders are the
measurements. The record counts as exact. With `process.stiffness` and `process.motor_constant` (0.07 and 0.02, the
tolerances of a datasheet) it estimates these two. An error of the kinematic error then appears as stiffness: on
joints known within tolerance that is worse than without (`augmented` is for those).

`rts_smoother` is the Rauch-Tung-Striebel smoother over the extended filter: offline, each estimate from the whole recording.
Backwards from the last sample (Rauch, Tung & Striebel 1965; Särkkä, "Bayesian Filtering and Smoothing", 2013, Eq. 9.13):

    G = P(k|k) Fᵀ P(k+1|k)⁻¹     x(k|n) = x(k|k) + G (x(k+1|n) − x(k+1|k))     P(k|n) = P(k|k) + G (P(k+1|n) − P(k+1|k)) Gᵀ
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import ClassVar

import numpy as np

from ...models.chunks import large, parts
from ...models.errors import FilterDiverged
from ...models.kernels import kernel
from ...models.motion import BLOCK
from ...models.signals import Signals
from ...models.step import OK, Step, step_of
from ..dynamics_filter import FILTER, OUT, SETTINGS, filter_step
from ..estimator import (
    TORQUES,
    CausalEstimator,
    Estimator,
    KnownJoint,
    Posterior,
    TuningParameter,
    as_samples,
    fields_of,
    interval_of,
)
from ..joint_model import SIZE, STATES, TUNING, ProcessNoise, joint_torque, torque_variance
from ..smoothed import in_time
from ..trust import Watch


@step_of(FILTER, SETTINGS, OUT)
def _step(m, s, p, c, o):
    return filter_step(m, s, c, p, o)


@dataclass(frozen=True)
class DynamicsEKF(CausalEstimator):
    """Extended Kalman filter on the joint's dynamics; see the module."""

    name: str = "dynamics_ekf"
    process: ProcessNoise = field(default_factory=ProcessNoise)  # deviation of the joint from its equations
    costly: ClassVar[bool] = True
    innovation_unit: ClassVar[str] = "rad"
    tuning: ClassVar[tuple[TuningParameter, ...]] = TUNING
    description: ClassVar[str] = (
        "extended Kalman filter on the joint's own equations of motion (`estimator.joint_model`)"
    )
    compiled: ClassVar[Step] = _step

    def torques(self, signals: Signals, joint: KnownJoint) -> Posterior:
        known, process, column, untrusted = signals.__dict__.get("_filtered", (None, None, {}, None))
        if type(self) is DynamicsEKF and known is joint and process == self.process:  # by rts_smoother
            return replace(self.posterior(signals.time, column), untrusted=untrusted)
        return super().torques(signals, joint)

    def settings(self, joint: KnownJoint, interval: float) -> np.ndarray:
        found = np.zeros(1, SETTINGS)
        found["noise"], found["kappa"] = self.process.record(joint, interval), math.nan
        return found


@dataclass(frozen=True)
class DynamicsUKF(DynamicsEKF):
    """Unscented Kalman filter on the joint's dynamics; the update is the EKF's, as the encoders are linear in the
    state."""

    name: str = "dynamics_ukf"
    kappa: float = 1.0  # κ [1], spread of the sigma points
    description: ClassVar[str] = (
        "unscented Kalman filter on the joint's own equations of motion (Julier & Uhlmann 1997)"
    )

    def settings(self, joint: KnownJoint, interval: float) -> np.ndarray:
        found = super().settings(joint, interval)
        found["kappa"] = self.kappa
        return found


@kernel
def forward(samples, settings, record, memory, out, F, predicted, covariance, filtered):
    """Filter n samples and keep the data of the backward pass; return n, or the sample at which an estimate was not
    finite.

    `memory`: record of `FILTER`; `out`: records of `OUT`, shape (n,); `F`, `covariance`, `filtered`: Jacobian,
    covariance of the prediction and of the estimate, shape (n, m, m); `predicted`: shape (n, SIZE).
    """
    m, c, p, count = memory[0], settings[0], record[0], F.shape[1]
    for k in range(len(samples)):
        if filter_step(m, samples[k], c, p, out[k]) != OK:
            return k
        F[k], covariance[k], filtered[k] = m.F[:count, :count], m.predicted_P[:count, :count], m.P[:count, :count]
        predicted[k] = m.predicted
    return len(samples)


@kernel
def backward(time, states, record, settings, F, predicted, covariance, filtered, torque, variance):
    """Smooth states, shape (n, SIZE), and `filtered`, shape (n, m, m), in place; torque, variance: outputs, shape
    (k,). Of n = k + 1 states the last one is already smoothed."""
    p, noise = record[0], settings[0].noise
    n, m = len(states), filtered.shape[1]
    H, shift = np.zeros(SIZE), np.zeros(m)
    for k in range(len(time) - 1, -1, -1):
        P = filtered[k]
        if k < n - 1:
            # Scaled to unit diagonal: the states' units span ten decades.
            scale = np.sqrt(np.diag(covariance[k + 1]))
            C = covariance[k + 1] / np.outer(scale, scale) + 1e-12 * np.eye(m)
            G = np.linalg.solve(C, (F[k + 1] @ P) / scale.reshape(m, 1)).T.copy() / scale
            for i in range(m):
                a = int(noise.active[i])
                shift[i] = states[k + 1, a] - predicted[k + 1, a]
            change = G @ shift
            for i in range(m):
                states[k, int(noise.active[i])] += change[i]
            filtered[k] = P + G @ (filtered[k + 1] - covariance[k + 1]) @ G.T
        torque[k] = joint_torque(states[k], time[k], p)
        variance[k] = torque_variance(states[k], filtered[k], torque[k], time[k], p, noise, H)


@dataclass(frozen=True)
class RTSSmoother(Estimator):
    """RTS smoother on the joint's dynamics; not causal.

    The backward pass needs 3 m² + SIZE numbers a sample, 2 MB per second at 1 kHz. The filter runs forward once and
    keeps its state at the start of every `BLOCK` of samples. From the last block to the first it runs again, keeps
    every sample, and runs back: the same numbers in a block's memory.
    """

    name: str = "rts_smoother"
    process: ProcessNoise = field(default_factory=ProcessNoise)  # deviation of the joint from its equations
    causal: ClassVar[bool] = False
    costly: ClassVar[bool] = True
    innovation_unit: ClassVar[str] = "rad"
    tuning: ClassVar[tuple[TuningParameter, ...]] = TUNING
    description: ClassVar[str] = (
        "smoother over dynamics_ekf: every estimate from the whole recording (Rauch et al. 1965)"
    )

    def estimate(self, signals: Signals, joint: KnownJoint) -> Posterior:
        return self._smoothed(signals, joint, fields_of(OUT))

    def torques(self, signals: Signals, joint: KnownJoint) -> Posterior:
        return self._smoothed(signals, joint, ("torque", "variance", "external_torque"))

    def _smoothed(self, signals: Signals, joint: KnownJoint, names: tuple[str, ...]) -> Posterior:
        signals, joint = in_time(signals, joint)
        for name in self.needs:
            signals[name]
        filtered = DynamicsEKF(self.name, self.process)
        settings = filtered.settings(joint, interval_of(signals.time))
        n, blocks = len(signals.time), list(parts(len(signals.time), BLOCK))
        memory, known = np.zeros(1, FILTER), np.zeros(len(blocks), FILTER)
        # The samples of a block, and the first one after it.
        size, m = min(n, BLOCK) + 1, int(settings[0]["noise"]["count"])
        out, predicted, states = np.zeros(size, OUT), np.zeros((size, SIZE)), np.zeros((size, SIZE))
        F, covariance, P = (np.zeros((size, m, m)) for _ in range(3))
        rows, outputs = out.view(np.float64).reshape(size, -1), fields_of(OUT)
        first = outputs.index(STATES[0])

        def run(part: slice) -> np.ndarray:
            samples = as_samples(signals, (), joint, False, part)
            done = forward(samples, settings, joint.record, memory, out[: len(samples)], F, predicted, covariance, P)
            if done < len(samples):
                at = part.start + int(done)
                why = "the estimate is no longer a finite number"
                raise FilterDiverged(self.name, at, float(signals.time[at]), why)
            return samples

        watch, forwards = Watch(joint.rated_torque, outputs), {name: large(n) for name in TORQUES.intersection(outputs)}
        for i, part in enumerate(blocks):
            known[i] = memory[0]
            samples = run(part)
            watch.add(samples["time"], rows[: len(samples)])
            for name, values in forwards.items():
                values[part] = rows[: len(samples), outputs.index(name)]
        signals.__dict__["_filtered"] = (joint, self.process, forwards, watch.reason)  # for dynamics_ekf
        column = {name: large(n) for name in names}
        for i, part in reversed(list(enumerate(blocks))):
            k, later = part.stop - part.start, part.stop < n
            if later:
                for kept in (states, predicted, F, covariance, P):
                    kept[k] = kept[0]
                memory[0] = known[i]
                samples = run(part)
            states[:k] = rows[:k, first:]
            end, torque, variance = k + later, np.empty(k), np.empty(k)
            try:
                backward(
                    samples["time"], states[:end], joint.record, settings, F[:end], predicted[:end], covariance[:end],
                    P[:end], torque, variance,
                )  # fmt: skip
            except np.linalg.LinAlgError as error:  # a finite covariance without a finite inverse
                raise FilterDiverged(self.name, n - 1, float(signals.time[-1]), f"its smoother: {error}") from error
            rows[:k, 0], rows[:k, 1], rows[:k, first:] = torque, variance, states[:k]
            for name, values in column.items():
                values[part] = rows[:k, outputs.index(name)]
        return replace(filtered.posterior(signals.time, column), untrusted=watch.reason)


ESTIMATORS = (DynamicsEKF(), DynamicsUKF(), RTSSmoother())
