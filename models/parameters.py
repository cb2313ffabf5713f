"""The joint's numbers as one flat record for all compiled code.

A record is one element of a NumPy array of type `PARAMETERS`: float64 fields (and small arrays of them), SI units,
symbols as in the joint's equations. At the values of `neutral()` an effect beyond the nominal equations is absent.
The MuJoCo plant holds the record in its plugin's configuration; the replay of measured motion and the estimators take
it as an argument.
"""

from __future__ import annotations

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

_F = np.float64
PARAMETERS = np.dtype(
    [
        # rotor and motor
        ("N", _F), ("Jm", _F), ("Kt", _F), ("bm", _F), ("Kt_drive", _F),
        ("R", _F), ("L", _F), ("supply_voltage", _F), ("current_limit", _F),
        # wave generator
        ("Jw", _F), ("Kw0", _F), ("Cw", _F), ("dw", _F),
        # mesh friction (LuGre)
        ("Fc", _F), ("Fs", _F), ("vs", _F), ("s0", _F), ("s1", _F), ("bw", _F),
        # flexspline
        ("K1", _F), ("K2", _F), ("K3", _F), ("T1", _F), ("T2", _F), ("df", _F), ("knee_width", _F),
        # kinematic error: A_k sin(k θw + φ_k)
        ("order", _F, N_ORDERS), ("amplitude", _F, N_ORDERS), ("phase", _F, N_ORDERS),
        # output and link
        ("bl", _F), ("Jl", _F), ("Mg", _F), ("gravity_angle", _F),
        # effects in the motor and transmission
        ("cogging_order", _F, N_ORDERS), ("cogging_amplitude", _F, N_ORDERS), ("cogging_phase", _F, N_ORDERS),
        ("hysteresis_torque", _F), ("hysteresis_extent", _F), ("backlash", _F),
        ("friction_asymmetry", _F), ("friction_load", _F), ("back_driven_friction", _F),
        ("friction_order", _F, N_ORDERS), ("friction_amplitude", _F, N_ORDERS), ("friction_phase", _F, N_ORDERS),
        ("drift_amplitude", _F), ("drift_time", _F),
        ("friction_temperature", _F), ("reference_temperature", _F), ("viscous_exponent", _F),
        # effects at the link
        ("cable_stiffness", _F), ("cable_rest", _F), ("stop_angle", _F), ("stop_stiffness", _F),
        ("link_friction", _F), ("link_damping", _F), ("arm_scale", _F),
        ("flexible_share", _F), ("flexible_frequency", _F), ("flexible_damping", _F),
        # sensors
        ("motor_eccentricity", _F), ("motor_eccentricity_phase", _F),
        ("link_zero", _F), ("link_delay", _F), ("link_error_order", _F, N_ORDERS),
        ("link_error_amplitude", _F, N_ORDERS), ("link_error_phase", _F, N_ORDERS),
        ("current_offset", _F), ("torque_gain", _F), ("torque_offset", _F), ("torque_rate", _F),
        # nonparametric model discrepancies: cubic B-splines on a uniform grid
        ("discrepancy_place", _F, N_DISCREPANCIES), ("discrepancy_variable", _F, N_DISCREPANCIES),
        ("discrepancy_low", _F, N_DISCREPANCIES), ("discrepancy_high", _F, N_DISCREPANCIES),
        ("discrepancy_count", _F, N_DISCREPANCIES),
        ("discrepancy_coefficient", _F, (N_DISCREPANCIES, N_COEFFICIENTS)),
    ],
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
