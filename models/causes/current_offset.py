"""Offset of the current sensor."""

from __future__ import annotations

import numpy as np

from .base import Cause, Parameter


class CurrentOffset(Cause):
    """A constant is added to the current reading."""

    name = "current_offset"
    component = "sensor"
    description = "a constant is added to the current reading"
    parameters = (Parameter("value", "A", (-10.0, 10.0), ((-0.15, -0.05), (0.05, 0.15)), magnitude=True),)

    def apply(self, p: np.void, values: dict[str, float]) -> None:
        p["current_offset"] = values["value"]

    def present(self, p: np.void) -> dict[str, float]:
        """The record's own value, which the cause replaces."""
        return {"value": float(p["current_offset"])}
