"""Changes that would mend a measurement, and which of them the agreement of its channels asks for.

A change says what is wrong with a column of the file (a unit, a sign, …) and makes the channels as they would be without. Each
has a price in log likelihood: nobody makes a mistake without need. The search applies the change that gains most, and looks
again; the last few best are kept, as a first step may only look good.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import CubicHermiteSpline

from ...models.errors import InputError
from ...models.joint import EncoderSpec, Joint
from ...models.recording import GAP, Recording
from ...models.signals import DRIVING, POSITIONS
from .plausibility import SETTINGS as AGREEMENT
from .plausibility import Plausibility, RelationFit, SmoothedChannels, motion_of


@dataclass(frozen=True)
class ChangeSettings:
    """What a change costs, and when one is believed; in log likelihood where nothing else is said.

    Set on `benchmarks/mistakes.py`: mistakes hidden in sound measurements, and sound ones in which nothing may be found.

    Attributes:
      price: of a mistake.
      free: of a number that is free, more.
      one_of_several: of a mistake that not all recordings have, more.
      sure: gain beyond its price from which on a change is believed.
      suspicious: misfit below which a relation is looked into; at_odds: by how much changes may make one of these worse.
      lasting: of recordings whose misfit says that nothing fits [s].
      worse: loss in a recording from which on a change is not one of the whole measurement; much_worse: where the recording's
        channels go together with it, or better than before.
      kept: states that are kept beside each other.
      most: changes on top of each other.
      other_counts: of counts of another encoder than the described one's, or of one that is read four times as fine or coarse,
        more; not_counts: of another unit where every value is a whole number, and of counts where not every one is, more.
      slope: by how much the encoders' ratio may be off at the least to be another gear ratio, relative; ratio: how many times as
        large or small another gear ratio may be.
      whole: by how much a gear ratio may be off a whole number to be that, relative: torsion under gravity goes with the angle.
      least_motion: of the link [rad], which angles in another unit must still show.
      offsets: of the angle's zero, that are tried in a turn.
      smallest_offset: between the encoders [rad]; smallest_turn: of all angles together, by which way gravity pulls [rad]: less
        is what a joint's gravity direction, a payload or a stop may make of it, and no mistake.
      slow: between samples, from which on time may be in other units than seconds [s].
      smooth: of an angle's second differences to its first ones, over 20 samples: less is sampled much faster than it moves.
      latest: between which one encoder is late: less may be in sound data, more is nothing of the same motion [s].
    """

    price: float = 9.0
    free: float = 5.0
    one_of_several: float = 4.0
    sure: float = 7.0
    suspicious: float = -0.15
    at_odds: float = 0.1
    lasting: float = 4.0
    worse: float = -3.0
    much_worse: float = -9.0
    kept: int = 3
    most: int = 3
    other_counts: tuple[float, float] = (8.0, 4.0)
    not_counts: float = 6.0
    slope: float = 0.004
    ratio: float = 10.0
    whole: float = 1.5e-3
    least_motion: float = 0.1
    offsets: int = 24
    smallest_offset: float = 0.015
    smallest_turn: float = 0.3
    slow: float = 0.05
    smooth: float = 0.3
    latest: tuple[float, float] = (0.015, 0.3)


SETTINGS = ChangeSettings()
_APART = 20  # samples
_DEGREE, _RPM = math.pi / 180, 2 * math.pi / 60
_LAST_OF = {"encoders": "motor_position", "command": "position_command"}
"""Of each relation between angles the one that is in another unit only where the other is as well."""
GRAVITY = "gravity_angle"
"""What stands for a column where gravity's direction is turned round: the mounting's angle in the recording's YAML."""


