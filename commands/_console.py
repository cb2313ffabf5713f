"""The consoles of the commands: results and tables to stdout, progress to stderr."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.console import Console
    from rich.progress import Progress, ProgressColumn

_WIDTH = 132  # columns where the output is not a terminal


def console() -> Console:
    """Return the console for results, which prints text without markup."""
    from rich.console import Console

    found = Console(markup=False, highlight=False, emoji=False)
    if found.is_terminal:
        return found
    return Console(width=max(found.width, _WIDTH), markup=False, highlight=False, emoji=False)


def print_table(
    terminal: Console, title: str, heads: Sequence[str], rows: Iterable[Sequence[str]], left: int = 1, caption: str = ""
) -> None:
    """Print a table; its first `left` columns are aligned to the left, the others to the right."""
    from rich.table import Table
    from rich.text import Text

    table = Table(title=Text(title), caption=Text(caption) if caption else None)
    for i, head in enumerate(heads):
        table.add_column(Text(head), justify="left" if i < left else "right")
    for row in rows:
        table.add_row(*map(Text, row))
    terminal.print(table)


def progress(counting: bool = False, remaining: bool = False) -> Progress:
    """Return a progress bar that disappears, on a terminal only; with a count and the remaining time, if asked for."""
    from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeElapsedColumn, TimeRemainingColumn

    count, rest = [MofNCompleteColumn()] if counting else [], [TimeRemainingColumn()] if remaining else []
    return _bar(TextColumn("{task.description}"), BarColumn(), *count, TimeElapsedColumn(), *rest)


def _bar(*columns: ProgressColumn) -> Progress:
    from rich.console import Console
    from rich.progress import Progress

    terminal = Console(stderr=True)
    terminal.quiet = not terminal.is_terminal  # otherwise Rich 13 ends with an empty line
    return Progress(*columns, console=terminal, transient=True, disable=not terminal.is_terminal)


@contextmanager
def stages(what: str) -> Iterator[Callable[[str, float], None]]:
    """Show the stages of a computation on stderr; yield a function of the stage that begins and the share that is done.

    On a terminal it is a bar that disappears, elsewhere a line per stage. The share never decreases.
    """
    from rich.progress import BarColumn, SpinnerColumn, TaskProgressColumn, TextColumn, TimeElapsedColumn
    from rich.table import Column

    column = Column(no_wrap=True, overflow="ellipsis")
    stage_column = TextColumn("{task.description}", markup=False, table_column=column)
    begin, most, last = time.monotonic(), 0.0, ""
    with _bar(SpinnerColumn(), stage_column, BarColumn(20), TaskProgressColumn(), TimeElapsedColumn()) as bar:
        task = bar.add_task(what, total=1.0)

        def update(stage: str, done: float) -> None:
            nonlocal most, last
            most = max(most, done)
            bar.update(task, description=stage, completed=most)
            if bar.disable and stage != last:
                print(f"{time.monotonic() - begin:6.1f} s {100 * most:3.0f} %  {stage}", file=sys.stderr)
            last = stage

        yield update
