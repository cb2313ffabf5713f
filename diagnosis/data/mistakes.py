"""Find mistakes in a measurement, each with its correction, before any fit.

1. Single samples (`samples`).
2. Whole columns: apply every entry of the table (`changes`) to the channels, score the relations of the result (`plausibility`),
   keep the best states, and repeat.
3. Time offsets (`time_offsets`).

A confidence above 0.5 requires that the corrected channels fit the joint, and that no description within a few times the stated
one explains the original channels.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from threadpoolctl import threadpool_limits

from ...models.command_lines import mending
from ...models.errors import InputError, InputWarning
from ...models.joint import Joint
from ...models.recording import GAP, Measurement, Recording, check_channels, with_load
from ...models.signals import DRIVING, POSITIONS
from .changes import GRAVITY, NO_CHANGE, UNSURE, Mistake, Table, expected_sign, probability, shrinkage, side, undone
from .plausibility import SETTINGS as AGREEMENT
from .plausibility import Plausibility, RelationFit, SmoothedChannels, motion_of
from .samples import bridged, still_commands, unwrapped, wrong_samples
from .time_offsets import late_columns

__all__ = ["NO_CHANGE", "Mistake", "find_mistakes", "mended", "mended_if_possible", "require_sound", "unclipped"]


@dataclass(frozen=True)
class ClaimSettings:
    """When a change is accepted; in log likelihood unless stated. Set on `benchmarks/mistakes.py`."""

    sure: float = 7.0  # gain beyond its price above which a change is accepted
    at_odds: float = 0.1  # by how much a change may worsen a misfit
    wrong: float = -0.6  # misfit of a relation below which the channels do not fit
    rest: float = 0.2  # residual over spread of a torque above which an unmeasured load explains it as well
    hopeless: float = -5.0  # misfit below which a relation is invalid
    worse: float = -9.0  # loss in a recording below which a change is not of all recordings
    one_of_several: float = 4.0  # added price of a mistake that not all recordings have
    few: float = 3.0  # ratio of both numbers of a load to the described ones from which a torque's unit may be wrong
    beyond: float = 15.0  # price of a description that is wrong by more than a few times
    kept: int = 3  # states that are kept
    most: int = 3  # changes on top of each other
    least_motion: float = 0.1  # least motion of the link [rad] after a change of the angles' unit
    valid: float = 0.5  # least share of valid samples of a recording to compare its channels


SETTINGS = ClaimSettings()
_TURN = 2 * np.pi
_OPTIONAL = ("position_command",)  # columns that no balance uses
_OF_LOAD = ("no_gravity", "angle_zero")  # mistakes that another load explains by nature
_UNREAD = ("joint_torque", "external_torque")  # columns that no estimator reads
_SCALES = (
    ("kelvin", (200.0, 500.0), 1.0, -273.15),
    ("degrees Fahrenheit", (120.0, 200.0), 5 / 9, -160 / 9),
)  # wrong units of a temperature: name, range of values, factor, offset
_NEAR_ZERO, _AWAY = 0.05, 0.25  # of a torque's usual size: at zero below, away from it above
# samples, and second over first differences below which a log is sampled faster than it moves
_APART, _SMOOTH = 20, 0.3


@threadpool_limits.wrap(limits=1, user_api="blas")  # small matrices
@np.errstate(all="ignore")  # wrong units overflow
def find_mistakes(measurement: Measurement, joint: Joint) -> tuple[Mistake, ...]:
    """Find the mistakes in a measurement of a joint, in the order in which `mended` corrects them.

    Causes of ordinary size, tolerances and imperfections of real joints are not mistakes.

    Args:
      measurement: recordings with the output bolted to the bench are skipped.
      joint: the description, which may be wrong by a few times.

    Returns:
      All mistakes found, severe or not, sure or not.
    """
    moving = tuple(r for r in measurement.recordings if not r.link.locked)
    found = _of_samples(moving, joint)
    try:
        recordings = _apply(moving, joint, found)
        # Skip recordings with few valid samples, if there are others.
        rest = [r for r, a in zip(recordings, moving, strict=True) if len(r.time) > SETTINGS.valid * len(a.time)]
        recordings = tuple(rest) or recordings
    except InputError:  # every channel is stuck
        recordings = ()
    further = _of_columns(recordings, joint) if recordings else []
    named = (*_by_name(found, moving, measurement.recordings), *_by_name(further, recordings, measurement.recordings))
    return tuple(replace(m, severe=m.severe and m.column not in _OPTIONAL) for m in named)


def _of_samples(recordings: Sequence[Recording], joint: Joint) -> list[Mistake]:
    """Find wrong units of time and temperature, and wrong samples."""
    found = _time_unit(recordings)
    recordings = _apply(recordings, joint, found)
    for recording, still in zip(recordings, still_commands(recordings, joint), strict=True):
        found += [*_temperature(recording), *wrong_samples(recording, joint), *still]
    return found if len(recordings) > 1 else [replace(m, recording="") for m in found]


def _of_columns(recordings: Sequence[Recording], joint: Joint) -> list[Mistake]:
    """Find mistakes of whole columns; the samples are correct."""
    # A time offset shows in any unit, with any sign and zero.
    late = [one for m, having in late_columns(recordings, joint) for one in _where(m, having, recordings)]
    search = _Search(_apply(recordings, joint, late), joint)
    start, end = search.start, search.best()
    fits = end.mends(start) and end.worst >= SETTINGS.wrong
    if not fits and start.worst > SETTINGS.wrong:
        end, fits = start, True
    found = [one for m, having in end.found for one in _where(m, having, recordings)]
    if end.found and start.disagrees and search.fits_a_lighter_drive():
        # Rules for a larger gear may have filled rotor and friction: a doubt, no reason to refuse the data.
        found = [m if m.column in end.lost else replace(_unsure(m), severe=False) for m in found]
    if all("encoders" not in one for one in start.fits):  # only torques show a time offset
        if late and end.found and not late_columns(_apply(recordings, joint, found), joint):
            late = []  # their unit, or a lost sign, looked like one
        found, late = [*late, *found], []
    if end.lost and end.lost >= {name for r in recordings for name in DRIVING if name in r}:
        found = [m if m.column in end.lost else _unsure(m) for m in found]  # a magnitude alone judges no other column
    units = [m for m in found if m.name == "unit" and m.column in (*DRIVING, "time")]
    if units and search.has_another_scale(end):  # per cent of a rated current, counts of a converter, …
        found = [_unsure(m) if m in units else m for m in found]
    load = search.with_another_load() if end.found or start.disagrees else None
    if load is not None and load.score > end.score - SETTINGS.beyond:
        found = [m if m.name in _OF_LOAD or m.column == GRAVITY else _unsure(m) for m in found]
        if load.found and load.score > end.score + SETTINGS.beyond:
            wrong = [replace(m, confidence=probability(load.score - end.score)) for m, _ in load.found]
            found, end, fits = [*(m for m in found if m.name == "late"), *wrong], load, True
    return [*late, *(found if fits and not start.leaves_a_load(end) else map(_unsure, found))]


def _unsure(m: Mistake) -> Mistake:
    return replace(m, confidence=min(m.confidence, UNSURE))


_Fits = dict[str, RelationFit]
"""Relations of a recording."""


@dataclass(frozen=True)
class _State:
    """Channels with some changes, or under another description of the joint."""

    motions: tuple[SmoothedChannels | None, ...]  # channels of every recording
    fits: tuple[_Fits, ...]  # their relations
    found: tuple[tuple[Mistake, tuple[int, ...]], ...] = ()  # changes, each with its recordings by index
    price: float = 0.0  # of changes and description, in log likelihood
    refund: float = 0.0  # part of the price that changes give back

    @property
    def score(self) -> float:
        return sum(map(_total, self.fits)) - self.price

    @property
    def disagrees(self) -> bool:
        return any(map(_suspicious, self.fits))

    @property
    def lost(self) -> set[str]:
        """Columns without their sign."""
        return {m.column for m, _ in self.found if m.name == "sign" and m.lost}

    @property
    def worst(self) -> float:
        """Misfit of the worst relation, except those that say little of the changes."""
        # A lost sign is only approximate, the integral of a velocity drifts, and a stop may keep a link from its command.
        ignored = self.lost | {"encoders" for m, _ in self.found if m.name == "velocity"}
        if all("position_command" not in (m.column, *m.also) for m, _ in self.found):
            ignored.add("command")
        return min((fit.misfit for fits in self.fits for name, fit in fits.items() if name not in ignored), default=0.0)

    @property
    def rest(self) -> float:
        """Residual of torques over their spread, of a recording in the middle; 0 without torques."""
        torques = [[one[name].rest for name in DRIVING if name in one] for one in self.fits]
        return float(np.median([max(rests) for rests in torques if rests] or [0.0]))

    def leaves_a_load(self, other: _State) -> bool:
        """Return whether another state may only fit an unmeasured load: torques alone disagree here, and much of them is left."""
        angles = [fits[name] for fits in self.fits for name in ("encoders", "command") if name in fits]
        return not other.lost and other.rest > SETTINGS.rest and not any(fit.suspicious for fit in angles)

    def mends(self, start: _State) -> bool:
        """Return whether readings fit better than without changes, and no relation disagrees more."""
        commands = [fits["command"] for fits in self.fits if "command" in fits]
        stopped = any(fit.misfit < AGREEMENT.suspicious for fit in commands)
        gain, beyond = self.refund, 0
        for old, new in zip(start.fits, self.fits, strict=True):
            for name in new.keys() & old.keys():
                if new[name].misfit < min(AGREEMENT.suspicious, old[name].misfit - SETTINGS.at_odds):
                    return False
            gain += _readings(new, stopped) - _readings(old, stopped)
            beyond += _beyond(new) and not _beyond(old)
        return not self.found or (gain > SETTINGS.sure and beyond <= 0.5 * len(self.fits))


def _readings(fits: _Fits, stopped: bool) -> float:
    """Return the part of `_total` of readings; `stopped`: without the command, which a stop keeps the link from."""
    found = sum(fit.readings for name, fit in fits.items() if name != "command" or not stopped)
    return found - SETTINGS.beyond * _beyond(fits)


def _total(fits: _Fits) -> float:
    """Return the score of a recording's relations; a description that is wrong by more than a few times has a price."""
    return sum(fit.agreement for fit in fits.values()) - SETTINGS.beyond * _beyond(fits)


