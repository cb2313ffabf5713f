"""Lists by name: a table for people, JSON for programs."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated

import typer

AsJson = Annotated[bool, typer.Option("--json", help="Print JSON instead of a table.")]


@dataclass(frozen=True)
class Entry:
    """An entry of a list: its kind in a few words, a line of description, and its source."""

    kind: str
    description: str
    source: str


def show(what: str, entries: Mapping[str, Entry], as_json: bool) -> None:
    """Print a list in 80 columns, or as JSON; `what`: heading of the names."""
    if as_json:
        from ..models.files import json_text

        print(json_text(dict(entries)))
        return
    from rich.table import Table
    from rich.text import Text

    from ._console import console

    terminal = console()
    table = Table(box=None, show_edge=False, pad_edge=False, padding=(0, 2, 0, 0), header_style="dim")
    longest = max(map(len, entries), default=0)
    table.add_column(what, no_wrap=longest <= terminal.width // 3, overflow="fold", style="bold")
    table.add_column("", overflow="fold")
    for name, entry in entries.items():
        text = Text.assemble((f"{entry.kind}. " if entry.kind else "", "dim"), _first_sentence(entry.description))
        if entry.source and entry.source != __name__.split(".")[0]:
            text.append(f" ({_line(entry.source)})", style="dim")
        table.add_row(Text(name), text)
    terminal.print(table)


def _first_sentence(text: str) -> str:
    return re.split(r"(?<=[\w)]{2}\.) (?=[A-Zθ])", _line(text))[0].rstrip(".")


def _line(text: str) -> str:
    return " ".join(text.split())
