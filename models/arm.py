"""What a recording says of the arm that its joint is part of, and what that arm puts on the joint's link.

The numbers come from the arm's MJCF by inverse dynamics: `models.arm_dynamics`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from .files import Strict


class ArmSpec(Strict):
    """The arm that a joint is part of, in a recording's YAML: `arm: {model: ur3e.xml, joint: shoulder_lift}`.

    `positions` [rad] of other joints that hold still; those that move are columns `arm_<joint>_position`, and the rest is
    where the MJCF has it.
    """

    model: str
    """MJCF of the arm, beside the recording."""
    joint: str
    """Which of its joints this is."""
    positions: dict[str, float] = {}
    """Angles [rad] of other joints that hold still, by name."""


@dataclass(frozen=True)
class Load:
    """What an arm in motion puts on the link, at each sample; n samples.

    Attributes:
      inertia: shape (n,), about the joint's axis [kg·m²].
      torque: shape (n,), known torque on the link, positive forward [N·m]: what the other joints' motion does, and by how much
        the weight differs from that of the recording's mounting.
      acceleration: of the joint itself, shape (n,), smoothed as the others' are [rad/s²].
    """

    inertia: np.ndarray
    torque: np.ndarray
    acceleration: np.ndarray

    def at(self, samples: slice | np.ndarray) -> Load:
        """The same at some of the samples."""
        return Load(self.inertia[samples], self.torque[samples], self.acceleration[samples])

    def on(self, inertia: float) -> np.ndarray:
        """Torque [N·m] that on a link of constant inertia [kg·m²] has the same effect, shape (n,)."""
        return self.torque - (self.inertia - inertia) * self.acceleration


@dataclass(frozen=True)
class ArmRecord:
    """The arm of a recording.

    Attributes:
      spec: as it stands in the YAML.
      mjcf: its masses and joints as an MJCF of its own, without files.
      positions: angles of the other joints that have a column, shape (n,) each [rad], by name of the joint.
    """

    spec: ArmSpec
    mjcf: str
    positions: Mapping[str, np.ndarray]

    def at(self, samples: slice | np.ndarray) -> ArmRecord:
        """The same at some of the samples."""
        return replace(self, positions={name: angle[samples] for name, angle in self.positions.items()})


def column(joint: str) -> str:
    """Name of the column that holds the angle of another joint of the arm."""
    return f"arm_{joint}_position"


def joint_of(name: str) -> str | None:
    """The joint whose angle a column holds; None where the column is none of an arm's."""
    inside = name.startswith("arm_") and name.endswith("_position") and len(name) > len("arm__position")
    return name[len("arm_") : -len("_position")] if inside else None
