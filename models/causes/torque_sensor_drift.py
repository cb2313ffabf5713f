"""Drift of the torque sensor."""

from .base import Cause, CauseParameter, Requirements


class TorqueSensorDrift(Cause):
    name = "torque_sensor_drift"
    component = "sensor"
    sensor = "joint_torque"
    description = "the torque sensor's reading drifts with time"
    parameters = (CauseParameter("rate", "N·m/s", (-10.0, 10.0), ((-0.05, -0.02), (0.02, 0.05)), magnitude=True),)
    sets = {"rate": "torque_rate"}
    needs = ("joint_torque",)
    requires = Requirements(duration=5.0)
