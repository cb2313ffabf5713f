"""Cogging of the motor."""

from .base import PHASE, Cause, CauseParameter, Requirements


class Cogging(Cause):
    name = "cogging"
    component = "motor"
    description = "a torque periodic in the rotor angle, A sin(n θm + φ), acts on the rotor"
    order_of = "cogging"
    adds = True
    ripple = True
    series = ("rotor", "motor_position")
    requires = Requirements(sliding=0.5, motor_turn=1.0)
    parameters = (
        CauseParameter("order", "1", (1, 64), ((2, 13),), integer=True),
        CauseParameter("amplitude", "N·m", (0.0, 1.0), ((4e-3, 10e-3),), magnitude=True),
        PHASE,
    )
