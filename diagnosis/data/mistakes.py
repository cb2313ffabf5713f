"""What people get wrong in their data, each named with the change that mends it: before any physics.

Three looks, one after the other, each at what the one before would have mended: single samples (`samples`), columns in the wrong
unit, direction, place (`changes`), columns that are late (`lateness`).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from ...models.command_lines import mending
from ...models.errors import InputError
from ...models.joint import Joint
from ...models.recording import GAP, Measurement, Recording, carried_anew, check_channels
from ...models.signals import POSITIONS
from .changes import GRAVITY, Found, Suspicions, change_in_an_arm, time_unit
from .lateness import LateColumn, late_columns
from .samples import SampleMistake, bridged, still_commands, unwrapped, wrong_samples

_CLIPPED = 0.01  # share of the samples from which on a sensor's end makes physics meaningless
_WRONG = -1.2  # misfit of a relation after all changes from which on they are unsure: sound data keep above −0.9
_TURN = 2 * np.pi
_BESIDE = ("position_command",)  # columns that no balance takes
_UNSURE = 0.5  # largest confidence where no change makes the channels fit
_LISTED = 4  # rows that are told one by one
_KEPT = 0.5  # of a recording's samples that stuck and clipped ones must leave for its channels to be held against each other
_UNREAD = ("joint_torque", "external_torque")  # columns that no estimator reads
_SCALES = (
    ("kelvin", (200.0, 500.0), 1.0, -273.15),
    ("degrees Fahrenheit", (120.0, 200.0), 5 / 9, -160 / 9),
)  # of temperatures that are none of a gear in °C: what they are, between which values, factor and offset
_NEAR_ZERO, _FEWEST = (
    2e-3,
    20,
)  # share and number of samples within its noise above zero, of a current that is never below
_SMALL = 0.05  # of what the current mostly is: the most that is taken for its noise


NO_CHANGE = "the channels do not fit this joint, whatever unit, sign or place is changed"


@dataclass(frozen=True)
class Mistake:
    """A mistake in the data.

    Attributes:
      name: `unit`, `sign`, `gear_ratio`, `swapped`, `late`, `wrapped`, `velocity`, `angle_zero`, `stuck`, `glitch`, `clipped`.
      column: that has it; empty where it is no single one's.
      recording: name of the recording that has it; empty where all have.
      description: for people.
      confidence: probability of it.
      factor: that mends the column (of `gear_ratio`: that mends N); of `wrapped` a whole turn in the column's unit.
      seconds: by which the column is late. offset: that mends it, added.
      rows: of the table that have it, from 0.
      also: further columns that the same change mends; an offset of the motor's on its own side of the gear.
      severe: whether it makes physics meaningless.
      lost: whether what was meant cannot be had from the file.
    """

    name: str
    column: str
    recording: str
    description: str
    confidence: float
    factor: float | None = None
    seconds: float | None = None
    offset: float | None = None
    rows: tuple[int, ...] | None = None
    also: tuple[str, ...] = ()
    severe: bool = True
    lost: bool = False

    @property
    def columns(self) -> str:
        """All columns that have it, for people; empty where it is no single one's."""
        return ", ".join(x for x in (self.column, *self.also) if x)

    @property
    def where(self) -> str:
        """Recording and columns that have it, for people; empty where it is all and everywhere."""
        return ": ".join(x for x in (self.recording, self.columns) if x)

    @property
    def sure(self) -> bool:
        """Whether its change makes the channels fit the joint; that which only mends most may be something else."""
        return self.confidence > _UNSURE and not self.lost

    @property
    def unmended(self) -> str:
        """What is said of it where it is not sure."""
        if self.lost:
            return f"{self.description}; {self.remedy}"
        return f"{NO_CHANGE}; what would mend most: {self.description}, {self.change}"

    @property
    def remedy(self) -> str:
        """What mends it, or what is said where nothing does."""
        if self.lost:
            return "nothing in the file mends that"
        return (
            f"{'mended by' if self.sure else 'no change makes the channels fit the joint; most would'}: {self.change}"
        )

    @property
    def change(self) -> str:
        """The change that mends it, in a few words."""
        if self.lost:
            return "to be logged anew"
        if self.name == "unit" and self.offset is not None:
            scaled = "" if self.factor in (None, 1.0) else f"× {self.factor:.6g}, "
            return f"{scaled}{self.offset:+.6g} K"
        if self.name == "sign":
            return "gravity_angle + π" if self.column == "gravity_angle" else "× −1"
        if self.name == "unit":
            return f"× {self.factor:.6g}"
        if self.name == "gear_ratio":
            return f"N × {self.factor:.6g}"
        if self.name == "late":
            return f"{1e3 * (self.seconds or 0.0):.4g} ms earlier"
        if self.name == "angle_zero":
            return f"{self.offset:+.5g} rad" + (", motor side by the gear ratio" if self.also else "")
        if self.name == "velocity":
            return "integrated" if self.factor is None else f"integrated, × {self.factor:.6g}"
        return {
            "swapped": "columns exchanged", "wrapped": "unwrapped", "glitch": "bridged", "stuck": "left out",
            "clipped": "left out",
        }[self.name]  # fmt: skip

    def to_json(self) -> dict[str, Any]:
        """As it stands in `diagnosis.json`."""
        data: dict[str, Any] = {"name": self.name}
        for key in ("column", "recording"):
            if getattr(self, key):
                data[key] = getattr(self, key)
        for key in ("factor", "seconds", "offset"):
            if getattr(self, key) is not None:
                data[key] = float(f"{getattr(self, key):.6g}")
        if self.also:
            data["also"] = list(self.also)
        if self.rows is not None:
            data["rows"] = list(self.rows)
        return data | {
            "description": self.description, "confidence": round(self.confidence, 3), "severe": self.severe,
            "sure": self.sure, "lost": self.lost, "change": self.change,
        }  # fmt: skip


