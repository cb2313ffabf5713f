"""Rotor inertia."""

from __future__ import annotations

import numpy as np

from .base import Cause, Parameter


class RotorInertia(Cause):
    """The rotor's inertia differs."""

    name = "rotor_inertia"
    component = "motor"
    description = "the rotor's inertia differs"
    parameters = (Parameter("value", "kg·m²", (1e-9, 1.0), ((2.0, 3.5),), relative="Jm", neutral=1.0, magnitude=True),)

    def apply(self, p: np.void, values: dict[str, float]) -> None:
        p["Jm"] = values["value"]
