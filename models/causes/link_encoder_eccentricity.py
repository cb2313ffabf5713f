"""Eccentricity of the link encoder."""

from .base import PHASE, Cause, CauseParameter, Requirements


class LinkEncoderEccentricity(Cause):
    name = "link_encoder_eccentricity"
    component = "sensor"
    imperfection = True
    sensor = "link_position"
    description = "the link encoder is mounted off centre: reading + A (sin(θl + φ) − sin φ)"
    order_of = "link_error"
    adds = True
    requires = Requirements(link_travel=0.5)
    torsion = True
    parameters = (CauseParameter("amplitude", "rad", (0.0, 0.05), ((0.2e-3, 0.6e-3),), magnitude=True), PHASE)
