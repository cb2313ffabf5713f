"""Eccentricity of the motor encoder."""

from __future__ import annotations

import numpy as np

from .base import PHASE, Cause, CauseParameter, Requirements


class MotorEncoderEccentricity(Cause):
    """A second one adds to the first as a vector. Ordinary: a disc of 10 to 20 mm radius 50 to 150 µm off centre; 30 to 150 µrad
    at the output of a gear of 100, as much as a kinematic error.
    """

    name = "motor_encoder_eccentricity"
    component = "sensor"
    imperfection = True
    sensor = "motor_position"
    description = "the motor encoder is mounted off centre: reading + A (sin(θm + φ) − sin φ)"
    adds = True
    requires = Requirements(motor_turn=1.0)
    torsion = True
    parameters = (CauseParameter("amplitude", "rad", (0.0, 0.1), ((3e-3, 15e-3),), magnitude=True), PHASE)

    def apply(self, p: np.void, values: dict[str, float]) -> None:
        whole = p["motor_eccentricity"] * np.exp(1j * p["motor_eccentricity_phase"])
        whole += values["amplitude"] * np.exp(1j * values["phase"])
        if values["amplitude"] != 0.0:
            p["motor_eccentricity"], p["motor_eccentricity_phase"] = abs(whole), np.angle(whole)
