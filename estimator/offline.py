"""Joint torque and external torque of a recording, by every estimator whose channels it has: without a torque sensor.

A recording is made ready first, segment by segment (`prepare`): what estimators need and no sensor read follows from what
was read and the joint's description, and the encoders' zeros are set against each other.

* **Current**: where a drive reports its torque instead, that over the torque constant that the drive believes in.
* **One encoder**: the other side's motion follows from the joint's description, under the torque that the current means (or,
  without a current, the link's own). What is made of torsion is then left out: torsion cannot be read with one encoder.
* **Delay** of the link encoder: a recording is over, so its readings are simply taken earlier.
* **Zero.** Where both encoders' zeros are not known against each other, the compliance model has an offset of stiffness times
  that. A joint states how well it is known (`sensors.link_encoder.zero`: `std`, or else `deviation`); the motor current knows it
  up to the errors of the joint's constants, which are open with their tolerances (`track_zero`). Where the joint has a link
  encoder eccentricity with a standard deviation, or torsion contradicts the current, the zero may wander with the link angle.
* **Load.** Where the current contradicts the link's balance in most of the motion, the load is another one (`unlike`): by how
  much is `KnownJoint.load_error`.
* **W** of the paper's filters is the one of `WALKS` that makes the EKF's innovations most likely: how fast the load changes is a
  property of the motion, not of the joint.

No estimator reads the columns `joint_torque` and `external_torque`.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Collection, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ..models import dynamics, laws, streams
from ..models.errors import InputError
from ..models.files import write_into_place
from ..models.joint import Joint
from ..models.kernels import kernel
from ..models.recording import Recording
from ..models.signals import Signals
from ..models.spool import Spool
from ..models.tables import ROWS, TableWriter
from . import recursion, registry, smoothed
from .bands import SIGMAS, deviations, disagreement, motion_and_load, reference_torque
from .conditioning import Conditioned, condition
from .errors import FilterDiverged
from .estimator import Estimator, KnownJoint, sample_interval
from .filters.current import MotorCurrent
from .filters.paper import PaperFilter
from .filters.payload import DECIMATION, PayloadObserver, observe, slow_current
from .motion import CUTOFF
from .payload_model import MEMORY, NOISE, friction_error, slow_friction

WALKS = (1.0, 4.0, 16.0, 64.0, 256.0, 1024.0)
"""Factors of the filters' W among which the likelihood of the EKF's innovations chooses."""
SHORTEST = 10
"""Samples that a segment must have to be estimated."""
POSITIONS = ("motor_position", "link_position")
_SLOW = 15.0
"""Bandwidth [Hz] below which the causal estimate from current makes up for its lag: 15 ms, in which a load has gone on."""
_LED = 0.6
"""Its cutoff then, in that bandwidth: with the lead as much noise as without it."""
_TRACK = 20  # grid steps per sample of the zero's tracking
_REWEIGHTED = 2  # times that samples are weighed by what is left of them
_OUTLIER = 2.5  # standard deviations beyond which a sample counts less
_ROBUST = 1.4826  # standard deviation of normal errors over their median
_UNMODELLED = 0.03  # share of the current's torque that friction without a description may be
_MOST, _CONTRADICTS = 0.75, 2.5  # share of the motion, and standard deviations, from which on the load is another one
_TORSION = 10.0  # times its uncertainty by which torsion contradicts the current
_MOVING = 2.5  # Stribeck velocities of the motor from which on it is in motion


@dataclass(frozen=True)
class Prepared:
    """A recording's segment, ready for estimators; n samples.

    Attributes:
      signals: both positions, the link's tared and without delay, and the current, as far as they can be known.
      known: what is known of the joint, with what the segment shows of it.
      measured: channels that were measured, or are another unit of one that was.
      own_torque: shape (n,), joint torque that the link's own inertia, gravity and known link torques ask for [N·m].
      walk: factor of the paper's filters' W, one of `WALKS`.
      bandwidth: of the estimate from current [Hz].
      note: what was found: `start` [s], `bandwidth` [Hz], `zero` [rad] with `zero_std`, the payload's moments [N·m] and inertia
        [kg·m²], the back-driven share of the load-dependent friction.
    """

    signals: Signals
    known: KnownJoint
    measured: frozenset[str]
    own_torque: np.ndarray
    walk: float
    bandwidth: float
    note: dict[str, float]
    lasting: np.ndarray

    def read_by(self, estimator: Estimator) -> Signals:
        """The signals as an estimator takes them: what the joint's constant errors do to the torsion is taken off with the zero,
        but for one that estimates these errors itself, which it does with a load that it knows."""
        return self.signals if estimator.learns and not self.known.load_error else _shifted(self.signals, self.lasting)

    def lacks(self, estimator: Estimator) -> str | None:
        """Why there is nothing for an estimator here; None where there is."""
        return _lacking(estimator, set(self.signals), self.measured)

    def ready(self, estimator: Estimator) -> Estimator:
        """An estimator as this segment wants it: scaled to joint and sampling, W and bandwidth by what its readings show."""
        interval = sample_interval(self.signals)
        scaled = estimator.scaled(self.known, interval)
        if isinstance(scaled, PaperFilter):
            return scaled.with_noise(scaled.W * self.walk, scaled.V)
        if isinstance(scaled, MotorCurrent) and self.bandwidth < _SLOW:
            return replace(scaled, cutoff=_LED * self.bandwidth, lead=1.0)
        if isinstance(scaled, (MotorCurrent, PayloadObserver)):
            return replace(scaled, cutoff=min(scaled.cutoff, self.bandwidth))
        return scaled


@dataclass(frozen=True)
class Estimates:
    """Estimates over one recording; n samples.

    Attributes:
      name: of the recording.
      time: as its table has it, shape (n,) [s].
      torque: joint torque by estimator, as the joint's torque sensor would read it, shape (n,) [N·m]; NaN in segments of fewer
        than `SHORTEST` samples. It may lie in files (`models.spool`).
      external_torque: torque on the link that its own gravity and inertia, and the motion of other joints of an arm, do not
        explain, by estimator, likewise.
      left_out: why there is no estimate, by estimator: a channel that was not recorded, an estimate that diverged.
      notes: what was found on the way, one entry a segment (`Prepared.note`).
      deviation, external_deviation: standard deviations of `torque` and `external_torque`, likewise; empty where nobody asked.
      untrusted: why an estimate is not to be trusted, by estimator (`trust`).
    """

    name: str
    time: np.ndarray
    torque: Mapping[str, np.ndarray]
    external_torque: Mapping[str, np.ndarray]
    left_out: dict[str, str] = field(default_factory=dict)
    notes: list[dict[str, float]] = field(default_factory=list)
    deviation: Mapping[str, np.ndarray] = field(default_factory=dict)
    external_deviation: Mapping[str, np.ndarray] = field(default_factory=dict)
    untrusted: dict[str, str] = field(default_factory=dict)

    @property
    def columns(self) -> dict[str, np.ndarray]:
        """All columns as they are written: `time` [s], `torque_…` and `external_torque_…` [N·m], with their 95 % bands,
        `…_low` and `…_high`, where these are known."""
        return self.part(slice(None))

    def part(self, samples: slice) -> dict[str, np.ndarray]:
        """Some samples of `columns`."""
        columns = {"time": self.time[samples]}
        for what, found, deviation in (
            ("torque", self.torque, self.deviation), ("external_torque", self.external_torque, self.external_deviation),
        ):  # fmt: skip
            for name, values in found.items():
                some = columns[f"{what}_{name}"] = values[samples]
                if name in deviation:
                    half = SIGMAS * deviation[name][samples]
                    columns[f"{what}_{name}_low"], columns[f"{what}_{name}_high"] = some - half, some + half
        return columns


@dataclass(frozen=True)
class Score:
    """Error of one estimate against what was measured [N·m]: all samples, samples in motion (NaN where nothing moves), mean,
    largest."""

    rms: float
    rms_moving: float
    mean: float
    max: float


def estimate_recording(
    recording: Recording,
    joint: Joint,
    names: Sequence[str] | None = None,
    bands: bool = False,
    spool: Path | None = None,
    record: np.ndarray | None = None,
    conditioned: Conditioned | None = None,
) -> Estimates:
    """Run estimators over a recording of a joint.

    Args:
      recording: its `joint_torque` and `external_torque` are not read.
      joint: the description, with the effects that are known of it.
      names: of the registry; all by default.
      bands: whether estimates are told how far they may be off (`bands`); those that simulate the joint's dynamics
        (`Estimator.costly`) only where they are named: some ten times their work.
      spool: a folder whose files hold the estimates, for as long as they are read; by default they are in memory.
      record: parameter record that estimators know in place of the joint's own, shape (1,).
      conditioned: the conditioned recording, where it is known already.

    Raises:
      InputError: a name that is none.
    """
    estimators = {name: registry.get(name) for name in (registry.names() if names is None else names)}
    known = replace(KnownJoint.of(joint, recording.link, record), start=float(recording.time[0]))
    conditioned = conditioned or condition(recording, joint)
    blind = conditioned.recording.signals.without("joint_torque", "external_torque")
    arm_torque = known.record[0]["arm_scale"] * recording.torque_of_arm
    if recording.load is not None:
        blind = blind.with_columns(arm_torque=arm_torque)
    n = len(recording.time)
    found, deviation = (
        {what: Spool(n, spool, f"{recording.name}_{kind}{what}") for what in _QUANTITIES} for kind in ("", "deviation_")
    )
    left_out: dict[str, str] = {}
    untrusted: dict[str, str] = {}
    notes = []
    for segment in recording.segments:
        if segment.stop - segment.start < SHORTEST:
            continue
        signals = blind.part(segment)
        ready = prepare(signals, known)
        notes.append(ready.note | {"start": float(recording.stamps[segment.start])})
        chosen = {name: e for name, e in estimators.items() if name not in left_out}
        beliefs: dict[str, np.ndarray] = {}
        estimates: dict[_Key, np.ndarray] = {}

        def take(
            what: str,
            name: str,
            values: np.ndarray,
            segment: slice = segment,
            estimates: dict[_Key, np.ndarray] = estimates,
        ) -> None:
            if bands:
                estimates[what, name] = values
            if what == "external_torque":
                values = values - arm_torque[segment]
            found[what].put(name, segment, values)

        _estimate(ready, chosen, left_out, take, beliefs if bands else None, _THREADS, untrusted)
        if bands:
            # The dynamics simulated nine times more is for whoever asks for it by name.
            told = {n: e for n, e in chosen.items() if n not in left_out and (names is not None or not e.costly)}

            def again(s: Signals, k: KnownJoint, told: dict[str, Estimator] = told) -> dict[_Key, np.ndarray]:
                other: dict[_Key, np.ndarray] = {}

                def keep(quantity: str, estimator: str, values: np.ndarray) -> None:
                    other[quantity, estimator] = values

                _estimate(prepare(s, k), told, {}, keep)
                return other

            reference = reference_torque(ready.signals, ready.known)
            seen = {
                "torque": ready.known.as_read(reference, ready.signals),
                "external_torque": ready.own_torque - reference,
            }
            there = {(what, name): estimates[what, name] for name in told for what in _QUANTITIES}
            for key, apart_by in deviations(there, signals, known, joint, recording.link, again).items():
                apart = disagreement(signals.time, estimates[key], seen[key[0]])
                own = np.sqrt(beliefs.get(key[1], 0.0))
                deviation[key[0]].put(key[1], segment, np.sqrt(apart_by**2 + apart**2 + own**2))
    kept = [name for name in estimators if name not in left_out]
    for columns in found.values():
        columns.keep(kept)
    torque, external = (found[what] for what in _QUANTITIES)
    spread, external_spread = (deviation[what] for what in _QUANTITIES)
    return Estimates(
        recording.name, recording.stamps, torque, external, left_out, notes, spread, external_spread, untrusted
    )


def too_short(recording: Recording) -> bool:
    """Whether nothing is estimated: no part without gaps has `SHORTEST` samples."""
    return all(segment.stop - segment.start < SHORTEST for segment in recording.segments)


def lacking(recording: Recording, names: Sequence[str]) -> dict[str, str]:
    """Why `estimate_recording` would leave estimators out for a channel that they need, by name; it is not run.

    Empty where nothing is estimated (`too_short`).

    Raises:
      InputError: a name that is none.
    """
    if too_short(recording):
        return {}
    measured = set(recording.columns) - {"joint_torque", "external_torque"}
    if "motor_torque" in measured:  # of which the current is told (`smoothed.in_amperes`)
        measured.add("motor_current")
    reasons = {name: _lacking(registry.get(name), measured | set(POSITIONS), measured) for name in names}
    return {name: reason for name, reason in reasons.items() if reason is not None}


def _lacking(estimator: Estimator, there: Collection[str], measured: Collection[str]) -> str | None:
    """Why an estimator finds nothing among the channels that are there, of which some were measured; None where it does."""
    for channel in estimator.needs:
        if channel not in there:
            return f"expected the column {channel!r}, the recording has none"
        if channel not in measured and set(estimator.needs) >= set(POSITIONS):
            return f"expected the column {channel!r}, the recording has none: torsion cannot be read with one encoder"
    return None


def beyond_range(recording: Recording, joint: Joint) -> dict[str, float]:
    """Shares of the samples in motion beyond a joint's range of validity (`ValidRange.beyond`); empty where it states none."""
    if joint.valid is None:
        return {}
    known = replace(KnownJoint.of(joint, recording.link), start=float(recording.time[0]))
    motions = []
    for segment in recording.segments:
        if segment.stop - segment.start < SHORTEST:
            continue
        motion, load = motion_and_load(recording.signals.part(segment), known)
        moving = np.abs(motion.motor_velocity) > _MOVING * known.p["vs"]
        motions.append(np.stack([motion.link_position, motion.link_velocity, load])[:, moving])
    return joint.valid.beyond(*np.concatenate(motions, axis=1)) if motions else {}


