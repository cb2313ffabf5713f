"""Write numbers with intervals, and tables between a page's markers."""

from __future__ import annotations

import re
import textwrap
from pathlib import Path

import numpy as np

from flexspline.models.files import write_text
from flexspline.scenarios.evaluation.intervals import Interval, interval

ROOT = Path(__file__).resolve().parents[1]
_WIDTH = 138  # of the pages' prose


def text(found: Interval, digits: int = 2) -> str:
    """A mean with its interval."""
    if not np.isfinite(found.mean):
        return "–"
    mean, low, high = (f"{round(x, digits) + 0.0:.{digits}f}" for x in (found.mean, found.low, found.high))  # no "-0.0"
    return f"{mean} [{low}, {high}]"


def share(values: np.ndarray) -> str:
    """A mean of shares in per cent, with its interval."""
    found = interval(100 * values)
    return text(Interval(found.mean, max(found.low, 0.0), min(found.high, 100.0), found.n), 0)


def _wrapped(text: str) -> str:
    """Wrap paragraphs to the pages' width, but not tables."""
    parts = text.split("\n\n")
    fill_ = textwrap.TextWrapper(_WIDTH, break_long_words=False, break_on_hyphens=False).fill
    return "\n\n".join(part if part.startswith("|") else fill_(part) for part in parts)


def fill(page: Path, tables: dict[str, str]) -> None:
    """Put each text, tables and paragraphs, between its markers."""
    whole = page.read_text(encoding="utf-8")
    for name, table in tables.items():
        begin, end = f"<!-- begin {name} -->", f"<!-- end {name} -->"
        if begin not in whole or end not in whole:
            raise SystemExit(f"{page}: expected the markers {begin} and {end}")
        pattern = re.escape(begin) + ".*?" + re.escape(end)
        whole = re.sub(pattern, lambda _, t=table, b=begin, e=end: f"{b}\n{_wrapped(t)}\n{e}", whole, flags=re.DOTALL)
    write_text(page, whole)
