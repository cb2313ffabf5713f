"""Inertia of the link."""

from .base import Cause, CauseParameter, Requirements


class LinkInertia(Cause):
    name = "link_inertia"
    component = "link"
    description = "the link's inertia differs"
    parameters = (CauseParameter("scale", "1", (0.05, 20.0), ((1.5, 2.2),), neutral=1.0, magnitude=True),)
    scales = ("Jl",)
    adds = True
    multiple = 5.0
    requires = Requirements(known_push=True)
