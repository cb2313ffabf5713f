"""Templates to text: numbers as people write them, symbols with their meaning, everything else escaped.

Also what pages state of their origin: date, versions, and digests of the data.
"""

from __future__ import annotations

import hashlib
import platform
import re
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import datetime
from functools import cache
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np
from jinja2 import Environment, FileSystemLoader, StrictUndefined

from ...models.errors import InputError
from ...models.files import check_format, read_json
from ...models.recording import Recording
from ..glossary import meaning, pieces
from ..numbers import number, percent
from ..report import plain

TEMPLATES = Path(__file__).resolve().parents[1] / "templates"
_DIGITS = 12  # of a digest


def render(template: str, context: dict[str, Any]) -> str:
    """Fill a template of `views/templates`; return a page without references to other files.

    `written` and `versions` are known to every template. Any other name that the context does not have is an error.
    """
    page = _pages().get_template(template).render({"written": now(), "versions": versions()} | context)
    return re.sub(r"\n\s*", "\n", page)  # without indentation and empty lines of templates


def environment(**options: Any) -> Environment:
    """Return the templates of `views/templates`; `options`: of jinja2."""
    loader = FileSystemLoader(TEMPLATES)
    return Environment(loader=loader, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True, **options)


@cache
def _pages() -> Environment:
    made = environment(autoescape=True)
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


@contextmanager
def output_of(path: Path, command: str) -> Iterator[dict[str, Any]]:
    """Read a JSON file of a command, whose keys and types the block checks. Raises `InputError`: other content."""
    answer = read_json(path, f"the output of flexspline {command}")
    check_format(answer, path)
    try:
        yield answer
    except (ValueError, KeyError, TypeError, AttributeError, OverflowError) as error:
        raise InputError(f"{path}: expected the output of flexspline {command}, got something else") from error


def now() -> str:
    """Return date and time, as pages state them."""
    return datetime.now().astimezone().strftime("%Y-%m-%d %H:%M %Z")


def versions() -> dict[str, str]:
    """Return the versions of this package and of what computes, by name."""
    packages = {name: metadata.version(name) for name in ("flexspline", "mujoco", "numpy", "scipy")}
    return packages | {"Python": platform.python_version()}


def file_digest(path: Path) -> str:
    """Return the first digits of a file's SHA-256."""
    return hashlib.sha256(path.read_bytes()).hexdigest()[:_DIGITS]


def fingerprint(recording: Recording) -> str:
    """Return the first digits of the SHA-256 of a recording's columns: equal for the same data."""
    digest = hashlib.sha256()
    for name, values in recording.columns.items():
        digest.update(name.encode())
        digest.update(np.ascontiguousarray(values, "<f8").tobytes())
    return digest.hexdigest()[:_DIGITS]
