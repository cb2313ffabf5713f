"""Joint torque and external torque of a recording, by every estimator whose channels it has, without a torque sensor.

Each segment is prepared first (`prepare`):

* **Current**: from the drive's torque over the torque constant that the drive uses, if it reports torque.
* **One encoder**: the motion of the other side follows from the description, under the torque of the current (without
  current, of the link). Estimators based on torsion are left out.
* **Delay** of the link encoder: its readings are shifted to earlier times.
* **Zero.** An unknown zero offset between the encoders is an offset of the compliance model, times the stiffness. The
  joint states how well the zero is known (`sensors.link_encoder.zero`: `std`, or else `deviation`). The current
  measures it, within the tolerances of the joint's constants (`track_zero`). The zero may vary with the link angle if
  the link encoder eccentricity has a standard deviation, or if torsion contradicts the current.
* **Load.** If the current contradicts the link's balance in most of the motion, the load is not the described one
  (`load_error`).
* **W** of the paper's filters is that of `WALKS` with the most likely innovations of the EKF: it depends on the
  motion, not on the joint.

No estimator reads the columns `joint_torque` and `external_torque`.
"""

from __future__ import annotations

import math
import os
from collections import defaultdict
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ..models import dynamics, laws
from ..models.chunks import kept, large, parts
from ..models.errors import FilterDiverged, InputError
from ..models.files import write_into_place
from ..models.joint import Joint
from ..models.joint_parts import Mounting
from ..models.kernels import kernel
from ..models.motion import CUTOFF
from ..models.recording import Recording
from ..models.signals import Signals
from ..models.tables import ROWS, table_writer
from . import recursion, registry, smoothed
from .bands import SIGMAS, deviations, disagreement, motion_and_load, reference_torque
from .conditioning import Conditioned, condition
from .estimator import Estimator, KnownJoint, each, interval_of
from .filters.current import MotorCurrent
from .filters.paper import PaperFilter
from .filters.payload import (
    DECIMATION,
    MEMORY,
    NOISE,
    PayloadObserver,
    friction_error,
    observe,
    slow_current,
    slow_friction,
)  # fmt: skip

WALKS = (1.0, 4.0, 16.0, 64.0, 256.0, 1024.0)
"""Candidate factors of the filters' W; the likelihood of the EKF's innovations decides."""
SHORTEST = 10  # fewest samples of a segment that is estimated
POSITIONS = ("motor_position", "link_position")
_SLOW = 15.0  # bandwidth [Hz] below which the causal estimate from current corrects its lag of 15 ms
_LED = 0.6  # its cutoff then, relative to the bandwidth: the same noise as without the correction
_TRACK = 20  # grid steps per sample of the zero's tracking
_REWEIGHTED = 2  # number of reweightings by the residual
_OUTLIER = 2.5  # standard deviations beyond which a sample counts less
_ROBUST = 1.4826  # standard deviation of normal errors over their median
_UNMODELLED = 0.03  # unmodelled friction, as a share of the current's torque
_MOST, _CONTRADICTS = 0.75, 2.5  # share of the motion, and standard deviations, that contradict the described load
_TORSION = 10.0  # times its uncertainty by which torsion contradicts the current
MOVING = 2.5  # Stribeck velocities of the motor above which it is in motion


