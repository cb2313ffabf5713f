"""Load that an arm puts on the joint."""

from __future__ import annotations

from .base import Cause, CauseParameter, Requirements


class ArmLoad(Cause):
    """What the arm's mass model puts on the joint is scaled.

    The torque of the other links' weight, inertia and motion comes from an MJCF file. Ordinary: masses 8 to 20 % off.
    """

    name = "arm_load"
    component = "link"
    description = "what the arm's mass model puts on the joint is scaled"
    parameters = (
        CauseParameter("scale", "1", (0.05, 20.0), ((0.80, 0.92), (1.08, 1.20)), neutral=1.0, magnitude=True),
    )
    sets = {"scale": "arm_scale"}
    multiple = 5.0
    requires = Requirements(arm=True)
