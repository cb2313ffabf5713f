"""Results in a notebook: a short text (`__repr__`), and small tables in HTML (`_repr_html_`), everything escaped."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from html import escape
from typing import Any


def shortened(head: str, lines: Sequence[str], most: int = 8) -> str:
    """Return a heading with an open bracket, the first lines, and how many there are more."""
    more = len(lines) - most
    return "\n".join([head, *lines[:most], f"  and {more} more)" if more > 0 else ")"])


def paragraph(word: str, text: str = "") -> str:
    """Return a paragraph that begins with a bold word."""
    return f"<p><b>{escape(word)}</b>{' ' if text else ''}{escape(text)}</p>"


def html_table(headings: Sequence[str], rows: Iterable[Sequence[Any]]) -> str:
    """Return a table; numbers with four digits on the right, other values on the left. Empty without rows."""
    body = "".join(f"<tr>{''.join(map(_cell, row))}</tr>" for row in rows)
    head = "".join(f"<th>{escape(heading)}</th>" for heading in headings)
    return f"<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>" if body else ""


def listing(items: Iterable[str]) -> str:
    """Return a numbered list; empty without items."""
    body = "".join(f"<li>{escape(item)}</li>" for item in items)
    return f"<ol>{body}</ol>" if body else ""


def _cell(value: Any) -> str:
    if value is None:
        return "<td>–</td>"
    if isinstance(value, float):
        return f'<td style="text-align:right">{value:.4g}</td>'
    if isinstance(value, int):
        return f'<td style="text-align:right">{value}</td>'
    return f'<td style="text-align:left">{escape(str(value))}</td>'
