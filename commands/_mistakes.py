"""Mistakes in the data as a table: what `check` and `import` share."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.console import Console

    from ..diagnosis.data.mistakes import Mistake


def print_mistakes(terminal: Console, mistakes: Sequence[Mistake], mending: str = "", mended: bool = False) -> None:
    """Print mistakes with the change that mends each; one line where there is none.

    Args:
      mending: command line that mends them, empty where there is none. mended: whether they are mended now.
    """
    from rich.table import Table
    from rich.text import Text

    if not mistakes:
        terminal.print("no mistake in the data was found")
        return
    table = Table(title="Mistakes in the data, " + ("mended" if mended else "and what mends them"))
    for heading in ("mistake", "column", "recording", "what", "mended by", "confidence"):
        table.add_column(heading)
    for m in mistakes:
        cells = (m.name, m.columns or "–", m.recording or "all", m.description, m.change, f"{m.confidence:.2f}")
        table.add_row(*map(Text, cells))
    terminal.print(table)
    if mending and any(m.sure for m in mistakes):
        terminal.print(Text(f"mended by: {mending}"), soft_wrap=True)
    if not all(m.sure or m.lost for m in mistakes):
        terminal.print(
            "no change makes the channels fit this joint; what is half sure at most would mend most, and --fix leaves it"
        )
