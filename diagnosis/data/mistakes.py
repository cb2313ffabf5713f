"""What people get wrong in their data, each named with the change that mends it: before any physics.

Single samples come first (`samples`), then whole columns: one loop applies every entry of the table (`changes`) to the channels
and scores what it makes of their relations (`plausibility`). It keeps the entries that gain most, and looks again, as a first
step may only look good. Last come columns that are late (`lateness`).

A confidence is absolute: above 0.5 only where the mended channels fit the joint, and where no description that is wrong by a few
times explains the channels without a change.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from threadpoolctl import threadpool_limits

from ...models.command_lines import mending
from ...models.errors import InputError
from ...models.joint import Joint
from ...models.recording import GAP, Measurement, Recording, check_channels, with_arm_load
from ...models.signals import DRIVING, POSITIONS
from .changes import GRAVITY, NO_CHANGE, Mistake, Table, expected_sign, shrinkage, side, undone
from .lateness import late_columns
from .plausibility import SETTINGS as AGREEMENT
from .plausibility import Plausibility, RelationFit, SmoothedChannels, motion_of
from .samples import bridged, still_commands, unwrapped, wrong_samples

__all__ = ["NO_CHANGE", "Mistake", "find_mistakes", "mended", "mended_if_possible", "require_sound"]


@dataclass(frozen=True)
class ClaimSettings:
    """When a change is believed; in log likelihood where nothing else is said.

    Set on `benchmarks/mistakes.py`: mistakes hidden in sound measurements, and sound ones in which nothing may be found.
    """

    sure: float = 7.0  # gain beyond its price from which on a change is believed
    at_odds: float = 0.1  # by how much changes may make one of these worse
    wrong: float = -0.6  # misfit of a relation below which the channels do not fit
    hopeless: float = -5.0  # misfit below which a relation does not hold at all, by however much
    lasting: float = 4.0  # of recordings whose misfit says that nothing fits [s]
    worse: float = -3.0  # loss in a recording from which on a change is not one of the whole measurement
    much_worse: float = -9.0  # where the recording's channels go together with it, or better than before
    one_of_several: float = 4.0  # price of a mistake that not all recordings have, more
    beyond: float = 15.0  # price of a description that would have to be wrong by more than a few times
    kept: int = 3  # states that are kept
    most: int = 3  # changes on top of each other
    least_motion: float = 0.1  # of the link [rad], which angles in another unit must still show
    rest: float = 0.5  # of a recording's samples that stuck and clipped ones must leave for its channels to be compared


SETTINGS = ClaimSettings()
_TURN = 2 * np.pi
_UNSURE = 0.5  # largest confidence where no change makes the channels fit
_BESIDE = ("position_command",)  # columns that no balance takes
_UNREAD = ("joint_torque", "external_torque")  # columns that no estimator reads
_SCALES = (
    ("kelvin", (200.0, 500.0), 1.0, -273.15),
    ("degrees Fahrenheit", (120.0, 200.0), 5 / 9, -160 / 9),
)  # of temperatures that are none of a gear in °C: what they are, between which values, factor and offset
_NEAR_ZERO = 0.05  # of what a torque mostly is
_APART, _SMOOTH = (
    20,
    0.3,
)  # samples, and second differences over first ones, below which a log is sampled faster than it moves


@threadpool_limits.wrap(limits=1, user_api="blas")  # small matrices, for which threads are but a burden
@np.errstate(all="ignore")  # units may make anything of a number
def find_mistakes(measurement: Measurement, joint: Joint) -> tuple[Mistake, ...]:
    """Find the mistakes in a measurement of a joint, in the order in which `mended` undoes them.

    A cause of ordinary size (`spec/recording.md`), tolerances and what is imperfect in every real joint are none.

    Args:
      measurement: whose recordings with the output bolted to the bench are passed over: there neither encoder says what the other
        should.
      joint: its description, which may be wrong by a few times.

    Returns:
      All that are found, severe or not, sure or not.
    """
    moving = tuple(r for r in measurement.recordings if not r.link.locked)
    found = list[Mistake]()
    second = _time_unit(moving)
    if second != 1.0:
        said = {1e-3: "milliseconds", 1e-6: "microseconds", 1e-9: "nanoseconds"}[second]
        found.append(Mistake("unit", "time", "", f"{said} taken for seconds", 0.99, factor=second))
    recordings = _apply(moving, joint, found)
    for recording, still in zip(recordings, still_commands(recordings, joint), strict=True):
        found += [*_temperature(recording), *wrong_samples(recording, joint), *still]
    if len(moving) == 1:
        found = [replace(m, recording="") for m in found]
    further: list[Mistake] = []
    try:
        recordings = _apply(moving, joint, found)
    except InputError:  # what does not move is all there is
        recordings = ()
    if recordings:
        # Of one in which next to nothing but rest is left, the others say more.
        rest = [r for r, a in zip(recordings, moving, strict=True) if len(r.time) > SETTINGS.rest * len(a.time)]
        recordings = tuple(rest) or recordings
        further = _of_columns(recordings, joint)
    told = (*_by_name(found, moving, measurement.recordings), *_by_name(further, recordings, measurement.recordings))
    return tuple(replace(m, severe=m.severe and m.column not in _BESIDE) for m in told)


def _of_columns(recordings: Sequence[Recording], joint: Joint) -> list[Mistake]:
    """What is wrong with whole columns of recordings whose samples are right."""
    search = _Search(recordings, joint)
    start, end = search.start, search.best()
    if _not_followed(start.fits, end.fits):
        end = start
    mends = _better(start, end)
    lasting = [r.time[-1] - r.time[0] > SETTINGS.lasting for r in recordings]
    before = _worst([fits for fits, there in zip(start.fits, lasting, strict=True) if there])
    if not mends and before > SETTINGS.wrong:
        end = start
    about = {c for m, _ in end.found for c in (m.column, *m.also)}
    # A command that a stop or a push keeps the joint from following says nothing of the other columns.
    ignored = [] if "position_command" in about or not mends else ["command"]
    # The integral of a velocity drifts, and a sign that is lost is only about what the description says.
    ignored += [
        "encoders" if m.name == "velocity" else m.column
        for m, _ in end.found
        if m.name == "velocity" or (m.name == "sign" and m.lost)
    ]
    after = _worst([{n: fit for n, fit in fits.items() if n not in ignored} for fits in end.fits])
    found = [one for m, having in end.found for one in _where(m, having, recordings)]
    others = [m for m in found if m.name != "late"]
    try:
        late = [
            one
            for m, having in late_columns(_apply(recordings, joint, others), joint)
            for one in _where(m, having, recordings)
        ]
    except InputError:  # the only torque has lost its sign
        late = []
    # Which column is late all relations together know better; the search had to know that one is.
    found = [*others, *(late or [m for m in found if m.name == "late"])]
    beyond = sum(map(_beyond, start.fits, end.fits)) > 0.5 * len(recordings)
    if not late and (after < SETTINGS.wrong or beyond or not mends):
        # What mends most leaves channels that cannot be of this joint: it may be something else.
        found = [replace(m, confidence=min(m.confidence, _UNSURE)) for m in found]
    return found


_Fits = Sequence[dict[str, RelationFit]]
"""Relations of every recording; changes leave the same ones, but for a torque that goes under another name."""


@dataclass(frozen=True)
class _State:
    """Changes made so far, each with the recordings that have it, and what became of every recording's channels."""

    motions: tuple[SmoothedChannels | None, ...]
    fits: tuple[dict[str, RelationFit], ...]
    found: tuple[tuple[Mistake, tuple[int, ...]], ...] = ()
    price: float = 0.0
    credit: float = 0.0  # part of it, below zero, that makes up for larger torques and a description that was beyond

    @property
    def score(self) -> float:
        return sum(map(_total, self.fits)) - self.price


