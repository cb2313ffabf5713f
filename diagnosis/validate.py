"""Compare a joint's description with a measurement, without a fit.

The described joint follows the measured motion (`fit.replay`). Its simulated readings are compared with the measured ones at the
samples of the recording. With two encoders, both ends follow, for current and torques; for the current the rotor alone, if the
encoder offset is so uncertain that its band is narrower. The link position is simulated with the rotor alone, unless there were
unmeasured pushes. Errors count in motion: at rest friction is unknown up to its level.

A kinematic error of unknown phase is not simulated: it is in the bands alone.

Every simulated channel has a 95 % band for the channel without its sensor's noise: the root sum of squares of

* the description's uncertainty along its independent directions (`models.calibration`),
* the model discrepancy of a diagnosis (`Uncertainty.discrepancy`), which grows beyond the range of validity,
* the effect of noise of the measured motion, from noise replicates, and friction at rest,
* the measured channel above the passband of the motion.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Any

import numpy as np
from scipy.ndimage import uniform_filter1d

from ..estimator.conditioning import Conditioned, as_logged, condition
from ..models import dynamics
from ..models.calibration import directions, in_quadratures
from ..models.dynamics import State
from ..models.errors import InputError
from ..models.files import plain
from ..models.joint import Joint
from ..models.joint_parts import EncoderSpec, ValidRange
from ..models.kernels import kernel
from ..models.notebook import html_table, paragraph
from ..models.recording import Measurement, Recording
from ..models.signals import CHANNELS
from .data.mistakes import Mistake, find_mistakes, unclipped
from .data.segments import CURRENT, LINK, TORQUE, Segment, segments
from .fit.replay import parallel, readings, transmission
from .fit.residual import lateness

SIGMAS = 1.96
"""Standard deviations of a 95 % band."""
BINS = 4
"""Regions into which the range of angle, speed and load is cut."""
FEWEST = 20
"""Samples in motion that a region must have."""
_AROUND = 500  # steps (half a second) to average the motion's noise
_LOOSE = 0.05  # torque of the encoder offset's uncertainty over the rated torque, above which the rotor alone is tried
_BATCH = 8  # directions per replay
_BALANCE_OF = {"motor_current": CURRENT, "motor_torque": CURRENT, "joint_torque": TORQUE, "external_torque": LINK}


@dataclass(frozen=True)
class ChannelError:
    """Error of a simulated channel in motion."""

    rms: float  # in `unit`
    mean: float  # likewise
    noise: float  # of the sensors, rms, likewise
    unit: str
    inside: float  # share of samples inside the band, widened by sensor noise
    samples: int


@dataclass(frozen=True)
class ValidationRegion:
    """RMS error of every channel in motion in a part of the range of a variable."""

    by: str  # angle, speed, load or direction
    low: float  # of the variable; of direction the sign of the velocity
    high: float  # likewise
    unit: str  # of the variable
    samples: int  # in motion
    rms: dict[str, float]  # by channel, in its unit
    beyond: float  # share of the samples that are beyond the joint's range of validity

    def to_json(self) -> dict[str, Any]:
        """Return the region as in `validation.json`."""
        return {
            "by": self.by, "from": self.low, "to": self.high, "unit": self.unit, "samples": self.samples, "rms": self.rms,
            "beyond": self.beyond,
        }  # fmt: skip


@dataclass(frozen=True)
class Channels:
    """One recording measured and simulated; n samples, NaN where the simulation is missing."""

    name: str  # of the recording
    time: np.ndarray  # as in its table, shape (n,) [s]
    measured: dict[str, np.ndarray]  # by channel, shape (n,)
    simulated: dict[str, np.ndarray]  # likewise
    deviation: dict[str, np.ndarray]  # likewise, half a band over `SIGMAS`
    noise: dict[str, np.ndarray]  # rms of `measured` − `simulated` from the sensors' noise by channel, shape (n,)
    sensor: dict[str, float]  # its part from the channel's own sensor
    moving: np.ndarray  # which samples count, shape (n,), bool
    angle: np.ndarray  # of the link [rad], shape (n,)
    velocity: np.ndarray  # [rad/s], shape (n,)
    load: np.ndarray  # [N·m], shape (n,)
    units: dict[str, str]  # by channel

    @property
    def columns(self) -> dict[str, np.ndarray]:
        """Columns of the output: `time`, and `<channel>`, `<channel>_simulated`, `_low`, `_high` of every channel."""
        found = {"time": self.time}
        for name, values in self.measured.items():
            half = SIGMAS * self.deviation[name]
            found[name] = values
            found[f"{name}_simulated"] = self.simulated[name]
            found[f"{name}_low"], found[f"{name}_high"] = self.simulated[name] - half, self.simulated[name] + half
        return found

    @property
    def column_units(self) -> dict[str, str]:
        """Unit of every one of `columns`."""
        ends = ("", "_simulated", "_low", "_high")
        return {"time": "s"} | {f"{name}{end}": unit for name, unit in self.units.items() for end in ends}


@dataclass(frozen=True)
class Validation:
    """Comparison of a description with a measurement.

    Attributes:
      joint: its name.
      residual: by channel.
      regions: by angle, speed, load and direction.
      beyond: shares of the samples in motion beyond the joint's range of validity, by variable; empty where there are none.
      mistakes: in the data.
      fixed: what `flexspline import --fix` changed before.
      recordings: measured and simulated channels.
      mostly_offset: whether most of the link position's error is a mean that an uncertain encoder offset explains. It also
        affects the joint torque's mean, through the torsion.
    """

    joint: str
    residual: dict[str, ChannelError]
    regions: tuple[ValidationRegion, ...]
    beyond: dict[str, float]
    mistakes: tuple[Mistake, ...] = ()
    fixed: tuple[str, ...] = ()
    recordings: tuple[Channels, ...] = field(default=(), repr=False)
    mostly_offset: bool = False

    def __repr__(self) -> str:
        errors = ", ".join(f"{name} {e.rms:.3g} {e.unit}" for name, e in self.residual.items())
        return f"Validation({self.joint!r}: RMS error {errors or 'of no channel'})"

    def _repr_html_(self) -> str:
        rows = [(name, e.rms, e.noise, e.unit, f"{100 * e.inside:.1f} %") for name, e in self.residual.items()]
        beyond = [f"{100 * share:.2g} % beyond the range of {name}" for name, share in self.beyond.items()]
        return (
            paragraph(self.joint, ", ".join(beyond))
            + html_table(("channel", "error, RMS", "noise", "unit", "inside the band"), rows)
            + "".join(paragraph(f"{m.name}:", f"{m.column} {m.description}") for m in self.mistakes)
        )

    def to_json(self) -> dict[str, Any]:
        """Return the content of `validation.json`."""
        return plain(
            {
                "format": 1, "joint": self.joint, "residual": self.residual, "regions": self.regions, "beyond": self.beyond,
                "mistakes": self.mistakes, "fixed": self.fixed, "untared": self.mostly_offset,
                "recordings": [r.name for r in self.recordings],
            }
        )  # fmt: skip


def validate(measurement: Measurement, joint: Joint) -> Validation:
    """Compare a joint's description with a measurement.

    Args:
      measurement: recordings of the joint.
      joint: its description.

    Raises:
      InputError: a measurement of which no part without gaps is long enough to be simulated.
    """
    mistakes = find_mistakes(measurement, joint)
    measurement = unclipped(measurement, joint, mistakes)
    wrong = {column for m in mistakes if m.severe for column in (m.column, *m.also)}
    joint = in_quadratures(as_logged(joint, measurement.recordings, wrong))  # of an unknown phase none is right
    recordings = tuple(_simulated(recording, joint) for recording in measurement.recordings)
    if not any(np.isfinite(x).any() for r in recordings for x in r.simulated.values()):
        raise InputError(
            f"{measurement.path}: expected half a second without gaps, with a channel to simulate, got none"
        )
    residual = _residual(recordings)
    motion = [np.concatenate([getattr(r, x)[r.moving] for r in recordings]) for x in ("angle", "velocity", "load")]
    return Validation(
        joint=joint.name,
        residual=residual,
        regions=tuple(_regions(recordings, motion, joint.valid)),
        beyond={} if joint.valid is None else joint.valid.beyond(*motion),
        mistakes=mistakes,
        fixed=measurement.fixed,
        recordings=recordings,
        mostly_offset=_mostly_offset(residual.get("link_position"), joint),
    )


# --- one recording simulated -----------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Part:
    """Simulation of one segment at its n steps, by channel."""

    segment: Segment
    values: dict[str, np.ndarray]
    variance: dict[str, np.ndarray]
    motion_noise: dict[str, np.ndarray]


def _simulated(recording: Recording, joint: Joint) -> Channels:
    """Simulate a recording's channels."""
    conditioned = condition(recording, joint)
    recording = replace(recording, time=conditioned.recording.time, logged=conditioned.recording.logged)
    parts = _parts(conditioned, joint, [name for name in _BALANCE_OF if name in recording])
    of = {name: [part for part in parts if name in part.values] for name in _BALANCE_OF}
    if {"motor_position", "link_position"} <= set(recording.columns) and recording.external != "unmeasured":
        alone = ["link_position", *(n for n in ("motor_current", "motor_torque") if n in recording and _loose(joint))]
        motor = replace(conditioned, recording=conditioned.recording.without("link_position"))
        one_end = _parts(motor, joint, alone)
        for name in alone:
            having = [part for part in one_end if name in part.values]
            if _width(having, name) < _width(of.get(name, []), name):
                of[name] = having
    measured = {name: recording[name] for name in CHANNELS if of.get(name)}
    since = recording.time - recording.time[0]
    every = [part.segment for part in parts]
    angle = _joined(every, since, [s.link_position for s in every])
    velocity = _joined(every, since, [s.state[:, 3] for s in every])
    load = _joined(every, since, [s.load for s in every])
    # In motion with settled friction.
    moving = [(s.usable | s.held_out).any(axis=1) & ~s.at_rest for s in every]
    simulated, deviation, noise = {}, {}, {}
    sensor = {name: _sensor_noise(joint, name) for name in measured}
    for name in measured:
        mine = [part.segment for part in of[name]]
        value = _joined(mine, since, [part.values[name] for part in of[name]])
        variance = _joined(mine, since, [part.variance[name] for part in of[name]])
        motion = _joined(mine, since, [part.motion_noise[name] for part in of[name]])
        # The external torque is a part of all known torques on the link.
        simulated[name] = value - recording.torque_of_arm if name == "external_torque" else value
        motion = np.maximum(motion, 0.0)
        if name == "link_position":  # a sample with a wrong time is off by the speed times that
            motion = motion + (np.nan_to_num(velocity) * conditioned.stamps.error) ** 2
        deviation[name] = np.sqrt(variance + motion + _fast(recording, name, mine, joint, sensor[name]))
        noise[name] = np.sqrt(motion + sensor[name] ** 2)
    return Channels(
        name=recording.name, time=recording.stamps, measured=measured, simulated=simulated, deviation=deviation,
        noise=noise, sensor=sensor, moving=_joined(every, since, [x.astype(float) for x in moving]) > 0.99,
        angle=angle, velocity=velocity, load=load,
        units={name: CHANNELS[name].unit for name in measured},
    )  # fmt: skip


