"""Cable spring."""

from __future__ import annotations

import numpy as np

from .base import Cause, Parameter


class CableSpring(Cause):
    """A cable pulls at the link like a spring: −k (θl − θ0)."""

    name = "cable_spring"
    component = "link"
    description = "a cable pulls at the link like a spring: −k (θl − θ0)"
    parameters = (
        Parameter("stiffness", "N·m/rad", (0.0, 1e3), ((0.5, 1.5),), magnitude=True),
        Parameter("rest_angle", "rad", (-7.0, 7.0), ((-0.6, 0.6),)),
    )

    def apply(self, p: np.void, values: dict[str, float]) -> None:
        p["cable_stiffness"] = values["stiffness"]
        p["cable_rest"] = values["rest_angle"]