_Key = tuple[str, str]  # quantity and estimator
_QUANTITIES = ("torque", "external_torque")
_THREADS = min(os.cpu_count() or 1, 8)
_LONG = 1 << 20
"""Samples from which on memory counts: what looks at the whole runs alone, of all others two at a time."""


def _estimate(
    ready: Prepared,
    estimators: Mapping[str, Estimator],
    left_out: dict[str, str],
    take: Callable[[str, str, np.ndarray], None],
    beliefs: dict[str, np.ndarray] | None = None,
    threads: int = 1,
    untrusted: dict[str, str] | None = None,
) -> None:
    """Estimate a segment's joint torque and external torque.

    Args:
      ready: the segment.
      estimators: by name.
      left_out: gets why there is no estimate, by name.
      take: takes an estimate, of quantity, name and values, in any order.
      beliefs: gets what estimators believe their error variance to be.
      threads: estimators at a time.
      untrusted: gets why an estimate is not to be trusted, by name.
    """
    able: dict[str, Estimator] = {}
    for name, estimator in estimators.items():
        reason = ready.lacks(estimator)
        if reason is not None:
            left_out[name] = reason
        else:
            able[name] = estimator

    def one(name: str) -> str | None:
        try:
            posterior = ready.ready(able[name]).torques(ready.read_by(able[name]), ready.known)
        except (FilterDiverged, InputError) as error:
            return str(error)
        if beliefs is not None and posterior.variance is not None:
            beliefs[name] = np.maximum(posterior.variance, 0.0)
        take("torque", name, ready.known.as_read(posterior.mean, ready.signals))
        external = ready.own_torque - posterior.mean if posterior.external is None else posterior.external
        if posterior.external is not None and "arm_torque" in ready.signals:
            external = external + ready.signals["arm_torque"]
        take("external_torque", name, external)
        if posterior.untrusted is not None and untrusted is not None:
            untrusted.setdefault(name, posterior.untrusted)
        return None

    # The longest first: what is compiled holds no lock.
    order = sorted(able, key=lambda name: not able[name].costly)
    long = len(ready.signals.time) > _LONG
    alone = [name for name in order if long and not able[name].causal]
    failed = {name: one(name) for name in alone}
    with ThreadPoolExecutor(min(threads, 2) if long else threads) as pool:
        others = [name for name in order if name not in alone]
        failed |= zip(others, pool.map(one, others), strict=True)
    left_out |= {name: why for name in able if (why := failed[name]) is not None}


