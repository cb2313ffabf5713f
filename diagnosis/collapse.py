"""A joint collapsed to what another simulator's joint can say, fitted to the joint's own behaviour, with what that costs.

Structures, each linear in what is fitted, for the current that a motion takes:

* `hinge`: N Kt i = armature q'' + damping q' + frictionloss sgn(q') + stiffness (q − springref) + load. One body, at the output.
  Stiffness only where the joint has a cable spring; no armature where the target has none (URDF).
* `two_bodies`: Kt i = J θm'' + b θm' + s g(θm') sgn(θm') − cogging + load/N. Rotor and link with a spring between them, whose
  torque is a polynomial of the torsion; g is the joint's Stribeck curve without load.

The load is the torque on the joint (inertia, weight, external torque). The target has separate bodies for it; here the joint's
laws compute it. Parameters are fitted to the current that the *joint's own laws* ask for on the motion (`fit.replay`), in
the blocks that every fit takes. Errors are against the *measured* current in the blocks kept from every fit
(`SegmentSettings.held_out_every`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import lsq_linear

from ..estimator.conditioning import as_logged
from ..models import laws
from ..models.calibration import drawn_changes, moved
from ..models.characteristics import friction, steady
from ..models.errors import InputError
from ..models.files import plain
from ..models.joint import Joint
from ..models.recording import Measurement, Recording
from .data.segments import CURRENT, Segment, decimate, segments
from .fit.replay import parallel, replay, transmission

STRUCTURES = ("hinge", "hinge_without_armature", "two_bodies")
_PARTS = 4  # into which the range of speed, load and angle is cut, to say where the error is worst
_FEWEST = 20  # samples of such a part
TIMESTEP = 1e-3
"""Of a written model of two bodies [s]."""
# of the rotor's inertia: MuJoCo's integration of a bristle's damping s1 acts as an inertia of a step times s1
_SHARE = 0.02


@dataclass(frozen=True)
class Worst:
    """Where the written model's error is largest: `by` speed, load or angle from `low` to `high` [unit]; RMS there [A]."""

    by: str
    low: float
    high: float
    unit: str
    rms: float


@dataclass(frozen=True)
class Collapse:
    """A joint as another simulator's structure says it.

    Parameters in SI: of a hinge at the output `armature` [kg·m²], `damping` [N·m·s/rad], `frictionloss` [N·m], `stiffness`
    [N·m/rad], `springref` [rad]. Of two bodies on the motor side: `inertia` [kg·m²], `damping` [N·m·s/rad], `Fc`, `Fs` [N·m],
    `vs` [rad/s], `s0`, `s1`; of the spring at the output `stiffness` (three coefficients, of x, x|x| and x³) and
    `spring_damping`. All: `N`, `torque_constant` N Kt [N·m/A], `torque_limit` [N·m], `speed_limit` [rad/s] at the output.
    """

    structure: str  # one of `STRUCTURES`
    parameters: dict[str, Any]
    full: float  # RMS error of the current [A] on held-out motion by the joint's own laws
    written: float  # the same of this structure, with the load on the joint by its laws
    nominal: float | None  # the same of the description that the measurement names; None if it is this joint
    worst: Worst | None
    samples: int  # that are held out
    visited: tuple[float, float]  # largest |speed| [rad/s] and |load| [N·m] of the motion, at the output
    draws: tuple[dict[str, Any], ...] = ()  # parameters of joints drawn from the uncertainty of this one

    @property
    def worse_than_nominal(self) -> bool:
        """Whether the description before identification predicts held-out motion better in the same structure."""
        return self.nominal is not None and self.written > self.nominal

    def to_json(self) -> dict[str, Any]:
        """As `flexspline export --json` prints it."""
        return {
            "structure": self.structure, "full": self.full, "written": self.written, "nominal": self.nominal, "unit": "A",
            "worse_than_nominal": self.worse_than_nominal, "samples": self.samples, "worst": plain(self.worst),
            "visited": {"speed": self.visited[0], "load": self.visited[1]}, "parameters": self.parameters,
        }  # fmt: skip


