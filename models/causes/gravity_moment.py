"""Gravity moment of the link."""

from __future__ import annotations

import numpy as np

from .base import Cause, Parameter


class GravityMoment(Cause):
    """The link's gravity moment differs."""

    name = "gravity_moment"
    component = "link"
    description = "the link's gravity moment differs"
    adds = True
    scales = ("Mg",)
    parameters = (Parameter("scale", "1", (0.05, 10.0), ((0.80, 0.92), (1.08, 1.20)), neutral=1.0, magnitude=True),)

    def apply(self, p: np.void, values: dict[str, float]) -> None:
        p["Mg"] *= values["scale"]
