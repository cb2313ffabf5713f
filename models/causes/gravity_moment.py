"""Gravity moment of the link."""

from .base import Cause, CauseParameter, Requirements


class GravityMoment(Cause):
    name = "gravity_moment"
    component = "link"
    description = "the link's gravity moment differs"
    parameters = (
        CauseParameter("scale", "1", (0.05, 10.0), ((0.80, 0.92), (1.08, 1.20)), neutral=1.0, magnitude=True),
    )
    scales = ("Mg",)
    adds = True
    multiple = 3.0
    requires = Requirements(link_travel=0.5, known_push=True, gravity=True)
