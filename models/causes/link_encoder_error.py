"""An error of the link encoder that returns several times per turn."""

from .base import PHASE, Cause, CauseParameter, Requirements


class LinkEncoderError(Cause):
    """Ordinary: orders 2 to 4 of an oval or tilted disc, half of an eccentricity of ordinary size."""

    name = "link_encoder_error"
    component = "sensor"
    imperfection = True
    sensor = "link_position"
    description = "the link encoder's error has an order of 2 to 4 per turn: reading + A (sin(n θl + φ) − sin φ)"
    order_of = "link_error"
    adds = True
    requires = Requirements(link_travel=0.5)
    torsion = True
    parameters = (
        CauseParameter("order", "1", (2, 64), ((2, 4),), integer=True),
        CauseParameter("amplitude", "rad", (0.0, 0.05), ((0.1e-3, 0.3e-3),), magnitude=True),
        PHASE,
    )
