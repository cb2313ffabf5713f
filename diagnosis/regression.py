"""Plain regression of a torque channel on the measured motion by linear least squares.

In motion, a joint's current (or the torque of its motor or of an output sensor) is a sum of known shapes:

    gravity, gravity across, inertia, Coulomb friction, viscous friction, friction that grows with load, offset

each with one coefficient. In a moving arm, gravity and inertia are replaced by the arm's inverse dynamics. With a torque sensor,
the load is the sensor's torque, and its coefficient gives the torque constant. The smoother of a diagnosis differentiates the
position.

The regression ignores compliance and tolerances. It is the starting point of a diagnosis with one encoder, and its baseline: a
joint that predicts held-out data worse is not written.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..estimator.conditioning import Conditioned, condition
from ..models.calibration import CUT, NARROW, Calibration
from ..models.files import plain
from ..models.joint import Joint
from ..models.joint_parts import Mounting
from ..models.motion import smooth
from ..models.recording import Measurement, Recording
from ..models.signals import CHANNELS, DRIVING
from .data.coverage import AGREED
from .data.segments import ENOUGH, in_held_out_block
from .data.stretches import most_telling

MOVING = 0.05
"""Share of the 98 % quantile of speed below which a sample is at rest, where friction is unknown up to its level."""
LONGEST = 300.0
"""Seconds of a measurement that a regression uses, the most informative ones."""
LEAST = 0.02  # share of the rated torque, below which a torque sensor reads little but its noise
_TIMES = 4.0  # ratio of a gravity moment by the drive to the described one, or the reverse, that contradicts it
_FRICTION = 0.25  # share of Coulomb friction, below which such a difference may be friction that varies with the angle
_STEP = 2e-3  # s: of the smoother's grid
_EDGE = 0.1  # s: at both ends of a part, where the smoother settles
_FEWEST = 20  # samples in motion for each coefficient
CLUSTER = 1.0  # s: residuals that far apart count as independent
_NOTHING = 1e-6  # share of a number that counts as zero
_SAME = 1e-6  # share of a column that no other column explains, below which it is left out


@dataclass(frozen=True)
class Coefficient:
    """One coefficient of a regression."""

    name: str  # of the shape: `gravity`, `inertia`, `Coulomb friction`, …
    value: float  # in the channel's unit over the shape's
    std: float  # likewise
    means: str = ""  # number of the joint, as a symbol or the name of a cause's parameter; may be empty
    number: float = float("nan")  # its value, in `unit`
    number_std: float = float("nan")
    described: float = float("nan")  # value of the description
    tolerance: float = float("nan")  # its standard deviation
    unit: str = ""
    size: float = float("nan")  # RMS of the shape

    @property
    def beyond(self) -> float:
        """Z-score of the number against the description, with tolerance and regression's deviation; 0 without a number.

        Wide tolerances are log-normal: there it is the one of the nearest value within two of the regression's deviations."""
        if not self.means:
            return 0.0
        if self.tolerance > NARROW * self.described > 0.0:
            near = np.clip(self.described, self.number - 2 * self.number_std, self.number + 2 * self.number_std)
            ratio = max(float(near), _NOTHING * self.described) / self.described
            return abs(float(np.log(ratio))) / float(np.log1p(self.tolerance / self.described))
        spread = float(np.hypot(self.tolerance, self.number_std))
        return abs(self.number - self.described) / max(spread, 1e-300)

    @property
    def misfit(self) -> float:
        """RMS of what the difference between number and description is in the channel, in its unit."""
        return abs(self.number - self.described) * self.size * self.std / max(self.number_std, 1e-300)

    def to_json(self) -> dict[str, Any]:
        """As plain data."""
        of_joint = ("means", "number", "number_std", "described", "tolerance", "unit") if self.means else ()
        return {name: getattr(self, name) for name in ("name", "value", "std", *of_joint)}


