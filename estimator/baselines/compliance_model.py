"""The raw compliance model, Eqs. (1)-(7) (`estimator.compliance`): torque from torsion, sample by sample.

Also the measurement of the torque filters here, with the variance that the sensors leave in it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..compliance import compliance
from ..settings import measurement_variance
from .base import Estimator, JointSignals, SensorNoise, TorqueEstimate
from .joint_dynamics import drive_current, known


def compliance_measurement(signals: JointSignals, record: np.ndarray, noise: SensorNoise) -> tuple[np.ndarray, float]:
    """Return torque [N·m] of the compliance model as a torque sensor would read it, shape (n,), and its variance.

    The motor torque is the command in force, or the reading where there is none. The command carries the encoder's counts
    through the velocity feedback, so the variance takes the current sensor's noise for either.
    """
    p = known(record)
    Tw = p["Kt"] * drive_current(signals, p)
    torque = compliance(signals.motor_position, signals.link_position, Tw, record).torque
    variance = measurement_variance(
        float(p["K2"]), noise.motor_resolution, noise.link_resolution, noise.link_noise, noise.motor_noise,
        ratio=float(p["N"]), torque_noise=float(p["Kt"]) * noise.current_noise,
        wave_generator_stiffness=float(p["Kw0"]),
    )  # fmt: skip
    since = signals.time
    return p["torque_gain"] * torque + p["torque_offset"] + p["torque_rate"] * since, variance


@dataclass(frozen=True)
class ComplianceModel(Estimator):
    """The compliance model as it is."""

    name: str = "compliance_model"

    def estimate(self, signals: JointSignals, record: np.ndarray, noise: SensorNoise) -> TorqueEstimate:
        torque, variance = compliance_measurement(signals, record, noise)
        return TorqueEstimate(self.name, torque, np.full_like(torque, variance))


ESTIMATORS = (ComplianceModel(),)
