"""Summarise a measurement, and find which causes it can show, without a fit.

The rules concern motion and channels only (reversals, travel, load). A diagnosis decides which causes are confounded. The
requirements of a cause are in `models.causes` (`needs`, `requires`, `torsion`), or follow from the laws.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence, Set
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import maximum_filter1d, minimum_filter1d

from ...estimator.conditioning import Conditioned, condition
from ...estimator.stamps import off_motion, stretches
from ...models import causes, dynamics
from ...models.causes import Cause
from ...models.dynamics import State
from ...models.joint import Joint
from ...models.motion import smooth
from ...models.recording import Measurement, Recording
from ...models.signals import POSITIONS, SENSED
from .segments import DECIMATION, SETTINGS, STEP, undisturbed

SLIDING = 2.5
"""Stribeck velocities above which the mesh slides."""
SLOWEST = 10.0
"""Rate [Hz] of a log below which nothing can show."""
TORSION_RATE, INERTIA_RATE = 50.0, 20.0
"""Rates [Hz] below which a log shows no torsion and no resonance, and no inertia: their passband is a quarter."""
_REVERSAL = 0.6  # rad of the rotor that a change of direction must last to count
_AGREED = 0.05  # by which a drive's torque may differ from its torque constant times the current
_LOUD, _VISIBLE = (
    5.0,
    0.15,
)  # times the described noise, and share of the readings, from which a sensor's noise is named
_FAST, _MANY = 100.0, 200  # Hz and samples, below which motion looks like noise
_ABOVE_NOISE = 3.0  # noises of the current above which it is held against the drive's torque
_CLIPPED = 0.995  # of the current limit
_BLOCK = 1 << 16  # samples that are smoothed, or made Python's numbers, at a time
_RESTING = 0.04  # s before and after, in which a rotor that is at rest stays where it is
_FEWEST = 10  # samples of a segment whose motion can be smoothed
_TURN = 2 * np.pi
_DRIVE = ("motor_current", "motor_torque")


@dataclass(frozen=True)
class RecordingSummary:
    """Summary of one recording.

    Attributes:
      name: of the recording; samples, duration [s], interval (median) [s].
      jitter: rms of the intervals' deviation from it, without missing samples [s].
      late: error of the time stamps according to the encoders [s rms]; zero if unknown.
      passband: up to which its motion may be differentiated twice [Hz].
      done: corrections of the conditioning, as sentences.
      missing: single samples that are missing; gaps: longer ones, begin and end [s].
      ranges: smallest and largest value by channel.
      motor_speed, link_speed: largest [rad/s]; of an encoder that is not there, by the gear ratio.
      sliding: share of the time in which the mesh slides.
      reversals: changes of direction that last.
      forward, backward: travel of the rotor in each direction [rad].
      load: smallest and largest joint torque [N·m], as measured, or else as the drive's reading asks for.
      load_measured: whether there was a joint torque sensor.
      clipped: share of samples at the current limit; None without motor current.
    """

    name: str
    samples: int
    duration: float
    interval: float
    jitter: float
    late: float
    passband: float
    done: tuple[str, ...]
    missing: int
    gaps: tuple[tuple[float, float], ...]
    ranges: dict[str, tuple[float, float]]
    motor_speed: float
    link_speed: float
    sliding: float
    reversals: int
    forward: float
    backward: float
    load: tuple[float, float]
    load_measured: bool
    clipped: float | None


@dataclass(frozen=True)
class Balance:
    """A torque balance that can be formed.

    Attributes:
      name: of the residual that it leaves, as in a diagnosis; description: what is held against what.
      recordings: names of those that have it.
    """

    name: str
    description: str
    recordings: tuple[str, ...]


def summarise(recording: Recording, joint: Joint, conditioned: Conditioned | None = None) -> RecordingSummary:
    """Summarise a recording of a joint, with any channels; `conditioned`: the same recording, if it is available."""
    time = recording.time
    conditioned = conditioned or condition(recording, joint)
    interval = recording.interval
    inside, there, jitter = _steps(time, interval, recording.gap)
    N = joint.numbers["N"].value
    rotor, link = _positions(recording, N)
    w = np.abs(_velocity(recording, rotor))
    motor_speed, sliding = float(w.max()), float(np.mean(w > SLIDING * joint.numbers["vs"].value))
    del w  # of an hour, 30 MB
    link_speed = float(np.abs(_velocity(recording, link)).max())
    load = np.percentile(_load(recording, joint), (0.5, 99.5))
    # What happens within a gap is unknown.
    turns = [_turning_points(rotor[part]) for part in recording.segments]
    travel = [np.diff(rotor[part]) for part in recording.segments]
    current = recording.columns.get("motor_current")
    limit = joint.numbers["current_limit"].value
    return RecordingSummary(
        name=recording.name,
        samples=len(time),
        duration=float(time[-1] - time[0]),
        interval=interval,
        jitter=jitter,
        late=max(conditioned.stamps.found, conditioned.stamps.error),
        passband=conditioned.passband,
        done=conditioned.done,
        missing=max(round(inside / interval) - there, 0),
        gaps=recording.gaps,
        ranges={name: (float(x.min()), float(x.max())) for name, x in recording.columns.items()},
        motor_speed=motor_speed,
        link_speed=link_speed,
        sliding=sliding,
        reversals=sum(max(len(points) - 2, 0) for points in turns),
        forward=float(sum(x[x > 0].sum() for x in travel)),
        backward=float(sum(-x[x < 0].sum() for x in travel)),
        load=(float(load[0]), float(load[1])),
        load_measured="joint_torque" in recording,
        clipped=None if current is None else float(np.mean(np.abs(current) >= _CLIPPED * limit)),
    )


def _steps(time: np.ndarray, interval: float, gap: float) -> tuple[float, int, float]:
    """Return sum [s] and number of the intervals without gaps, and the rms jitter [s] of those without missing samples."""
    steps = np.diff(time)
    steps = steps[steps <= gap]
    whole, count = float(steps.sum()), len(steps)
    steps = steps[steps < 1.6 * interval]
    steps -= interval
    steps *= steps
    return whole, count, float(np.sqrt(np.mean(steps))) if len(steps) else 0.0


def missing_columns(measurement: Measurement) -> list[str]:
    """Channels that sensors read and that no recording has."""
    return [name for name in SENSED if all(name not in r for r in measurement.recordings)]


def balances(measurement: Measurement) -> tuple[Balance, ...]:
    """Return the torque balances of the channels, without duplicates.

    With one encoder, recordings with unmeasured pushes are skipped if there are others.
    """
    found: dict[tuple[str, str], list[str]] = {}
    for recording in undisturbed(measurement.recordings):
        for key in _balances(recording):
            found.setdefault(key, []).append(recording.name)
    return tuple(Balance(name, description, tuple(names)) for (name, description), names in found.items())


def _balances(recording: Recording) -> Iterator[tuple[str, str]]:
    """Yield name and description of a recording's balances; none of the link with unknown loads, as in `segments`."""
    drive = next((name for name in _DRIVE if name in recording), None)
    said = None if drive is None else drive.replace("_", " ")
    sensor = "joint_torque" in recording
    alone = recording.external != "unmeasured" and recording.load is None
    if all(name in recording for name in POSITIONS):
        if said is not None:
            yield "motor_current", f"{said} against rotor, friction and what the torsion transmits"
        if sensor:
            yield "joint_torque", "joint torque against the torsion between both encoders"
        if alone:
            held = "joint torque" if sensor else "torsion between both encoders"
            yield "link_balance", f"{held} against the link's inertia and gravity"
    else:
        if said is not None:
            yield "motor_current", f"{said} against rotor, friction and link together"
        if sensor and (alone or "link_position" not in recording):
            name = "link_balance" if "link_position" in recording else "joint_torque"
            yield name, "joint torque against the link's inertia and gravity"