def score(recording: Recording, estimates: Estimates, joint: Joint) -> dict[str, dict[str, Score]]:
    """Score estimates where there is something to compare with.

    Returns:
      `joint_torque` (with a sensor) and `external_torque` (where it was measured, or known to be zero): estimator →
      score. Friction at rest is anything up to its level, hence the score in motion (motor faster than 2.5 Stribeck
      velocities).
    """
    N = joint.numbers["N"].value
    motor = recording["motor_position"] if "motor_position" in recording else N * recording["link_position"]
    moving = np.abs(np.gradient(motor, recording.time)) > _MOVING * joint.numbers["vs"].value
    truths: dict[str, tuple[np.ndarray, Mapping[str, np.ndarray]]] = {}
    if "joint_torque" in recording:
        truths["joint_torque"] = (recording["joint_torque"], estimates.torque)
    if recording.external == "measured":
        truths["external_torque"] = (recording["external_torque"], estimates.external_torque)
    elif recording.external == "none":
        truths["external_torque"] = (np.zeros(len(recording.time)), estimates.external_torque)
    return {
        what: {name: _score(values - truth, moving) for name, values in found.items()}
        for what, (truth, found) in truths.items()
    }


_USELESS = 0.5
"""Share of a torque's own RMS from which on an estimate's error is not worth having."""


