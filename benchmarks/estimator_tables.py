"""Tables and figure of docs/estimators.md that come from the CSVs of `benchmarks.estimators`, which lie next to the page."""

from __future__ import annotations

import csv
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from flexspline.scenarios.evaluation.intervals import Interval
from flexspline.views.tables import markdown_table

from . import plots
from .pages import fill, text

OVERALL = "all three"
"""In a CSV, the geometric mean over the three experiments."""
REFERENCE = "RAREKF"
SHOWN = (
    "augmented", "momentum_torsion", "momentum", "current", "dynamics_ekf", "inverse", "AREKF", REFERENCE, "REKF", "EKF",
)  # fmt: skip
"""The estimators of the tables; the CSVs have all."""
SCENARIOS = ("no_load", "link_sweep", "external_push")

Lines = Mapping[tuple[str, float, str], Mapping[str, str]]


def read_csv(path: Path) -> Lines:
    """Read a CSV of `estimators.write_csv`, by scenario, tolerance and estimator."""
    with path.open(newline="", encoding="utf-8") as file:
        return {(r["scenario"], float(r["tolerance"]), r["estimator"]): r for r in csv.DictReader(file)}


def write(page: Path) -> None:
    """Write the page's tables and its figure."""
    folder = page.parent
    kinds = {
        "sensors as described": read_csv(folder / "estimators.csv"),
        "realistic sensors": read_csv(folder / "estimators_realistic.csv"),
    }
    offset = read_csv(folder / "estimators_offset.csv")
    ideal = kinds["sensors as described"]
    with (folder / "estimators_cost.csv").open(newline="", encoding="utf-8") as file:
        cost = [(r["estimator"], r["us"], r["ratio"]) for r in csv.DictReader(file) if r["estimator"] in SHOWN]
    columns = [(label, lines, t) for label, lines in kinds.items() for t in (1.0, 0.2, 0.0)]
    columns.append(("encoder offset unknown", offset, 0.2))
    found = {
        "ratios": _table(columns, [(f"{label}, ×{t:g}", OVERALL, "ratio", 2) for label, _, t in columns]),
        "nees": _table(
            [("", ideal, t) for t in (1.0, 0.2) for _ in SCENARIOS],
            [(f"{s}, ×{t:g}", s, "nees", 2) for t in (1.0, 0.2) for s in SCENARIOS],
        ),
        "push": _table(
            [("", ideal, t) for t in (1.0, 0.2) for _ in range(2)],
            [
                (f"×{t:g}: {head}", "external_push", measure, digits)
                for t in (1.0, 0.2)
                for head, measure, digits in (("response [ms]", "response", 1), ("share missed", "missed", 2))
            ],
        ),
        "cost": markdown_table(("estimator", "µs per update", f"ratio to {REFERENCE}"), cost),
    }
    fill(page, found)
    panels = {
        label: [
            (name, f"tolerance ×{t:g}", _interval(lines[OVERALL, t, name], "ratio"))
            for t in (1.0, 0.2, 0.0)
            for name in SHOWN
            if (OVERALL, t, name) in lines
        ]
        for label, lines in kinds.items()
    }
    (folder / "figures").mkdir(exist_ok=True)
    plots.intervals(folder / "figures" / "estimators.png", panels, f"RMS error / {REFERENCE}'s")


def _table(columns: list, heads: list) -> str:
    """Make a table of `SHOWN`; a row without a value is left out."""
    rows = []
    for name in SHOWN:
        cells = [
            _cell(_interval(lines[scenario, tolerance, name], measure), measure, digits)
            if (scenario, tolerance, name) in lines
            else "–"
            for (_, lines, tolerance), (_, scenario, measure, digits) in zip(columns, heads, strict=True)
        ]
        if any(cell != "–" for cell in cells):
            rows.append((f"`{name}`", *cells))
    return markdown_table(("estimator", *(head for head, *_ in heads)), rows)


def _cell(value: Interval, measure: str, digits: int) -> str:
    """Write a ratio with its interval, another measure without: the CSV has its interval."""
    if measure == "ratio":
        return text(value, digits)
    return "–" if np.isnan(value.mean) else f"{value.mean:.{digits}f}"


def _interval(line: Mapping[str, str], measure: str) -> Interval:
    """A value with its interval; NaN where the CSV has none."""
    values = (float(line[f"{measure}{end}"] or "nan") for end in ("", "_low", "_high"))
    return Interval(*values, int(line["draws"]))
