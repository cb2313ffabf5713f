"""Causes in an optimiser's coordinates: of order one, with a prior, instead of parameters with units.

Magnitudes are in ordinary sizes, from where the cause does nothing. An amplitude with a phase becomes two Cartesian coordinates,
in which it is linear and not singular. Other positive parameters are logarithmic. Whole-number parameters (orders) are not
coordinates: each of their values is a separate hypothesis.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from ...models.causes import Cause, CauseParameter
from ...models.parameters import short_way

SPREAD = 1.2
"""Prior standard deviation of a magnitude, in ordinary sizes: small effects are as likely as ordinary ones."""
SHAPE_SPREAD = 1.3
"""Prior standard deviation of the other coordinates, in half widths of their ordinary interval."""
SHAPE_REACH = 2.2
"""Half widths within which they stay: a much slower or farther effect is another one."""


@dataclass(frozen=True)
class Hypothesis:
    """One cause with its whole-number parameters fixed.

    Attributes:
      cause: the cause.
      fixed: its whole-number parameters.
      centre: values at which the joint does not change, in the units of the cause's parameters.
      start: values of the parameters that are no magnitudes, from which a search starts.
      alternatives: number of whole numbers over which the prior is spread.
      scale: of each parameter, its ordinary size or half width.
    """

    cause: Cause
    fixed: dict[str, float]
    centre: dict[str, float]
    start: dict[str, float]
    alternatives: int = 1
    scale: dict[str, float] = field(default_factory=dict)

    @property
    def key(self) -> tuple[Any, ...]:
        """Identity: the cause's name and its whole numbers."""
        return (self.cause.name, *self.fixed.items())

    @cached_property
    def free(self) -> list[CauseParameter]:
        """The parameters that are not fixed."""
        return [q for q in self.cause.parameters if q.name not in self.fixed]

    @cached_property
    def polar(self) -> bool:
        """Whether amplitude and phase are Cartesian coordinates."""
        return any(q.period for q in self.cause.parameters)

    @cached_property
    def size(self) -> int:
        """Number of coordinates."""
        return len(self.free)

    @cached_property
    def magnitudes(self) -> list[int]:
        """Indices of the coordinates that vanish with the effect."""
        return [i for i, q in enumerate(self.free) if q.magnitude or self.polar]

    def values(self, u: np.ndarray) -> dict[str, float]:
        """Return the cause's parameters at coordinates u, within their bounds."""
        values = self._unbounded(u)
        for q in self.free:
            if not q.period:
                low, high = q.bounds
                values[q.name] = min(max(values[q.name], low), high)
        return values

    def _unbounded(self, u: np.ndarray) -> dict[str, float]:
        values = dict(self.fixed)
        if self.polar:
            amplitude, phase = (q.name for q in self.free)
            z = complex(u[0], u[1]) * self.scale[amplitude] + self.centre[amplitude] * np.exp(1j * self.centre[phase])
            values[amplitude], values[phase] = float(abs(z)), float(np.angle(z))
            return values
        for q, x in zip(self.free, u, strict=True):
            if q.magnitude:
                value = self.centre[q.name] + self.scale[q.name] * x
            elif q.ordinary[0][0] > 0:
                value = self.start[q.name] * np.exp(self.scale[q.name] * x)
            else:
                value = self.start[q.name] + self.scale[q.name] * x
            values[q.name] = float(value)
        return values

    def coordinates(self, values: dict[str, float]) -> np.ndarray:
        """Return coordinates u of parameters, shape (size,): of magnitudes the inverse of `values`, zero for others."""
        u = np.zeros(self.size)
        if self.polar:
            amplitude, phase = (q.name for q in self.free)
            z = values[amplitude] * np.exp(1j * values[phase])
            z -= self.centre[amplitude] * np.exp(1j * self.centre[phase])
            u[:] = np.array([z.real, z.imag]) / self.scale[amplitude]
            return u
        for i in self.magnitudes:
            q = self.free[i]
            u[i] = (values[q.name] - self.centre[q.name]) / self.scale[q.name]
        return u

    @property
    def limits(self) -> tuple[np.ndarray, np.ndarray]:
        """Smallest and largest coordinates, shape (size,) each: the parameters' bounds."""
        low, high = np.full(self.size, -SHAPE_REACH), np.full(self.size, SHAPE_REACH)
        for i, q in enumerate(self.free):
            if self.polar:
                low[i], high[i] = -1e3, 1e3
            elif q.magnitude:
                low[i], high[i] = ((b - self.centre[q.name]) / self.scale[q.name] for b in q.bounds)
        return low, high

    def at_bound(self, u: np.ndarray) -> bool:
        """Return whether a size is at the bound of the cause's parameters. At zero a part of the effect is absent."""
        if self.polar:
            amplitude = self.free[0]
            return self.values(u)[amplitude.name] >= amplitude.bounds[1]
        low, high = (limit[self.magnitudes] for limit in self.limits)
        present = np.array([self.free[i].bounds[0] != 0.0 for i in self.magnitudes], bool)
        return bool(np.any((present & (u[self.magnitudes] <= low + 1e-6)) | (u[self.magnitudes] >= high - 1e-6)))

    def confine(self, u: np.ndarray) -> np.ndarray:
        """Return coordinates within their limits."""
        return np.clip(u, *self.limits)

    @property
    def spread(self) -> np.ndarray:
        """Prior standard deviation of each coordinate, shape (size,)."""
        return np.array([SPREAD if i in self.magnitudes else SHAPE_SPREAD for i in range(self.size)])

    def deviation(self, u: np.ndarray, covariance: np.ndarray) -> dict[str, float]:
        """Return standard deviations of the free parameters from the coordinates' covariance, at a bound as inside."""
        step = 1e-4
        at = self._unbounded(u)
        names = [q.name for q in self.free]
        slope = np.empty((len(names), self.size))
        for j in range(self.size):
            moved = self._unbounded(u + step * np.eye(self.size)[j])
            for i, q in enumerate(self.free):
                slope[i, j] = short_way(moved[q.name] - at[q.name], q.period) / step
        variance = np.einsum("ij,jk,ik->i", slope, covariance, slope)
        return dict(zip(names, np.sqrt(np.maximum(variance, 0.0)), strict=True))


