"""Gain of the torque sensor."""

from __future__ import annotations

import numpy as np

from .base import Cause, Parameter


class TorqueSensorGain(Cause):
    """The torque sensor's reading is scaled."""

    name = "torque_sensor_gain"
    component = "sensor"
    description = "the torque sensor's reading is scaled"
    parameters = (Parameter("gain", "1", (0.05, 20.0), ((0.80, 0.92), (1.08, 1.20)), neutral=1.0, magnitude=True),)
    needs = ("joint_torque",)

    def apply(self, p: np.void, values: dict[str, float]) -> None:
        p["torque_gain"] = values["gain"]

    def present(self, p: np.void) -> dict[str, float]:
        """The record's own value, which the cause replaces."""
        return {"gain": float(p["torque_gain"])}
