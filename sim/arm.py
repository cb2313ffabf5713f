"""Joints in series: one MuJoCo model of several joints, on each other's links or on the hinges of a user's arm.

In `build`, a joint's axis is perpendicular to its link, which points straight down at zero; `turn` rotates it about the link
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

from ..models.arm import ArmPayload
from ..models.arm_dynamics import numbers, put_payloads, weigh
from ..models.errors import refusing
from ..models.joint import Joint
from ..models.parameters import GRAVITY
from . import native, plant
from .attach import MASSLESS, attach_record
from .shape import shape


@dataclass(frozen=True)
class ArmJoint:
    """A joint of an arm."""

    name: str  # in the arm
    joint: Joint  # its description
    record: np.ndarray  # parameters with its load, shape (1,); on a user's arm, its load is that of the arm's bodies
    length: float = 0.0  # from its axis to the next joint's, along its link [m]
    turn: float = 0.0  # of its axis about the link before it, against that one's axis [rad]

    @property
    def prefix(self) -> str:
        """Prefix of its names in the model."""
        return f"{self.name}_"


def build(
    joints: Sequence[ArmJoint],
    timestep: float = plant.TIMESTEP,
    ideal_current: bool = False,
    payloads: Sequence[ArmPayload] = (),
    carried: Sequence[bool] = (),
) -> mujoco.MjModel:
    """Build the MuJoCo model of joints in series, from the base to the tip, otherwise as `plant.build`; names begin
    with `ArmJoint.prefix`. `payloads`: on links, by their joint's name; `carried`: whether each is carried. Raises
    `InputError`: an invalid MJCF."""
    arm = mujoco.MjSpec()
    at = arm.worldbody
    for i, one in enumerate(joints):
        shape(one.joint)
        spec = plant.describe(one.record, timestep, ideal_current)
        for name in ("rotor", "wave_generator", "flange"):
            spec.body(name).mass = MASSLESS
        if i == 0:
            for option in ("timestep", "integrator", "gravity", "disableflags"):
                setattr(arm.option, option, getattr(spec.option, option))
        else:
            for light in spec.lights:
                spec.delete(light)
        place = [0.0, 0.0, -joints[i - 1].length] if i else [0.0, 0.0, 0.0]
        with refusing(f"{one.joint.mjcf}: cannot be part of an arm"):
            arm.attach(spec, prefix=one.prefix, frame=at.add_frame(pos=place, quat=_about_z(one.turn)))
        at = arm.body(one.prefix + "link")
    on_links = [one.model_copy(update={"body": f"{one.body}_link"}) for one in payloads]
    weigh(put_payloads(arm, on_links, ""), payloads, carried)
    with native.quiet():
        return arm.compile()


def on_hinges(
    mjcf: str,
    joints: Sequence[ArmJoint],
    timestep: float = plant.TIMESTEP,
    payloads: Sequence[ArmPayload] = (),
    carried: Sequence[bool] = (),
) -> mujoco.MjModel:
    """Build the MuJoCo model of joints, by the names of their hinges, on those of an arm (`attach.attach`); `mjcf`: as
    of `models.arm_dynamics.reduced`; `carried`: whether each payload is carried. Raises `InputError`: as `attach.attach`.

    A wrench sensor is in each hinge: its y axis is opposite to the hinge's, as in a single joint, and its z axis points
    away from the link's centre of mass.
    """
    spec = mujoco.MjSpec.from_string(mjcf)
    plant.set_options(spec, timestep)
    bodies = put_payloads(spec, payloads, "")
    centres = spec.compile().body_ipos
    for one in joints:
        hinge, site = spec.joint(one.name), one.prefix + "force_torque"
        hinge.parent.add_site(name=site, pos=hinge.pos, quat=_sensing(hinge, centres[hinge.parent.id]))
        for name, kind in (("force", mujoco.mjtSensor.mjSENS_FORCE), ("torque", mujoco.mjtSensor.mjSENS_TORQUE)):
            spec.add_sensor(name=one.prefix + name, type=kind, objtype=mujoco.mjtObj.mjOBJ_SITE, objname=site)
        attach_record(spec, one.name, one.record)
    weigh(bodies, payloads, carried)
    with native.quiet():
        return spec.compile()


def _sensing(hinge: mujoco.MjsJoint, centre: np.ndarray) -> np.ndarray:
    """Return the orientation of a hinge's wrench sensor, shape (4,); `centre`: of the link's mass."""
    y = -hinge.axis / np.linalg.norm(hinge.axis)
    rough = [hinge.pos - centre, *np.eye(3)]
    across = [one - (one @ y) * y for one in rough]
    z = next(one for one, whole in zip(across, rough, strict=True) if one @ one > 1e-6 * (whole @ whole))
    z = z / np.linalg.norm(z)
    quat = np.zeros(4)
    mujoco.mju_mat2Quat(quat, np.stack([np.cross(y, z), y, z], axis=1).ravel())
    return quat


def rigid(joints: Sequence[ArmJoint]) -> str:
    """Return the arm's links without drives, as the text of an MJCF, for a recording (`models.arm`); `joints`: with
    their known records; a flexible part counts as rigid."""
    root = ElementTree.Element("mujoco", model="arm")
    ElementTree.SubElement(root, "compiler", angle="radian")
    ElementTree.SubElement(root, "option", gravity=f"0 0 {-GRAVITY!r}")
    parent = ElementTree.SubElement(root, "worldbody")
    for i, one in enumerate(joints):
        p = one.record[0]
        mass, lever = plant.link_mass(p)
        drop = joints[i - 1].length if i else 0.0
        place = {"pos": numbers([0.0, 0.0, -drop])} | ({"quat": numbers(_about_z(one.turn))} if one.turn else {})
        parent = ElementTree.SubElement(parent, "body", place, name=one.name)
        ElementTree.SubElement(parent, "joint", name=one.name, axis="0 -1 0")
        angle, about_mass = float(p["gravity_angle"]), float(p["Jl"]) - mass * lever**2
        ElementTree.SubElement(
            parent, "inertial", pos=numbers([lever * np.sin(angle), 0.0, -lever * np.cos(angle)]), mass=numbers(mass),
            diaginertia=numbers([about_mass] * 3),
        )  # fmt: skip
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode") + "\n"


def _about_z(angle: float) -> list[float]:
    return [float(np.cos(0.5 * angle)), 0.0, 0.0, float(np.sin(0.5 * angle))]
