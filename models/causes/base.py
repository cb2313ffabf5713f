"""The interface of causes: differences of a real joint from its description."""

from __future__ import annotations

from abc import ABC
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from ..errors import InputError
from ..parameters import N_COEFFICIENTS, N_DISCREPANCIES, PLACES, VARIABLES

if TYPE_CHECKING:
    from ..joint import Joint

COMPONENTS = ("motor", "transmission", "link", "sensor")


@dataclass(frozen=True)
class CauseParameter:
    """A parameter of a cause, in the *extended* model."""

    name: str  # as in a diagnosis
    unit: str  # SI unit, `1` for a pure number
    bounds: tuple[float, float]  # smallest and largest possible value
    # intervals of ordinary size, for draws of hidden effects and for priors; with `relative`, in units of the nominal
    # value (0.92 is 8 % less)
    ordinary: tuple[tuple[float, float], ...]
    relative: str | None = None  # field of the parameter record that multiplies `ordinary` and `neutral`
    neutral: float = 0.0  # value without effect (times the relative field)
    magnitude: bool = False  # whether it grows with the size of the effect; other parameters are places or kinds
    integer: bool = False  # whether only whole numbers are possible
    period: float = 0.0  # of an angle [rad], 0 for others
    # smallest and largest whole number that a diagnosis tries, if more than the ordinary ones
    searched: tuple[int, int] | None = None
    # values from which a diagnosis searches, if a few over the ordinary interval are not enough
    starts: tuple[float, ...] = ()


TURN = 2 * np.pi
PHASE = CauseParameter("phase", "rad", (-TURN, TURN), ((0.0, TURN),), period=TURN)  # the phase of a periodic effect


@dataclass(frozen=True)
class Requirements:
    """Conditions of a measurement for a cause of ordinary size to show; by default none."""

    sliding: float = 0.0  # time in which the mesh slides, over all recordings [s]
    reversal: bool = False  # whether the motion must change its direction
    motor_turn: float = 0.0  # travel of the rotor [turns]
    link_travel: float = 0.0  # range of the link's angle [rad]
    link_beyond: float = -np.inf  # angle that the link must pass [rad]
    load_span: float = 0.0  # range of the joint torque, as a share of the rated torque
    speed: float = 0.0  # of the motor, in Stribeck velocities vs
    duration: float = 0.0  # of one recording [s]
    temperature_span: float = 0.0  # range of the temperature [K]
    known_push: bool = False  # whether a recording without unmeasured pushes on the link is needed
    gravity: bool = False  # whether it must have a gravity moment
    arm: bool = False  # whether other joints of an arm must move
    weighed: bool = False  # whether a current is needed, or a load that is not of an arm's mass model


def put_order(p: np.void, field: str, values: dict[str, float]) -> None:
    """Add an order, amplitude and phase to `{field}_order`, `_amplitude`, `_phase`: as a vector to the same order, else
    in the first free place. Raises `InputError`: no place is free."""
    orders, amplitudes, phases = (p[f"{field}_{name}"] for name in ("order", "amplitude", "phase"))
    there = np.flatnonzero((amplitudes != 0) & (orders == values["order"]))
    free = np.flatnonzero(amplitudes == 0)
    if there.size:
        slot = int(there[0])
        whole = sum(
            a * np.exp(1j * f) for a, f in ((amplitudes[slot], phases[slot]), (values["amplitude"], values["phase"]))
        )
        amplitudes[slot], phases[slot] = abs(whole), np.angle(whole)
    elif free.size:
        slot = int(free[0])
        orders[slot], amplitudes[slot], phases[slot] = values["order"], values["amplitude"], values["phase"]
    else:
        raise InputError(f"expected at most {len(orders)} orders of {field.replace('_', ' ')}, got one more")


def put_discrepancy(
    p: np.void, place: str, variable: str, low: float, high: float, coefficients: Sequence[float] | np.ndarray
) -> None:
    """Put a cubic B-spline of a variable into the first free place of a record, in place: a model discrepancy.

    Args:
      place: where it acts (`parameters.PLACES`): torque on rotor or mesh [N·m, motor side], flexspline or link [N·m],
        or the reading to which it is added: joint torque [N·m], link position [rad] or motor current [A].
      variable: `parameters.VARIABLES`, SI.
      low, high: ends of the uniform grid, in the variable's unit; it is constant outside.
      coefficients: 4 to 32 (`spline_through`), in the place's unit.

    Raises:
      InputError: no place is free.
    """
    free = np.flatnonzero(p["discrepancy_place"] == 0)
    if not free.size:
        raise InputError(f"expected at most {N_DISCREPANCIES} model discrepancies, got one more")
    slot, count = int(free[0]), len(coefficients)
    p["discrepancy_place"][slot] = PLACES.index(place)
    p["discrepancy_variable"][slot] = VARIABLES.index(variable)
    p["discrepancy_low"][slot], p["discrepancy_high"][slot] = low, high
    p["discrepancy_count"][slot] = count
    p["discrepancy_coefficient"][slot, :count] = coefficients


