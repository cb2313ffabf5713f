"""Effects outside the library: what no known cause describes, where it sits, and how it is drawn at a size."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ...models.parameters import N_COEFFICIENTS, PLACES, VARIABLES

Values = dict[str, float]


@dataclass(frozen=True)
class Outside:
    """An effect that no cause of the library describes."""

    component: str  # where it is
    description: str  # for people
    draw: Callable[[np.random.Generator, float], Values]  # its parameters by random stream and size
    put: Callable[[np.void, Values], None]  # adds it to a parameter record, in place
    needs: tuple[str, ...] = ()  # channels in which it shows


def sign(rng: np.random.Generator) -> float:
    """−1 or 1."""
    return float(rng.choice((-1.0, 1.0)))


def _spline(
    place: str, variable: str, low: float, high: float, shape: Callable[[np.ndarray, Values], np.ndarray]
) -> Callable[[np.void, Values], None]:
    """Return what puts a function into a record as a model discrepancy of a place and variable, the spline through it. `low`,
    `high`: its range, about the effect's angle if that is of the link; `shape`: the function's values, shape (n,)."""

    def put(p: np.void, values: Values) -> None:
        slot = int(np.flatnonzero(p["discrepancy_place"] == 0)[0])
        n = N_COEFFICIENTS
        centre = values["angle"] if variable.endswith("link_position") else 0.0
        begin, end = centre + low, centre + high
        knots = begin + (np.arange(n) - 1) / (n - 3) * (end - begin)
        # Values at the knots are (c₋ + 4c + c₊)/6: solve for the coefficients, ends continued.
        A = (np.diag(np.full(n, 4.0)) + np.diag(np.ones(n - 1), 1) + np.diag(np.ones(n - 1), -1)) / 6.0
        A[0, 0] = A[-1, -1] = 5.0 / 6.0
        p["discrepancy_place"][slot], p["discrepancy_variable"][slot] = PLACES.index(place), VARIABLES.index(variable)
        p["discrepancy_low"][slot], p["discrepancy_high"][slot], p["discrepancy_count"][slot] = begin, end, n
        p["discrepancy_coefficient"][slot] = np.linalg.solve(A, shape(knots, values))

    return put


def _half_order(p: np.void, values: Values) -> None:
    slot = int(np.flatnonzero(p["amplitude"] == 0)[0])
    p["order"][slot], p["amplitude"][slot], p["phase"][slot] = values["order"], values["amplitude"], values["phase"]


_CURRENT, _TURN = ("motor_current",), 2 * np.pi
OUTSIDE: dict[str, Outside] = {
    "link_bump": Outside(
        "link", "a torque on the link near one angle",
        lambda rng, size: {
            "amplitude": size * sign(rng) * rng.uniform(2, 4), "angle": rng.uniform(-0.6, 0.6), "width": rng.uniform(0.08, 0.14),
        },
        _spline(
            "link", "link_position", -1, 1, lambda x, v: v["amplitude"] * np.exp(-0.5 * ((x - v["angle"]) / v["width"]) ** 2)
        ),
    ),
    "quadratic_friction": Outside(
        "transmission", "mesh friction that grows with the square of velocity",
        lambda rng, size: {"torque": size * rng.uniform(0.02, 0.04)},
        _spline("mesh", "motor_velocity", -150, 150, lambda w, v: v["torque"] * (w / 80.0) * np.abs(w / 80.0)), _CURRENT,
    ),
    "stepped_friction": Outside(
        "transmission", "mesh friction that is higher beyond an angle of the link",
        lambda rng, size: {"torque": size * rng.uniform(0.008, 0.015), "angle": rng.uniform(-0.6, 0.6)},
        _spline(
            "mesh", "direction_link_position", -1, 1, lambda x, v: 0.5 * v["torque"] * (1 + np.tanh((x - v["angle"]) / 0.1))
        ), _CURRENT,
    ),
    "half_order": Outside(
        "transmission", "kinematic error once in two turns of the motor",
        lambda rng, size: {"order": 0.5, "amplitude": size * rng.uniform(0.8e-4, 2e-4), "phase": rng.uniform(0, _TURN)},
        _half_order,
    ),
    "rotor_pulse": Outside(
        "motor", "a torque pulse on the rotor, once a turn",
        lambda rng, size: {"torque": size * sign(rng) * rng.uniform(0.015, 0.03), "angle": rng.uniform(0, _TURN)},
        _spline(
            "rotor", "motor_position", 0, _TURN,
            lambda x, v: v["torque"] * np.exp(-0.5 * (((x - v["angle"] + np.pi) % _TURN - np.pi) / 0.35) ** 2),
        ), _CURRENT,
    ),
    "current_drift": Outside(
        "sensor", "a current reading that drifts as it warms up",
        lambda rng, size: {"current": size * sign(rng) * rng.uniform(0.08, 0.2), "time_constant": rng.uniform(5, 12)},
        _spline(
            "motor_current", "time", 0, 60, lambda t, v: v["current"] * (1 - np.exp(-np.maximum(t, 0) / v["time_constant"]))
        ), _CURRENT,
    ),
    "sensor_bend": Outside(
        "sensor", "a torque sensor that is not linear",
        lambda rng, size: {"torque": size * sign(rng) * rng.uniform(0.4, 0.9)},
        _spline("joint_torque", "load", -16, 16, lambda T, v: v["torque"] * (T / 9.0) ** 2), ("joint_torque",),
    ),
}  # fmt: skip
"""Effects outside the library."""