def too_little(measurement: Measurement, joint: Joint) -> str | None:
    """Return why no cause can show: slow log, short segments or no motion; None if causes can show."""
    samples, seconds = SETTINGS.shortest
    fastest = 1 / min(r.interval for r in measurement.recordings)
    if fastest < SLOWEST:
        return f"the log is slower than {SLOWEST:g} Hz ({fastest:.2g} samples a second), too slow for a diagnosis"
    parts = [
        (recording, part)
        for recording in measurement.recordings
        for part in recording.segments
        if part.stop - part.start >= samples and recording.time[part.stop - 1] - recording.time[part.start] >= seconds
    ]
    if not parts:
        return f"no part without gaps has {samples} samples and {seconds:g} s"
    if any(_moves(recording, part, joint) for recording, part in parts):
        return None
    return "nothing moves"


def _moves(recording: Recording, part: slice, joint: Joint) -> bool:
    """Return whether the rotor moves in a part, as a diagnosis defines it; with a locked output it winds up the gear."""
    rotor = _positions(recording, joint.numbers["N"].value)[0][part]
    travel = float(np.ptp(rotor))
    if recording.link.locked or travel >= SETTINGS.settle_travel or travel < SETTINGS.rest_travel:
        return travel >= SETTINGS.rest_travel
    window = 2 * round(_RESTING / recording.interval) + 1
    return bool((maximum_filter1d(rotor, window) - minimum_filter1d(rotor, window)).max() >= SETTINGS.rest_travel)