@dataclass(frozen=True)
class ColumnChange:
    """A change of one column that would mend it.

    Attributes:
      name, column: of the mistake; description: of it, for people.
      factor, offset, seconds: as in `mistakes.Mistake`; price: in log likelihood.
      also: changes of other columns that are the same mistake.
      ratio: of the gear.
      counts: whether it takes an encoder's counts for an angle, and then whether these are the described encoder's.
    """

    name: str
    column: str
    description: str
    factor: float | None = None
    offset: float | None = None
    price: float = SETTINGS.price
    also: tuple[ColumnChange, ...] = ()
    ratio: float = 1.0
    seconds: float | None = None
    counts: bool = False
    described: bool = False

    def apply(self, motion: SmoothedChannels) -> SmoothedChannels:
        """The channels without the mistake; the same where the column is not there."""
        if self.column == GRAVITY:  # all angles less a half turn instead: nothing but gravity knows where they begin
            return replace(self, name="angle_zero", column="").apply(motion)
        if self.column in motion or self.name == "swapped":
            motion = self._own(motion)
        for one in self.also:
            motion = one.apply(motion)
        return motion

    def shrinkage(self, new: dict[str, RelationFit], old: dict[str, RelationFit]) -> float:
        """What it costs in a recording that smaller torques, or all angles smaller, look like nothing, whatever they are.

        Of angles no more than relations between them alone gain by it: where that is nothing, torques say which motion it was.
        """
        smaller = -math.log(abs(self.factor)) if self.name == "unit" and self.factor is not None else 0.0
        if smaller <= 0.0 or new is old:
            return 0.0
        cost = 0.5 * AGREEMENT.effective * smaller
        if self.column in (*DRIVING, "external_torque"):
            return cost
        columns = {one.column for one in self.also}
        alone = [name for name, last in _LAST_OF.items() if name in new and last in columns]
        return min(cost, sum(max(new[n].agreement - old[n].agreement, 0.0) for n in alone))

    def leaves_motion(self, mended: Sequence[SmoothedChannels | None], N: float) -> bool:
        """Whether channels without the mistake still show a motion, where the change makes all angles smaller."""
        if self.name != "unit" or self.factor is None or abs(self.factor) >= 1.0:
            return True
        columns = {self.column, *(one.column for one in self.also)}
        for motion in mended:
            there = [name for name in POSITIONS if motion is not None and name in motion]
            if not there or not columns.issuperset(there):
                return True
            assert motion is not None
            spans = [float(np.ptp(motion.channels[n][:, 0])) / (N if n == "motor_position" else 1.0) for n in there]
            if max(spans) > SETTINGS.least_motion:
                return True
        return False

    def _own(self, motion: SmoothedChannels) -> SmoothedChannels:
        if self.name == "swapped":
            return swapped(motion)
        x = motion.channels[self.column]
        factor = 1.0 if self.factor is None else self.factor
        if self.seconds is not None:
            return motion.with_channels(**{self.column: _earlier(motion.time, x, self.seconds)})
        if self.name == "velocity":
            return motion.with_channels(**{self.column: self._position(motion, factor * x)})
        if self.name == "gear_ratio" and self.column == "motor_position":
            factor = 1 / factor
        if self.name == "sign":
            factor = -1.0
        x = factor * x
        if self.offset is not None:
            x = x + np.array([self.offset, 0.0, 0.0])
        return motion.with_channels(**{self.column: x})

    def _position(self, motion: SmoothedChannels, velocity: np.ndarray) -> np.ndarray:
        """The position of a velocity; where another position or the command says it, from there."""
        x = integrated(motion.time, velocity)
        for name in (*POSITIONS, "position_command"):
            if name != self.column and name in motion:
                sides = [self.ratio if n == "motor_position" else 1.0 for n in (self.column, name)]
                x[:, 0] += np.median(sides[0] / sides[1] * motion.channels[name][:, 0] - x[:, 0])
                break
        return x


def _earlier(time: np.ndarray, motion: np.ndarray, seconds: float) -> np.ndarray:
    """What a position, shape (n, 3) with two derivatives, is some time later; at the end it stands still."""
    later = time + seconds
    value = CubicHermiteSpline(time, motion[:, 0], motion[:, 1])(np.minimum(later, time[-1]))
    return np.column_stack([value, *(np.interp(later, time, motion[:, k]) for k in (1, 2))])


def _lag(time: np.ndarray, a: np.ndarray, b: np.ndarray) -> float:
    """By how much position b lags behind a, both of shape (n, 3), at their best offset and slope [s]."""
    lag = 0.0
    for _ in range(4):  # what is linear in a small lag is not in a large one
        now = _earlier(time, b, lag) if lag > 0 else b
        other = _earlier(time, a, -lag) if lag < 0 else a
        A = np.column_stack([now[:, 1], np.ones(len(now)), now[:, 0]])
        lag += float(np.linalg.lstsq(A, other[:, 0] - now[:, 0], rcond=None)[0][0])
    return lag


