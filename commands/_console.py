"""The consoles of the commands: results to stdout, where tables keep their width if it is no terminal; progress to stderr."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.console import Console
    from rich.progress import Progress

_WIDTH = 132


def console() -> Console:
    """Console for results: text is printed as it is, nothing in it is taken for a style."""
    from rich.console import Console

    found = Console(markup=False, highlight=False, emoji=False)
    if found.is_terminal:
        return found
    return Console(width=max(found.width, _WIDTH), markup=False, highlight=False, emoji=False)


def progress(counting: bool = False, remaining: bool = False) -> Progress:
    """A progress bar that vanishes, on a terminal only; `counting`: done of how many; `remaining`: the time that is left."""
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
    terminal = Console(stderr=True)
    terminal.quiet = not terminal.is_terminal  # where nothing is shown Rich 13 ends it with an empty line
    return Progress(*columns, console=terminal, transient=True, disable=not terminal.is_terminal)


@contextmanager
def stages(what: str) -> Iterator[Callable[[str, float], None]]:
    """Show the stages of one piece of work on stderr; gives what is called with a stage that begins and the share that is done.

    On a terminal a bar that vanishes, with the time that it has taken; elsewhere a line a stage. What begins once more does not
    take the share back.
    """
    from rich.console import Console

    terminal = Console(stderr=True, emoji=False)
    begin, most = time.monotonic(), 0.0

    def furthest(done: float) -> float:
        nonlocal most
        most = max(most, done)
        return most

    if not terminal.is_terminal:
        told = ""

        def line(stage: str, done: float) -> None:
            nonlocal told
            if stage != told:
                told = stage
                share, seconds = furthest(done), time.monotonic() - begin
                terminal.print(f"{seconds:6.1f} s {100 * share:3.0f} %  {stage}", markup=False, highlight=False)

        yield line
        return
    from rich.progress import BarColumn, Progress, SpinnerColumn, TaskProgressColumn, TextColumn, TimeElapsedColumn
    from rich.table import Column

    stage_column = TextColumn(
        "{task.description}", markup=False, table_column=Column(no_wrap=True, overflow="ellipsis")
    )
    columns = (SpinnerColumn(), stage_column, BarColumn(20), TaskProgressColumn(), TimeElapsedColumn())
    with Progress(*columns, console=terminal, transient=True) as bar:
        task = bar.add_task(what, total=1.0)
        yield lambda stage, done: bar.update(task, description=stage, completed=furthest(done))
