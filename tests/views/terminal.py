"""Tables as a terminal shows them."""

import io

from rich.console import Console


def rendered(table, width: int = 80) -> str:
    """A table as text; fails where the terminal is too narrow for it."""
    out = io.StringIO()
    Console(file=out, width=width).print(table)
    text = out.getvalue()
    assert max(len(line) for line in text.splitlines()) <= width
    assert "…" not in text
    return text