def swapped(motion: SmoothedChannels) -> SmoothedChannels:
    """Both positions exchanged; the only one under the other's name."""
    names = [name for name in POSITIONS if name in motion]
    others = {name: POSITIONS[1 - POSITIONS.index(name)] for name in names}
    return motion.without(*names).with_channels(**{others[name]: motion.channels[name] for name in names})


def integrated(time: np.ndarray, velocity: np.ndarray) -> np.ndarray:
    """Position from zero and two derivatives, shape (n, 3), of a channel that holds a velocity; the mean bridges gaps."""
    steps = 0.5 * np.diff(time) * (velocity[1:, 0] + velocity[:-1, 0])
    position = np.concatenate([[0.0], np.cumsum(steps)])
    return np.column_stack([position, velocity[:, 0], velocity[:, 1]])


@dataclass(frozen=True)
class Found:
    """A change that a measurement asks for.

    Attributes:
      change: that mends; recordings: indices of those that have the mistake.
      confidence: of it.
    """

    change: ColumnChange
    recordings: tuple[int, ...]
    confidence: float


@dataclass(frozen=True)
class _Progress:
    """Changes made so far, one after the other, and what became of each recording's channels."""

    motions: tuple[SmoothedChannels | None, ...]
    fits: tuple[dict[str, RelationFit], ...]
    found: tuple[Found, ...] = ()
    price: float = 0.0

    @property
    def score(self) -> float:
        return sum(_total(fits) for fits in self.fits) - self.price


def _mends(new: dict[str, RelationFit], old: dict[str, RelationFit]) -> bool:
    """Whether channels that do not go together do."""
    return _suspicious(old) and not _suspicious(new)


def _suspicious(fits: dict[str, RelationFit]) -> bool:
    """Whether a recording's channels do not go together."""
    return any(fit.misfit < SETTINGS.suspicious for fit in fits.values())


def _worst(fits: Sequence[dict[str, RelationFit]]) -> float:
    """Misfit of the relation that fits worst; 0 where there is none."""
    return min((fit.misfit for relations in fits for fit in relations.values()), default=0.0)


_Fits = Sequence[dict[str, RelationFit]]
"""Relations of every recording; changes leave the same ones."""


def _gained(before: _Fits, after: _Fits, but: str = "") -> float:
    """By how much better the readings of all relations but one fit, in log likelihood."""
    return sum(
        fit.readings - old[name].readings
        for old, new in zip(before, after, strict=True)
        for name, fit in new.items()
        if name != but
    )


def _not_followed(before: _Fits, after: _Fits) -> bool:
    """Whether changes mend nothing but what the command says, and the link does not follow it all the same: a stop holds it, or
    the drive's limit does."""
    commands = [(old["command"], new["command"]) for old, new in zip(before, after, strict=True) if "command" in new]
    commanded = any(new.misfit < SETTINGS.suspicious and new != old for old, new in commands)
    return commanded and _gained(before, after, but="command") < SETTINGS.sure


def _better(before: _Fits, after: _Fits) -> bool:
    """Whether readings fit better than before, beside what is known of more of them, and no relation is at odds that was not.

    An angle in turns moves six times as fast: less of it is at rest, where friction may be anything, and of a second in which
    next to nothing moves that alone once spoke for turns.
    """
    at_odds = any(
        fit.misfit < min(SETTINGS.suspicious, old[name].misfit - SETTINGS.at_odds)
        for old, new in zip(before, after, strict=True)
        for name, fit in new.items()
    )
    return not at_odds and _gained(before, after) > SETTINGS.sure


def _units_told_apart(steps: Sequence[_Progress], column: str, whole: bool) -> list[_Progress]:
    """Steps of which those that take a column alone for counts, of `whole` numbers for an angle in any unit, are one, as sure as
    what else it may be lets it be.

    Counts of a coarser encoder are a larger motion, which rests less and of which more is known: that tells a motion from next to
    none, but not one from another half as large. Of those whose readings fit about as well the described encoder's it is; whole
    numbers in another unit than counts would be strange.
    """

    def of_them(change: ColumnChange) -> bool:
        return change.name == "unit" and change.column == column and not change.also and (change.counts or whole)

    some = [s for s in steps if of_them(s.found[-1].change)]
    if not some:
        return list(steps)
    scores = [sum(fit.readings for fits in s.fits for fit in fits.values()) - s.price for s in some]
    near = [(x, s) for x, s in zip(scores, some, strict=True) if x > max(scores) - SETTINGS.sure]
    described = [(x, s) for x, s in near if s.found[-1].change.described]
    score, best = described[0] if described else max(near, key=lambda found: found[1].score)
    *before, last = best.found
    alone = 1.0 / sum(math.exp(min(x - score, 50.0) / 3) for x in scores)
    if (not described and len(near) > 1) or (whole and not last.change.counts):
        alone = min(alone, 0.5)
    last = replace(last, confidence=min(last.confidence, alone))
    return [*(s for s in steps if not of_them(s.found[-1].change)), replace(best, found=(*before, last))]


