"""What a measurement is, and what it can show at all: before anything is fitted.

The rules are about motion and columns only (has it reversed, how far has it turned, was there a load), so that they
can be told to a person at once; how well causes can be told apart is a question for diagnosis proper.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..models import causes
from ..models.joint import Joint
from ..sim.recording import GAP, OPTIONAL, Measurement, Recording
from .motion import smooth
from .sampling import timing_error

_MOVES = 2.5  # Stribeck velocities above which the mesh slides
_REVERSAL = 0.6  # rad of the rotor that a change of direction must last to count
_CLIPPED = 0.995  # of the current limit
_TURN = 2 * np.pi


@dataclass(frozen=True)
class Summary:
    """One recording in numbers.

    Attributes:
      samples, duration [s], interval (median) [s], jitter: rms of the intervals' deviation from it, without missing
        samples [s].
      late: by how much the time stamps are wrong, as both encoders have it [s rms]; zero where they do not say so.
      missing: single samples that are missing; gaps: longer ones, begin and end [s].
      ranges: smallest and largest value by column.
      motor_speed, link_speed: largest [rad/s].
      moving: share of the time in which the mesh slides.
      reversals: changes of direction that last.
      forward, backward: travel of the rotor in each direction [rad].
      load: smallest and largest joint torque [N·m], as measured, or else as the current asks for.
      clipped: share of samples at the current limit.
    """

    name: str
    samples: int
    duration: float
    interval: float
    jitter: float
    late: float
    missing: int
    gaps: tuple[tuple[float, float], ...]
    ranges: dict[str, tuple[float, float]]
    motor_speed: float
    link_speed: float
    moving: float
    reversals: int
    forward: float
    backward: float
    load: tuple[float, float]
    load_measured: bool
    clipped: float


def summarise(recording: Recording, joint: Joint) -> Summary:
    """Sum up a recording of a joint."""
    time = recording.time
    steps = np.diff(time)
    interval = recording.interval
    inside = steps[steps <= GAP]
    regular = inside[inside < 1.6 * interval]
    motor_speed, link_speed, w = _speeds(recording)
    moving = np.abs(w) > _MOVES * joint.numbers["vs"].value
    load = recording.joint_torque
    if load is None:
        load = joint.numbers["N"].value * joint.numbers["Kt"].value * recording.motor_current
    turns = _turns(recording.motor_position)
    travel = np.diff(recording.motor_position)
    limit = joint.numbers["current_limit"].value
    return Summary(
        name=recording.name,
        samples=len(time),
        duration=float(time[-1] - time[0]),
        interval=interval,
        jitter=float(np.sqrt(np.mean((regular - interval) ** 2))) if len(regular) else 0.0,
        late=max(
            timing_error(time[k], recording.motor_position[k], recording.link_position[k]) for k in recording.stretches
        ),
        missing=max(round(float(inside.sum()) / interval) - len(inside), 0),
        gaps=recording.gaps,
        ranges={name: (float(x.min()), float(x.max())) for name, x in recording.columns.items() if name != "time"},
        motor_speed=motor_speed,
        link_speed=link_speed,
        moving=float(np.mean(moving)),
        reversals=max(len(turns) - 2, 0),
        forward=float(travel[travel > 0].sum()),
        backward=float(-travel[travel < 0].sum()),
        load=(float(np.percentile(load, 0.5)), float(np.percentile(load, 99.5))),
        load_measured=recording.joint_torque is not None,
        clipped=float(np.mean(np.abs(recording.motor_current) >= _CLIPPED * limit)),
    )


def missing_columns(measurement: Measurement) -> list[str]:
    """Optional columns that no recording has."""
    return [c for c in OPTIONAL if all(getattr(r, c) is None for r in measurement.recordings)]


def undetermined(measurement: Measurement, joint: Joint) -> dict[str, str]:
    """Causes that this measurement cannot show at ordinary size, with the reason, by the rules of this module."""
    recordings = measurement.recordings
    found = [summarise(r, joint) for r in recordings]
    rated = joint.numbers["rated_torque"].value
    columns = {c for r in recordings for c in r.columns}
    reversals = sum(s.reversals for s in found)
    motor = max(np.ptp(s.ranges["motor_position"]) for s in found)
    link = max(np.ptp(s.ranges["link_position"]) for s in found)
    highest = max(s.ranges["link_position"][1] for s in found)
    load = max(s.load[1] for s in found) - min(s.load[0] for s in found)
    moved = sum(s.moving * s.duration for s in found)
    duration = max(s.duration for s in found)
    speeds = max(s.motor_speed for s in found)
    known_push = [r for r in recordings if r.external != "unmeasured"]
    gravity = any(r.link.gravity_moment > 0 for r in known_push)
    reasons: dict[str, str] = {}

    def say(reason: str, *names: str) -> None:
        for name in names:
            reasons.setdefault(name, reason)

    for name in causes.names():
        for column in causes.get(name).needs:
            if column not in columns:
                say(f"there is no column {column}", name)
    if moved < 0.5:
        say(
            "the joint hardly moves",
            *(n for n in causes.names() if causes.get(n).component in ("motor", "transmission")),
        )
    if reversals == 0:
        say("the motion never reverses", "hysteresis", "backlash", "friction_asymmetry")
    if motor < _TURN:
        say(f"the motor turns {motor:.2g} rad, less than a revolution", "cogging", "kinematic_error")
    if link < 0.5:
        say(
            f"the link turns {link:.2g} rad",
            "link_encoder_eccentricity", "position_dependent_friction", "cable_spring", "gravity_moment",
            "gravity_direction",
        )  # fmt: skip
    if load < 0.2 * rated:
        say(
            f"the load spans {load:.2g} N·m, less than a fifth of the rated torque",
            "stiffness",
            "load_dependent_friction",
        )
    if duration < 5.0:
        say(f"the longest recording takes {duration:.2g} s", "friction_drift", "torque_sensor_drift")
    if speeds < 10 * joint.numbers["vs"].value:
        say(f"the motor turns at no more than {speeds:.2g} rad/s", "viscous_friction", "rotor_inertia", "encoder_delay")
    if not known_push:
        say(
            "unmeasured pushes may happen in every recording",
            "gravity_moment", "gravity_direction", "link_inertia", "cable_spring", "hard_stop",
        )  # fmt: skip
    if not gravity:
        say("no recording has a gravity moment", "gravity_moment", "gravity_direction")
    stop = causes.get("hard_stop").parameters[0].ordinary[0]
    if highest < stop[0]:
        say(f"the link goes no further than {highest:.2g} rad, a stop would be beyond {stop[0]:g} rad", "hard_stop")
    return {name: reasons[name] for name in causes.names() if name in reasons}


def _speeds(recording: Recording) -> tuple[float, float, np.ndarray]:
    """Largest speed of motor and link [rad/s], and the motor's velocity at the samples, shape (n,)."""
    w = np.zeros(len(recording.time))
    fastest = [0.0, 0.0]
    for stretch in recording.stretches:
        if stretch.stop - stretch.start < 10:
            continue
        time = recording.time[stretch]
        s = smooth(
            time, np.column_stack([recording.motor_position[stretch], recording.link_position[stretch]]), 2e-3, 20.0
        )
        w[stretch] = np.interp(time, s.time, s.rate[:, 0])
        fastest = [max(a, float(b)) for a, b in zip(fastest, np.abs(s.rate).max(axis=0), strict=True)]
    return fastest[0], fastest[1], w


def _turns(position: np.ndarray) -> list[float]:
    """Turning points of a motion, ends included: shorter ways than `_REVERSAL` do not count."""
    points = [float(position[0])]
    extreme, direction = float(position[0]), 0
    for x in position.tolist():
        if direction == 0:
            if abs(x - points[0]) > _REVERSAL:
                direction, extreme = (1 if x > points[0] else -1), x
        elif (x - extreme) * direction > 0:
            extreme = x
        elif (extreme - x) * direction > _REVERSAL:
            points.append(extreme)
            direction, extreme = -direction, x
    return [*points, extreme] if direction else points
