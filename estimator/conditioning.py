"""Conditioning of recordings: stamps, steps, repeated readings and noise are measured and corrected.

All users of a measured recording take it conditioned: with a current, with the times at which samples were taken, with
repeated readings filled in, and with the passband [Hz] up to which the motion may be differentiated twice.
docs/conditioning.md has a table of what is done.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from scipy.interpolate import CubicSpline

from ..models.joint import Joint
from ..models.joint_parts import AnalogSpec, EncoderSpec, Number
from ..models.motion import CUTOFF, SHARE
from ..models.recording import Recording
from ..models.signals import CHANNELS, POSITIONS
from .passband import highest
from .stamps import Clock, clock_times, off_motion, read_stamps, stretches

READ = ("motor_position", "link_position", "motor_current", "joint_torque", "external_torque")
"""Channels whose repeats and noise are measured."""
FEWEST = 200  # fewest changes of a reading for a statement on its steps
GRAVITY_ANGLE = 0.05  # standard deviation of the direction of gravity [rad], 3°: of zero points and the centre of mass
STRIBECK = 2.0  # least tolerance of a Stribeck velocity by rule, a factor of 3: no data sheet states it
_NEAR = 20  # largest change that is used [steps]
_OFF = 0.1  # largest deviation from a whole number of steps [steps]
_SHARE = 0.98  # least share of changes that are whole numbers of steps
_COARSER = 1.5  # times the described step
_SLOWER = 0.75  # of the described rate
_WENT_ON = 1.5  # motion per sample in which a fresh reading cannot repeat itself [steps]
_CREEPS = 0.25  # of the usual change of a sample: less is rest
_REGULAR = 0.9  # least share of intervals that are multiples of one, for a regular hold
_REPEATED = 0.02  # least share of repeats, of the samples in motion
_MOVING = 0.2  # of the rms speed


@dataclass(frozen=True)
class Quality:
    """Properties of one channel's readings; in its unit."""

    noise: float  # standard deviation of one reading's white noise in motion, counts included
    step: float  # of which all changes are multiples; 0 without steps
    rate: float  # of fresh readings [Hz]
    repeated: float  # share of the samples in motion that repeat an older reading
    delay: float  # as described [s]
    bandwidth: float  # [Hz]: of a described low-pass, or half of its rate


@dataclass(frozen=True)
class Conditioned:
    """A conditioned recording; n samples."""

    # with a current, with sample times, and without repeats; the times of its table are `recording.stamps`
    recording: Recording
    channels: Mapping[str, Quality]  # properties of its readings, by name
    stamps: Clock  # kind of its stamps
    passband: float  # up to which its motion may be differentiated twice [Hz]
    # fresh readings of a channel, shape (n,), bool, by name; only channels with repeats
    news: Mapping[str, np.ndarray] = field(default_factory=dict)
    done: tuple[str, ...] = ()  # the corrections, as sentences

    @cached_property
    def rate(self) -> float:
        """Sample rate [Hz]."""
        return 1.0 / self.recording.interval