def _total(fits: dict[str, RelationFit]) -> float:
    return sum(fit.agreement for fit in fits.values())


def time_unit(recordings: Sequence[Recording], joint: Joint) -> float:
    """What one unit of time is [s]: where samples are too far apart for seconds, the unit that suits the channels."""
    interval = min(r.interval for r in recordings)
    if interval < SETTINGS.slow:
        return 1.0
    plausible = [Plausibility(joint, r) for r in recordings]

    def score(second: float) -> float:
        motions = [motion_of(r, second) for r in recordings]
        fits = [p.agreement(m) for p, m in zip(plausible, motions, strict=True) if m is not None]
        return sum(map(_total, fits)) if fits else -math.inf

    # Samples with gaps between them all, of a motion that hardly changes from one to the next, are no log in seconds, whatever
    # else is wrong with it.
    nothing = interval > GAP and all(_sampled_fast(r) for r in recordings)
    best, found = -1e9 if nothing else max(score(1.0), -1e9) + SETTINGS.price + SETTINGS.sure, 1.0
    for unit in (1e-3, 1e-6, 1e-9):
        if 5e-5 < interval * unit < SETTINGS.slow and (now := score(unit)) > best:
            best, found = now, unit
    return found


def _sampled_fast(recording: Recording) -> bool:
    """Whether a recording's angles are sampled much faster than they move."""
    for name in POSITIONS:
        x = recording.columns.get(name)
        if x is not None and len(x) > 4 * _APART:
            first = x[_APART:] - x[:-_APART]
            second = first[_APART:] - first[:-_APART]
            if float(np.std(second)) < SETTINGS.smooth * float(np.std(first)):
                return True
    return False


def change_in_an_arm(
    recordings: Sequence[Recording], joint: Joint, mended: Callable[[Found], Sequence[Recording]]
) -> Found | None:
    """The unit or sign of a joint's own angle where an arm that moves carries its link: what that puts on the link was taken from
    the angle as it stands, so that nothing goes together until it is taken from the right one. None where none is asked for.

    Args:
      mended: the recordings without a change, what the arm puts on the link taken anew.
    """
    as_it_is = Suspicions(recordings, joint, depth=0)
    if not any(map(_suspicious, as_it_is.fits)):
        return None
    best: tuple[float, Found] | None = None
    for change in as_it_is.changes_of_angles():
        found = Found(change, tuple(range(len(recordings))), 0.99)
        try:
            fits = Suspicions(mended(found), joint, depth=0).fits
        except InputError:
            continue
        score = sum(map(_total, fits)) - change.price
        mends = not any(map(_suspicious, fits)) and _gained(as_it_is.fits, fits) > change.price + SETTINGS.sure
        if mends and (best is None or score > best[0]):
            best = score, found
    return None if best is None else best[1]


