"""Error bands of estimates, from the uncertainty of the joint.

A diagnosed joint states its uncertainty (`models.joint_parts.Uncertainty`). The variance of an estimate is the sum of

* its squared changes along independent directions of the uncertainty (`models.calibration`), one standard deviation
  each. Only the directions with the largest effect on three simple torques (from torsion, from current, the link's own)
  are used: all but `LEFT` of the energy;
* its change under additional sensor noise;
* model discrepancy: an error of current and torsion as large as the unexplained part of the description's own data,
  larger outside the range of these, times the estimator's response to such an error; near rest, friction;
* its difference from a zero-phase estimate of the same signals: its lag, and the disagreement of two kinds of
  sensors;
* its own variance (`Posterior.variance`), if it has one.

Every case repeats the preparation of the recording (zeros, payload, bandwidth). Noise is added at the recording's own
rate; the other changes are smooth and are computed on fewer samples (`RATE`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import TypeVar

import numpy as np
from scipy.ndimage import uniform_filter1d

from ..models.calibration import independent_changes, moved, principal
from ..models.joint import Joint
from ..models.joint_parts import Mounting
from ..models.signals import Signals
from . import registry, smoothed
from .estimator import KnownJoint

SIGMAS = 1.96  # standard deviations of a 95 % band
LEFT = 0.01  # share of the energy of simple torques' changes that may be left out
MOST = 8  # directions at most
RATE = 250.0  # sample rate [Hz] to which a recording is thinned for all changes except noise
_PROBE = 0.005  # test error, in rated torques
_MEMORY = 0.3  # s, correlation time of the test errors
_AVERAGE = 0.5  # s, over which its response to noise is averaged
_EVERY = 10  # grid steps from one sample of the simple torques to the next
_PROBED = 0.1  # test error of the friction
_SEED = 20

Key = TypeVar("Key")
Run = Callable[[Signals, KnownJoint], Mapping[Key, np.ndarray]]
"""Estimates of one segment by any key, shape (n,) each, from its signals and the known joint."""


def deviations(
    estimated: Mapping[Key, np.ndarray],
    signals: Signals,
    known: KnownJoint,
    joint: Joint,
    mounting: Mounting,
    run: Run[Key],
) -> dict[Key, np.ndarray]:
    """Return the standard deviation of every estimate of a segment, shape (n,) each, as `estimated`, what `run` gives
    for its signals. `joint`: the description of what is `known`, in `mounting`."""
    signals, rng = smoothed.in_amperes(signals, known), np.random.default_rng(_SEED)
    time, probes = signals.time, dict[str, float]()
    noisy = _noisier(signals, known, rng)
    few = signals.part(slice(None, None, max(int(_rate(time) / RATE), 1)))
    errors = _errors(signals, known, joint)
    rated, scale = known.rated_torque, float(known.p["N"] * known.p["Kt"])
    cases = [(few, known)]
    if "motor_current" in signals:
        shifted = few["motor_current"] + _wave(few.time, rng) * _PROBE * rated / scale
        probes["current"] = _PROBE * rated
        cases.append((few.with_columns(motor_current=shifted), known))
    if "motor_position" in signals and "link_position" in signals:
        shifted = few["link_position"] - _wave(few.time, rng) * _PROBE * rated / known.p["K1"]
        probes["torsion"] = _PROBE * rated
        cases.append((few.with_columns(link_position=shifted), known))
    probes["friction"] = _PROBED * float(known.p["N"] * known.p["Fc"])
    cases.append((few, known.with_numbers(Fc=(1 + _PROBED) * known.p["Fc"], Fs=(1 + _PROBED) * known.p["Fs"])))
    cases += [(few, replace(known, record=record)) for record in _principal(few, known, joint, mounting)]
    with ThreadPoolExecutor(2) as pool:
        again, base, *done = pool.map(lambda case: run(*case), [(noisy, known), *cases])
    found = {}
    for name, values in estimated.items():
        change = [np.nan_to_num(other.get(name, base[name]) - base[name]) for other in done] if name in base else []
        noise = np.nan_to_num(again.get(name, values) - values)
        variance = _smoothed_square(noise, time)
        for one, (error, size) in zip(change, probes.items(), strict=False):
            gain = float(np.sqrt(np.mean(one**2))) / max(size, 1e-12)
            variance = variance + (gain * errors[error]) ** 2
        by_numbers = sum((one**2 for one in change[len(probes) :]), np.zeros(len(few.time)))
        found[name] = np.sqrt(variance + np.interp(time, few.time, by_numbers))
    return found


def reference_torque(signals: Signals, known: KnownJoint) -> np.ndarray:
    """Return a joint torque without lag [N·m], shape (n,), by prepared signals (`offline.prepare`): from torsion if
    both encoders were read, else from the current."""
    names = ("model", "current_smoothed")
    chosen = next((name for name in names if set(registry.get(name).needs) <= set(signals)), None)
    if chosen is None:
        return np.zeros(len(signals.time))
    return registry.get(chosen).estimate(signals, known).mean


def disagreement(time: np.ndarray, one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Return the root mean square difference of two estimates around every sample, shape (n,)."""
    return np.sqrt(_smoothed_square(one - other, time))


