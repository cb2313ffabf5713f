"""A payload."""

from __future__ import annotations

import math

import numpy as np

from ..parameters import GRAVITY
from .base import Cause, CauseParameter, Requirements


class Payload(Cause):
    """A mass on the link that is missing in its description: −m g d sin(θl + gravity_angle + angle), and m d² of
    inertia.

    The angle is that of the mass against the link's own centre of mass, seen from the axis. Gravity shows the product
    of mass and distance, inertia that of mass and distance squared. Ordinary: a tool or a part of 0.3 to 1 kg in the
    hand of an arm of the test joint's size (9 N·m, 0.35 kg·m²), 0.2 to 0.4 m from the axis.
    """

    name = "payload"
    component = "link"
    description = "an unknown mass on the link: gravity moment and inertia grow together"
    adds = True
    requires = Requirements(link_travel=0.5, known_push=True)
    parameters = (
        CauseParameter("mass", "kg", (0.0, 100.0), ((0.3, 1.0),), magnitude=True),
        CauseParameter("distance", "m", (0.01, 3.0), ((0.2, 0.4),), neutral=0.3),
        CauseParameter("angle", "rad", (-3.2, 3.2), ((-0.3, 0.3),)),
    )

    def apply(self, p: np.void, values: dict[str, float]) -> None:
        moment = values["mass"] * GRAVITY * values["distance"]
        along = p["Mg"] + moment * math.cos(values["angle"])
        across = moment * math.sin(values["angle"])
        p["Mg"] = math.hypot(along, across)
        if p["Mg"] > 0.0:
            p["gravity_angle"] += math.atan2(across, along)
        p["Jl"] += values["mass"] * values["distance"] ** 2
