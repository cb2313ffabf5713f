"""How far the motion of a recording may be differentiated twice, before its acceleration is noise rather than motion.

Noise of a position grows with the power 5/2 of the passband once it is an acceleration, whatever it comes of: counts, time stamps
times speed, a ripple that the samples do not resolve. It is read off what the position has above a passband. Three things bound
that: noise makes an inertia too small, by its share of the acceleration's power; no motion asks for far more torque than there
was; and a plain regression must not be worse off than with less of the acceleration.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from ..models.recording import Recording
from ..models.signals import POSITIONS
from .motion import CUTOFF, smooth

NOISY = 0.02
"""Share of the acceleration's power that may be noise."""
KNOWN = 8.0
"""Noise of the acceleration as a torque over that of what it is held against, up to which fits of two encoders count it: where
it is that of the sensor as it is described."""
QUIET = 1.0
"""The same, up to which it does no harm with two encoders."""
_BEYOND = 2.0  # times the described noise, up to which it is that
_DESCRIBED_WRONG = 3.0  # times too small an inertia may be described
_AS_GOOD = 1.005  # of the least residual of a regression
_PLAINLY = 0.8  # of the residual below the noise's limit: less of it above shows motion there
_LEAST, _STEPS = 0.5, 32  # passbands that are tried: from so many Hz, so many
_LOWER = 4.0  # times less than the noise allows, down to which a regression chooses
_WINDOW = 4.0  # s of a spectrum
_LONGEST, _SHORTEST, _WINDOWS = 1 << 15, 32, 48  # samples of a window, windows of a long log
_REGRESSED = 1 << 15  # samples, most
_ABOVE = (1.5, 4.0)  # times a passband: where its noise is read off
_WIDTH = 0.418  # what passes the smoother of white noise, twice differentiated: the root of ∫ x⁴/(1+x⁶)² dx
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
    """The highest passband for all encoders of a recording.

    Args:
      recording: n samples; parts: without gaps.
      noise: of one sample, by channel, in its unit; floors: of each encoder as its sensor is described [rad].
      limit: that the rates set [Hz].
      p: parameters of the joint.

    Returns:
      Passband [Hz], and the encoder whose noise sets it; empty where none does.
    """
    limit = min(CUTOFF, limit)
    found, loudest = limit, ""
    tried = np.geomspace(min(_LEAST, limit), limit, _STEPS)
    for name, floor in floors.items():
        spectrum = _spectrum(recording, name, parts)
        if spectrum is None:
            continue
        share, shaken, whole = np.array([_noise_share(*spectrum, f) for f in tried]).T
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
            good &= possible | ~possible.any()  # of a column in another unit nothing is
        own = float(tried[good].max()) if good.any() else float(tried[0])
        if held and len(floors) == 1:
            own = _regressed(recording, name, next(iter(held)), parts, tried[tried >= own / _LOWER], own, float(p["N"]))
        if own < found:
            found, loudest = own, name
    return found, loudest


def _held_against(recording: Recording, name: str, p: np.void) -> dict[str, float]:
    """Channels that an encoder's acceleration is held against, by what one rad/s² is in their unit."""
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


def _windows(recording: Recording, name: str, parts: Sequence[slice], size: int, count: int, step: int) -> list[int]:
    """First samples of windows of a size, every so many samples; of more than `count` those in which an encoder travels most."""
    begins = [b for part in parts for b in range(part.start, part.stop - size + 1, step)]
    if len(begins) > count:
        x = recording[name]
        travel = [float(np.ptp(x[b : b + size : max(size // 64, 1)])) for b in begins]
        begins = sorted(begins[k] for k in np.argsort(travel)[-count:])
    return begins


def _spectrum(recording: Recording, name: str, parts: Sequence[slice]) -> tuple[np.ndarray, np.ndarray] | None:
    """Frequencies [Hz] and power density of a position [rad²/Hz]; None of a recording that is too short."""
    interval = recording.interval
    longest = max((part.stop - part.start for part in parts), default=0)
    size = min(_LONGEST, max(round(_WINDOW / interval), 2 * _SHORTEST), longest // 3)
    if size < _SHORTEST:
        return None
    begins = _windows(recording, name, parts, size, _WINDOWS, max(size // 2, 1))
    window = np.hanning(size - 2)
    total = np.zeros((size - 2) // 2 + 1)
    for b in begins:
        t = recording.time[b : b + size]
        even = np.interp(t[0] + interval * np.arange(size), t, recording[name][b : b + size])
        total += np.abs(np.fft.rfft(window * np.diff(even, 2))) ** 2
    frequency = np.fft.rfftfreq(size - 2, interval)
    gain = (2 * np.sin(np.pi * frequency * interval)) ** 4
    power = 2 * interval * total / (len(begins) * np.sum(window**2))
    return frequency[1:], power[1:] / gain[1:]


def _noise_share(frequency: np.ndarray, power: np.ndarray, cutoff: float) -> tuple[float, float, float]:
    """Of an acceleration up to a passband [Hz]: share of its power that is noise, the noise and the whole [rad/s² rms]. What the
    position has above the passband is taken for noise that it has below, too."""
    above = (frequency > _ABOVE[0] * cutoff) & (frequency < _ABOVE[1] * cutoff)
    if not above.any():
        return 1.0, np.inf, np.inf
    density = float(np.median(power[above]))
    passed = (2 * np.pi * frequency) ** 4 / (1 + (frequency / cutoff) ** 6) ** 2
    width = float(frequency[1] - frequency[0])
    noise, whole = density * float(passed.sum()) * width, float((passed * power).sum()) * width
    return noise / max(whole, 1e-300), float(np.sqrt(noise)), float(np.sqrt(whole))


def _regressed(
    recording: Recording, name: str, y: str, parts: Sequence[slice], tried: np.ndarray, own: float, N: float
) -> float:
    """The highest of some passbands [Hz] at which a regression of a channel on an encoder's motion predicts blocks that it has
    not seen about as well as at any.

    Args:
      own: the highest that the noise allows. What lies above is chosen only where it plainly predicts better: then it is motion.
    """
    longest = max(part.stop - part.start for part in parts)
    size = min(longest, _REGRESSED)
    begins = _windows(recording, name, parts, size, max(_REGRESSED // size, 1), size)
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
    """RMS that is left of y, shape (n,), in folds that a regression on gravity, inertia, friction and an offset has not seen."""
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