class _Search:
    """The changes that a measurement's channels ask for.

    Attributes:
      start: the channels as they are.
    """

    def __init__(self, recordings: Sequence[Recording], joint: Joint):
        self._recordings, self._joint = tuple(recordings), joint
        self._N, self._p = joint.numbers["N"].value, [joint.record(r.link)[0] for r in recordings]
        self._plausible = [Plausibility(joint, r) for r in recordings]
        self._carried = [r.arm is not None and bool(r.arm.positions) for r in recordings]

        def all_are(names: Iterable[str], of: Callable[[np.ndarray], bool]) -> frozenset[str]:
            there = {n: [r[n] for r in recordings if n in r] for n in names}
            return frozenset(n for n, found in there.items() if found and all(map(of, found)))

        self._table = Table(
            joint, self._plausible, all_are(POSITIONS, lambda x: np.array_equal(x, np.round(x))),
            all_are(DRIVING, _folded), not any(self._carried),
        )  # fmt: skip
        motions = tuple(motion_of(r) for r in recordings)
        fits = tuple({} if m is None else p.agreement(m) for p, m in zip(self._plausible, motions, strict=True))
        self.start = _State(motions, fits)

    def best(self) -> _State:
        """The state that nothing improves enough."""
        states, best = [self.start], self.start
        for depth in range(SETTINGS.most):
            looked = [s for s in states if any(map(_suspicious, s.fits)) or (depth == 0 and _vague(s.fits))]
            further = [s for state in looked for s in self._steps(state)]
            states = sorted(further, key=lambda s: -s.score)[: SETTINGS.kept]
            if not states or states[0].score <= best.score + SETTINGS.sure:
                break
            best = states[0]
        return best

    def _without(self, m: Mistake, i: int, state: _State) -> SmoothedChannels | None:
        """A recording's channels without one mistake more; the same where it has none of its columns."""
        motion = state.motions[i]
        touched = m.name == "swapped" or m.column in ("time", GRAVITY)
        if motion is None or not (touched or any(c in motion for c in (m.column, *m.also))):
            return motion
        if self._carried[i] and {m.column or "link_position", *m.also} & set(POSITIONS):
            # What the arm in motion puts on the link depends on where that is.
            mine = [one for one, having in state.found if i in having]
            try:
                return motion_of(_mend(self._recordings[i], self._joint, [*mine, m]))
            except InputError:
                return motion
        if m.name == "sign" and m.lost:  # as the description has it: a magnitude that is smoothed does not come to zero
            r, mine = self._recordings[i], [one for one, having in state.found if i in having]
            sign = expected_sign(motion.channels, self._N, self._p[i])
            x = r[m.column] * np.sign(np.interp(r.time - r.time[0], motion.time, sign))
            return motion_of(_mend(replace(r, columns={**r.columns, m.column: x}), self._joint, mine))
        time, channels = undone(m, motion.time, motion.channels, self._N, self._p[i])
        return replace(motion, time=time, channels=channels)

    def _steps(self, state: _State) -> list[_State]:
        """All states one change further that are better than this one by more than that change's price."""
        steps, done = list[_State](), {(m.name, m.column) for m, _ in state.found}
        old = state.fits
        for m in self._table.entries(state.motions):
            if (m.name, m.column) in done:
                continue
            motions = [self._without(m, i, state) for i in range(len(old))]
            same = [new is before for new, before in zip(motions, state.motions, strict=True)]
            new = [
                f if s or motion is None else p.agreement(motion, before, f)
                for p, motion, before, f, s in zip(self._plausible, motions, state.motions, old, same, strict=True)
            ]
            more = [_total(b) - _total(a) for a, b in zip(old, new, strict=True)]
            costs = [
                0.0 if s else shrinkage(m, b, a, AGREEMENT.effective) for a, b, s in zip(old, new, same, strict=True)
            ]
            costs = [
                cost + SETTINGS.beyond * (_beyond(a, b) - _beyond(b, a))
                for cost, a, b in zip(costs, old, new, strict=True)
            ]
            gains = [x - cost for x, cost in zip(more, costs, strict=True)]
            bears = [
                SETTINGS.much_worse if not _suspicious(b) or _worst([b]) > _worst([a]) else SETTINGS.worse
                for a, b in zip(old, new, strict=True)
            ]
            everywhere = all(gain > least for gain, least in zip(gains, bears, strict=True))
            least = m.price + SETTINGS.sure
            chosen = [i for i, g in enumerate(gains) if everywhere or g > least]
            # Where it is so in one recording, that a torque looks like nothing is no reason against it in another whose channels
            # do not go together otherwise.
            chosen = sorted({*chosen, *(
                i for i, (a, b) in enumerate(zip(old, new, strict=True))
                if chosen and more[i] > least and _suspicious(a) and not _suspicious(b)
            )})  # fmt: skip
            if not chosen or not self._leaves_motion(m, [motions[i] for i in chosen], [new[i] for i in chosen]):
                continue  # a link that hardly moves asks for no torque: that suits any log
            everywhere = all(i in chosen or unchanged for i, unchanged in enumerate(same))
            price = m.price if everywhere else (m.price + SETTINGS.one_of_several) * len(chosen)
            gain = sum(gains[i] for i in chosen) - price
            if gain <= 0:
                continue
            sure = replace(m, confidence=1 / (1 + math.exp(-min(gain, 50.0) / 3)))
            steps.append(
                _State(
                    tuple(motions[i] if i in chosen else state.motions[i] for i in range(len(old))),
                    tuple(new[i] if i in chosen else old[i] for i in range(len(old))),
                    (*state.found, (sure, tuple(chosen))),
                    state.price + price + sum(costs[i] for i in chosen),
                    state.credit + sum(min(costs[i], 0.0) for i in chosen if not m.becomes),
                )
            )
        for column in POSITIONS:
            steps = self._units_told_apart(steps, column)
        return steps

    def _leaves_motion(self, m: Mistake, mended: Sequence[SmoothedChannels | None], fits: _Fits) -> bool:
        """Whether channels without the mistake still show a motion, where the change makes angles smaller that no other encoder
        agrees with."""
        if m.name != "unit" or m.factor is None or abs(m.factor) >= 1.0:
            return True
        for motion, relations in zip(mended, fits, strict=True):
            there = [name for name in POSITIONS if motion is not None and name in motion]
            if motion is None or not {m.column, *m.also} & set(there):
                return True
            if len(there) == 2 and not relations["encoders"].suspicious:
                return True
            there = [name for name in there if name in (m.column, *m.also)]
            if max(np.ptp(motion.channels[n][:, 0]) / side(n, "", self._N) for n in there) > SETTINGS.least_motion:
                return True
        return False

    def _units_told_apart(self, steps: Sequence[_State], column: str) -> list[_State]:
        """Steps of which those that take a column alone for counts (whole numbers: for an angle in any unit) are one, as sure as
        what else it may be lets it be.

        Counts of a coarser encoder are a larger motion, which rests less and of which more is known: that tells a motion from
        next to none, but not one from another half as large. Of those whose readings fit about as well the described encoder's
        it is; whole numbers in another unit than counts would be strange.
        """
        whole = column in self._table.whole

        def of_them(m: Mistake) -> bool:
            return m.name == "unit" and m.column == column and not m.also and (m.counts is not None or whole)

        some = [s for s in steps if of_them(s.found[-1][0])]
        if not some:
            return list(steps)
        scores = [sum(_said(fit) for fits in s.fits for fit in fits.values()) - s.price for s in some]
        near = [(x, s) for x, s in zip(scores, some, strict=True) if x > max(scores) - SETTINGS.sure]
        described = [(x, s) for x, s in near if s.found[-1][0].counts]
        score, best = described[0] if described else max(near, key=lambda one: one[1].score)
        *before, (last, having) = best.found
        alone = 1.0 / sum(math.exp(min(x - score, 50.0) / 3) for x in scores)
        if (not described and len(near) > 1) or (whole and last.counts is None):
            alone = min(alone, _UNSURE)
        last = replace(last, confidence=min(last.confidence, alone))
        return [*(s for s in steps if not of_them(s.found[-1][0])), replace(best, found=(*before, (last, having)))]