@dataclass(frozen=True)
class Regression:
    """The least squares of one channel."""

    channel: str  # `motor_current`, `motor_torque` or `joint_torque`
    unit: str  # of the channel
    coefficients: tuple[Coefficient, ...]  # of every identifiable shape
    rms: float  # of the residual in motion, in `unit`
    held_out: float  # the same on held-out blocks of a separate fit; NaN for short recordings
    spread: float  # standard deviation of the channel in motion, in `unit`
    samples: int  # in motion
    passband: float  # of the smoother [Hz], the lowest of all recordings
    left_out: tuple[str, ...] = ()  # shapes that are confounded with others in this motion
    moment: float = 0.0  # gravity moment [N·m] of a recording without a described one: 1 if no recording has one

    @property
    def rows(self) -> list[tuple[str, str, str, str]]:
        """Rows of text: shape, coefficient, its meaning for the joint, described value."""
        rows = []
        for c in self.coefficients:
            unit = "" if c.unit == "1" else c.unit
            meaning = f"{c.means.replace('_', ' ')} {c.number:.4g} ± {c.number_std:.2g} {unit}".rstrip()
            said = (meaning, f"{c.described:.4g} ± {c.tolerance:.2g}") if c.means else ("", "")
            rows.append((c.name, f"{c.value:.4g} ± {c.std:.2g}", *said))
        return rows

    @property
    def title(self) -> str:
        """Channel and residual, as text."""
        unseen = f", {self.held_out:.3g} on held-out blocks" if np.isfinite(self.held_out) else ""
        return (
            f"{self.channel.replace('_', ' ')}: {self.rms:.3g} {self.unit} RMS residual of {self.spread:.3g} in motion{unseen}; "
            f"motion smoothed at {self.passband:.3g} Hz"
        )

    def predict(self, recording: Recording, joint: Joint) -> np.ndarray:
        """The channel of a recording at its samples, shape (n,), in `unit`; NaN at the ends of parts without gaps."""
        shapes = _shapes(condition(recording, joint), joint, self.channel, self.moment)
        found = np.full(len(recording.time), np.nan)
        if shapes is not None:
            found[shapes.rows] = sum(c.value * shapes.columns[c.name] for c in self.coefficients)
        return found

    def to_json(self) -> dict[str, Any]:
        """As plain data."""
        return {
            "channel": self.channel, "unit": self.unit, "rms": self.rms, "held_out": plain(self.held_out),
            "spread": self.spread, "samples": self.samples, "passband": self.passband, "left_out": list(self.left_out),
            "coefficients": plain(self.coefficients),
        }  # fmt: skip


def regressions(
    measurement: Measurement, joint: Joint, conditioned: Sequence[Conditioned] | None = None, passband: float = np.inf
) -> tuple[Regression, ...]:
    """Fit the regression of every torque channel that a measurement has.

    Args:
      measurement: recordings of the joint; pushes of unknown size are not modelled, recordings that have them are left out.
      joint: its description.
      conditioned: the recordings of the measurement, if they are conditioned already.
      passband: highest one of the smoother [Hz].

    Returns:
      One regression per channel; none for a channel with too little motion.
    """
    part = most_telling(measurement, LONGEST)
    if part is not measurement:
        measurement, conditioned = part, None
    every = conditioned or [condition(r, joint) for r in measurement.recordings]
    every = [replace(c, passband=min(c.passband, passband)) for c in every]
    pairs = zip(measurement.recordings, every, strict=True)
    used = [(r, c) for r, c in pairs if r.external != "unmeasured" and not r.link.locked]
    channels = [name for name in DRIVING if any(name in r for r, _ in used)]
    if "motor_current" in channels and "motor_torque" in channels:
        channels.remove("motor_torque")
    return tuple(one for name in channels if (one := _regress([c for _, c in used], joint, name)) is not None)


def contradictions(every: Sequence[Regression], joint: Joint) -> tuple[str, ...]:
    """Return the numbers of the load that a torque sensor contradicts beyond any joint within tolerance, as sentences; without a
    sensor, a gravity moment that the drive contradicts by `_TIMES` (friction turns with the motion, and hides an inertia)."""
    p, sensed = joint.record()[0], _sensed(every, joint)
    found = []
    for r in sensed or every:
        friction = float(p["Fc"] / (p["Kt"] if r.channel == "motor_current" else 1.0))
        for c in r.coefficients:
            less, more = sorted((max(c.number, 0.0), c.described))
            drive = c.means == "gravity_moment" and more > _TIMES * less and c.misfit > _FRICTION * friction
            if c.beyond > CUT and (drive or (sensed and c.means in ("gravity_moment", "inertia"))):
                clock = ", and is time in seconds" if c.means == "inertia" else ""
                found.append(f"{_contradicted(r, c)}: is the load as described{clock}?")
    return tuple(found)


