"""The page of collision detectors: smallest push found at the same number of false alarms."""

from __future__ import annotations

import csv
import math
import shlex
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ...models.errors import InputError
from ..contact_views import HEADS, contact_rows, measure_text, reasons, titles
from .chart import WIDTH, Chart, limits
from .rendering import file_digest, output_of, render
from .run import line_kinds

MEASURES = ("false_alarms_per_hour", "smallest_push", "found_of_large", "delay")
"""Measures of a detector; each has an interval."""
_NUMBERS = (
    "tolerance", "threshold", "false_alarms_per_hour", "smallest_push", "found_of_large", "delay_ms", "hours", "runs",
)  # fmt: skip
_STATED = ("tolerance", "hours", "runs")  # numbers that every row has; the others may be undefined
_DECADES = (0.1, 1, 10, 100, 1000, 10_000)

SENSOR = "torque sensor"  # the detector without an estimator

Row = Mapping[str, Any]


def read_curves(path: Path) -> list[dict[str, Any]]:
    """Read the rows of `contact.csv`; undefined measures are NaN. Raises `InputError`: a file with other content."""
    try:
        with path.open(newline="", encoding="utf-8") as file:
            rows: list[dict[str, Any]] = [
                {"estimator": row["estimator"]}
                | {name: float(row[name]) if row[name] else math.nan for name in _NUMBERS}
                for row in csv.DictReader(file)
            ]
    except (OSError, ValueError, KeyError) as error:
        raise InputError(f"{path}: expected the curves of flexspline contact, got something else") from error
    if not rows:
        raise InputError(f"{path}: expected curves, got none")
    for i, row in enumerate(rows):
        for name in _NUMBERS:
            if math.isinf(row[name]) or (name in _STATED and math.isnan(row[name])):
                raise InputError(f"{path}: row {i}: {name}: expected a finite number, got {row[name]:g}")
    return rows


def read_answer(path: Path) -> dict[str, Any]:
    """Read `contact.json`. Raises `InputError`: a file with other content."""
    with output_of(path, "contact") as answer:
        for row in answer["detectors"]:
            numbers = [row[f"{name}{end}"] for name in MEASURES for end in ("", "_low", "_high")]
            numbers += [row["tolerance"] + 0.0, row["threshold"]]
            if not all(n is None or (isinstance(n, (int, float)) and math.isfinite(n)) for n in numbers):
                raise ValueError
            str.strip(row["estimator"]), str.strip(row["reason"])
        for key in ("rate", "hours", "hours_counted", "runs"):
            if not 0.0 < answer[key] < math.inf:
                raise ValueError
        list(map(str.strip, (answer["scenario"], answer["joint"], *answer["arguments"])))
    if not answer["detectors"]:
        raise InputError(f"{path}: expected detectors, got none")
    return answer


def contact_html(answer: Mapping[str, Any], rows: Sequence[Row], folder: Path) -> str:
    """Return the page as text, one file without references to others, by the `answer` of `read_answer` and the `rows`
    of `read_curves` in a folder."""
    names = list(dict.fromkeys(str(row["estimator"]) for row in answer["detectors"]))
    kinds = line_kinds([name for name in names if name != SENSOR]) | {SENSOR: "measured"}
    parts = list(titles(answer))
    _, worst = parts[-1]
    best, joint = worst[0], _joint(answer, worst[0]["tolerance"])
    sentence = f"No detector finds nine pushes in ten at {answer['rate']:g} false alarms per hour or fewer, on {joint}."
    if best["smallest_push"] is not None:
        sentence = (
            f"{best['estimator']} finds the smallest push, {measure_text(best, 'smallest_push', 2)} N·m, at "
            f"{answer['rate']:g} false alarms per hour, on {joint}."
        )
    longer = min(4 * answer["hours"], 100.0)
    more = ["--hours", f"{longer:g}", "--out", f"{folder.as_posix()}-{longer:g}h"]
    context = {
        "sentence": sentence,
        "answer": answer,
        "heads": HEADS,
        "tables": [(_joint(answer, d[0]["tolerance"]), list(contact_rows(d)), reasons(d)) for _, d in parts],
        "entries": [(kinds[name], name) for name in names],
        "charts": [_charts(rows, d[0]["tolerance"], names, kinds, _joint(answer, d[0]["tolerance"])) for _, d in parts],
        "command": shlex.join(["flexspline", "contact", *answer["arguments"], *more]),
        "folder": str(folder),
        "digest": file_digest(folder / "contact.json"),
    }
    return render("contact.html.j2", context)


def _joint(answer: Mapping[str, Any], tolerance: float) -> str:
    return (
        f"{answer['joint']} within {tolerance:g} times its tolerances"
        if tolerance
        else f"{answer['joint']} known exactly"
    )


def _charts(
    rows: Sequence[Row], tolerance: float, names: Sequence[str], kinds: Mapping[str, str], title: str
) -> list[Chart]:
    here = [row for row in rows if row["tolerance"] == tolerance]
    labels = tuple((math.log10(v), f"{v:g}") for v in _DECADES)
    charts = []
    for key, what in (("smallest_push", "smallest push [N·m]"), ("delay_ms", "delay [ms]")):
        values = np.array([row[key] for row in here])
        chart = Chart(
            (-1.0, 4.3), limits(np.append(values, 0.0), 4.0), title, "false alarms per hour", what,
            labels=labels, width=WIDTH, height=240,
        )  # fmt: skip
        for name in names:
            own = [row for row in here if row["estimator"] == name and row["false_alarms_per_hour"] > 0]
            if own:
                x = np.log10([row["false_alarms_per_hour"] for row in own])
                order = np.argsort(x, kind="stable")
                chart.line(x[order], np.array([row[key] for row in own])[order], kinds[name])
        charts.append(chart)
    return charts
