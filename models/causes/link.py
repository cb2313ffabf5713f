"""Causes at the link and its load."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from ..parameters import GRAVITY
from .base import Cause, CauseParameter, Requirements

if TYPE_CHECKING:
    from ..joint import Joint


class ArmLoad(Cause):
    """The torque of the links' weight, inertia and motion comes from an MJCF file. Ordinary: masses 8 to 20 % off."""

    name = "arm_load"
    component = "link"
    description = "all masses of the arm's model are scaled"
    parameters = (
        CauseParameter("scale", "1", (0.05, 20.0), ((0.80, 0.92), (1.08, 1.20)), neutral=1.0, magnitude=True),
    )
    scales = ("arm_scale", "Jl", "Mg")
    adds = True
    multiple = 5.0
    requires = Requirements(arm=True)


class CableSpring(Cause):
    name = "cable_spring"
    component = "link"
    description = "a cable pulls at the link like a spring: −k (θl − θ0)"
    parameters = (
        CauseParameter("stiffness", "N·m/rad", (0.0, 1e3), ((0.5, 1.5),), magnitude=True),
        CauseParameter("rest_angle", "rad", (-7.0, 7.0), ((-0.6, 0.6),)),
    )
    sets = {"stiffness": "cable_stiffness", "rest_angle": "cable_rest"}
    requires = Requirements(link_travel=0.5, known_push=True)


class GravityDirection(Cause):
    """The link's centre of mass, or the joint against the world, is turned: −Mg sin(θl + gravity_angle + angle)."""

    name = "gravity_direction"
    component = "link"
    description = "gravity acts at another angle than described: −Mg sin(θl + angle)"
    adds = True
    requires = Requirements(link_travel=0.5, known_push=True, gravity=True)
    parameters = (CauseParameter("angle", "rad", (-1.6, 1.6), ((-0.2, -0.08), (0.08, 0.2)), magnitude=True),)

    def apply(self, p: np.void, values: dict[str, float]) -> None:
        p["gravity_angle"] += values["angle"]

    def concerns(self, joint: Joint) -> bool:
        """Only a joint with a stated direction of gravity may have it wrong; a diagnosis of a log states one."""
        return joint.gravity_angle is not None


class GravityMoment(Cause):
    name = "gravity_moment"
    component = "link"
    description = "the link's gravity moment differs"
    parameters = (
        CauseParameter("scale", "1", (0.05, 10.0), ((0.80, 0.92), (1.08, 1.20)), neutral=1.0, magnitude=True),
    )
    scales = ("Mg",)
    adds = True
    multiple = 3.0
    requires = Requirements(link_travel=0.5, known_push=True, gravity=True)


class HardStop(Cause):
    name = "hard_stop"
    component = "link"
    description = "the link runs into a stop: −k (θl − θs) beyond the angle θs"
    parameters = (
        CauseParameter("angle", "rad", (-7.0, 7.0), ((0.6, 1.0),)),
        CauseParameter("stiffness", "N·m/rad", (0.0, 1e5), ((15.0, 40.0),), magnitude=True),
    )
    sets = {"angle": "stop_angle", "stiffness": "stop_stiffness"}
    requires = Requirements(link_beyond=0.6, known_push=True)


class LinkFlexibility(Cause):
    """Part of the link's inertia is connected by a spring: a second resonance.

    J_s (φ'' + θl'') = −k φ − d φ' with J_s = share · Jl; frequency and damping ratio are those with the link held.
    Ordinary: a slender tool or a payload in a rubber grip, near the joint's own resonance (19 Hz with the test
    joint's link), damped as metal and rubber are.
    """

    name = "link_flexibility"
    component = "link"
    imperfection = True
    description = "part of the link's inertia is connected by a spring: a second resonance"
    parameters = (
        CauseParameter("share", "1", (0.0, 0.9), ((0.15, 0.4),), magnitude=True),
        # From damping that is broad enough for the next frequency to be within reach.
        CauseParameter(
            "frequency", "Hz", (1.0, 200.0), ((10.0, 25.0),), starts=(10.0, 11.7, 13.6, 15.8, 18.4, 21.4, 25.0)
        ),
        CauseParameter("damping", "1", (1e-3, 0.5), ((0.01, 0.05),), starts=(0.05,)),
    )
    sets = {"share": "flexible_share", "frequency": "flexible_frequency", "damping": "flexible_damping"}
    behind_link_encoder = "it is faster than the rotor's motion that the link's encoder shows"
    resonance = True
    requires = Requirements(known_push=True)


class LinkFriction(Cause):
    """Ordinary: 2 to 5 % of the rated torque of the test joint, as bearings, seals and hoses have."""

    name = "link_friction"
    component = "link"
    description = "friction acts on the link beyond the torque sensor: −F sgn(θl') − c θl'"
    parameters = (
        CauseParameter("torque", "N·m", (0.0, 1e3), ((0.3, 0.8),), magnitude=True),
        CauseParameter("coefficient", "N·m·s/rad", (0.0, 1e3), ((0.05, 0.4),), magnitude=True),
    )
    sets = {"torque": "link_friction", "coefficient": "link_damping"}
    needs = ("joint_torque",)
    requires = Requirements(reversal=True, link_travel=0.1)


class LinkInertia(Cause):
    name = "link_inertia"
    component = "link"
    description = "the link's inertia differs"
    parameters = (CauseParameter("scale", "1", (0.05, 20.0), ((1.5, 2.2),), neutral=1.0, magnitude=True),)
    scales = ("Jl",)
    adds = True
    multiple = 5.0
    requires = Requirements(known_push=True)


class Payload(Cause):
    """A mass on the link that is missing in its description: −m g d sin(θl + gravity_angle + angle), and m d² of
    inertia.

    The angle is that of the mass against the link's own centre of mass, seen from the axis. Gravity shows the product
    of mass and distance, inertia that of mass and distance squared. Ordinary: a tool or a part of 0.3 to 1 kg in the
    hand of an arm of the test joint's size (9 N·m, 0.35 kg·m²), 0.2 to 0.4 m from the axis.
    """

    name = "payload"
    component = "link"
    description = "an unknown mass on the link: gravity moment and inertia grow together"
    adds = True
    requires = Requirements(link_travel=0.5, known_push=True)
    parameters = (
        CauseParameter("mass", "kg", (0.0, 100.0), ((0.3, 1.0),), magnitude=True),
        CauseParameter("distance", "m", (0.01, 3.0), ((0.2, 0.4),), neutral=0.3),
        CauseParameter("angle", "rad", (-3.2, 3.2), ((-0.3, 0.3),)),
    )

    def apply(self, p: np.void, values: dict[str, float]) -> None:
        moment = values["mass"] * GRAVITY * values["distance"]
        along = p["Mg"] + moment * math.cos(values["angle"])
        across = moment * math.sin(values["angle"])
        p["Mg"] = math.hypot(along, across)
        if p["Mg"] > 0.0:
            p["gravity_angle"] += math.atan2(across, along)
        p["Jl"] += values["mass"] * values["distance"] ** 2
