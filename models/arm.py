"""Loads on a joint's link in addition to its mounting: the arm of a recording's joint, and payloads that it carries.

The numbers of an arm come from its MJCF by inverse dynamics: `models.arm_dynamics`.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Self

import numpy as np
from pydantic import Field, model_validator

from .files import Strict
from .joint_parts import Mounting
from .motion import differentiated
from .parameters import GRAVITY


class Carried(Strict):
    """A payload that is picked up and put down.

    Velocities do not jump: it has its carrier's when it is picked up and when it is put down.
    """

    start: Annotated[float, Field(ge=0)]
    """It is picked up [s]."""
    end: float | None = None
    """It is put down [s]; never by default."""

    @model_validator(mode="after")
    def _in_order(self) -> Self:
        if self.end is not None and self.end <= self.start:
            raise ValueError(f"end: expected a time after {self.start:g} s, got {self.end:g} s")
        return self

    def carried(self, time: np.ndarray) -> np.ndarray:
        """Return whether it is carried at times [s], shape (n,)."""
        return (time >= self.start) & (time < (np.inf if self.end is None else self.end))


def carried_at(payloads: Sequence[Carried], time: np.ndarray) -> np.ndarray:
    """Return whether each payload is carried at times [s], shape (payloads, n)."""
    return np.array([one.carried(time) for one in payloads], dtype=bool).reshape(len(payloads), len(time))


def pickups(payloads: Sequence[Carried], time: np.ndarray) -> Iterator[tuple[int, list[bool]]]:
    """Yield the samples at which payloads are picked up or put down, and whether each is carried from then on."""
    carried = carried_at(payloads, time)
    for k in np.flatnonzero(np.any(np.diff(carried, axis=1, prepend=False), axis=0)):
        yield int(k), carried[:, k].tolist()


class ArmPayload(Carried):
    """A payload on a body of an arm."""

    body: str
    """Body or site of the model; of links in series, the joint's name."""
    mass: Annotated[float, Field(ge=0)]
    """[kg]."""
    position: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Of its centre in the frame of the body or site [m]."""
    inertia: Annotated[float, Field(ge=0)] = 0.0
    """About any axis through its own centre [kg·m²]."""


class ArmSpec(Strict):
    """The arm of a joint, in a recording's YAML: `arm: {model: ur3e.xml, joint: shoulder_lift}`.

    `positions` [rad] of other joints at rest. Moving joints are columns `arm_<joint>_position`; the rest is as in the
    MJCF. Times of `payloads` are those of the recording's table.
    """

    model: str
    """MJCF or URDF of the arm, next to the recording."""
    joint: str
    """Its joint."""
    positions: dict[str, float] = {}
    """Angles [rad] of other joints at rest, by name."""
    payloads: tuple[ArmPayload, ...] = ()
    """Masses that the arm picks up and puts down."""


@dataclass(frozen=True)
class Load:
    """The effect of a moving arm on the link, at each sample; n samples."""

    inertia: np.ndarray  # shape (n,), about the joint's axis [kg·m²]
    # shape (n,), known torque on the link, positive forward [N·m]: of the other joints' motion, and the difference of
    # the weight from that of the recording's mounting
    torque: np.ndarray
    acceleration: np.ndarray  # of the joint, shape (n,), smoothed as the others' [rad/s²]

    def on(self, inertia: float) -> np.ndarray:
        """Return the torque [N·m] with the same effect on a link of constant inertia [kg·m²], shape (n,)."""
        return self.torque - (self.inertia - inertia) * self.acceleration


@dataclass(frozen=True)
class ArmRecord:
    """The arm of a recording."""

    spec: ArmSpec  # as in the YAML
    mjcf: str  # its masses and joints as an MJCF without files
    # angles of the other joints with a column, shape (n,) each [rad], by name of the joint
    positions: Mapping[str, np.ndarray]


def column(joint: str) -> str:
    """Return the name of the column with the angle of another joint of the arm."""
    return f"arm_{joint}_position"


def joint_of(name: str) -> str | None:
    """Return the joint of an angle's column; None for other columns."""
    inside = name.startswith("arm_") and name.endswith("_position") and len(name) > len("arm__position")
    return name[len("arm_") : -len("_position")] if inside else None


_LEVER = 0.25  # m: largest distance of the link's centre of mass from the axis


class PayloadSpec(Strict):
    """A payload on the link."""

    mass: Annotated[float, Field(ge=0)]
    """[kg]."""
    distance: Annotated[float, Field(ge=0)]
    """Of its centre from the axis [m]."""
    angle: float = 0.0
    """Of it against the link's own centre of mass [rad]."""
    inertia: Annotated[float, Field(ge=0)] = 0.0
    """About its own centre [kg·m²]."""

    @property
    def joint_inertia(self) -> float:
        """Inertia about the joint's axis [kg·m²]."""
        return self.mass * self.distance**2 + self.inertia

    @property
    def gravity_moment(self) -> float:
        """Gravity moment at horizontal [N·m]."""
        return self.mass * GRAVITY * self.distance

    def on(self, link: Mounting) -> Mounting:
        """Return the link with the payload: m g d adds to the gravity moment as a vector, m d² and `inertia` to the inertia."""
        whole = link.gravity_moment + self.gravity_moment * np.exp(1j * self.angle)
        turned = float(np.angle(whole)) if abs(whole) > 0 else 0.0
        return Mounting(
            inertia=link.inertia + self.joint_inertia,
            gravity_moment=float(abs(whole)),
            gravity_angle=link.gravity_angle + turned,
        )


class CarriedMass(PayloadSpec, Carried):
    """A payload that the link picks up and puts down."""


def link_mass(inertia: float, gravity_moment: float) -> tuple[float, float]:
    """Return a mass of a link [kg] and the distance of its centre from the axis [m], by its inertia about the axis
    [kg·m²] and its gravity moment [N·m]: a description has no more."""
    moment = gravity_moment / GRAVITY
    if moment <= 0.0:
        return 0.1, 0.0
    lever = min(_LEVER, 0.6 * inertia / moment)  # its own m r² is at most 60 % of the inertia
    return moment / lever, lever


def carrying(record: np.ndarray, payloads: Sequence[CarriedMass]) -> np.ndarray:
    """Return a joint's parameter record, shape (1,), with payloads on the rigid part of its link."""
    record = record.copy()
    p = record[0]
    flexible = p["flexible_share"] * p["Jl"]
    moment = complex(p["Mg"])
    for one in payloads:
        p["Jl"] += one.joint_inertia
        moment += one.gravity_moment * np.exp(1j * one.angle)
    p["Mg"] = abs(moment)
    p["gravity_angle"] += np.angle(moment)
    p["flexible_share"] = flexible / p["Jl"]
    return record


def load_of(
    payloads: Sequence[CarriedMass], link: Mounting, time: np.ndarray, position: np.ndarray, parts: Sequence[slice]
) -> Load:
    """Return the effect of payloads at each sample, shape (n,), on a link whose load without them is `link`; their
    times count as `time` does [s]. `position`: of the link [rad]; `parts`: samples between gaps."""
    inertia, torque, acceleration = np.full(len(time), link.inertia), np.zeros(len(time)), np.zeros(len(time))
    for one in payloads:
        on = one.carried(time)
        inertia += on * one.joint_inertia
        torque -= on * one.gravity_moment * np.sin(position + link.gravity_angle + one.angle)
    for part in parts:
        acceleration[part] = differentiated(time[part], position[part])[2]
    return Load(inertia, torque, acceleration)