def _beyond(fits: _Fits) -> bool:
    """Return whether a recording needs a description that is wrong by more than a few times."""
    return any(fit.at_bound for fit in fits.values())


def _suspicious(fits: _Fits) -> bool:
    """Return whether a recording's channels disagree."""
    return any(fit.suspicious for fit in fits.values())


@dataclass(frozen=True)
class _Tried:
    """A change in one recording."""

    motion: SmoothedChannels | None  # channels with it
    before: _Fits  # relations without it
    after: _Fits  # with it
    cost: float = 0.0

    @property
    def more(self) -> float:
        return _total(self.after) - _total(self.before)


def _off_alike(ratios: Sequence[float], times: float) -> bool:
    """Return whether all ratios are above a factor, or all below its inverse."""
    return max(ratios) < 1 / times or min(ratios) > times


class _Search:
    """Beam search for the changes that make the channels fit; `start`: the state without changes."""

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
        self.start = _State(motions, self._agreement(motions, self._plausible))

    @staticmethod
    def _agreement(motions: Sequence[SmoothedChannels | None], plausible: Sequence[Plausibility]) -> tuple[_Fits, ...]:
        return tuple({} if m is None else p.agreement(m) for p, m in zip(plausible, motions, strict=True))

    def with_another_load(self) -> _State:
        """Return the channels without changes, each recording with the load that fits its torque best; `found` has the described
        loads that are then wrong, none if the channels still disagree."""
        found, plausible = list[tuple[Mistake, tuple[int, ...]]](), list[Plausibility]()
        parts = zip(self._recordings, self._plausible, self.start.motions, self.start.fits, strict=True)
        for i, (r, p, motion, fits) in enumerate(parts):
            torques = [name for name in reversed(DRIVING) if name in fits]
            if motion is None or not torques:
                plausible.append(p)
                continue
            link = p.best_load(motion, torques[0])
            plausible.append(Plausibility(self._joint, replace(r, link=link)))
            # A sensor in another unit contradicts the load alone; a single one makes both its numbers larger, or smaller.
            pairs = ((link.inertia, r.link.inertia), (link.gravity_moment, r.link.gravity_moment))
            ratios = [fitted / max(described, 1e-12) for fitted, described in pairs]
            unit = len(torques) == 1 and _off_alike(ratios, SETTINGS.few)
            contradicted = r.load is None and not unit and all(fits[name].suspicious for name in torques)
            if contradicted and (text := p.unlike(link)):
                found.append((Mistake("load", "link", r.name, text, 0.0, lost=True), (i,)))
        agreement = self._agreement(self.start.motions, plausible)
        state = _State(self.start.motions, agreement, tuple(found), SETTINGS.beyond * len(agreement))
        return state if state.worst > SETTINGS.wrong else replace(state, found=())

    def has_another_scale(self, state: _State) -> bool:
        """Return whether the only torque channel needs both numbers of each described load larger, or both smaller. With another
        clock any inertia fits."""
        found, clock = [], any(m.column == "time" for m, _ in state.found)
        for p, motion, fits in zip(self._plausible, state.motions, state.fits, strict=True):
            torques = [name for name in DRIVING if name in fits]
            if motion is not None and len(torques) == 1 and p.mounting.gravity_moment > 0.0:
                inertia, along, across = p.torque(motion, torques[0], free=True).coefficients[:3]
                ratios = (float(inertia), math.hypot(along, across) / p.mounting.gravity_moment)
                found.append(_off_alike(ratios[int(clock) :], AGREEMENT.scale))
        return bool(found) and all(found)

    def fits_a_lighter_drive(self) -> bool:
        """Return whether all channels agree without changes if rotor and friction are much smaller than described."""
        lighter = [Plausibility(self._joint, r, lighter=True) for r in self._recordings]
        return not any(map(_suspicious, self._agreement(self.start.motions, lighter)))

    def best(self) -> _State:
        """Return the state that no further change improves enough."""
        states, best = [self.start], self.start
        vague = any(fit.vague for fits in self.start.fits for fit in fits.values())
        for depth in range(SETTINGS.most):
            looked = [s for s in states if s.disagrees or (depth == 0 and vague)]
            further = [s for state in looked for s in self._steps(state)]
            states = sorted(further, key=lambda s: -s.score)[: SETTINGS.kept]
            if not states or states[0].score <= best.score + SETTINGS.sure:
                break
            best = states[0]
        return best

    def _without(self, m: Mistake, i: int, state: _State) -> SmoothedChannels | None:
        """Return a recording's channels without one more mistake; unchanged if it lacks the columns."""
        motion = state.motions[i]
        touched = m.name == "swapped" or m.column in ("time", GRAVITY)
        if motion is None or not (touched or any(c in motion for c in (m.column, *m.also))):
            return motion
        r, mine = self._recordings[i], [one for one, having in state.found if i in having]
        if m.name == "sign" and m.lost:  # from the description
            sign = expected_sign(motion.channels, self._N, self._p[i])
            x = r[m.column] * np.sign(np.interp(r.time - r.time[0], motion.time, sign))
            return motion_of(_mend(replace(r, columns={**r.columns, m.column: x}), self._joint, mine))
        if self._carried[i] and {m.column or "link_position", *m.also} & set(POSITIONS):
            # The arm's load depends on the link's angle.
            try:
                return motion_of(_mend(r, self._joint, [*mine, m]))
            except InputError:
                return motion
        time, channels = undone(m, motion.time, motion.channels, self._N, self._p[i])
        return replace(motion, time=time, channels=channels)

    def _tried(self, m: Mistake, i: int, state: _State) -> _Tried:
        """Apply one more change to a recording."""
        motion, before = self._without(m, i, state), state.fits[i]
        if motion is state.motions[i] or motion is None:
            return _Tried(motion, before, before)
        after = self._plausible[i].agreement(motion, state.motions[i], before)
        return _Tried(motion, before, after, shrinkage(m, after, before, AGREEMENT.effective))

    def _steps(self, state: _State) -> list[_State]:
        """Return all states with one more change whose gain exceeds its price."""
        steps, done = list[_State](), {(m.name, m.column) for m, _ in state.found}
        for m in self._table.entries(state.motions):
            if (m.name, m.column) in done:
                continue
            tried = [self._tried(m, i, state) for i in range(len(state.fits))]
            gains, least = [one.more - one.cost for one in tried], m.price + SETTINGS.sure
            chosen = [i for i, gain in enumerate(gains) if min(gains) > SETTINGS.worse or gain > least]
            if chosen:  # a change also holds where channels fit only with it, even if torques shrink
                only = [_suspicious(one.before) and not _suspicious(one.after) and one.more > least for one in tried]
                chosen = [i for i in range(len(tried)) if i in chosen or only[i]]
            if not chosen or not self._leaves_motion(m, [tried[i] for i in chosen]):
                continue  # a link at rest fits any torque
            everywhere = all(i in chosen or one.after is one.before for i, one in enumerate(tried))
            price = m.price if everywhere else (m.price + SETTINGS.one_of_several) * len(chosen)
            gain = sum(gains[i] for i in chosen) - price
            if gain > 0:
                step = _State(
                    tuple(one.motion if i in chosen else state.motions[i] for i, one in enumerate(tried)),
                    tuple(one.after if i in chosen else one.before for i, one in enumerate(tried)),
                    (*state.found, (replace(m, confidence=probability(gain)), tuple(chosen))),
                    state.price + price + sum(tried[i].cost for i in chosen),
                    state.refund + sum(max(-tried[i].cost, 0.0) for i in chosen if not m.becomes),
                )
                steps.append(step)
        for column in POSITIONS:
            steps = self._best_unit(steps, column)
        return steps

    def _leaves_motion(self, m: Mistake, tried: Sequence[_Tried]) -> bool:
        """Return whether corrected angles still move; always true if the other encoder agrees with them."""
        if m.name != "unit" or m.factor is None or abs(m.factor) >= 1.0:
            return True
        for motion, relations in ((one.motion, one.after) for one in tried):
            there = {name for name in POSITIONS if motion is not None and name in motion}
            mine = there & {m.column, *m.also}
            if motion is None or not mine or (len(there) == 2 and not relations["encoders"].suspicious):
                return True
            if max(np.ptp(motion.channels[n][:, 0]) / side(n, "", self._N) for n in mine) > SETTINGS.least_motion:
                return True
        return False

    def _best_unit(self, steps: Sequence[_State], column: str) -> list[_State]:
        """Reduce the steps that change the unit of one column to the best one, and limit its confidence by the others. Units that
        differ by a factor of two fit about as well; the described encoder's counts are preferred among them."""
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
            alone = min(alone, UNSURE)
        last = replace(last, confidence=min(last.confidence, alone))
        return [*(s for s in steps if not of_them(s.found[-1][0])), replace(best, found=(*before, (last, having)))]