def torque_over_current(recording: Recording, joint: Joint) -> float | None:
    """Return the drive's torque over its torque constant times the current, if significantly different from 1; else None."""
    if not all(name in recording for name in _DRIVE):
        return None
    believed = float(joint.record(recording.link)[0]["Kt_drive"])
    torque, expected = recording["motor_torque"], believed * recording["motor_current"]
    noise = believed * joint.sensors.motor_current.noise
    power = float(np.mean(expected**2))
    if power <= (_ABOVE_NOISE * noise) ** 2:
        return None
    ratio = float(np.mean(torque * expected)) / (power - noise**2)
    rest = float(np.sqrt(np.mean((torque - ratio * expected) ** 2) / (len(torque) * power)))
    return ratio if abs(ratio - 1) > _AGREED + 3 * rest else None


def louder(recording: Recording, joint: Joint) -> str:
    """Return in words that a torque sensor has noise far above the described one and visible in its readings; else empty."""
    if "joint_torque" not in recording or recording.interval * _FAST > 1.0:
        return ""
    reading, described = recording["joint_torque"], joint.sensors.joint_torque.noise
    off = np.concatenate([off_motion(recording.time[p], reading[p])[0] for p in stretches(recording.segments)])
    # The median ignores jumps of stick-slip.
    noise = 1.4826 * float(np.median(np.abs(off))) if len(off) > _MANY else 0.0
    if noise <= max(_LOUD * described, _VISIBLE * float(np.std(reading))):
        return ""
    return f"joint_torque has a noise of {noise:.2g} N·m rms, described: {described:.2g}: is the sensor or its cable damaged?"


def undetermined(
    measurement: Measurement, joint: Joint, summaries: Sequence[RecordingSummary] | None = None
) -> dict[str, str]:
    """Return the causes that a measurement cannot show at ordinary size, each with a reason.

    Args:
      summaries: of the recordings, if available.
    """
    found = _Extent.of(measurement, joint, summaries or [summarise(r, joint) for r in measurement.recordings])
    nothing = too_little(measurement, joint)
    reasons: dict[str, str] = {}
    for name in causes.of(joint):
        reason = next(_lacking(causes.get(name), found, nothing), None)
        if reason is not None:
            reasons[name] = reason
    return reasons


def can_show(name: str, measurement: Measurement, link_measured: bool) -> bool:
    """Return whether a cause can show in the channels of a measurement, for any motion.

    Args:
      name: of the cause.
      measurement: whose recordings have the channels.
      link_measured: whether some recording has both encoders.
    """
    columns = {column for r in measurement.recordings for column in r.columns}
    cause = causes.get(name)
    arm = any(r.load is not None for r in measurement.recordings)
    return shows_in(cause, columns, link_measured, arm) and next(_too_slow(cause, _rate(measurement)), None) is None


def shows_in(cause: Cause, columns: Set[str], both_encoders: bool, arm: bool = False) -> bool:
    """Return whether a cause can show in these channels, with or without both encoders in one recording."""
    return (arm or not cause.requires.arm) and next(_hidden_from(cause, columns, both_encoders), None) is None


def _rate(measurement: Measurement) -> float:
    """Of its fastest recording [Hz]."""
    return 1 / min(r.interval for r in measurement.recordings)


