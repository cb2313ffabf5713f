"""What is wrong with single samples of a recording: far off, jumped by a turn, not moving, at the sensor's end.

Each column is held against its own neighbourhood, and positions against each other; units do not matter. Steps between samples
are taken less the local speed times the interval, so that motion, jitter and missing samples are none.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import median_filter, percentile_filter

from ...models.joint import EncoderSpec, Joint
from ...models.recording import GAP, Measurement, Recording
from ...models.signals import DRIVING, POSITIONS


@dataclass(frozen=True)
class SampleSettings:
    """When a sample is wrong.

    Set on `benchmarks/mistakes.py`: mistakes hidden in sound measurements, and sound ones in which nothing may be found.

    Attributes:
      neighbours: steps whose median is the local speed.
      far: times what 99 % of the steps keep below, from which on a step is far.
      alone: times the largest ordinary step within `nearby`, from which on it stands alone.
      nearby: samples.
      longest: samples of a glitch at the most.
      window, around: samples whose median is held against a sample where glitches are many, and within which most are calm on
        either side; calm: their part.
      usual: part of the samples that are no glitches even then; cleared: by how much steps must become smaller without them.
      quanta: smallest steps of a column that a glitch is larger than.
      still: seconds and samples that a column does not move at the least to be stuck.
      moved: share of its range and radians on the output side by which others move meanwhile.
      pieces: of a part, whose medians say how far another column moves meanwhile.
      flat: samples at a sensor's end at the least.
      peaked: times more often that the value at the end is there than those beside it.
      drive_moved: share of its range by which a position moves while a torque is stuck.
      together: part of a jump by which both encoders may differ in it.
      uncommanded: way of the link [rad] that nothing but a command makes: no push and no compliance.
    """

    neighbours: int = 9
    far: float = 8.0
    alone: float = 5.0
    nearby: int = 25
    longest: int = 3
    window: int = 11
    around: int = 6
    calm: float = 0.7
    usual: float = 0.9
    cleared: float = 0.25
    quanta: float = 20.0
    still: tuple[float, int] = (0.2, 20)
    moved: tuple[float, float] = (0.03, 0.02)
    pieces: int = 8
    flat: int = 8
    peaked: float = 4.0
    drive_moved: float = 0.01
    together: float = 0.2
    uncommanded: float = 0.3


SETTINGS = SampleSettings()


@dataclass(frozen=True)
class SampleMistake:
    """Samples of a column that are wrong.

    Attributes:
      name: `glitch`, `wrapped`, `stuck` or `clipped`; column: that has it.
      rows: samples concerned; of `wrapped` those after each jump.
      turn: of `wrapped`, what a whole turn is in the column's unit.
    """

    name: str
    column: str
    rows: tuple[int, ...]
    turn: float | None = None


def wrong_samples(recording: Recording, joint: Joint) -> tuple[SampleMistake, ...]:
    """Single samples of a recording that are wrong, column by column."""
    columns = dict(recording.columns)
    found: list[SampleMistake] = []
    for name in columns:
        if name == "temperature":
            continue
        angle = name in (*POSITIONS, "position_command")
        if angle:
            jumps, turn = _within_a_turn(recording.time, columns[name], _turns(name, joint))
            if len(jumps):
                found.append(SampleMistake("wrapped", name, tuple(jumps.tolist()), turn))
                columns[name] = unwrapped(recording.time, columns[name], jumps, turn)
        steps, glitches = _Steps(recording.time, columns[name]), set[int]()
        while more := set(steps.glitches().tolist()) - glitches:  # large ones hide smaller ones
            glitches |= more
            columns[name] = bridged(recording.time, columns[name], np.array(sorted(glitches)))
            steps = _Steps(recording.time, columns[name])
        if glitches:
            found.append(SampleMistake("glitch", name, tuple(sorted(glitches))))
        if angle:
            jumps, turn = steps.wraps(_turns(name, joint)[: 2 + (name in POSITIONS)])
            if len(jumps):
                found.append(SampleMistake("wrapped", name, tuple(jumps.tolist()), turn))
                columns[name] = unwrapped(recording.time, columns[name], jumps, turn)
    N = joint.numbers["N"].value
    for name in columns:
        if name in (*POSITIONS, *DRIVING):
            found += _still(recording.time, columns, name, N)
    return tuple(found)


def jumps(recording: Recording, joint: Joint) -> np.ndarray:
    """Samples before which others are missing, or were logged twice, though the time was numbered through: both encoders go the
    same way at once, far more than before and after."""
    if any(name not in recording for name in POSITIONS):
        return np.empty(0, int)
    N = joint.numbers["N"].value
    motor, link = (_Steps(recording.time, recording[n] / (N if n == "motor_position" else 1.0)) for n in POSITIONS)
    far = [
        s.size > max(SETTINGS.far * float(np.quantile(s.size, 0.99)), SETTINGS.quanta * s.quantum)
        for s in (motor, link)
    ]
    same = np.abs(motor.off - link.off) < SETTINGS.together * np.abs(link.off)
    found = np.flatnonzero(far[0] & far[1] & same)
    # What comes back at once is a sample far off.
    back = [
        bool(np.any(far[1][max(k - SETTINGS.longest, 0) : k]) or np.any(far[1][k + 1 : k + 1 + SETTINGS.longest]))
        for k in found
    ]
    return found[~np.array(back, bool)] + 1


def parted(measurement: Measurement, joint: Joint) -> tuple[Measurement, tuple[str, ...]]:
    """The measurement with gaps in the time of its recordings where samples are missing (`jumps`), and what is said of each.

    What they had for time stays beside it (`Recording.stamps`).
    """
    said, found = [], []
    for recording in measurement.recordings:
        rows, time = jumps(recording, joint), recording.time.copy()
        for row in rows:
            time[row:] += 2 * GAP
            said.append(
                f"{recording.name}: both encoders jump at row {row}: samples are missing, or there twice, which the time does "
                "not show; taken for a gap"
            )
        found.append(replace(recording, time=time, logged=recording.stamps) if len(rows) else recording)
    return replace(measurement, recordings=tuple(found)) if said else measurement, tuple(said)


def still_commands(recordings: Sequence[Recording], joint: Joint) -> list[list[SampleMistake]]:
    """Of each recording a position command that stays where it is though the link does not, if it has one: a drive that follows
    a torque or a velocity logs 0. One that stands at the same place beside such ones is of the same drive."""
    N = joint.numbers["N"].value
    at: list[float | None] = []
    goes = []
    for r in recordings:
        command = r.columns.get("position_command")
        at.append(float(command[0]) if command is not None and np.ptp(command) == 0.0 else None)
        spans = [float(np.ptp(r[n])) / (N if n == "motor_position" else 1.0) for n in POSITIONS if n in r]
        goes.append(min(spans, default=0.0) > SETTINGS.uncommanded)
    still = {value for value, moves in zip(at, goes, strict=True) if value is not None and moves}
    return [
        [SampleMistake("stuck", "position_command", tuple(range(len(r.time))))] if value in still else []
        for r, value in zip(recordings, at, strict=True)
    ]


def bridged(time: np.ndarray, x: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """The column with some samples replaced by the straight line between their neighbours, shape (n,)."""
    kept = np.ones(len(x), bool)
    kept[rows] = False
    return np.where(kept, x, np.interp(time, time[kept], x[kept])) if kept.any() else x


def unwrapped(
    time: np.ndarray, x: np.ndarray, jumps: np.ndarray, turn: float, guide: np.ndarray | None = None, start: float = 0.0
) -> np.ndarray:
    """The angle without jumps, shape (n,): whole turns are added after each; over gaps as a guide's motion has it.

    The first one is within half a turn of `start`.

    Args:
      time, x: of the samples [s], and the angle, shape (n,).
      jumps: samples after each jump; turn: in the angle's unit.
      guide: another angle of the same shaft, in any unit; without one the speed before and after a gap tells.
    """
    change = np.zeros(len(x))
    steps = np.diff(x)
    change[jumps] = -turn * np.round(steps[jumps - 1] / turn)
    out = x + np.cumsum(change)
    out -= turn * np.round((out[0] - start) / turn)
    gaps = np.flatnonzero(np.diff(time) > GAP)
    if len(gaps) == 0:
        return out
    inside = np.diff(time) <= GAP
    ratio = 0.0
    if guide is not None:
        a, b = np.diff(out)[inside], np.diff(guide)[inside]
        ratio = float(a @ b / (b @ b)) if b @ b > 0 else 0.0
    for k in gaps:
        if ratio:
            assert guide is not None
            step = ratio * (guide[k + 1] - guide[k])
        else:
            speeds = [_speed(time, out, slice(max(k - 8, 0), k + 1)), _speed(time, out, slice(k + 1, k + 10))]
            step = float(np.mean(speeds)) * (time[k + 1] - time[k])
        out[k + 1 :] += turn * np.round((out[k] + step - out[k + 1]) / turn)
    return out


def _speed(time: np.ndarray, x: np.ndarray, part: slice) -> float:
    return float(np.polyfit(time[part], x[part], 1)[0]) if len(time[part]) > 2 else 0.0


class _Steps:
    """A column's steps from sample to sample less the local speed times the interval."""

    def __init__(self, time: np.ndarray, x: np.ndarray):
        self.x = x
        intervals, self.step = np.diff(time), np.diff(x)
        self.inside = intervals <= max(GAP, 5 * float(np.median(intervals)))
        speed = np.where(self.inside, self.step / intervals, 0.0)
        local = median_filter(speed, SETTINGS.neighbours, mode="nearest")
        self.off = np.where(self.inside, self.step - local * intervals, 0.0)
        self.size = np.abs(self.off)
        moving = np.abs(self.step[self.step != 0])
        self.quantum = float(moving.min()) if len(moving) else 0.0

    def glitches(self) -> np.ndarray:
        """Samples that are far off their neighbours, which agree with each other."""
        ordinary = self.size[self.inside]
        if not len(ordinary) or not ordinary.any() or len(self.x) < 2 * SETTINGS.neighbours:
            return np.empty(0, int)
        few = self._few(ordinary)
        return few if len(few) else self._many(ordinary)

    def _many(self, ordinary: np.ndarray) -> np.ndarray:
        """The same where they are so many that far steps are no exception: what they are far off is a running median, and steps
        are ordinary without them; none where they are not."""
        way = np.concatenate([[0.0], np.cumsum(self.off)])
        off = np.abs(way - median_filter(way, SETTINGS.window, mode="nearest"))
        limit = max(SETTINGS.far * float(np.quantile(off, SETTINGS.usual)), SETTINGS.quanta * self.quantum, 1e-12)
        about = percentile_filter(off, 100 * SETTINGS.calm, 2 * SETTINGS.around + 1, mode="nearest")
        far = (off > limit) & (off > SETTINGS.alone * about)
        begins, lengths = _runs(far)
        for begin, length in zip(begins.tolist(), lengths.tolist(), strict=True):
            if length > SETTINGS.longest:
                far[begin : begin + length] = False
        rows = np.flatnonzero(far)
        if not len(rows):
            return rows
        step = np.diff(bridged(np.arange(len(way)), way, rows))[self.inside]
        less = float(np.quantile(np.abs(step), 0.99)) < SETTINGS.cleared * float(np.quantile(ordinary, 0.99))
        return rows if less else rows[:0]

    def _few(self, ordinary: np.ndarray) -> np.ndarray:
        """The same where a far step is an exception."""
        size, n = self.size, len(self.x)
        usually = SETTINGS.far * float(np.quantile(ordinary, 0.99))
        limit = max(usually, SETTINGS.quanta * self.quantum, 1e-6 * float(np.ptp(self.x)), 1e-12)
        far = size > limit
        usual = np.where(far, 0.0, size)
        rows: list[int] = []
        for k in np.flatnonzero(far).tolist():
            if rows and k < rows[-1] + 1:
                continue
            near = usual[max(k - SETTINGS.nearby, 0) : k + SETTINGS.nearby]
            if size[k] < SETTINGS.alone * float(near.max()):
                continue
            if (k == 0 and not far[1]) or (k == n - 2 and not far[n - 3]):
                rows.append(0 if k == 0 else n - 1)
                continue
            for width in range(1, SETTINGS.longest + 1):
                if k + width < n - 1 and abs(self.off[k : k + width + 1].sum()) < 0.3 * size[k] and far[k + width]:
                    rows += range(k + 1, k + width + 1)
                    break
        return np.array(sorted(set(rows)), int)

    def wraps(self, turns: tuple[float, ...]) -> tuple[np.ndarray, float]:
        """Samples after jumps by exactly a whole turn, of an angle that makes several; none where there is no such jump."""
        ordinary = self.size[self.inside]
        if len(ordinary) >= 2 * SETTINGS.neighbours:
            usual = max(float(np.quantile(ordinary, 0.99)), self.quantum, 1e-9)
            far = np.flatnonzero(self.size > max(SETTINGS.far * usual, SETTINGS.quanta * self.quantum))
            jumps = np.abs(self.off[far])
            # Else it was stuck before.
            moved = [bool(np.any(self.step[max(k - SETTINGS.still[1], 0) : k])) for k in far]
            for turn in turns:
                exact = np.abs(jumps - turn) < 2e-3 * turn + usual
                if len(far) and turn > 12 * usual and np.all(exact) and all(moved):
                    return far + 1, turn
        return np.empty(0, int), 0.0