def _folded(x: np.ndarray) -> bool:
    """Return whether a torque is never negative, but touches zero often, and not in a single stretch."""
    usual = float(np.quantile(np.abs(x), 0.9))
    near, away = np.abs(x) < _NEAR_ZERO * usual, np.abs(x) > _AWAY * usual
    returns = np.count_nonzero(np.diff(near[near | away].astype(np.int8)) > 0)
    return bool(x.min() >= 0.0 and returns and np.count_nonzero(near) > max(2e-3 * len(x), 4))


def _said(fit: RelationFit) -> float:
    """Return the log likelihood of a relation's readings, limited if another column is wrong, too."""
    return fit.readings * SETTINGS.hopeless / min(fit.misfit, SETTINGS.hopeless)


def _time_unit(recordings: Sequence[Recording]) -> list[Mistake]:
    """Find a time that is not in seconds: gaps between all samples, but smooth motion."""
    interval = min((r.interval for r in recordings), default=0.0)
    if interval <= GAP or not all(any(_smooth(r[n]) for n in POSITIONS if n in r) for r in recordings):
        return []
    units = {"milliseconds": 1e-3, "microseconds": 1e-6, "nanoseconds": 1e-9}
    fitting = [(said, unit) for said, unit in units.items() if interval * unit < GAP]
    return [Mistake("unit", "time", "", f"{said}, logged as seconds", 0.99, factor=unit) for said, unit in fitting[:1]]


