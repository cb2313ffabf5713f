"""Collision detection on each estimator's external torque: `python -m benchmarks contact` writes the section *Contact* of
docs/estimators.md, its curves docs/contact.csv and docs/figures/contact.png.

Runs without and with contact are drawn (`scenarios.evaluation.contact`): joint within a share of its tolerances, motion, pushes,
noise, and with realistic sensors the drive's lag. Tables go between the markers `<!-- begin NAME -->` and `<!-- end NAME -->`.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence
from pathlib import Path

from flexspline.commands.contact import DEFAULT
from flexspline.models.files import write_rows
from flexspline.scenarios.evaluation import contact
from flexspline.scenarios.filters import estimators
from flexspline.scenarios.scenario import load_scenario
from flexspline.views import contact_views
from flexspline.views.figures.sheet import save

from .pages import ROOT, fill

CASES = (("ideal", 0.0), ("ideal", 0.2), ("ideal", 1.0), ("realistic", 0.2))
"""Sensors as the joint's description has them, or `realistic`; share of the tolerances within which the joint is drawn."""
LABELS = {"ideal": "sensors as described", "realistic": "`sensors: realistic`"}
RATE = 10.0
"""False alarms per hour at which the detectors are compared."""


def label(sensors: str, tolerance: float) -> str:
    """A case in words."""
    return f"joint {'known exactly' if tolerance == 0.0 else f'within tolerance ×{tolerance:g}'}, {LABELS[sensors]}"


def main(arguments: Sequence[str] = ()) -> None:
    """Run everything and write tables, curves and figure."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.contact", description=__doc__)
    parser.add_argument("--hours", type=float, default=1.0, help="without contact, in every case")
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--page", type=Path, default=ROOT / "docs" / "estimators.md")
    asked = parser.parse_args(arguments)
    began, parts, rows, drawn = time.perf_counter(), [], [], []
    for sensors, tolerance in CASES:
        changes = [] if sensors == "ideal" else ["sensors=realistic"]
        scenario, folder = load_scenario("collision", changes)
        found = contact.assess(scenario, folder, estimators(DEFAULT), asked.hours, tolerance, asked.threads)
        points = contact_views.as_data({one.name: contact.at(one, one.threshold(RATE)) for one in found}, tolerance)
        parts += [f"**{label(sensors, tolerance).capitalize()}**", contact_views.contact_markdown(points)]
        curves = [
            {"sensors": sensors, **row} for row in (row for one in found for row in contact.curve(one, tolerance))
        ]
        rows += curves
        drawn += [row for row in curves if sensors == "ideal"]
        print(f"{time.perf_counter() - began:7.0f} s  {label(sensors, tolerance)}", flush=True)
    about = (
        f"{len(found[0].quiet)} runs of {scenario.duration:g} s without contact in each case, half of them for the thresholds "
        f"({RATE:g} false alarms an hour), half ({found[0].hours:.2g} h) for the false alarms that are counted; as many with "
        f"{found[0].size.shape[1]} pushes each of {contact.SIZES[0]:g} to {contact.SIZES[1]:g} N·m. Brackets are 95 % intervals, "
        "bootstrapped over runs. All curves: [contact.csv](contact.csv); with sensors as described: "
        "[figure](figures/contact.png)."
    )
    fill(asked.page, {"contact about": about, "contact": "\n\n".join(parts)})
    write_rows(asked.page.parent / "contact.csv", rows)
    save(contact_views.contact_figure(drawn, "collision"), asked.page.parent / "figures" / "contact.png")


if __name__ == "__main__":
    import sys

    main(sys.argv[1:])
