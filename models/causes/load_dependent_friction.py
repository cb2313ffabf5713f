"""Friction that depends on the load."""

from __future__ import annotations

import numpy as np

from .base import Cause, Parameter


class LoadDependentFriction(Cause):
    """Mesh friction grows with the load: g(w) + μ|Tf|/N."""

    name = "load_dependent_friction"
    component = "transmission"
    description = "mesh friction grows with the load: g(w) + μ|Tf|/N"
    parameters = (Parameter("coefficient", "1", (0.0, 2.0), ((0.12, 0.3),), magnitude=True),)

    def apply(self, p: np.void, values: dict[str, float]) -> None:
        p["friction_load"] = values["coefficient"]
