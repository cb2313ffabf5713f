"""Direction of gravity."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from .base import Cause, CauseParameter, Requirements

if TYPE_CHECKING:
    from ..joint import Joint


class GravityDirection(Cause):
    """The link's centre of mass, or the joint against the world, is turned: −Mg sin(θl + gravity_angle + angle)."""

    name = "gravity_direction"
    component = "link"
    description = "gravity acts at another angle than described: −Mg sin(θl + angle)"
    adds = True
    requires = Requirements(link_travel=0.5, known_push=True, gravity=True)
    parameters = (CauseParameter("angle", "rad", (-1.6, 1.6), ((-0.2, -0.08), (0.08, 0.2)), magnitude=True),)

    def apply(self, p: np.void, values: dict[str, float]) -> None:
        p["gravity_angle"] += values["angle"]

    def concerns(self, joint: Joint) -> bool:
        """Only a joint with a stated direction of gravity may have it wrong; a diagnosis of a log states one."""
        return joint.gravity_angle is not None
