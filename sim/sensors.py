"""Sensors: sample rate, delay, bandwidth, noise, quantisation, imperfections.

Every channel has its own random streams, by the seed and the channel's name. A new or changed sensor leaves the noise
of the others unchanged, to the bit.
"""

from __future__ import annotations

import math
import zlib
from typing import Any

import numpy as np

from ..models.joint import Joint
from ..models.joint_parts import AnalogSpec, EncoderSpec, WrenchSpec
from ..models.kernels import kernel
from ..models.parameters import floats
from ..models.signals import CHANNELS, READINGS, SENSED

SENSOR = floats(
    "step", "delay", "period", "pass_now", "pass_before", "at_step", "ripple_order", "ripple_amplitude", "ripple_phase",
    "crosstalk", "cyclic_error",
)  # fmt: skip
"""A sensor as one record for compiled code: step of quantisation, delay [s], sample period [s], its low-pass
(`low_pass`; 1 and 0 without one), whether it is read after the plant's step, ripple over the motor's angle,
crosstalk (amplitude over the cosine of the link's angle), error within four counts [rad]."""
_CYCLE = 4  # counts of an incremental encoder in one line of its disc


def sensor_records(joint: Joint, link_delay: float, dt: float) -> np.ndarray:
    """Return the joint's sensors as records, shape (channels,), in the order of `signals.SENSED`; `dt`: control
    period [s].

    `link_delay`: delay of the link encoder against the motor's [s], a number of the parameter record that a cause may
    change.
    """
    records = np.zeros(len(SENSED), SENSOR)
    for i, name in enumerate(SENSED):
        spec, r = joint.sensors.of(CHANNELS[name]), records[i]
        r["delay"], r["period"], r["pass_now"] = spec.delay, 1 / spec.rate, 1.0
        r["at_step"] = CHANNELS[name].at_step
        if isinstance(spec, EncoderSpec):
            r["step"] = spec.resolution
            r["cyclic_error"] = spec.cyclic_error * spec.resolution
        elif isinstance(spec, AnalogSpec):
            r["step"], r["crosstalk"] = spec.step, spec.crosstalk
            if spec.bandwidth is not None:
                r["pass_now"], r["pass_before"] = _pass(2 * math.pi * spec.bandwidth * dt)
            if spec.ripple is not None:
                r["ripple_order"], r["ripple_amplitude"] = spec.ripple.order, spec.ripple.amplitude
                r["ripple_phase"] = spec.ripple.phase
    records[SENSED.index("link_position")]["delay"] = joint.sensors.motor_encoder.delay + link_delay
    return records


def _pass(x: float) -> tuple[float, float]:
    """Return the shares of a first-order low-pass of its input now and before; `x`: cut-off frequency [rad/s] times
    interval [s].

    Exact for a piecewise linear input (ramp invariance): y = e^−x y + … .
    """
    share = -math.expm1(-x)
    return 1 - share / x, share / x - 1 + share


def noise(joint: Joint, seed: int, samples: int, dt: float) -> np.ndarray:
    """Return the noise of every channel in its unit, shape (samples,), records of `signals.READINGS`; `dt`: control
    period [s]."""
    found = np.zeros(samples, READINGS)
    for name in SENSED:
        spec = joint.sensors.of(CHANNELS[name])
        if isinstance(spec, WrenchSpec):
            white = spec.force_noise if name.startswith("force") else spec.torque_noise
        else:
            white = spec.noise
        if white > 0.0:
            found[name] = white * stream(seed, name).standard_normal(samples)
        if isinstance(spec, AnalogSpec) and spec.flicker > 0.0:
            found[name] += spec.flicker * flicker(samples, stream(seed, f"{name} flicker"))
        if isinstance(spec, AnalogSpec) and spec.vibration is not None:
            phase = stream(seed, f"{name} vibration").uniform(0.0, 2 * np.pi)
            angle = 2 * np.pi * spec.vibration.frequency * dt * np.arange(samples) + phase
            found[name] += math.sqrt(2.0) * spec.vibration.amplitude * np.sin(angle)
    return found


def flicker(samples: int, rng: np.random.Generator) -> np.ndarray:
    """Return noise of unit variance with a power of 1/f, shape (samples,): white noise, shaped in its spectrum."""
    spectrum = np.fft.rfft(rng.standard_normal(samples))
    shape = np.arange(len(spectrum), dtype=np.float64)
    shape[0] = np.inf
    x = np.fft.irfft(spectrum / np.sqrt(shape), samples)
    spread = float(np.std(x))
    return x / spread if spread > 0.0 else x


