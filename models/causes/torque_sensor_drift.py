"""Drift of the torque sensor."""

from __future__ import annotations

import numpy as np

from .base import Cause, Parameter


class TorqueSensorDrift(Cause):
    """The torque sensor's reading drifts with time."""

    name = "torque_sensor_drift"
    component = "sensor"
    description = "the torque sensor's reading drifts with time"
    parameters = (Parameter("rate", "N·m/s", (-10.0, 10.0), ((-0.05, -0.02), (0.02, 0.05)), magnitude=True),)
    needs = ("joint_torque",)

    def apply(self, p: np.void, values: dict[str, float]) -> None:
        p["torque_rate"] = values["rate"]
