"""Friction that depends on the temperature."""

from .base import Cause, CauseParameter, Requirements


class FrictionTemperature(Cause):
    """Mesh friction and its viscous part change with the temperature: g(w) and bw × (1 + c (ϑ − ϑ0)).

    Ordinary: a lubricant loses half of its friction over some 25 to 60 K; a gear that gains preload as it warms, the reverse.
    """

    name = "friction_temperature"
    component = "transmission"
    description = "mesh friction and its viscous part change with the temperature: g(w) and bw × (1 + c (ϑ − ϑ0))"
    parameters = (CauseParameter("coefficient", "1/K", (-0.1, 0.1), ((-0.02, -0.008), (0.008, 0.02)), magnitude=True),)
    sets = {"coefficient": "friction_temperature"}
    needs = ("temperature",)
    requires = Requirements(sliding=0.5, temperature_span=5.0)
