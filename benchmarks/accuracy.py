"""Draw the rates of docs/accuracy.md from its tables: `python -m benchmarks accuracy`."""

from __future__ import annotations

import re
from pathlib import Path

from flexspline.scenarios.evaluation.intervals import Interval

from . import plots
from .pages import ROOT

RATE = re.compile(r"^\| (?P<what>[^|]+) \| [^|]* \| (?P<right>\d+) of (?P<of>\d+) \| (?P<low>\d+)–(?P<high>\d+) % \|$")


def rates(section: str) -> list[plots.Point]:
    """Read the rates of a section's table in %; a row that begins with … belongs to the row above."""
    points: list[plots.Point] = []
    above = ""
    for line in section.splitlines():
        found = RATE.match(line)
        if found is None:
            continue
        what = found["what"].strip()
        if what.startswith("…"):
            what = f"{above}: {what[1:].strip()}"
        else:
            above = what.partition(":")[0]
        share = 100 * int(found["right"]) / int(found["of"])
        points.append((what, "", Interval(share, float(found["low"]), float(found["high"]), int(found["of"]))))
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
