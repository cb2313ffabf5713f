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
import os
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from benchmarks.draws import DrawnExperiment, draw_of, geometric, rms
from flexspline.diagnosis.diagnose import diagnose
from flexspline.diagnosis.trials.draw import Challenge, Draw, Hidden, draw
from flexspline.estimator import registry
from flexspline.estimator.errors import FilterDiverged
from flexspline.estimator.estimator import KnownJoint
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


@dataclass(frozen=True)
class Row:
    """An estimator's RMS errors [N·m] in an experiment of a draw: of all, moving, at rest, with each knowledge; infinite where
    it diverged. `hidden`: none or one; `cause`: which; `named`: what the diagnosis named, the first cause or the verdict."""

    hidden: str
    real: bool
    draw: int
    cause: str
    named: str
    scenario: str
    estimator: str
    before_rms: float
    before_moving: float
    before_resting: float
    after_rms: float
    after_moving: float
    after_resting: float
    exact_rms: float
    exact_moving: float
    exact_resting: float


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


def assessed(hidden: Hidden, real: bool, index: int, names: Sequence[str] = NAMES) -> list[Row]:
    """One draw: recorded, diagnosed, and every estimator's errors on fresh motion with each knowledge."""
    one = draw(Challenge(seed=SEED, hidden=hidden, real=real), index)
    found = diagnose(one.measurement, one.nominal)
    named = found.causes[0].name if found.causes else found.verdict
    return errors(one, found.extended, names, (hidden, real, index, ", ".join(e.name for e in one.effects), named))


def errors(
    one: Draw,
    extended: Joint,
    names: Sequence[str],
    said: tuple[str, bool, int, str, str],
    duration: float | None = None,
) -> list[Row]:
    """Errors of estimators on fresh motion of a draw; `said`: how rows begin; `duration`: of the motion [s], whole by default."""
    rows = []
    true = one.nominal if one.imperfections is None else one.imperfections.nominal
    for name in SCENARIOS:
        scenario, home = load_scenario(name)
        if duration is not None:
            scenario = scenario.model_copy(update={"duration": duration, "disturbances": []})
        seed = SEED + said[2]
        experiment = replace(Experiment.of(varied(scenario, seed), home), joint=true)
        record = next(
            record
            for record, recording in zip(one.records, one.measurement.recordings, strict=True)
            if recording.link == experiment.mounting
        )
        each = known(one, extended, experiment, record)
        simulation = experiment.simulate(seed, record, experiment.build(record))
        fresh = draw_of(experiment, simulation, record, each["exact"], seed)
        for estimator in names:
            values = [value for knowledge in KNOWLEDGE for value in _errors(estimator, each[knowledge], fresh)]
            rows.append(Row(*said, name, estimator, *values))
    return rows


def _errors(name: str, joint: KnownJoint, fresh: DrawnExperiment) -> list[float]:
    """RMS error of all, moving, at rest."""
    try:
        error = registry.get(name).estimate(fresh.signals, joint).mean - fresh.truth
    except FilterDiverged:
        return [np.inf] * len(PARTS)
    masks = (fresh.kept, fresh.kept & fresh.moving, fresh.kept & ~fresh.moving)
    return [float(f"{rms(error, mask):.4g}") for mask in masks]


class Results:
    """Rows of all draws: by kind of draw, estimator and knowledge, the geometric mean over the experiments of each draw."""

    def __init__(self, rows: Sequence[Row]):
        self.rows = rows

    def draws(self, hidden: str, real: bool) -> list[int]:
        """Numbers of the draws of a kind."""
        return sorted({r.draw for r in self.rows if r.hidden == hidden and r.real == real})

    def values(
        self, hidden: str, real: bool, estimator: str, knowledge: str, part: str = "rms", cause: str | None = None
    ) -> np.ndarray:
        """RMS error of every draw [N·m], geometric mean over the experiments, shape (draws,); infinite where it diverged."""
        by: dict[int, list[float]] = {}
        for r in self.rows:
            if (r.hidden, r.real, r.estimator) == (hidden, real, estimator) and cause in (None, r.cause):
                by.setdefault(r.draw, []).append(getattr(r, f"{knowledge}_{part}"))
        return np.array([np.exp(np.mean(np.log(by[k]))) for k in sorted(by)])


def _mean(found: Interval, digits: int) -> str:
    """Write a mean with its interval, if it has more than two draws."""
    return text(found, digits) if found.n > 2 else f"{found.mean:.{digits}f}"


def _level(values: np.ndarray) -> str:
    """Write the geometric mean of errors, and how many diverged."""
    found = f"{geometric(values, np.ones(len(values))).mean:.3f}"
    diverged = int(np.sum(~np.isfinite(values)))
    return f"{found}, {diverged} diverged" if diverged else found


