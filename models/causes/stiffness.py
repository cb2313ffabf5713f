"""Stiffness of the flexspline."""

from .base import Cause, CauseParameter, Requirements


class Stiffness(Cause):
    name = "stiffness"
    component = "transmission"
    description = "the flexspline's stiffness (K1, K2, K3) is scaled"
    parameters = (CauseParameter("scale", "1", (0.2, 5.0), ((0.65, 0.85), (1.2, 1.5)), neutral=1.0, magnitude=True),)
    scales = ("K1", "K2", "K3")
    adds = True
    multiple = 3.0
    requires = Requirements(sliding=0.5, load_span=0.2)
    torsion = True