def _within_a_turn(time: np.ndarray, x: np.ndarray, turns: tuple[float, ...]) -> tuple[np.ndarray, float]:
    """Samples after jumps of an angle that never leaves one turn, and what a turn is; none where it makes sense as it is."""
    extent = float(np.ptp(x))
    inside = np.diff(time) <= max(GAP, 5 * float(np.median(np.diff(time))))
    for turn in turns:
        if not 0.9 * turn < extent <= 1.001 * turn:
            continue
        jumps = np.flatnonzero((np.abs(np.diff(x)) > 0.5 * turn) & inside) + 1
        rest = np.abs(np.diff(unwrapped(time, x, jumps, turn)))[inside]
        if len(jumps) and float(np.quantile(rest, 0.995)) < 0.35 * turn:
            return jumps, turn
    return np.empty(0, int), 0.0


def _turns(name: str, joint: Joint) -> tuple[float, ...]:
    """What a whole turn may be in a column: radians, degrees, turns, counts."""
    encoders = {"motor_position": joint.sensors.motor_encoder, "link_position": joint.sensors.link_encoder}
    encoder: EncoderSpec | None = encoders.get(name)
    own = () if encoder is None else (2 * math.pi / encoder.resolution,)
    return (2 * math.pi, 360.0, *own, 1.0, *(float(2**bits) for bits in range(8, 33)))


