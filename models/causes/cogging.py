"""Cogging of the motor."""

from __future__ import annotations

import numpy as np

from .base import Cause, Parameter


class Cogging(Cause):
    """A torque periodic in the rotor angle, A sin(n θm + φ), acts on the rotor."""

    name = "cogging"
    component = "motor"
    description = "a torque periodic in the rotor angle, A sin(n θm + φ), acts on the rotor"
    parameters = (
        Parameter("order", "1", (1, 64), ((2, 13),), integer=True),
        Parameter("amplitude", "N·m", (0.0, 0.1), ((4e-3, 10e-3),), magnitude=True),
        Parameter(
            "phase",
            "rad",
            (-6.283185307179586, 6.283185307179586),
            ((0.0, 6.283185307179586),),
            period=6.283185307179586,
        ),
    )

    def apply(self, p: np.void, values: dict[str, float]) -> None:
        slot = int(np.flatnonzero(p["cogging_amplitude"] == 0)[0])
        p["cogging_order"][slot] = values["order"]
        p["cogging_amplitude"][slot] = values["amplitude"]
        p["cogging_phase"][slot] = values["phase"]
