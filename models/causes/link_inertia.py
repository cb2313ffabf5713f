"""Inertia of the link."""

from __future__ import annotations

import numpy as np

from .base import Cause, Parameter


class LinkInertia(Cause):
    """The link's inertia differs."""

    name = "link_inertia"
    component = "link"
    description = "the link's inertia differs"
    adds = True
    scales = ("Jl",)
    parameters = (Parameter("scale", "1", (0.05, 20.0), ((1.5, 2.2),), neutral=1.0, magnitude=True),)

    def apply(self, p: np.void, values: dict[str, float]) -> None:
        p["Jl"] *= values["scale"]
