"""Hysteresis of the flexspline."""

from .base import Cause, CauseParameter, Requirements


class Hysteresis(Cause):
    name = "hysteresis"
    component = "transmission"
    description = "Dahl friction acts across the flexspline: Tf + F z/x, z' = v − |v| z/x with v = Δθf'"
    parameters = (
        CauseParameter("torque", "N·m", (0.0, 20.0), ((0.6, 1.5),), magnitude=True),
        CauseParameter("extent", "rad", (5e-6, 2e-3), ((50e-6, 120e-6),)),
    )
    sets = {"torque": "hysteresis_torque", "extent": "hysteresis_extent"}
    requires = Requirements(sliding=0.5, reversal=True)
    torsion = True
