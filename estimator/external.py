"""External torque on the link from any estimate of the joint torque: the link's momentum observer (De Luca & Mattone,
"Sensorless robot collision detection and hybrid force/motion control", ICRA 2005; for an elastic joint with known
torque: De Luca, Albu-Schäffer, Haddadin & Hirzinger, IROS 2006, Eq. 14). With the link's momentum p = Jl·ωl and p'
= Ts + own torques + τext

    r = K (p − p(0) − ∫ (T̂ + own torques + r) dt)        so that  r' = K (τext + Ts − T̂ − r)

The residual r is the external torque plus the estimate's error, behind a first-order low-pass of K/2π Hz.
"""

from __future__ import annotations

import math

import numpy as np

from ..models import dynamics
from ..models.errors import InputError
from ..models.kernels import kernel
from ..models.signals import Signals
from .estimator import KnownJoint
from .sensing import LOWPASS, lowpass

BANDWIDTH, CUTOFF = 20.0, 40.0
"""Of the observer, and of the low-pass of the link's velocity [Hz]: those of the estimator `momentum`."""


def external_torque(
    signals: Signals, torque: np.ndarray, joint: KnownJoint, bandwidth: float = BANDWIDTH, cutoff: float = CUTOFF
) -> np.ndarray:
    """Return the external torque on the link [N·m], shape (n,), by an estimate of the joint torque [N·m]. The signals
    have both positions, and `arm_torque`, of other joints of an arm on the link [N·m], if there is any. `bandwidth`: of
    the observer [Hz]; `cutoff`: of the link velocity's low-pass [Hz]. Raises `InputError`: a torque of another length.
    """
    if np.shape(torque) != signals.time.shape:
        raise InputError(f"external torque: expected a torque of shape {signals.time.shape}, got {np.shape(torque)}")
    out = np.zeros(len(signals.time))
    arm = signals["arm_torque"] if "arm_torque" in signals else np.zeros(len(out))
    _observe(
        joint.since(signals.time), signals["motor_position"], signals["link_position"],
        np.ascontiguousarray(torque, dtype=np.float64), arm, joint.record, 2 * math.pi * bandwidth, 2 * math.pi * cutoff, out,
    )  # fmt: skip
    return out


def lowpassed(time: np.ndarray, values: np.ndarray, cutoff: float) -> np.ndarray:
    """Return a signal behind the Butterworth low-pass of `sensing.lowpass`: value, rate and acceleration, shape (n, 3)."""
    return _lowpassed(time, np.ascontiguousarray(values, dtype=np.float64), 2 * math.pi * cutoff)


@kernel
def _lowpassed(time, values, cutoff):
    out, m = np.zeros((len(time), 3)), np.zeros(1, LOWPASS)[0]
    for k in range(len(time)):
        lowpass(m, values[k], time[k] - time[k - 1] if k > 0 else 0.0, cutoff)
        out[k, 0], out[k, 1], out[k, 2] = m.value, m.rate, m.acceleration
    return out


@kernel
def _observe(time, motor, link, torque, arm, record, gain, cutoff, out):
    p = record[0]
    velocity, total, residual = 0.0, 0.0, 0.0
    before = dynamics.actual_link_position(link[0], motor[0], 0.0, time[0], p)
    for k in range(1, len(time)):
        h = time[k] - time[k - 1]
        position = dynamics.actual_link_position(link[k], motor[k], p.N * velocity, time[k], p)
        velocity += (1.0 - math.exp(-cutoff * h)) * ((position - before) / h - velocity)
        before = position
        state = dynamics.drive_state(
            motor[k], p.N * velocity, position, velocity, dynamics.UNREAD, dynamics.UNREAD, time[k], dynamics.UNREAD
        )
        total += h * (torque[k] + dynamics.link_torque(state, torque[k], p) + arm[k])
        residual = gain * (p.Jl * velocity - total) / (1.0 + gain * h)  # implicit in r: stable at any gain
        total += h * residual
        out[k] = residual