@threadpool_limits.wrap(limits=1, user_api="blas")  # small matrices, for which threads are but a burden
@np.errstate(all="ignore")  # units may make anything of a number
def find_mistakes(measurement: Measurement, joint: Joint) -> tuple[Mistake, ...]:
    """Mistakes in a measurement of a joint, in the order in which `mended` undoes them.

    A cause of ordinary size (`spec/recording.md`), tolerances and what is imperfect in every real joint are none.
    """
    # With the output bolted to the bench neither encoder says what the other should.
    moving = tuple(r for r in measurement.recordings if not r.link.locked)
    if not moving:
        return ()
    recordings, found = moving, list[Mistake]()
    second = time_unit(recordings, joint)
    if second != 1.0:
        said = {1e-3: "milliseconds", 1e-6: "microseconds", 1e-9: "nanoseconds"}[second]
        found.append(Mistake("unit", "time", "", f"{said} taken for seconds", 0.99, factor=second))
    recordings = _apply(recordings, joint, found)
    found += [m for recording in recordings for m in (*_temperature(recording), *_rectified(recording, joint))]
    for recording, still in zip(recordings, still_commands(recordings, joint), strict=True):
        found += [_of_samples(m, recording) for m in (*wrong_samples(recording, joint), *still)]
    found = _merged(found, len(recordings))
    try:
        recordings = _apply(moving, joint, found)
    except InputError:  # what does not move is all there is
        return _by_name(found, moving, measurement.recordings)
    # Of one in which next to nothing but rest is left, what is beside it in the others says more.
    whole = [r for r, before in zip(recordings, moving, strict=True) if len(r.time) > _KEPT * len(before.time)]
    recordings = tuple(whole) or recordings
    carried = []
    if any(r.arm is not None and r.arm.positions for r in recordings):
        arm = change_in_an_arm(recordings, joint, lambda one: _apply(recordings, joint, _of_change(one, recordings)))
        carried = [] if arm is None else _of_change(arm, recordings)
        recordings = _apply(recordings, joint, carried)
    suspicions = Suspicions(recordings, joint)
    changes = suspicions.found if suspicions.mends or suspicions.before < _WRONG else ()
    further = [m for f in changes if f.change.name != "late" for m in _of_change(f, recordings)]
    late = [m for one in late_columns(_apply(recordings, joint, further), joint) for m in _of_lateness(one, recordings)]
    # Which column is late all relations together know better; the search had to know that one is.
    further += late or [m for f in changes if f.change.name == "late" for m in _of_change(f, recordings)]
    if not late and (suspicions.misfit < _WRONG or not suspicions.mends):
        # What mends most leaves channels that cannot be of this joint: it may be something else.
        further = [replace(m, confidence=min(m.confidence, _UNSURE)) for m in further]
    further = [*carried, *further]
    told = (*_by_name(found, moving, measurement.recordings), *_by_name(further, recordings, measurement.recordings))
    return tuple(replace(m, severe=m.severe and m.column not in _BESIDE) for m in told)


