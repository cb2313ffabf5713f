"""Calibrate, then estimate: `python -m benchmarks calibrated` writes docs/calibrated.csv and a section of docs/estimators.md.

A draw is a joint within its tolerances, alone or with one hidden effect of ordinary size, recorded for about 85 s on drawn
motions (`diagnosis.trials.draw`), with `--real` with a real joint's small imperfections. `diagnose` gets the recordings and the
description. Every estimator then runs over fresh motion of the same joint, the three experiments with drawn start, pace,
pushes and noise (`scenarios.evaluation.draws`). It knows in turn

* *before*: the description, its tolerances, and the encoder offset;
* *after*: the joint that the diagnosis wrote, with its encoder offset and standard deviations;
* *exact*: the plant's own numbers, effects and imperfections.

Errors are RMS against the plant's noise-free joint torque. Draws are kept as they come (`--kept`), and those that are kept
are not computed again, so that a run can be stopped and continued.
"""

from __future__ import annotations

import argparse
import itertools
import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd

from benchmarks.draws import DrawnExperiment, draw_of, geometric, rms
from flexspline.diagnosis.diagnose import diagnose
from flexspline.diagnosis.trials.draw import Challenge, Draw, Hidden, draw
from flexspline.estimator import registry
from flexspline.estimator.estimator import KnownJoint
from flexspline.models.errors import FilterDiverged
from flexspline.models.joint import Joint
from flexspline.scenarios.evaluation.draws import varied
from flexspline.scenarios.evaluation.intervals import Interval
from flexspline.scenarios.experiment import Experiment
from flexspline.scenarios.scenario import load_scenario
from flexspline.views.tables import markdown_table

from . import kept, plots
from .estimators import SCENARIOS
from .pages import ROOT, fill, text

SEED = 7101
NAMES = ("augmented", "dynamics_ekf", "momentum_torsion", "current", "model", "RAREKF", "AREKF", "EKF")
KNOWLEDGE = ("before", "after", "exact")
PARTS = ("rms", "moving", "resting")
LABELS = {"none": "nothing hidden", "one": "one hidden cause"}


def known(one: Draw, extended: Joint, experiment: Experiment, record: np.ndarray) -> dict[str, KnownJoint]:
    """Return what the estimators know of a joint, by knowledge."""
    described = KnownJoint.of(one.nominal, experiment.mounting)
    before = replace(described.with_numbers(link_zero=float(record[0]["link_zero"])), link_zero=0.0)
    mounting = experiment.scenario.mounting or None
    return {
        "before": before,
        "after": KnownJoint.of(extended, extended.mount(mounting)),
        "exact": KnownJoint.of(one.nominal, experiment.mounting, record).within(0.0),
    }


def assessed(hidden: Hidden, real: bool, index: int, names: Sequence[str] = NAMES) -> kept.Rows:
    """One draw: recorded, diagnosed, and every estimator's errors on fresh motion with each knowledge."""
    one = draw(Challenge(seed=SEED, hidden=hidden, real=real), index)
    found = diagnose(one.measurement, one.nominal)
    named = found.causes[0].name if found.causes else found.verdict
    cause = ", ".join(e.name for e in one.effects)
    said = {"hidden": hidden, "real": real, "draw": index, "cause": cause, "named": named}
    return [said | row for row in errors(one, found.extended, names, index)]


def errors(
    one: Draw, extended: Joint, names: Sequence[str], index: int = 0, duration: float | None = None
) -> kept.Rows:
    """RMS errors [N·m] of estimators on fresh motion of a draw: of all, moving, at rest, with each knowledge; infinite where it
    diverged. `index`: of the draw; `duration`: of the motion [s], whole by default."""
    rows: kept.Rows = []
    true = one.nominal if one.imperfections is None else one.imperfections.nominal
    for name in SCENARIOS:
        scenario, home = load_scenario(name)
        if duration is not None:
            scenario = scenario.model_copy(update={"duration": duration, "disturbances": []})
        seed = SEED + index
        experiment = replace(Experiment.of(varied(scenario, seed), home), joint=true)
        record = next(
            record
            for record, recording in zip(one.records, one.measurement.recordings, strict=True)
            if recording.link == experiment.mounting
        )
        each = known(one, extended, experiment, record)
        simulation = replace(experiment, record=record).simulate()
        fresh = draw_of(experiment, simulation, record, each["exact"], seed)
        for estimator in names:
            rows.append({"scenario": name, "estimator": estimator})
            for knowledge in KNOWLEDGE:
                values = _errors(estimator, each[knowledge], fresh)
                rows[-1] |= {f"{knowledge}_{part}": value for part, value in zip(PARTS, values, strict=True)}
    return rows


def _errors(name: str, joint: KnownJoint, fresh: DrawnExperiment) -> list[float]:
    """RMS error of all, moving, at rest."""
    try:
        error = registry.get(name).estimate(fresh.signals, joint).mean - fresh.truth
    except FilterDiverged:
        return [np.inf] * len(PARTS)
    masks = (fresh.kept, fresh.kept & fresh.moving, fresh.kept & ~fresh.moving)
    return [float(f"{rms(error, mask):.4g}") for mask in masks]


def of_kind(rows: pd.DataFrame, hidden: str, real: bool) -> pd.DataFrame:
    """Rows of a kind of draw."""
    return rows[(rows.hidden == hidden) & (rows.real == real)]


