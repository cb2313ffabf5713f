"""Templates to text: numbers as people write them, symbols with their meaning, everything else escaped."""

from __future__ import annotations

import re
from functools import cache
from pathlib import Path
from typing import Any

from jinja2 import Environment, FileSystemLoader, StrictUndefined

from ..glossary import meaning, pieces
from ..numbers import number, percent
from ..report import plain
from .provenance import now, versions

TEMPLATES = Path(__file__).resolve().parents[1] / "templates"


def render(template: str, context: dict[str, Any]) -> str:
    """Fill a template of `views/templates`; return a page without references to other files.

    `written` and `versions` are known to every template. Any other name that the context does not have is an error.
    """
    page = _environment().get_template(template).render({"written": now(), "versions": versions()} | context)
    return re.sub(r"\n\s*", "\n", page)  # without indentation and empty lines of templates


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


def evidence(value: float) -> str:
    """Return log evidence or standard deviations as text."""
    return f"{value:.1f}" if value < 100 else f"{value:.0f}"


def sentence(text: str) -> str:
    """Return a text with a capital at its beginning and a full stop at its end."""
    return text[:1].upper() + text[1:].rstrip(".") + "."