def _smoothed_square(x: np.ndarray, time: np.ndarray) -> np.ndarray:
    """Return the mean square around every sample, shape (n,). The filter's running sum may be slightly negative."""
    samples = max(round(_AVERAGE * _rate(time)), 1)
    return np.maximum(uniform_filter1d(x**2, samples, mode="nearest"), 0.0)


def _rate(time: np.ndarray) -> float:
    return 1.0 / float(np.median(np.diff(time)))


def _principal(signals: Signals, known: KnownJoint, joint: Joint, mounting: Mounting) -> list[np.ndarray]:
    """Return records, shape (1,) each, one standard deviation along each direction with an effect on torques."""
    changes = independent_changes(joint)
    base = _torques(signals, known)
    responses = [_torques(signals, replace(known, record=moved(joint, mounting, c))) - base for c in changes]
    good = [(change, r) for change, r in zip(changes, responses, strict=True) if np.isfinite(r).all()]
    if not good:
        return []
    changes, responses = (list(x) for x in zip(*good, strict=True))
    return [moved(joint, mounting, c) for c in principal(changes, np.stack(responses, axis=1), LEFT, MOST)]


def _torques(signals: Signals, known: KnownJoint) -> np.ndarray:
    """Return torque from torsion without its mean, from current, and the link's own, concatenated at a few samples
    [N·m]."""
    found = []
    motion, load = motion_and_load(signals, known)
    found.append(load[::_EVERY])
    found.append(smoothed.own_torque(motion, known, load)[::_EVERY])
    if all(name in signals for name in registry.get("model").needs):
        torque = registry.get("model").estimate(signals, known).mean
        found.append(np.interp(motion.time[::_EVERY], signals.time, torque - np.mean(torque)))
    return np.concatenate(found)


def motion_and_load(signals: Signals, known: KnownJoint) -> tuple[smoothed.Motion, np.ndarray]:
    """Return the smooth motion of a segment, and the joint torque on the motion's grid [N·m]: from the current, or
    else from the link's weight and inertia."""
    signals = smoothed.in_amperes(signals, known)
    if "motor_position" not in signals:
        signals = signals.with_columns(motor_position=known.p["N"] * signals["link_position"])
    motion = smoothed.smooth_motion(signals, known, smoothed.BANDWIDTHS[-2])
    if "motor_current" in signals:
        return motion, smoothed.torque_from_current(motion, known)
    return motion, smoothed.own_torque(motion, known)


def _errors(signals: Signals, known: KnownJoint, joint: Joint) -> dict[str, np.ndarray]:
    """Return the sizes of errors [N·m at the output], shape (n,) each: of current and torsion beyond the laws, of friction near
    rest."""
    motion, load = motion_and_load(signals, known)
    inflation, stated = np.ones(len(motion.time)), {}
    if joint.uncertainty is not None:
        stated = dict(joint.uncertainty.discrepancy)
        if joint.valid is not None:
            far = joint.valid.distance(motion.link_position, motion.link_velocity, load)
            inflation = 1 + (joint.uncertainty.beyond - 1) * far
    # At rest friction is anything up to its level.
    p = known.p
    near_rest = p["N"] * p["Fs"] / np.sqrt(3) * np.exp(-((motion.motor_velocity / p["vs"]) ** 2))
    scale = float(known.p["N"] * known.p["Kt"])
    current = scale * stated.get("motor_current", 0.0) * inflation
    torsion = max(stated.get("joint_torque", 0.0), stated.get("link_balance", 0.0)) * inflation
    # Torque follows from torsion up to the hysteresis, which may be anything between its ends.
    torsion = np.hypot(torsion, p["hysteresis_torque"] / np.sqrt(3))
    sizes = {"current": current, "torsion": torsion, "friction": near_rest}
    return {name: motion.at(signals.time, size) for name, size in sizes.items()}


def _wave(time: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Return a random error of unit variance with correlation time `_MEMORY`, shape (n,)."""
    from scipy.signal import lfilter  # a third of a second, and 50 MB

    keep = float(np.exp(-1 / (_rate(time) * _MEMORY)))
    noise = np.sqrt(1 - keep**2) * rng.standard_normal(len(time))
    return lfilter([1.0], [1.0, -keep], noise)


def _noisier(signals: Signals, known: KnownJoint, rng: np.random.Generator) -> Signals:
    """Return the signals with additional sensor noise, counts included."""
    s = known.noise
    sizes = {
        "motor_position": np.hypot(s.motor_noise, s.motor_resolution / np.sqrt(12)),
        "link_position": np.hypot(s.link_noise, s.link_resolution / np.sqrt(12)),
        "motor_current": s.current_noise,
    }
    noisy = {
        name: signals[name] + x * rng.standard_normal(len(signals.time)) for name, x in sizes.items() if name in signals
    }
    return signals.with_columns(**noisy)
