"""Joints in series: one MuJoCo model of several joints, each on the link of the one before.

A joint's axis is perpendicular to its link, which points straight down at zero; `turn` rotates it about the link
before it against that one's axis. An arm of parallel axes moves in a vertical plane. A joint's `Mounting` is its link
with all that is fixed to it, including housing and motor of the next joint: rotors and wave generators have inertia
about their axis and no mass. A mounting states inertia Jl and gravity moment Mg but no mass; the link's is
`plant.link_mass`, which loads the joints before it.

The rotors turn with their links, as real ones do. That couples the joints by Jm θ̈, a hundredth of the torque of a
rotor when its own joint moves; the equations of a single joint (`models.dynamics`) do not have it.
"""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from ..models.errors import InputError
from ..models.joint import Joint
from ..models.parameters import GRAVITY
from . import native, plant
from .shape import shape

_MASSLESS = 1e-9  # kg: MuJoCo needs a mass


@dataclass(frozen=True)
class ArmJoint:
    """A joint of an arm.

    Attributes:
      name: in the arm.
      joint: its description.
      record: parameters with its load, shape (1,).
      length: from its axis to the next joint's, along its link [m].
      turn: of its axis about the link before it, against that one's axis [rad].
    """

    name: str
    joint: Joint
    record: np.ndarray
    length: float
    turn: float = 0.0

    @property
    def prefix(self) -> str:
        """Prefix of its names in the model."""
        return f"{self.name}_"


def build(joints: Sequence[ArmJoint], timestep: float = plant.TIMESTEP, ideal_current: bool = False) -> mujoco.MjModel:
    """Build the MuJoCo model of joints in series.

    Args:
      joints: from the base to the tip, at least one.
      timestep: step of the integrator [s].
      ideal_current: as in `plant.build`.

    Returns:
      The model. Coordinates and activations as of `plant.build`, joint by joint; names begin with `ArmJoint.prefix`.

    Raises:
      InputError: an invalid MJCF.
    """
    arm = mujoco.MjSpec()
    at = arm.worldbody
    for i, one in enumerate(joints):
        shape(one.joint)
        spec = plant.describe(one.record, timestep, ideal_current)
        for name in ("rotor", "wave_generator", "flange"):
            spec.body(name).mass = _MASSLESS
        if i == 0:
            for option in ("timestep", "integrator", "gravity", "disableflags"):
                setattr(arm.option, option, getattr(spec.option, option))
        else:
            for light in spec.lights:
                spec.delete(light)
        place = [0.0, 0.0, -joints[i - 1].length] if i else [0.0, 0.0, 0.0]
        try:
            arm.attach(spec, prefix=one.prefix, frame=at.add_frame(pos=place, quat=_about_z(one.turn)))
        except ValueError as error:
            raise InputError(f"{one.joint.mjcf}: cannot be part of an arm: {' '.join(str(error).split())}") from error
        at = arm.body(one.prefix + "link")
    with native.quiet():
        return arm.compile()


def rigid(joints: Sequence[ArmJoint]) -> str:
    """Return the arm's links without drives, as the text of an MJCF, for a recording (`models.arm`).

    Args:
      joints: with their known records; a flexible part counts as rigid.
    """
    root = ElementTree.Element("mujoco", model="arm")
    ElementTree.SubElement(root, "compiler", angle="radian")
    ElementTree.SubElement(root, "option", gravity=f"0 0 {-GRAVITY!r}")
    parent = ElementTree.SubElement(root, "worldbody")
    for i, one in enumerate(joints):
        p = one.record[0]
        mass, lever = plant.link_mass(p)
        drop = joints[i - 1].length if i else 0.0
        place = {"pos": _numbers(0.0, 0.0, -drop)} | ({"quat": _numbers(*_about_z(one.turn))} if one.turn else {})
        parent = ElementTree.SubElement(parent, "body", place, name=one.name)
        ElementTree.SubElement(parent, "joint", name=one.name, axis="0 -1 0")
        angle, about_mass = float(p["gravity_angle"]), float(p["Jl"]) - mass * lever**2
        ElementTree.SubElement(
            parent, "inertial", pos=_numbers(lever * np.sin(angle), 0.0, -lever * np.cos(angle)), mass=_numbers(mass),
            diaginertia=_numbers(*[about_mass] * 3),
        )  # fmt: skip
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode") + "\n"


def _about_z(angle: float) -> list[float]:
    return [float(np.cos(0.5 * angle)), 0.0, 0.0, float(np.sin(0.5 * angle))]


def _numbers(*values: float) -> str:
    return " ".join(repr(float(x)) for x in values)
