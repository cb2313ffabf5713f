"""Mistakes in the data as a table: what `check` and `import` share."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.console import Console

    from ..diagnosis.data.mistakes import Mistake


def print_mistakes(terminal: Console, mistakes: Sequence[Mistake], what: str) -> None:
    """Print mistakes with the change that mends each; one line where there is none."""
    from rich.table import Table
    from rich.text import Text

    if not mistakes:
        terminal.print("no mistake in the data was found")
        return
    table = Table(title=f"Mistakes in the data, {what}")
    for heading in ("mistake", "column", "recording", "what", "mended by", "confidence"):
        table.add_column(heading)
    for m in mistakes:
        column = ", ".join((m.column or "–", *m.also))
        cells = (m.name, column, m.recording or "all", m.description, change(m), f"{m.confidence:.2f}")
        table.add_row(*map(Text, cells))
    terminal.print(table)


def change(m: Mistake) -> str:
    """The change that mends a mistake, in a few words."""
    if m.name == "sign":
        return "gravity_angle + π" if m.column == "gravity_angle" else "× −1"
    if m.name == "unit":
        return f"× {m.factor:.6g}"
    if m.name == "gear_ratio":
        return f"N × {m.factor:.6g}"
    if m.name == "late":
        return f"{1e3 * (m.seconds or 0.0):.4g} ms earlier"
    if m.name == "angle_zero":
        return f"{m.offset:+.5g} rad" + (", motor side by the gear ratio" if m.also else "")
    if m.name == "velocity":
        return "integrated" if m.factor is None else f"integrated, × {m.factor:.6g}"
    return {
        "swapped": "columns exchanged", "wrapped": "unwrapped", "glitch": "bridged", "stuck": "left out", "clipped": "left out",
    }[m.name]  # fmt: skip
