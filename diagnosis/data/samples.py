"""Find wrong samples of a recording: glitches, jumps by a turn, stuck and clipped readings.

Each column is compared with its own neighbourhood and with other columns, in any unit. The local speed times the interval is
subtracted from steps between samples, which removes motion, jitter and missing samples. Torque peaks at changes of speed, rest
at an end pose, and a joint held by friction are not mistakes.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.ndimage import convolve1d, maximum_filter1d, median_filter, percentile_filter

from ...models.joint import Joint
from ...models.recording import GAP, Measurement, Recording
from ...models.signals import DRIVING, POSITIONS
from .changes import Mistake, side
from .plausibility import smallest_step


@dataclass(frozen=True)
class SampleSettings:
    """Thresholds of wrong samples. Set on `benchmarks/mistakes.py`."""

    neighbours: int = 9  # steps whose median is the local speed
    far: float = 8.0  # least size of a far step, over the 99 % quantile of steps
    alone: float = 5.0  # least size of an isolated step, over the largest ordinary step within `nearby`
    nearby: int = 25  # samples
    longest: int = 3  # most samples of a glitch
    # samples of the running median with frequent glitches, and samples on either side of which most are calm
    window: int = 11
    around: int = 6  # the latter
    calm: float = 0.7  # their share
    usual: float = 0.9  # least share of valid samples with frequent glitches
    cleared: float = 0.25  # largest ratio of steps without glitches to steps with them
    quanta: float = 20.0  # least size of a glitch, in smallest steps of a column or roundings of single precision
    moves: float = 1.5  # the same over the largest other step of an angle nearby
    # the same over the usual peak of a torque at a change of speed
    bends: float = 5.0
    span: int = 4  # samples within which the speed changes
    events: int = 8  # least number of samples with such changes
    still: tuple[float, int] = (0.2, 20)  # least seconds and samples of a stuck column
    # least motion of other columns meanwhile: share of their range, and radians on the output side
    moved: tuple[float, float] = (0.03, 0.02)
    pieces: int = 8  # of a part, whose medians measure the motion of other columns
    leaves: float = 3.0  # least step of a single encoder after it was stuck, over the largest ordinary step
    flat: int = 8  # least number of samples at a sensor's limit
    peaked: float = 4.0  # least frequency of the value at the limit, over that of values near it
    driven: float = 0.01  # least motion of a position, over its range, while a torque is stuck or clipped
    together: float = 0.2  # largest relative difference of a jump of both encoders
    uncommanded: float = 0.3  # motion of the link [rad] that needs a command
    whole: float = 0.1  # tolerance of a counter's jump by whole turns [turns]
    clipped: float = 0.5  # share of clipped samples that is severe: the others are left out
    listed: int = 4  # rows that are listed one by one


SETTINGS = SampleSettings()
_ANGLES = (*POSITIONS, "position_command")


def wrong_samples(recording: Recording, joint: Joint) -> list[Mistake]:
    """Find the wrong samples of a recording, column by column."""
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
            wrapped(name, *_within_a_turn(time, columns[name], (*_registers(columns[name], name in _ANGLES), *turns)))
        steps, glitches = _Steps(time, columns[name]), set[int]()
        while more := set(_glitches(steps, name, columns)) - glitches:  # large ones mask smaller ones
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
        text = "does not move" if len(rows) == n else f"does not move in {count} although it should, {where}"
    else:
        text, severe = f"{count} at a limit beyond which nothing is read, {where}", len(rows) > SETTINGS.clipped * n
    rows_ = tuple(int(k) for k in rows)
    return Mistake(name, column, recording.name, text, 0.99, factor=turn, rows=rows_, severe=severe)


def jumps(recording: Recording, joint: Joint) -> np.ndarray:
    """Find samples before which others are missing or duplicated without a change in time: both encoders jump together."""
    if any(name not in recording for name in POSITIONS):
        return np.empty(0, int)
    N = joint.numbers["N"].value
    off, far = [], []
    for name in POSITIONS:
        steps = _Steps(recording.time, recording[name] / (N if name == "motor_position" else 1.0))
        far.append(steps.size > steps.far)
        off.append(steps.off)
        del steps
    alike = far[0] & far[1] & (np.abs(off[0] - off[1]) < SETTINGS.together * np.abs(off[1]))
    # A jump back is a glitch.
    near = convolve1d(far[1].astype(np.int8), np.ones(2 * SETTINGS.longest + 1, np.int8), mode="constant")
    return np.flatnonzero(alike & (near == 1)) + 1


def parted(measurement: Measurement, joint: Joint) -> tuple[Measurement, tuple[str, ...]]:
    """Insert gaps in time where samples are missing (`jumps`); also return a message for each. `Recording.stamps` keeps the
    original time."""
    messages, found = [], []
    for recording in measurement.recordings:
        rows, time = jumps(recording, joint), recording.time.copy()
        for row in rows:
            time[row:] += 2 * GAP
            messages.append(
                f"{recording.name}: both encoders jump at row {row}, but the time does not: samples are missing or duplicated; "
                "the recording is split there"
            )
        found.append(replace(recording, time=time, logged=recording.stamps) if len(rows) else recording)
    return replace(measurement, recordings=tuple(found)) if messages else measurement, tuple(messages)


def still_commands(recordings: Sequence[Recording], joint: Joint) -> list[list[Mistake]]:
    """Find, for each recording, a constant position command of a moving link, as drives in torque or velocity mode log it; one
    recording decides for equal commands."""
    N = joint.numbers["N"].value
    commands = [r.columns.get("position_command") for r in recordings]
    at = [None if x is None or np.ptp(x) else float(x[0]) for x in commands]
    moves = [all(np.ptp(r[n]) / side(n, "", N) > SETTINGS.uncommanded for n in POSITIONS if n in r) for r in recordings]
    still = {value for value, moving in zip(at, moves, strict=True) if moving and value is not None}
    return [
        [_mistake("stuck", "position_command", r, np.arange(len(r.time)))] if value in still else []
        for r, value in zip(recordings, at, strict=True)
    ]


def bridged(time: np.ndarray, x: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """Return the column with some samples interpolated linearly, shape (n,)."""
    kept = np.ones(len(x), bool)
    kept[rows] = False
    return np.where(kept, x, np.interp(time, time[kept], x[kept])) if kept.any() else x


def unwrapped(
    time: np.ndarray, x: np.ndarray, jumps: np.ndarray, turn: float, guide: np.ndarray | None = None, start: float = 0.0
) -> np.ndarray:
    """Return the angle x without jumps by whole turns, shape (n,); the first is within half a turn of `start`. `jumps`: samples
    after each jump; `turn`: in the angle's unit; `guide`: another angle of the joint, in any unit, that determines the turns
    within gaps, otherwise the speed around them does."""
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
    """Steps of a column from sample to sample, minus the local speed times the interval."""

    def __init__(self, time: np.ndarray, x: np.ndarray):
        self.x = x
        intervals, self.step = np.diff(time), np.diff(x)
        self.inside = intervals <= max(GAP, 5 * float(np.median(intervals)))
        # In place: an hour at 1 kHz has 29 MB per array.
        speed = np.divide(self.step, intervals, out=np.zeros(len(intervals)), where=self.inside)
        self.off = median_filter(speed, SETTINGS.neighbours, mode="nearest")
        del speed
        self.off *= intervals
        np.subtract(self.step, self.off, out=self.off, where=self.inside)
        self.off[~self.inside] = 0.0
        smallest = float(np.min(np.abs(self.step), where=self.step != 0, initial=np.inf))
        largest = min(max(float(x.max()), -float(x.min())), 1e30)
        self.quantum = max(smallest if np.isfinite(smallest) else 0.0, float(np.spacing(np.float32(largest))))

    @property
    def size(self) -> np.ndarray:
        """Absolute steps, shape (n - 1,)."""
        return np.abs(self.off)

    @cached_property
    def usual(self) -> float:
        """Size of the largest ordinary steps."""
        return float(np.quantile(self.size[self.inside], 0.99)) if self.inside.any() else 0.0

    @property
    def far(self) -> float:
        """Least size of an exceptional step."""
        return max(SETTINGS.far * self.usual, SETTINGS.quanta * self.quantum)

    def glitches(self) -> np.ndarray:
        """Find samples that are far off their neighbours, which agree with each other."""
        if not self.off.any() or len(self.x) < 2 * SETTINGS.neighbours:
            return np.empty(0, int)
        few = self._few()
        return few if len(few) else self._many()

    def _many(self) -> np.ndarray:
        """Find glitches that are so frequent that far steps are no exception, by a running median; steps must be ordinary without
        them."""
        way = np.concatenate([[0.0], np.cumsum(self.off)])
        off = np.abs(way - median_filter(way, SETTINGS.window, mode="nearest"))
        limit = max(SETTINGS.far * float(np.quantile(off, SETTINGS.usual)), SETTINGS.quanta * self.quantum, 1e-12)
        if not np.any(off > limit):
            return np.empty(0, int)
        about = percentile_filter(off, 100 * SETTINGS.calm, 2 * SETTINGS.around + 1, mode="nearest")
        far = (off > limit) & (off > SETTINGS.alone * about)
        lengths = np.diff(_edges(far))
        rows = np.flatnonzero(far & (np.repeat(lengths, lengths) <= SETTINGS.longest))
        step = np.abs(np.diff(bridged(np.arange(len(way)), way, rows))[self.inside])
        return rows if float(np.quantile(step, 0.99)) < SETTINGS.cleared * self.usual else rows[:0]

    def _few(self) -> np.ndarray:
        """Find glitches if far steps are rare."""
        size, n = self.size, len(self.x)
        far = size > max(self.far, 1e-6 * float(np.ptp(self.x)), 1e-12)
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
        """Find the samples after jumps by exactly a whole turn, and the turn."""
        usual = max(self.usual, self.quantum, 1e-9)
        far = np.flatnonzero(self.size > max(SETTINGS.far * usual, SETTINGS.quanta * self.quantum))
        # Exclude stuck readings before a jump.
        moved = all(np.any(self.step[max(k - SETTINGS.still[1], 0) : k]) for k in far)
        if len(far) and moved and np.count_nonzero(self.inside) >= 2 * SETTINGS.neighbours:
            for turn in turns:
                if turn > 12 * usual and np.all(np.abs(np.abs(self.off[far]) - turn) < 2e-3 * turn + usual):
                    return far + 1, turn
        return np.empty(0, int), 0.0


def _glitches(steps: _Steps, name: str, columns: Mapping[str, np.ndarray]) -> list[int]:
    """Find a column's glitches that the joint's motion does not explain."""
    rows = steps.glitches()
    if not len(rows):
        return []
    out = np.zeros(len(steps.x), bool)
    out[rows] = True
    if name in _ANGLES:  # excludes short moves
        own = np.where(out[1:] | out[:-1], 0.0, np.abs(steps.step))
        largest = maximum_filter1d(own, 2 * SETTINGS.nearby + 1, mode="nearest")[np.minimum(rows, len(own) - 1)]
        off = np.abs(steps.x - bridged(np.arange(len(out)), steps.x, rows))[rows]
        return rows[off > SETTINGS.moves * largest].tolist()
    size = np.maximum(np.append(steps.size, 0.0), np.append(0.0, steps.size))
    for angle in (n for n in _ANGLES if n in columns):  # torques have peaks at changes of speed
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
    """Find the samples after wraps of a column within one turn or a register's range, and that range."""
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