def contradictions_of_drive(every: Sequence[Regression], joint: Joint) -> tuple[str, ...]:
    """Return the rotor inertia and torque constant that current and torque sensor contradict likewise; none without a sensor."""
    return tuple(
        f"{_contradicted(r, c)}: is the drive as described, and is time in seconds?"
        for r in every
        for c in r.coefficients
        if c.means in ("rotor_inertia", "Kt")
        and c.beyond > CUT
        and abs(c.number - c.described) > AGREED * c.described
        and _sensed(every, joint)
    )


def _sensed(every: Sequence[Regression], joint: Joint) -> list[Regression]:
    """The regression of a torque sensor that reads more than its noise."""
    rated = joint.numbers["rated_torque"].value
    return [r for r in every if r.channel == "joint_torque" and r.spread > LEAST * rated]


def _contradicted(r: Regression, c: Coefficient) -> str:
    means = c.means.replace("_", " ")
    return f"{r.channel}: {means} is {c.number:.3g} {c.unit}, not {c.described:.3g} ± {c.tolerance:.2g}"


# --- shapes ----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Shapes:
    """Shapes of one recording at n of its samples: `rows`, shape (n,); `time` since its start [s]; `speed` [rad/s]; `columns` by
    name, shape (n,) each; `smoothed` and raw `reading` of the channel.

    Both sides of the balance go through one smoother: a controller feeds the position's noise back into the current."""

    rows: np.ndarray
    time: np.ndarray
    speed: np.ndarray
    columns: dict[str, np.ndarray]
    smoothed: np.ndarray
    reading: np.ndarray


def _shapes(conditioned: Conditioned, joint: Joint, channel: str, without: float) -> _Shapes | None:
    """Shapes of a recording; None where no part of it is long enough. `without`: the gravity moment if none is described."""
    recording, passband = conditioned.recording, conditioned.passband
    p = joint.record(recording.link)[0]
    position = "link_position" if "link_position" in recording else "motor_position"
    sensed = channel != "joint_torque" and "joint_torque" in recording
    names = [position, *(["joint_torque"] if sensed else [])]
    parts: list[np.ndarray] = []
    for part in recording.segments:
        time = recording.time[part]
        if len(time) < 10 or time[-1] - time[0] < 4 * _EDGE:
            continue
        values = [recording[name][part] for name in names]
        if recording.load is not None:
            values += [recording.load.torque[part], recording.load.inertia[part]]
        values.append(recording.columns.get("external_torque", np.zeros(len(recording.time)))[part])
        values.append(recording[channel][part])
        s = smooth(time, np.column_stack(values), min(_STEP, recording.interval), passband)
        inside = (time > time[0] + _EDGE) & (time < time[-1] - _EDGE)
        at = time[inside]
        columns = [np.interp(at, s.time, x) for x in (*s.value.T, s.rate[:, 0], s.acceleration[:, 0])]
        parts.append(np.stack([np.arange(part.start, part.stop)[inside], *columns]))
    if not parts:
        return None
    rows, *columns = np.concatenate(parts, axis=1)
    scale = 1.0 / float(p["N"]) if position == "motor_position" else 1.0
    angle, velocity, acceleration = scale * columns[0], scale * columns[-2], scale * columns[-1]
    at = rows.astype(int)
    moment, turned = float(p["Mg"]) or without, float(p["gravity_angle"])
    weight = moment * np.sin(angle + turned)
    load = weight * (float(p["Mg"]) > 0.0) + float(p["Jl"]) * acceleration
    found: dict[str, np.ndarray] = {}
    if sensed:
        load = columns[1]
        found["sensor torque"] = load
    elif recording.load is not None:
        load = weight - columns[-6] + columns[-5] * acceleration
        found["arm"] = load
    else:
        found |= {"gravity": weight, "gravity across": moment * np.cos(angle + turned)}
        found["link inertia"] = float(p["Jl"]) * acceleration
    found["inertia"] = acceleration
    found |= {"Coulomb friction": np.sign(velocity), "viscous friction": velocity}
    if channel != "joint_torque":
        found["load friction"] = np.abs(load) * np.sign(velocity)
    found["offset"] = np.ones(len(at))
    found["external torque"] = -columns[-4]
    return _Shapes(at, recording.time[at] - recording.time[0], velocity, found, columns[-3], recording[channel][at])


