"""Offset of the torque sensor."""

from __future__ import annotations

import numpy as np

from .base import Cause, Parameter


class TorqueSensorOffset(Cause):
    """A constant is added to the torque sensor's reading."""

    name = "torque_sensor_offset"
    component = "sensor"
    description = "a constant is added to the torque sensor's reading"
    parameters = (Parameter("value", "N·m", (-100.0, 100.0), ((-0.6, -0.2), (0.2, 0.6)), magnitude=True),)
    needs = ("joint_torque",)

    def apply(self, p: np.void, values: dict[str, float]) -> None:
        p["torque_offset"] = values["value"]

    def present(self, p: np.void) -> dict[str, float]:
        """The record's own value, which the cause replaces."""
        return {"value": float(p["torque_offset"])}
