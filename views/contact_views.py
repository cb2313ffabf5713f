"""Collision detectors as tables, a CSV of their curves, and a figure: false alarms against smallest push and delay."""

from __future__ import annotations

import csv
import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from matplotlib.figure import Figure
from rich.table import Table
from rich.text import Text

from ..models.files import write_into_place
from .figures.sheet import BETWEEN, LEFT, RIGHT, WIDTH, blank, place, styled
from .limit_figures import contender_color
from .limit_tables import markdown
from .style import SENSOR
from .tables import narrow_table

if TYPE_CHECKING:
    from ..scenarios.evaluation.contact import OperatingPoint
    from ..scenarios.evaluation.intervals import Interval

HEADS = ("estimator", "threshold [N·m]", "false alarms / h", "smallest push [N·m]", "found of 2 N·m [%]", "delay [ms]")
"""Columns of `contact_rows`."""


def told(value: Interval, digits: int, scale: float = 1.0) -> str:
    """A value with its interval where it has one; `none` where it is infinite."""
    if math.isinf(value.mean):
        return "none"
    if math.isnan(value.mean):
        return "–"
    text = f"{scale * value.mean:.{digits}f}"
    if math.isnan(value.low):
        return text
    high = "∞" if math.isinf(value.high) else f"{scale * value.high:.{digits}f}"
    return f"{text} [{scale * value.low:.{digits}f}, {high}]"


def contact_rows(points: Mapping[str, OperatingPoint]) -> Iterator[tuple[str, ...]]:
    """A row of text per estimator, `HEADS`; the smallest push first."""
    for name, point in sorted(points.items(), key=lambda item: item[1].smallest.mean):
        threshold = "–" if math.isnan(point.threshold) else f"{point.threshold:.3f}"
        yield (
            name, threshold, told(point.alarms, 1), told(point.smallest, 2), told(point.share, 0, 100.0),
            told(point.delay, 0, 1e3),
        )  # fmt: skip


def contact_markdown(points: Mapping[str, OperatingPoint]) -> str:
    """Detectors at their thresholds, in Markdown."""
    return markdown(HEADS, list(contact_rows(points)))


def contact_table(points: Mapping[str, OperatingPoint], title: str) -> Table:
    """Detectors at their thresholds, for the terminal."""
    table = narrow_table(
        title,
        "false alarms: seconds with one per hour, counted on other runs than those that gave the threshold; smallest push: of "
        "which 90 % are found; 95 % intervals: bootstrap over runs",
    )
    for i, head in enumerate(HEADS):
        words, _, unit = head.partition(" [")
        table.add_column(
            Text(f"{words}\n[{unit}" if unit else words), justify="right" if i else "left", overflow="fold"
        )
    for row in contact_rows(points):
        table.add_row(*(Text(cell.replace(" [", "\n[")) for cell in row))
    return table


def as_data(points: Mapping[float, Mapping[str, OperatingPoint]]) -> list[dict[str, Any]]:
    """A row per tolerance and estimator: threshold [N·m], and every measure with the ends of its interval; none where there is
    none."""
    names = {
        "alarms": "false_alarms_per_hour",
        "smallest": "smallest_push",
        "share": "found_of_large",
        "delay": "delay",
    }
    rows = []
    for tolerance, at_rate in points.items():
        for name, point in at_rate.items():
            row: dict[str, Any] = {"tolerance": tolerance, "estimator": name, "threshold": _finite(point.threshold)}
            for field, label in names.items():
                value = getattr(point, field)
                row |= {
                    label: _finite(value.mean),
                    f"{label}_low": _finite(value.low),
                    f"{label}_high": _finite(value.high),
                }
            rows.append(row)
    return rows


def _finite(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


def write_curves(rows: Sequence[Mapping[str, Any]], path: Path) -> None:
    """Curves, rows of `contact.curve`, as CSV; empty where a measure is not defined."""
    with write_into_place(path) as temporary, temporary.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)


@styled
def contact_figure(rows: Sequence[Mapping[str, Any]], scenario: str) -> Figure:
    """False alarms against the smallest push that is found, and against the delay; a row of panels per tolerance."""
    tolerances = sorted({r["tolerance"] for r in rows})
    names = list(dict.fromkeys(r["estimator"] for r in rows))
    hours = max(r["hours"] for r in rows)
    caption = (
        f"{scenario}. A detector is a threshold on |external torque|; along a curve it falls. Thresholds from every other of the "
        f"runs without contact, false alarms counted on the others ({hours:.2g} h), pushes in runs of their own; every run is "
        "another joint within tolerance, another motion and noise. Smallest push: of which 90 % are found; where an "
        "alarm is on already, none is. Delay: median, from the onset of half-sine pushes of 2 N·m or more. Below and to the left "
        "is better."
    )
    above, height = 0.55 + 0.2 * -(-len(names) // 4), 2.5
    figure = blank("Contact: false alarms, delay, smallest push", caption, above + len(tolerances) * (height + 0.85))
    width = 0.5 * (WIDTH - LEFT - RIGHT - BETWEEN)
    for row, tolerance in enumerate(tolerances):
        for column, (key, label) in enumerate((("smallest_push", "smallest push [N·m]"), ("delay_ms", "delay [ms]"))):
            axes = place(figure, LEFT + column * (width + BETWEEN), above + row * (height + 0.85) + 0.2, width, height)
            for name in names:
                own = [r for r in rows if r["estimator"] == name and r["tolerance"] == tolerance]
                found = [
                    (r["false_alarms_per_hour"], r[key])
                    for r in own
                    if r[key] is not None and r["false_alarms_per_hour"]
                ]
                color = SENSOR if name == "torque sensor" else contender_color(name.partition(",")[0])
                dashes = "--" if name == "torque sensor" else ":" if "," in name else "-"
                axes.plot(*zip(*found, strict=True) if found else ([], []), color=color, ls=dashes, label=name)
            axes.set(xscale="log", xlabel="false alarms per hour", ylabel=label)
            axes.set_title(f"joint within tolerance ×{tolerance:g}" if tolerance else "joint known exactly")
            if key == "smallest_push":
                axes.set_yscale("log")
            if row == 0 and column == 0:
                axes.legend(ncols=4, loc="lower left", bbox_to_anchor=(0, 1.08), borderaxespad=0.2, fontsize=8)
    return figure