def _folded(x: np.ndarray) -> bool:
    """Whether a torque is never below zero and comes down to it as often as it would cross it."""
    near = _NEAR_ZERO * float(np.quantile(np.abs(x), 0.9))
    return bool(x.min() >= 0.0 and np.count_nonzero(x < near) > max(2e-3 * len(x), 4))


def _suspicious(fits: dict[str, RelationFit]) -> bool:
    """Whether a recording's channels do not go together."""
    return any(fit.suspicious for fit in fits.values())


def _vague(fits: _Fits) -> bool:
    """Whether a residual is not much less than what is allowed."""
    return any(fit.vague for relations in fits for fit in relations.values())


def _beyond(before: dict[str, RelationFit], after: dict[str, RelationFit]) -> bool:
    """Whether the description would have to be wrong by more than a few times after a change, and not before."""
    return any(fit.at_bound and not (name in before and before[name].at_bound) for name, fit in after.items())


def _worst(fits: _Fits) -> float:
    """Misfit of the relation that fits worst, of two angles half as bad; 0 where there is none."""
    found = [fit.misfit * (1.0 if name in DRIVING else 0.5) for relations in fits for name, fit in relations.items()]
    return min(found, default=0.0)


def _total(fits: dict[str, RelationFit]) -> float:
    return sum(fit.agreement for fit in fits.values())