def useless(
    recording: Recording, scores: Mapping[str, Mapping[str, Score]]
) -> dict[str, tuple[float, dict[str, float]]]:
    """Of each quantity that was measured, where there are any, the estimators whose error is more than half of it.

    Returns:
      quantity → its own RMS, and RMS error by estimator [N·m].
    """
    found = {}
    for what, by_name in scores.items():
        truth = recording.columns.get(what)
        if truth is None:  # known to be zero
            continue
        own = float(np.sqrt(np.mean(truth**2)))
        worse = {name: s.rms for name, s in by_name.items() if s.rms > _USELESS * own}
        if worse:
            found[what] = own, worse
    return found


def _score(error: np.ndarray, moving: np.ndarray) -> Score:
    good = np.isfinite(error)
    if not good.any():
        return Score(*[float("nan")] * 4)
    inside, error = error[good & moving], error[good]
    return Score(
        rms=float(np.sqrt(np.mean(error**2))),
        rms_moving=float(np.sqrt(np.mean(inside**2))) if len(inside) else float("nan"),
        mean=float(np.mean(error)),
        max=float(np.max(np.abs(error))),
    )


def write_estimates(estimates: Estimates, folder: Path) -> Path:
    """Write estimates as `<recording>.parquet`, units in the columns' metadata; return its path."""
    path = folder / f"{estimates.name}.parquet"
    units = {name: "s" if name == "time" else "N·m" for name in estimates.part(slice(0, 0))}
    with write_into_place(path) as temporary, TableWriter(temporary, units) as table:
        for part in streams.parts(len(estimates.time), ROWS, 1):
            table.write(estimates.part(part))
    return path


