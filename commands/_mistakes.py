"""Mistakes in the data as a table: shared by `check`, `import` and `validate`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from ._console import print_table

if TYPE_CHECKING:
    from rich.console import Console

    from ..diagnosis.data.mistakes import Mistake


def print_mistakes(terminal: Console, mistakes: Sequence[Mistake], command: str = "", corrected: bool = False) -> None:
    """Print mistakes; `command`: line that corrects them, if there is one; `corrected`: whether they are corrected
    already."""
    if not mistakes:
        terminal.print("no mistake in the data was found")
        return
    heads = ("mistake", "column", "recording", "what", "correction", "confidence")
    rows = [
        (m.name, m.columns or "–", m.recording or "all", m.description, m.change, f"{m.confidence:.2f}")
        for m in mistakes
    ]
    print_table(terminal, f"Mistakes in the data, {'corrected' if corrected else 'and corrections'}", heads, rows, 6)
    if command and any(m.sure for m in mistakes):
        terminal.print(f"to correct them: {command}", soft_wrap=True)
    if not all(m.sure or m.lost for m in mistakes):
        terminal.print("no correction makes the channels fit this joint; --fix applies none below a confidence of 0.5")
