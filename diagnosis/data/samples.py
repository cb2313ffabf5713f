"""What is wrong with single samples of a recording: far off, jumped by a turn, not moving, at the sensor's end.

Each column is compared with its own neighbourhood and with what other columns do meanwhile; units do not matter. Steps between
samples are taken less the local speed times the interval, so that motion, jitter and missing samples are none. What motion
explains is no mistake: a torque's peak where the angle's speed changes, a rest at the outermost pose, what friction holds.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import maximum_filter1d, median_filter, percentile_filter

from ...models.joint import Joint
from ...models.recording import GAP, Measurement, Recording
from ...models.signals import DRIVING, POSITIONS
from .changes import Mistake
from .plausibility import smallest_step


@dataclass(frozen=True)
class SampleSettings:
    """When a sample is wrong.

    Set on `benchmarks/mistakes.py`: mistakes hidden in sound measurements, and sound ones in which nothing may be found.
    """

    neighbours: int = 9  # steps whose median is the local speed
    far: float = 8.0  # times what 99 % of the steps keep below, from which on a step is far
    alone: float = 5.0  # times the largest ordinary step within `nearby`, from which on it stands alone
    nearby: int = 25  # samples
    longest: int = 3  # samples of a glitch at the most
    # samples whose median is compared with a sample where glitches are many, and within which most are calm on either side
    window: int = 11
    around: int = 6  # likewise
    calm: float = 0.7  # their part
    usual: float = 0.9  # part of the samples that are no glitches even then
    cleared: float = 0.25  # by how much steps must become smaller without them
    quanta: float = 20.0  # smallest steps of a column, and roundings of single precision, that a glitch is larger than
    moves: float = 1.5  # times the largest other step of an angle nearby, that a glitch is larger than
    # times what it usually is where the angle's speed changes, that a torque's peak there is larger than
    bends: float = 5.0
    span: int = 4  # samples within which the speed changes
    events: int = 8  # samples with such changes, at the least
    still: tuple[float, int] = (0.2, 20)  # seconds and samples that a column does not move at the least to be stuck
    # share of its range and radians on the output side by which others move meanwhile
    moved: tuple[float, float] = (0.03, 0.02)
    pieces: int = 8  # of a part, whose medians say how far another column moves meanwhile
    leaves: float = 3.0  # times the largest ordinary step of an angle, by which a lone one that was stuck goes on
    flat: int = 8  # samples at a sensor's end at the least
    peaked: float = 4.0  # times more often that the value at the end is there than those near it
    driven: float = 0.01  # share of its range by which a position moves while a torque is stuck, or at its end
    together: float = 0.2  # part of a jump by which both encoders may differ in it
    uncommanded: float = 0.3  # way of the link [rad] that nothing but a command makes: no push and no compliance
    whole: float = 0.1  # by how much a counter's jump against the other encoder may be off whole turns [turns]
    clipped: float = 0.01  # share of the samples from which on a sensor's end makes physics meaningless
    listed: int = 4  # rows that are named one by one


SETTINGS = SampleSettings()
_ANGLES = (*POSITIONS, "position_command")


def wrong_samples(recording: Recording, joint: Joint) -> list[Mistake]:
    """Single samples of a recording that are wrong, column by column."""
    time, columns, N = recording.time, dict(recording.columns), joint.numbers["N"].value
    found: list[Mistake] = []

    def wrapped(name: str, jumps: np.ndarray, turn: float) -> None:
        if len(jumps):
            found.append(_mistake("wrapped", name, recording, jumps, turn))
            guide = columns["link_position"] if name == "motor_position" and "link_position" in columns else None
            columns[name] = unwrapped(time, columns[name], jumps, turn, guide)

    for name in columns:
        if name == "temperature":
            continue
        if name in (*_ANGLES, *DRIVING):
            turns = _turns(name, joint) if name in _ANGLES else ()
            wrapped(name, *_within_a_turn(time, columns[name], (*_registers(columns[name]), *turns)))
        steps, glitches = _Steps(time, columns[name]), set[int]()
        while more := set(_glitches(steps, name, columns)) - glitches:  # large ones hide smaller ones
            glitches |= more
            columns[name] = bridged(time, columns[name], np.array(sorted(glitches)))
            steps = _Steps(time, columns[name])
        if glitches:
            found.append(_mistake("glitch", name, recording, np.array(sorted(glitches))))
        if name in _ANGLES:
            wrapped(name, *steps.wraps(_turns(name, joint)[: 2 + (name in POSITIONS)]))
    if all(name in columns for name in POSITIONS):
        wrapped("motor_position", _power_cycles(time, columns, N), 2 * math.pi)
    for name in columns:
        if name in (*POSITIONS, *DRIVING):
            limit = joint.numbers["current_limit"].value if name == "motor_current" else math.inf
            parts = _still(time, columns, name, N, limit)
            found += [_mistake(what, name, recording, rows) for what, rows in parts.items() if len(rows)]
    return found


def _mistake(name: str, column: str, recording: Recording, rows: np.ndarray, turn: float | None = None) -> Mistake:
    n, severe = len(recording.time), True
    count = "one sample" if len(rows) == 1 else f"{len(rows)} samples"
    listed = ", ".join(map(str, rows)) if len(rows) <= SETTINGS.listed else f"{rows[0]} to {rows[-1]}"
    where = f"row{'s' if len(rows) > 1 else ''} {listed}"
    if name == "glitch":
        text = f"{count} far off the neighbours, {where}"
    elif name == "wrapped" and column in DRIVING:
        text = f"a register without its sign: values above half of {turn:g} are negative, {where}"
    elif name == "wrapped":
        text = f"jumps by a whole turn ({turn:g}) {'once' if len(rows) == 1 else f'{len(rows)} times'}, {where}"
    elif name == "stuck":
        text = "does not move at all" if len(rows) == n else f"does not move in {count} although it should, {where}"
    else:
        text, severe = f"{count} at the sensor's end, {where}", len(rows) > SETTINGS.clipped * n
    rows_ = tuple(int(k) for k in rows)
    return Mistake(name, column, recording.name, text, 0.99, factor=turn, rows=rows_, severe=severe)


def jumps(recording: Recording, joint: Joint) -> np.ndarray:
    """Samples before which others are missing, or were logged twice, though the time was numbered through: both encoders go the
    same way at once, far more than before and after."""
    if any(name not in recording for name in POSITIONS):
        return np.empty(0, int)
    N = joint.numbers["N"].value
    motor, link = (_Steps(recording.time, recording[n] / (N if n == "motor_position" else 1.0)) for n in POSITIONS)
    far = [s.size > s.far() for s in (motor, link)]
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

    The time that they had is kept in `Recording.stamps`.
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


def still_commands(recordings: Sequence[Recording], joint: Joint) -> list[list[Mistake]]:
    """Of each recording a position command that stays where it is though the link does not, if it has one: a drive that follows
    a torque or a velocity logs 0. One at the same value in another recording is of the same drive."""
    N = joint.numbers["N"].value
    at: list[float | None] = []
    still = set()
    for r in recordings:
        command = r.columns.get("position_command")
        at.append(float(command[0]) if command is not None and np.ptp(command) == 0.0 else None)
        spans = [float(np.ptp(r[n])) / (N if n == "motor_position" else 1.0) for n in POSITIONS if n in r]
        if at[-1] is not None and min(spans, default=0.0) > SETTINGS.uncommanded:
            still.add(at[-1])
    return [
        [_mistake("stuck", "position_command", r, np.arange(len(r.time)))] if value in still else []
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
    steps, change = np.diff(x), np.zeros(len(x))
    inside = np.diff(time) <= GAP
    plain = inside.copy()
    plain[jumps - 1] = False
    ratio = 0.0
    if guide is not None:
        a, b = steps[plain], np.diff(guide)[plain]
        ratio = float(a @ b / (b @ b)) if b @ b > 0 else 0.0
    expected = ratio * np.diff(guide) if guide is not None else np.zeros(len(steps))
    change[jumps] = -turn * np.round((steps - expected)[jumps - 1] / turn)
    out = x + np.cumsum(change)
    out -= turn * np.round((out[0] - start) / turn)
    for k in np.flatnonzero(~inside):
        step = expected[k]
        if not ratio:
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
        self.quantum = max(self.quantum, float(np.spacing(np.float32(min(np.abs(x).max(), 1e30)))))

    def far(self) -> float:
        """Size from which on a step is an exception."""
        ordinary = self.size[self.inside]
        usual = float(np.quantile(ordinary, 0.99)) if len(ordinary) else 0.0
        return max(SETTINGS.far * usual, SETTINGS.quanta * self.quantum)

    def glitches(self) -> np.ndarray:
        """Samples that are far off their neighbours, which agree with each other."""
        ordinary = self.size[self.inside]
        if not len(ordinary) or not ordinary.any() or len(self.x) < 2 * SETTINGS.neighbours:
            return np.empty(0, int)
        few = self._few()
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

    def _few(self) -> np.ndarray:
        """The same where a far step is an exception."""
        size, n = self.size, len(self.x)
        far = size > max(self.far(), 1e-6 * float(np.ptp(self.x)), 1e-12)
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


def _glitches(steps: _Steps, name: str, columns: Mapping[str, np.ndarray]) -> list[int]:
    """A column's glitches, without what the joint's motion explains."""
    rows = steps.glitches()
    if not len(rows):
        return []
    out = np.zeros(len(steps.x), bool)
    out[rows] = True
    if name in _ANGLES:  # a short move goes there, too, and others like it do
        own = np.where(out[1:] | out[:-1], 0.0, np.abs(steps.step))
        largest = maximum_filter1d(own, 2 * SETTINGS.nearby + 1, mode="nearest")[np.minimum(rows, len(own) - 1)]
        off = np.abs(steps.x - bridged(np.arange(len(out)), steps.x, rows))[rows]
        return rows[off > SETTINGS.moves * largest].tolist()
    size = np.maximum(np.append(steps.size, 0.0), np.append(0.0, steps.size))
    for angle in (n for n in _ANGLES if n in columns):  # where the speed changes, a torque has a peak
        k = SETTINGS.span
        x = np.pad(columns[angle], k, mode="edge")
        bend = maximum_filter1d(np.abs(x[2 * k :] - 2 * x[k:-k] + x[: -2 * k]), 2 * k + 1, mode="nearest")
        event = (bend > 2.5 * smallest_step(columns[angle])) & (bend > 0.1 * np.quantile(bend, 0.995))
        if event.sum() >= SETTINGS.events:
            times = np.quantile((size / np.maximum(bend, 1e-12))[event], 0.9)
            most = np.maximum(np.quantile(size[event], 0.9), times * bend[rows])
            rows = rows[~event[rows] | (size[rows] > SETTINGS.bends * most)]
    return rows.tolist()


def _within_a_turn(time: np.ndarray, x: np.ndarray, turns: tuple[float, ...]) -> tuple[np.ndarray, float]:
    """Samples after jumps of a column that never leaves one turn, or the range of a register, and what that is; none where it
    makes sense without."""
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


def _registers(x: np.ndarray) -> tuple[float, ...]:
    """What the range of a register of 16 or 32 bits may be, in the unit of a column that is never below zero."""
    values, extent = np.unique(x), float(np.ptp(x))
    if values[0] < 0.0 or len(values) < 16:
        return ()
    # No value lies between small numbers and those that were below zero.
    apart = np.diff(values)
    k = int(np.argmax(apart))
    high = x > values[k]
    step = float(apart.min())
    if apart[k] < 0.5 * extent or min(np.count_nonzero(high), np.count_nonzero(~high)) < SETTINGS.flat:
        return (2.0**16 * step, 2.0**32 * step)  # an angle goes through all of it
    for part in (values[: k + 1] - values[0], values[k + 1 :] - values[k + 1], values - values[0]):
        whole = np.round(part / step)  # the larger a number, the better it says the step
        step = float(part @ whole / (whole @ whole)) if whole @ whole > 0 else step
    steps = np.diff(x)
    at = np.flatnonzero(np.abs(steps) > 0.5 * extent)
    ordinary = 0.5 * (steps[np.maximum(at - 1, 0)] + steps[np.minimum(at + 1, len(steps) - 1)])
    return (2.0**16 * step, 2.0**32 * step, float(np.median(np.abs(steps[at]) - np.sign(steps[at]) * ordinary)))


def _turns(name: str, joint: Joint) -> tuple[float, ...]:
    """What a whole turn may be in a column: radians, degrees, turns, counts."""
    encoders = {"motor_position": joint.sensors.motor_encoder, "link_position": joint.sensors.link_encoder}
    own = (2 * math.pi / encoders[name].resolution,) if name in encoders else ()
    return (2 * math.pi, 360.0, *own, 1.0, *(float(2**bits) for bits in range(8, 33)))


def _power_cycles(time: np.ndarray, columns: Mapping[str, np.ndarray], N: float) -> np.ndarray:
    """Samples before which the motor's counter has lost whole turns, which the link's encoder says that it did not make."""
    motor, link = (columns[name] for name in POSITIONS)
    off = np.diff(motor) - N * np.diff(link)
    usual = 8 * float(np.quantile(np.abs(off), 0.99))
    turns = off / (2 * math.pi)
    found = np.flatnonzero((np.abs(off) > max(usual, math.pi)) & (np.abs(turns - np.round(turns)) < SETTINGS.whole))
    if not len(found) or len(found) > 3:
        return np.empty(0, int)
    # Else one of them was stuck before, but for a gap.
    before = [slice(max(k - SETTINGS.still[1], 0), k) for k in found]
    moved = [bool(np.any(np.diff(motor[b])) and np.any(np.diff(link[b]))) for b in before]
    found = found[np.array(moved, bool) | (np.diff(time)[found] > GAP)]
    apart = motor - N * link
    back = [abs(np.median(apart[k + 1 : k + 10]) - np.median(apart[max(k - 9, 0) : k + 1])) < math.pi for k in found]
    return found[~np.array(back, bool)] + 1


def _runs(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """First samples and lengths of runs of equal values."""
    edges = np.flatnonzero(np.concatenate([[True], np.diff(x) != 0, [True]]))
    return edges[:-1], np.diff(edges)


def _still(
    time: np.ndarray, columns: Mapping[str, np.ndarray], name: str, N: float, limit: float
) -> dict[str, np.ndarray]:
    """Samples in which a column does not move although it should, `stuck`, and those at a sensor's end, `clipped`.

    Args:
      limit: what the column cannot pass, whatever its sensor does.
    """
    x, none = columns[name], np.empty(0, int)
    begins, lengths = _runs(x)
    if len(begins) == 1:
        moves = any(np.ptp(columns[n]) > 0 for n in columns if n != name and n != "temperature")
        wanted = name in DRIVING or _moves_meanwhile(columns, name, slice(0, len(x)), N)
        nothing = not moves and len(x) > SETTINGS.still[1]
        return {"stuck": np.arange(len(x)) if wanted or nothing else none}
    clipped = _clipped(columns, name, begins, lengths, limit) if name in DRIVING else none
    ends = {float(x.min()), float(x.max())}
    ordinary = 1 if name in POSITIONS else float(np.quantile(lengths, 0.95))
    found: dict[str, list[np.ndarray]] = {"stuck": [none], "clipped": [clipped]}
    long = lengths >= max(SETTINGS.still[1], 12 * ordinary)
    for begin, length in zip(begins[long].tolist(), lengths[long].tolist(), strict=True):
        part = slice(begin, begin + length)
        at_end = float(x[begin]) in ends
        if time[part.stop - 1] - time[begin] < SETTINGS.still[0] or (at_end and (len(clipped) or _at(x[begin], limit))):
            continue
        if _moves_meanwhile(columns, name, part, N):
            what = "clipped" if name in POSITIONS and at_end and _leaves_softly(x, part.stop) else "stuck"
            found[what].append(np.arange(begin, part.stop))
    return {what: np.sort(np.concatenate(rows)) for what, rows in found.items()}


def _moves_meanwhile(columns: Mapping[str, np.ndarray], name: str, part: slice, N: float) -> bool:
    """Whether another column says that this one should have moved."""
    others = [n for n in POSITIONS if n in columns and n != name and np.ptp(columns[n]) > 0]
    if name in DRIVING:
        return any(_travelled(columns[n][part]) > SETTINGS.driven * np.ptp(columns[n]) for n in others)
    for other in others:
        moved, whole = _travelled(columns[other][part]), float(np.ptp(columns[other]))
        if moved > SETTINGS.moved[0] * whole and moved > SETTINGS.moved[1] * (N if other == "motor_position" else 1.0):
            return True
    # A lone encoder that hangs goes on by a jump; friction holds a joint for as long, but lets it go as it always does.
    steps = np.abs(np.diff(columns[name]))
    if others or part.stop >= len(steps) + 1 or not steps.any():
        return False
    jump = steps[part.stop - 1]
    rest = np.delete(steps, part.stop - 1)
    return bool(jump > SETTINGS.leaves * max(np.quantile(rest, 0.999), np.sort(rest)[-3]))


def _travelled(x: np.ndarray) -> float:
    """By how much an angle moves, its noise left out: a velocity in its place has much of that at rest."""
    if len(x) < SETTINGS.pieces * 2:
        return float(np.ptp(x))
    return float(np.ptp([np.median(piece) for piece in np.array_split(x, SETTINGS.pieces)]))


def _leaves_softly(x: np.ndarray, end: int) -> bool:
    """Whether a column moves on from a run of equal values without a jump; not where it never does."""
    steps = np.abs(np.diff(x))
    after = steps[end : end + 5]
    return end < len(x) and (not len(after) or steps[end - 1] <= 3 * float(after.max()) + 1e-12)


def _clipped(
    columns: Mapping[str, np.ndarray], name: str, begins: np.ndarray, lengths: np.ndarray, limit: float
) -> np.ndarray:
    """Samples at the largest or smallest value, where there are far more than of the values near it, and the joint moves."""
    x = columns[name]
    values, counts = np.unique(x, return_counts=True)
    found = [np.empty(0, int)]
    if len(values) < 50:
        return found[0]
    for end, near in ((-1, slice(-9, -1)), (0, slice(1, 9))):
        mine = x[begins] == values[end]
        longest = int(lengths[mine].max())
        if (mine.sum() == 1 and not _leaves_softly(x, int(begins[mine][0]) + longest)) or _at(values[end], limit):
            continue
        if counts[end] >= SETTINGS.flat and longest >= 3 and counts[end] > SETTINGS.peaked * counts[near].max():
            rows = np.flatnonzero(x == values[end])
            # A pose that is held takes the same torque all the time.
            moved = [
                _moved_within(columns[n], rows) > SETTINGS.driven * np.ptp(columns[n])
                for n in POSITIONS
                if n in columns
            ]
            if any(moved):
                found.append(rows)
    return np.sort(np.concatenate(found))


def _at(value: float, limit: float) -> bool:
    """Whether a value is at what a column cannot pass, which is no sensor's end."""
    return abs(abs(value) / limit - 1) < 0.02


def _moved_within(x: np.ndarray, rows: np.ndarray) -> float:
    """By how much an angle moves within the longest run of some samples."""
    runs = np.split(rows, np.flatnonzero(np.diff(rows) > 1) + 1)
    return max(float(np.ptp(x[run])) for run in runs)
