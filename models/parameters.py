"""The joint's numbers as one flat record, which all compiled code reads.

A record is one element of a NumPy array of type `PARAMETERS`: float64 fields (and small arrays of them), SI units,
symbols as in the joint's equations. Every effect beyond the nominal equations is neutral at the values that
`neutral()` gives. The MuJoCo plant holds the record in a custom numeric field, the replay of measured motion
and the estimators take it as an argument: one joint, one set of numbers.
"""

from __future__ import annotations

import numpy as np

N_ORDERS = 8
"""Orders of kinematic error that a joint may have."""
N_PERIODIC = 3
"""Orders of cogging, and of position-dependent friction, that a joint may have."""
N_TERMS = 4
"""Nonparametric terms that a joint may have."""
N_COEFFICIENTS = 32
"""Coefficients of one nonparametric term."""

# Where a nonparametric term acts, and on what it depends: the codes that `term_place` and `term_variable` hold.
PLACES = ("none", "rotor", "mesh", "flexspline", "link", "joint_torque", "link_position", "motor_current")
VARIABLES = (
    "link_position", "motor_position", "motor_velocity", "load", "time", "direction_link_position",
    "motor_position_two_turns",
)  # fmt: skip

_F = np.float64
PARAMETERS = np.dtype(
    [
        # rotor and motor
        ("N", _F), ("Jm", _F), ("Kt", _F), ("bm", _F),
        ("R", _F), ("L", _F), ("supply_voltage", _F), ("current_limit", _F),
        # wave generator
        ("Jw", _F), ("Kw0", _F), ("Cw", _F), ("dw", _F),
        # mesh friction (LuGre)
        ("Fc", _F), ("Fs", _F), ("vs", _F), ("s0", _F), ("s1", _F), ("bw", _F),
        # flexspline
        ("K1", _F), ("K2", _F), ("K3", _F), ("T1", _F), ("T2", _F), ("df", _F),
        # kinematic error: A_k sin(k θw + φ_k)
        ("order", _F, N_ORDERS), ("amplitude", _F, N_ORDERS), ("phase", _F, N_ORDERS),
        # output and link
        ("bl", _F), ("Jl", _F), ("Mg", _F), ("gravity_angle", _F),
        # effects in the motor and transmission
        ("cogging_order", _F, N_PERIODIC), ("cogging_amplitude", _F, N_PERIODIC), ("cogging_phase", _F, N_PERIODIC),
        ("hysteresis_torque", _F), ("hysteresis_extent", _F), ("backlash", _F),
        ("friction_asymmetry", _F), ("friction_load", _F), ("back_driven_friction", _F),
        ("friction_order", _F, N_PERIODIC), ("friction_amplitude", _F, N_PERIODIC), ("friction_phase", _F, N_PERIODIC),
        ("drift_amplitude", _F), ("drift_time", _F),
        # effects at the link
        ("cable_stiffness", _F), ("cable_rest", _F), ("stop_angle", _F), ("stop_stiffness", _F),
        # what the sensors make of it
        ("link_zero", _F), ("link_delay", _F), ("eccentricity", _F), ("eccentricity_phase", _F),
        ("current_offset", _F), ("torque_gain", _F), ("torque_offset", _F), ("torque_rate", _F),
        # nonparametric terms: cubic B-splines on a uniform grid
        ("term_place", _F, N_TERMS), ("term_variable", _F, N_TERMS),
        ("term_low", _F, N_TERMS), ("term_high", _F, N_TERMS), ("term_count", _F, N_TERMS),
        ("term_coefficient", _F, (N_TERMS, N_COEFFICIENTS)),
    ],
    align=True,
)  # fmt: skip

SIZE = PARAMETERS.itemsize // 8
"""Number of float64 values in a record."""


def neutral() -> np.ndarray:
    """Return a record, shape (1,), in which no effect is present and every number of the joint is zero."""
    record = np.zeros(1, PARAMETERS)
    p = record[0]
    p["hysteresis_extent"] = 1e-4
    p["drift_time"] = 10.0
    p["torque_gain"] = 1.0
    p["back_driven_friction"] = 1.0
    p["term_high"] = 1.0
    return record


def as_floats(record: np.ndarray) -> np.ndarray:
    """View a record, shape (1,), as its float64 values, shape (SIZE,)."""
    return record.view(np.float64).reshape(-1)
