"""Warm-up of the friction."""

from __future__ import annotations

import numpy as np

from .base import Cause, Parameter


class FrictionDrift(Cause):
    """Mesh friction warms up: g(w)·(1 + A exp(−t/T)) from the recording's start."""

    name = "friction_drift"
    component = "transmission"
    description = "mesh friction warms up: g(w)·(1 + A exp(−t/T)) from the recording's start"
    parameters = (
        Parameter("amplitude", "1", (-0.9, 10.0), ((0.8, 1.6),), magnitude=True),
        Parameter("time_constant", "s", (0.5, 300.0), ((6.0, 15.0),)),
    )

    def apply(self, p: np.void, values: dict[str, float]) -> None:
        p["drift_amplitude"] = values["amplitude"]
        p["drift_time"] = values["time_constant"]