def _said(fit: RelationFit) -> float:
    """What readings say of a relation; of one that does not hold at all, as the other column is wrong, too, no more than that."""
    return fit.readings * SETTINGS.hopeless / min(fit.misfit, SETTINGS.hopeless)


def _gained(before: _Fits, after: _Fits, but: str = "") -> float:
    """By how much better the readings of all relations but one fit, in log likelihood."""
    return sum(
        sum(fit.readings for name, fit in fits.items() if name != but) * sign
        for sign, all_of_them in ((1, after), (-1, before))
        for fits in all_of_them
    )


def _not_followed(before: _Fits, after: _Fits) -> bool:
    """Whether changes mend nothing but what the command says, and the link does not follow it all the same: a stop holds it, or
    the drive's limit does."""
    commands = [(old["command"], new["command"]) for old, new in zip(before, after, strict=True) if "command" in new]
    commanded = any(new.misfit < AGREEMENT.suspicious and new is not old for old, new in commands)
    return commanded and _gained(before, after, but="command") < SETTINGS.sure


def _better(before: _State, after: _State) -> bool:
    """Whether readings fit better than before, in addition to what is known of more of them, and no relation is at odds that was
    not.

    An angle in turns moves six times as fast: less of it is at rest, where friction may be anything, and of a second in which
    next to nothing moves that alone once spoke for turns.
    """
    at_odds = any(
        fit.misfit < min(AGREEMENT.suspicious, old[name].misfit - SETTINGS.at_odds)
        for old, new in zip(before.fits, after.fits, strict=True)
        for name, fit in new.items()
        if name in old
    )
    return not at_odds and _gained(before.fits, after.fits) - after.credit > SETTINGS.sure


