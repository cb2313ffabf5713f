"""Summarise a measurement, and find which causes it can show, without a fit.

The rules concern motion and channels only (reversals, travel, load). A diagnosis decides which causes are confounded. The
requirements of a cause are in `models.causes` (`needs`, `requires`, `torsion`), or follow from the laws.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence, Set
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
from ...models.signals import CHANNELS, POSITIONS, SENSED
from .segments import DECIMATION, SETTINGS, STEP, undisturbed

SLIDING = 2.5
"""Stribeck velocities above which the mesh slides."""
SLOWEST = 10.0
"""Rate [Hz] of a log below which nothing can show."""
TORSION_RATE, INERTIA_RATE = 50.0, 20.0
"""Rates [Hz] below which a log shows no torsion and no resonance, and no inertia: their passband is a quarter."""
_REVERSAL = 0.6  # rad of the rotor that a change of direction must last to count
AGREED = 0.05  # by which a drive's torque may differ from its torque constant times the current
# Times the described noise, and share of the readings, from which a sensor's noise is named.
_LOUD, _VISIBLE = 5.0, 0.15
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
    """Summary of one recording."""

    name: str
    samples: int
    duration: float  # [s]
    interval: float  # median [s]
    jitter: float  # rms of the intervals' deviation from it, without missing samples [s]
    late: float  # error of the time stamps according to the encoders [s rms]; zero if unknown
    passband: float  # up to which its motion may be differentiated twice [Hz]
    done: tuple[str, ...]  # corrections of the conditioning, as sentences
    missing: int  # single samples
    gaps: tuple[tuple[float, float], ...]  # begin and end [s]
    ranges: dict[str, tuple[float, float]]  # smallest and largest value by channel
    motor_speed: float  # largest [rad/s]; without the encoder, by the gear ratio
    link_speed: float  # likewise
    sliding: float  # share of the time in which the mesh slides
    reversals: int  # changes of direction that last
    forward: float  # travel of the rotor [rad]
    backward: float  # likewise
    load: tuple[float, float]  # smallest and largest joint torque [N·m]: measured, or from the drive's reading
    load_measured: bool  # by a joint torque sensor
    clipped: float | None  # share of samples at the current limit; None without motor current


@dataclass(frozen=True)
class Balance:
    """A torque balance that can be formed."""

    name: str  # of its residual, as in a diagnosis
    description: str  # what is compared
    recordings: tuple[str, ...]  # names of those that have it


def summarise(recording: Recording, joint: Joint, conditioned: Conditioned | None = None) -> RecordingSummary:
    """Summarise a recording of a joint, with any channels; `conditioned`: the same recording, if it is available."""
    time = recording.time
    conditioned = conditioned or condition(recording, joint)
    interval = recording.interval
    steps = np.diff(time)
    steps = steps[steps <= recording.gap]
    off = steps[steps < 1.6 * interval] - interval  # without missing samples
    N = joint.numbers["N"].value
    rotor, link = _positions(recording.columns, N)
    speed = np.abs(_velocity(recording, rotor))
    motor_speed, sliding = float(speed.max()), float(np.mean(speed > SLIDING * joint.numbers["vs"].value))
    del speed  # of an hour, 30 MB
    load = np.percentile(_load(recording, joint), (0.5, 99.5))
    # What happens within a gap is unknown.
    parts = [rotor[part] for part in recording.segments]
    travel = [np.diff(part) for part in parts]
    current = recording.columns.get("motor_current")
    limit = joint.numbers["current_limit"].value
    return RecordingSummary(
        name=recording.name,
        samples=len(time),
        duration=float(time[-1] - time[0]),
        interval=interval,
        jitter=float(np.sqrt(np.mean(off**2))) if len(off) else 0.0,
        late=max(conditioned.stamps.found, conditioned.stamps.error),
        passband=conditioned.passband,
        done=conditioned.done,
        missing=max(round(float(steps.sum()) / interval) - len(steps), 0),
        gaps=recording.gaps,
        ranges={name: (float(x.min()), float(x.max())) for name, x in recording.columns.items()},
        motor_speed=motor_speed,
        link_speed=float(np.abs(_velocity(recording, link)).max()),
        sliding=sliding,
        reversals=sum(map(_reversals, parts)),
        forward=float(sum(x[x > 0].sum() for x in travel)),
        backward=float(sum(-x[x < 0].sum() for x in travel)),
        load=(float(load[0]), float(load[1])),
        load_measured="joint_torque" in recording,
        clipped=None if current is None else float(np.mean(np.abs(current) >= _CLIPPED * limit)),
    )


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
    sensor = "joint_torque" in recording
    alone = recording.external != "unmeasured" and recording.load is None
    both = all(name in recording for name in POSITIONS)
    for drive in [name for name in _DRIVE if name in recording][:1]:
        others = "what the torsion transmits" if both else "link together"
        yield "motor_current", f"{drive.replace('_', ' ')} against rotor, friction and {others}"
    if both and sensor:
        yield "joint_torque", "joint torque against the torsion between both encoders"
    if both and alone:
        held = "joint torque" if sensor else "torsion between both encoders"
        yield "link_balance", f"{held} against the link's inertia and gravity"
    if not both and sensor and (alone or "link_position" not in recording):
        name = "link_balance" if "link_position" in recording else "joint_torque"
        yield name, "joint torque against the link's inertia and gravity"


def too_little(measurement: Measurement, joint: Joint) -> str | None:
    """Return why no cause can show: slow log, short segments or no motion; None if causes can show."""
    samples, seconds = SETTINGS.shortest
    fastest = _rate(measurement)
    if fastest < SLOWEST:
        return f"the log is slower than {SLOWEST:g} Hz ({fastest:.2g} samples a second), too slow for a diagnosis"
    parts = [
        (r, part) for r in measurement.recordings for part in r.segments
        if part.stop - part.start >= samples and r.time[part.stop - 1] - r.time[part.start] >= seconds
    ]  # fmt: skip
    if not parts:
        return f"no part without gaps has {samples} samples and {seconds:g} s"
    return None if any(_moves(recording, part, joint) for recording, part in parts) else "nothing moves"


def _moves(recording: Recording, part: slice, joint: Joint) -> bool:
    """Return whether the rotor moves in a part, as a diagnosis defines it; with a locked output it winds up the gear."""
    rotor = _positions(recording.columns, joint.numbers["N"].value)[0][part]
    travel = float(np.ptp(rotor))
    if not recording.link.locked and SETTINGS.rest_travel <= travel < SETTINGS.settle_travel:
        window = 2 * round(_RESTING / recording.interval) + 1
        travel = float((maximum_filter1d(rotor, window) - minimum_filter1d(rotor, window)).max())
    return travel >= SETTINGS.rest_travel


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
    return ratio if abs(ratio - 1) > AGREED + 3 * rest else None


def noisy_sensors(recording: Recording, joint: Joint) -> Iterator[str]:
    """Yield in words the sensors of torque and current that have noise far above the described one and visible in their readings.

    A joint that vibrates has a real current that looks like noise: its encoders have it, too.
    """
    if recording.interval * _FAST > 1.0:
        return

    def noise(column: str) -> float:
        reading = recording[column]
        off = np.concatenate([off_motion(recording.time[p], reading[p])[0] for p in stretches(recording.segments)])
        # The median ignores jumps of stick-slip.
        return 1.4826 * float(np.median(np.abs(off))) if len(off) > _MANY else 0.0

    s = joint.sensors
    encoders = {"motor_position": s.motor_encoder, "link_position": s.link_encoder}
    vibrates = any(
        noise(name) > _LOUD * math.hypot(spec.noise, spec.resolution)
        for name, spec in encoders.items()
        if name in recording
    )
    for column, described in (("joint_torque", s.joint_torque.noise), ("motor_current", s.motor_current.noise)):
        if column not in recording or (vibrates and column == "motor_current"):
            continue
        found = noise(column)
        if found > max(_LOUD * described, _VISIBLE * float(np.std(recording[column]))):
            yield (
                f"{column} has a noise of {found:.2g} {CHANNELS[column].unit} rms, described: {described:.2g}: is the sensor or "
                "its cable damaged?"
            )


def undetermined(
    measurement: Measurement, joint: Joint, summaries: Sequence[RecordingSummary] | None = None
) -> dict[str, str]:
    """Return the causes that a measurement cannot show at ordinary size, each with a reason."""
    summaries = summaries or [summarise(r, joint) for r in measurement.recordings]
    columns = {name for r in measurement.recordings for name in r.columns}
    both = any(all(name in r for name in POSITIONS) for r in measurement.recordings)
    rate, passband = _rate(measurement), max(s.passband for s in summaries)
    nothing, offered = too_little(measurement, joint), _offered(measurement, joint, summaries)

    def lacking(cause: Cause) -> Iterator[str]:  # the simplest reason first
        yield from _hidden_from(cause, columns, both)
        if nothing is not None:
            yield nothing
        yield from _too_slow(cause, rate, passband)
        if columns.isdisjoint(_DRIVE) and in_drive_alone(cause, joint, both):
            yield "it affects the motor current alone, which is missing"
        if "Jm" in {*cause.sets.values(), *cause.scales} and "motor_position" in columns:
            louder = shaken(joint)
            if louder > _SHAKEN:
                yield f"the acceleration's noise from the motor encoder's counts is {louder:.2g} times the current's noise"
        for name, text in _REQUIRED.items():
            has, needed = offered[name], getattr(cause.requires, name)
            if has < needed:
                yield text.format(has, needed, 100 * has, 100 * needed)

    reasons = {name: next(lacking(causes.get(name)), None) for name in causes.of(joint)}
    return {name: reason for name, reason in reasons.items() if reason is not None}


def can_show(name: str, measurement: Measurement, link_measured: bool) -> bool:
    """Return whether a cause can show in the channels of a measurement, for any motion; `link_measured`: with both encoders."""
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


_REQUIRED = {
    "sliding": "the gear slides for {0:.2g} s, less than {1:g} s",
    "reversal": "the motion never reverses",
    "motor_turn": "the motor makes {0:.2g} turns, less than {1:g}",
    "link_travel": "the link turns {0:.2g} rad, less than {1:g} rad",
    "link_beyond": "the link goes no further than {0:.2g} rad, not beyond {1:g} rad",
    "load_span": "the load spans {2:.2g} % of the rated torque, less than {3:g} %",
    "speed": "the motor goes no faster than {0:.2g} times the Stribeck velocity, it takes {1:g}",
    "duration": "the longest recording takes {0:.2g} s, less than {1:g} s",
    "temperature_span": "the temperature changes by {0:.2g} K, less than {1:g} K",
    "known_push": "in every recording unmeasured pushes may happen, or other joints of the arm move without a torque sensor",
    "weighed": "the torque can be compared with the arm's mass model alone, which may be as wrong",
    "arm": "no recording is of an arm whose other joints move",
    "gravity": "no recording without unmeasured pushes, the arm's other joints still, has a gravity moment",
}
"""What causes require (`models.causes.base.Requirements`), and the reason if less is offered: {0} for {1}, {2} % for {3} %."""


def _offered(measurement: Measurement, joint: Joint, summaries: Sequence[RecordingSummary]) -> dict[str, float]:
    """Return what a measurement offers of `_REQUIRED`."""
    recordings, value = measurement.recordings, {name: number.value for name, number in joint.numbers.items()}
    motion = [_positions({n: np.array(x) for n, x in s.ranges.items()}, value["N"]) for s in summaries]
    warm = [s.ranges["temperature"] for s in summaries if "temperature" in s.ranges]
    known = [r for r in recordings if r.external != "unmeasured" and (r.load is None or "joint_torque" in r.columns)]
    return {
        "sliding": sum(s.sliding * s.duration for s in summaries),
        "reversal": any(s.reversals for s in summaries),
        "motor_turn": max(float(np.ptp(rotor)) for rotor, _ in motion) / _TURN,
        "link_travel": max(float(np.ptp(link)) for _, link in motion),
        "link_beyond": max(float(link.max()) for _, link in motion),
        "load_span": (max(s.load[1] for s in summaries) - min(s.load[0] for s in summaries)) / value["rated_torque"],
        "speed": max(s.motor_speed for s in summaries) / value["vs"],
        "duration": max(s.duration for s in summaries),
        "temperature_span": float(np.ptp(warm)) if warm else 0.0,
        "known_push": bool(known),
        "weighed": any(r.load is None or not r.columns.keys().isdisjoint(_DRIVE) for r in recordings),
        "arm": any(r.load is not None for r in recordings),
        "gravity": any(r.link.gravity_moment > 0 for r in known),
    }


_SHAKEN = 1.5
"""Ratio to the current's noise beyond which counts hide a rotor's inertia: the drive reacts to them, which biases a fit. With a
ratio of 3.4, an inertia 2.1 to 3.3 times as large was found in none of six draws; with 1.2 in three of three."""
_SEEN = 0.5 / (STEP * DECIMATION)
"""Frequency [Hz] up to which residuals see an acceleration."""


def shaken(joint: Joint) -> float:
    """Return the rotor acceleration's noise, as a current, over the current's noise; 0 if none is described. The second
    derivative of an angle's white noise up to a frequency F is (2πF)²/√5 times as large."""
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
    """Return whether a cause affects the motor current alone: motor causes, and friction with one encoder. With both, friction
    changes the wind-up of the wave generator."""
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
            (others, rotor, drives), (others_after, rotor_after, drives_after) = (_effects(state, r) for r in (p, q))
            moved = both_encoders and abs(rotor_after - rotor) > _READ * counts
            if moved or not np.allclose(others, others_after, rtol=1e-9, atol=0.0):
                return False
            drive = drive or not np.isclose(drives, drives_after, rtol=1e-9, atol=0.0)
    return drive