def _smooth(x: np.ndarray) -> bool:
    """Return whether an angle is sampled much faster than it moves."""
    if len(x) <= 4 * _APART:
        return False
    first = x[_APART:] - x[:-_APART]
    second = first[_APART:] - first[:-_APART]
    usual = [float(np.quantile(np.abs(d), 0.95)) for d in (first, second)]  # ignores jumps at gaps
    return usual[1] < _SMOOTH * usual[0]


def _temperature(recording: Recording) -> list[Mistake]:
    """Find a temperature in kelvin or degrees Fahrenheit."""
    usual = float(np.median(recording["temperature"])) if "temperature" in recording else math.nan
    return [
        Mistake("unit", "temperature", recording.name, f"{said}, logged as °C", 0.99, factor=factor, offset=offset)
        for said, (low, high), factor, offset in _SCALES
        if low < usual < high
    ]


def unclipped(measurement: Measurement, joint: Joint, mistakes: Sequence[Mistake]) -> Measurement:
    """Return the measurement without the few samples at a sensor's or drive's limit."""
    clipped = [m for m in mistakes if m.name == "clipped" and not m.severe]
    return mended(measurement, joint, clipped) if clipped else measurement


def require_sound(measurement: Measurement, joint: Joint) -> tuple[Measurement, tuple[Mistake, ...]]:
    """Refuse a measurement with invalid motion or current.

    Returns:
      The measurement `unclipped`, and severe mistakes in columns that estimators do not read.

    Warns:
      InputWarning: samples that are left out.

    Raises:
      InputError: the first severe mistake in a column that estimators read, with its correction.
    """
    found = find_mistakes(measurement, joint)
    severe = [m for m in found if m.severe]
    for m in severe:
        if m.column not in _UNREAD:
            where = ": ".join(name for name in (m.recording or measurement.name, m.columns) if name)
            if not m.sure:
                raise InputError(f"{where}: {m.unmended}")
            if mended_if_possible(measurement, joint, found) is None:
                raise InputError(f"{where}: {m.description}; without this column nothing can be estimated")
            raise InputError(
                f"{where}: {m.description}, corrected by: {m.change}; `{mending(measurement, joint, 'DIR')}` corrects it"
            )
    sound = unclipped(measurement, joint, found)
    if sound is not measurement:
        for m in (m for m in found if m.name == "clipped"):
            warnings.warn(f"{m.where}: {m.description}: {m.change}", InputWarning, stacklevel=2)
    return sound, tuple(m for m in severe if m.column in _UNREAD)


