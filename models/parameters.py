"""The joint's numbers as one flat record for all compiled code.

A record is one element of a NumPy array of type `PARAMETERS`: float64 fields (and small arrays of them), SI units,
symbols as in the joint's equations. At the values of `neutral()` an effect beyond the nominal equations is absent.
The MuJoCo plant holds the record in its plugin's configuration; the replay of measured motion and the estimators take
it as an argument.
"""

from __future__ import annotations

from typing import Any

import numpy as np

N_ORDERS = 8
"""Most orders of each: kinematic error, cogging, position-dependent friction, the link encoder's error (once per
turn, eccentricity, included)."""
N_DISCREPANCIES = 4  # most nonparametric model discrepancies of a joint
N_COEFFICIENTS = 32  # coefficients of one model discrepancy

# Place and variable of a model discrepancy: codes of `discrepancy_place`, `discrepancy_variable`.
PLACES = ("none", "rotor", "mesh", "flexspline", "link", "joint_torque", "link_position", "motor_current")
VARIABLES = (
    "link_position", "motor_position", "motor_velocity", "load", "time", "direction_link_position",
    "motor_position_two_turns",
)  # fmt: skip

GRAVITY = 9.80665  # standard gravity [m/s²]
REFERENCE_TEMPERATURE = 25.0  # default temperature [°C] of a joint's stated friction


def floats(*fields: str | tuple[Any, ...], align: bool = False) -> np.dtype:
    """Return a record of float64 fields for compiled code: `name`, or `(name, shape)` of an array; `(name, record)` and `(name,
    record, shape)` are records inside it."""
    given = ((one, np.float64) if isinstance(one, str) else one for one in fields)
    return np.dtype(
        [one if isinstance(one[1], type | np.dtype) else (one[0], np.float64, *one[1:]) for one in given], align=align
    )


PARAMETERS = floats(
    # rotor and motor
    "N", "Jm", "Kt", "bm", "Kt_drive", "R", "L", "supply_voltage", "current_limit",
    # wave generator
    "Jw", "Kw0", "Cw", "dw",
    # mesh friction (LuGre)
    "Fc", "Fs", "vs", "s0", "s1", "bw",
    # flexspline
    "K1", "K2", "K3", "T1", "T2", "df", "knee_width",
    # kinematic error: A_k sin(k θw + φ_k)
    ("order", N_ORDERS), ("amplitude", N_ORDERS), ("phase", N_ORDERS),
    # output and link
    "bl", "Jl", "Mg", "gravity_angle",
    # effects in the motor and transmission
    ("cogging_order", N_ORDERS), ("cogging_amplitude", N_ORDERS), ("cogging_phase", N_ORDERS),
    "hysteresis_torque", "hysteresis_extent", "backlash", "friction_asymmetry", "friction_load", "back_driven_friction",
    ("friction_order", N_ORDERS), ("friction_amplitude", N_ORDERS), ("friction_phase", N_ORDERS),
    "drift_amplitude", "drift_time", "friction_temperature", "reference_temperature", "viscous_exponent",
    # effects at the link
    "cable_stiffness", "cable_rest", "stop_angle", "stop_stiffness", "link_friction", "link_damping", "arm_scale",
    "flexible_share", "flexible_frequency", "flexible_damping",
    # sensors
    "motor_eccentricity", "motor_eccentricity_phase", "link_zero", "link_delay",
    ("link_error_order", N_ORDERS), ("link_error_amplitude", N_ORDERS), ("link_error_phase", N_ORDERS),
    "current_offset", "torque_gain", "torque_offset", "torque_rate",
    # nonparametric model discrepancies: cubic B-splines on a uniform grid
    ("discrepancy_place", N_DISCREPANCIES), ("discrepancy_variable", N_DISCREPANCIES),
    ("discrepancy_low", N_DISCREPANCIES), ("discrepancy_high", N_DISCREPANCIES), ("discrepancy_count", N_DISCREPANCIES),
    ("discrepancy_coefficient", (N_DISCREPANCIES, N_COEFFICIENTS)),
    align=True,
)  # fmt: skip

SIZE = PARAMETERS.itemsize // 8  # number of float64 values in a record


def neutral() -> np.ndarray:
    """Return a record, shape (1,), without effects; every number of the joint is zero."""
    record = np.zeros(1, PARAMETERS)
    p = record[0]
    p["hysteresis_extent"] = 1e-4
    p["drift_time"] = 10.0
    p["torque_gain"] = p["arm_scale"] = 1.0
    p["back_driven_friction"] = 1.0
    p["viscous_exponent"] = 1.0
    p["flexible_frequency"] = 20.0
    p["reference_temperature"] = REFERENCE_TEMPERATURE
    p["discrepancy_high"] = 1.0
    return record


def as_floats(record: np.ndarray) -> np.ndarray:
    """View a record, shape (1,), as its float64 values, shape (SIZE,)."""
    return record.view(np.float64).reshape(-1)


def short_way(change: np.ndarray | float, period: np.ndarray | float) -> np.ndarray:
    """Return changes of angles by the shorter way; without a period (0) unchanged. Units alike, shapes broadcast."""
    return change - period * np.round(change / np.where(np.asarray(period) > 0, period, np.inf))
