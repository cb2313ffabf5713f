"""What a finding means on the machine: a sentence in everyday units, its usual origin, how to check it, what to do."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

import yaml

from ..models import causes
from .numbers import with_std

if TYPE_CHECKING:
    from ..diagnosis.answer import Finding, ParameterEstimate
    from ..models.causes import CauseParameter
    from ..models.joint import Joint

UNDETERMINED = "not determined"


@dataclass(frozen=True)
class Advice:
    """A finding for the person at the machine; `typical`, `check` and `do` are empty for a cause without advice."""

    sentence: str
    typical: str = ""
    check: str = ""
    do: str = ""


@cache
def _texts() -> dict[str, dict[str, str]]:
    return yaml.safe_load(Path(__file__).with_name("advice.yaml").read_text(encoding="utf-8"))


def advice(c: Finding, joint: Joint) -> Advice:
    """Return what a finding means; `joint`: its description, for values relative to it."""
    if c.name == "unknown":
        return Advice(f"no known cause explains {c.description or 'an effect'}")
    library, text = causes.get(c.name), _texts().get(c.name)
    if text is None or any(q.name not in c.parameters for q in library.parameters):
        return Advice(library.description)
    values = {q.name: _everyday(c.parameters[q.name], q, joint) for q in library.parameters}
    return Advice(text["says"].format(**values), text["typical"], text["check"], text["do"])


def parameter_text(name: str, c: Finding, joint: Joint) -> str:
    """Return a parameter as `0.2821 ± 0.0002 N·m`, or that the data do not determine it."""
    p = c.parameters[name]
    q = next((q for q in causes.get(c.name).parameters if q.name == name), None) if c.name in causes.names() else None
    if q is not None and not determined(p, q, joint):
        return UNDETERMINED
    return with_std(p.value, p.std, p.unit)


def determined(p: ParameterEstimate, q: CauseParameter, joint: Joint) -> bool:
    """Whether the data determine a parameter: a phase to a quarter of a turn, a size to its own deviation from neutral."""
    if q.period:
        return p.std < 0.25 * q.period
    neutral = q.neutral * (float(joint.bare_record()[0][q.relative]) if q.relative else 1.0)
    return not q.magnitude or p.std < abs(p.value - neutral)


def _everyday(p: ParameterEstimate, q: CauseParameter, joint: Joint) -> str:
    """A parameter in the units that people measure it in."""
    value = p.value
    if not determined(p, q, joint):
        return "an amount that these data do not determine"
    if q.integer:
        return f"{value:g}"
    if q.name == "ratio":
        return f"{100 * abs(value):.2g} % higher {'forward' if value > 0 else 'backward'} than on average"
    if q.relative or q.name in ("scale", "gain"):
        change = value / (float(joint.bare_record()[0][q.relative]) if q.relative else 1.0) - 1.0
        return f"{100 * abs(change):.2g} % {'above' if change > 0 else 'below'} the described value"
    if q.unit == "rad":
        small = q.name in ("amplitude", "width", "extent")
        return f"{math.degrees(value) * 60:.2g} arcmin" if small else f"{math.degrees(value):.2g}°"
    if q.unit == "N·m" and q.name in ("amplitude", "torque"):
        output = abs(value) * (joint.numbers["N"].value if q.name == "amplitude" else 1.0)
        return f"{output:.2g} N·m at the output ({100 * output / joint.numbers['rated_torque'].value:.2g} % of the rated torque)"
    if q.unit == "1" and q.name == "amplitude":
        return f"{100 * abs(value):.2g} % {'higher' if value > 0 else 'lower'}"
    scaled = {"1": (100.0, "%"), "1/K": (100.0, "% per K"), "s": (1e3, "ms") if value < 1 else (1.0, "s")}
    factor, unit = scaled.get(q.unit, (1.0, q.unit))
    return f"{factor * value:.2g} {unit}".replace("-", "−")
