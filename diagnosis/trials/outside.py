"""Effects outside the library: what no known cause describes, where it sits, and how it is drawn at a size."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ...models.parameters import N_COEFFICIENTS, PLACES, VARIABLES

Values = dict[str, float]
Change = Callable[[np.void], None]
"""Puts an effect into a parameter record, in place."""


@dataclass(frozen=True)
class Outside:
    """An effect that no cause of the library describes: where it sits, how it is drawn at a size, in which channels it shows."""

    component: str
    make: Callable[[np.random.Generator, float], tuple[Values, Change, str]]
    needs: tuple[str, ...] = ()


def sign(rng: np.random.Generator) -> float:
    """−1 or 1."""
    return float(rng.choice((-1.0, 1.0)))


def _put(
    p: np.void, place: str, variable: str, low: float, high: float, shape: Callable[[np.ndarray], np.ndarray]
) -> None:
    """Put a function into a record as a model discrepancy, the spline through it."""
    slot = int(np.flatnonzero(p["discrepancy_place"] == 0)[0])
    n = N_COEFFICIENTS
    knots = low + (np.arange(n) - 1) / (n - 3) * (high - low)
    # Values at the knots are (c₋ + 4c + c₊)/6: solve for the coefficients, ends continued.
    A = (np.diag(np.full(n, 4.0)) + np.diag(np.ones(n - 1), 1) + np.diag(np.ones(n - 1), -1)) / 6.0
    A[0, 0] = A[-1, -1] = 5.0 / 6.0
    p["discrepancy_place"][slot], p["discrepancy_variable"][slot] = PLACES.index(place), VARIABLES.index(variable)
    p["discrepancy_low"][slot], p["discrepancy_high"][slot], p["discrepancy_count"][slot] = low, high, n
    p["discrepancy_coefficient"][slot] = np.linalg.solve(A, shape(knots))


def _link_bump(rng: np.random.Generator, size: float) -> tuple[Values, Change, str]:
    amplitude, angle, width = size * sign(rng) * rng.uniform(2, 4), rng.uniform(-0.6, 0.6), rng.uniform(0.08, 0.14)

    def apply(p: np.void) -> None:
        _put(
            p, "link", "link_position", angle - 1, angle + 1,
            lambda x: amplitude * np.exp(-0.5 * ((x - angle) / width) ** 2),
        )  # fmt: skip

    return {"amplitude": amplitude, "angle": angle, "width": width}, apply, "a torque on the link near one angle"


def _quadratic_friction(rng: np.random.Generator, size: float) -> tuple[Values, Change, str]:
    torque = size * rng.uniform(0.02, 0.04)

    def apply(p: np.void) -> None:
        _put(p, "mesh", "motor_velocity", -150.0, 150.0, lambda w: torque * (w / 80.0) * np.abs(w / 80.0))

    return {"torque": torque}, apply, "mesh friction that grows with the square of velocity"


def _stepped_friction(rng: np.random.Generator, size: float) -> tuple[Values, Change, str]:
    torque, angle = size * rng.uniform(0.008, 0.015), rng.uniform(-0.6, 0.6)

    def apply(p: np.void) -> None:
        _put(
            p, "mesh", "direction_link_position", angle - 1, angle + 1,
            lambda x: 0.5 * torque * (1 + np.tanh((x - angle) / 0.1)),
        )  # fmt: skip

    return {"torque": torque, "angle": angle}, apply, "mesh friction that is higher beyond an angle of the link"


def _half_order(rng: np.random.Generator, size: float) -> tuple[Values, Change, str]:
    amplitude, phase = size * rng.uniform(0.8e-4, 2e-4), rng.uniform(0, 2 * np.pi)

    def apply(p: np.void) -> None:
        slot = int(np.flatnonzero(p["amplitude"] == 0)[0])
        p["order"][slot], p["amplitude"][slot], p["phase"][slot] = 0.5, amplitude, phase

    return (
        {"order": 0.5, "amplitude": amplitude, "phase": phase},
        apply,
        "kinematic error once in two turns of the motor",
    )


def _rotor_pulse(rng: np.random.Generator, size: float) -> tuple[Values, Change, str]:
    torque, angle = size * sign(rng) * rng.uniform(0.015, 0.03), rng.uniform(0, 2 * np.pi)

    def apply(p: np.void) -> None:
        _put(
            p, "rotor", "motor_position", 0.0, 2 * np.pi,
            lambda x: torque * np.exp(-0.5 * (((x - angle + np.pi) % (2 * np.pi) - np.pi) / 0.35) ** 2),
        )  # fmt: skip

    return {"torque": torque, "angle": angle}, apply, "a torque pulse on the rotor, once a turn"


def _current_drift(rng: np.random.Generator, size: float) -> tuple[Values, Change, str]:
    current, seconds = size * sign(rng) * rng.uniform(0.08, 0.2), rng.uniform(5, 12)

    def apply(p: np.void) -> None:
        _put(p, "motor_current", "time", 0.0, 60.0, lambda t: current * (1 - np.exp(-np.maximum(t, 0) / seconds)))

    return {"current": current, "time_constant": seconds}, apply, "a current reading that drifts as it warms up"


def _sensor_bend(rng: np.random.Generator, size: float) -> tuple[Values, Change, str]:
    torque = size * sign(rng) * rng.uniform(0.4, 0.9)

    def apply(p: np.void) -> None:
        _put(p, "joint_torque", "load", -16.0, 16.0, lambda T: torque * (T / 9.0) ** 2)

    return {"torque": torque}, apply, "a torque sensor that is not linear"


OUTSIDE: dict[str, Outside] = {
    "link_bump": Outside("link", _link_bump),
    "quadratic_friction": Outside("transmission", _quadratic_friction, ("motor_current",)),
    "stepped_friction": Outside("transmission", _stepped_friction, ("motor_current",)),
    "half_order": Outside("transmission", _half_order),
    "rotor_pulse": Outside("motor", _rotor_pulse, ("motor_current",)),
    "current_drift": Outside("sensor", _current_drift, ("motor_current",)),
    "sensor_bend": Outside("sensor", _sensor_bend, ("joint_torque",)),
}
"""Effects outside the library."""