def _runs(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """First samples and lengths of runs of equal values."""
    edges = np.flatnonzero(np.concatenate([[True], np.diff(x) != 0, [True]]))
    return edges[:-1], np.diff(edges)


def _still(time: np.ndarray, columns: Mapping[str, np.ndarray], name: str, N: float) -> list[SampleMistake]:
    """Parts in which a column does not move although it should, and those at a sensor's end."""
    x = columns[name]
    begins, lengths = _runs(x)
    if len(begins) == 1:
        moves = any(np.ptp(columns[n]) > 0 for n in columns if n != name and n != "temperature")
        wanted = name in DRIVING or _moves_meanwhile(columns, name, 0, len(x), N)
        nothing = not moves and len(x) > SETTINGS.still[1]
        return [SampleMistake("stuck", name, tuple(range(len(x))))] if wanted or nothing else []
    found: list[SampleMistake] = []
    clipped = _clipped(x, begins, lengths) if name in DRIVING else np.empty(0, int)
    if len(clipped):
        found.append(SampleMistake("clipped", name, tuple(clipped.tolist())))
    ends = {float(x.min()), float(x.max())}
    ordinary = 1 if name in POSITIONS else float(np.quantile(lengths, 0.95))
    stuck: list[int] = []
    flat: list[int] = []
    long = lengths >= max(SETTINGS.still[1], 12 * ordinary)
    for begin, length in zip(begins[long].tolist(), lengths[long].tolist(), strict=True):
        end = begin + length
        if time[end - 1] - time[begin] < SETTINGS.still[0]:
            continue
        if len(clipped) and float(x[begin]) in ends:
            continue
        if not _moves_meanwhile(columns, name, begin, end, N):
            continue
        at_end = name in POSITIONS and float(x[begin]) in ends and _leaves_softly(x, end)
        (flat if at_end else stuck).extend(range(begin, end))
    if stuck:
        found.append(SampleMistake("stuck", name, tuple(stuck)))
    if flat:
        found.append(SampleMistake("clipped", name, tuple(flat)))
    return found


def _moves_meanwhile(columns: Mapping[str, np.ndarray], name: str, begin: int, end: int, N: float) -> bool:
    """Whether another column says that this one should have moved."""
    part = slice(begin, end)
    others = [n for n in POSITIONS if n in columns and n != name and np.ptp(columns[n]) > 0]
    if name in DRIVING:
        return any(np.ptp(columns[n][part]) > SETTINGS.drive_moved * np.ptp(columns[n]) for n in others)
    for other in others:
        moved, whole = _travelled(columns[other][part]), float(np.ptp(columns[other]))
        if moved > SETTINGS.moved[0] * whole and moved > SETTINGS.moved[1] * (N if other == "motor_position" else 1.0):
            return True
    if others:
        return False
    command = columns.get("position_command")
    if command is not None and np.ptp(command[part]) > 0.5 * np.ptp(command) and np.ptp(command[part]) > 0.1:
        return True
    return _stops_at_once(columns[name], begin, end)


def _travelled(x: np.ndarray) -> float:
    """By how much an angle moves, its noise left out: a velocity that stands in its place has much of that at rest."""
    if len(x) < SETTINGS.pieces * 2:
        return float(np.ptp(x))
    return float(np.ptp([np.median(piece) for piece in np.array_split(x, SETTINGS.pieces)]))


def _stops_at_once(x: np.ndarray, begin: int, end: int) -> bool:
    """Whether an angle comes to rest from a speed far above its resolution within a sample, or leaves it by a jump."""
    steps = np.abs(np.diff(x))
    moving = steps[steps > 0]
    if not len(moving):
        return False
    fast = max(8 * float(moving.min()), 0.1 * float(np.quantile(moving, 0.99)))
    before = steps[max(begin - 6, 0) : begin]
    enters = len(before) >= 4 and float(np.median(before)) > fast and before[-1] > 0.5 * float(np.median(before))
    after = steps[end : end + 5]
    leaves = len(after) >= 3 and steps[end - 1] > max(fast, 5 * float(np.median(after)))
    return bool(enters or leaves)


def _leaves_softly(x: np.ndarray, end: int) -> bool:
    """Whether a column moves on from a run of equal values without a jump; not where it never does."""
    steps = np.abs(np.diff(x))
    after = steps[end : end + 5]
    return end < len(x) and (not len(after) or steps[end - 1] <= 3 * float(after.max()) + 1e-12)


def _clipped(x: np.ndarray, begins: np.ndarray, lengths: np.ndarray) -> np.ndarray:
    """Samples at the largest or smallest value, where there are far more than of the values beside it."""
    values, counts = np.unique(x, return_counts=True)
    found = []
    if len(values) < 50:
        return np.empty(0, int)
    for end, beside in ((-1, slice(-9, -1)), (0, slice(1, 9))):
        mine = x[begins] == values[end]
        longest = int(lengths[mine].max())
        if mine.sum() == 1 and not _leaves_softly(x, int(begins[mine][0]) + longest):
            continue
        if counts[end] >= SETTINGS.flat and longest >= 3 and counts[end] > SETTINGS.peaked * counts[beside].max():
            found.append(np.flatnonzero(x == values[end]))
    return np.sort(np.concatenate(found)) if found else np.empty(0, int)
