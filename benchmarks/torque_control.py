"""Torque control with each estimate fed back: `python -m benchmarks torque_control` writes a section of docs/contact.md
and docs/torque_control.csv.

Each draw is a joint within a share of its tolerances (`benchmarks.torque_loops`). Gain margin, delay margin and bandwidth
are with the output bolted to a bench, the torque error in the experiment external_push. Medians have distribution-free
intervals, because margins may be infinite. Draws that are kept are not computed again.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from benchmarks.draws import median
from benchmarks.torque_loops import DEFAULT, Loop, assess
from flexspline.estimator import registry
from flexspline.scenarios.evaluation.intervals import Interval
from flexspline.scenarios.scenario import load_scenario
from flexspline.views.tables import markdown_table

from . import kept, plots
from .pages import ROOT, fill

SENSOR, NONE = "torque sensor", "no torque loop"
NAMES = (NONE, SENSOR, "momentum_torsion", "augmented", "momentum", "EKF", "RAREKF", "current")
TOLERANCE = 0.2
FIRST = 101


def measured(name: str, draw: int) -> kept.Rows:
    """One draw of one estimate: factor, ms, Hz, N·m; infinite margins are beyond what is tried."""
    scenario, folder = load_scenario("external_push")
    estimator = None if name in (NONE, SENSOR) else registry.get(name)
    loop = Loop(gain=0.0) if name == NONE else DEFAULT
    found = assess(scenario, folder, estimator, draw, TOLERANCE, loop)
    values = {
        "gain_margin": found.gain_margin, "delay_margin_ms": 1e3 * found.delay_margin, "bandwidth": found.bandwidth,
        "error": found.error,
    }  # fmt: skip
    return [{"estimator": name, "draw": draw} | {k: float(f"{v:.4g}") for k, v in values.items()}]


def text(found: Interval, digits: int) -> str:
    """A median with its interval; beyond what is tried: ∞."""
    if np.isnan(found.mean):
        return "–"
    shown = ["∞" if np.isinf(v) else f"{v:.{digits}f}" for v in (found.mean, found.low, found.high)]
    return shown[0] if np.isnan(found.low) else f"{shown[0]} [{shown[1]}, {shown[2]}]"


def table(rows: pd.DataFrame) -> str:
    """Medians over draws; the smallest error first."""
    cells = []
    for name in NAMES:
        own = rows[rows.estimator == name]
        if own.empty:
            continue
        stable = own[own.gain_margin >= 1.0]
        error = median(stable.error)
        margins = (
            ("–", "–", "–")
            if name == NONE
            else (
                f"{len(stable)} of {len(own)}",
                text(median(own.gain_margin), 1),
                text(median(own.delay_margin_ms), 1),
            )
        )
        row = (name, *margins, text(median(stable.bandwidth), 0), text(error, 2))
        cells.append((error.mean if np.isfinite(error.mean) else np.inf, row))
    heads = ("fed back", "stable", "gain margin", "delay margin [ms]", "bandwidth [Hz]", "error [N·m]")
    return markdown_table(heads, [row for _, row in sorted(cells, key=lambda cell: cell[0])])


def figure(rows: pd.DataFrame, path: Path) -> None:
    """Draw gain margins and errors."""
    panels: dict[str, list[plots.Point]] = {"gain margin": [], "error [N·m]": []}
    for name in NAMES[1:]:
        own = rows[rows.estimator == name]
        panels["gain margin"].append((name, "", median(own.gain_margin)))
        panels["error [N·m]"].append((name, "", median(own.error[own.gain_margin >= 1.0])))
    plots.intervals(path, panels, "median over joints", log=False, shared=False)


def main(arguments: Sequence[str] = ()) -> None:
    """Compute the draws that are not kept yet, and write the table."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks torque_control", description=__doc__)
    parser.add_argument("--draws", type=int, default=30, help="joints; 0 writes the table of what is kept")
    parser.add_argument("--kept", type=Path, default=ROOT / "docs" / "torque_control.csv")
    parser.add_argument("--page", type=Path, default=ROOT / "docs" / "contact.md")
    asked = parser.parse_args(arguments)
    wanted = [(name, draw) for draw in range(FIRST, FIRST + asked.draws) for name in NAMES]
    rows = kept.completed(asked.kept, measured, wanted, ("estimator", "draw"), {"estimator": NAMES, "draw": None})
    draws = rows.draw.nunique()
    about = (
        f"{draws} joints within tolerance ×{TOLERANCE:g}; torque loop gain {DEFAULT.gain:g}, impedance {DEFAULT.stiffness:g} "
        f"N·m/rad, {DEFAULT.damping:g} N·m·s/rad. Medians over draws with distribution-free 95 % intervals. Margins are found "
        "by bisection to within 10 %, so intervals can have no width. Every draw: [torque_control.csv](torque_control.csv)."
    )
    fill(asked.page, {"control about": about, "control": table(rows)})
    figure(rows, asked.page.parent / "figures" / "torque_control.png")