# --- a segment made ready -------------------------------------------------------------------------------------------


def prepare(signals: Signals, joint: KnownJoint) -> Prepared:
    """Make a segment ready for estimators.

    Args:
      signals: at least one position; no `joint_torque`.
      joint: what is known of it.

    Raises:
      InputError: no position.
    """
    given = set(signals)
    if not given & set(POSITIONS):
        raise InputError(f"recording: expected one of the columns {', '.join(POSITIONS)}, got {sorted(given)}")
    signals = smoothed.in_amperes(signals, joint)
    signals, joint = smoothed.in_time(signals, joint)
    measured = set(signals)
    if "link_position" not in measured:
        signals = signals.with_columns(link_position=_link_of_motor(signals, joint))
    elif "motor_position" not in measured:
        signals = signals.with_columns(motor_position=_motor_of_link(signals, joint))
    note = {"start": float(signals.time[0])}

    if "motor_current" not in signals:
        motion = smoothed.smooth_motion(signals, joint, CUTOFF)
        own, none = smoothed.own_torque(motion, joint, np.zeros(len(motion.time))), np.zeros(len(signals.time))
        return Prepared(
            signals, joint, frozenset(measured), motion.at(signals.time, own), 1.0, motion.cutoff, note, none
        )

    # The payload first, as it shows how much of the load-dependent friction acts when the load drives.
    cutoff = smoothed.bandwidth(signals, joint)
    current = slow_current(signals)
    motion = smoothed.smooth_motion(signals, joint, cutoff)
    own, grid = smoothed.own_torque(motion, joint, smoothed.torque_from_current(motion, joint)), motion.time
    beside = smoothed.arm_torque(motion, signals)
    payload = observe(joint, motion.every(DECIMATION), (own - beside)[::DECIMATION], current)
    joint = joint.told(back_driven_friction=payload.back_driven_friction)
    note |= {"bandwidth": cutoff} | payload._asdict()
    torque = smoothed.torque_from_current(motion, joint)[::_TRACK].copy()
    coarse, motion = (own - beside)[::_TRACK].copy(), motion.every(_TRACK)  # of an hour, all of it is 300 MB
    own = np.interp(signals.time, grid, own)
    joint = replace(joint, load_error=unlike(joint, motion, torque, coarse))
    if joint.load_error > 0.0:
        note |= {"load_error": joint.load_error}
    walk, lasting = 1.0, np.zeros(len(signals.time))
    if measured >= set(POSITIONS):
        zero, std, wander, plain = tared(signals, joint, motion, torque)
        lasting = plain - zero
        signals = signals.with_columns(link_position=signals["link_position"] - zero)
        if wander > joint.link_wander:
            note |= {"torsion_error": wander * float(joint.p["K2"])}
        joint = replace(joint, link_zero=std, link_wander=wander)
        note |= {"zero": float(np.mean(zero)), "zero_std": std}
        walk = likely_walk(_shifted(signals, lasting), joint)
    return Prepared(signals, joint, frozenset(measured), own, walk, cutoff, note, lasting)


def unlike(joint: KnownJoint, motion: smoothed.Motion, torque: np.ndarray, own: np.ndarray) -> float:
    """By how much [N·m] the load is not what the description says; 0 where nothing speaks against it.

    The current's torque and the link's own balance differ by what their tolerances allow, or while somebody touches the joint.
    Where they differ by more in most of the motion, and by more than all of the friction, the load is another one.

    Args:
      motion: n points; torque: of `smoothed.torque_from_current` there, own: what the link's balance asks for, shape (n,) [N·m].
    """
    p, known = joint.p, joint.spread
    w = motion.motor_velocity
    moving = np.abs(w) > _MOVING * p["vs"]
    if not moving.any():
        return 0.0
    off = np.abs(torque - own)[moving]
    allowed = np.sqrt(
        (known.torque_constant**2 + _UNMODELLED**2) * torque**2 + friction_error(joint) ** 2
        + (known.viscous * p["bw"] * p["N"] * w) ** 2 + (known.gravity * p["Mg"]) ** 2
        + (known.inertia * p["Jl"] * motion.link_acceleration) ** 2
    )[moving]  # fmt: skip
    found = float(np.median(off))
    other = np.quantile(off / allowed, 1.0 - _MOST) > _CONTRADICTS and found > p["N"] * p["Fc"]
    return found if other else 0.0