def _time_unit(recordings: Sequence[Recording]) -> float:
    """What one unit of time is [s]: samples with gaps between them all, of a motion that hardly changes from one to the next, are
    no log in seconds, whatever else is wrong with it."""
    interval = min((r.interval for r in recordings), default=0.0)
    if interval <= GAP or not all(_sampled_fast(r) for r in recordings):
        return 1.0
    return next((unit for unit in (1e-3, 1e-6, 1e-9) if interval * unit < GAP), 1.0)


def _sampled_fast(recording: Recording) -> bool:
    """Whether a recording's angles are sampled much faster than they move."""
    for name in POSITIONS:
        x = recording.columns.get(name)
        if x is not None and len(x) > 4 * _APART:
            first = x[_APART:] - x[:-_APART]
            second = first[_APART:] - first[:-_APART]
            usual = [float(np.quantile(np.abs(d), 0.95)) for d in (first, second)]  # a gap's jump left aside
            if usual[1] < _SMOOTH * usual[0]:
                return True
    return False


def _temperature(recording: Recording) -> list[Mistake]:
    """A temperature that no gear has in °C: kelvin, or degrees Fahrenheit."""
    if "temperature" not in recording:
        return []
    usual = float(np.median(recording["temperature"]))
    return [
        Mistake("unit", "temperature", recording.name, f"{said} taken for °C", 0.99, factor=factor, offset=offset)
        for said, (low, high), factor, offset in _SCALES
        if low < usual < high
    ]


