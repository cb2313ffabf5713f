"""Collision detectors as tables, a CSV of their curves, and a figure: false alarms against smallest push and delay."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.figure import Figure
from rich.table import Table
from rich.text import Text

from .figures.sheet import BETWEEN, LEFT, RIGHT, WIDTH, blank, place, styled
from .limit_figures import contender_color
from .style import SENSOR
from .tables import markdown_table, narrow_table

if TYPE_CHECKING:
    from ..scenarios.evaluation.contact import OperatingPoint
HEADS = ("estimator", "threshold [N·m]", "false alarms / h", "smallest push [N·m]", "found of 2 N·m [%]", "delay [ms]")
"""Columns of `contact_rows`."""


def told(row: Mapping[str, Any], measure: str, digits: int, scale: float = 1.0) -> str:
    """A measure of a row of `as_data` with its interval where it has one; `none` where no push is found."""
    value, low, high = (row[f"{measure}{end}"] for end in ("", "_low", "_high"))
    if value is None:
        return "none" if measure == "smallest_push" and row["threshold"] is not None else "–"
    text = f"{scale * value:.{digits}f}"
    if low is None:
        return text
    return f"{text} [{scale * low:.{digits}f}, {'∞' if high is None else f'{scale * high:.{digits}f}'}]"


def contact_rows(detectors: Sequence[Mapping[str, Any]]) -> Iterator[tuple[str, ...]]:
    """A row of text per row of `as_data`, `HEADS`."""
    for row in detectors:
        threshold = "–" if row["threshold"] is None else f"{row['threshold']:.3f}"
        yield (
            row["estimator"], threshold, told(row, "false_alarms_per_hour", 1), told(row, "smallest_push", 2),
            told(row, "found_of_large", 0, 100.0), told(row, "delay", 0, 1e3),
        )  # fmt: skip


def reasons(detectors: Sequence[Mapping[str, Any]]) -> list[str]:
    """Why detectors have no threshold or find no push, and whose estimates diverged."""
    return [f"{row['estimator']}: {row['reason']}" for row in detectors if row["reason"]]


def titles(answer: Mapping[str, Any]) -> Iterator[tuple[str, list[Mapping[str, Any]]]]:
    """A title and the detectors for each tolerance of an answer, as `contact.json` has it."""
    for share in dict.fromkeys(row["tolerance"] for row in answer["detectors"]):
        joint = f"{answer['joint']} within tolerance ×{share:g}" if share else f"{answer['joint']} known exactly"
        yield (
            f"{answer['scenario']}, {joint}: thresholds for {answer['rate']:g} false alarms per hour, "
            f"{answer['hours_counted']:.2g} h counted",
            [row for row in answer["detectors"] if row["tolerance"] == share],
        )


def contact_markdown(detectors: Sequence[Mapping[str, Any]]) -> str:
    """Detectors, rows of `as_data`, at their thresholds in Markdown, with the reasons of those that have none."""
    return "\n\n".join([markdown_table(HEADS, contact_rows(detectors)), *reasons(detectors)])


def contact_table(detectors: Sequence[Mapping[str, Any]], title: str) -> Table:
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
    for row in contact_rows(detectors):
        table.add_row(*(Text(cell.replace(" [", "\n[")) for cell in row))
    return table


def as_data(points: Mapping[str, OperatingPoint], tolerance: float) -> list[dict[str, Any]]:
    """A row per estimator, the smallest push first: threshold [N·m], every measure with the ends of its interval, and why one has
    none; None where there is none."""
    names = {
        "alarms": "false_alarms_per_hour",
        "smallest": "smallest_push",
        "share": "found_of_large",
        "delay": "delay",
    }
    rows = []
    for name, point in sorted(points.items(), key=lambda one: np.nan_to_num(one[1].smallest.mean, nan=np.inf)):
        row: dict[str, Any] = {"tolerance": tolerance, "estimator": name, "threshold": _finite(point.threshold)}
        for field, label in names.items():
            value = getattr(point, field)
            row |= {
                label: _finite(value.mean),
                f"{label}_low": _finite(value.low),
                f"{label}_high": _finite(value.high),
            }
        rows.append(row | {"reason": point.reason})
    return rows


def _finite(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


@styled
def contact_figure(rows: Sequence[Mapping[str, Any]], scenario: str) -> Figure:
    """False alarms against the smallest push that is found, and against the delay; a row of panels per tolerance."""
    tolerances = sorted({r["tolerance"] for r in rows})
    names = list(dict.fromkeys(r["estimator"] for r in rows))
    hours = max(r["hours"] for r in rows)
    kinds: dict[str, tuple[str, str]] = {}
    for name in names:  # of one colour a line of another kind each
        color = SENSOR if name == "torque sensor" else contender_color(name.partition(",")[0])
        kinds[name] = next(
            ((color, d) for d in ("-", ":", "--", "-.") if (color, d) not in kinds.values()), (color, "-")
        )
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
                color, dashes = kinds[name]
                axes.plot(*zip(*found, strict=True) if found else ([], []), color=color, ls=dashes, label=name)
            axes.set(xscale="log", xlabel="false alarms per hour", ylabel=label)
            axes.set_title(f"joint within tolerance ×{tolerance:g}" if tolerance else "joint known exactly")
            if key == "smallest_push":
                axes.set_yscale("log")
            if row == 0 and column == 0:
                axes.legend(ncols=4, loc="lower left", bbox_to_anchor=(0, 1.08), borderaxespad=0.2, fontsize=8)
    return figure
