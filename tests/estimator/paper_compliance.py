"""The paper's compliance model over arrays of readings, Eqs. (1), (5), (6), (7), of which estimators have the step."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from flexspline.models import dynamics, laws
from flexspline.models.kernels import kernel


class Compliance(NamedTuple):
    """Every array has the shape of the readings."""

    torsion: np.ndarray  # Δθ, Eq. (1) [rad]
    wave_generator_torsion: np.ndarray  # Δθw, Eq. (5) [rad, motor side]
    kinematic_error: np.ndarray  # θerr at θw [rad]
    flexspline_torsion: np.ndarray  # Δθf, Eq. (6) [rad]
    torque: np.ndarray  # Tf, Eq. (7) [N·m]


def compliance(motor_position, link_position, motor_torque, calibration) -> Compliance:
    """Of readings that broadcast: motor encoder θm [rad, motor side], link encoder θl [rad], motor torque [N·m, motor side];
    `calibration`: a parameter record, shape (1,)."""
    readings = np.broadcast_arrays(
        *(np.asarray(a, dtype=np.float64) for a in (motor_position, link_position, motor_torque))
    )
    out = np.empty((5, readings[0].size))
    _compliance(*(np.ascontiguousarray(a).reshape(-1) for a in readings), calibration, out)
    return Compliance(*(row.reshape(readings[0].shape) for row in out))


@kernel
def _compliance(motor_position, link_position, motor_torque, calibration, out):
    p = calibration[0]
    for i in range(motor_position.size):
        link = link_position[i] - p.link_zero
        torsion, theta_w = dynamics.measured_torsion(motor_position[i], link, motor_torque[i], p)
        out[0, i] = motor_position[i] / p.N - link
        out[1, i] = laws.wave_generator_torsion(motor_torque[i], p)
        out[2, i], out[3, i] = laws.kinematic_error(theta_w, p), torsion
        out[4, i] = laws.flexspline_spring(torsion, p)