def mended_if_possible(measurement: Measurement, joint: Joint, mistakes: Sequence[Mistake]) -> Measurement | None:
    """Return `mended`, or None if too few samples are valid."""
    try:
        return mended(measurement, joint, mistakes)
    except InputError:
        return None


def mended(measurement: Measurement, joint: Joint, mistakes: Sequence[Mistake]) -> Measurement:
    """Return the measurement without the mistakes that are sure; invalid samples are left out."""
    return replace(measurement, recordings=_apply(measurement.recordings, joint, [m for m in mistakes if m.sure]))


def fixed(measurement: Measurement, joint: Joint, mistakes: Sequence[Mistake]) -> Measurement:
    """Return `mended`, with the changes noted in every recording."""
    found = mended(measurement, joint, mistakes)

    def noted(r: Recording) -> Recording:
        mine = [m for m in mistakes if m.sure and m.recording in ("", r.name)]
        said = tuple(f"{m.name}: {m.columns + ': ' if m.columns else ''}{m.description}: {m.change}" for m in mine)
        return replace(r, fixed=(*r.fixed, *said))

    return replace(found, recordings=tuple(map(noted, found.recordings)))


@np.errstate(all="ignore")
def fits_no_better(before: Measurement, after: Measurement, joint: Joint) -> bool:
    """Return whether a change leaves channels that do not fit the joint, and fit no better than before."""
    misfits = []
    for one in (before, after):
        moving = tuple(r for r in one.recordings if not r.link.locked)
        misfits.append(_Search(moving, joint).start.worst if moving else 0.0)
    return misfits[1] < AGREEMENT.suspicious and misfits[1] <= misfits[0]


