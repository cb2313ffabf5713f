"""Friction that depends on the direction."""

from .base import Cause, CauseParameter, Requirements


class FrictionAsymmetry(Cause):
    name = "friction_asymmetry"
    component = "transmission"
    description = "mesh friction is g(w)·(1 + a) forward and g(w)·(1 − a) backward"
    parameters = (CauseParameter("ratio", "1", (-0.95, 0.95), ((-0.45, -0.2), (0.2, 0.45)), magnitude=True),)
    sets = {"ratio": "friction_asymmetry"}
    requires = Requirements(sliding=0.5, reversal=True)
