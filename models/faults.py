"""Faults of a joint's numbers, and numbers that contradict each other."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

if TYPE_CHECKING:
    from .joint import Joint

Severity = Literal["error", "warning"]


@dataclass(frozen=True)
class Fault:
    """A fault: severity, field in the file, expected and got."""

    severity: Severity
    field: str
    message: str


_UNITS = {"K2": "N·m/rad", "K3": "N·m/rad", "Fs": "N·m"}


def contradictions(value: Mapping[str, float], fitted: Collection[str]) -> Iterator[Fault]:
    """Yield numbers of a joint that contradict each other: a gear that softens with torque, Coulomb above static
    friction. `fitted`: symbols of numbers that may cross, as each follows the data."""

    def ordered(small: str, large: str, why: str, severity: Severity = "error") -> Iterator[Fault]:
        if small in value and large in value and value[small] > value[large]:
            worst: Severity = "warning" if {small, large} & set(fitted) else severity
            text = f"expected {large} ≥ {small} = {value[small]:g} {_UNITS[large]}, {why}, got {value[large]:g}"
            yield Fault(worst, f"numbers.{large}", text)

    yield from ordered("K1", "K3", "a strain wave gear stiffens with torque")
    yield from ordered("K1", "K2", "a strain wave gear stiffens with torque", "warning")
    yield from ordered("K2", "K3", "a strain wave gear stiffens with torque", "warning")
    yield from ordered("Fc", "Fs", "static friction is no less than Coulomb friction")


def unlike_mjcf(joint: Joint) -> Iterator[Fault]:
    """Yield a fault if numbers of a joint's MJCF differ from its description by more than any tolerance. The
    description counts."""
    other = []
    for symbol, got in joint.stated_by_mjcf().items():
        if symbol not in joint.numbers:  # missing: reported elsewhere
            continue
        n = joint.numbers[symbol]
        shared = joint.shared_tolerances.get(n.shared or "", 0.0)
        left_open = math.hypot(n.tolerance * n.value, n.deviation, shared * n.value)
        near = max(4 * left_open, 1e-3 * abs(n.value))
        if min(abs(got - known) for known in (n.value, n.nominal) if known is not None) > near:
            other.append(f"{symbol} = {got:.6g} for {n.value:.6g} {n.unit}")
    if other:
        yield Fault("warning", "model", f"{', '.join(other)} in the MJCF; the description's numbers count")
