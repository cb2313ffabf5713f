"""Rauch-Tung-Striebel smoother over the joint-dynamics EKF: offline, each estimate from the whole recording.

Backwards from the last sample (Rauch, Tung & Striebel 1965; Särkkä, "Bayesian Filtering and Smoothing", 2013, Eq. 9.13):

    G = P(k|k) Fᵀ P(k+1|k)⁻¹     x(k|n) = x(k|k) + G (x(k+1|n) − x(k+1|k))     P(k|n) = P(k|k) + G (P(k+1|n) − P(k+1|k)) Gᵀ
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from ...models.kernels import kernel
from ...models.signals import Signals
from ..dynamics_filter import FILTER, OUT, filter_step, tell
from ..errors import FilterDiverged
from ..estimator import Estimator, KnownJoint, Posterior, as_samples, fields_of, sample_interval
from ..joint_model import SIZE, STATES, TUNING, ProcessNoise, joint_torque, torque_variance
from ..smoothed import in_time
from ..tuning_parameters import TuningParameter
from .dynamics_ekf import DynamicsEKF


@kernel
def forward(samples, settings, record, memory, out, F, predicted, covariance, filtered):
    """Filter n samples and keep what the way back needs; returns n, or the sample at which an estimate was not finite.

    Args:
        memory: Shape (1,), record of `FILTER`. out: Shape (n, len(OUT.names)).
        F, covariance, filtered: Shape (n, m, m): Jacobian, covariance of the prediction, of the estimate.
        predicted: Shape (n, SIZE).
    """
    m, c, p, count = memory[0], settings[0], record[0], F.shape[1]
    for k in range(len(samples)):
        torque, variance = filter_step(m, samples[k], c, p, False)
        if tell(m, torque, variance, out[k]) != 0:
            return k
        F[k], covariance[k], filtered[k] = m.F[:count, :count], m.predicted_P[:count, :count], m.P[:count, :count]
        predicted[k] = m.predicted
    return len(samples)


@kernel
def backward(time, states, record, settings, F, predicted, covariance, filtered, torque, variance):
    """Smooth states, shape (n, SIZE), and `filtered`, shape (n, m, m), in place; torque, variance: outputs, shape (n,)."""
    p, noise = record[0], settings[0].noise
    n, m = len(time), filtered.shape[1]
    H, shift = np.zeros(SIZE), np.zeros(m)
    for k in range(n - 1, -1, -1):
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
    """RTS smoother on the joint's dynamics; not causal. Keeps 3 m² + SIZE numbers a sample: 2 MB per second at 1 kHz.

    Attributes:
        process: how far the joint departs from its equations.
    """

    name: str = "rts_smoother"
    process: ProcessNoise = field(default_factory=ProcessNoise)
    causal: ClassVar[bool] = False
    costly: ClassVar[bool] = True
    innovation_unit: ClassVar[str] = "rad"
    tuning: ClassVar[tuple[TuningParameter, ...]] = TUNING
    description: ClassVar[str] = (
        "smoother over dynamics_ekf: every estimate from the whole recording (Rauch et al. 1965)"
    )

    def estimate(self, signals: Signals, joint: KnownJoint) -> Posterior:
        signals, joint = in_time(signals, joint)
        samples = as_samples(signals, self.needs, joint)
        filtered = DynamicsEKF(self.name, self.process)
        settings = filtered.settings(joint, sample_interval(signals))
        n, m = len(samples), int(settings[0]["noise"]["count"])
        out, predicted = np.zeros((n, len(fields_of(OUT)))), np.zeros((n, SIZE))
        F, covariance, P = np.zeros((n, m, m)), np.zeros((n, m, m)), np.zeros((n, m, m))
        done = forward(samples, settings, joint.record, np.zeros(1, FILTER), out, F, predicted, covariance, P)
        if done < n:
            raise FilterDiverged(
                self.name, done, float(signals.time[done]), "the estimate is no longer a finite number"
            )
        states = out[:, fields_of(OUT).index(STATES[0]) :].copy()
        torque, variance = out[:, 0].copy(), out[:, 1].copy()
        try:
            backward(samples["time"], states, joint.record, settings, F, predicted, covariance, P, torque, variance)
        except np.linalg.LinAlgError as error:  # a covariance that is finite and whose inverse is not
            raise FilterDiverged(self.name, n - 1, float(signals.time[-1]), f"its smoother: {error}") from error
        out[:, 0], out[:, 1], out[:, fields_of(OUT).index(STATES[0]) :] = torque, variance, states
        return filtered.posterior(signals.time, {name: out[:, i].copy() for i, name in enumerate(fields_of(OUT))})


ESTIMATORS = (RTSSmoother(),)