def _temperature(recording: Recording) -> list[Mistake]:
    """A temperature that no gear has in °C: kelvin, or degrees Fahrenheit."""
    if "temperature" not in recording:
        return []
    usual = float(np.median(recording["temperature"]))
    for said, (low, high), factor, offset in _SCALES:
        if low < usual < high:
            text = f"{said} taken for °C"
            return [Mistake("unit", "temperature", recording.name, text, 0.99, factor=factor, offset=offset)]
    return []


def _rectified(recording: Recording, joint: Joint) -> list[Mistake]:
    """A current of which only the magnitude was logged: it comes as near to zero as noise goes, and never below."""
    found = []
    for name, spec in (("motor_current", joint.sensors.motor_current), ("motor_torque", joint.sensors.motor_torque)):
        x = recording.columns.get(name)
        if x is None or not len(x) or float(x.min()) < 0.0:
            continue
        # In another unit all of it may be within the noise that is described.
        noise = min(max(spec.noise, float(np.median(np.abs(np.diff(x))))), _SMALL * float(np.quantile(x, 0.9)))
        if np.count_nonzero((x > 0.0) & (x < noise)) > max(_NEAR_ZERO * len(x), _FEWEST):
            text = "its magnitude without its sign: it comes down to zero as often as it would cross it, and is never below"
            found.append(Mistake("sign", name, recording.name, text, 0.99, lost=True))
    return found


def require_sound(measurement: Measurement, joint: Joint) -> tuple[Mistake, ...]:
    """Refuse a measurement of whose motion and current no estimate means anything.

    Returns:
      Mistakes in columns that no estimator reads: what is held against them means nothing.

    Raises:
      InputError: the first severe mistake in a column that estimators read, and the change that mends it.
    """
    found = find_mistakes(measurement, joint)
    severe = [m for m in found if m.severe]
    for m in severe:
        if m.column not in _UNREAD:
            where = ": ".join(name for name in (m.recording or measurement.name, m.columns) if name)
            if not m.sure:
                raise InputError(f"{where}: {m.unmended}")
            if mended_if_possible(measurement, joint, found) is None:
                raise InputError(f"{where}: {m.description}; without it nothing can be estimated")
            raise InputError(
                f"{where}: {m.description}, mended by: {m.change}; `{mending(measurement, joint, 'DIR')}` writes it mended"
            )
    return tuple(m for m in severe if m.column in _UNREAD)


def mended_if_possible(measurement: Measurement, joint: Joint, mistakes: Sequence[Mistake]) -> Measurement | None:
    """`mended`, or None where of what is left out too little remains."""
    try:
        return mended(measurement, joint, mistakes)
    except InputError:
        return None


