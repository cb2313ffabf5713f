"""Bands of estimates: how far an estimate may be off, by what is not known of the joint.

A joint that a diagnosis has written states how well it is known (`models.joint.Uncertainty`). The variance of an estimate is the
sum of

* its squared changes along independent directions of what is not known (`models.uncertainty`), each a standard deviation off. Few
  directions matter: those of three simple torques (from torsion, from current, the link's own), all but `LEFT` of their energy;
* what the sensors' noise makes of it: its change under noise that is added once more;
* model discrepancy: an error of the current and one of the torsion as large as what the description could not hold in its own
  data, and larger beyond the range of these, times how much of such an error the estimator passes on; near rest, friction;
* how far it is from a zero-phase estimate of the same signals: its lag, and what two kinds of sensors do not agree on;
* what it believes of itself (`Posterior.variance`), where it does.

Whatever is done to a recording before it is estimated (zeros, payload, bandwidth) is done again in each case. Noise is added at
the recording's own rate; what the other changes do is smooth, and is computed on fewer samples (`RATE`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
from scipy.ndimage import uniform_filter1d

from ..models.joint import Joint, Mounting
from ..models.signals import Signals
from ..models.uncertainty import independent_changes, moved, principal
from . import registry, smoothed
from .estimator import KnownJoint

SIGMAS = 1.96
"""Standard deviations of a 95 % band."""
LEFT = 0.01
"""Share of the energy of simple torques' changes that the directions which are left out may have."""
MOST = 8
"""Directions at most."""
RATE = 250.0
"""Samples per second from which on a recording is thinned for all changes but noise [Hz]."""
_PROBE = 0.005  # least error by which an estimator is probed, in rated torques
_MEMORY = 0.3  # s, correlation time of the errors by which it is probed
_AVERAGE = 0.5  # s, over which its response to noise is averaged
_EVERY = 10  # grid steps from one sample of the simple torques to the next
_PROBED = 0.1  # of the friction, by which an estimator is probed
_SEED = 20

Key = TypeVar("Key")
Run = Callable[[Signals, KnownJoint], Mapping[Key, np.ndarray]]
"""Estimates of one segment by whatever names them, shape (n,) each, from its signals and what is known of the joint."""


@dataclass(frozen=True)
class _Errors:
    """Sizes of errors [N·m at the output], shape (n,) each: of current and torsion beyond the laws, of friction near rest."""

    current: np.ndarray
    torsion: np.ndarray
    friction: np.ndarray


def deviations(
    estimated: Mapping[Key, np.ndarray],
    signals: Signals,
    known: KnownJoint,
    joint: Joint,
    mounting: Mounting,
    run: Run[Key],
    threads: int = 2,
) -> dict[Key, np.ndarray]:
    """Standard deviation of every estimate of a segment, shape (n,) each.

    Args:
      estimated: the estimates, shape (n,) each.
      signals: of the segment, n samples.
      known: what estimators know of the joint; joint: its description, in `mounting`.
      run: estimates the segment.
      threads: on which cases are run.
    """
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
    cases.append((few, known.told(Fc=(1 + _PROBED) * known.p["Fc"], Fs=(1 + _PROBED) * known.p["Fs"])))
    cases += [(few, replace(known, record=record)) for record in _principal(few, known, joint, mounting)]
    with ThreadPoolExecutor(threads) as pool:
        again, base, *done = pool.map(lambda case: run(*case), [(noisy, known), *cases])
    found = {}
    for name, values in estimated.items():
        change = [np.nan_to_num(other.get(name, base[name]) - base[name]) for other in done] if name in base else []
        noise = np.nan_to_num(again.get(name, values) - values)
        variance = _smoothed_square(noise, time)
        for one, (error, size) in zip(change, probes.items(), strict=False):
            gain = float(np.sqrt(np.mean(one**2))) / max(size, 1e-12)
            variance = variance + (gain * getattr(errors, error)) ** 2
        by_numbers = sum((one**2 for one in change[len(probes) :]), np.zeros(len(few.time)))
        found[name] = np.sqrt(variance + np.interp(time, few.time, by_numbers))
    return found


