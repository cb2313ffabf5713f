"""Joint-dynamics unscented Kalman filter: as `dynamics_ekf`, with sigma points instead of a Jacobian.

Sigma points x, x ± √((m + κ) P) columns, weights κ/(m + κ), 1/(2(m + κ)) (Julier & Uhlmann 1997), κ = 1. Each goes
through the compiled step, sticking or sliding as it may. The encoders are linear in the state, so the update is the EKF's.
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
from .joint_dynamics import PROCESS_KNOBS, SIZE, STATES, ProcessNoise


@njit(cache=True, nogil=True, error_model="numpy")
def cholesky(P, C):
    """Write the lower factor of P into C, shape (m, m); a direction without variance gets a column of zeros."""
    for j in range(P.shape[0]):
        for i in range(j, P.shape[0]):
            total = P[i, j]
            for l in range(j):
                total -= C[i, l] * C[j, l]
            if i == j:
                C[j, j] = math.sqrt(total) if total > 1e-14 * P[j, j] else 0.0
            else:
                C[i, j] = total / C[j, j] if C[j, j] > 0.0 else 0.0
                C[j, i] = 0.0


@njit(cache=True, nogil=True, error_model="numpy")
def predict(x, P, i_now, command, time, dt, ratio, noise, kappa, p, C, points, work):
    """Predict x, shape (SIZE,), and P, shape (m, m), in place. C: (m, m), points: (2m + 1, SIZE), work: (3, SIZE), scratch."""
    active = noise.active
    m = len(active)
    steps = model.substeps(x, dt, p)
    forget = math.exp(-dt / noise.rule[0])
    cholesky(P, C)
    spread, first, other = math.sqrt(m + kappa), kappa / (m + kappa), 0.5 / (m + kappa)
    for j in range(2 * m + 1):
        points[j] = x
        if j > 0:
            column, sign = (j - 1, spread) if j <= m else (j - 1 - m, -spread)
            for i in range(column, m):
                points[j, active[i]] += sign * C[i, column]
        model.advance(points[j], i_now, command, time, dt, steps, forget, p, work)
    # Means as differences from the first point: the angles are large, their spread is small.
    x[:] = points[0]
    for i in range(m):
        total = 0.0
        for j in range(1, 2 * m + 1):
            total += points[j, active[i]] - points[0, active[i]]
        x[active[i]] += other * total
    for i in range(m):
        for l in range(i + 1):
            a, b = active[i], active[l]
            total = first * (points[0, a] - x[a]) * (points[0, b] - x[b])
            for j in range(1, 2 * m + 1):
                total += other * (points[j, a] - x[a]) * (points[j, b] - x[b])
            P[i, l] = total
            P[l, i] = total
    model.add_noise(P, dt, ratio, noise)


@njit(cache=True, nogil=True, error_model="numpy")
def run(time, motor, link, current, record, noise, kappa, states, torque, variance, e, S):
    """Filter n samples; arguments as of `dynamics_ekf.run`; returns n, or the sample that was not finite."""
    p = record[0]
    m = len(noise.active)
    x, work, points = np.zeros(SIZE), np.zeros((3, SIZE)), np.zeros((2 * m + 1, SIZE))
    P, C, H, PH, ratio = np.zeros((m, m)), np.zeros((m, m)), np.zeros(m), np.zeros(m), np.ones(2)
    model.start(motor[0], link[0], p, x)
    for i in range(m):
        P[i, i] = noise.start[noise.active[i]]
    i_now = current[0]
    for k in range(len(time)):
        if k > 0:
            dt = time[k] - time[k - 1]
            predict(x, P, i_now, current[k], time[k - 1], dt, ratio, noise, kappa, p, C, points, work)
            i_now = model.next_current(i_now, current[k], dt, p)
            model.measure(x, P, motor[k], link[k], time[k], ratio, noise, p, e[k], S[k], H, PH)
        states[k] = x
        torque[k] = model.joint_torque(x, time[k], p)
        variance[k] = model.torque_variance(x, P, torque[k], time[k], p, noise.active, H)
        if not math.isfinite(torque[k] + variance[k]):
            return k
    return len(time)


@dataclass(frozen=True)
class DynamicsUKF(Estimator):
    """Unscented Kalman filter on the joint's dynamics.

    Attributes:
        kappa: κ [1], spread of the sigma points.
    """

    name: str = "dynamics_ukf"
    process: ProcessNoise = field(default_factory=ProcessNoise)
    costly: ClassVar[bool] = True
    knobs: ClassVar[tuple[Knob, ...]] = PROCESS_KNOBS
    kappa: float = 1.0

    def estimate(self, signals: JointSignals, record: np.ndarray, noise: SensorNoise) -> TorqueEstimate:
        p = model.known(record)
        n = len(signals.time)
        states, torque, variance, e, S = model.outputs(n)
        done = run(
            signals.time, signals.motor_position, signals.link_position, model.drive_current(signals, p), record,
            self.process.matrices(signals, p, noise), self.kappa, states, torque, variance, e, S,
        )  # fmt: skip
        if done < n:
            raise FilterDiverged(self.name, done, signals.time[done], "the estimate is no longer a finite number")
        return TorqueEstimate(self.name, torque, variance, states, STATES, e, S[:, :, None] * np.eye(2))


ESTIMATORS = (DynamicsUKF(),)