def condition(recording: Recording, joint: Joint) -> Conditioned:
    """Condition a recording, which is not changed; the joint's numbers convert an acceleration to a current."""
    done: list[str] = []
    p = joint.record(recording.link)[0]
    columns = dict(recording.columns)
    if "motor_current" not in columns and "motor_torque" in columns:
        columns["motor_current"] = columns["motor_torque"] / p["Kt_drive"]
        done.append("motor_current is motor_torque over the drive's torque constant")
    ratio = float(p["N"])
    parts = [part for part in recording.segments if part.stop - part.start > 4]
    news: dict[str, np.ndarray] = {}
    repeated = dict.fromkeys(columns, 0.0)
    looked_at = stretches(parts)
    for name in (n for n in READ if n in columns):
        if news_of(columns[name], looked_at)[1] > _REPEATED:
            news[name], repeated[name] = news_of(columns[name], parts)
            share = repeated[name]
            done.append(
                f"{name}: {100 * share:.2g} % of the samples in motion repeat an older reading; they are filled in"
            )
    time = recording.time
    encoders = [name for name in POSITIONS if name in columns]
    for part in parts:  # before the stamps are judged
        for name in news:
            columns[name] = _filled(time, columns, name, news, ratio, part)
    floors = _floors(joint, encoders, columns)
    stamps = read_stamps(time, [columns[name] for name in encoders], parts, floors)
    if stamps.error:
        even = time.copy()
        mended = 0
        for part in parts:
            times = clock_times(time[part], [columns[name][part] for name in encoders])
            if times is not None:
                even[part] = times
                mended += part.stop - part.start
        if mended and np.all(np.diff(even) > 0):
            time = even
            left = read_stamps(time, [columns[name] for name in encoders], parts, floors)
            stamps = replace(left, kind=stamps.kind, found=stamps.error, tick=stamps.tick)
    if stamps.kind != "exact":
        done.append(stamps.text)
    if done:
        logged = recording.stamps if time is not recording.time else recording.logged
        recording = replace(recording, time=time, columns=columns, logged=logged)
    channels = {
        name: _channel(recording, name, parts, repeated[name], joint) for name in READ if name in recording.columns
    }
    slowest = min((c.rate, name) for name, c in channels.items() if name != "external_torque")
    noise = {name: channel.noise for name, channel in channels.items()}
    passband, loud = highest(recording, parts, noise, dict(zip(encoders, floors, strict=True)), SHARE * slowest[0], p)
    if loud:
        cause = f"stamps off by {1e3 * stamps.error:.2g} ms" if stamps.error else f"noise of {noise[loud]:.2g} rad"
        done.append(f"motion is differentiated up to {passband:.3g} Hz: above, {loud} is mostly noise ({cause})")
    elif passband < CUTOFF:
        done.append(f"motion is differentiated up to {passband:.3g} Hz: a quarter of the rate of {slowest[1]}")
    return Conditioned(recording, channels, stamps, passband, news, tuple(done))


def as_logged(joint: Joint, recordings: Sequence[Recording], wrong: Collection[str] = ()) -> Joint:
    """Return the joint with sensors as coarse as a log's readings, and with what nobody knows exactly about a joint.

    The torque of an arm's other links has the tolerance of the gravity moment, and the direction of gravity a deviation of
    `GRAVITY_ANGLE`, unless the description has its own. With one encoder, a Stribeck velocity that a rule of `joint new` filled
    has at least the tolerance `STRIBECK`.
    Columns in `wrong`, for example in another unit, are ignored.
    """
    changed: dict[str, Any] = {}
    for one in coarser(recordings, joint, wrong):
        channel = CHANNELS[one.column]
        spec = changed.get(channel.sensor, joint.sensors.of(channel))
        new: dict[str, Any] = {one.what: one.found}
        if isinstance(spec, EncoderSpec) and one.what == "step":
            new = {"counts": max(round(2 * np.pi / one.found), 2), "bits": None}
        changed[channel.sensor] = spec.model_copy(update=new)
    update: dict[str, Any] = {"sensors": joint.sensors.model_copy(update=changed)} if changed else {}
    gravity = joint.link_tolerances.get("gravity_moment")
    if gravity is not None and "arm" not in joint.link_tolerances and any(r.load is not None for r in recordings):
        arm = gravity.model_copy(update={"value": 1.0, "nominal": None, "std": None})
        update["link_tolerances"] = joint.link_tolerances | {"arm": arm}
    speed = joint.numbers["vs"]
    both = any(set(POSITIONS) <= set(r.columns) for r in recordings)
    if not both and speed.source.startswith("rule") and speed.std is None and speed.tolerance < STRIBECK:
        update["numbers"] = joint.numbers | {"vs": speed.model_copy(update={"tolerance": STRIBECK})}
    if joint.gravity_angle is None:
        source = "how well people know where zero and the load's centre of mass are"
        update["gravity_angle"] = Number(value=0.0, unit="rad", deviation=GRAVITY_ANGLE, source=source)
    return joint.model_copy(update=update) if update else joint


