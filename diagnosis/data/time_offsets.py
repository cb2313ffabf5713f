"""Find columns with a time offset, from each relation between two columns at every shift of one against the other.

    motor and link encoder     θm/N − θl is wind-up: a sum of known shapes of the motion
    drive and each encoder     N Kt i is gravity, inertia and friction: shapes of that encoder's motion
    torque and each encoder    Ts is gravity and inertia, likewise

With motion in one direction a delay looks like another angle: only angles passed in both directions count. The shapes have
free coefficients; the unexplained part at each shift measures the fit. A late column shifts all of its relations and no other,
which identifies it. Ordinary delays of encoders, sensors and filters are not mistakes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...models.joint import Joint
from ...models.motion import smooth
from ...models.recording import Recording
from ...models.signals import DRIVING, POSITIONS
from .changes import Mistake, probability
from .stretches import shortened


@dataclass(frozen=True)
class TimeOffsetSettings:
    """When a column is late. Set on `benchmarks/mistakes.py`."""

    step: float = 5e-3  # of shifts that are tried, and between samples [s]
    farthest: float = 0.3  # largest shift [s]
    cutoff: float = 12.0  # of the smoother [Hz]
    bin: float = 4e-3  # over which samples are averaged before [s]
    # effective samples of a relation per second, and at most per recording
    effective: tuple[float, float] = (6.0, 60.0)
    sure: float = 7.0  # gain in log likelihood from which on a column is late
    worse: float = -3.0  # loss in a recording from which on not all have it
    one_of_several: float = 12.0  # more gain that it takes where not all have it
    # added gain per second beyond `near`
    far_off: float = 300.0
    near: float = 0.03  # [s]
    sliding: float = 2.5  # Stribeck velocities above which friction is known by its direction
    hats: int = 24  # pieces of the angle, whose functions gravity, cables, stops and the like are
    longest: float = 600.0  # of a recording, the most informative part [s]
    fewest: int = 200  # samples that a relation takes
    most: int = 2500  # samples that are looked at
    # least residual of a relation of positions, of current or motor torque, and of joint torque, over its value at rated torque:
    # the shapes are not more accurate
    wind_up: float = 0.1
    drive: float = 0.01  # likewise
    torque: float = 0.001  # likewise
    side: float = 0.03  # distance from the best shift [s] at which it must be worse by `peaked`
    peaked: float = 4.0  # in log likelihood
    # by how much the link encoder is late in sound data, by `encoder_delay`, sensors and filters [s]
    ordinary_link: tuple[float, float] = (-2e-3, 14e-3)
    ordinary: tuple[float, float] = (-2e-3, 5e-3)  # the same of all other columns [s]
    # least gain in log likelihood of the encoders' relation for a late encoder: unmeasured effects disturb all other relations
    between: float = 2.0
    travel: float = 0.05  # of the link, below which motion says nothing [rad]
    moving: float = 0.02  # speed over the largest from which on the link goes somewhere
    alone: float = 3.0  # times `sure`: threshold of a single relation
    fits: float = 0.08  # residual over spread of a drive's torque that fits; twice as much for other relations
    alike: float = 0.2  # gain of either encoder's relation over the mean, where a torque is late
    # least share of time in motion to compare a drive's torque with the motion
    goes: float = 0.25


SETTINGS = TimeOffsetSettings()


@dataclass(frozen=True)
class _Relation:
    """Log likelihood lost at each shift of the second column against the first, shape (d,), and whether the residual fits."""

    first: str
    second: str
    left: np.ndarray
    fits: np.ndarray


_REACH = round(SETTINGS.farthest / SETTINGS.step)
_SHIFTS = SETTINGS.step * np.arange(-_REACH, _REACH + 1)
_ORDINARY = dict.fromkeys((*POSITIONS, *DRIVING), SETTINGS.ordinary) | {"link_position": SETTINGS.ordinary_link}


def late_columns(recordings: Sequence[Recording], joint: Joint) -> tuple[tuple[Mistake, tuple[int, ...]], ...]:
    """Find the late columns of a measurement without other mistakes, each with its recordings by index."""
    relations = [_relations(recording, joint) for recording in recordings]
    best = _latest([r for found in relations for r in found])
    found: dict[str, list[tuple[int, float, float]]] = {}
    if best is not None and all(_gain(some, *best[:2]) >= SETTINGS.worse for some in relations):
        found[best[0]] = [(i, best[1], best[2] / len(relations)) for i in range(len(relations))]
    elif len(recordings) > 1:
        for i, some in enumerate(relations):
            name, seconds, gain = _latest(some) or ("", 0.0, 0.0)
            far = SETTINGS.far_off * max(abs(seconds) - SETTINGS.near, 0.0)
            if gain > SETTINGS.sure + SETTINGS.one_of_several + far:
                found.setdefault(name, []).append((i, seconds, gain))
    late = []
    for name, mine in found.items():
        having, offsets, gains = zip(*mine, strict=True)
        seconds = float(np.median(offsets))
        text, sure = f"{1e3 * seconds:.3g} ms later than the others", probability(sum(gains) - SETTINGS.sure)
        late.append((Mistake("late", name, "", text, sure, seconds=seconds), having))
    return tuple(late)


def _latest(relations: list[_Relation]) -> tuple[str, float, float] | None:
    """Return the time offset that explains most: column, offset [s] and gain."""
    pairs = [r for r in relations if r.second in POSITIONS]
    tried = [
        (_gain(relations, name, d), name, d)
        for name in sorted({name for r in relations for name in (r.first, r.second)})
        for d in _SHIFTS[_SHIFTS > _ORDINARY[name][1]].tolist()
        if not pairs or name not in POSITIONS or _gain(pairs, name, d) >= SETTINGS.between
    ]
    if not tried:
        return None
    gain, name, d = max(tried, key=lambda one: one[0])
    mine = [r for r in relations if name in (r.first, r.second)]
    if gain < SETTINGS.sure * (SETTINGS.alone if len(mine) == 1 else 1.0):
        return None
    turned = [slice(None, None, 1 if r.second == name else -1) for r in mine]
    left = np.sum([r.left[t] for r, t in zip(mine, turned, strict=True)], axis=0)
    i = int(np.argmin(np.where(np.abs(_SHIFTS - d) < 0.02, left, np.inf)))
    gains = [_gain([r], name, d) for r in mine]
    by = [sum(g for g, r in zip(gains, mine, strict=True) if r.first == one) for one in {r.first for r in mine}]
    if name in DRIVING[:2] and min(by) < SETTINGS.alike * sum(by) / len(by):  # both encoders must agree
        return None
    if not all(r.fits[t][i] for g, r, t in zip(gains, mine, turned, strict=True) if g > 0.1 * sum(gains)):
        return None
    side = round(SETTINGS.side / SETTINGS.step)
    if not side <= i < len(left) - side or min(left[i - side], left[i + side]) - left[i] < SETTINGS.peaked:
        return None  # no distinct minimum
    before, at, after = left[i - 1 : i + 2]
    bend = before - 2 * at + after
    off = 0.5 * (before - after) / bend if bend > 0 else 0.0
    return name, float(_SHIFTS[i] + SETTINGS.step * np.clip(off, -0.5, 0.5)), gain


def _gain(relations: list[_Relation], late: str, d: float) -> float:
    """Return the gain in log likelihood of a column that is late by d [s]."""
    return sum(_least(r, 0.0, "") - _least(r, d, late) for r in relations if late in (r.first, r.second))


def _least(relation: _Relation, d: float, late: str) -> float:
    """Return the loss of a relation at the best ordinary shift, with one column late by d [s]."""
    (a, b), (c, e) = ((d, d) if name == late else _ORDINARY[name] for name in (relation.first, relation.second))
    low, high = c - b, e - a
    inside = relation.left[(_SHIFTS > low) & (_SHIFTS < high)]
    return float(np.concatenate([np.interp([low, high], _SHIFTS, relation.left), inside]).min())


def _relations(recording: Recording, joint: Joint) -> list[_Relation]:
    """Return all relations of a recording at every shift; none if its link is at rest."""
    recording = shortened(recording, SETTINGS.longest)
    names = [n for n in (*POSITIONS, *DRIVING) if n in recording]
    positions = [n for n in POSITIONS if n in names]
    p = joint.record(recording.link)[0]
    N, value = float(p["N"]), {name: number.value for name, number in joint.numbers.items()}
    limit = SETTINGS.travel * (1.0 if "link_position" in names else N)
    if np.ptp(recording[positions[-1]]) < limit or len(recording.time) < 50:
        return []
    pushed = ["external_torque"] if recording.external == "measured" and "external_torque" in recording else []
    parts = _evenly(recording, names + pushed)
    pairs = [(m, n) for m in positions for n in names if n in DRIVING]
    if recording.external == "unmeasured":  # pushes have no shape
        pairs = []
    if len(positions) == 2:
        pairs.append((positions[0], positions[1]))
    # The least residual that counts: wind-up [rad], current [A] or torque [N·m].
    least_of = dict.fromkeys(POSITIONS, SETTINGS.wind_up * value["rated_torque"] / value["K1"])
    least_of["joint_torque"] = SETTINGS.torque * value["rated_torque"]
    least_of["motor_torque"] = SETTINGS.drive * value["rated_torque"] / value["N"]
    least_of["motor_current"] = least_of["motor_torque"] / value["Kt"]
    stride = max(sum(len(values) for _, values in parts) // SETTINGS.most, 1)
    found = []
    for first, second in pairs:
        columns: list[tuple[np.ndarray, ...]] = []
        for time, values in parts:
            i = np.arange(_REACH, len(values) - _REACH, stride)
            motion = values[i, names.index(first)] / (N if first == "motor_position" else 1.0)
            y = values[:, names.index(second), 0] / (N if second == "motor_position" else 1.0)
            shifted = np.lib.stride_tricks.sliding_window_view(y, 2 * _REACH + 1)[::stride]
            if second in POSITIONS:
                shifted = shifted - motion[:, :1]
            sliding = N * motion[:, 1] / float(p["vs"])
            use = np.abs(sliding) > SETTINGS.sliding if second != "joint_torque" else np.ones(len(i), bool)
            if second in DRIVING and use.mean() < SETTINGS.goes:  # stick-slip: the current rises before the motion
                continue
            shapes = _shapes(time[i], motion, sliding, second)
            if pushed:
                shapes = np.column_stack([shapes, values[i, -1, 0]])
            columns.append((shapes[use], shifted[use], motion[use, 1]))
        if sum(len(v) for *_, v in columns) < SETTINGS.fewest:
            continue
        shapes, y, v = (np.concatenate(x) for x in zip(*columns, strict=True))
        # Only angles that the link passed in both directions.
        piece = _places(shapes[:, 0]).astype(int)
        moving = np.abs(v) > SETTINGS.moving * float(np.max(np.abs(v), initial=0.0))
        forth, back = (np.bincount(piece[moving & (s * v > 0)], minlength=SETTINGS.hats) > 0 for s in (1, -1))
        again = (forth & back)[piece]
        shapes, y = shapes[again], y[again]
        if len(y) < SETTINGS.fewest:
            continue
        count = min(SETTINGS.effective[0] * SETTINGS.step * stride * len(y), SETTINGS.effective[1])
        unexplained, least = _unexplained(shapes, y), least_of[second]
        share = SETTINGS.fits * (1 if second in DRIVING[:2] else 2)
        fits = unexplained < np.maximum((2 * least) ** 2, share**2 * np.var(y, axis=0))
        found.append(_Relation(first, second, 0.5 * count * np.log(unexplained + least**2), fits))
    return found


def _places(theta: np.ndarray) -> np.ndarray:
    """Return the place of each angle in their range, from 0 to the number of pieces less one, shape (n,)."""
    return (theta - theta.min()) / max(float(np.ptp(theta)), 1e-9) * (SETTINGS.hats - 1)


def _unexplained(shapes: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return the mean square of y, shape (n, d), that shapes (n, s) and functions of the first do not explain: shape (d,)."""
    at = _places(shapes[:, 0])
    # Piecewise linear functions of the angle with sum one.
    A = np.column_stack([shapes, *(np.maximum(1 - np.abs(at - i), 0.0) for i in range(SETTINGS.hats))])
    A = A / np.maximum(np.sqrt(np.mean(A * A, axis=0)), 1e-12)
    values, vectors = np.linalg.eigh(A.T @ A)
    kept = values > 1e-10 * values[-1]
    along = (A @ vectors[:, kept] / np.sqrt(values[kept])).T @ y
    total = np.einsum("ij,ij->j", y, y)
    return np.maximum(total - np.einsum("ij,ij->j", along, along), 0.0) / len(y)