def _width(parts: Sequence[_Part], name: str) -> float:
    """Return the median standard deviation of a simulated channel."""
    return float(np.sqrt(np.median(np.concatenate([part.variance[name] for part in parts])))) if parts else np.inf


def _loose(joint: Joint) -> bool:
    """Return whether the encoder offset is too uncertain to get a torque from torsion."""
    return joint.numbers["K1"].value * _zero_std(joint) > _LOOSE * joint.numbers["rated_torque"].value


def _zero_std(joint: Joint) -> float:
    """Standard deviation of the link encoder's zero [rad]; 0 where the description has none."""
    zero = joint.sensors.link_encoder.zero
    return 0.0 if zero is None else zero.deviation if zero.std is None else zero.std


def _mostly_offset(error: ChannelError | None, joint: Joint) -> bool:
    """Return whether most of the link position's error is a mean within the uncertainty of the encoder's zero."""
    if error is None or not _loose(joint):
        return False
    return error.noise < abs(error.mean) <= SIGMAS * _zero_std(joint) and error.mean**2 > error.rms**2 / 2


def _fast(recording: Recording, name: str, parts: Sequence[Segment], joint: Joint, noise: float) -> np.ndarray | float:
    """Return the mean square of a channel above the passband and its sensor's noise, shape (n,)."""
    if name not in ("motor_current", "motor_torque", "joint_torque"):
        return 0.0
    since = recording.time - recording.time[0]
    scale = float(joint.record(recording.link)[0]["Kt_drive"]) if name == "motor_torque" else 1.0
    slow = _joined(parts, since, [scale * part.measured[:, _BALANCE_OF[name]] for part in parts])
    rest = np.nan_to_num(recording[name] - slow) ** 2
    around = max(round(_AROUND * 1e-3 / recording.interval), 1)
    return np.maximum(uniform_filter1d(rest, around, mode="nearest") - noise**2, 0.0)