# --- steps and repeats -----------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Coarse:
    """A column that is coarser than described: its step [its unit], or rate of fresh readings [Hz]."""

    column: str
    what: str
    found: float
    described: float

    @property
    def text(self) -> str:
        """Description in words."""
        if self.what == "rate":
            return f"{self.column} is updated at {self.found:.4g} Hz, described: {self.described:.4g} Hz"
        was = f"{self.described:.3g}" if self.described else "none"
        return f"{self.column} comes in steps of {self.found:.3g} {CHANNELS[self.column].unit}, described: {was}"


def coarser(recordings: Sequence[Recording], joint: Joint, wrong: Collection[str] = ()) -> tuple[Coarse, ...]:
    """Return the columns that are coarser in all recordings than described, without those in `wrong`."""
    found = []
    for name in READ[:4]:
        there = [r for r in recordings if name in r and name not in wrong]
        spec = joint.sensors.of(CHANNELS[name])
        steps = [step_of(r[name]) for r in there]
        if not steps or not isinstance(spec, EncoderSpec | AnalogSpec):
            continue
        described = spec.resolution if isinstance(spec, EncoderSpec) else spec.step
        # Steps finer than an analog sensor's noise do not count.
        least = 0.0 if isinstance(spec, EncoderSpec) else spec.noise
        if min(steps) > max(_COARSER * described, least):
            found.append(Coarse(name, "step", min(steps), described))
        if isinstance(spec, EncoderSpec) or spec.noise:  # without noise a reading may stay the same
            shares = [
                news_of(r[name], stretches(r.segments))[1] for r in there if np.count_nonzero(np.diff(r[name])) > FEWEST
            ]
            rates = [(1 - share) / r.interval for share, r in zip(shares, there, strict=False)]
            if rates and min(shares) > _REPEATED and max(rates) < _SLOWER * spec.rate:
                found.append(Coarse(name, "rate", max(rates), spec.rate))
    return tuple(found)


def step_of(reading: np.ndarray) -> float:
    """Return the step of a reading, shape (n,), of which all its changes are multiples, in its unit; 0 without steps."""
    parts = stretches([slice(0, len(reading))])
    change = np.abs(np.concatenate([np.diff(reading[part]) for part in parts]))
    change = change[change > 1e-12 * max(float(np.ptp(reading)), 1e-300)]
    if len(change) < FEWEST:
        return 0.0
    step = float(np.percentile(change, 1))
    steps = change[change < _NEAR * step] / step
    whole = float(np.mean(np.abs(steps - np.round(steps)) < _OFF))
    return step if whole > _SHARE else 0.0


def news_of(reading: np.ndarray, parts: Sequence[slice]) -> tuple[np.ndarray, float]:
    """Return which samples are fresh, shape (n,), bool, and the share of repeats among the samples in motion.

    A reading stays the same at rest, and between two counts of a slow motion. If it then changes by more than a step
    per unchanged sample, these samples were old.
    """
    fresh, step = np.ones(len(reading), bool), step_of(reading)
    runs = []
    for part in parts:
        at = np.flatnonzero(np.diff(reading[part])) + 1  # first sample of each run
        if len(at) > 1:
            runs.append((part.start + at[:-1], np.diff(at), np.abs(np.diff(reading[part][at - 1]))))
    if sum(len(begin) for begin, _, _ in runs) < FEWEST:
        return fresh, 0.0
    begin, length, jump = (np.concatenate(x) for x in zip(*runs, strict=True))
    went = jump / length
    went_on = went > (_WENT_ON * step if step else _CREEPS * float(np.median(went)))
    if not went_on.any():
        return fresh, 0.0
    stale = went_on & (length > 1)
    for first, count in zip(begin[stale].tolist(), length[stale].tolist(), strict=True):
        fresh[first + 1 : first + count] = False
    moving, old = int(length[went_on].sum()), int((length[stale] - 1).sum())
    every = max(int(np.percentile(length[went_on], 5)), 1)
    if every > 1 and np.mean(length % every == 0) > _REGULAR:  # fresh at regular times, also in slow motion
        for part in parts:
            first = begin[(begin >= part.start) & (begin < part.stop)]
            if len(first):
                fresh[part] = (np.arange(part.start, part.stop) - first[0]) % every == 0
                fresh[part.start] = True
    return fresh, max(old - _by_chance(reading, parts, step), 0.0) / max(moving, 1)