def _effects(state: State, p: np.void) -> tuple[list[float], float, float]:
    """Return torsion torque, link torque, and readings of encoders and torque sensor in a state; the rotor's angle [rad] in a
    steady motion of the link, with wind-up under load and friction; the drive's transmitted torque, from the measured current."""
    t = dynamics.transmission(state, p)
    others = [
        t.flexspline_torque, dynamics.link_torque(state, t.load, p), dynamics.read_motor_position(state, p),
        dynamics.read_link_position(state, t.load, p), dynamics.read_joint_torque(t.flexspline_torque, state, t.load, p),
    ]  # fmt: skip
    theta, v, time, temperature = state.link_position, state.link_velocity, state.time, state.temperature
    rotor = dynamics.steady_motion(theta, v, 0.0, 0.0, time, temperature, p)[0]
    current = dynamics.actual_motor_current(
        state.motor_current, state.motor_position, theta, state.motor_velocity, t.load, time, p
    )
    sliding = dynamics.sliding_friction(state, t.load, p)
    drive = dynamics.transmitted_torque(state._replace(motor_current=current), 100.0, sliding, t.load, p)
    return others, rotor, drive


def _positions(columns: Mapping[str, np.ndarray], N: float) -> tuple[np.ndarray, np.ndarray]:
    """Return rotor and link angle [rad], shape (n,) each; a missing one by the gear ratio."""
    motor, link = (columns.get(name) for name in POSITIONS)
    rotor = motor if motor is not None else N * columns["link_position"]
    return rotor, link if link is not None else rotor / N


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
        slice(b, min(b + _BLOCK, part.stop)) for part in recording.segments for b in range(part.start, part.stop, _BLOCK)
    )  # fmt: skip
    for part in (piece for piece in pieces if piece.stop - piece.start >= _FEWEST):
        time = recording.time[part]
        s = smooth(time, position[part, None], max(2e-3, 0.5 * float(np.median(np.diff(time)))), 20.0)
        v[part] = np.interp(time, s.time, s.rate[:, 0])
    return v


def _reversals(position: np.ndarray) -> int:
    """Return how often a motion reverses; moves shorter than `_REVERSAL` do not count."""
    count, extreme, direction = -1, float(position[0]), 0
    for x in (x for begin in range(0, len(position), _BLOCK) for x in position[begin : begin + _BLOCK].tolist()):
        if (x - extreme) * direction > 0:
            extreme = x
        elif abs(x - extreme) > _REVERSAL:
            count, extreme, direction = count + 1, x, 1 if x > extreme else -1
    return max(count, 0)
