"""Encoders that are slower than the log: their readings are held for a number of samples, while the other end moves on."""

from __future__ import annotations

import numpy as np

from ..models.signals import Signals
from .estimator import KnownJoint

FEWEST = 200  # changes of a reading below which nothing is said
HELD = 0.9  # share of the changes that must be so many samples apart, or a multiple of that
_MANY = 4.0  # counts by which an encoder that is held goes on at a time


def held_for(reading: np.ndarray, resolution: float) -> int:
    """Samples for which an encoder's reading, shape (n,), is held; 1 where it is not.

    It stays where it is at rest, and counts at regular times at one speed: what says that it is held are steps of many counts, at
    times that are multiples of one.

    Args:
      resolution: of the encoder, in the reading's unit.
    """
    steps = np.diff(reading)
    at = np.flatnonzero(steps != 0.0)
    apart = np.diff(at)
    if len(apart) < FEWEST:
        return 1
    samples = max(int(np.percentile(apart, 5)), 1)
    steady = float(np.mean(apart % samples == 0)) > HELD
    return samples if steady and float(np.median(np.abs(steps[at]))) > _MANY * resolution else 1


def moved_on(signals: Signals, joint: KnownJoint) -> Signals:
    """The signals with an encoder that is held moved on as the other one says: the torsion is held instead of an angle.

    An angle that is 8 ms old is a torsion of newton metres where the joint turns; a torsion that is 8 ms old is late.
    """
    N, noise = float(joint.p["N"]), joint.noise
    motor, link = signals["motor_position"], signals["link_position"]
    if (k := held_for(link, noise.link_resolution)) > 1:
        fresh = _last_fresh(link, k)
        return signals.with_columns(link_position=link + (motor - motor[fresh]) / N)
    if (k := held_for(motor, noise.motor_resolution)) > 1:
        fresh = _last_fresh(motor, k)
        return signals.with_columns(motor_position=motor + N * (link - link[fresh]))
    return signals


def _last_fresh(reading: np.ndarray, samples: int) -> np.ndarray:
    """Index of the sample at which each reading was read, shape (n,)."""
    first = int(np.flatnonzero(np.diff(reading) != 0.0)[0] + 1) % samples
    at = np.arange(len(reading))
    return np.maximum(at - (at - first) % samples, 0)
