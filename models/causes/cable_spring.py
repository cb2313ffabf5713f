"""Cable spring."""

from .base import Cause, CauseParameter, Requirements


class CableSpring(Cause):
    name = "cable_spring"
    component = "link"
    description = "a cable pulls at the link like a spring: −k (θl − θ0)"
    parameters = (
        CauseParameter("stiffness", "N·m/rad", (0.0, 1e3), ((0.5, 1.5),), magnitude=True),
        CauseParameter("rest_angle", "rad", (-7.0, 7.0), ((-0.6, 0.6),)),
    )
    sets = {"stiffness": "cable_stiffness", "rest_angle": "cable_rest"}
    requires = Requirements(link_travel=0.5, known_push=True)