def _shifted(signals: Signals, zero: np.ndarray) -> Signals:
    """The signals with another zero of the link encoder, shape (n,) [rad]."""
    return (
        signals.with_columns(link_position=signals["link_position"] - zero) if "link_position" in signals else signals
    )


def likely_walk(signals: Signals, joint: KnownJoint) -> float:
    """The one of `WALKS` by which the EKF's W makes its innovations most likely."""
    interval = sample_interval(signals)
    measured = registry.get("model").torques(signals, joint).mean
    ekf = registry.get("EKF").scaled(joint, interval)
    assert isinstance(ekf, PaperFilter)
    return min(WALKS, key=lambda walk: _surprise(replace(ekf, W=ekf.W * walk), measured))


def _surprise(ekf: PaperFilter, measured: np.ndarray) -> float:
    """Minus twice the log likelihood of a filter's innovations, robust: no outlier counts more than 5 deviations."""
    found, step, status = recursion.surprise(measured, ekf.record(), 25.0)
    if status != recursion.OK:
        raise FilterDiverged(ekf.name, step, step * 1e-3, ekf.failure(status, measured[step - 1], ekf.W))
    return float(found)


# --- one encoder ----------------------------------------------------------------------------------------------------


def _link_of_motor(signals: Signals, joint: KnownJoint) -> np.ndarray:
    """The link encoder's reading [rad] as the joint's description has it under the torque that the current means."""
    if "motor_current" in signals:
        motion = smoothed.smooth_motion(signals, joint, smoothed.bandwidth(signals, joint))
        torque = smoothed.torque_from_current(motion, joint)
    else:
        motion = smoothed.smooth_motion(signals, joint, CUTOFF)
        torque = smoothed.own_torque(motion, joint, np.zeros(len(motion.time)))
    found = np.empty(len(signals.time))
    _wind_link(signals["motor_position"], motion.at(signals.time, torque), joint.record, found)
    return found


@kernel
def _wind_link(motor_reading, torque, record, out):
    p = record[0]
    for i in range(len(out)):
        motor = dynamics.actual_motor_position(motor_reading[i], p)
        turned, _ = dynamics.measured_torsion(motor, 0.0, torque[i] / p.N, p)
        out[i] = laws.link_reading(turned - laws.flexspline_torsion(torque[i], p), p)


def _motor_of_link(signals: Signals, joint: KnownJoint) -> np.ndarray:
    """The motor encoder's reading [rad, motor side] as the joint's description has it under the link's own torque."""
    rough = signals.with_columns(motor_position=joint.p["N"] * (signals["link_position"] - joint.p["link_zero"]))
    motion = smoothed.smooth_motion(rough, joint, CUTOFF)
    torque = smoothed.own_torque(motion, joint, np.zeros(len(motion.time)))
    found = np.empty(len(signals.time))
    link = smoothed.link_positions(rough, joint)
    _wind_motor(link, motion.at(signals.time, torque), joint.record, found)
    return found


@kernel
def _wind_motor(link, torque, record, out):
    p = record[0]
    for i in range(len(out)):
        theta_w = dynamics.wave_generator_position(link[i] + laws.flexspline_torsion(torque[i], p), p)
        out[i] = laws.motor_reading(theta_w + laws.wave_generator_torsion(torque[i] / p.N, p), p)


# --- the encoders' zeros --------------------------------------------------------------------------------------------


