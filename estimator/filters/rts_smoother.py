"""Rauch-Tung-Striebel smoother over the joint-dynamics EKF: offline, each estimate from the whole recording.

Backwards from the last sample (Rauch, Tung & Striebel 1965; Särkkä, "Bayesian Filtering and Smoothing", 2013, Eq. 9.13):

    G = P(k|k) Fᵀ P(k+1|k)⁻¹     x(k|n) = x(k|k) + G (x(k+1|n) − x(k+1|k))     P(k|n) = P(k|k) + G (P(k+1|n) − P(k+1|k)) Gᵀ
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import ClassVar

import numpy as np

from ...models.chunks import parts
from ...models.kernels import kernel
from ...models.signals import Signals
from ..dynamics_filter import FILTER, OUT, filter_step, write_out
from ..errors import FilterDiverged
from ..estimator import Estimator, KnownJoint, Posterior, fields_of, part_samples, sample_interval
from ..joint_model import SIZE, STATES, TUNING, ProcessNoise, joint_torque, torque_variance
from ..motion import BLOCK
from ..smoothed import in_time
from ..trust import Watch
from ..tuning_parameters import TuningParameter
from .dynamics_kalman import DynamicsEKF


@kernel
def forward(samples, settings, record, memory, out, F, predicted, covariance, filtered):
    """Filter n samples and keep the data of the backward pass; return n, or the sample at which an estimate was not
    finite.

    Args:
      memory: Shape (1,), record of `FILTER`. out: Shape (n,), records of `OUT`.
      F, covariance, filtered: Shape (n, m, m): Jacobian, covariance of the prediction, of the estimate.
      predicted: Shape (n, SIZE).
    """
    m, c, p, count = memory[0], settings[0], record[0], F.shape[1]
    for k in range(len(samples)):
        torque, variance = filter_step(m, samples[k], c, p, False)
        if write_out(m, torque, variance, out[k]) != 0:
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

    Attributes:
      process: deviation of the joint from its equations.
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
        return self._smoothed(signals, joint, fields_of(OUT))

    def torques(self, signals: Signals, joint: KnownJoint) -> Posterior:
        return self._smoothed(signals, joint, ("torque", "variance", "external_torque"))

    def _smoothed(self, signals: Signals, joint: KnownJoint, names: tuple[str, ...]) -> Posterior:
        signals, joint = in_time(signals, joint)
        for name in self.needs:
            signals[name]
        filtered = DynamicsEKF(self.name, self.process)
        settings = filtered.settings(joint, sample_interval(signals))
        n, blocks = len(signals.time), list(parts(len(signals.time), BLOCK))
        memory, known = np.zeros(1, FILTER), np.zeros(len(blocks), FILTER)
        kept = _Kept(min(n, BLOCK) + 1, int(settings[0]["noise"]["count"]))

        def run(part: slice) -> np.ndarray:
            samples = part_samples(signals, joint, part, False)
            done = kept.forward(samples, settings, joint.record, memory)
            if done < len(samples):
                at = part.start + done
                why = "the estimate is no longer a finite number"
                raise FilterDiverged(self.name, at, float(signals.time[at]), why)
            return samples

        watch = Watch(joint.rated_torque, fields_of(OUT))
        for i, part in enumerate(blocks):
            known[i] = memory[0]
            samples = run(part)
            out = kept.outputs(len(samples))
            watch.add(samples["time"], out.view(np.float64).reshape(len(out), -1))
        column = {name: np.empty(n) for name in names}
        for i, part in reversed(list(enumerate(blocks))):
            if part.stop < n:
                kept.first_of_the_next(part.stop - part.start)
                memory[0] = known[i]
                samples = run(part)
            try:
                out = kept.backward(samples, joint.record, settings, part.stop < n)
            except np.linalg.LinAlgError as error:  # a finite covariance without a finite inverse
                raise FilterDiverged(self.name, n - 1, float(signals.time[-1]), f"its smoother: {error}") from error
            for name, values in column.items():
                values[part] = out[:, fields_of(OUT).index(name)]
        return replace(filtered.posterior(signals.time, column), untrusted=watch.reason)


class _Kept:
    """Data of the backward pass for the samples of a block, and for the first one after it."""

    def __init__(self, size: int, m: int):
        """Allocate for `size` samples of m active states."""
        self._out, self._predicted = np.zeros(size, OUT), np.zeros((size, SIZE))
        self._states = np.zeros((size, SIZE))
        self._F, self._covariance, self._P = (np.zeros((size, m, m)) for _ in range(3))

    def forward(self, samples: np.ndarray, settings: np.ndarray, record: np.ndarray, memory: np.ndarray) -> int:
        """Filter a block; overwrite the previous one."""
        n = len(samples)
        return int(forward(
            samples, settings, record, memory, self._out[:n], self._F, self._predicted, self._covariance, self._P
        ))  # fmt: skip

    def outputs(self, n: int) -> np.ndarray:
        """Return the filter's outputs over a block of n samples, shape (n, outputs)."""
        return self._out[:n]

    def first_of_the_next(self, n: int) -> None:
        """Use the first sample, which is smoothed, as the one after a block of n samples."""
        for kept in (self._states, self._predicted, self._F, self._covariance, self._P):
            kept[n] = kept[0]

    def backward(self, samples: np.ndarray, record: np.ndarray, settings: np.ndarray, goes_on: bool) -> np.ndarray:
        """Smooth a block; `goes_on`: whether there is one after it. Return its outputs, shape (n, outputs)."""
        n = len(samples)
        end, first = n + goes_on, fields_of(OUT).index(STATES[0])
        out, states = self._out[:n].view(np.float64).reshape(n, -1), self._states[:end]
        states[:n] = out[:, first:]
        torque, variance = np.empty(n), np.empty(n)
        backward(
            samples["time"], states, record, settings, self._F[:end], self._predicted[:end], self._covariance[:end],
            self._P[:end], torque, variance,
        )  # fmt: skip
        out[:, 0], out[:, 1], out[:, first:] = torque, variance, states[:n]
        return out


ESTIMATORS = (RTSSmoother(),)
