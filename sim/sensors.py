"""What the sensors make of the joint's state: sample rate, delay, quantisation, noise.

Every sensor has a random stream of its own, derived from the seed and the sensor's name: adding a sensor, or changing
one, leaves the noise of the others as it was, to the bit.
"""

from __future__ import annotations

import math
import zlib

import numpy as np
from numba import njit

from ..models.joint import Joint

SENSOR = np.dtype([(name, np.float64) for name in ("noise", "step", "delay", "period")])
"""A sensor as one record for compiled code: noise [rms], step of quantisation, delay [s], sample period [s]."""

NAMES = ("motor_position", "link_position", "motor_current", "joint_torque")
WRENCH = ("force_x", "force_y", "force_z", "torque_x", "torque_y", "torque_z")


def sensor_records(joint: Joint, link_delay: float) -> np.ndarray:
    """The joint's sensors as records, shape (5,): `NAMES`, then the wrench (noise of force, torque in `noise`, `step`)."""
    s = joint.sensors
    records = np.zeros(len(NAMES) + 1, SENSOR)
    records[0] = (s.motor_encoder.noise, s.motor_encoder.resolution, s.motor_encoder.delay, 1 / s.motor_encoder.rate)
    records[1] = (s.link_encoder.noise, s.link_encoder.resolution, link_delay, 1 / s.link_encoder.rate)
    for i, analog in ((2, s.motor_current), (3, s.joint_torque)):
        records[i] = (analog.noise, analog.step, analog.delay, 1 / analog.rate)
    records[4] = (s.wrench.force_noise, s.wrench.torque_noise, s.wrench.delay, 1 / s.wrench.rate)
    return records


def noise(seed: int, samples: int) -> np.ndarray:
    """Standard normal noise of every sensor and wrench axis, shape (10, samples): `NAMES`, then `WRENCH`."""
    return np.stack([stream(seed, name).standard_normal(samples) for name in (*NAMES, *WRENCH)])


def stream(seed: int, name: str) -> np.random.Generator:
    """The random stream of that name: independent of all others of the same seed."""
    return np.random.Generator(np.random.PCG64(np.random.SeedSequence([seed, zlib.crc32(name.encode())])))


@njit(cache=True, nogil=True)
def quantise(value, step):
    """Round to a multiple of `step`; 0 leaves the value as it is."""
    return math.floor(value / step + 0.5) * step if step > 0.0 else value


@njit(cache=True, nogil=True)
def sample_tick(k, dt, sensor):
    """Control tick of a sensor's last sample at tick k: k itself, or an earlier one where it is slower than the control."""
    if sensor.period > dt * 1.000001:
        return math.floor(math.floor(k * dt / sensor.period + 1e-9) * sensor.period / dt + 1e-9)
    return k


@njit(cache=True, nogil=True)
def sample(history, k, dt, noise, sensor):
    """What a sensor gives at control tick k.

    Args:
      history: true values at the ticks up to k.
      dt: control period [s]; noise: standard normal, one value a tick; sensor: `SENSOR` record.

    Returns:
      The value at the sensor's last sample instant less its delay (before the start: the first value), with noise,
      quantised. Slower sensors hold their value.
    """
    t = sample_tick(k, dt, sensor)
    back = t - sensor.delay / dt
    if sensor.delay == 0.0:
        value = history[t]
    elif back <= 0.0:
        value = history[0]
    else:
        i = int(back)
        value = history[i] + (back - i) * (history[min(i + 1, t)] - history[i])
    return quantise(value + sensor.noise * noise[t], sensor.step)
