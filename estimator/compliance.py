"""The harmonic-drive compliance model, Eqs. (1)-(7): joint torque from two encoders and the motor torque.

The equations themselves are the joint's and stand in `models.laws`; here they are composed into a measurement.
The calibration `p` is a parameter record (`models.parameters`): N, K1, K2, K3, T1, T2, Kw0, Cw, the orders of the
kinematic error, and the zero of the link encoder. Effects of the record that change what the sensors read or the
flexspline's law are respected; whoever wants the bare calibration passes `Joint.bare_record`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

from ..models.errors import InputError
from ..models.laws import flexspline_spring, kinematic_error, wave_generator_torsion
from ..models.parameters import PARAMETERS


@njit(cache=True, nogil=True, error_model="numpy")
def compliance_torque(motor_position, link_position, motor_torque, p):
    """Return Tf [N·m] of the compliance model, Eq. (7), from one reading of each sensor. Compiled.

    Args:
        motor_position: θm [rad, motor side].
        link_position: θl [rad], as read; `p.link_zero` is taken off.
        motor_torque: motor torque command [N·m, motor side], which approximates Tw.
        p: parameter record.
    """
    return flexspline_spring(torsions(motor_position, link_position, motor_torque, p)[3], p)


@njit(cache=True, nogil=True, error_model="numpy")
def torsions(motor_position, link_position, motor_torque, p):
    """Return Δθ of Eq. (1) [rad], Δθw of Eq. (5) [rad, motor side], θerr [rad], Δθf of Eq. (6) [rad]. Compiled.

    Arguments as `compliance_torque`. The kinematic error is a function of θw, which no sensor reads:
    θw = θm - Δθw.
    """
    total = motor_position / p.N - (link_position - p.link_zero)
    wave_generator = wave_generator_torsion(motor_torque, p)
    error = kinematic_error(motor_position - wave_generator, p)
    return total, wave_generator, error, total - wave_generator / p.N - error


@dataclass(frozen=True)
class Compliance:
    """Result of the compliance model; every array has the shape of the readings.

    Attributes:
        torsion: Δθ, Eq. (1) [rad].
        wave_generator_torsion: Δθw, Eq. (5) [rad, motor side].
        kinematic_error: θerr at θw [rad].
        flexspline_torsion: Δθf, Eq. (6) [rad].
        torque: Tf, Eq. (7) [N·m].
    """

    torsion: np.ndarray
    wave_generator_torsion: np.ndarray
    kinematic_error: np.ndarray
    flexspline_torsion: np.ndarray
    torque: np.ndarray


def compliance(motor_position, link_position, motor_torque, calibration: np.ndarray) -> Compliance:
    """Evaluate the compliance model over arrays of readings.

    Args:
        motor_position: motor encoder θm [rad, motor side], any shape.
        link_position: link encoder θl [rad]; same shape, or one that broadcasts.
        motor_torque: motor torque command [N·m, motor side], approximates Tw; likewise.
        calibration: Shape (1,), a record of `models.parameters.PARAMETERS`.

    Raises:
        InputError: shapes that do not fit, values that are not numbers, or a calibration that is no such record.
    """
    try:
        readings = [np.asarray(a, dtype=np.float64) for a in (motor_position, link_position, motor_torque)]
        readings = np.broadcast_arrays(*readings)
    except (TypeError, ValueError) as error:
        raise InputError(
            f"compliance model: expected arrays of numbers of one shape for motor position [rad], link position [rad] "
            f"and motor torque [N·m], got {error}"
        ) from error
    if getattr(calibration, "dtype", None) != PARAMETERS or calibration.shape != (1,):
        got = f"{type(calibration).__name__} of shape {np.shape(calibration)}"
        raise InputError(f"compliance model: calibration: expected a parameter record of shape (1,), got {got}")
    shape = readings[0].shape
    out = np.empty((5, readings[0].size))
    _compliance(*(np.ascontiguousarray(a).reshape(-1) for a in readings), calibration, out)
    return Compliance(*(row.reshape(shape) for row in out))


@njit(cache=True, nogil=True, error_model="numpy")
def _compliance(motor_position, link_position, motor_torque, calibration, out):
    p = calibration[0]
    for i in range(motor_position.size):
        total, wave_generator, error, flexspline = torsions(motor_position[i], link_position[i], motor_torque[i], p)
        out[0, i] = total
        out[1, i] = wave_generator
        out[2, i] = error
        out[3, i] = flexspline
        out[4, i] = flexspline_spring(flexspline, p)
