"""Tuning parameters of a filter: fields of its settings with bounds, for tuning and sweeping."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Literal


@dataclass(frozen=True)
class TuningParameter:
    """A tuning parameter."""

    field: str  # its name; dotted inside a dataclass (`process.push`)
    low: float  # lower bound, in the field's unit
    high: float  # upper bound
    scale: Literal["log", "linear"] = "log"  # of the search; `log` needs low > 0

    def to_unit(self, value: float) -> float:
        """Return the value's place between the bounds, 0 to 1."""
        if self.scale == "log":
            place = math.log(max(value, self.low) / self.low) / math.log(self.high / self.low)
        else:
            place = (value - self.low) / (self.high - self.low)
        return min(max(place, 0.0), 1.0)

    def from_unit(self, place: float) -> float:
        """Return the value at a place between the bounds."""
        place = min(max(float(place), 0.0), 1.0)
        if self.scale == "log":
            return self.low * (self.high / self.low) ** place
        return self.low + (self.high - self.low) * place


def value_of(settings: Any, field: str) -> Any:
    """Return the value of a field, which may be dotted."""
    for part in field.split("."):
        settings = getattr(settings, part)
    return settings


def with_values(settings: Any, values: Mapping[str, Any]) -> Any:
    """Return a copy of frozen settings with other values, by field; fields may be dotted."""
    own: dict[str, Any] = {}
    inner: dict[str, dict[str, Any]] = {}
    for field, value in values.items():
        head, _, rest = field.partition(".")
        if rest:
            inner.setdefault(head, {})[rest] = value
        else:
            own[head] = value
    for head, parts in inner.items():
        own[head] = with_values(getattr(settings, head), parts)
    return replace(settings, **own)