def _registers(x: np.ndarray, angle: bool) -> tuple[float, ...]:
    """Return possible ranges of a register of 16 or 32 bits, in a column's unit; a torque with negative values is in none."""
    values, extent, signed = np.unique(x), float(np.ptp(x)), float(x.min()) < 0.0
    if len(values) < 16 or (signed and not angle):
        return ()
    # There is a gap between small values and wrapped negative ones.
    apart = np.diff(values)
    k = int(np.argmax(apart))
    high = x > values[k]
    step = float(apart.min())
    if signed or apart[k] < 0.5 * extent or min(np.count_nonzero(high), np.count_nonzero(~high)) < SETTINGS.flat:
        return (2.0**16 * step, 2.0**32 * step)  # an angle goes through all of it
    for part in (values[: k + 1] - values[0], values[k + 1 :] - values[k + 1], values - values[0]):
        whole = np.round(part / step)
        step = float(part @ whole / (whole @ whole)) if whole @ whole > 0 else step
    steps = np.diff(x)
    at = np.flatnonzero(np.abs(steps) > 0.5 * extent)
    ordinary = 0.5 * (steps[np.maximum(at - 1, 0)] + steps[np.minimum(at + 1, len(steps) - 1)])
    return (2.0**16 * step, 2.0**32 * step, float(np.median(np.abs(steps[at]) - np.sign(steps[at]) * ordinary)))