def hypotheses(cause: Cause, record: np.ndarray, present: dict[str, float] | None = None) -> list[Hypothesis]:
    """Return every hypothesis of a cause for a joint with this record: its orders times its starting points.

    Args:
      present: parameters of this cause in the joint's description, if it has them.
    """
    p = record[0]
    neutral = cause.present(p)
    if present is not None:
        again = record.copy()
        cause.apply(again[0], present)
        if (
            again.tobytes() == record.tobytes()
        ):  # the cause replaces its number: the joint does not change at these values
            neutral = dict(present)
        else:
            present = None
    whole = [q for q in cause.parameters if q.integer]
    shape = [q for q in cause.parameters if not (q.integer or q.magnitude or q.period)]
    scale = {}
    for q in cause.parameters:
        unit = float(p[q.relative]) if q.relative else 1.0
        if q.magnitude:
            scale[q.name] = unit * float(np.mean([abs(0.5 * (low + high) - q.neutral) for low, high in q.ordinary]))
        elif not q.integer:
            low, high = q.ordinary[0]
            scale[q.name] = max(0.5 * np.log(high / low), 0.3) if low > 0 else 0.5 * (high - low)
    limits = [q.searched or (round(q.ordinary[0][0]), round(q.ordinary[0][1])) for q in whole]
    orders = [range(low, high + 1) for low, high in limits]
    grids = []
    for q in shape:
        low, high = q.ordinary[0]
        if q.starts:
            grids.append(np.array(q.starts))
            continue
        count = 5 if high / max(low, 1e-12) < 2 and low > 0 else 3
        grids.append(np.geomspace(low, high, count) if low > 0 else np.linspace(low, high, count))
    found = []
    alternatives = int(np.prod([len(o) for o in orders])) if orders else 1
    for chosen in itertools.product(*orders):
        fixed = {q.name: float(v) for q, v in zip(whole, chosen, strict=True)}
        centre = cause.centre(p, fixed) if present is None else neutral
        for where in itertools.product(*grids):
            start = {q.name: float(v) for q, v in zip(shape, where, strict=True)}
            found.append(Hypothesis(cause, fixed, centre, start, alternatives, scale))
    return found
