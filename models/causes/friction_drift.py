"""Warm-up of the friction."""

from .base import Cause, CauseParameter, Requirements


class FrictionDrift(Cause):
    name = "friction_drift"
    component = "transmission"
    description = "mesh friction warms up: g(w)·(1 + A exp(−t/T)) from the recording's start"
    parameters = (
        CauseParameter("amplitude", "1", (-0.9, 10.0), ((0.8, 1.6),), magnitude=True),
        CauseParameter("time_constant", "s", (0.5, 300.0), ((6.0, 15.0),)),
    )
    sets = {"amplitude": "drift_amplitude", "time_constant": "drift_time"}
    requires = Requirements(sliding=0.5, duration=5.0)