def _joined(segments: Sequence[Segment], since: np.ndarray, values: Sequence[np.ndarray]) -> np.ndarray:
    """Join values at steps or residuals of all segments at a recording's samples, shape (n,); NaN between segments."""
    found = np.full(len(since), np.nan)
    for segment, x in zip(segments, values, strict=True):
        time = segment.time if len(x) == len(segment.time) else segment.at
        here = np.interp(since, time, x, left=np.nan, right=np.nan)
        found = np.where(np.isfinite(here), here, found)
    return found


def _sensor_noise(joint: Joint, name: str) -> float:
    """Return the rms noise of a channel's own sensor, including counts and steps."""
    spec = joint.sensors.of(CHANNELS[name])
    step = spec.resolution if isinstance(spec, EncoderSpec) else getattr(spec, "step", 0.0)
    return float(np.hypot(getattr(spec, "noise", 0.0), step / np.sqrt(12)))


def _parts(conditioned: Conditioned, joint: Joint, names: Sequence[str]) -> list[_Part]:
    """Simulate the channels `names` in each segment of a recording, if possible."""
    recording = conditioned.recording
    record = joint.record(recording.link)
    moved = directions(joint, recording.link)
    late = lateness(joint)
    found = []
    for one, replicate in zip(*segments([conditioned], joint), strict=True):
        kept = [name for name in names if _can(one, recording, name)]

        def channels(task: tuple[Segment, np.ndarray], kept: list[str] = kept) -> dict[str, np.ndarray]:
            return _channels(*task, kept, late)

        base, noisy = parallel(channels, [(one, record), (replicate, record)])
        variance = {name: np.zeros(len(one.time)) + _discrepancy(one, joint, name) ** 2 for name in kept}
        for first in range(0, len(moved), _BATCH):
            for changed in parallel(channels, [(one, other) for other in moved[first : first + _BATCH]]):
                for name in kept:
                    if np.isfinite(changed[name]).all():  # skip diverged replays
                        variance[name] += (changed[name] - base[name]) ** 2
        resting, friction = np.interp(one.time, one.at, one.at_rest), joint.numbers["Fs"].value / np.sqrt(3)
        for name in (name for name in kept if _BALANCE_OF.get(name) == CURRENT):
            unit = 1.0 if name == "motor_torque" else joint.numbers["Kt"].value
            variance[name] += resting * float(friction / unit) ** 2
        noise = {name: uniform_filter1d((noisy[name] - base[name]) ** 2, _AROUND, mode="nearest") for name in kept}
        found.append(_Part(one, base, variance, noise))
    return found


