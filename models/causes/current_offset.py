"""Offset of the current sensor."""

from .base import Cause, CauseParameter


class CurrentOffset(Cause):
    name = "current_offset"
    component = "sensor"
    sensor = "motor_current"
    description = "a constant is added to the current reading"
    parameters = (CauseParameter("value", "A", (-10.0, 10.0), ((-0.15, -0.05), (0.05, 0.15)), magnitude=True),)
    sets = {"value": "current_offset"}
