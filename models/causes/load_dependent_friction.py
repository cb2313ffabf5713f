"""Friction that depends on the load."""

from .base import Cause, CauseParameter, Requirements


class LoadDependentFriction(Cause):
    name = "load_dependent_friction"
    component = "transmission"
    description = "mesh friction grows with the load: g(w) + μ|Tf|/N"
    parameters = (CauseParameter("coefficient", "1", (0.0, 2.0), ((0.12, 0.3),), magnitude=True),)
    sets = {"coefficient": "friction_load"}
    requires = Requirements(sliding=0.5, load_span=0.2)