def mended(measurement: Measurement, joint: Joint, mistakes: Sequence[Mistake]) -> Measurement:
    """The measurement without those of the mistakes that are sure: columns as they were meant, samples that nothing can mend left
    out."""
    return replace(measurement, recordings=_apply(measurement.recordings, joint, [m for m in mistakes if m.sure]))


def _of_samples(found: SampleMistake, recording: Recording) -> Mistake:
    n, rows = len(recording.time), found.rows
    count = "one sample" if len(rows) == 1 else f"{len(rows)} samples"
    listed = ", ".join(map(str, rows)) if len(rows) <= _LISTED else f"{rows[0]} to {rows[-1]}"
    where = f"row{'s' if len(rows) > 1 else ''} {listed}"
    severe = True
    if found.name == "glitch":
        text = f"{count} far off the neighbours, {where}"
    elif found.name == "wrapped":
        text = f"jumps by a whole turn ({found.turn:g}) {'once' if len(rows) == 1 else f'{len(rows)} times'}, {where}"
    elif found.name == "stuck":
        text = "does not move at all" if len(rows) == n else f"does not move in {count} although it should, {where}"
    else:
        text = f"{count} at the sensor's end, {where}"
        severe = len(rows) > _CLIPPED * n
    return Mistake(found.name, found.column, recording.name, text, 0.99, factor=found.turn, rows=rows, severe=severe)


def _merged(found: list[Mistake], recordings: int) -> list[Mistake]:
    """The same, with no recording's name where there is but one."""
    return [replace(m, recording="") for m in found] if recordings == 1 else found


def _by_name(
    found: Sequence[Mistake], looked_at: Sequence[Recording], all_of_them: Sequence[Recording]
) -> tuple[Mistake, ...]:
    """The same; what all recordings have that were looked at, of each of these by its name where there are others."""
    if len(looked_at) == len(all_of_them):
        return tuple(found)
    every = [r.name for r in looked_at]
    return tuple(replace(m, recording=name) for m in found for name in ([m.recording] if m.recording else every))


def _of_lateness(found: LateColumn, recordings: Sequence[Recording]) -> list[Mistake]:
    text = f"{1e3 * found.seconds:.3g} ms late against the others"
    one = Mistake("late", found.column, "", text, found.confidence, seconds=found.seconds)
    return _where(one, found.recordings, recordings)


def _where(mistake: Mistake, having: Sequence[int], recordings: Sequence[Recording]) -> list[Mistake]:
    """A mistake of those recordings, by index, that have it: one where all have."""
    names = [""] if len(having) == len(recordings) else [recordings[i].name for i in having]
    return [replace(mistake, recording=name) for name in names]


def _of_change(found: Found, recordings: Sequence[Recording]) -> list[Mistake]:
    change = found.change
    apart = [one for one in change.also if change.column != GRAVITY and one.factor != change.factor]
    if apart:  # each with a factor of its own
        same = replace(change, also=tuple(one for one in change.also if one not in apart))
        return [m for one in (same, *apart) for m in _of_change(replace(found, change=one), recordings)]
    one = Mistake(
        change.name, change.column, "", change.description, found.confidence, factor=change.factor, seconds=change.seconds,
        offset=np.pi if change.column == GRAVITY else change.offset,
        also=() if change.column == GRAVITY else tuple(c.column for c in change.also),
    )  # fmt: skip
    return _where(one, found.recordings, recordings)


def _apply(recordings: Iterable[Recording], joint: Joint, mistakes: Sequence[Mistake]) -> tuple[Recording, ...]:
    return tuple(
        _mend(recording, joint, [m for m in mistakes if m.recording in ("", recording.name)])
        for recording in recordings
    )


