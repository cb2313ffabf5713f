"""The page of collision detectors: whose external torque finds the smallest push at the same number of false alarms."""

from __future__ import annotations

import csv
import math
import shlex
from collections.abc import Mapping, Sequence
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np

from ...models.errors import InputError
from .chart import Chart, limits
from .provenance import file_digest, now
from .rendering import number, render, squeezed
from .run import line_kinds

RATE = 10.0
"""False alarms per hour at which detectors are compared."""
_NUMBERS = (
    "tolerance", "threshold", "false_alarms_per_hour", "smallest_push", "found_of_large", "delay_ms", "hours", "runs",
)  # fmt: skip
_STATED = ("tolerance", "hours", "runs")
"""Numbers of every row; the others are measures, which may not be defined."""
_DECADES = (0.1, 1, 10, 100, 1000, 10_000)

_SENSOR = "torque sensor"
"""A detector that is no estimator; nor are those whose name has more after a comma."""

Row = Mapping[str, Any]


def read_curves(path: Path) -> list[dict[str, Any]]:
    """Rows of `contact.csv`, not a number where a measure is not defined.

    Raises:
      InputError: a file that is no such table.
    """
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


def contact_html(rows: Sequence[Row], folder: Path) -> str:
    """The page as text: one file that refers to nothing outside itself.

    Args:
      rows: of `read_curves`.
      folder: that holds `contact.csv`.
    """
    names = list(dict.fromkeys(str(row["estimator"]) for row in rows))
    kinds = line_kinds(names)
    tables = [(tolerance, _ranked(rows, tolerance)) for tolerance in sorted({row["tolerance"] for row in rows})]
    worst, ranked = tables[-1]
    found = [row for row in ranked if math.isfinite(row["smallest_push"])]
    sentence = "No detector finds nine pushes in ten at so few false alarms."
    if found:
        sentence = (
            f"{found[0]['estimator']} finds the smallest push, {number(found[0]['smallest_push'], 2)} N·m, at "
            f"{RATE:g} false alarms per hour or fewer, on {_joint(worst)}."
        )
    context = {
        "sentence": sentence,
        "rate": RATE,
        "tables": [(_joint(t), own) for t, own in tables],
        "hours": max(row["hours"] for row in rows),
        "runs": int(max(row["runs"] for row in rows)),
        "entries": [(kinds[name], name) for name in names],
        "charts": [_charts(rows, tolerance, names, kinds) for tolerance, _ in tables],
        "filters": "".join(f" --filter {shlex.quote(name)}" for name in names if name != _SENSOR and "," not in name),
        "place": shlex.quote(folder.as_posix()),
        "folder": str(folder),
        "digest": file_digest(folder / "contact.csv"),
        "written": now(),
        "version": metadata.version("flexspline"),
    }
    return squeezed(render("contact.html.j2", context))


def _joint(tolerance: float) -> str:
    return f"joints within {tolerance:g} times their tolerance" if tolerance else "a joint known exactly"


def _ranked(rows: Sequence[Row], tolerance: float) -> list[Row]:
    """Of each estimator the most sensitive threshold with no more false alarms than `RATE`; the smallest push first."""
    best: dict[str, Row] = {}
    for row in rows:
        name = str(row["estimator"])
        if row["tolerance"] != tolerance or not row["false_alarms_per_hour"] <= RATE:
            continue
        if name not in best or row["threshold"] < best[name]["threshold"]:
            best[name] = row
    return sorted(
        best.values(), key=lambda row: row["smallest_push"] if math.isfinite(row["smallest_push"]) else math.inf
    )


def _charts(rows: Sequence[Row], tolerance: float, names: Sequence[str], kinds: Mapping[str, str]) -> list[Chart]:
    """Smallest push and delay over the false alarms, whose axis is logarithmic."""
    here = [row for row in rows if row["tolerance"] == tolerance]
    labels = tuple((math.log10(v), f"{v:g}") for v in _DECADES)
    charts = []
    for key, what in (("smallest_push", "smallest push [N·m]"), ("delay_ms", "delay [ms]")):
        values = np.array([row[key] for row in here])
        chart = Chart(
            (-1.0, 4.3), limits(np.append(values, 0.0), 4.0), _joint(tolerance), "false alarms per hour", what,
            labels=labels, width=540, height=240,
        )  # fmt: skip
        for name in names:
            own = [row for row in here if row["estimator"] == name and row["false_alarms_per_hour"] > 0]
            if own:
                x = np.log10([row["false_alarms_per_hour"] for row in own])
                order = np.argsort(x, kind="stable")
                chart.line(x[order], np.array([row[key] for row in own])[order], kinds[name])
        charts.append(chart)
    return charts