def _can(segment: Segment, recording: Recording, name: str) -> bool:
    """Return whether a channel can be simulated in a segment."""
    if name == "external_torque":
        return recording.external == "measured" and segment.weighed
    # A joint torque is compared with the torsion, or with one encoder with the link's motion.
    return name in ("link_position", "joint_torque") or bool(segment.balances[_BALANCE_OF[name]])


def _channels(segment: Segment, record: np.ndarray, names: Sequence[str], late: np.ndarray) -> dict[str, np.ndarray]:
    """Simulate the readings of channels at a segment's steps, shape (n,) each; `late`: from `lateness`."""
    p, time = record[0], segment.time
    inner = transmission(segment, record)
    out = readings(segment, record, inner)
    for balance, delay in zip((CURRENT, TORQUE), late, strict=True):
        out[:, balance] = np.interp(time - delay, time, out[:, balance])
    if segment.has_torque:  # the sensor's delay
        out[:, LINK] += np.interp(time + late[TORQUE], time, segment.torque) - segment.torque
    found = {}
    for name in names:
        if name == "motor_torque":
            found[name] = out[:, CURRENT] * p["Kt_drive"]
        elif name == "external_torque":  # residual of the balance without the measured torque
            scale = p["torque_gain"] if segment.has_torque else segment.stiffness / (p["K1"] + p["K2"] + p["K3"])
            found[name] = segment.external - out[:, LINK] / scale
        elif name == "joint_torque" and not segment.balances[TORQUE]:  # torque of the link's motion
            needed = np.interp(time + late[TORQUE], time, segment.torque) - out[:, LINK]
            found[name] = np.interp(time - late[TORQUE], time, needed)
        elif name == "link_position":
            reading = np.empty(len(segment.time))
            _link_readings(p, segment.time, segment.temperature, inner, reading)
            found[name] = np.interp(segment.time - p["link_delay"], segment.time, reading)
        else:
            found[name] = out[:, _BALANCE_OF[name]]
    return found


