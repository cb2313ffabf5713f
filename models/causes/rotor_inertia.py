"""Rotor inertia."""

from .base import Cause, CauseParameter, Requirements


class RotorInertia(Cause):
    name = "rotor_inertia"
    component = "motor"
    description = "the rotor's inertia differs"
    parameters = (
        CauseParameter("value", "kg·m²", (1e-9, 1.0), ((2.0, 3.5),), relative="Jm", neutral=1.0, magnitude=True),
    )
    sets = {"value": "Jm"}
    requires = Requirements(sliding=0.5, speed=10.0)