def _evenly(recording: Recording, names: list[str]) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return times and channels with two derivatives, shape (n, channels, 3), of each segment, `SETTINGS.step` apart."""
    found = []
    for part in recording.segments:
        time = recording.time[part]
        if len(time) < 20 or time[-1] - time[0] < 3 * SETTINGS.farthest:
            continue
        every = max(int(SETTINGS.bin / recording.interval), 1)
        begins = np.arange(0, len(time), every)
        count = np.diff(begins, append=len(time))
        mean = [np.add.reduceat(x, begins) / count for x in (time, *(recording[n][part] for n in names))]
        s = smooth(mean[0], np.column_stack(mean[1:]), SETTINGS.step, SETTINGS.cutoff)
        if len(s.time) > 2 * _REACH + 50:
            found.append((s.time - recording.time[0], np.stack([s.value, s.rate, s.acceleration], axis=-1)))
    return found


def _shapes(time: np.ndarray, motion: np.ndarray, sliding: np.ndarray, second: str) -> np.ndarray:
    """Return the shapes of a torque or of wind-up, the angle first, shape (n, shapes)."""
    theta, v, a = motion.T
    shapes = [theta, a]
    if second != "joint_torque":
        direction = np.tanh(sliding)
        shapes += [direction, *(direction * wave(k * theta) for k in (1, 2, 3) for wave in (np.sin, np.cos))]
    if second not in (*POSITIONS, "joint_torque"):
        shapes += [v, v * np.abs(v), direction * np.exp(-time / 10.0), a * direction]
    return np.column_stack(shapes)
