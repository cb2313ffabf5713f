"""Causes in the motor."""

from __future__ import annotations

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


class RotorInertia(Cause):
    name = "rotor_inertia"
    component = "motor"
    description = "the rotor's inertia differs"
    parameters = (
        CauseParameter("value", "kg·m²", (1e-9, 1.0), ((2.0, 3.5),), relative="Jm", neutral=1.0, magnitude=True),
    )
    sets = {"value": "Jm"}
    requires = Requirements(sliding=0.5, speed=10.0)


class TorqueConstant(Cause):
    name = "torque_constant"
    component = "motor"
    description = "the torque constant, or the current sensor's gain, differs"
    parameters = (
        CauseParameter(
            "value", "N·m/A", (1e-4, 10.0), ((0.80, 0.92), (1.08, 1.20)), relative="Kt", neutral=1.0, magnitude=True
        ),
    )
    sets = {"value": "Kt"}
    multiple = 3.0
    requires = Requirements(sliding=0.5)