def _turns(name: str, joint: Joint) -> tuple[float, ...]:
    """Return possible whole turns of a column: in radians, degrees, turns, counts."""
    encoders = {"motor_position": joint.sensors.motor_encoder, "link_position": joint.sensors.link_encoder}
    own = (2 * math.pi / encoders[name].resolution,) if name in encoders else ()
    return (2 * math.pi, 360.0, *own, 1.0, *(float(2**bits) for bits in range(8, 33)))


def _power_cycles(time: np.ndarray, columns: Mapping[str, np.ndarray], N: float) -> np.ndarray:
    """Find samples before which the motor's counter lost whole turns, according to the link encoder."""
    motor, link = (columns[name] for name in POSITIONS)
    off = np.diff(motor) - N * np.diff(link)
    usual = 8 * float(np.quantile(np.abs(off), 0.99))
    turns = off / (2 * math.pi)
    found = np.flatnonzero((np.abs(off) > max(usual, math.pi)) & (np.abs(turns - np.round(turns)) < SETTINGS.whole))
    if not len(found) or len(found) > 3:
        return np.empty(0, int)
    # Exclude stuck readings before a jump, except at gaps.
    before = [slice(max(k - SETTINGS.still[1], 0), k) for k in found]
    moved = [bool(np.any(np.diff(motor[b])) and np.any(np.diff(link[b]))) for b in before]
    found = found[np.array(moved, bool) | (np.diff(time)[found] > GAP)]
    apart = motor - N * link
    back = [abs(np.median(apart[k + 1 : k + 10]) - np.median(apart[max(k - 9, 0) : k + 1])) < math.pi for k in found]
    return found[~np.array(back, bool)] + 1


