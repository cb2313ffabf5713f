"""The consoles of the commands: tables keep their width where the output is no terminal."""

from __future__ import annotations

from rich.console import Console

_WIDTH = 132


def console() -> Console:
    """Console for results."""
    found = Console()
    return found if found.is_terminal else Console(width=max(found.width, _WIDTH))
