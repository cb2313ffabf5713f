"""Gain of the torque sensor."""

from .base import Cause, CauseParameter, Requirements


class TorqueSensorGain(Cause):
    name = "torque_sensor_gain"
    component = "sensor"
    sensor = "joint_torque"
    description = "the torque sensor's reading is scaled"
    parameters = (CauseParameter("gain", "1", (0.05, 20.0), ((0.80, 0.92), (1.08, 1.20)), neutral=1.0, magnitude=True),)
    sets = {"gain": "torque_gain"}
    needs = ("joint_torque",)
    requires = Requirements(weighed=True)
