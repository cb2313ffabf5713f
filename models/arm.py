"""The arm of a recording's joint, and the arm's effect on the joint's link.

The numbers come from the arm's MJCF by inverse dynamics: `models.arm_dynamics`.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Self

import numpy as np
from pydantic import Field, model_validator

from .files import Strict


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