def _edges(x: np.ndarray) -> np.ndarray:
    """Return the first samples of runs of equal values, and the number of samples."""
    begins = np.ones(len(x) + 1, bool)
    begins[1:-1] = x[1:] != x[:-1]
    return np.flatnonzero(begins)


def _still(
    time: np.ndarray, columns: Mapping[str, np.ndarray], name: str, N: float, limit: float
) -> dict[str, np.ndarray]:
    """Find samples of a column that should move but does not, `stuck`, and those at a sensor's limit, `clipped`; `limit`: the
    column's physical one."""
    x = columns[name]
    edges = _edges(x)
    begins, lengths = edges[:-1], np.diff(edges)
    if len(begins) == 1:
        moves = any(np.ptp(columns[n]) > 0 for n in columns if n != name and n != "temperature")
        wanted = name in DRIVING or _moves_meanwhile(columns, name, slice(0, len(x)), N)
        nothing = not moves and len(x) > SETTINGS.still[1]
        return {"stuck": np.arange(len(x) if wanted or nothing else 0)}
    clipped = _clipped(columns, name, begins, lengths, limit) if name in DRIVING else edges[:0]
    ends = {float(x.min()), float(x.max())}
    ordinary = 1 if name in POSITIONS else float(np.quantile(lengths, 0.95))
    found = {"stuck": [edges[:0]], "clipped": [clipped]}
    long = lengths >= max(SETTINGS.still[1], 12 * ordinary)
    for begin, length in zip(begins[long].tolist(), lengths[long].tolist(), strict=True):
        part = slice(begin, begin + length)
        at_end = float(x[begin]) in ends
        at_limit = at_end and name in DRIVING and (len(clipped) or _at(x[begin], limit))
        lasting = time[part.stop - 1] - time[begin] >= SETTINGS.still[0]
        if lasting and not at_limit and _moves_meanwhile(columns, name, part, N):
            what = "clipped" if name in POSITIONS and at_end and _leaves_softly(x, part.stop) else "stuck"
            found[what].append(np.arange(begin, part.stop))
    return {what: np.sort(np.concatenate(rows)) for what, rows in found.items()}