@dataclass(frozen=True)
class Prepared:
    """A prepared segment of a recording; n samples."""

    signals: Signals  # both positions, the link's without zero and delay, and the current, as far as possible
    known: KnownJoint  # the known joint, with the findings of the segment
    measured: frozenset[str]  # channels that were measured, or converted from one that was
    own_torque: np.ndarray  # shape (n,), joint torque for the link's inertia, gravity and known link torques [N·m]
    walk: float  # factor of the paper's filters' W, one of `WALKS`
    bandwidth: float  # of the estimate from current [Hz]
    # findings: `start` [s], `bandwidth` [Hz], `zero` [rad] with `zero_std`, the payload's moments [N·m] and inertia
    # [kg·m²], the back-driven share of the load-dependent friction
    note: dict[str, float]
    lasting: np.ndarray  # shape (n,), zero offset by the joint's constant errors [rad]

    def read_by(self, estimator: Estimator) -> Signals:
        """Return the signals for an estimator: without the effect of constant errors on torsion, unless it estimates
        these errors itself, with a known load."""
        return self.signals if estimator.learns and not self.known.load_error else self._plain

    @cached_property
    def _plain(self) -> Signals:
        return _shifted(self.signals, self.lasting)

    def ready(self, estimator: Estimator) -> Estimator:
        """Return an estimator scaled to joint and sampling, with W and bandwidth of this segment."""
        interval = interval_of(self.signals.time)
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
    """Estimates over one recording; n samples."""

    name: str  # of the recording
    time: np.ndarray  # as in its table, shape (n,) [s]
    # joint torque by estimator, as the joint's torque sensor would read it, shape (n,) [N·m]; NaN in segments of fewer
    # than `SHORTEST` samples
    torque: Mapping[str, np.ndarray]
    # external torque on the link by estimator, without that of an arm's motion, likewise
    external_torque: Mapping[str, np.ndarray]
    # reason by estimator without an estimate: a missing channel, a divergence
    left_out: dict[str, str] = field(default_factory=dict)
    notes: list[dict[str, float]] = field(default_factory=list)  # findings, one entry a segment (`Prepared.note`)
    # deviation, external_deviation: standard deviations of `torque` and `external_torque`, likewise; empty without
    # bands
    deviation: Mapping[str, np.ndarray] = field(default_factory=dict)
    external_deviation: Mapping[str, np.ndarray] = field(default_factory=dict)
    # why an estimate is not to be trusted, by estimator (`trust`)
    untrusted: dict[str, str] = field(default_factory=dict)

    @property
    def columns(self) -> dict[str, np.ndarray]:
        """All columns as written: `time` [s], `torque_…` and `external_torque_…` [N·m], with their 95 % bands
        `…_low`, `…_high`."""
        return self.part(slice(None))

    def part(self, samples: slice) -> dict[str, np.ndarray]:
        """Return some samples of `columns`."""
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


def estimate_recording(
    recording: Recording,
    joint: Joint,
    names: Sequence[str] | None = None,
    bands: bool = False,
    record: np.ndarray | None = None,
    conditioned: Conditioned | None = None,
) -> Estimates:
    """Run estimators over a recording of a joint, by their names in the registry; all by default.

    `bands`: whether to compute error bands (`bands`), of costly estimators (`Estimator.costly`) only by name: they take
    ten times the work. `record`: parameters for the estimators instead of the joint's, shape (1,). Raises `InputError`:
    an unknown name.
    """
    estimators = {name: registry.get(name) for name in (registry.names() if names is None else names)}
    known = replace(KnownJoint.of(joint, recording.link, record), start=float(recording.time[0]))
    conditioned = conditioned or condition(recording, joint)
    blind = conditioned.recording.signals.without("joint_torque", "external_torque")
    if recording.load is not None:
        blind = blind.with_columns(arm_torque=known.record[0]["arm_scale"] * recording.torque_of_arm)
    n = len(recording.time)
    torque, external, spread, external_spread = (defaultdict[str, np.ndarray](partial(_blank, n)) for _ in range(4))

    def put(columns: dict[str, np.ndarray], name: str, segment: slice, values: np.ndarray) -> None:
        if segment == slice(0, n):  # no copy of a whole hour
            columns[name] = values
        else:
            columns[name][segment] = values

    left_out: dict[str, str] = {}
    untrusted: dict[str, str] = {}
    notes = []
    for segment in _estimated(recording):
        signals = blind.part(segment)
        ready = prepare(signals, known)
        notes.append(ready.note | {"start": float(recording.stamps[segment.start])})
        chosen = {name: e for name, e in estimators.items() if name not in left_out}
        done, reasons = _estimate(ready, chosen, _THREADS)
        left_out |= reasons
        if bands:
            # Bands simulate the dynamics nine times more: for costly estimators only on request.
            banded = {n: e for n, e in chosen.items() if n in done and (names is not None or not e.costly)}
            for (name, outside), one in _bands(signals, known, ready, banded, done, joint, recording.link).items():
                put(external_spread if outside else spread, name, segment, one)
        for name in list(done):
            found = done.pop(name)
            put(torque, name, segment, found.torque)
            link = found.external - signals["arm_torque"] if "arm_torque" in signals else found.external
            put(external, name, segment, link)
            if found.untrusted is not None:
                untrusted.setdefault(name, found.untrusted)
    there = [name for name in estimators if name not in left_out]
    return Estimates(
        recording.name, recording.stamps, {name: torque[name] for name in there},
        {name: external[name] for name in there}, left_out, notes, dict(spread), dict(external_spread), untrusted,
    )  # fmt: skip


def _blank(n: int) -> np.ndarray:
    values = large(n)
    values.fill(np.nan)
    return values


