"""Eccentricity of the link encoder."""

from __future__ import annotations

import numpy as np

from .base import PHASE, Cause, CauseParameter, Requirements, put_order


class LinkEncoderEccentricity(Cause):
    name = "link_encoder_eccentricity"
    component = "sensor"
    imperfection = True
    sensor = "link_position"
    description = "the link encoder is mounted off centre: reading + A (sin(θl + φ) − sin φ)"
    adds = True
    requires = Requirements(link_travel=0.5)
    torsion = True
    parameters = (
        CauseParameter("amplitude", "rad", (0.0, 0.05), ((0.2e-3, 0.6e-3),), magnitude=True),
        PHASE,
    )

    def apply(self, p: np.void, values: dict[str, float]) -> None:
        put_order(p, "link_error", {"order": 1.0, **values})
