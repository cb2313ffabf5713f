"""Load that an arm puts on the joint."""

from .base import Cause, CauseParameter, Requirements


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