_Key = tuple[str, bool]  # estimator, and whether it is its external torque instead of its joint torque


def _bands(
    signals: Signals,
    known: KnownJoint,
    ready: Prepared,
    banded: Mapping[str, Estimator],
    done: Mapping[str, _Estimate],
    joint: Joint,
    link: Mounting,
) -> dict[_Key, np.ndarray]:
    """Return the standard deviations of a segment's estimates, shape (n,) each."""

    def torques(found: Mapping[str, _Estimate]) -> dict[_Key, np.ndarray]:
        return {
            (n, outside): found[n].external if outside else found[n].torque for n in found for outside in (False, True)
        }

    def again(s: Signals, k: KnownJoint) -> dict[_Key, np.ndarray]:
        return torques(_estimate(prepare(s, k), banded)[0])

    reference = reference_torque(ready.signals, ready.known)
    seen = {False: ready.known.as_read(reference, ready.signals), True: ready.own_torque - reference}
    estimated = torques({name: done[name] for name in banded})
    found = {}
    for (name, outside), change in deviations(estimated, signals, known, joint, link, again).items():
        lag = disagreement(signals.time, estimated[name, outside], seen[outside])
        found[name, outside] = np.sqrt(change**2 + lag**2 + done[name].variance)
    return found


def too_short(recording: Recording) -> bool:
    """Return whether nothing is estimated: no segment has `SHORTEST` samples."""
    return not _estimated(recording)


def _estimated(recording: Recording) -> list[slice]:
    return [segment for segment in recording.segments if segment.stop - segment.start >= SHORTEST]


def lacking(recording: Recording, names: Sequence[str]) -> dict[str, str]:
    """Return why `estimate_recording` would leave out estimators for a missing channel, by name, without running it.

    Empty if nothing is estimated (`too_short`). Raises `InputError`: an unknown name.
    """
    if too_short(recording):
        return {}
    measured = set(recording.columns) - {"joint_torque", "external_torque"}
    if "motor_torque" in measured:  # converted to current (`smoothed.in_amperes`)
        measured.add("motor_current")
    reasons = {name: _lacking(registry.get(name), measured | set(POSITIONS), measured) for name in names}
    return {name: reason for name, reason in reasons.items() if reason is not None}


def _lacking(estimator: Estimator, there: Collection[str], measured: Collection[str]) -> str | None:
    """Return why an estimator cannot run with these channels, of which some were measured; None if it can."""
    for channel in estimator.needs:
        if channel not in there:
            return f"expected the column {channel!r}, the recording has none"
        if channel not in measured and set(estimator.needs) >= set(POSITIONS):
            return f"expected the column {channel!r}, the recording has none: torsion cannot be read with one encoder"
    return None


def beyond_range(recording: Recording, joint: Joint) -> dict[str, float]:
    """Return the shares of the samples in motion outside a joint's range of validity (`ValidRange.beyond`); empty if
    it has none."""
    if joint.valid is None:
        return {}
    known = replace(KnownJoint.of(joint, recording.link), start=float(recording.time[0]))
    motions = []
    for segment in _estimated(recording):
        motion, load = motion_and_load(recording.signals.part(segment), known)
        moving = np.abs(motion.motor_velocity) > MOVING * known.p["vs"]
        motions.append(np.stack([motion.link_position, motion.link_velocity, load])[:, moving])
    return joint.valid.beyond(*np.concatenate(motions, axis=1)) if motions else {}


_THREADS = min(os.cpu_count() or 1, 8)
_LONG = 1 << 20  # number of samples from which memory matters: smoothers run alone, others two at a time


class _Estimate(NamedTuple):
    """An estimator's joint torque, as read, and external torque of a segment, shape (n,) each [N·m]; its own variance of
    the joint torque, 0 if it has none; why it is not to be trusted."""

    torque: np.ndarray
    external: np.ndarray
    variance: np.ndarray | float
    untrusted: str | None


