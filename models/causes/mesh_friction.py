"""Mesh friction."""

from __future__ import annotations

import numpy as np

from .base import Cause, Parameter


class MeshFriction(Cause):
    """Coulomb and static mesh friction (Fc, Fs) are scaled."""

    name = "mesh_friction"
    component = "transmission"
    description = "Coulomb and static mesh friction (Fc, Fs) are scaled"
    adds = True
    scales = ("Fc", "Fs")
    parameters = (Parameter("scale", "1", (0.05, 10.0), ((1.7, 2.5),), neutral=1.0, magnitude=True),)

    def apply(self, p: np.void, values: dict[str, float]) -> None:
        for symbol in ("Fc", "Fs"):
            p[symbol] *= values["scale"]
