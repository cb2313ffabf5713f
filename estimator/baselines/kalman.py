"""Standard Kalman filter on the compliance model with a constant-rate torque: states torque and its rate.

    x = [T, T']     F = [[1, h], [0, 1]]     W = q·[[h³/3, h²/2], [h²/2, h]]     y = T + v,  v ~ (0, V)

the continuous white-noise-acceleration model (Bar-Shalom, Li & Kirubarajan 2001, section 6.2). The other torque filters of
this folder share the model and differ in their gain.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numba import njit

from ..knobs import Knob
from .base import Estimator, JointSignals, SensorNoise, TorqueEstimate
from .compliance_model import compliance_measurement

STATES = ("torque", "torque_rate")
ACCELERATION = Knob("acceleration", 1e-3, 1e3)


@njit(cache=True, nogil=True, error_model="numpy")
def predict(x, P, h, q):
    """Predict x, shape (2,), and P, shape (2, 2), over `h` [s], in place; q [(N·m)²/s³]."""
    x[0] += h * x[1]
    P[0, 0] += h * (2.0 * P[0, 1] + h * P[1, 1]) + q * h**3 / 3.0
    P[0, 1] += h * P[1, 1] + q * h**2 / 2.0
    P[1, 0] = P[0, 1]
    P[1, 1] += q * h


@njit(cache=True, nogil=True, error_model="numpy")
def correct(x, P, e, V):
    """Update with the innovation `e` [N·m] of a measurement with variance V, in place; returns its variance S."""
    S = P[0, 0] + V
    k0, k1 = P[0, 0] / S, P[1, 0] / S
    x[0] += k0 * e
    x[1] += k1 * e
    P[1, 1] -= k1 * P[0, 1]
    P[0, 1] *= 1.0 - k0
    P[1, 0] = P[0, 1]
    P[0, 0] *= 1.0 - k0
    return S


@njit(cache=True, nogil=True, error_model="numpy")
def run(time, y, q, V, x, P, states, variance, e, S):
    """Filter y, shape (n,), from x, P; outputs: shape (n, 2), (n,), (n,), (n,)."""
    for k in range(len(y)):
        if k > 0:
            predict(x, P, time[k] - time[k - 1], q)
            e[k] = y[k] - x[0]
            S[k] = correct(x, P, e[k], V)
        states[k] = x
        variance[k] = P[0, 0]


@dataclass(frozen=True)
class TorqueFilter(Estimator):
    """A filter of the compliance model's torque with the constant-rate model.

    Attributes:
        acceleration: intensity √q of the torque's second derivative [T2/s² per √Hz]. The steady filter's natural frequency
            is (q/(V·h))^(1/4): with 10·12 N·m and V = 0.05² at 1 kHz, 274 rad/s.
        rate: standard deviation of the first rate [T2/s].
    """

    name: str = "kalman"
    acceleration: float = 10.0
    rate: float = 1.0
    knobs: ClassVar[tuple[Knob, ...]] = (ACCELERATION,)

    def estimate(self, signals: JointSignals, record: np.ndarray, noise: SensorNoise) -> TorqueEstimate:
        y, V = compliance_measurement(signals, record, noise)
        scale = float(record[0]["T2"])
        n = len(y)
        states, variance, e, S = np.zeros((n, 2)), np.zeros(n), np.zeros(n), np.zeros(n)
        x, P = np.array([y[0], 0.0]), np.diag([V, (self.rate * scale) ** 2])
        self._run(signals.time, y, (self.acceleration * scale) ** 2, V, x, P, states, variance, e, S)
        return TorqueEstimate(self.name, states[:, 0].copy(), variance, states, STATES, e[:, None], S[:, None, None])

    def _run(self, time, y, q, V, x, P, states, variance, e, S) -> None:
        run(time, y, q, V, x, P, states, variance, e, S)


ESTIMATORS = (TorqueFilter(),)