def _moves_meanwhile(columns: Mapping[str, np.ndarray], name: str, part: slice, N: float) -> bool:
    """Return whether other columns show that this one should have moved."""
    others = [n for n in POSITIONS if n in columns and n != name and np.ptp(columns[n]) > 0]
    if name in DRIVING:
        return any(_travelled(columns[n][part]) > SETTINGS.driven * np.ptp(columns[n]) for n in others)
    share, least = SETTINGS.moved
    if any(_travelled(x[part]) > max(share * np.ptp(x), least * side(n, "", N)) for n in others for x in (columns[n],)):
        return True
    # A single stuck encoder continues with a jump; a joint held by friction does not.
    steps = np.abs(np.diff(columns[name]))
    if others or part.stop >= len(steps) + 1 or not steps.any():
        return False
    jump = steps[part.stop - 1]
    rest = np.delete(steps, part.stop - 1)
    return bool(jump > SETTINGS.leaves * max(np.quantile(rest, 0.999), np.sort(rest)[-3]))


def _travelled(x: np.ndarray) -> float:
    """Return the motion of an angle without noise: the range of medians."""
    if len(x) < SETTINGS.pieces * 2:
        return float(np.ptp(x))
    return float(np.ptp([np.median(piece) for piece in np.array_split(x, SETTINGS.pieces)]))


def _leaves_softly(x: np.ndarray, end: int) -> bool:
    """Return whether a column continues after a run of equal values without a jump."""
    steps = np.abs(np.diff(x[end - 1 : end + 6]))
    return len(steps) > 0 and (len(steps) == 1 or bool(steps[0] <= 3 * float(steps[1:].max()) + 1e-12))


def _clipped(
    columns: Mapping[str, np.ndarray], name: str, begins: np.ndarray, lengths: np.ndarray, limit: float
) -> np.ndarray:
    """Find samples at the largest or smallest value, if it is far more frequent than values near it and the joint moves."""
    x = columns[name]
    edges = _edges(np.sort(x))  # of equal values
    found = [np.empty(0, int)]
    if len(edges) <= 50:
        return found[0]
    moving = [columns[n] for n in POSITIONS if n in columns]
    # Counts of the extreme value, and of the eight values next to it.
    for value, counts in ((x.max(), np.diff(edges[-10:])[::-1]), (x.min(), np.diff(edges[:10]))):
        mine = x[begins] == value
        longest = int(lengths[mine].max())
        if (mine.sum() == 1 and not _leaves_softly(x, int(begins[mine][0]) + longest)) or _at(value, limit):
            continue
        if counts[0] >= SETTINGS.flat and longest >= 3 and counts[0] > SETTINGS.peaked * counts[1:].max():
            rows = np.flatnonzero(x == value)
            runs = np.split(rows, np.flatnonzero(np.diff(rows) > 1) + 1)
            # A held pose has a constant torque.
            if any(max(np.ptp(a[run]) for run in runs) > SETTINGS.driven * np.ptp(a) for a in moving):
                found.append(rows)
    return np.sort(np.concatenate(found))


def _at(value: float, limit: float) -> bool:
    """Return whether an extreme torque is at its physical limit, or the zero of a magnitude without its sign."""
    return value == 0.0 or abs(abs(value) / limit - 1) < 0.02
