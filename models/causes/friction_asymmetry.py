"""Friction that depends on the direction."""

from __future__ import annotations

import numpy as np

from .base import Cause, Parameter


class FrictionAsymmetry(Cause):
    """Mesh friction is g(w)·(1 + a) forward and g(w)·(1 − a) backward."""

    name = "friction_asymmetry"
    component = "transmission"
    description = "mesh friction is g(w)·(1 + a) forward and g(w)·(1 − a) backward"
    parameters = (Parameter("ratio", "1", (-0.95, 0.95), ((-0.45, -0.2), (0.2, 0.45)), magnitude=True),)

    def apply(self, p: np.void, values: dict[str, float]) -> None:
        p["friction_asymmetry"] = values["ratio"]