# --- least squares ---------------------------------------------------------------------------------------------------


def _regress(conditioned: Sequence[Conditioned], joint: Joint, channel: str) -> Regression | None:
    having = [(i, c) for i, c in enumerate(conditioned) if channel in c.recording]
    link = max((c.recording.link for _, c in having), key=lambda mounting: mounting.gravity_moment)
    moment = 0.0 if link.gravity_moment > 0.0 else 1.0
    each = [(i, s) for i, c in having if (s := _shapes(c, joint, channel, moment)) is not None]
    if not each:
        return None
    names = [n for n in each[0][1].columns if all(n in s.columns for _, s in each)]
    if not any(s.columns["external torque"].any() for _, s in each):
        names.remove("external torque")
    speed, y, raw = (np.concatenate([getattr(s, a) for _, s in each]) for a in ("speed", "smoothed", "reading"))
    held = np.concatenate([in_held_out_block(s.time, i) for i, s in each])
    cluster = np.concatenate([np.floor(s.time / CLUSTER) + 1e6 * i for i, s in each])
    X = np.column_stack([np.concatenate([s.columns[n] for _, s in each]) for n in names])
    moving = np.abs(speed) > MOVING * float(np.quantile(np.abs(speed), 0.98))
    X, y, raw, held, cluster = X[moving], y[moving], raw[moving], held[moving], cluster[moving]
    kept = _independent(X, [names.index(n) for n in _PREFERRED if n in names])
    if len(y) < _FEWEST * len(kept) or not len(kept):
        return None
    beta = least_squares(X[:, kept], y)
    left = y - X[:, kept] @ beta
    unseen = float("nan")
    if _FEWEST * len(kept) <= (~held).sum() and held.mean() > ENOUGH:
        unseen = _rms(raw[held] - X[held][:, kept] @ least_squares(X[~held][:, kept], y[~held]))
    std = np.sqrt(np.diag(covariance(X[:, kept], left, cluster)))
    alone = any(names[k] in ("arm", "sensor torque", "link inertia") for k in kept)
    coefficients = tuple(
        replace(_of_joint(names[k], float(b), float(s), channel, joint, link, alone), size=_rms(X[:, k]))
        for k, b, s in zip(kept, beta, std, strict=True)
    )
    left_out = tuple(n for i, n in enumerate(names) if i not in kept)
    return Regression(
        channel, CHANNELS[channel].unit, coefficients, _rms(raw - X[:, kept] @ beta), unseen, float(np.std(raw)), len(y),
        min(c.passband for _, c in having), left_out, moment,
    )  # fmt: skip


_PREFERRED = (
    "sensor torque", "arm", "gravity", "external torque", "inertia", "Coulomb friction", "viscous friction",
    "gravity across", "link inertia", "load friction", "offset",
)  # fmt: skip
"""Shapes by precedence, if they are confounded."""


def _independent(X: np.ndarray, order: Sequence[int]) -> list[int]:
    """Columns of X, shape (n, c), each of which the ones before it in an order do not explain."""
    kept: list[int] = []
    basis = np.zeros((len(X), 0))
    for k in order:
        x = X[:, k] / max(float(np.linalg.norm(X[:, k])), 1e-300)
        rest = x - basis @ (basis.T @ x)
        size = float(np.linalg.norm(rest))
        if size**2 > _SAME:
            kept.append(k)
            basis = np.column_stack([basis, rest / size])
    return kept


