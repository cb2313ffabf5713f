"""Offset of the torque sensor."""

from .base import Cause, CauseParameter


class TorqueSensorOffset(Cause):
    name = "torque_sensor_offset"
    component = "sensor"
    sensor = "joint_torque"
    description = "a constant is added to the torque sensor's reading"
    parameters = (CauseParameter("value", "N·m", (-100.0, 100.0), ((-0.6, -0.2), (0.2, 0.6)), magnitude=True),)
    sets = {"value": "torque_offset"}
    needs = ("joint_torque",)
