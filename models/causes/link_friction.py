"""Friction of the output bearing or a seal."""

from .base import Cause, CauseParameter, Requirements


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