def _by_name(found: Sequence[Mistake], seen: Sequence[Recording], every: Sequence[Recording]) -> tuple[Mistake, ...]:
    """Name the recordings of mistakes that all recordings in `seen` have, if there are others."""
    if len(seen) == len(every):
        return tuple(found)
    names = [r.name for r in seen]
    return tuple(replace(m, recording=name) for m in found for name in ([m.recording] if m.recording else names))


def _where(mistake: Mistake, having: Sequence[int], recordings: Sequence[Recording]) -> list[Mistake]:
    """Return one mistake for each recording that has it, by index, or one for all."""
    names = [""] if len(having) == len(recordings) else [recordings[i].name for i in having]
    return [replace(mistake, recording=name) for name in names]


def _apply(recordings: Iterable[Recording], joint: Joint, mistakes: Sequence[Mistake]) -> tuple[Recording, ...]:
    return tuple(_mend(r, joint, [m for m in mistakes if m.recording in ("", r.name)]) for r in recordings)


def _mend(recording: Recording, joint: Joint, mistakes: Sequence[Mistake]) -> Recording:
    """Return a recording without mistakes."""
    if not mistakes:
        return recording
    N, p = joint.numbers["N"].value, joint.record(recording.link)[0]
    where = f"{recording.source or recording.name}: without"
    time, columns = recording.time, dict(recording.columns)
    lost = np.zeros(len(time), bool)
    for m in mistakes:
        rows = np.array(m.rows or (), int)
        signless = m.name == "sign" and m.lost
        if signless or (m.name in ("stuck", "clipped") and len(rows) == len(time)):
            columns.pop(m.column, None)
            check_channels(f"{where} {m.column}, {'whose sign is lost' if signless else 'which is stuck'}", columns)
        elif m.column == GRAVITY:
            turned = math.remainder(recording.link.gravity_angle + np.pi, _TURN)
            recording = replace(recording, link=recording.link.model_copy(update={"gravity_angle": turned}))
        elif m.name in ("stuck", "clipped"):
            lost[rows] |= m.column in columns
        elif m.name == "glitch" and m.column in columns:
            columns[m.column] = bridged(time, columns[m.column], rows)
        elif m.name == "wrapped" and m.offset is None and m.column in columns:
            columns[m.column] = _unwrapped(m, time, columns, rows, N)
        else:
            time, columns = undone(m, time, columns, N, p)
            if m.name == "late":  # no data beyond the ends and within gaps
                after = np.clip(np.searchsorted(time, time + m.seconds), 1, len(time) - 1)
                lost |= (time + m.seconds > time[-1]) | (time + m.seconds < time[0])
                lost |= time[after] - time[after - 1] > GAP
    found = replace(recording, time=time, columns=columns)
    found = found.at(~lost) if lost.any() else found
    moved = {c for m in mistakes for c in (m.column or "link_position", *m.also)} & {*POSITIONS, "time"}
    # The load of an arm or a payload depends on the link's motion.
    return with_load(found, N) if moved else found


def _unwrapped(m: Mistake, time: np.ndarray, columns: dict[str, np.ndarray], rows: np.ndarray, N: float) -> np.ndarray:
    """Return a column without jumps by whole turns or by a register's range, shape (n,)."""
    x, turn = columns[m.column], m.factor or _TURN
    if m.column in DRIVING:  # signed register
        return np.where(x > 0.5 * turn, x - turn, x)
    guide = next((n for n in (*POSITIONS, "position_command") if n in columns and n != m.column), None)
    if guide is None:
        return unwrapped(time, x, rows, turn)
    start = side(m.column, guide, N) * float(columns[guide][0]) if turn == _TURN else 0.0
    return unwrapped(time, x, rows, turn, columns[guide], start)
