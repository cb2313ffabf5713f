"""The passband up to which a recording's motion may be differentiated twice, before the acceleration is mostly noise.

Noise of a position grows with the power 5/2 of the passband in the acceleration, whatever its source: counts, time
stamps times speed, unresolved ripple. It is read off the position's spectrum above a passband. Three limits bound it:
noise makes an inertia too small, by its share of the acceleration's power; no motion needs far more torque than was
measured; and a plain regression must not predict worse than with a lower passband.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from ..models.motion import CUTOFF, NOISY, candidates, noise_share, smooth, spectrum, windows
from ..models.recording import Recording
from ..models.signals import POSITIONS

KNOWN = 8.0
"""Largest noise of the acceleration as a torque, over the noise of the torque, if it is the described sensor noise:
fits of two encoders then account for it."""
QUIET = 1.0  # the same, at which it does no harm with two encoders
_BEYOND = 2.0  # largest noise over the described noise
_DESCRIBED_WRONG = 3.0  # largest factor by which a described inertia may be too small
_AS_GOOD = 1.005  # of the least residual of a regression
_PLAINLY = 0.8  # residual ratio that shows motion above the noise's limit
_LOWER = 4.0  # the regression tries passbands down to the noise's limit over this
_REGRESSED = 1 << 15  # samples, most
_WIDTH = 0.418  # rms of white noise, twice differentiated, after the smoother: the root of ∫ x⁴/(1+x⁶)² dx
_FOLDS, _BLOCKS, _BLOCK = 6, 24, 0.5  # folds, blocks at least, s
_CRAWLING = 0.02  # of the rms speed, within which friction changes its sign


def highest(
    recording: Recording,
    parts: Sequence[slice],
    noise: Mapping[str, float],
    floors: Mapping[str, float],
    limit: float,
    p: np.void,
) -> tuple[float, str]:
    """Return the highest passband [Hz] for all encoders of a recording, and the encoder whose noise limits it, if one
    does. `parts`: without gaps; `noise`: of one sample, by channel, in its unit; `floors`: of each encoder as described
    [rad]; `limit`: by the rates [Hz]."""
    limit = min(CUTOFF, limit)
    found, loudest = limit, ""
    tried = candidates(limit)
    for name, floor in floors.items():
        power = spectrum(recording.time, recording[name], recording.interval, parts)
        if power is None:
            continue
        share, shaken, whole = np.array([noise_share(*power, f) for f in tried]).T
        held = _held_against(recording, name, p)
        good = share <= NOISY
        if len(floors) == len(POSITIONS):
            white = floor * np.sqrt(2 * recording.interval) * (2 * np.pi) ** 2 * _WIDTH * tried**2.5
            passed = np.sqrt(2 * tried * recording.interval)
            loud = np.max(
                [shaken * inertia / (noise[y] * passed + 1e-300) for y, inertia in held.items()], axis=0, initial=0.0
            )
            good |= (loud <= QUIET) | (loud <= KNOWN) & (shaken <= _BEYOND * white)
        for y, inertia in held.items():
            possible = inertia * whole <= _DESCRIBED_WRONG * np.sqrt(np.mean(recording[y] ** 2))
            good &= possible | ~possible.any()  # no passband is possible for a column in another unit
        own = float(tried[good].max()) if good.any() else float(tried[0])
        if held and len(floors) == 1:
            own = _regressed(recording, name, next(iter(held)), parts, tried[tried >= own / _LOWER], own, float(p["N"]))
        if own < found:
            found, loudest = own, name
    return found, loudest


def _held_against(recording: Recording, name: str, p: np.void) -> dict[str, float]:
    """Return the channels that an encoder's acceleration is compared with, with the factor from rad/s² to their unit."""
    rotor, link, N, Kt = float(p["Jm"] + p["Jw"]), float(p["Jl"]), float(p["N"]), float(p["Kt"])
    both = all(n in recording for n in POSITIONS)
    found = {}
    if "motor_current" in recording and not (both and name == "link_position"):
        found["motor_current"] = (
            (rotor if both else rotor + link / N**2) / Kt * (1.0 if name == "motor_position" else N)
        )
    if "joint_torque" in recording and not (both and name == "motor_position"):
        found["joint_torque"] = link / (N if name == "motor_position" else 1.0)
    return found


def _regressed(
    recording: Recording, name: str, y: str, parts: Sequence[slice], tried: np.ndarray, own: float, N: float
) -> float:
    """Return the highest passband [Hz] at which a regression of a channel on an encoder's motion predicts held-out
    blocks about as well as at any. `own`: the highest that the noise allows; a higher one is chosen only if it clearly
    predicts better: then it is motion."""
    longest = max(part.stop - part.start for part in parts)
    size = min(longest, _REGRESSED)
    begins = windows(recording[name], parts, size, max(_REGRESSED // size, 1), size)
    block_time = min(_BLOCK, float(recording.time[-1] - recording.time[0]) / _BLOCKS)
    left, ratio, load = [], 1.0 if name == "link_position" else 1 / N, recording.load
    for cutoff in tried:
        columns, values, block = [], [], []
        for b in begins:
            time = recording.time[b : b + size]
            s = smooth(time, recording[name][b : b + size, None], recording.interval, float(cutoff))
            x, v, a = (np.interp(time, s.time, z[:, 0]) for z in (s.value, s.rate, s.acceleration))
            known = [] if load is None else [load.torque[b : b + size], load.inertia[b : b + size] * a * ratio]
            columns.append(np.column_stack([x * ratio, v, a, *known]))
            values.append(recording[y][b : b + size])
            block.append(np.floor((time - recording.time[0]) / block_time).astype(int))
        left.append(_left(np.concatenate(columns), np.concatenate(values), np.concatenate(block) % _FOLDS))
    found, below = np.array(left), tried <= own
    good = below if found.min() > _PLAINLY * found[below].min() else np.ones(len(tried), bool)
    return float(tried[good & (found <= _AS_GOOD * found[good].min())].max())


def _left(motion: np.ndarray, y: np.ndarray, fold: np.ndarray) -> float:
    """Return the RMS residual of y, shape (n,), in held-out folds of a regression on gravity, inertia, friction and
    an offset."""
    (x, v, a), known = motion.T[:3], motion.T[3:]
    crawling = _CRAWLING * np.sqrt(np.mean(v**2)) + 1e-300
    columns = np.column_stack([np.sin(x), np.cos(x), a, v, np.tanh(v / crawling), np.ones(len(x)), *known])
    columns /= np.sqrt(np.mean(columns**2, axis=0)) + 1e-300
    total = 0.0
    gram = [(columns[k].T @ columns[k], columns[k].T @ y[k]) for k in (fold == i for i in range(_FOLDS))]
    ridge = 1e-9 * len(y) * np.eye(columns.shape[1])
    for i in range(_FOLDS):
        rest = [g for j, g in enumerate(gram) if j != i]
        found = np.linalg.solve(sum(g for g, _ in rest) + ridge, sum(h for _, h in rest))
        here = fold == i
        total += float(np.sum((y[here] - columns[here] @ found) ** 2))
    return float(np.sqrt(total / len(y)))
