"""The consoles of the commands: results to stdout, where tables keep their width if it is no terminal; progress to stderr."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.console import Console
    from rich.progress import Progress

_WIDTH = 132


def console() -> Console:
    """Console for results."""
    from rich.console import Console

    found = Console()
    return found if found.is_terminal else Console(width=max(found.width, _WIDTH))


def progress(counting: bool = False, remaining: bool = False) -> Progress:
    """A progress bar that vanishes; `counting`: done of how many; `remaining`: the time that is left."""
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        ProgressColumn,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    columns: list[ProgressColumn] = [TextColumn("{task.description}"), BarColumn()]
    columns += [MofNCompleteColumn()] if counting else []
    columns += [TimeElapsedColumn()]
    columns += [TimeRemainingColumn()] if remaining else []
    return Progress(*columns, console=Console(stderr=True), transient=True)
