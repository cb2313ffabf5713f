"""Hysteresis of the flexspline."""

from __future__ import annotations

import numpy as np

from .base import Cause, Parameter


class Hysteresis(Cause):
    """Dahl friction acts across the flexspline: Tf + F z/x, z' = v − |v| z/x with v = Δθf'."""

    name = "hysteresis"
    component = "transmission"
    description = "Dahl friction acts across the flexspline: Tf + F z/x, z' = v − |v| z/x with v = Δθf'"
    parameters = (
        Parameter("torque", "N·m", (0.0, 20.0), ((0.6, 1.5),), magnitude=True),
        Parameter("extent", "rad", (5e-6, 2e-3), ((50e-6, 120e-6),)),
    )

    def apply(self, p: np.void, values: dict[str, float]) -> None:
        p["hysteresis_torque"] = values["torque"]
        p["hysteresis_extent"] = values["extent"]