def collapse(measurement: Measurement, joint: Joint, structure: str, draws: int = 0, seed: int = 1) -> Collapse:
    """Fit a structure to a joint on a measurement's motion.

    Args:
      measurement: recordings with `motor_current` or `motor_torque`; its motion is visited.
      joint: the joint.
      structure: one of `STRUCTURES`.
      draws: number of joints drawn from the description's uncertainty, each fitted likewise.
      seed: of the draws.

    Raises:
      InputError: a measurement without current, or without motion in held-out blocks.
    """
    joint = as_logged(joint, measurement.recordings)
    motion = _motion(measurement, joint)
    one = motion.fitted(motion.records(joint), structure)
    before = measurement.load_joint() if measurement.recordings[0].joint else joint
    nominal = None
    if before.numbers != joint.numbers or before.effects != joint.effects:
        described = motion.fitted(motion.records(before), structure)
        nominal = _rms(described.written - described.measured)
    error = one.written - one.measured
    changes = drawn_changes(joint, draws, seed)
    drawn = ([moved(joint, s.mounting, change) for s in motion.segments] for change in changes)
    return Collapse(
        structure=structure,
        parameters=one.parameters,
        full=_rms(one.full - one.measured),
        written=_rms(error),
        nominal=nominal,
        worst=_worst(error, one),
        samples=len(error),
        visited=(float(np.max(np.abs(one.speed))), float(np.max(np.abs(one.load)))),
        draws=tuple(motion.fitted(records, structure).parameters for records in drawn),
    )


@dataclass(frozen=True)
class FeedForwardError:
    """RMS error of the current [A] on held-out motion, of inertia, load and friction, and of inertia and load alone."""

    with_friction: float
    without: float
    samples: int

    def to_json(self) -> dict[str, Any]:
        """As `flexspline joint friction --json` prints it."""
        return {"with": self.with_friction, "without": self.without, "unit": "A", "samples": self.samples}


def feed_forward_error(measurement: Measurement, joint: Joint) -> FeedForwardError:
    """How well the friction map of a joint (`models.characteristics`) says the current of a measured motion.

    Raises:
      InputError: a measurement without current, or without motion in held-out blocks.
    """
    motion = _motion(measurement, as_logged(joint, measurement.recordings))
    records = motion.records(joint)
    _, link = motion.replayed(records)
    held, p = motion.held, steady(records[0])[0]
    load = link[:, 3] + p["bl"] * link[:, 1]
    temperature = np.concatenate([decimate(s.temperature) for s in motion.segments])
    _, w, a = motion.rotor.T
    rest = (motion.measured - p["current_offset"] - ((p["Jm"] + p["Jw"]) * a + load / p["N"]) / p["Kt"])[held]
    points = np.column_stack([w / p["N"], load, temperature])[held]
    forward = np.array([friction(*point, p) for point in points]) / p["Kt"]
    return FeedForwardError(_rms(rest - forward), _rms(rest), len(rest))


@dataclass(frozen=True)
class _Fitted:
    """Currents on held-out motion, shape (k,) [A], and the motion: speed [rad/s], load [N·m], angle [rad] at the output."""

    parameters: dict[str, Any]
    measured: np.ndarray
    full: np.ndarray
    written: np.ndarray
    speed: np.ndarray
    load: np.ndarray
    angle: np.ndarray