def wrench_crosstalk(joint: Joint, seed: int) -> np.ndarray:
    """Return the crosstalk of the wrench's axes, shape (6, 6), zero on the diagonal; another sensor for each seed.

    A share, uniform within ± the stated one, of each axis' load relative to its rated one.
    """
    spec = joint.sensors.wrench
    rated = np.repeat([spec.rated_force, spec.rated_torque], 3)
    share = spec.crosstalk * stream(seed, "wrench crosstalk").uniform(-1.0, 1.0, (6, 6))
    np.fill_diagonal(share, 0.0)
    return share * rated[:, None] / rated[None, :]


def time_stamps(time: np.ndarray, jitter: float, seed: int) -> np.ndarray:
    """Return times [s], shape (n,), of a clock with a jitter of `jitter` [s rms]; they still increase."""
    return time if jitter == 0.0 else jittered(time, jitter, stream(seed, "jitter"))


def jittered(time: np.ndarray, jitter: float, rng: np.random.Generator) -> np.ndarray:
    """Return evenly spaced times [s], shape (n,), with an error of `jitter` [s rms] each, less than half a step."""
    step = float(np.median(np.diff(time)))
    return time + np.clip(jitter * rng.standard_normal(len(time)), -0.45 * step, 0.45 * step)


def realistic(joint: Joint) -> dict[str, Any]:
    """Return changes of a joint's sensors to realistic ones, in proportion to the joint; stated imperfections stay.

    Encoders with a cyclic error of 0.2 counts per line; a current sensor behind an ADC of 12 bits over ± the current
    limit, with a ripple of 0.5 % of it (Maxon and drive makers state 0.3 to 1 %); a torque sensor and a wrench with 1
    % of crosstalk (datasheets of six-axis sensors: 1 to 2 % of the rated load).
    """
    limit, s = joint.numbers["current_limit"].value, joint.sensors
    found: dict[str, Any] = {"motor_current": {}, "joint_torque": {}, "wrench": {}}
    for name in ("motor_encoder", "link_encoder"):
        found[name] = {} if getattr(s, name).cyclic_error else {"cyclic_error": 0.2}
    if s.motor_current.step == 0.0:
        found["motor_current"]["step"] = 2.0 * limit / 2**12
    if s.motor_current.ripple is None:
        found["motor_current"]["ripple"] = {"order": 14, "amplitude": 0.005 * limit}
    if s.joint_torque.crosstalk == 0.0:
        found["joint_torque"]["crosstalk"] = 0.01 * joint.mount().gravity_moment
    if s.wrench.crosstalk == 0.0:
        found["wrench"]["crosstalk"] = 0.01
    return found


def stream(seed: int, name: str) -> np.random.Generator:
    """Return the random stream of that name, independent of all others of the same seed."""
    return np.random.Generator(np.random.PCG64(np.random.SeedSequence([seed, zlib.crc32(name.encode())])))


@kernel
def quantise(value, step):
    """Round to a multiple of `step`; 0 does not round."""
    return math.floor(value / step + 0.5) * step if step > 0.0 else value


@kernel
def sample_tick(k, dt, sensor):
    """Return the control tick of a sensor's last sample at tick k: k, or an earlier one of a slower sensor."""
    if sensor.period > dt * 1.000001:
        return math.floor(math.floor(k * dt / sensor.period + 1e-9) * sensor.period / dt + 1e-9)
    return k


@kernel
def distort(value, motor_position, link_position, sensor):
    """Return a value [its unit] with a sensor's ripple, crosstalk and error within counts."""
    if sensor.ripple_amplitude != 0.0:
        value += sensor.ripple_amplitude * math.sin(sensor.ripple_order * motor_position + sensor.ripple_phase)
    if sensor.crosstalk != 0.0:
        value += sensor.crosstalk * math.cos(link_position)
    if sensor.cyclic_error != 0.0:
        value += sensor.cyclic_error * math.sin(2.0 * math.pi * value / (_CYCLE * sensor.step))
    return value


@kernel
def low_pass(value, value_before, passed_before, sensor):
    """Return the output of a sensor's first-order low-pass, from its input now and a control period before, and its
    output before."""
    if sensor.pass_now == 1.0:
        return value
    return (
        passed_before + sensor.pass_now * (value - passed_before) + sensor.pass_before * (value_before - passed_before)
    )


@kernel
def sample(history, k, dt, noise, sensor):
    """Return a sensor's value at control tick `k`, by true values at the ticks up to k: that of its last sample instant
    less its delay (before the start: the first), with noise of each tick, quantised. Slower sensors hold their value.
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
    return quantise(value + noise[t], sensor.step)
