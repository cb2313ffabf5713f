"""Causes in the sensors."""

from __future__ import annotations

import numpy as np

from .base import PHASE, Cause, CauseParameter, Requirements


class CurrentOffset(Cause):
    name = "current_offset"
    component = "sensor"
    sensor = "motor_current"
    description = "a constant is added to the current reading"
    parameters = (CauseParameter("value", "A", (-10.0, 10.0), ((-0.15, -0.05), (0.05, 0.15)), magnitude=True),)
    sets = {"value": "current_offset"}


class EncoderDelay(Cause):
    name = "encoder_delay"
    component = "sensor"
    sensor = "link_position"
    description = "the link encoder's reading comes late"
    parameters = (CauseParameter("seconds", "s", (0.0, 0.09), ((4e-3, 11e-3),), magnitude=True),)
    sets = {"seconds": "link_delay"}
    requires = Requirements(speed=10.0)
    torsion = True


class LinkEncoderEccentricity(Cause):
    name = "link_encoder_eccentricity"
    component = "sensor"
    imperfection = True
    sensor = "link_position"
    description = "the link encoder is mounted off centre: reading + A (sin(θl + φ) − sin φ)"
    order_of = "link_error"
    adds = True
    requires = Requirements(link_travel=0.5)
    torsion = True
    parameters = (CauseParameter("amplitude", "rad", (0.0, 0.05), ((0.2e-3, 0.6e-3),), magnitude=True), PHASE)


class LinkEncoderError(Cause):
    """Ordinary: orders 2 to 4 of an oval or tilted disc, half of an eccentricity of ordinary size."""

    name = "link_encoder_error"
    component = "sensor"
    imperfection = True
    sensor = "link_position"
    description = "the link encoder's error has an order of 2 to 4 per turn: reading + A (sin(n θl + φ) − sin φ)"
    order_of = "link_error"
    adds = True
    requires = Requirements(link_travel=0.5)
    torsion = True
    parameters = (
        CauseParameter("order", "1", (2, 64), ((2, 4),), integer=True),
        CauseParameter("amplitude", "rad", (0.0, 0.05), ((0.1e-3, 0.3e-3),), magnitude=True),
        PHASE,
    )


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


class TorqueSensorDrift(Cause):
    name = "torque_sensor_drift"
    component = "sensor"
    sensor = "joint_torque"
    description = "the torque sensor's reading drifts with time"
    parameters = (CauseParameter("rate", "N·m/s", (-10.0, 10.0), ((-0.05, -0.02), (0.02, 0.05)), magnitude=True),)
    sets = {"rate": "torque_rate"}
    needs = ("joint_torque",)
    requires = Requirements(duration=5.0)


class TorqueSensorGain(Cause):
    name = "torque_sensor_gain"
    component = "sensor"
    sensor = "joint_torque"
    description = "the torque sensor's reading is scaled"
    parameters = (CauseParameter("gain", "1", (0.05, 20.0), ((0.80, 0.92), (1.08, 1.20)), neutral=1.0, magnitude=True),)
    sets = {"gain": "torque_gain"}
    needs = ("joint_torque",)
    requires = Requirements(weighed=True)


class TorqueSensorOffset(Cause):
    name = "torque_sensor_offset"
    component = "sensor"
    sensor = "joint_torque"
    description = "a constant is added to the torque sensor's reading"
    parameters = (CauseParameter("value", "N·m", (-100.0, 100.0), ((-0.6, -0.2), (0.2, 0.6)), magnitude=True),)
    sets = {"value": "torque_offset"}
    needs = ("joint_torque",)
