"""What a cause is: one way in which a real joint differs from its description."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

COMPONENTS = ("motor", "transmission", "link", "sensor")


@dataclass(frozen=True)
class Parameter:
    """A parameter of a cause, of the *extended* model.

    Attributes:
      name: as in recordings' diagnosis output.
      unit: SI unit, empty for a pure number.
      bounds: smallest and largest value that makes sense.
      ordinary: intervals of ordinary size, from which hidden effects are drawn and priors are made; in units of the
        nominal value where `relative` is set (0.92 is 8 % less).
      relative: field of the parameter record that `ordinary` and `neutral` multiply.
      neutral: the value at which the cause does nothing (times the relative field).
      magnitude: whether it grows with the size of the effect; the others say where or how.
      integer: whether only whole numbers make sense.
      period: of an angle [rad], 0 for others.
    """

    name: str
    unit: str
    bounds: tuple[float, float]
    ordinary: tuple[tuple[float, float], ...]
    relative: str | None = None
    neutral: float = 0.0
    magnitude: bool = False
    integer: bool = False
    period: float = 0.0


TURN = 2 * np.pi
PHASE = Parameter("phase", "rad", (-TURN, TURN), ((0.0, TURN),), period=TURN)
"""The phase of a periodic effect."""


def put_order(p: np.void, field: str, values: dict[str, float]) -> None:
    """Put order, amplitude and phase into the first free place of `{field}_order`, `_amplitude`, `_phase`."""
    slot = int(np.flatnonzero(p[f"{field}_amplitude"] == 0)[0])
    for name in ("order", "amplitude", "phase"):
        p[f"{field}_{name}"][slot] = values[name]


class Cause(ABC):
    """A cause: what it does to the parameter record, where it sits, and how large it ordinarily is.

    What it leaves in the residuals is not written down: it follows from the laws, evaluated with and without it.
    """

    name: ClassVar[str]
    component: ClassVar[str]
    description: ClassVar[str]
    parameters: ClassVar[tuple[Parameter, ...]]
    needs: ClassVar[tuple[str, ...]] = ()
    """Columns of a recording without which the cause cannot show."""
    adds: ClassVar[bool] = False
    """Whether a second one adds to the first (another order), instead of replacing it."""
    scales: ClassVar[tuple[str, ...]] = ()
    """Fields of the parameter record that its one parameter multiplies."""

    @abstractmethod
    def apply(self, p: np.void, values: dict[str, float]) -> None:
        """Put the effect into a parameter record, in place."""

    def concerns(self, joint: object) -> bool:
        """Whether a joint description (`models.joint.Joint`) leaves room for the cause; most do."""
        return True

    def present(self, p: np.void) -> dict[str, float]:
        """Values of the parameters at which this record would not change: the absence of the effect."""
        return {q.name: (q.neutral * float(p[q.relative]) if q.relative else q.neutral) for q in self.parameters}

    def centre(self, p: np.void, fixed: dict[str, float]) -> dict[str, float]:
        """Values at which this record would not change, given the parameters in `fixed` (an order)."""
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