class _Motion:
    """Segments of a measurement whose current is known."""

    def __init__(self, recordings: Sequence[Recording], joint: Joint, path: Path):
        found, _ = segments(list(recordings), joint)
        self.segments = [s for s in found if s.balances[CURRENT]]
        if not self.segments:
            raise InputError(f"{path}: expected a motion with motor_current or motor_torque, got none")
        kept = [~s.at_rest & s.usable[:, CURRENT] for s in self.segments]
        held = [~s.at_rest & s.held_out[:, CURRENT] for s in self.segments]
        if not (sum(map(np.sum, kept)) and sum(map(np.sum, held))):
            raise InputError(f"{path}: expected more than three seconds in motion, got less")
        self.kept, self.held = np.concatenate(kept), np.concatenate(held)
        self.rotor = np.concatenate([decimate(s.rotor) for s in self.segments])
        self.measured = np.concatenate([s.measured[:, CURRENT] for s in self.segments])

    def records(self, joint: Joint) -> list[np.ndarray]:
        """Return a joint's parameters with the load of each segment."""
        return [joint.record(s.mounting) for s in self.segments]

    def replayed(self, records: Sequence[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
        """Return `_replayed` of all segments, a record for each."""
        each = parallel(_replayed, list(zip(self.segments, records, strict=True)))
        current, motion = zip(*each, strict=True)
        return np.concatenate(current), np.concatenate(motion)

    def fitted(self, records: Sequence[np.ndarray], structure: str) -> _Fitted:
        """A structure fitted to the laws of a joint, a record for every segment."""
        full, link = self.replayed(records)
        q, v, _, load = link.T
        p = records[0][0]
        if structure == "two_bodies":
            columns, known = _two_bodies(self.rotor, load + p["bl"] * v, p)
            X = fitted = np.stack(columns, axis=1)
        else:
            # Fitted to the drive's own motion, as the link's does not have the rotor's acceleration; errors are on the link's.
            drive = np.column_stack([q, self.rotor[:, 1:] / p["N"]])
            fitted, X = (np.stack(_hinge(x, p, structure), axis=1) for x in (drive, link[:, :3]))
            known = load / p["N"] / p["Kt"]
        free = np.arange(X.shape[1]) == 4  # the spring's rest angle times its stiffness has either sign
        y = full - known - p["current_offset"]
        scale = np.linalg.norm(fitted[self.kept], axis=0) + 1e-300
        bounds = np.where(free, -np.inf, 0.0), np.inf
        fit = lsq_linear(fitted[self.kept] / scale, y[self.kept], bounds=bounds).x / scale
        written = X @ fit + known + p["current_offset"]
        named = _two_bodies_named if structure == "two_bodies" else _hinge_named
        held = self.held
        limits = {
            "N": float(p["N"]),
            "torque_constant": float(p["N"] * p["Kt"]),
            "torque_limit": float(p["N"] * p["Kt"] * p["current_limit"]),
            "speed_limit": float(p["supply_voltage"] / p["Kt"] / p["N"]),
        }
        visited = float(np.max(np.abs(load)))
        return _Fitted(
            named(fit, p, visited) | limits, self.measured[held], full[held], written[held],
            v[held], load[held], q[held],
        )  # fmt: skip

    def full_error(self, joint: Joint) -> float:
        """RMS error [A] of the current by the joint's own laws on held-out motion."""
        current, _ = self.replayed(self.records(joint))
        return _rms((current - self.measured)[self.held])


def _motion(measurement: Measurement, joint: Joint) -> _Motion:
    """A measurement's motion, driven at both ends, or by the rotor alone where the joint's laws then predict the current best."""
    recordings = list(measurement.recordings)
    both = [{"motor_position", "link_position"} <= set(r.columns) and r.external != "unmeasured" for r in recordings]
    ways = [recordings]
    if any(both):
        ways.append([r.without("link_position") if alone else r for r, alone in zip(recordings, both, strict=True)])
    motions = [_Motion(way, joint, measurement.path) for way in ways]
    return min(motions, key=lambda motion: motion.full_error(joint))


def _replayed(task: tuple[Segment, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Current [A], shape (k,), and the link's angle, velocity, acceleration and what it asks of the joint [N·m] without cable and
    stop, shape (k, 4), as a joint's laws have them."""
    segment, record = task
    p = record[0]
    inner = transmission(segment, record)
    q, v = inner["link_position"], inner["link_velocity"]
    cable = np.array([laws.link_torque(angle, p) for angle in q])
    load = inner["flexspline_torque"] - p["bl"] * v + cable
    motion = decimate(np.column_stack([q, v, inner["link_acceleration"], load]))
    return replay(segment, record, inner)[:, CURRENT], motion


def _hinge(motion: np.ndarray, p: np.void, structure: str) -> list[np.ndarray]:
    """Currents [A] of a unit of armature, damping, frictionloss and (where there is a cable) stiffness and its torque at zero."""
    q, v, a = motion.T
    per_torque = 1.0 / (p["N"] * p["Kt"])
    armature = a if structure == "hinge" else np.zeros_like(a)
    columns = [armature * per_torque, v * per_torque, np.sign(v) * per_torque]
    if p["cable_stiffness"] != 0.0:
        columns += [q * per_torque, np.full_like(a, per_torque)]
    return columns


def _hinge_named(found: np.ndarray, p: np.void, visited: float) -> dict[str, Any]:
    names = ("armature", "damping", "frictionloss", "stiffness")
    values = dict.fromkeys(names, 0.0) | {name: float(x) for name, x in zip(names, found, strict=False)}
    stiff = len(found) > 4 and values["stiffness"] > 0.0
    return values | {"springref": float(-found[4] / values["stiffness"]) if stiff else 0.0}


def _two_bodies(motion: np.ndarray, load: np.ndarray, p: np.void) -> tuple[list[np.ndarray], np.ndarray]:
    """Currents [A] of a unit of inertia, damping and the Stribeck curve; of what is known, shape (k,)."""
    theta, w, a = motion.T
    curve = p["Fc"] + (p["Fs"] - p["Fc"]) * np.exp(-((w / p["vs"]) ** 2))
    order, amplitude, phase = _cogging(p)
    known = load / p["N"] - amplitude * np.sin(order * theta + phase)
    return [a / p["Kt"], w / p["Kt"], curve * np.sign(w) / p["Kt"]], known / p["Kt"]


def _cogging(p: np.void) -> tuple[float, float, float]:
    """Order, amplitude [N·m] and phase [rad] of the largest cogging torque; the target has one."""
    k = int(np.argmax(np.abs(p["cogging_amplitude"])))
    return float(p["cogging_order"][k]), float(p["cogging_amplitude"][k]), float(p["cogging_phase"][k])


def _two_bodies_named(found: np.ndarray, p: np.void, visited: float) -> dict[str, Any]:
    inertia, damping, friction = (float(x) for x in found)
    torque = np.linspace(0.0, max(visited, float(p["T1"])), 101)[1:]
    torsion = np.array(
        [laws.flexspline_torsion(T, p) + laws.wave_generator_torsion(T / p["N"], p) / p["N"] for T in torque]
    )
    X = np.stack([torsion, torsion**2, torsion**3], axis=1)
    scale = np.linalg.norm(X, axis=0)
    spring = lsq_linear(X / scale, torque, bounds=(0.0, np.inf)).x / scale
    # The dampers in series at low frequency: what each loses, by its share of the torsion.
    K = float(spring[0])
    at = p["N"] ** 2 * p["Kw0"]
    series = K**2 * (p["df"] / p["K1"] ** 2 + p["N"] ** 2 * p["dw"] / at**2)
    order, amplitude, phase = _cogging(p)
    return {
        "inertia": inertia, "damping": damping, "Fc": friction * float(p["Fc"]), "Fs": friction * float(p["Fs"]),
        "vs": float(p["vs"]), "s0": float(p["s0"]), "s1": min(float(p["s1"]), _SHARE * inertia / TIMESTEP),
        "stiffness": [float(x) for x in spring],
        "spring_damping": float(series), "Kt": float(p["Kt"]), "R": float(p["R"]),
        "L": float(p["L"]), "supply_voltage": float(p["supply_voltage"]),
        "current_limit": float(p["current_limit"]), "cogging": [amplitude, order, phase], "link_damping": float(p["bl"]),
    }  # fmt: skip


def _worst(error: np.ndarray, one: _Fitted) -> Worst | None:
    """The part of the range of speed, load or angle with the largest RMS error."""
    found = []
    for by, x, unit in (("speed", np.abs(one.speed), "rad/s"), ("load", one.load, "N·m"), ("angle", one.angle, "rad")):
        ends = np.linspace(np.min(x), np.max(x), _PARTS + 1)
        for low, high in pairwise(ends):
            inside = (x >= low) & (x <= high)
            if np.sum(inside) >= _FEWEST:
                found.append(Worst(by, float(low), float(high), unit, _rms(error[inside])))
    return max(found, key=lambda w: w.rms, default=None)


def _rms(x: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.square(x))))