def _mend(recording: Recording, joint: Joint, mistakes: Sequence[Mistake]) -> Recording:
    """One recording without mistakes; of samples first, as they were found."""
    if not mistakes:
        return recording
    N = joint.numbers["N"].value
    time, columns = recording.time, dict(recording.columns)
    lost = np.zeros(len(time), bool)
    for m in mistakes:
        if m.column == "time" and m.factor is not None:
            time = m.factor * (time - time[0])
            continue
        if m.name == "swapped":
            _swap(columns)
            continue
        if m.lost:
            columns.pop(m.column, None)
            check_channels(f"{recording.source or recording.name}: without {m.column}, whose sign is lost", columns)
            continue
        if m.column == GRAVITY:
            turned = float(np.remainder(recording.link.gravity_angle + np.pi, _TURN))
            turned -= _TURN if turned > np.pi else 0.0
            recording = replace(recording, link=recording.link.model_copy(update={"gravity_angle": turned}))
            continue
        for column in (m.column, *m.also):
            if column not in columns:
                continue
            x = columns[column]
            if m.name in ("stuck", "clipped"):
                assert m.rows is not None
                if len(m.rows) == len(time):
                    del columns[column]
                    check_channels(f"{recording.source or recording.name}: without {column}, which is stuck", columns)
                else:
                    lost[list(m.rows)] = True
            elif m.name == "late":
                assert m.seconds is not None
                columns[column] = np.interp(time + m.seconds, time, x)
                # Nothing was measured beyond the ends, and none of what lies within a gap.
                after = np.clip(np.searchsorted(time, time + m.seconds), 1, len(time) - 1)
                lost |= (time + m.seconds > time[-1]) | (time + m.seconds < time[0])
                lost |= time[after] - time[after - 1] > GAP
            else:
                columns[column] = _column(m, column, time, x, columns, N)
    found = replace(recording, time=time, columns=columns)
    if lost.any():
        found = found.at(~lost)
    if recording.arm is not None and any(
        c in (*POSITIONS, "time") for m in mistakes for c in (m.column or "link_position", *m.also)
    ):
        found = carried_anew(found, N)  # what the arm's motion puts on a link depends on where that is, and how fast
    return found


def _column(m: Mistake, column: str, time: np.ndarray, x: np.ndarray, columns: dict, N: float) -> np.ndarray:
    """A column without one mistake, shape (n,)."""
    factor = 1.0 if m.factor is None else m.factor
    if m.name == "glitch":
        return bridged(time, x, np.array(m.rows, int))
    if m.name == "wrapped":
        guide = next((n for n in (*POSITIONS, "position_command") if n in columns and n != column), None)
        jumps = np.array(m.rows, int)
        if guide is None:
            return unwrapped(time, x, jumps, factor)
        start = _side(column, guide, N) * float(columns[guide][0]) if factor == _TURN else 0.0
        return unwrapped(time, x, jumps, factor, columns[guide], start)
    if m.name == "velocity":
        steps = 0.5 * np.diff(time) * (x[1:] + x[:-1])
        position = factor * np.concatenate([[0.0], np.cumsum(steps)])
        guide = next((n for n in (*POSITIONS, "position_command") if n in columns and n != column), None)
        if guide is None:
            return position
        return position + float(np.median(_side(column, guide, N) * columns[guide] - position))
    if m.name == "sign":
        return -x
    if m.name == "gear_ratio" and column == "motor_position":
        factor = 1 / factor
    offset = m.offset or 0.0
    if m.name in ("unit", "gear_ratio"):
        return factor * x + offset
    if column != m.column:
        offset *= _side(column, m.column, N)
    return x + offset


def _side(column: str, other: str, N: float) -> float:
    """Angle of a column's shaft over that of another's."""
    return (N if column == "motor_position" else 1.0) / (N if other == "motor_position" else 1.0)


def _swap(columns: dict[str, np.ndarray]) -> None:
    """Exchange both positions, in place; the only one goes under the other's name."""
    found = {name: columns.pop(name) for name in POSITIONS if name in columns}
    for name, x in found.items():
        columns[POSITIONS[1 - POSITIONS.index(name)]] = x
