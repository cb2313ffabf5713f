"""Viscous friction."""

from __future__ import annotations

import numpy as np

from .base import Cause, Parameter


class ViscousFriction(Cause):
    """The mesh's viscous friction bw differs."""

    name = "viscous_friction"
    component = "transmission"
    description = "the mesh's viscous friction bw differs"
    parameters = (
        Parameter("coefficient", "N·m·s/rad", (0.0, 0.1), ((3.0, 7.0),), relative="bw", neutral=1.0, magnitude=True),
    )

    def apply(self, p: np.void, values: dict[str, float]) -> None:
        p["bw"] = values["coefficient"]