def least_squares(X: np.ndarray, y: np.ndarray) -> np.ndarray:
    scale = np.maximum(np.linalg.norm(X, axis=0), 1e-300)
    return np.linalg.lstsq(X / scale, y, rcond=1e-10)[0] / scale


def covariance(X: np.ndarray, left: np.ndarray, cluster: np.ndarray) -> np.ndarray:
    """Covariance of the coefficients that takes residuals of one cluster as one (Liang and Zeger, 1986)."""
    scale = np.maximum(np.linalg.norm(X, axis=0), 1e-300)
    A = X / scale
    bread = np.linalg.pinv(A.T @ A)
    _, index = np.unique(cluster, return_inverse=True)
    scores = np.zeros((index.max() + 1, A.shape[1]))
    np.add.at(scores, index, A * left[:, None])
    count = len(scores)
    meat = scores.T @ scores * count / max(count - 1, 1)
    return bread @ meat @ bread / scale[:, None] / scale


def _of_joint(
    name: str, value: float, std: float, channel: str, joint: Joint, link: Mounting, alone: bool
) -> Coefficient:
    """A coefficient with what it says of the joint; torques of friction are those of the motor side.

    Args:
      link: the mounting of the recording.
      alone: whether another shape has the link's inertia, so that `inertia` is the rotor's alone.
    """
    calibration = Calibration(joint)
    records = [
        calibration.record(x, link)[0] for x in np.vstack([np.zeros(calibration.size), np.eye(calibration.size)])
    ]
    p = records[0]
    N, Kt, moment = float(p["N"]), float(p["Kt"]), float(p["Mg"]) or 1.0
    output = {"motor_current": N * Kt, "motor_torque": N, "joint_torque": 1.0}[channel]
    driven = channel != "joint_torque"
    offset = "current_offset" if channel == "motor_current" else "torque_offset"
    inertia: tuple[str, Callable[[np.void], float]] = ("inertia", lambda r: r["Jl"])
    if driven:
        inertia = (
            ("rotor_inertia" if alone else "inertia"),
            (lambda r: (not alone) * r["Jl"] + N * N * (r["Jm"] + r["Jw"])),
        )
    # Per shape: number of the joint, unit, its ratio to the coefficient, its described value.
    meanings: dict[str, tuple[str, str, float, Callable[[np.void], float]]] = {
        "gravity": ("gravity_moment", "N·m", moment * output, lambda r: r["Mg"]),
        "arm": ("arm_scale", "1", output, lambda r: r["arm_scale"]),
        "inertia": (inertia[0], "kg·m²", output, inertia[1]),
        "link inertia": ("link_inertia", "kg·m²", output * link.inertia, lambda r: r["Jl"]),
        "load friction": ("load_dependent_friction", "1", output, lambda r: r["friction_load"]),
        "offset": ("offset", CHANNELS[channel].unit, 1.0, lambda r: r[offset]),
        "Coulomb friction": ("link_friction", "N·m", 1.0, lambda r: r["link_friction"]),
        "viscous friction": ("link_damping", "N·m·s/rad", 1.0, lambda r: r["link_damping"]),
    }
    if driven:
        total = lambda r: r["bw"] + r["bm"] + r["bl"] / N**2  # noqa: E731
        meanings["Coulomb friction"] = ("Fc", "N·m", output / N, lambda r: r["Fc"])
        meanings["viscous friction"] = ("viscous", "N·m·s/rad", output / N**2, total)
    if channel == "motor_current" and value > 0.0:  # its number is the reciprocal of the coefficient
        meanings["sensor torque"] = ("Kt", "N·m/A", -1.0 / (N * value) / value, lambda r: r["Kt"])
    if name not in meanings:
        return Coefficient(name, value, std)
    means, unit, factor, of = meanings[name]
    described, *moved = (float(of(r)) for r in records)
    open_ = float(np.sqrt(np.sum((np.array(moved) - described) ** 2)))
    number = 1.0 / (N * value) if name == "sensor torque" else factor * value
    if name == "inertia" and alone and not driven:
        number += described
    return Coefficient(name, value, std, means, number, abs(factor) * std, described, open_, unit)


def _rms(x: np.ndarray) -> float:
    return float(np.sqrt(np.mean(x * x)))