def kind_table(results: Results, real: bool, names: Sequence[str] = NAMES) -> str:
    """Make the table of errors before, after, and with exact knowledge, without and with a hidden cause."""
    kinds = [hidden for hidden in LABELS if results.draws(hidden, real)]
    rows = []
    for name in names:
        row = [f"`{name}`"]
        for hidden in kinds:
            values = {k: results.values(hidden, real, name, k) for k in KNOWLEDGE}
            row += [_level(values[k]) for k in KNOWLEDGE]
            worse = np.sum(values["after"] > values["before"])
            row += [_mean(geometric(values["after"], values["before"]), 2), f"{worse} of {len(values['after'])}"]
        rows.append(row)
    heads = ["estimator"]
    for hidden in kinds:
        heads += [f"{LABELS[hidden]}: before [N·m]", "after", "exact", "after / before", "worse after"]
    return markdown_table(heads, rows)


def counts(results: Results, real: bool) -> str:
    """Say how often the diagnosis was right, and how `augmented` changed."""
    parts = []
    for hidden, what in (
        ("none", "joints with nothing hidden were called consistent"),
        ("one", "causes were named first"),
    ):
        rows = [r for r in results.rows if r.hidden == hidden and r.real == real]
        named = {r.draw: r.named == (r.cause or "consistent") for r in rows}
        if named and not (real and hidden == "none"):  # imperfections are found as what they are
            parts.append(f"{sum(named.values())} of {len(named)} {what}.")
    kinds = [h for h in LABELS if any((r.hidden, r.real, r.estimator) == (h, real, NAMES[0]) for r in results.rows)]
    if kinds:
        before, after = (np.concatenate([results.values(h, real, NAMES[0], k) for h in kinds]) for k in KNOWLEDGE[:2])
        parts.append(
            f"The largest error of `{NAMES[0]}` was {np.max(before):.2g} N·m before a diagnosis and {np.max(after):.2g} N·m "
            "after it."
        )
    return " ".join(parts)


def tables(results: Results, names: Sequence[str] = NAMES) -> dict[str, str]:
    """Make the tables of docs/estimators.md, by marker."""
    found = {}
    for real, name in ((False, "calibrated"), (True, "calibrated real")):
        if results.draws("none", real) or results.draws("one", real):
            said = f"{_counts(results, real)}, seed {SEED}. {counts(results, real)}"
            found |= {f"{name} about": said, name: kind_table(results, real, names)}
    return found


def figure(results: Results, path: Path, names: Sequence[str] = NAMES) -> None:
    """Draw the errors on joints with one hidden cause."""
    plots.intervals(
        path,
        {
            label: [
                (name, knowledge, geometric(values, np.ones(len(values))))
                for knowledge in KNOWLEDGE
                for name in names
                for values in [results.values("one", real, name, knowledge)]
            ]
            for real, label in ((False, "without imperfections"), (True, "with imperfections"))
            if results.draws("one", real)
        },
        "RMS error [N·m]",
    )


def _counts(results: Results, real: bool) -> str:
    """How many draws there are of each kind."""
    numbers = {label: len(results.draws(hidden, real)) for hidden, label in LABELS.items()}
    return ", ".join(f"{n or 'no'} {'joint' if n == 1 else 'joints'} with {label}" for label, n in numbers.items())


def read(path: Path) -> list[Row]:
    """Rows that are kept."""
    return kept.read(path, Row)


def write(path: Path, rows: Sequence[Row]) -> None:
    """Keep rows, in order of draws."""
    ordered = sorted(
        rows, key=lambda r: (r.real, r.hidden, r.draw, SCENARIOS.index(r.scenario), NAMES.index(r.estimator))
    )
    kept.write(path, ordered, Row)


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
    rows, began = read(asked.kept), time.monotonic()
    have = {(r.hidden, r.real, r.draw) for r in rows}
    # Alternate between the kinds, so that a stopped run has as many of both.
    wanted = [(h, asked.real, k) for k in range(asked.draws) for h in LABELS]
    waiting = [one for one in wanted if one not in have]
    for _, done in kept.computed(assessed, waiting, asked.processes, asked.minutes):
        rows += done.result()
        write(asked.kept, rows)
        last = rows[-1]
        minutes = (time.monotonic() - began) / 60
        print(f"{last.hidden} {last.draw} {last.cause}: {last.named}; {minutes:.1f} min", flush=True)
    results = Results(rows)
    fill(asked.page, tables(results))
    figure(results, asked.page.parent / "figures" / "calibrated.png")
    print(kind_table(results, asked.real))
