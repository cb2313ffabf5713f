"""Draw the rates of docs/accuracy.md from its tables: `python -m benchmarks accuracy`."""

from __future__ import annotations

import re
from pathlib import Path

from flexspline.scenarios.evaluation.intervals import Interval

from . import plots
from .pages import ROOT

RATE = re.compile(r"(\d+) of (\d+) \((\d+)–(\d+) %\)")


def rates(section: str) -> list[plots.Point]:
    """Read the rates of a section's table of draws in %, by row and column."""
    points: list[plots.Point] = []
    for table in (block for block in section.split("\n\n") if block.startswith("| draws |")):
        head, _, *rows = ([cell.strip() for cell in line.strip("| ").split("|")] for line in table.splitlines())
        for row in rows:
            what, _, result = row[0].rpartition(": ")
            for column, cell in zip(head[2:], row[2:], strict=True):
                if found := RATE.fullmatch(cell):
                    right, of, low, high = map(float, found.groups())
                    name = f"{what}: {result if column == 'result' else column}"
                    points.append((name, "", Interval(100 * right / of, low, high, int(of))))
    return points


def draw(page: Path) -> None:
    """Draw one figure for each section with rates."""
    for section in page.read_text(encoding="utf-8").split("\n## ")[1:]:
        points = rates(section)
        if points:
            stem = "_".join(section.partition("\n")[0].lower().replace("'", "").split())
            path = page.parent / "figures" / f"accuracy_{stem}.png"
            plots.intervals(path, {"": points}, "share of draws, parameters or claims [%]", log=False)


def main() -> None:
    """Draw the page's figures."""
    draw(ROOT / "docs" / "accuracy.md")