def tared(
    signals: Signals, joint: KnownJoint, motion: smoothed.Motion, torque: np.ndarray
) -> tuple[np.ndarray, float, float, np.ndarray]:
    """What the link encoder's zero is off from the joint's [rad], shape (n,), its mean standard deviation, by how much it wanders
    [rad/√rad], and what it is off with the joint's constant errors, shape (n,): for who does not know of them.

    Args:
      signals: both encoders and the current, n samples.
      motion: of `smoothed.smooth_motion` at the bandwidth of the estimate from current, every `_TRACK`-th point of its grid.
      torque: of `smoothed.torque_from_current` there [N·m].
    """
    p, spread, wander = joint.p, joint.link_zero, joint.link_wander
    if spread == 0 and wander == 0:
        return np.zeros(len(signals.time)), 0.0, 0.0, np.zeros(len(signals.time))
    wide = smoothed.smooth_motion(signals, joint, CUTOFF, _TRACK)  # of the same grid
    # A reading that is too high by δ makes torsion too small by δ.
    seen = smoothed.wound(torque, joint) - smoothed.torsion_of(wide, joint, torque)
    load = np.abs(torque)
    slope = 1.0 / np.where(load < p["T1"], p["K1"], np.where(load < p["T2"], p["K2"], p["K3"]))
    w, v = motion.motor_velocity, motion.link_velocity
    slow = np.empty(len(w))
    _slow_friction(w, joint.record, slow)
    friction = friction_error(joint)
    constants = _constants(joint, wide, torque, slope, w)
    found, plain = (
        track_zero(
            seen, slope * np.sign(w), some, slope * np.hypot(max(0.1 * friction, NOISE * joint.rated_torque), slow),
            np.abs(v) * smoothed.STEP * _TRACK, spread, wander, friction,
        )
        for some in (constants, constants[:, :0])
    )  # fmt: skip
    at = signals.time, motion.time
    return np.interp(*at, found.zero), float(np.mean(found.std)), found.wander, np.interp(*at, plain.zero)


def _constants(
    joint: KnownJoint, motion: smoothed.Motion, torque: np.ndarray, slope: np.ndarray, w: np.ndarray
) -> np.ndarray:
    """What a standard deviation of every constant error of the joint does to the zero that is seen, shape (n, constants) [rad].

    Stiffness with torque constant, wave generator, friction's level, viscous friction, current offset, and both quadratures of
    every order of kinematic error. They last as long as the recording does: no number of samples averages them away.
    """
    p, known, wave = joint.p, joint.spread, np.empty(len(torque))
    _wave_generator_torsion(torque, joint.record, wave)
    columns = [
        math.hypot(known.stiffness, known.torque_constant) * torque * slope,
        known.wave_generator * wave,
        friction_error(joint) * slope * np.sign(w),
        known.viscous * p["bw"] * p["N"] * w * slope,
        known.current_offset * p["Kt"] * p["N"] * slope,
    ]
    theta = motion.motor_position - p["N"] * wave
    for order, std in zip(p["order"], known.kinematic, strict=True):
        columns += [std * np.sin(order * theta), std * np.cos(order * theta)]
    found = np.stack(columns, axis=1)
    return found[:, np.any(found != 0.0, axis=0)]


class Tracked(NamedTuple):
    """A zero δ [rad] and its standard deviation, shape (n,); by how much it wanders [rad/√rad]: more than is known where torsion
    contradicts the current."""

    zero: np.ndarray
    std: np.ndarray
    wander: float


def track_zero(
    seen: np.ndarray,
    friction_shape: np.ndarray,
    constants: np.ndarray,
    noise: np.ndarray,
    travel: np.ndarray,
    spread: float,
    wander: float,
    friction: float,
) -> Tracked:
    """Kalman smoother of the zero δ [rad], every `_TRACK` grid steps.

        seen = δ + friction_shape · r + constants · c + noise
        δ walks by `wander` rad per √rad of travel, r forgets in `MEMORY`, c are standard normal

    δ and r by the smoother for given c, which is linear in what is seen; c by its innovations. Noise is as large as the scatter
    shows where it is more than what is given, and single samples that are off count less (iterated reweighting).

    Args:
      seen: measured, shape (n,) [rad]; friction_shape [rad/(N·m)], noise [rad], travel since the last [rad]: shape (n,).
      constants: of one standard deviation each, shape (n, k) [rad].
      spread: prior standard deviation of δ [rad]; wander [rad/√rad]; friction: of r [N·m].
    """
    forget = float(np.exp(-smoothed.STEP * _TRACK / MEMORY))
    known = np.hypot(noise, friction * friction_shape)
    told = noise <= np.median(noise)
    weighted = noise
    beyond = np.zeros(_REWEIGHTED + 1)
    for i in range(_REWEIGHTED + 1):
        (zero, left), variance = _tracked(
            seen, friction_shape, constants, weighted**2, wander**2 * travel, spread**2, friction**2, forget
        )
        scatter = _ROBUST * float(np.median(np.abs(left[told])))
        beyond[i] = math.sqrt(max(scatter**2 - float(np.median(known[told])) ** 2, 0.0))
        if i < _REWEIGHTED:
            weighted = np.hypot(noise, beyond[i])
            weighted = weighted * np.maximum(np.abs(left) / (_OUTLIER * np.hypot(known, beyond[i])), 1.0)
    if beyond[-1] > _TORSION * float(np.median(known[told])):
        variance, wander = variance + beyond[-1] ** 2, math.hypot(wander, beyond[-1])
    return Tracked(zero, np.sqrt(np.maximum(variance, 0.0)), wander)


