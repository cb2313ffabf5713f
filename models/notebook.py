"""Results as a notebook shows them (`_repr_html_`): small tables in HTML, everything escaped."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from html import escape
from typing import Any


def paragraph(word: str, text: str = "") -> str:
    """A paragraph that begins with a word that counts."""
    return f"<p><b>{escape(word)}</b>{' ' if text else ''}{escape(text)}</p>"


def html_table(headings: Sequence[str], rows: Iterable[Sequence[Any]]) -> str:
    """A table; numbers with four digits to the right, anything else to the left. Nothing where there are no rows."""
    body = "".join(f"<tr>{''.join(map(_cell, row))}</tr>" for row in rows)
    head = "".join(f"<th>{escape(heading)}</th>" for heading in headings)
    return f"<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>" if body else ""


def listing(items: Iterable[str]) -> str:
    """A numbered list; nothing where it is empty."""
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
