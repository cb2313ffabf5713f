"""Backlash."""

from .base import Cause, CauseParameter, Requirements


class Backlash(Cause):
    name = "backlash"
    component = "transmission"
    description = "the flexspline's spring has a dead zone"
    parameters = (CauseParameter("width", "rad", (0.0, 0.01), ((0.2e-3, 0.6e-3),), magnitude=True),)
    sets = {"width": "backlash"}
    # Without load the joint rattles in it, which a resonance's damping looks like.
    requires = Requirements(sliding=0.5, reversal=True, load_span=0.2)
    torsion = True
