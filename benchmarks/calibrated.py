"""Calibrate, then estimate: `python -m benchmarks calibrated` writes docs/calibrated.csv and a section of docs/estimators.md.

A draw is a joint within its tolerances, alone or with one hidden effect of ordinary size, recorded for about 85 s on drawn
motions (`diagnosis.trials.draw`), with `--real` with a real joint's small imperfections. `diagnose` gets the recordings and the
description. Every estimator then runs over fresh motion of the same joint, the three experiments with drawn start, pace,
pushes and noise (`scenarios.evaluation.draws`), and is told in turn

* *before*: the description, its tolerances, and the link encoder's zero, which taring gives to anybody;
* *after*: the joint that the diagnosis wrote, its zero and standard deviations, and nothing else;
* *exact*: the plant's own numbers, effects and imperfections, without a doubt.

Errors are RMS against the plant's noise-free joint torque. Draws are kept as they come (`--kept`), and those that are kept
are not computed again: a run can be cut at any time and continued.
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from flexspline.diagnosis.diagnose import diagnose
from flexspline.diagnosis.trials.draw import Challenge, Draw, Hidden, draw
from flexspline.estimator import registry
from flexspline.estimator.errors import FilterDiverged
from flexspline.estimator.estimator import KnownJoint
from flexspline.models.joint import Joint
from flexspline.scenarios.evaluation.draws import DrawnExperiment, draw_of, geometric, rms, varied
from flexspline.scenarios.evaluation.intervals import Interval
from flexspline.scenarios.experiment import Experiment
from flexspline.scenarios.scenario import load_scenario
from flexspline.views.tables import markdown_table

from . import kept
from .estimators import SCENARIOS
from .pages import ROOT, fill, text

SEED = 7101
NAMES = ("augmented", "dynamics_ekf", "momentum_torsion", "current", "model", "RAREKF", "AREKF", "EKF")
KNOWLEDGE = ("before", "after", "exact")
PARTS = ("rms", "moving", "resting")
LABELS = {"none": "nothing hidden", "one": "one hidden cause"}
SHOWN = ("augmented", "momentum_torsion", "RAREKF")  # cause by cause


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
    """What the estimators are told of a joint, by knowledge."""
    described = KnownJoint.of(one.nominal, experiment.mounting)
    tared = replace(described.told(link_zero=float(record[0]["link_zero"])), link_zero=0.0)
    mounting = experiment.scenario.mounting or None
    return {
        "before": tared,
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
        told = known(one, extended, experiment, record)
        simulation = experiment.simulate(seed, record, experiment.build(record))
        fresh = draw_of(experiment, simulation, record, told["exact"], seed)
        for estimator in names:
            values = [value for knowledge in KNOWLEDGE for value in _errors(estimator, told[knowledge], fresh)]
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


def _mean(found: Interval, digits: int = 3) -> str:
    """A mean with its interval, which two draws do not have."""
    return text(found, digits) if found.n > 2 else f"{found.mean:.{digits}f}"


def _level(values: np.ndarray) -> str:
    """Geometric mean of errors with its interval; how many diverged."""
    found = _mean(geometric(values, np.ones(len(values))))
    diverged = int(np.sum(~np.isfinite(values)))
    return f"{found}, {diverged} diverged" if diverged else found


def _worse(after: np.ndarray, before: np.ndarray) -> str:
    """In how many draws an error is larger afterwards, and how much at most."""
    more = after / before
    count = int(np.sum(more > 1.0))
    return f"{count} of {len(more)}" + (f", ≤ {np.max(more):.1f} ×" if count else "")


def kind_table(results: Results, hidden: str, real: bool, names: Sequence[str] = NAMES) -> str:
    """Errors before, after, and with exact knowledge; in motion and at rest."""
    heads = ["estimator", "before [N·m]", "after", "exact knowledge", "after / before", "worse after"]
    heads += ["moving: before", "after", "exact", "at rest: before", "after", "exact"]
    rows = []
    for name in names:
        values = {k: results.values(hidden, real, name, k) for k in KNOWLEDGE}
        row = [
            f"`{name}`",
            *(_level(values[k]) for k in KNOWLEDGE),
            _mean(geometric(values["after"], values["before"]), 2),
            _worse(values["after"], values["before"]),
        ]
        for part in PARTS[1:]:
            for k in KNOWLEDGE:
                some = results.values(hidden, real, name, k, part)
                row.append(_mean(geometric(some, np.ones(len(some)))))
        rows.append(row)
    return markdown_table(heads, rows)


def counts(results: Results, real: bool) -> str:
    """What was named, where `augmented` lost by a diagnosis, and its largest errors after one, in words."""
    told: list[str] = []
    for hidden, rows in ((h, [r for r in results.rows if r.hidden == h and r.real == real]) for h in LABELS):
        named = {r.draw: r.named == (r.cause or "consistent") for r in rows}
        if named:
            what = (
                "hidden causes were named first"
                if hidden == "one"
                else "joints with nothing hidden were called consistent"
            )
            told.append(f"{sum(named.values())} of {len(named)} {what}")
    kinds = [
        h for h in LABELS if any(r.hidden == h and r.real == real and r.estimator == NAMES[0] for r in results.rows)
    ]
    if not kinds:
        return ", ".join(told)
    before, after = (np.concatenate([results.values(h, real, NAMES[0], k) for h in kinds]) for k in KNOWLEDGE[:2])
    more = after / before
    worse = f"`{NAMES[0]}` was worse after a diagnosis than before in {np.sum(more > 1)} of the {len(more)}"
    if np.any(more > 1):
        worse += f", by {100 * (np.max(more) - 1):.0f} % at most"
    return f"{', '.join(told)}; {worse}, and at most {np.max(after):.2g} N·m off (before: {np.max(before):.2g})."


def cause_table(results: Results, real: bool) -> str:
    """Cause by cause: how often it was named first, and errors before, after and with exact knowledge."""
    heads = ["hidden", "named first"]
    heads += [f"{name}: {k}" for name in SHOWN for k in KNOWLEDGE]
    rows = []
    for cause in sorted({r.cause for r in results.rows if r.hidden == "one" and r.real == real}):
        named = {r.draw: r.named for r in results.rows if r.hidden == "one" and r.real == real and r.cause == cause}
        others = sorted({n for n in named.values() if n != cause})
        right = f"{sum(n == cause for n in named.values())} of {len(named)}"
        row = [cause, f"{right} ({', '.join(others)})" if others else right]
        for name in SHOWN:
            for k in KNOWLEDGE:
                values = results.values("one", real, name, k, cause=cause)
                row.append(f"{geometric(values, np.ones(len(values))).mean:.3f}")
        rows.append(row)
    return markdown_table(heads, rows)


def tables(results: Results, names: Sequence[str] = NAMES) -> dict[str, str]:
    """The tables of docs/estimators.md, by marker; those with imperfections under one, with their headings."""
    found = {
        f"calibrated {hidden}": kind_table(results, hidden, False, names)
        if results.draws(hidden, False)
        else "(no draws yet)"
        for hidden in LABELS
    }
    found["calibrated causes"] = cause_table(results, False) if results.draws("one", False) else "(no draws yet)"
    found["calibrated about"] = (
        f"{_counts(results, False)}, seed {SEED}: draw by draw the same motions and, where the effect allows, the same "
        "joint. Geometric means over the three experiments and the draws [N·m]; brackets are 95 % intervals over draws, "
        "Student's t of logarithms, from three draws on. Every run: "
        f"[calibrated.csv](calibrated.csv).\n\n{counts(results, False)}"
    )
    parts = [f"{_counts(results, True)}."]
    for hidden, label in LABELS.items():
        if results.draws(hidden, True):
            parts += [f"**{label.capitalize()}**", kind_table(results, hidden, True, names)]
    if results.draws("one", True):
        parts.append(cause_table(results, True))
    found["calibrated real"] = "\n\n".join(parts)
    return found


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
    parser = argparse.ArgumentParser(prog="python -m benchmarks.calibrated", description=__doc__)
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
    # One kind beside the other, so that a run that is cut has as many of both.
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
    for hidden, label in LABELS.items():
        if results.draws(hidden, asked.real):
            print(f"{label}\n{kind_table(results, hidden, asked.real)}")


if __name__ == "__main__":
    import sys

    main(sys.argv[1:])
