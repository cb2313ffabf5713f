"""Friction that depends on the link angle."""

from .base import PHASE, Cause, CauseParameter, Requirements


class PositionDependentFriction(Cause):
    name = "position_dependent_friction"
    component = "transmission"
    description = "mesh friction is periodic in the link angle: g(w) + A sin(n θl + φ)"
    order_of = "friction"
    adds = True
    series = ("mesh", "direction_link_position")
    requires = Requirements(sliding=0.5, link_travel=0.5)
    parameters = (
        CauseParameter("order", "1", (1, 32), ((1, 3),), integer=True),
        CauseParameter("amplitude", "N·m", (0.0, 1.0), ((6e-3, 12e-3),), magnitude=True),
        PHASE,
    )
