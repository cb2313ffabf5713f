"""Collision detectors as tables and as a figure: false alarms against smallest push and delay."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from matplotlib.figure import Figure
from rich.table import Table
from rich.text import Text

from .figures.sheet import BETWEEN, LEFT, RIGHT, WIDTH, blank, place, styled
from .limit_figures import contender_color
from .style import SENSOR
from .tables import markdown_table, text_table

HEADS = ("estimator", "threshold [N·m]", "false alarms / h", "smallest push [N·m]", "found of 2 N·m [%]", "delay [ms]")
"""Columns of `contact_rows`."""


def measure_text(row: Mapping[str, Any], measure: str, digits: int, scale: float = 1.0) -> str:
    """Return a measure of a detector with its interval; `none` if no push is found."""
    value, low, high = (row[f"{measure}{end}"] for end in ("", "_low", "_high"))
    if value is None:
        return "none" if measure == "smallest_push" and row["threshold"] is not None else "–"
    text = f"{scale * value:.{digits}f}"
    if low is None:
        return text
    return f"{text} [{scale * low:.{digits}f}, {'∞' if high is None else f'{scale * high:.{digits}f}'}]"


def contact_rows(detectors: Sequence[Mapping[str, Any]]) -> Iterator[tuple[str, ...]]:
    """Yield a row of text per detector, `HEADS`."""
    for row in detectors:
        threshold = "–" if row["threshold"] is None else f"{row['threshold']:.3f}"
        yield (
            row["estimator"], threshold, measure_text(row, "false_alarms_per_hour", 1), measure_text(row, "smallest_push", 2),
            measure_text(row, "found_of_large", 0, 100.0), measure_text(row, "delay", 0, 1e3),
        )  # fmt: skip


def reasons(detectors: Sequence[Mapping[str, Any]]) -> list[str]:
    """Return why detectors have no threshold, find no push, or diverged."""
    return [f"{row['estimator']}: {row['reason']}" for row in detectors if row["reason"]]


def titles(answer: Mapping[str, Any]) -> Iterator[tuple[str, list[Mapping[str, Any]]]]:
    """Yield a title and the detectors for each tolerance of an answer, which is the content of `contact.json`."""
    for share in dict.fromkeys(row["tolerance"] for row in answer["detectors"]):
        joint = f"{answer['joint']} within tolerance ×{share:g}" if share else f"{answer['joint']} known exactly"
        yield (
            f"{answer['scenario']}, {joint}: thresholds for {answer['rate']:g} false alarms per hour, "
            f"{answer['hours_counted']:.2g} h counted",
            [row for row in answer["detectors"] if row["tolerance"] == share],
        )


def contact_markdown(answer: Mapping[str, Any]) -> str:
    """Return the detectors of an answer at their thresholds as Markdown, a table for each tolerance."""
    parts = ((f"## {title}", markdown_table(HEADS, contact_rows(own)), *reasons(own)) for title, own in titles(answer))
    return "".join(f"{text}\n\n" for part in parts for text in part)


def contact_table(detectors: Sequence[Mapping[str, Any]], title: str) -> Table:
    """Return detectors at their thresholds for the terminal."""
    caption = (
        "false alarms: seconds with an alarm per hour, counted on other runs than those for the threshold; smallest push: size "
        "of which 90 % are found; 95 % intervals: bootstrap over runs"
    )
    heads, *rows = ([cell.replace(" [", "\n[") for cell in row] for row in (HEADS, *contact_rows(detectors)))
    return text_table(title, caption, map(Text, heads), rows)


@styled
def contact_figure(rows: Sequence[Mapping[str, Any]], scenario: str) -> Figure:
    """Draw false alarms against the smallest push found, and against the delay; a row of panels per tolerance."""
    tolerances = sorted({r["tolerance"] for r in rows})
    names = list(dict.fromkeys(r["estimator"] for r in rows))
    hours = max(r["hours"] for r in rows)
    kinds: dict[str, tuple[str, str]] = {}
    for name in names:  # estimators of one colour differ in dashes
        color = SENSOR if name == "torque sensor" else contender_color(name.partition(",")[0])
        kinds[name] = next(
            ((color, d) for d in ("-", ":", "--", "-.") if (color, d) not in kinds.values()), (color, "-")
        )
    caption = (
        f"{scenario}. A detector is a threshold on |external torque|; it decreases along a curve. Thresholds come from one half "
        f"of the runs without contact, false alarms from the other half ({hours:.2g} h), pushes from more runs. Every run has "
        "another joint within tolerance, another motion and other noise. Smallest push: size of which 90 % are found; a push "
        "during an alarm is not. Delay: median, from the onset of half-sine pushes of 2 N·m or more. Lower left is better."
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