def _too_slow(cause: Cause, rate: float, passband: float = np.inf) -> Iterator[str]:
    """Yield why a cause cannot show at a sample rate [Hz] and passband [Hz]."""
    if cause.resonance and passband < TORSION_RATE / 4:
        yield f"the motion is known up to {passband:.2g} Hz, no resonance is slower"
    if (cause.torsion or cause.resonance) and rate < TORSION_RATE:
        yield f"{rate:.3g} samples a second do not show torsion, it takes {TORSION_RATE:g}"
    if {"Jm", "Jl"} & {*cause.sets.values(), *cause.scales} and rate < INERTIA_RATE:
        yield f"{rate:.3g} samples a second do not show inertia, it takes {INERTIA_RATE:g}"


def _hidden_from(cause: Cause, columns: Set[str], both_encoders: bool) -> Iterator[str]:
    """Yield why a cause cannot show in these channels."""
    for column in cause.needs:
        if column not in columns:
            yield f"there is no column {column}"
    if cause.torsion and not both_encoders:
        yield "it affects the torsion, which one encoder does not measure"
    # A torque sensor shows loads of the link.
    weighed = cause.component == "link" and "joint_torque" in columns
    if cause.behind_link_encoder and not both_encoders and "motor_position" not in columns and not weighed:
        yield cause.behind_link_encoder


@dataclass(frozen=True)
class _Extent:
    """What a measurement offers for the requirements of causes (`models.causes.base.Requirements`)."""

    joint: Joint
    rate: float
    passband: float
    columns: frozenset[str]
    both_encoders: bool
    sliding: float
    reversals: int
    motor_turn: float
    link_travel: float
    highest: float
    load_span: float
    speed: float
    duration: float
    temperature_span: float
    known_push: bool
    gravity: bool
    arm: bool
    weighed: bool

    @classmethod
    def of(cls, measurement: Measurement, joint: Joint, summaries: Sequence[RecordingSummary]) -> _Extent:
        recordings = measurement.recordings
        N, rated = joint.numbers["N"].value, joint.numbers["rated_torque"].value
        ends = [_link_range(s, N) for s in summaries]
        turns = [_rotor_range(s, N) for s in summaries]
        warm = [s.ranges["temperature"] for s in summaries if "temperature" in s.ranges]
        known = [
            r for r in recordings if r.external != "unmeasured" and (r.load is None or "joint_torque" in r.columns)
        ]
        return cls(
            joint=joint,
            rate=_rate(measurement),
            passband=max(s.passband for s in summaries),
            columns=frozenset(name for r in recordings for name in r.columns),
            both_encoders=any(all(name in r for name in POSITIONS) for r in recordings),
            sliding=sum(s.sliding * s.duration for s in summaries),
            reversals=sum(s.reversals for s in summaries),
            motor_turn=max(high - low for low, high in turns) / _TURN,
            link_travel=max(high - low for low, high in ends),
            highest=max(high for _, high in ends),
            load_span=(max(s.load[1] for s in summaries) - min(s.load[0] for s in summaries)) / rated,
            speed=max(s.motor_speed for s in summaries) / joint.numbers["vs"].value,
            duration=max(s.duration for s in summaries),
            temperature_span=max(high for _, high in warm) - min(low for low, _ in warm) if warm else 0.0,
            known_push=bool(known),
            gravity=any(r.link.gravity_moment > 0 for r in known),
            weighed=any(r.load is None or not r.columns.keys().isdisjoint(_DRIVE) for r in recordings),
            arm=any(r.load is not None for r in recordings),
        )