def values(rows: pd.DataFrame, hidden: str, real: bool, estimator: str, knowledge: str) -> np.ndarray:
    """RMS error of every draw [N·m], geometric mean over the experiments, shape (draws,); infinite where it diverged."""
    some = of_kind(rows, hidden, real)
    some = some[some.estimator == estimator]
    return np.exp(np.log(some[f"{knowledge}_rms"]).groupby(some.draw).mean()).to_numpy()


def _mean(found: Interval, digits: int) -> str:
    """Write a mean with its interval, if it has more than two draws."""
    return text(found, digits) if found.n > 2 else f"{found.mean:.{digits}f}"


def _level(values: np.ndarray) -> str:
    """Write the geometric mean of errors, and how many diverged."""
    found = f"{geometric(values, np.ones(len(values))).mean:.3f}"
    diverged = int(np.sum(~np.isfinite(values)))
    return f"{found}, {diverged} diverged" if diverged else found


def kind_table(rows: pd.DataFrame, real: bool, names: Sequence[str] = NAMES) -> str:
    """Make the table of errors before, after, and with exact knowledge, without and with a hidden cause."""
    kinds = [hidden for hidden in LABELS if len(of_kind(rows, hidden, real))]
    lines = []
    for name in names:
        line = [f"`{name}`"]
        for hidden in kinds:
            before, after, exact = (values(rows, hidden, real, name, k) for k in KNOWLEDGE)
            line += [_level(before), _level(after), _level(exact), _mean(geometric(after, before), 2)]
            line.append(f"{np.sum(after > before)} of {len(after)}")
        lines.append(line)
    heads = ["estimator"]
    for hidden in kinds:
        heads += [f"{LABELS[hidden]}: before [N·m]", "after", "exact", "after / before", "worse after"]
    return markdown_table(heads, lines)


def counts(rows: pd.DataFrame, real: bool) -> str:
    """Say how often the diagnosis was right, and how `augmented` changed."""
    parts = []
    for hidden, what in (
        ("none", "joints with nothing hidden were called consistent"),
        ("one", "causes were named first"),
    ):
        draws = of_kind(rows, hidden, real).drop_duplicates("draw")
        if len(draws) and not (real and hidden == "none"):  # imperfections are found as what they are
            parts.append(f"{(draws.named == draws.cause.replace('', 'consistent')).sum()} of {len(draws)} {what}.")
    kinds = [h for h in LABELS if len(values(rows, h, real, NAMES[0], "before"))]
    if kinds:
        before, after = (np.concatenate([values(rows, h, real, NAMES[0], k) for h in kinds]) for k in KNOWLEDGE[:2])
        parts.append(
            f"The largest error of `{NAMES[0]}` was {np.max(before):.2g} N·m before a diagnosis and {np.max(after):.2g} N·m "
            "after it."
        )
    return " ".join(parts)


def tables(rows: pd.DataFrame, names: Sequence[str] = NAMES) -> dict[str, str]:
    """Make the tables of docs/estimators.md, by marker."""
    found = {}
    for real, name in ((False, "calibrated"), (True, "calibrated real")):
        if (rows.real == real).any():
            said = f"{_counts(rows, real)}, seed {SEED}. {counts(rows, real)}"
            found |= {f"{name} about": said, name: kind_table(rows, real, names)}
    return found


def figure(rows: pd.DataFrame, path: Path) -> None:
    """Draw the errors on joints with one hidden cause."""
    panels: dict[str, list[plots.Point]] = {}
    for real, label in ((False, "without imperfections"), (True, "with imperfections")):
        for knowledge, name in itertools.product(KNOWLEDGE, NAMES):
            errors = values(rows, "one", real, name, knowledge)
            if len(errors):
                panels.setdefault(label, []).append((name, knowledge, geometric(errors, np.ones(len(errors)))))
    plots.intervals(path, panels, "RMS error [N·m]")


def _counts(rows: pd.DataFrame, real: bool) -> str:
    """How many draws there are of each kind."""
    numbers = {label: of_kind(rows, hidden, real).draw.nunique() for hidden, label in LABELS.items()}
    return ", ".join(f"{n or 'no'} {'joint' if n == 1 else 'joints'} with {label}" for label, n in numbers.items())


def main(arguments: Sequence[str] = ()) -> None:
    """Compute the draws that are not kept yet, keep them, and write the tables."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks calibrated", description=__doc__)
    parser.add_argument(
        "--draws",
        type=int,
        default=30,
        help="joints without anything hidden, and as many with one cause; 0 writes the tables of what is kept",
    )
    parser.add_argument("--real", action="store_true", help="with the imperfections of `challenge --real`")
    parser.add_argument("--processes", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--minutes", type=float, default=np.inf, help="after which no further draw begins")
    parser.add_argument("--kept", type=Path, default=ROOT / "docs" / "calibrated.csv")
    parser.add_argument("--page", type=Path, default=ROOT / "docs" / "estimators.md")
    asked = parser.parse_args(arguments)
    # Alternate between the kinds, so that a stopped run has as many of both.
    wanted = [(h, asked.real, k) for k in range(asked.draws) for h in LABELS]
    order = {"real": None, "hidden": None, "draw": None, "scenario": SCENARIOS, "estimator": NAMES}
    by = ("hidden", "real", "draw")
    rows = kept.completed(asked.kept, assessed, wanted, by, order, asked.processes, asked.minutes)
    fill(asked.page, tables(rows))
    figure(rows, asked.page.parent / "figures" / "calibrated.png")
    print(kind_table(rows, asked.real))