def _estimate(
    ready: Prepared, estimators: Mapping[str, Estimator], threads: int = 1
) -> tuple[dict[str, _Estimate], dict[str, str]]:
    """Return the estimates of a segment by name, and the reason of every missing one; `threads`: estimators at a time."""
    there, measured = set(ready.signals), ready.measured
    reasons = {name: why for name, e in estimators.items() if (why := _lacking(e, there, measured)) is not None}

    def one(estimator: Estimator) -> _Estimate:
        found = ready.ready(estimator).torques(ready.read_by(estimator), ready.known)
        external = found.external
        if external is None:
            external = np.subtract(ready.own_torque, found.mean, out=large(len(found.mean)))
        elif "arm_torque" in ready.signals:
            external = external + ready.signals["arm_torque"]
        variance = 0.0 if found.variance is None else np.maximum(found.variance, 0.0)
        return _Estimate(ready.known.as_read(found.mean, ready.signals), external, variance, found.untrusted)

    # The longest first: compiled code does not hold the lock.
    able = {n: e for n, e in sorted(estimators.items(), key=lambda item: not item[1].costly) if n not in reasons}
    long = len(ready.signals.time) > _LONG
    alone = {name: e for name, e in able.items() if long and not e.causal}
    others = {name: e for name, e in able.items() if name not in alone}
    done = each(alone, one) | each(others, one, min(threads, 2) if long else threads)
    reasons |= {name: str(found) for name, found in done.items() if isinstance(found, Exception)}
    return {name: found for name, found in done.items() if not isinstance(found, Exception)}, reasons


def write_estimates(estimates: Estimates, folder: Path) -> Path:
    """Write estimates as `<recording>.parquet`, units in the columns' metadata; return its path."""
    path = folder / f"{estimates.name}.parquet"
    units = {name: "s" if name == "time" else "N·m" for name in estimates.part(slice(0, 0))}
    with write_into_place(path) as temporary, table_writer(temporary, units) as write:
        for part in parts(len(estimates.time), ROWS):
            write(estimates.part(part))
    return path


# --- a segment made ready -------------------------------------------------------------------------------------------


def prepare(signals: Signals, joint: KnownJoint) -> Prepared:
    """Prepare a segment for estimators by what is known of the joint; without `joint_torque`. Raises `InputError`: no
    position."""
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
        own = motion.at(signals.time, smoothed.own_torque(motion, joint))
        none = np.zeros(len(signals.time))
        return Prepared(signals, joint, frozenset(measured), own, 1.0, motion.cutoff, note, none)

    # The payload first: it shows the share of the load-dependent friction that acts when the load drives.
    cutoff = smoothed.bandwidth(signals, joint)
    current = slow_current(signals)
    motion = smoothed.smooth_motion(signals, joint, cutoff)
    own, grid = smoothed.own_torque(motion, joint, smoothed.torque_from_current(motion, joint)), motion.time
    arm = smoothed.arm_torque(motion, signals)
    payload = observe(joint, motion.every(DECIMATION), own[::DECIMATION] - arm[::DECIMATION], current)
    joint = joint.with_numbers(back_driven_friction=payload.back_driven_friction)
    note |= {"bandwidth": cutoff} | payload._asdict()
    torque = smoothed.torque_from_current(motion, joint)[::_TRACK].copy()
    coarse, motion = own[::_TRACK] - arm[::_TRACK], motion.every(_TRACK)  # 300 MB less for an hour
    own = kept(np.interp(signals.time, grid, own))
    joint = replace(joint, load_error=unlike(joint, motion, torque, coarse))
    if joint.load_error > 0.0:
        note |= {"load_error": joint.load_error}
    walk, lasting = 1.0, np.zeros(len(signals.time))
    if measured >= set(POSITIONS):
        zero, std, wander, plain = encoder_zero(signals, joint, motion, torque)
        lasting = np.subtract(plain, zero, out=plain)
        signals = _shifted(signals, zero)
        if wander > joint.link_wander:
            note |= {"torsion_error": wander * float(joint.p["K2"])}
        joint = replace(joint, link_zero=std, link_wander=wander)
        note |= {"zero": float(np.mean(zero)), "zero_std": std}
        walk = likely_walk(_shifted(signals, lasting), joint)
    return Prepared(signals, joint, frozenset(measured), own, walk, cutoff, note, lasting)


def unlike(joint: KnownJoint, motion: smoothed.Motion, torque: np.ndarray, own: np.ndarray) -> float:
    """Return the error of the described load [N·m]; 0 if nothing contradicts it. `torque`: of the current, `own`: of
    the link's balance, shape (n,) [N·m], at the points of the motion.

    The current's torque and the link's balance differ within their tolerances, or while the joint is touched. A
    difference larger than the tolerances in most of the motion, and larger than all friction, is another load.
    """
    p, known = joint.p, joint.spread
    w = motion.motor_velocity
    moving = np.abs(w) > MOVING * p["vs"]
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
    if "link_position" not in signals:
        return signals
    return signals.with_columns(link_position=np.subtract(signals["link_position"], zero, out=large(len(zero))))