def _lacking(cause: Cause, found: _Extent, nothing: str | None) -> Iterator[str]:
    """Yield why a cause cannot show, the simplest reason first; `nothing`: reason for all causes (`too_little`)."""
    yield from _hidden_from(cause, found.columns, found.both_encoders)
    if nothing is not None:
        yield nothing
    yield from _too_slow(cause, found.rate, found.passband)
    if not found.columns.intersection(_DRIVE) and in_drive_alone(cause, found.joint, found.both_encoders):
        yield "it affects the motor current alone, which is missing"
    if "Jm" in {*cause.sets.values(), *cause.scales} and "motor_position" in found.columns:
        louder = shaken(found.joint)
        if louder > _SHAKEN:
            yield f"the acceleration's noise from the motor encoder's counts is {louder:.2g} times the current's noise"
    needed = cause.requires
    if found.sliding < needed.sliding:
        yield f"the gear slides for {found.sliding:.2g} s, less than {needed.sliding:g} s"
    if needed.reversal and found.reversals == 0:
        yield "the motion never reverses"
    if found.motor_turn < needed.motor_turn:
        yield f"the motor makes {found.motor_turn:.2g} turns, less than {needed.motor_turn:g}"
    if found.link_travel < needed.link_travel:
        yield f"the link turns {found.link_travel:.2g} rad, less than {needed.link_travel:g} rad"
    if found.highest < needed.link_beyond:
        yield f"the link goes no further than {found.highest:.2g} rad, not beyond {needed.link_beyond:g} rad"
    if found.load_span < needed.load_span:
        yield f"the load spans {100 * found.load_span:.2g} % of the rated torque, less than {100 * needed.load_span:g} %"
    if found.speed < needed.speed:
        yield f"the motor goes no faster than {found.speed:.2g} times the Stribeck velocity, it takes {needed.speed:g}"
    if found.duration < needed.duration:
        yield f"the longest recording takes {found.duration:.2g} s, less than {needed.duration:g} s"
    if found.temperature_span < needed.temperature_span:
        yield f"the temperature changes by {found.temperature_span:.2g} K, less than {needed.temperature_span:g} K"
    if needed.known_push and not found.known_push:
        yield "in every recording unmeasured pushes may happen, or other joints of the arm move without a torque sensor"
    if needed.weighed and not found.weighed:
        yield "the torque can be compared with the arm's mass model alone, which may be as wrong"
    if needed.arm and not found.arm:
        yield "no recording is of an arm whose other joints move"
    if needed.gravity and not found.gravity:
        yield "no recording without unmeasured pushes, the arm's other joints still, has a gravity moment"


_SHAKEN = 1.5
"""Ratio to the current's noise beyond which counts hide a rotor's inertia: the drive reacts to them, which biases a fit. With a
ratio of 3.4, an inertia 2.1 to 3.3 times as large was found in none of six draws; with 1.2 in three of three."""
_SEEN = 0.5 / (STEP * DECIMATION)
"""Frequency [Hz] up to which residuals see an acceleration."""


def shaken(joint: Joint) -> float:
    """Return the rotor acceleration's noise, as a current, over the current's noise; 0 if none is described.

    The second derivative of an angle's white noise up to a frequency F is (2πF)²/√5 times as large.
    """
    sensors = joint.sensors
    if not sensors.motor_current.noise:
        return 0.0
    angle = math.hypot(sensors.motor_encoder.resolution / math.sqrt(12), sensors.motor_encoder.noise)
    current = joint.numbers["Jm"].value / joint.numbers["Kt"].value * angle * (2 * math.pi * _SEEN) ** 2 / math.sqrt(5)
    return current / sensors.motor_current.noise


_READ = 0.1
"""Resolution of many samples in motion, in encoder counts. On the test joint, without a current, friction that winds it up by 0.2
to 0.7 counts was found in 14 of 14 draws."""
_DRAWS = 3  # of a cause, as one may have no effect
_TRIED = (
    State(3.0, 40.0, 2.99, 40.0, 0.9, 0.4, 1e-3, 2e-5, 0.5, 4.0, 35.0),
    State(-95.0, -25.0, -95.02, -25.0, -1.1, -0.25, -1e-3, -3e-5, -0.7, 7.0, 45.0),
)
"""States that show the changes of a cause: sliding in both directions, loaded, warm, far from zero."""


def in_drive_alone(cause: Cause, joint: Joint, both_encoders: bool = True) -> bool:
    """Return whether a cause affects the motor current alone: motor causes, and friction with one encoder.

    With both encoders, friction changes the wind-up of the wave generator.
    """
    rng = np.random.default_rng(0)
    before = joint.record()
    p = before[0]
    counts = joint.sensors.motor_encoder.resolution + p["N"] * joint.sensors.link_encoder.resolution
    drive = False
    for _ in range(_DRAWS):
        after = before.copy()
        cause.apply(after[0], cause.draw(p, rng))
        q = after[0]
        if any(p[name] != q[name] for name in ("Jl", "link_delay", "flexible_share")):
            return False
        for state in _TRIED:
            if not np.allclose(_other_readings(state, p), _other_readings(state, q), rtol=1e-9, atol=0.0):
                return False
            if both_encoders and abs(_rotor_position(state, q) - _rotor_position(state, p)) > _READ * counts:
                return False
            drive = drive or not np.isclose(_in_the_drive(state, p), _in_the_drive(state, q), rtol=1e-9, atol=0.0)
    return drive


