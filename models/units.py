"""Spellings of units: N·m, N*m, N.m, Nm; kg·m², kg*m^2, kgm2; ohm, Ω."""

from __future__ import annotations

import re

_SPELLINGS = str.maketrans(
    {"*": "·", ".": "·", "⋅": "·", "•": "·", "\u2126": "Ω", "\u00b3": "^3", "\u00b2": "^2", "\u03bc": "µ"}
)
_PRODUCT = re.compile(r"(?<![A-Za-zµ])([mk]?N|kg|g)(m)(s?)(?![A-Za-z])")  # Nm, mNm, Nms, kgm; not Nmm, which is N·mm
_POWER = re.compile(r"(?<=[A-Za-z])([23])(?![0-9])")  # m2, which is m^2


def plain(unit: str) -> str:
    """Return a unit in one spelling; `1` for an empty one."""
    text = unit.translate(_SPELLINGS).replace("Ω", "ohm").replace(" ", "").replace("1/(", "/(")
    text = _POWER.sub(r"^\1", text)
    text = _PRODUCT.sub(lambda found: "·".join(part for part in found.groups() if part), text)
    text = re.sub(r"\(([^()·/]+)\)", r"\1", text)
    return re.sub(r"^/", "1/", text) or "1"


def same(a: str, b: str) -> bool:
    """Return whether two spellings are of the same unit."""
    return plain(a) == plain(b)