def require_sound(measurement: Measurement, joint: Joint) -> tuple[Mistake, ...]:
    """Refuse a measurement of whose motion and current no estimate means anything.

    Returns:
      Mistakes in columns that no estimator reads: what is compared with them means nothing.

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


def fixed(measurement: Measurement, joint: Joint, mistakes: Sequence[Mistake]) -> Measurement:
    """`mended`, with what was changed noted in every recording."""
    found = mended(measurement, joint, mistakes)

    def noted(r: Recording) -> Recording:
        mine = [m for m in mistakes if m.sure and m.recording in ("", r.name)]
        said = tuple(f"{m.name}: {m.columns + ': ' if m.columns else ''}{m.description}: {m.change}" for m in mine)
        return replace(r, fixed=(*r.fixed, *said))

    return replace(found, recordings=tuple(map(noted, found.recordings)))


@np.errstate(all="ignore")
def fits_no_better(before: Measurement, after: Measurement, joint: Joint) -> bool:
    """Whether the channels of a measurement fit the joint after a change no better than before, and do not fit."""
    misfits = []
    for one in (before, after):
        moving = tuple(r for r in one.recordings if not r.link.locked)
        misfits.append(_worst(_Search(moving, joint).start.fits) if moving else 0.0)
    return misfits[1] < AGREEMENT.suspicious and misfits[1] <= misfits[0]


def _by_name(found: Sequence[Mistake], seen: Sequence[Recording], every: Sequence[Recording]) -> tuple[Mistake, ...]:
    """The same; what all recordings have that were looked at, of each of these by its name where there are others."""
    if len(seen) == len(every):
        return tuple(found)
    names = [r.name for r in seen]
    return tuple(replace(m, recording=name) for m in found for name in ([m.recording] if m.recording else names))


def _where(mistake: Mistake, having: Sequence[int], recordings: Sequence[Recording]) -> list[Mistake]:
    """A mistake of those recordings, by index, that have it: one where all have."""
    names = [""] if len(having) == len(recordings) else [recordings[i].name for i in having]
    return [replace(mistake, recording=name) for name in names]


def _apply(recordings: Iterable[Recording], joint: Joint, mistakes: Sequence[Mistake]) -> tuple[Recording, ...]:
    return tuple(_mend(r, joint, [m for m in mistakes if m.recording in ("", r.name)]) for r in recordings)


def _mend(recording: Recording, joint: Joint, mistakes: Sequence[Mistake]) -> Recording:
    """One recording without mistakes; of samples first, as they were found."""
    if not mistakes:
        return recording
    N, p = joint.numbers["N"].value, joint.record(recording.link)[0]
    where = f"{recording.source or recording.name}: without"
    time, columns = recording.time, dict(recording.columns)
    lost = np.zeros(len(time), bool)
    for m in mistakes:
        rows = np.array(m.rows or (), int)
        if m.name == "sign" and m.lost:
            columns.pop(m.column, None)
            check_channels(f"{where} {m.column}, whose sign is lost", columns)
        elif m.column == GRAVITY:
            turned = float(np.remainder(recording.link.gravity_angle + np.pi, _TURN))
            turned -= _TURN if turned > np.pi else 0.0
            recording = replace(recording, link=recording.link.model_copy(update={"gravity_angle": turned}))
        elif m.name in ("stuck", "clipped") and m.column in columns:
            if len(rows) == len(time):
                del columns[m.column]
                check_channels(f"{where} {m.column}, which is stuck", columns)
            else:
                lost[rows] = True
        elif m.name == "glitch" and m.column in columns:
            columns[m.column] = bridged(time, columns[m.column], rows)
        elif m.name == "wrapped" and m.offset is None and m.column in columns:
            columns[m.column] = _unwrapped(m, time, columns, rows, N)
        else:
            time, columns = undone(m, time, columns, N, p)
            if m.name == "late":  # nothing was measured beyond the ends, and none of what lies within a gap
                after = np.clip(np.searchsorted(time, time + m.seconds), 1, len(time) - 1)
                lost |= (time + m.seconds > time[-1]) | (time + m.seconds < time[0])
                lost |= time[after] - time[after - 1] > GAP
    found = replace(recording, time=time, columns=columns)
    found = found.at(~lost) if lost.any() else found
    moved = {c for m in mistakes for c in (m.column or "link_position", *m.also)} & {*POSITIONS, "time"}
    # What the arm's motion puts on a link depends on where that is, and how fast.
    return with_arm_load(found, N) if moved and recording.arm is not None else found


def _unwrapped(m: Mistake, time: np.ndarray, columns: dict[str, np.ndarray], rows: np.ndarray, N: float) -> np.ndarray:
    """A column without jumps by whole turns or by a register's range, shape (n,)."""
    x, turn = columns[m.column], m.factor or _TURN
    if m.column in DRIVING:  # of a register what is beyond half of its range is negative
        return np.where(x > 0.5 * turn, x - turn, x)
    guide = next((n for n in (*POSITIONS, "position_command") if n in columns and n != m.column), None)
    if guide is None:
        return unwrapped(time, x, rows, turn)
    start = side(m.column, guide, N) * float(columns[guide][0]) if turn == _TURN else 0.0
    return unwrapped(time, x, rows, turn, columns[guide], start)