def reference_torque(signals: Signals, known: KnownJoint) -> np.ndarray:
    """A joint torque without lag [N·m], shape (n,): from torsion where both encoders were read, from the current else.

    Args:
      signals: made ready (`offline.prepare`).
      known: likewise.
    """
    names = ("model", "current_smoothed")
    chosen = next((name for name in names if set(registry.get(name).needs) <= set(signals)), None)
    if chosen is None:
        return np.zeros(len(signals.time))
    return registry.get(chosen).estimate(signals, known).mean


def disagreement(time: np.ndarray, one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Root mean square difference of two estimates around every sample, shape (n,)."""
    return np.sqrt(_smoothed_square(one - other, time))


def _smoothed_square(x: np.ndarray, time: np.ndarray) -> np.ndarray:
    """Mean square around every sample, shape (n,); the filter's running sum may end a little below zero."""
    return np.maximum(uniform_filter1d(x**2, _samples(time), mode="nearest"), 0.0)


def _samples(time: np.ndarray) -> int:
    """Number of samples over which responses are averaged."""
    return max(round(_AVERAGE * _rate(time)), 1)


def _rate(time: np.ndarray) -> float:
    """Samples per second [Hz]."""
    return 1.0 / float(np.median(np.diff(time)))


def _principal(signals: Signals, known: KnownJoint, joint: Joint, mounting: Mounting) -> list[np.ndarray]:
    """Records, shape (1,) each, a standard deviation off along the directions that matter to torques."""
    changes = independent_changes(joint)
    base = _torques(signals, known)
    responses = [_torques(signals, replace(known, record=moved(joint, mounting, c))) - base for c in changes]
    good = [i for i, r in enumerate(responses) if np.isfinite(r).all()]
    kept = (
        principal([changes[i] for i in good], np.stack([responses[i] for i in good], axis=1), LEFT, MOST)
        if good
        else []
    )
    return [moved(joint, mounting, change) for change in kept]


def _torques(signals: Signals, known: KnownJoint) -> np.ndarray:
    """Torque from torsion without its mean, from current, and the link's own, one after another at a few samples [N·m]."""
    found = []
    motion, load = motion_and_load(signals, known)
    found.append(load[::_EVERY])
    found.append(smoothed.own_torque(motion, known, load)[::_EVERY])
    if all(name in signals for name in registry.get("model").needs):
        torque = registry.get("model").estimate(signals, known).mean
        found.append(np.interp(motion.time[::_EVERY], signals.time, torque - np.mean(torque)))
    return np.concatenate(found)


def motion_and_load(signals: Signals, known: KnownJoint) -> tuple[smoothed.Motion, np.ndarray]:
    """Smooth motion of a segment, and the torque that the joint gives its link on the motion's grid [N·m]: from the current, or
    without one what the link's weight and inertia ask for."""
    signals = smoothed.in_amperes(signals, known)
    if "motor_position" not in signals:
        signals = signals.with_columns(motor_position=known.p["N"] * signals["link_position"])
    motion = smoothed.smooth_motion(signals, known, smoothed.BANDWIDTHS[-2])
    if "motor_current" in signals:
        return motion, smoothed.torque_from_current(motion, known)
    return motion, smoothed.own_torque(motion, known, np.zeros(len(motion.time)))


def _errors(signals: Signals, known: KnownJoint, joint: Joint) -> _Errors:
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
    return _Errors(*(motion.at(signals.time, x) for x in (current, torsion, near_rest)))


def _wave(time: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """A random error of unit variance that forgets in `_MEMORY`, shape (n,)."""
    from scipy.signal import lfilter  # a third of a second, and 50 MB

    keep = float(np.exp(-1 / (_rate(time) * _MEMORY)))
    noise = np.sqrt(1 - keep**2) * rng.standard_normal(len(time))
    return lfilter([1.0], [1.0, -keep], noise)


def _noisier(signals: Signals, known: KnownJoint, rng: np.random.Generator) -> Signals:
    """The signals with the sensors' noise, counts included, added once more."""
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
