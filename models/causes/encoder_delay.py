"""Delay of the link encoder."""

from .base import Cause, CauseParameter, Requirements


class EncoderDelay(Cause):
    name = "encoder_delay"
    component = "sensor"
    sensor = "link_position"
    description = "the link encoder's reading comes late"
    parameters = (CauseParameter("seconds", "s", (0.0, 0.09), ((4e-3, 11e-3),), magnitude=True),)
    sets = {"seconds": "link_delay"}
    requires = Requirements(speed=10.0)
    torsion = True
