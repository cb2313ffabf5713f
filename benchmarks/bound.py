"""Distance of the estimators to the bound: `python -m benchmarks bound` writes a table of docs/estimators.md. Bounds and
errors are those of `flexspline bound`, over independent draws of start, pace, pushes and noise.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

from flexspline.estimator import registry
from flexspline.scenarios.evaluation.intervals import interval
from flexspline.scenarios.evaluation.limits import Limits, assess
from flexspline.scenarios.scenario import load_scenario
from flexspline.views.tables import markdown_table

from .estimators import SCENARIOS
from .pages import ROOT, fill, text

NAMES = ("augmented", "dynamics_ekf", "momentum_torsion", "RAREKF")


def table(found: Sequence[Limits]) -> str:
    """By scenario: intensity, both bounds, and errors of estimators that know the true numbers."""
    rows = []
    for limits in found:
        errors = {e.name: text(interval(e.rms), 4) for e in limits.estimators}
        bounds = (f"{limits.bound_rms:.4f}", f"{limits.tolerance_bound_rms:.4f}")
        rows.append((limits.scenario, f"{limits.intensity:.2g}", *bounds, *(errors[n] for n in NAMES)))
    heads = (
        "experiment",
        "external torque [N·m/√s]",
        "bound, joint known exactly [N·m]",
        "bound, within its tolerances",
    )
    return markdown_table((*heads, *(f"`{n}`" for n in NAMES)), rows)


def main(arguments: Sequence[str] = ()) -> None:
    """Compute bounds and errors, and write the table."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks bound", description=__doc__)
    parser.add_argument("--seeds", type=int, default=30, help="draws, seeds 101 and on")
    parser.add_argument("--page", type=Path, default=ROOT / "docs" / "estimators.md")
    asked = parser.parse_args(arguments)
    estimators = {name: registry.get(name) for name in NAMES}
    found = []
    for name in SCENARIOS:
        scenario, folder = load_scenario(name)
        found.append(assess(scenario, folder, range(101, 101 + asked.seeds), estimators, None, 1.0))
        print(f"{name}: {found[-1].bound_rms:.4f} and {found[-1].tolerance_bound_rms:.4f} N·m", flush=True)
    fill(asked.page, {"bound": table(found)})