def likely_walk(signals: Signals, joint: KnownJoint) -> float:
    """Return the factor of `WALKS` with the most likely innovations of the EKF; no outlier counts more than 5
    deviations."""
    interval = interval_of(signals.time)
    measured = registry.get("model").torques(signals, joint).mean
    ekf = registry.get("EKF").scaled(joint, interval)
    assert isinstance(ekf, PaperFilter)

    def surprise(walk: float) -> float:
        one = replace(ekf, W=ekf.W * walk)
        found, step, status = recursion.surprise(measured, one.record(), 25.0)
        if status != recursion.OK:
            raise FilterDiverged(one.name, step, step * 1e-3, one.failure(status, measured[step - 1], one.W))
        return float(found)

    return min(WALKS, key=surprise)


# --- one encoder ----------------------------------------------------------------------------------------------------


def _link_of_motor(signals: Signals, joint: KnownJoint) -> np.ndarray:
    """Return the link encoder's reading [rad] by the joint's description under the torque of the current."""
    if "motor_current" in signals:
        motion = smoothed.smooth_motion(signals, joint, smoothed.bandwidth(signals, joint))
        torque = smoothed.torque_from_current(motion, joint)
    else:
        motion = smoothed.smooth_motion(signals, joint, CUTOFF)
        torque = smoothed.own_torque(motion, joint)
    return _wind_link(signals["motor_position"], motion.at(signals.time, torque), joint.record)


@kernel
def _wind_link(motor_reading, torque, record):
    p, out = record[0], np.empty(len(torque))
    for i in range(len(out)):
        motor = dynamics.actual_motor_position(motor_reading[i], p)
        turned, _ = dynamics.measured_torsion(motor, 0.0, torque[i] / p.N, p)
        out[i] = laws.link_reading(turned - laws.flexspline_torsion(torque[i], p), p)
    return out


def _motor_of_link(signals: Signals, joint: KnownJoint) -> np.ndarray:
    """Return the motor encoder's reading [rad, motor side] by the joint's description under the link's own torque."""
    rough = signals.with_columns(motor_position=joint.p["N"] * (signals["link_position"] - joint.p["link_zero"]))
    motion = smoothed.smooth_motion(rough, joint, CUTOFF)
    torque = motion.at(signals.time, smoothed.own_torque(motion, joint))
    return _wind_motor(smoothed.link_positions(rough, joint), torque, joint.record)


@kernel
def _wind_motor(link, torque, record):
    p, out = record[0], np.empty(len(torque))
    for i in range(len(out)):
        theta_w = dynamics.wave_generator_position(link[i] + laws.flexspline_torsion(torque[i], p), p)
        out[i] = laws.motor_reading(theta_w + laws.wave_generator_torsion(torque[i] / p.N, p), p)
    return out


# --- the encoders' zeros --------------------------------------------------------------------------------------------


def encoder_zero(
    signals: Signals, joint: KnownJoint, motion: smoothed.Motion, torque: np.ndarray
) -> tuple[np.ndarray, float, float, np.ndarray]:
    """Return the error of the link encoder's zero [rad], shape (n,), its mean standard deviation, its variation
    [rad/√rad], and the zero for an estimator that ignores the joint's constant errors, shape (n,).

    The signals are both encoders and the current; the motion, and the torque of the current there [N·m], at every
    `_TRACK`-th point of the grid.
    """
    p, spread, wander = joint.p, joint.link_zero, joint.link_wander
    if spread == 0 and wander == 0:
        return np.zeros(len(signals.time)), 0.0, 0.0, np.zeros(len(signals.time))
    wide = smoothed.smooth_motion(signals, joint, CUTOFF, _TRACK)  # of the same grid
    # A reading too high by δ makes torsion too small by δ.
    seen = smoothed.wound(torque, joint) - smoothed.torsion_of(wide, joint, torque)
    load = np.abs(torque)
    slope = 1.0 / np.where(load < p["T1"], p["K1"], np.where(load < p["T2"], p["K2"], p["K3"]))
    w, v = motion.motor_velocity, motion.link_velocity
    slow, friction = _slow_friction(w, joint.record), friction_error(joint)
    constants = _constants(joint, wide, torque, slope, w)
    found, plain = (
        track_zero(
            seen, slope * np.sign(w), some, slope * np.hypot(max(0.1 * friction, NOISE * joint.rated_torque), slow),
            np.abs(v) * smoothed.STEP * _TRACK, spread, wander, friction,
        )
        for some in (constants, constants[:, :0])
    )  # fmt: skip
    at = signals.time, motion.time
    zero, lasting = (kept(np.interp(*at, one.zero)) for one in (found, plain))
    return zero, float(np.mean(found.std)), found.wander, lasting


