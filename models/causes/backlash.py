"""Backlash."""

from __future__ import annotations

import numpy as np

from .base import Cause, Parameter


class Backlash(Cause):
    """The flexspline's spring has a dead zone."""

    name = "backlash"
    component = "transmission"
    description = "the flexspline's spring has a dead zone"
    parameters = (Parameter("width", "rad", (0.0, 0.01), ((0.2e-3, 0.6e-3),), magnitude=True),)

    def apply(self, p: np.void, values: dict[str, float]) -> None:
        p["backlash"] = values["width"]