@kernel
def _link_readings(p, time, temperature, inner, out):
    for i in range(len(time)):
        s = inner[i]
        state = State(
            s.motor_position, s.motor_velocity, s.wave_generator_position, s.wave_generator_velocity, s.link_position,
            s.link_velocity, s.bristle, s.dahl, 0.0, time[i], temperature[i],
        )  # fmt: skip
        out[i] = dynamics.read_link_position(state, s.load, p)


def _discrepancy(segment: Segment, joint: Joint, name: str) -> float | np.ndarray:
    """Return the model discrepancy of the description's fit, rms in the channel's unit; it grows beyond the range of validity,
    shape (n,)."""
    stated, valid = joint.uncertainty, joint.valid
    if stated is None:
        return 0.0
    known: dict[str, float] = {balance: rms for balance, rms in stated.discrepancy.items()}
    current, link = (known.get(balance, 0.0) for balance in ("motor_current", "link_balance"))
    rms = {
        "motor_current": current,
        "motor_torque": current * joint.numbers["Kt"].value,
        "joint_torque": known.get("joint_torque", link),
        "external_torque": link,
        "link_position": max(link, known.get("joint_torque", 0.0)) / joint.numbers["K1"].value,
    }[name]
    if valid is None:
        return rms
    far = valid.distance(segment.link_position, segment.state[:, 3], segment.load)
    return (1 + (stated.beyond - 1) * np.interp(segment.time, segment.at, far)) * rms


# --- results ---------------------------------------------------------------------------------------------------------


def _residual(recordings: Sequence[Channels]) -> dict[str, ChannelError]:
    """Return the error of every channel over all recordings."""
    found = {}
    for name in CHANNELS:
        having = [(r, r.moving & np.isfinite(r.simulated[name])) for r in recordings if name in r.measured]
        if any(use.any() for _, use in having):
            error = np.concatenate([(r.measured[name] - r.simulated[name])[use] for r, use in having])
            noise = np.concatenate([r.noise[name][use] for r, use in having])
            # The band includes the motion's noise, but not the sensor's.
            half = SIGMAS * np.concatenate([np.hypot(r.deviation[name], r.sensor[name])[use] for r, use in having])
            inside, mean = float(np.mean(np.abs(error) <= half)), float(np.mean(error))
            found[name] = ChannelError(_rms(error), mean, _rms(noise), CHANNELS[name].unit, inside, len(error))
    return found


def _regions(
    recordings: Sequence[Channels], motion: Sequence[np.ndarray], valid: ValidRange | None
) -> Iterator[ValidationRegion]:
    """Yield errors by region of angle, speed, load and direction; `motion`: angle, velocity and load in motion, shape (n,)."""
    angle, velocity, load = motion
    if not len(angle):
        return
    outside = np.zeros(len(angle), bool) if valid is None else valid.outside(*motion)
    errors = {}
    for name in (name for name in CHANNELS if any(name in r.measured for r in recordings)):
        each = [r.measured[name] - r.simulated[name] if name in r.measured else np.nan * r.time for r in recordings]
        errors[name] = np.concatenate([error[r.moving] for error, r in zip(each, recordings, strict=True)])
    variables = {"angle": ("rad", angle), "speed": ("rad/s", np.abs(velocity)), "load": ("N·m", load)}
    for by, (unit, x) in (variables | {"direction": ("", np.sign(velocity))}).items():
        edges = np.array([-1.0, 0.0, 1.0]) if by == "direction" else np.linspace(x.min(), x.max(), BINS + 1)
        place = np.clip(np.searchsorted(edges, x, side="right") - 1, 0, len(edges) - 2)
        for k, (low, high) in enumerate(pairwise(edges.tolist())):
            use = place == k
            if use.sum() < FEWEST:
                continue
            here = {name: error[use & np.isfinite(error)] for name, error in errors.items()}
            rms = {name: _rms(error) for name, error in here.items() if len(error)}
            yield ValidationRegion(by, low, high, unit, int(use.sum()), rms, float(np.mean(outside[use])))


def _rms(x: np.ndarray) -> float:
    return float(np.sqrt(np.mean(x**2))) if len(x) else float("nan")
