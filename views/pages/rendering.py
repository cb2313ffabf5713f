"""Templates to text: numbers as people write them, symbols with their meaning, everything else escaped."""

from __future__ import annotations

import math
import re
from functools import cache
from pathlib import Path
from typing import Any

from jinja2 import Environment, FileSystemLoader, StrictUndefined

from ..glossary import meaning, pieces
from ..report import plain

TEMPLATES = Path(__file__).resolve().parents[1] / "templates"
_SUPERSCRIPT = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def render(template: str, context: dict[str, Any]) -> str:
    """A template of `views/templates` with a context; a name that the context does not have is an error."""
    return _environment().get_template(template).render(context)


@cache
def _environment() -> Environment:
    made = Environment(
        loader=FileSystemLoader(TEMPLATES), autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )  # fmt: skip
    made.filters |= {
        "number": number, "percent": percent, "sentence": sentence, "evidence": evidence, "meaning": meaning,
        "pieces": pieces, "plain": plain,
    }  # fmt: skip
    return made


def number(value: float, digits: int = 4) -> str:
    """A number for people: powers of ten only far from 1; also one that is none, as numbers of 10³⁰⁸ come to."""
    if math.isfinite(value) and value != 0 and not 1e-3 <= abs(value) < 1e5:
        mantissa, exponent = f"{value:.{digits - 1}e}".split("e")
        return f"{float(mantissa):g}·10".replace("-", "−") + str(int(exponent)).translate(_SUPERSCRIPT)
    text = f"{value:.{digits}g}"
    return (f"{float(text):.0f}" if "e" in text else text).replace("-", "−")


def percent(share: float, decimals: int = 0, sign: bool = False) -> str:
    """A share of 1 in percent, with the sign of a change if asked for."""
    rounded = round(100 * share, decimals) + 0.0
    return f"{rounded:{'+' if sign and rounded else ''}.{decimals}f} %".replace("-", "−")


def evidence(value: float) -> str:
    """Log evidence, or standard deviations."""
    return f"{value:.1f}" if value < 100 else f"{value:.0f}"


def with_std(value: float, std: float, unit: str) -> str:
    """`0.2821 ± 0.0002 N·m`: as many digits as the standard deviation bears; without it where it is not above zero."""
    tail = f" {unit}" if unit and unit != "1" else ""
    if not 0 < std < math.inf:
        return f"{number(value)}{tail}"
    largest = max(abs(value), std)
    power = 0 if 1e-3 <= largest < 1e5 and std >= 1e-5 else math.floor(math.log10(largest))
    value, std = value / 10.0**power, std / 10.0**power
    decimals = -math.floor(math.log10(std))
    if round(std * 10**decimals) == 1:  # a second digit where the first is 1
        decimals += 1
    decimals = min(max(decimals, 0), 6)
    both = f"{value:.{decimals}f} ± {std:.{decimals}f}".replace("-", "−")
    return f"({both})·10{str(power).translate(_SUPERSCRIPT)}{tail}" if power else f"{both}{tail}"


def sentence(text: str) -> str:
    """With a capital at its beginning and a full stop at its end."""
    return text[:1].upper() + text[1:].rstrip(".") + "."


def squeezed(page: str) -> str:
    """Without the white space at the beginning of lines and empty lines, which templates leave."""
    return re.sub(r"\n\s*", "\n", page)