def _by_chance(reading: np.ndarray, parts: Sequence[slice], step: float) -> float:
    """Return how many fresh samples equal the one before it in motion: half as many as differ from it by one step."""
    if not step:
        return 0.0
    number = 0
    for part in parts:
        change = np.abs(np.diff(reading[part])) / step
        number += int(np.count_nonzero((np.round(change[:-1]) == 1.0) & (change[1:] > 2 * _WENT_ON)))
    return 0.5 * number


def _filled(
    time: np.ndarray,
    columns: Mapping[str, np.ndarray],
    name: str,
    news: Mapping[str, np.ndarray],
    ratio: float,
    part: slice,
) -> np.ndarray:
    """Return a channel with its repeats filled in within a part: an encoder's with the other's motion, if that was
    read."""
    values, fresh = columns[name].copy(), news[name][part]
    other = next((o for o in POSITIONS if name in POSITIONS and o != name and o in columns), None)
    shared = np.zeros(part.stop - part.start)
    if other is not None and (other not in news or news[other].sum() > news[name].sum()):
        shared = columns[other][part] * (ratio if name == "motor_position" else 1 / ratio)
    t, own = time[part], values[part] - shared
    values[part] = np.where(fresh, values[part], shared + between(t, t[fresh], own[fresh]))
    return values


def between(time: np.ndarray, at: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Return values known at some times, at other times: the cubic spline through them, constant beyond its ends."""
    if len(at) < 4 or len(at) == len(time):
        return np.interp(time, at, values)
    return CubicSpline(at, values)(np.clip(time, at[0], at[-1]))


# --- noise ----------------------------------------------------------------------------------------------


def _floors(joint: Joint, encoders: Sequence[str], columns: Mapping[str, np.ndarray]) -> list[float]:
    """Return each encoder's noise in motion with an exact clock [rad rms]: of its counts, and as described."""
    specs = {"motor_position": joint.sensors.motor_encoder, "link_position": joint.sensors.link_encoder}
    steps = [max(step_of(columns[name]), specs[name].resolution) for name in encoders]
    return [float(np.hypot(q / np.sqrt(12), specs[name].noise)) for name, q in zip(encoders, steps, strict=True)]


def _channel(recording: Recording, name: str, parts: Sequence[slice], repeated: float, joint: Joint) -> Quality:
    rate = (1 - repeated) / recording.interval
    spec = joint.sensors.of(CHANNELS[name]) if CHANNELS[name].sensor else None
    low = getattr(spec, "bandwidth", None)
    return Quality(
        noise=_noise(recording, name, parts),
        step=step_of(recording[name]),
        rate=rate,
        repeated=repeated,
        delay=float(getattr(spec, "delay", 0.0)),
        bandwidth=min(0.5 * rate, low if low else np.inf),
    )


def _noise(recording: Recording, name: str, parts: Sequence[slice]) -> float:
    """Return the standard deviation of a channel's white noise where an encoder moves."""
    position = next(n for n in POSITIONS if n in recording)
    found = []
    for part in stretches(parts):
        off, _ = off_motion(recording.time[part], recording[name][part])
        speed = np.abs(np.gradient(recording[position][part], recording.time[part])[2:-2])
        found.append(off[speed > _MOVING * np.sqrt(np.mean(speed**2))])
    off = np.concatenate(found) if found else np.zeros(0)
    if not len(off):
        return 0.0
    off **= 2
    return float(np.sqrt(np.mean(np.minimum(off, 36 * np.median(off) + 1e-300))))
