"""Estimators on joints of another simulator: `python -m benchmarks independent` writes docs/independent.csv, a section of
docs/estimators.md and README's first table.

The plant is `tests/estimator/independent_plant.py`: separate equations and integration. A draw is a joint within its
tolerances with three recordings (free, loaded, loaded and pushed), whose motions, loads and pushes are drawn as well.
Estimators know the nominal description and the nominal load, and run as `flexspline estimate` runs them. Errors are RMS
over all samples against the true torque. The augmented filter was tuned on seeds 200 to 229; some joints of seeds 300 to
531 were looked at.
"""

from __future__ import annotations

import argparse
import math
import os
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd

from benchmarks.draws import geometric
from flexspline.estimator import registry
from flexspline.estimator.conditioning import condition
from flexspline.estimator.estimator import KnownJoint
from flexspline.estimator.offline import prepare
from flexspline.models.joint import Joint, load_joint
from flexspline.models.joint_parts import Mounting
from flexspline.models.recording import Recording
from flexspline.scenarios.evaluation.intervals import interval
from flexspline.views.tables import markdown_table

from . import kept, plots
from .pages import ROOT, fill, text

FIRST = 600
"""First seed: no other use was made of those from here on."""
REFERENCE = "RAREKF"
NAMES = ("augmented", "momentum_torsion", "current", REFERENCE)
KINDS = ("free", "sweep", "push")
LABELS = {False: "sensors as described", True: "with imperfections"}


def measured(
    seed: int,
    imperfect: bool,
    duration: float | None = None,
    names: Sequence[str] = NAMES,
    kinds: Sequence[str] = KINDS,
    joint: Joint | None = None,
) -> kept.Rows:
    """Errors over the recordings of a drawn joint: RMS and what an estimator believes that to be [N·m], NaN without a belief;
    mean NEES; number of samples.

    Args:
      seed: of the draw.
      imperfect: whether the joint has effects that no description holds.
      duration: of every recording [s]; drawn by default.
      names: of estimators.
      kinds: of recordings.
      joint: what is known of it; its description by default.
    """
    path = str(ROOT / "tests" / "estimator")
    if path not in sys.path:
        sys.path.append(path)
    import independent_plant as plant

    known_joint = load_joint("test-joint") if joint is None else joint
    rng = np.random.default_rng([seed, int(imperfect)])
    drawn_joint, rows = plant.draw_joint(rng, imperfect), []
    for kind in kinds:
        drawn = plant.draw_motion(rng, drawn_joint, kind, duration)
        link = Mounting(inertia=drawn.inertia, gravity_moment=drawn.gravity)
        recording = Recording(kind, drawn.time, drawn.columns, known_joint.name, "", link, "unmeasured")
        known = replace(KnownJoint.of(known_joint, link), start=float(drawn.time[0]))
        ready = prepare(condition(recording, known_joint).recording.signals, known)
        for name in names:
            estimator = registry.get(name)
            found = ready.ready(estimator).estimate(ready.read_by(estimator), ready.known)
            square, claimed, nees = (found.mean - drawn.torque) ** 2, math.nan, math.nan
            if found.variance is not None:
                claimed, nees = math.sqrt(np.mean(found.variance)), float(np.mean(square / found.variance))
            figures = {"rms": math.sqrt(np.mean(square)), "claimed": claimed, "nees": nees}
            head = {"imperfect": imperfect, "seed": seed, "kind": kind, "estimator": name}
            rows.append(head | {k: float(f"{x:.5g}") for k, x in figures.items()} | {"samples": len(square)})
    return rows


def error(rows: pd.DataFrame, imperfect: bool, name: str) -> np.ndarray:
    """RMS error [N·m] over all samples of every joint, in the order of seeds, shape (joints,)."""
    own = rows[(rows.imperfect == imperfect) & (rows.estimator == name)]
    squares = (own.samples * own.rms**2).groupby(own.seed).sum()
    return np.sqrt(squares / own.samples.groupby(own.seed).sum()).to_numpy()


def table(rows: pd.DataFrame) -> str:
    """Error, and its ratio to RAREKF's, by estimator and kind of joint."""
    kinds = [imperfect for imperfect in LABELS if (rows.imperfect == imperfect).any()]
    heads = ["estimator"]
    for imperfect in kinds:
        count = len(error(rows, imperfect, REFERENCE))
        heads += [f"{LABELS[imperfect]} ({count} joints): RMS error [N·m]", f"ratio to {REFERENCE}", "worst joint"]
    lines = []
    for name in NAMES:
        cells = [f"`{name}`"]
        for imperfect in kinds:
            own, reference = error(rows, imperfect, name), error(rows, imperfect, REFERENCE)
            cells.append(text(interval(own), 3))
            cells += (
                ["1", "1"] if name == REFERENCE else [text(geometric(own, reference)), f"{np.max(own / reference):.2f}"]
            )
        lines.append(cells)
    return markdown_table(heads, lines)


def figure(rows: pd.DataFrame, path: Path) -> None:
    """Draw the ratios of `table`."""
    panels = {
        label: [
            (name, "", geometric(error(rows, imperfect, name), error(rows, imperfect, REFERENCE)))
            for name in NAMES[:-1]
        ]
        for imperfect, label in LABELS.items()
    }
    plots.intervals(path, panels, f"RMS error / {REFERENCE}'s")


def beliefs(rows: pd.DataFrame, name: str = NAMES[0]) -> str:
    """Whether an estimator knows how wrong it is, by kind of joint and recording."""
    lines = []
    for imperfect, label in LABELS.items():
        for kind in KINDS:
            own = rows[(rows.imperfect == imperfect) & (rows.kind == kind) & (rows.estimator == name)]
            if len(own):
                apart, nees = own.rms / own.claimed, own.nees
                lines.append([
                    label, kind, f"{np.mean(nees):.2f}", f"{np.median(nees):.2f}", f"{np.max(apart):.2f}",
                    f"{np.count_nonzero(apart > 3.0)} of {len(own)}",
                ])  # fmt: skip
    heads = (
        "joints",
        "recording",
        "mean NEES",
        "median",
        "largest error / claimed",
        "error more than 3 times the claim",
    )
    return markdown_table(heads, lines)


def main(arguments: Sequence[str] = ()) -> None:
    """Measure the joints that are not kept yet, keep them, and write the tables."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks independent", description=__doc__)
    parser.add_argument(
        "--draws", type=int, default=30, help="joints of either kind; 0 writes the tables of what is kept"
    )
    parser.add_argument("--processes", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--kept", type=Path, default=ROOT / "docs" / "independent.csv")
    parser.add_argument("--page", type=Path, default=ROOT / "docs" / "estimators.md")
    parser.add_argument("--readme", type=Path, default=ROOT / "README.md")
    asked = parser.parse_args(arguments)
    wanted = [(FIRST + k, imperfect) for k in range(asked.draws) for imperfect in LABELS]
    order = {"imperfect": None, "seed": None, "kind": KINDS, "estimator": NAMES}
    rows = kept.completed(asked.kept, measured, wanted, ("seed", "imperfect"), order, asked.processes)
    fill(asked.page, {"independent": table(rows), "independent beliefs": beliefs(rows)})
    fill(asked.readme, {"independent": table(rows)})
    figure(rows, asked.page.parent / "figures" / "independent.png")
    print(table(rows))
