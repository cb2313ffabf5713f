"""Hard stop."""

from .base import Cause, CauseParameter, Requirements


class HardStop(Cause):
    name = "hard_stop"
    component = "link"
    description = "the link runs into a stop: −k (θl − θs) beyond the angle θs"
    parameters = (
        CauseParameter("angle", "rad", (-7.0, 7.0), ((0.6, 1.0),)),
        CauseParameter("stiffness", "N·m/rad", (0.0, 1e5), ((15.0, 40.0),), magnitude=True),
    )
    sets = {"angle": "stop_angle", "stiffness": "stop_stiffness"}
    requires = Requirements(link_beyond=0.6, known_push=True)