def _tracked(
    seen: np.ndarray,
    friction_shape: np.ndarray,
    constants: np.ndarray,
    noise: np.ndarray,
    walk: np.ndarray,
    zero_variance: float,
    friction_variance: float,
    forget: float,
) -> tuple[tuple[np.ndarray, np.ndarray], np.ndarray]:
    """Zero and what is left of what is seen without it and the constants, shape (n,); the zero's variance, likewise."""
    k = constants.shape[1]
    smooth, innovations = np.empty((k + 1, len(seen))), np.empty((k + 1, len(seen)))
    variance, total = np.empty(len(seen)), np.empty(len(seen))
    for i, column in enumerate((seen, *constants.T)):
        _track(
            np.ascontiguousarray(column), friction_shape, noise, walk, zero_variance, friction_variance, forget, smooth[i],
            variance, innovations[i], total,
        )  # fmt: skip
    information = np.eye(k) + (innovations[1:] / total) @ innovations[1:].T
    c = np.linalg.solve(information, (innovations[1:] / total) @ innovations[0])
    zero = smooth[0] - c @ smooth[1:]
    variance = variance + np.einsum("kn,kn->n", smooth[1:], np.linalg.solve(information, smooth[1:]))
    return (zero, seen - zero - constants @ c), variance


@kernel
def _wave_generator_torsion(torque, record, out):
    p = record[0]
    for i in range(len(out)):
        out[i] = laws.wave_generator_torsion(torque[i] / p.N, p) / p.N


@kernel
def _slow_friction(w, record, out):
    for i in range(len(w)):
        out[i] = slow_friction(w[i], record[0])


@kernel
def _track(seen, slope, noise, walk, zero_variance, friction_variance, forget, zero, variance, innovation, total):
    """Kalman filter forward and Rauch-Tung-Striebel back, of two states: zero and its variance into `zero`, `variance`, the
    filter's innovations and their variance into `innovation`, `total`.

    Args:
      slope: of what is seen over the friction model's error, shape (n,); noise, walk: variances of what is seen and of the zero's
        steps, likewise.
    """
    n = len(seen)
    # Filtered and predicted: both states, and variance of the first, covariance, variance of the second.
    filtered, predicted = np.empty((n, 5)), np.empty((n, 5))
    d, r, a, b, c = 0.0, 0.0, zero_variance, 0.0, friction_variance
    for k in range(n):
        if k > 0:
            r, a, b, c = (
                forget * r,
                a + walk[k],
                forget * b,
                forget * forget * (c - friction_variance) + friction_variance,
            )
        p = predicted[k]
        p[0], p[1], p[2], p[3], p[4] = d, r, a, b, c
        h = slope[k]
        first, second = a + b * h, b + c * h
        s = first + h * second + noise[k]
        innovation[k], total[k] = seen[k] - d - h * r, s
        e = innovation[k] / s
        d, r = d + first * e, r + second * e
        a, b, c = a - first * first / s, b - first * second / s, c - second * second / s
        f = filtered[k]
        f[0], f[1], f[2], f[3], f[4] = d, r, a, b, c
    zero[n - 1], variance[n - 1] = d, a
    for k in range(n - 2, -1, -1):
        f, p = filtered[k], predicted[k + 1]
        fa, fb, fc = f[2], f[3], f[4]
        pa, pb, pc = p[2], p[3], p[4]
        determinant = pa * pc - pb * pb
        # Gain of the smoother: P F over what was predicted; a state that is known exactly stays.
        g00, g01, g10, g11 = 0.0, 0.0, 0.0, 0.0
        if determinant > 1e-15 * pa * pc:
            g00, g01 = (fa * pc - forget * fb * pb) / determinant, (forget * fb * pa - fa * pb) / determinant
            g10, g11 = (fb * pc - forget * fc * pb) / determinant, (forget * fc * pa - fb * pb) / determinant
        elif pa > 0.0:
            g00, g10 = fa / pa, fb / pa
        elif pc > 0.0:
            g01, g11 = forget * fb / pc, forget * fc / pc
        du, dv = d - p[0], r - p[1]
        d, r = f[0] + g00 * du + g01 * dv, f[1] + g10 * du + g11 * dv
        qa, qb, qc = a - pa, b - pb, c - pc
        a = fa + g00 * g00 * qa + 2.0 * g00 * g01 * qb + g01 * g01 * qc
        b = fb + g00 * g10 * qa + (g00 * g11 + g01 * g10) * qb + g01 * g11 * qc
        c = fc + g10 * g10 * qa + 2.0 * g10 * g11 * qb + g11 * g11 * qc
        zero[k], variance[k] = d, a
