"""Torque constant."""

from .base import Cause, CauseParameter, Requirements


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
