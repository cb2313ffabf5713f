"""Joint-dynamics extended Kalman filter: encoders and current through the joint's own equations.

State and laws: `joint_dynamics`. The current is an input, the encoders are the measurements. Three things beyond the
textbook:

* **Counts are cells, not noise** (`quantised`): while the joint rests, equal counts say nothing new.
* **Contacts are rare**: τext walks quietly, and loudly only while the link encoder's innovations are larger than their
  variance (a window of 5 samples); likewise d with the motor encoder (adaptive process noise, Mehra 1972).
* **Jacobian** by forward differences through the compiled step itself, so that friction's sticking and sliding, the knees
  of the stiffness and every known effect are in it.

`dynamics_ekf` takes the record as it is; `dynamics_ekf_calibrating` also estimates stiffness and torque constant, with the
tolerances of a data sheet (7 %, 2 %) as prior: better where the record is wrong, worse where it is right.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np
from numba import njit

from ..errors import FilterDiverged
from ..knobs import Knob
from . import joint_dynamics as model
from .base import Estimator, JointSignals, SensorNoise, TorqueEstimate
from .joint_dynamics import PROCESS_KNOBS, SIZE, STATES, STEPS, ProcessNoise


@njit(cache=True, nogil=True, error_model="numpy")
def predict(x, P, i_now, command, time, dt, ratio, noise, p, F, A, base, y, work):
    """Predict x, shape (SIZE,), and P, shape (m, m), over `dt` [s], in place; F, shape (m, m), receives the Jacobian.

    A: like F; base, y: Shape (SIZE,); work: Shape (3, SIZE): scratch.
    """
    active = noise.active
    m = len(active)
    steps = model.substeps(x, dt, p)
    forget = math.exp(-dt / noise.rule[0])
    for j in range(-1, m):
        y[:] = x
        if j >= 0:
            y[active[j]] += STEPS[active[j]]
        model.advance(y, i_now, command, time, dt, steps, forget, p, work)
        if j < 0:
            base[:] = y
            continue
        for i in range(m):
            F[i, j] = (y[active[i]] - base[active[i]]) / STEPS[active[j]]
    x[:] = base
    model.propagate(F, P, A)
    model.add_noise(P, dt, ratio, noise)


@njit(cache=True, nogil=True, error_model="numpy")
def run(
    time, motor, link, current, record, noise, states, torque, variance, e, S, keep, Fs, predicted, covariance, filtered
):  # fmt: skip
    """Filter n samples; returns n, or the sample at which an estimate was not finite.

    Args:
        time, motor, link, current: Shape (n,).
        states, torque, variance, e, S: outputs, shape (n, SIZE), (n,), (n,), (n, 2), (n, 2).
        keep: whether to fill, for a smoother, Fs, predicted, covariance (of the prediction), filtered (covariance):
            shape (n, m, m), (n, SIZE), (n, m, m), (n, m, m).
    """
    p = record[0]
    m = len(noise.active)
    x, base, y, work = np.zeros(SIZE), np.zeros(SIZE), np.zeros(SIZE), np.zeros((3, SIZE))
    P, F, A = np.zeros((m, m)), np.zeros((m, m)), np.zeros((m, m))
    H, PH, ratio = np.zeros(m), np.zeros(m), np.ones(2)
    model.start(motor[0], link[0], p, x)
    for i in range(m):
        P[i, i] = noise.start[noise.active[i]]
    i_now = current[0]
    for k in range(len(time)):
        if k > 0:
            dt = time[k] - time[k - 1]
            predict(x, P, i_now, current[k], time[k - 1], dt, ratio, noise, p, F, A, base, y, work)
            i_now = model.next_current(i_now, current[k], dt, p)
            if keep:
                Fs[k], predicted[k], covariance[k] = F, x, P
            model.measure(x, P, motor[k], link[k], time[k], ratio, noise, p, e[k], S[k], H, PH)
        if keep:
            filtered[k] = P
        states[k] = x
        torque[k] = model.joint_torque(x, time[k], p)
        variance[k] = model.torque_variance(x, P, torque[k], time[k], p, noise.active, H)
        if not math.isfinite(torque[k] + variance[k]):
            return k
    return len(time)


@dataclass(frozen=True)
class DynamicsEKF(Estimator):
    """Extended Kalman filter on the joint's dynamics; see the module."""

    name: str = "dynamics_ekf"
    process: ProcessNoise = field(default_factory=ProcessNoise)
    costly: ClassVar[bool] = True
    knobs: ClassVar[tuple[Knob, ...]] = PROCESS_KNOBS

    def estimate(self, signals: JointSignals, record: np.ndarray, noise: SensorNoise) -> TorqueEstimate:
        return self._filter(signals, record, noise, False)[0]

    def _filter(self, signals: JointSignals, record: np.ndarray, noise: SensorNoise, keep: bool):
        """The estimate; with `keep` also F, predictions, their covariances, the filtered covariances; and the noise."""
        p = model.known(record)
        arrays = self.process.matrices(signals, p, noise)
        n, m = len(signals.time), len(arrays.active)
        k = n if keep else 0
        states, torque, variance, e, S = model.outputs(n)
        kept = np.zeros((k, m, m)), np.zeros((k, SIZE)), np.zeros((k, m, m)), np.zeros((k, m, m))
        current = model.drive_current(signals, p)
        done = run(
            signals.time, signals.motor_position, signals.link_position, current, record, arrays,
            states, torque, variance, e, S, keep, *kept,
        )  # fmt: skip
        if done < n:
            raise FilterDiverged(self.name, done, signals.time[done], "the estimate is no longer a finite number")
        covariance = S[:, :, None] * np.eye(2)
        return TorqueEstimate(self.name, torque, variance, states, STATES, e, covariance), kept, arrays


ESTIMATORS = (
    DynamicsEKF(),
    DynamicsEKF("dynamics_ekf_calibrating", ProcessNoise(stiffness=0.07, motor_constant=0.02)),
)