class Suspicions:
    """What is wrong with the channels of a measurement as a whole.

    Attributes:
      found: changes, in the order in which they mend.
      mends: whether channels fit better when they are made.
      before: misfit of the relation that fits worst in recordings that last, as in `RelationFit`; misfit: of all when they are
        made; 0 where there is none.
      fits: relations of every recording as it is.

    Args:
      depth: changes on top of each other that are tried.
    """

    def __init__(self, recordings: Sequence[Recording], joint: Joint, depth: int = SETTINGS.most):
        self.joint = joint
        self.recordings = tuple(recordings)
        self._plausible = [Plausibility(joint, r) for r in recordings]
        self._whole = {
            name
            for name in POSITIONS
            if all(np.array_equal(r[name], np.round(r[name])) for r in recordings if name in r)
        }
        start = self._state()
        self.fits = start.fits
        end = self._search(start, depth)
        if _not_followed(start.fits, end.fits):
            end = start
        self.mends = _better(start.fits, end.fits)
        self.found = end.found
        lasting = [r.time[-1] - r.time[0] > SETTINGS.lasting for r in recordings]
        self.before = _worst([fits for fits, there in zip(start.fits, lasting, strict=True) if there])
        about = {one.column for f in end.found for one in (f.change, *f.change.also)}
        # A command that a stop or a push keeps the joint from following says nothing of the other columns.
        ignored = () if "position_command" in about or not self.mends else ("command",)
        self.misfit = _worst([{n: fit for n, fit in fits.items() if n not in ignored} for fits in end.fits])

    def _state(self) -> _Progress:
        motions = tuple(motion_of(r) for r in self.recordings)
        return _Progress(motions, tuple(self._fits(i, m) for i, m in enumerate(motions)))

    def _fits(self, index: int, motion: SmoothedChannels | None) -> dict[str, RelationFit]:
        return {} if motion is None else self._plausible[index].agreement(motion)

    def changes_of_angles(self) -> Iterator[ColumnChange]:
        """Units and signs of the joint's own angles, of one alone or of both."""
        there = {name for r in self.recordings for name in r.columns if name in POSITIONS}
        yield from self._scales(there)
        if len(there) > 1:
            yield replace(_sign("link_position"), also=(_sign("motor_position"),))

    def _search(self, start: _Progress, depth: int) -> _Progress:
        beam, best = [start], start
        for _ in range(depth):
            further: list[_Progress] = []
            for state in beam:
                if any(map(_suspicious, state.fits)):
                    further += self._steps(state)
            if not further:
                break
            beam = sorted(further, key=lambda s: -s.score)[: SETTINGS.kept]
            if beam[0].score <= best.score + SETTINGS.sure:
                break
            best = beam[0]
        return best

    def _steps(self, state: _Progress) -> list[_Progress]:
        """All states one change further that are better than this one by more than that change's price."""
        steps = []
        for change in self._changes(state):
            motions = [m if m is None else change.apply(m) for m in state.motions]
            fits = [
                f if m is None or m is old else self._plausible[i].agreement(m, old, f)
                for i, (m, old, f) in enumerate(zip(motions, state.motions, state.fits, strict=True))
            ]
            more = [_total(new) - _total(old) for new, old in zip(fits, state.fits, strict=True)]
            same = [new is old for new, old in zip(fits, state.fits, strict=True)]
            costs = [change.shrinkage(new, old) for new, old in zip(fits, state.fits, strict=True)]
            gains = [x - cost for x, cost in zip(more, costs, strict=True)]
            bears = [
                SETTINGS.much_worse if not _suspicious(new) or _worst([new]) > _worst([old]) else SETTINGS.worse
                for new, old in zip(fits, state.fits, strict=True)
            ]
            everywhere = all(gain > least for gain, least in zip(gains, bears, strict=True))
            least = change.price + SETTINGS.sure
            chosen = [i for i, g in enumerate(gains) if everywhere or g > least]
            # Where it is so in one recording, that a torque looks like nothing is no reason against it in another whose channels
            # do not go together as they are.
            also = [
                i for i, (new, old) in enumerate(zip(fits, state.fits, strict=True))
                if chosen and i not in chosen and more[i] > least and _mends(new, old)
            ]  # fmt: skip
            chosen = sorted([*chosen, *also])
            if not change.leaves_motion([motions[i] for i in chosen], self.joint.numbers["N"].value):
                continue  # a link that hardly moves asks for no torque: that suits any log
            everywhere = all(i in chosen or unchanged for i, unchanged in enumerate(same))
            price = change.price if everywhere else (change.price + SETTINGS.one_of_several) * max(len(chosen), 1)
            gain = sum(gains[i] for i in chosen) - price
            if not chosen or gain <= 0:
                continue
            found = Found(change, tuple(chosen), 1 / (1 + math.exp(-min(gain, 50.0) / 3)))
            steps.append(
                _Progress(
                    tuple(
                        m if i in chosen else old for i, (m, old) in enumerate(zip(motions, state.motions, strict=True))
                    ),
                    tuple(f if i in chosen else old for i, (f, old) in enumerate(zip(fits, state.fits, strict=True))),
                    (*state.found, found),
                    state.price + price + sum(costs[i] for i in chosen),
                )
            )
        for column in POSITIONS:
            steps = _units_told_apart(steps, column, column in self._whole)
        return steps

    def _changes(self, state: _Progress) -> Iterator[ColumnChange]:
        """Changes that may mend what is left in a state, each column's once."""
        there = {name for m in state.motions if m is not None for name in m.channels}
        done = {(f.change.name, f.change.column) for f in state.found}
        for change in (*self._scales(there), *self._exchanges(there), *self._fitted(there, state)):
            if (change.name, change.column) not in done:
                yield change

    def _scales(self, there: set[str]) -> Iterator[ColumnChange]:
        """Units and signs."""
        N, Kt = self.joint.numbers["N"].value, self.joint.numbers["Kt"].value
        sensors = self.joint.sensors
        encoders = {"motor_position": sensors.motor_encoder, "link_position": sensors.link_encoder}
        for column, encoder in encoders.items():
            if column in there:
                yield _sign(column)
                for unit in _angles(column):
                    unit = replace(unit, price=unit.price + (SETTINGS.not_counts if column in self._whole else 0.0))
                    yield unit
                    yield _turned(unit)
                yield from self._counts(column, encoder)
        angles = [name for name in ("link_position", "motor_position", "position_command") if name in there]
        for count in range(2, len(angles) + 1):  # the encoders, or all: nothing between them shows it
            for first, *others in zip(*map(_angles, angles[:count]), strict=True):
                yield replace(first, also=tuple(others))
        if self._whole.issuperset(POSITIONS) and there.issuperset(
            POSITIONS
        ):  # in either's alone they make no motion of a joint
            link, motor = (next(self._counts(name, encoders[name])) for name in ("link_position", "motor_position"))
            yield replace(link, also=(motor,), price=link.price + SETTINGS.free)
        if "position_command" in there:
            yield _sign("position_command")
            yield from _angles("position_command")
            yield _unit("position_command", "rad on the motor side", 1 / N)
        for column in (*DRIVING, "external_torque"):
            if column in there:
                yield _sign(column)
        if "motor_current" in there:
            yield _unit("motor_current", "mA", 1e-3)
            if abs(math.log(Kt)) > 0.7:
                yield _unit("motor_current", "N·m of the motor", 1 / Kt)
            if abs(math.log(N * Kt)) > 0.7:
                yield _unit("motor_current", "N·m at the output", 1 / (N * Kt))
        if "motor_torque" in there:
            yield _unit("motor_torque", "mN·m", 1e-3)
            yield _unit("motor_torque", "N·m at the output", 1 / N)
            if abs(math.log(Kt)) > 0.7:
                yield _unit("motor_torque", "A", Kt)
        for column in ("joint_torque", "external_torque"):
            if column in there:
                yield _unit(column, "mN·m", 1e-3)

    def _counts(self, column: str, encoder: EncoderSpec) -> Iterator[ColumnChange]:
        """Counts of the encoder as it is described, or, where every value is a whole number, of any other."""
        lines = 2 * math.pi / encoder.resolution
        another, read_otherwise = SETTINGS.other_counts

        def counts(turn: float, more: float, described: bool = False) -> ColumnChange:
            more += 0.0 if column in self._whole else SETTINGS.not_counts
            unit = _unit(column, f"counts ({turn:.10g} a turn)", 2 * math.pi / turn, SETTINGS.price + more)
            return replace(unit, counts=True, described=described)

        yield counts(lines, 0.0, described=True)
        for times in (4.0, 0.25):
            yield counts(times * lines, read_otherwise)
        if column in self._whole:
            for bits in range(8, 33):
                if min(abs(bits - math.log2(times * lines)) for times in (0.25, 1.0, 4.0)) > 0.1:
                    yield counts(float(2**bits), another)

    def _exchanges(self, there: set[str]) -> Iterator[ColumnChange]:
        """Positions that are something else: the other side's, a velocity."""
        N = self.joint.numbers["N"].value
        positions = [name for name in POSITIONS if name in there]
        if len(positions) == 2:
            yield ColumnChange("swapped", "", "motor and link position stand under each other's name")
        else:
            other = POSITIONS[1 - POSITIONS.index(positions[0])].replace("_", " ")
            yield ColumnChange("swapped", positions[0], f"what stands here is the {other}")
        for column in positions:
            side = 1 / N if column == "link_position" else N
            for said, factor in (("rad/s", 1.0), ("deg/s", _DEGREE), ("rpm", _RPM), ("rad/s of the other side", side)):
                yield ColumnChange(
                    "velocity", column, f"a velocity ({said}) where the position belongs", None if factor == 1.0 else factor,
                    price=SETTINGS.price + (0.0 if factor == 1.0 else 3.0), ratio=N,
                )  # fmt: skip

    def _fitted(self, there: set[str], state: _Progress) -> Iterator[ColumnChange]:
        """Changes with a number that the channels themselves give: gear ratio, zero of the angle."""
        if all(name in there for name in POSITIONS):
            slope = self._slope(state)
            if slope is not None and abs(slope - 1) > SETTINGS.slope and 1 / SETTINGS.ratio < slope < SETTINGS.ratio:
                yield self._gear_ratio("motor_position", slope)
                yield self._gear_ratio("link_position", slope)
            yield from self._late(state)
        yield from self._zeros(there, state)

    def _late(self, state: _Progress) -> Iterator[ColumnChange]:
        """The encoder that lags behind the other, by what suits all recordings, and by what suits each."""
        N = self.joint.numbers["N"].value
        found = []
        for motion in state.motions:
            if motion is not None and all(name in motion for name in POSITIONS):
                motor, link = motion.channels["motor_position"] / N, motion.channels["link_position"]
                found.append(_lag(motion.time, motor, link))
        tried = [float(np.median(found)), *found] if found else []
        for lag in {round(x, 2): x for x in tried}.values():
            if SETTINGS.latest[0] < abs(lag) < SETTINGS.latest[1]:
                column = POSITIONS[1] if lag > 0 else POSITIONS[0]
                yield ColumnChange(
                    "late", column, f"{1e3 * abs(lag):.3g} ms late against the other encoder",
                    price=SETTINGS.price + SETTINGS.free, seconds=abs(lag),
                )  # fmt: skip

    def _gear_ratio(self, column: str, slope: float) -> ColumnChange:
        """Another ratio between the encoders; near N ± 1 the one of the other kind of strain wave gear."""
        N = round(self.joint.numbers["N"].value)
        if column == "motor_position":
            whole, free = round(slope * N), SETTINGS.free
            if whole and abs(slope * N / whole - 1) < SETTINGS.whole:
                slope, free = whole / N, 0.0 if whole in (N - 1, N + 1) else free
            text = f"the motor makes {slope * N:.5g} turns for one of the link, not {N}"
            return ColumnChange("gear_ratio", column, text, slope, price=SETTINGS.price + free)
        text = f"the link's angle is {1 / slope:.5g} times what motor and gear ratio say"
        return ColumnChange("gear_ratio", column, text, slope, price=SETTINGS.price + SETTINGS.free + 3)

    def _slope(self, state: _Progress) -> float | None:
        """Turns of the motor over N times those of the link, of all recordings; None where the link hardly moves."""
        N = self.joint.numbers["N"].value
        found, weights = [], []
        for motion in state.motions:
            if motion is None or not all(name in motion for name in POSITIONS):
                continue
            m, l = (motion.channels[name][:, 0] for name in POSITIONS)
            if np.ptp(l) > 0.02:
                l, m = l - l.mean(), m / N - m.mean() / N
                found.append(float(l @ m / (l @ l)))
                weights.append(float(l @ l))
        return float(np.average(found, weights=weights)) if found else None

    def _zeros(self, there: set[str], state: _Progress) -> Iterator[ColumnChange]:
        """Zeros of the angle, of one encoder or of all angles together."""
        N = self.joint.numbers["N"].value
        positions = [name for name in POSITIONS if name in there]
        between = self._median(state, "motor_position", "link_position")
        if between is not None and abs(between) > SETTINGS.smallest_offset:
            yield _zero("link_position", between)
            yield _zero("motor_position", -N * between)
        command = self._median(state, "position_command", positions[-1])
        if command is not None and abs(command) > 0.1:
            yield _zeros(positions, command, N)
            yield _zero("position_command", -command)
        angle = self._hanging(state)
        if angle is not None:
            if abs(angle) == math.pi and any(abs(p.p["gravity_angle"]) > 0.3 for p in self._plausible):
                yield self._gravity(there, angle)
            yield _zeros(positions, angle, N)
            if "position_command" in there:
                yield _zeros([*positions, "position_command"], angle, N)

    def _gravity(self, there: set[str], angle: float) -> ColumnChange:
        """Gravity's direction turned round, where the description says that it has one."""
        angles = [n for n in (*POSITIONS, "position_command") if n in there]
        turned = _zeros(angles, angle, self.joint.numbers["N"].value)
        text = "gravity acts the other way: gravity_angle is a half turn off, or all angles are"
        return ColumnChange("sign", GRAVITY, text, price=SETTINGS.price - 1, also=(turned,))

    def _median(self, state: _Progress, a: str, b: str) -> float | None:
        """Median of one position less another on the output side [rad], of all recordings that have both."""
        N = self.joint.numbers["N"].value
        found = []
        for motion in state.motions:
            if motion is not None and a in motion and b in motion and a != b:
                x, y = (motion.channels[n][:, 0] / (N if n == "motor_position" else 1.0) for n in (a, b))
                found.append(x - y)
        return float(np.median(np.concatenate(found))) if found else None

    def _hanging(self, state: _Progress) -> float | None:
        """What all angles would have to be turned by for gravity to suit them best [rad]; None where it hardly matters."""
        torques = [i for i, fits in enumerate(state.fits) if any(n in fits for n in DRIVING)]
        weights = [i for i in torques if self._plausible[i].p["Mg"] > 0]
        if not weights or not any(
            fit.misfit < SETTINGS.suspicious for i in weights for n, fit in state.fits[i].items() if n in DRIVING
        ):
            return None

        def agreement(angle: float) -> float:
            total = 0.0
            for i in weights:
                motion = state.motions[i]
                assert motion is not None
                turned = _zeros([n for n in POSITIONS if n in motion], angle, self.joint.numbers["N"].value).apply(
                    motion
                )
                total += sum(fit.agreement for n, fit in self._plausible[i].torques(turned).items())
            return total

        tried = 2 * math.pi / SETTINGS.offsets * np.arange(-SETTINGS.offsets // 2 + 1, SETTINGS.offsets // 2 + 1)
        best = float(tried[int(np.argmax([agreement(x) for x in tried]))])
        width = 2 * math.pi / SETTINGS.offsets
        while width > 0.02:
            width /= 2
            best = max((best - width, best, best + width), key=agreement)
        for simple in (0.5 * math.pi, -0.5 * math.pi, math.pi, -math.pi):
            if abs(best - simple) < 0.2:
                best = simple
        return best if abs(best) > SETTINGS.smallest_turn else None


def _sign(column: str) -> ColumnChange:
    return ColumnChange("sign", column, "turned round", price=SETTINGS.price - 1)


def _turned(unit: ColumnChange) -> ColumnChange:
    """A wrong unit whose column is turned round as well: either alone mends nothing."""
    assert unit.factor is not None
    text = f"{unit.description}, and turned round"
    return replace(unit, description=text, factor=-unit.factor, price=unit.price + SETTINGS.price - 1)


def _unit(column: str, said: str, factor: float, price: float = SETTINGS.price) -> ColumnChange:
    return ColumnChange("unit", column, f"{said} taken for {_SI[column]}", factor, price=price)


_SI = {
    "motor_position": "rad", "link_position": "rad", "position_command": "rad", "motor_current": "A",
    "motor_torque": "N·m of the motor", "joint_torque": "N·m", "external_torque": "N·m",
}  # fmt: skip


def _angles(column: str) -> Iterator[ColumnChange]:
    yield _unit(column, "degrees", _DEGREE)
    yield _unit(column, "turns", 2 * math.pi)
    yield _unit(column, "mrad", 1e-3)


def _zero(column: str, offset: float) -> ColumnChange:
    return ColumnChange("angle_zero", column, "zero is elsewhere", offset=offset, price=SETTINGS.price + SETTINGS.free)


def _zeros(columns: Sequence[str], offset: float, N: float) -> ColumnChange:
    """The same turn of several angles, the link's first."""
    changes = [
        _zero(column, offset * (N if column == "motor_position" else 1.0))
        for column in sorted(columns, key=lambda name: name != "link_position")
    ]
    price = SETTINGS.price + (
        0.0 if abs(abs(offset) % (0.5 * math.pi)) < 1e-9 else 1.0
    )  # of one angle, it shows in its counterpart
    return replace(changes[0], price=price, also=tuple(changes[1:]))
