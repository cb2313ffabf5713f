"""Direction of gravity."""

from __future__ import annotations

import numpy as np

from .base import Cause, Parameter


class GravityDirection(Cause):
    """The link's centre of mass, or the joint against the world, is turned: −Mg sin(θl + gravity_angle + angle)."""

    name = "gravity_direction"
    component = "link"
    description = "the link hangs at another angle than described: −Mg sin(θl + angle)"
    parameters = (Parameter("angle", "rad", (-1.6, 1.6), ((-0.2, -0.08), (0.08, 0.2)), magnitude=True),)

    def apply(self, p: np.void, values: dict[str, float]) -> None:
        p["gravity_angle"] += values["angle"]

    def concerns(self, joint: object) -> bool:
        """Only a joint that states the direction of gravity may have it wrong: for others zero is where it hangs."""
        return joint.gravity_angle is not None
