"""An error of the link encoder that returns several times per turn."""

from __future__ import annotations

import numpy as np

from .base import PHASE, Cause, CauseParameter, Requirements, put_order


class LinkEncoderError(Cause):
    """The link encoder's error has a higher order: reading + A (sin(n θl + φ) − sin φ), in addition to an eccentricity.

    Ordinary: what an oval or tilted disc leaves of an eccentricity of ordinary size in orders 2 to 4, about half of it.
    """

    name = "link_encoder_error"
    component = "sensor"
    imperfection = True
    sensor = "link_position"
    description = "the link encoder's error has an order of 2 to 4 per turn: reading + A (sin(n θl + φ) − sin φ)"
    adds = True
    requires = Requirements(link_travel=0.5)
    torsion = True
    parameters = (
        CauseParameter("order", "1", (2, 64), ((2, 4),), integer=True),
        CauseParameter("amplitude", "rad", (0.0, 0.05), ((0.1e-3, 0.3e-3),), magnitude=True),
        PHASE,
    )

    def apply(self, p: np.void, values: dict[str, float]) -> None:
        put_order(p, "link_error", values)