def spline_through(values: np.ndarray) -> np.ndarray:
    """Return the coefficients, shape (n + 2,), of the natural cubic spline through n = 2 to 30 values at even points,
    for `put_discrepancy`.

    At the points (c_i + 4 c_{i+1} + c_{i+2}) / 6 = value, and at both ends the second derivative is zero.
    """
    if not 2 <= len(values) <= N_COEFFICIENTS - 2:
        raise InputError(f"spline: expected 2 to {N_COEFFICIENTS - 2} values, got {len(values)}")
    return _through(len(values)) @ np.asarray(values, dtype=np.float64)


@cache
def _through(count: int) -> np.ndarray:
    """Return the matrix from values to coefficients, shape (count + 2, count)."""
    A = np.zeros((count + 2, count + 2))
    for i in range(count):
        A[i + 1, i : i + 3] = np.array([1.0, 4.0, 1.0]) / 6.0
    A[0, :3] = A[-1, -3:] = [1.0, -2.0, 1.0]
    return np.linalg.inv(A)[:, 1:-1]


class Cause(ABC):
    """A cause: its effect on the parameter record, its place, ordinary size and conditions.

    Its effect on residuals follows from the laws, evaluated with and without it. A simple cause is data alone
    (`sets`, `scales`, `order_of`); others define their effect (`apply`, with `present`).
    """

    name: ClassVar[str]
    component: ClassVar[str]
    description: ClassVar[str]
    parameters: ClassVar[tuple[CauseParameter, ...]]
    sets: ClassVar[Mapping[str, str]] = {}
    """Parameters that replace fields of the parameter record."""
    scales: ClassVar[tuple[str, ...]] = ()
    """Fields of the parameter record that its one parameter multiplies."""
    order_of: ClassVar[str] = ""
    """Fields `…_order`, `_amplitude` and `_phase` of the parameter record to which it adds an order (by default 1)."""
    adds: ClassVar[bool] = False
    """Whether a second one adds to the first (another order, a further factor) instead of replacing it."""
    multiple: ClassVar[float] = float("inf")
    """Largest factor by which a description may have its number wrong: beyond it another joint, load or unit is
    likelier."""
    inexact: ClassVar[float] = 0.0
    """Relative standard deviation of its magnitudes, as a real joint's law is another."""
    includes: ClassVar[str] = ""
    """Name of a cause that is a special case of it: it is there wherever this one is."""
    imperfection: ClassVar[bool] = False
    """Whether every real joint has a little of it."""
    sensor: ClassVar[str | None] = None
    """Channel whose reading it changes; None for effects on the joint itself."""
    needs: ClassVar[tuple[str, ...]] = ()
    """Columns of a recording that it needs to show."""
    requires: ClassVar[Requirements] = Requirements()
    """Motion and load that it needs to show at ordinary size."""
    torsion: ClassVar[bool] = False
    """Whether it shows in the torsion only, and so not with one encoder."""
    behind_link_encoder: ClassVar[str] = ""
    """Why it does not show with the link's encoder only; empty if it does."""
    resonance: ClassVar[bool] = False
    """Whether it is a resonance, or makes one: confounded with the transmission's own or a controller's with one
    encoder."""

    ripple: ClassVar[bool] = False
    """Whether it is an order of the motor's angle: with one encoder it is confounded with others, except by the
    transmission's dynamics and an unobserved controller."""

    series: ClassVar[tuple[str, str] | None] = None
    """Place and variable of which it is one order (`parameters.PLACES`, `VARIABLES`): an unknown effect there has all
    of them."""

    def apply(self, p: np.void, values: dict[str, float]) -> None:
        """Apply the effect to a parameter record, in place."""
        for name, field in self.sets.items():
            p[field] = values[name]
        for field in self.scales:
            p[field] *= values[self.parameters[0].name]
        if self.order_of:
            put_order(p, self.order_of, {"order": 1.0, **values})

    def concerns(self, joint: Joint) -> bool:
        """Return whether the cause is possible for a joint description; most are."""
        return True

    def present(self, p: np.void) -> dict[str, float]:
        """Return the values of the parameters without effect on this record."""
        neutral = {q.name: q.neutral * float(p[q.relative]) if q.relative else q.neutral for q in self.parameters}
        return neutral | {name: float(p[field]) for name, field in self.sets.items()}

    def centre(self, p: np.void, fixed: dict[str, float]) -> dict[str, float]:
        """Return the values without effect on this record, given the parameters in `fixed` (an order)."""
        return self.present(p)

    def draw(self, p: np.void, rng: np.random.Generator, size: float = 1.0) -> dict[str, float]:
        """Draw parameters of ordinary size (times `size`) for the joint with record `p`."""
        values: dict[str, float] = {}
        for q in self.parameters:
            widths = np.array([high - low for low, high in q.ordinary])
            low, high = q.ordinary[rng.choice(len(widths), p=widths / widths.sum())]
            value = float(rng.integers(round(low), round(high) + 1)) if q.integer else float(rng.uniform(low, high))
            if q.magnitude:
                value = q.neutral + size * (value - q.neutral)
            values[q.name] = value * float(p[q.relative]) if q.relative else value
        return values
