"""Hard stop."""

from __future__ import annotations

import numpy as np

from .base import Cause, Parameter


class HardStop(Cause):
    """The link runs into a stop: −k (θl − θs) beyond the angle θs."""

    name = "hard_stop"
    component = "link"
    description = "the link runs into a stop: −k (θl − θs) beyond the angle θs"
    parameters = (
        Parameter("angle", "rad", (-7.0, 7.0), ((0.6, 1.0),)),
        Parameter("stiffness", "N·m/rad", (0.0, 1e5), ((15.0, 40.0),), magnitude=True),
    )

    def apply(self, p: np.void, values: dict[str, float]) -> None:
        p["stop_angle"] = values["angle"]
        p["stop_stiffness"] = values["stiffness"]