def _constants(
    joint: KnownJoint, motion: smoothed.Motion, torque: np.ndarray, slope: np.ndarray, w: np.ndarray
) -> np.ndarray:
    """Return the change of the observed zero by one standard deviation of every constant of the joint, shape (n,
    constants) [rad].

    Stiffness with torque constant, wave generator, friction's level, viscous friction, current offset, and both
    quadratures of every order of kinematic error. They do not average out over a recording.
    """
    p, known, wave = joint.p, joint.spread, _wave_generator_torsion(torque, joint.record)
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
    """A zero δ [rad] and its standard deviation, shape (n,); its variation [rad/√rad], larger if torsion contradicts
    the current."""

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

    δ is a random walk of `wander` rad per √rad of travel, r forgets in `MEMORY`, c are standard normal. δ and r by
    the smoother for given c, which is linear in `seen`; c by its innovations. The noise is at least the observed
    scatter, and outliers count less (iterated reweighting). Shape (n,): `seen`, `noise`, `travel` since the last [rad],
    `friction_shape` [rad/(N·m)]; (n, k): one standard deviation of each of the `constants` [rad]. Prior standard
    deviations: `spread` of δ [rad], `friction` of r [N·m].
    """
    forget = float(np.exp(-smoothed.STEP * _TRACK / MEMORY))
    known = np.hypot(noise, friction * friction_shape)
    quiet = noise <= np.median(noise)
    weighted = noise
    beyond = np.zeros(_REWEIGHTED + 1)
    n, k = constants.shape
    smooth, innovations, variance, total = np.empty((k + 1, n)), np.empty((k + 1, n)), np.empty(n), np.empty(n)
    for i in range(_REWEIGHTED + 1):
        for row, column in enumerate((seen, *constants.T)):
            _track(
                np.ascontiguousarray(column), friction_shape, weighted**2, wander**2 * travel, spread**2, friction**2, forget,
                smooth[row], variance, innovations[row], total,
            )  # fmt: skip
        information = np.eye(k) + (innovations[1:] / total) @ innovations[1:].T
        c = np.linalg.solve(information, (innovations[1:] / total) @ innovations[0])
        zero = smooth[0] - c @ smooth[1:]
        left = seen - zero - constants @ c
        scatter = _ROBUST * float(np.median(np.abs(left[quiet])))
        beyond[i] = math.sqrt(max(scatter**2 - float(np.median(known[quiet])) ** 2, 0.0))
        if i < _REWEIGHTED:
            weighted = np.hypot(noise, beyond[i])
            weighted = weighted * np.maximum(np.abs(left) / (_OUTLIER * np.hypot(known, beyond[i])), 1.0)
    variance = variance + np.einsum("kn,kn->n", smooth[1:], np.linalg.solve(information, smooth[1:]))
    if beyond[-1] > _TORSION * float(np.median(known[quiet])):
        variance, wander = variance + beyond[-1] ** 2, math.hypot(wander, beyond[-1])
    return Tracked(zero, np.sqrt(np.maximum(variance, 0.0)), wander)


@kernel
def _wave_generator_torsion(torque, record):
    p = record[0]
    return np.array([laws.wave_generator_torsion(T / p.N, p) / p.N for T in torque])


@kernel
def _slow_friction(w, record):
    return np.array([slow_friction(x, record[0]) for x in w])


@kernel
def _track(seen, slope, noise, walk, zero_variance, friction_variance, forget, zero, variance, innovation, total):
    """Kalman filter and Rauch-Tung-Striebel smoother of two states. Write the zero and its variance into `zero`,
    `variance`, the filter's innovations and their variance into `innovation`, `total`.

    `slope`: of `seen` over the friction model's error; `noise`, `walk`: variances of `seen` and of the zero's steps;
    shape (n,).
    """
    n = len(seen)
    # Filtered and predicted: both states, and variance of the first, covariance, variance of the second.
    filtered, predicted = np.empty((n, 5)), np.empty((n, 5))
    d, r, a, b, c = 0.0, 0.0, zero_variance, 0.0, friction_variance
    for k in range(n):
        if k > 0:
            r, a, b = forget * r, a + walk[k], forget * b
            c = forget * forget * (c - friction_variance) + friction_variance
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
        # Gain of the smoother: P F over the prediction; an exactly known state stays.
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