def _other_readings(state: State, p: np.void) -> list[float]:
    """Return torsion torque, link torque, and readings of encoders and torque sensor in a state."""
    t = dynamics.transmission(state, p)
    return [
        t.flexspline_torque, dynamics.link_torque(state, t.load, p), dynamics.read_motor_position(state, p),
        dynamics.read_link_position(state, t.load, p), dynamics.read_joint_torque(t.flexspline_torque, state, t.load, p),
    ]  # fmt: skip


def _rotor_position(state: State, p: np.void) -> float:
    """Return the rotor angle [rad] in a steady motion of the link, with wind-up under load and friction."""
    motor, _, _ = dynamics.steady_motion(
        state.link_position, state.link_velocity, 0.0, 0.0, state.time, state.temperature, p
    )
    return motor


def _in_the_drive(state: State, p: np.void) -> float:
    """Return the drive's transmitted torque in a state, from the measured current."""
    load = dynamics.transmission(state, p).load
    current = dynamics.actual_motor_current(
        state.motor_current, state.motor_position, state.link_position, state.motor_velocity, load, state.time, p
    )
    sliding = dynamics.sliding_friction(state, load, p)
    return dynamics.transmitted_torque(state._replace(motor_current=current), 100.0, sliding, load, p)


def _positions(recording: Recording, N: float) -> tuple[np.ndarray, np.ndarray]:
    """Return rotor and link angle [rad], shape (n,) each; a missing one by the gear ratio."""
    motor, link = (recording.columns.get(name) for name in POSITIONS)
    rotor = motor if motor is not None else N * recording["link_position"]
    return rotor, link if link is not None else rotor / N


def _link_range(s: RecordingSummary, N: float) -> tuple[float, float]:
    if "link_position" in s.ranges:
        return s.ranges["link_position"]
    low, high = s.ranges["motor_position"]
    return low / N, high / N


def _rotor_range(s: RecordingSummary, N: float) -> tuple[float, float]:
    if "motor_position" in s.ranges:
        return s.ranges["motor_position"]
    low, high = s.ranges["link_position"]
    return N * low, N * high


def _load(recording: Recording, joint: Joint) -> np.ndarray:
    """Return the joint torque [N·m], shape (n,): measured, or of the drive without friction."""
    if "joint_torque" in recording:
        return recording["joint_torque"]
    N, Kt = joint.numbers["N"].value, joint.numbers["Kt"].value
    if "motor_current" in recording:  # takes precedence
        return N * Kt * recording["motor_current"]
    return N * recording["motor_torque"]


def _velocity(recording: Recording, position: np.ndarray) -> np.ndarray:
    """Return the velocity of a position, shape (n,) [rad/s]; zero in segments that are too short to smooth."""
    v = np.zeros(len(position))
    pieces = (
        slice(b, min(b + _BLOCK, part.stop))
        for part in recording.segments
        for b in range(part.start, part.stop, _BLOCK)
    )
    for part in pieces:
        if part.stop - part.start < _FEWEST:
            continue
        time = recording.time[part]
        s = smooth(time, position[part, None], max(2e-3, 0.5 * float(np.median(np.diff(time)))), 20.0)
        v[part] = np.interp(time, s.time, s.rate[:, 0])
    return v


def _turning_points(position: np.ndarray) -> list[float]:
    """Return turning points of a motion, with both ends; moves shorter than `_REVERSAL` do not count."""
    points = [float(position[0])]
    extreme, direction = float(position[0]), 0
    for x in (x for begin in range(0, len(position), _BLOCK) for x in position[begin : begin + _BLOCK].tolist()):
        if direction == 0:
            if abs(x - points[0]) > _REVERSAL:
                direction, extreme = (1 if x > points[0] else -1), x
        elif (x - extreme) * direction > 0:
            extreme = x
        elif (extreme - x) * direction > _REVERSAL:
            points.append(extreme)
            direction, extreme = -direction, x
    return [*points, extreme] if direction else points
