"""Collision detection on each estimator's external torque: `python -m benchmarks contact` writes the section *Contact* of
docs/contact.md, its curves docs/contact.csv and docs/figures/contact.png.

Runs without and with contact are drawn (`scenarios.evaluation.contact`): joint within a share of its tolerances, motion,
pushes, noise, and with realistic sensors the drive's lag. Tables go between the markers `<!-- begin NAME -->` and `<!--
end NAME -->`.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from flexspline.models.files import write_rows
from flexspline.scenarios.evaluation import contact
from flexspline.scenarios.filters import estimators
from flexspline.scenarios.scenario import load_scenario
from flexspline.views import contact_views
from flexspline.views.figures.sheet import save
from flexspline.views.tables import markdown_table

from .pages import ROOT, fill

CASES = (("ideal", 0.0), ("ideal", 0.2), ("ideal", 1.0), ("realistic", 0.2))
"""Sensors as the joint's description has them, or `realistic`; share of the tolerances within which the joint is drawn."""
LABELS = {"ideal": "sensors as described", "realistic": "`sensors: realistic`"}
RATE = 10.0
"""False alarms per hour at which the detectors are compared."""


def label(sensors: str, tolerance: float) -> str:
    """A case in words."""
    return f"joint {'known exactly' if tolerance == 0.0 else f'within tolerance ×{tolerance:g}'}, {LABELS[sensors]}"


def cell(point: Mapping[str, Any]) -> str:
    """Write the smallest push with its interval, and the delay."""
    push, low, high = (point[f"smallest_push{end}"] for end in ("", "_low", "_high"))
    return "–" if push is None else f"{push:.2f} [{low:.2f}, {high:.2f}]; {1e3 * point['delay']:.0f}"


def main(arguments: Sequence[str] = ()) -> None:
    """Run everything and write tables, curves and figure."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks contact", description=__doc__)
    parser.add_argument("--hours", type=float, default=1.0, help="without contact, in every case")
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--page", type=Path, default=ROOT / "docs" / "contact.md")
    asked = parser.parse_args(arguments)
    began, rows, drawn = time.perf_counter(), [], []
    cells: dict[str, dict[tuple[str, float], str]] = {}
    for sensors, tolerance in CASES:
        changes = [] if sensors == "ideal" else ["sensors=realistic"]
        scenario, folder = load_scenario("collision", changes)
        found = contact.assess(scenario, folder, estimators(contact.DEFAULT), asked.hours, tolerance, asked.threads)
        points = contact.ranked(found, RATE, tolerance)
        for point in points:
            cells.setdefault(point["estimator"], {})[sensors, tolerance] = cell(point)
        curves = [
            {"sensors": sensors, **row} for row in (row for one in found for row in contact.curve(one, tolerance))
        ]
        rows += curves
        drawn += [row for row in curves if sensors == "ideal"]
        print(f"{time.perf_counter() - began:7.0f} s  {label(sensors, tolerance)}", flush=True)
    about = (
        f"Each case has {len(found[0].quiet)} runs of {scenario.duration:g} s without contact and as many with "
        f"{found[0].size.shape[1]} pushes each, of {contact.SIZES[0]:g} to {contact.SIZES[1]:g} N·m. The threshold gives "
        f"{RATE:g} false alarms per hour on half of the runs without contact. Brackets are 95 % intervals, bootstrapped over "
        "runs. All curves: [contact.csv](contact.csv)."
    )
    heads = ("external torque by", *(f"{label(*case)}: smallest push [N·m]; delay [ms]" for case in CASES))
    table = markdown_table(heads, [(name, *(own.get(case, "–") for case in CASES)) for name, own in cells.items()])
    fill(asked.page, {"contact about": about, "contact": table})
    write_rows(asked.page.parent / "contact.csv", rows)
    save(contact_views.contact_figure(drawn, "collision"), asked.page.parent / "figures" / "contact.png")
