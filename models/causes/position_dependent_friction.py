"""Friction that depends on the link angle."""

from __future__ import annotations

import numpy as np

from .base import Cause, Parameter


class PositionDependentFriction(Cause):
    """Mesh friction is periodic in the link angle: g(w) + A sin(n θl + φ)."""

    name = "position_dependent_friction"
    component = "transmission"
    description = "mesh friction is periodic in the link angle: g(w) + A sin(n θl + φ)"
    parameters = (
        Parameter("order", "1", (1, 32), ((1, 3),), integer=True),
        Parameter("amplitude", "N·m", (0.0, 0.1), ((6e-3, 12e-3),), magnitude=True),
        Parameter(
            "phase",
            "rad",
            (-6.283185307179586, 6.283185307179586),
            ((0.0, 6.283185307179586),),
            period=6.283185307179586,
        ),
    )

    def apply(self, p: np.void, values: dict[str, float]) -> None:
        slot = int(np.flatnonzero(p["friction_amplitude"] == 0)[0])
        p["friction_order"][slot] = values["order"]
        p["friction_amplitude"][slot] = values["amplitude"]
        p["friction_phase"][slot] = values["phase"]
