"""Viscous friction."""

from .base import Cause, CauseParameter, Requirements


class ViscousFriction(Cause):
    name = "viscous_friction"
    component = "transmission"
    description = "the mesh's viscous friction bw differs"
    parameters = (
        CauseParameter(
            "coefficient", "N·m·s/rad", (0.0, 0.1), ((3.0, 7.0),), relative="bw", neutral=1.0, magnitude=True
        ),
    )
    sets = {"coefficient": "bw"}
    # Real friction grows less than linearly: as speed to the power 0.7 to 0.9 it is 10 to 30 % less at speed.
    inexact = 0.1
    requires = Requirements(sliding=0.5, speed=10.0)
