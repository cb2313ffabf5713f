"""Stiffness of the flexspline."""

from __future__ import annotations

import numpy as np

from .base import Cause, Parameter


class Stiffness(Cause):
    """The flexspline's stiffness (K1, K2, K3) is scaled."""

    name = "stiffness"
    component = "transmission"
    description = "the flexspline's stiffness (K1, K2, K3) is scaled"
    adds = True
    scales = ("K1", "K2", "K3")
    parameters = (Parameter("scale", "1", (0.2, 5.0), ((0.65, 0.85), (1.2, 1.5)), neutral=1.0, magnitude=True),)

    def apply(self, p: np.void, values: dict[str, float]) -> None:
        for symbol in ("K1", "K2", "K3"):
            p[symbol] *= values["scale"]
