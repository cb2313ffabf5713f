"""Errors of every estimator on joints within a tolerance: `python -m benchmarks estimators` runs them and writes
docs/estimators.csv, then the tables and the figure of docs/estimators.md from all CSVs (`--tables`: only these).

Every number is over independent draws (`scenarios.evaluation.draws`): joint within a share of its tolerances, start,
pace, pushes and noise are drawn per seed; every estimator gets the same signals. Ratios are geometric means of the ratio
of RMS errors to RAREKF's, draw by draw. `--draws FOLDER` keeps the signals, so that a changed estimator is measured
without simulating again.
"""

from __future__ import annotations

import argparse
import itertools
import pickle
import time
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from benchmarks.draws import DrawnExperiment, draw, geometric, rms
from flexspline.estimator import registry
from flexspline.estimator.estimator import Estimator, with_values
from flexspline.models.errors import FilterDiverged, InputError
from flexspline.models.files import write_into_place, write_rows
from flexspline.scenarios.evaluation import metrics
from flexspline.scenarios.evaluation.intervals import Interval, interval
from flexspline.scenarios.scenario import load_scenario
from flexspline.sim.loop import CONTROL_PERIOD

from . import estimator_tables
from .estimator_tables import OVERALL, REFERENCE, SCENARIOS
from .kept import Rows
from .pages import ROOT
from .timing import alternately

TOLERANCES = (1.0, 0.2, 0.05, 0.0)
NAMES = (
    "augmented", "dynamics_ekf", "momentum_torsion", "momentum", "current", "EKF", "AREKF", REFERENCE, "REKF", "inverse",
    "lowpass", "kalman", "strong_tracking", "h_infinity", "huber",
)  # fmt: skip
"""`inverse` is RAREKF with the reading `inverse` of Eq. (23)."""
COSTLY_AT = (1.0, 0.0)
"""Tolerances at which the estimators that simulate the joint run; a second each, where the others take a hundredth."""
MEASURES = ("rms", "moving", "resting", "nees", "response", "missed")
APART = 0.25
"""Time [s] between errors that count for NEES."""


def chosen(names: Iterable[str] = NAMES) -> dict[str, Estimator]:
    """Return the estimators by name."""
    inverse = with_values(registry.get(REFERENCE), {"name": "inverse", "alpha": "inverse"})
    return {name: inverse if name == "inverse" else registry.get(name) for name in names}


OFFSET_AT = (1.0, 0.2)
"""Tolerances at which joints with an unknown encoder offset are drawn."""
REALISTIC = ("sensors=realistic",)
"""Changes of a scenario for realistic sensors, clock and drive."""


def drawn(
    scenario: str,
    tolerance: float,
    seed: int,
    folder: Path | None,
    changes: Sequence[str] = (),
    load: float | None = None,
    zero_known: bool = True,
) -> DrawnExperiment:
    """Return a draw, from `folder` if it is kept there.

    Args:
      changes: of the scenario, `key=value`.
      load: gravity moment at horizontal of the payload [N·m]; the scenario's by default.
      zero_known: whether the encoder offset is known.
    """
    of = "".join(f"_{change}" for change in changes) + ("" if load is None else f"_load={load:g}")
    of += "" if zero_known else "_offset"
    kept = None if folder is None else folder / f"{scenario}_{tolerance:g}_{seed}{of}.pkl"
    if kept is not None and kept.is_file():
        with kept.open("rb") as file:
            return pickle.load(file)
    described, home = load_scenario(scenario, list(changes))
    found = draw(described, home, seed, tolerance, zero_known, load=load)
    if kept is not None:
        kept.parent.mkdir(parents=True, exist_ok=True)
        with write_into_place(kept) as temporary:
            temporary.write_bytes(pickle.dumps(found))
    return found


def assess(one: DrawnExperiment, scenario: str, tolerance: float, estimators: dict[str, Estimator]) -> Rows:
    """Measure every estimator in a draw: RMS [N·m] of all samples, moving, at rest, infinity where it diverges; mean NEES;
    response to pushes [ms] and the share of pushes that it misses."""
    rows: Rows = []
    events = [(a, b) for a, b in metrics.pushes(one.external_torque, CONTROL_PERIOD) if one.kept[a]]
    for name, estimator in estimators.items():
        row = {"scenario": scenario, "tolerance": tolerance, "estimator": name, "seed": one.seed}
        rows.append(row | dict.fromkeys(MEASURES[:3], np.inf) | dict.fromkeys(MEASURES[3:], np.nan))
        try:
            found = estimator.estimate(one.signals, one.known)
        except FilterDiverged:
            continue
        error = found.mean - one.truth
        parts = (one.kept, one.kept & one.moving, one.kept & ~one.moving)
        rows[-1] |= {measure: rms(error, part) for measure, part in zip(MEASURES, parts, strict=False)}
        if found.variance is not None:
            apart = np.flatnonzero(one.kept)[:: round(APART / CONTROL_PERIOD)]
            rows[-1]["nees"] = np.mean(error[apart] ** 2 / found.variance[apart])
        followed = metrics.responses(found.mean, one.truth, CONTROL_PERIOD, events) if events else np.empty(0)
        if len(followed):
            rows[-1]["missed"] = np.mean(np.isnan(followed))
        if np.isfinite(followed).any():
            rows[-1]["response"] = 1e3 * np.nanmean(followed)
    return rows


def geometric_over(values: Sequence[np.ndarray], reference: Sequence[np.ndarray]) -> Interval:
    """`geometric` over several scenarios with the same draws: each scenario counts alike.

    A draw's joint is the same in all of them, so the draw, not the run, is what is independent.
    """
    logs = np.mean([np.log(np.asarray(v) / np.asarray(r)) for v, r in zip(values, reference, strict=True)], axis=0)
    found = interval(logs)
    return Interval(np.exp(found.mean), np.exp(found.low), np.exp(found.high), found.n)


def write_cost(estimators: dict[str, Estimator], one: DrawnExperiment, path: Path) -> None:
    """Write the core time of an update, the median of nine measured in turns, and its ratio to RAREKF's."""
    part = one.signals.part(slice(0, 4000))
    runs = {n: lambda estimator=e: estimator.estimate(part, one.known) for n, e in estimators.items()}
    cost = {name: 1e6 * timing.core / len(part.time) for name, timing in alternately(runs, 9).items()}
    rows = [
        {"estimator": name, "us": f"{us:.2f}", "ratio": f"{us / cost[REFERENCE]:.1f}"}
        for name, us in sorted(cost.items(), key=lambda one: one[1])
    ]
    write_rows(path, rows)


LOADS = (4.0, 9.0, 12.0)
"""Gravity moments at horizontal [N·m]; the scenarios' own is the second."""
LOADED = SCENARIOS[1:]
LOADED_AT = (1.0, 0.2, 0.0)
LOADED_NAMES = ("augmented", "momentum_torsion", REFERENCE)


def with_load(scenario: str, load: float) -> str:
    """What an experiment with a load is called."""
    return f"{scenario}, {load:g} N·m"


def measured(one: Callable[[int], Rows], seeds: Iterable[int], threads: int) -> pd.DataFrame:
    """Rows of all draws, from several threads."""
    with ThreadPoolExecutor(threads) as pool:
        return pd.DataFrame(row for some in pool.map(one, seeds) for row in some)


def with_loads(seed: int, kept: Path | None) -> Rows:
    """Measure the estimators with other loads than the scenarios'; a joint that cannot bear the heaviest is left out."""
    estimators = chosen(LOADED_NAMES)
    try:
        return [
            row
            for load in reversed(LOADS)
            for tolerance in LOADED_AT
            for s in LOADED
            for row in assess(drawn(s, tolerance, seed, kept, load=load), with_load(s, load), tolerance, estimators)
        ]
    except InputError as error:
        print(f"draw {seed} is left out: {error}", flush=True)
        return []


def write_csv(rows: pd.DataFrame, path: Path) -> None:
    """Means over draws and the ratio, each with its interval, a line for each scenario, tolerance and estimator; the ratio over
    all three experiments in separate lines."""

    def line(scenario: str, tolerance: float, name: str, **found: Interval) -> dict[str, Any]:
        cells = {"scenario": scenario, "tolerance": f"{tolerance:g}", "estimator": name, "draws": found["ratio"].n}
        for measure, value in found.items():
            for end, x in (("", value.mean), ("_low", value.low), ("_high", value.high)):
                cells[f"{measure}{end}"] = "" if np.isnan(x) else f"{x:.5g}"
        return cells

    of = dict(list(rows.sort_values("seed", kind="stable").groupby(["scenario", "tolerance", "estimator"], sort=False)))
    lines = [
        line(*key, ratio=geometric(own.rms, of[*key[:2], REFERENCE].rms), **{m: interval(own[m]) for m in MEASURES})
        | {"draws": len(own)}
        for key, own in of.items()
    ]
    for tolerance, name in itertools.product(TOLERANCES, NAMES):
        if all((s, tolerance, name) in of for s in SCENARIOS):
            own, reference = ([of[s, tolerance, n].rms for s in SCENARIOS] for n in (name, REFERENCE))
            lines.append(line(OVERALL, tolerance, name, ratio=geometric_over(own, reference)))
    write_rows(path, lines)


def main(arguments: Sequence[str] = ()) -> None:
    """Run what is asked for, write its CSV, and write the page's tables and figure from all CSVs."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=30, help="draws, from seed 101; tuned on 1 to 8")
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--draws", type=Path, help="folder in which draws are kept, to be used again")
    parser.add_argument("--tolerances", type=float, nargs="+", default=list(TOLERANCES))
    parser.add_argument("--page", type=Path, default=ROOT / "docs" / "estimators.md")
    kinds = parser.add_mutually_exclusive_group()
    kinds.add_argument("--realistic", action="store_true", help="with `sensors: realistic`")
    kinds.add_argument("--offset", action="store_true", help="with an unknown encoder offset")
    kinds.add_argument("--loads", action="store_true", help="with light and heavy loads")
    kinds.add_argument("--cost", action="store_true", help="the core time of an update alone")
    kinds.add_argument("--tables", action="store_true", help="nothing is run: tables and figure from the CSVs")
    asked = parser.parse_args(arguments)
    if not asked.tables:
        run(asked)
    estimator_tables.write(asked.page)


def run(asked: argparse.Namespace) -> None:
    """Run every estimator over the draws of one kind and write the CSV next to the page."""
    folder, seeds = asked.page.parent, range(101, 101 + asked.seeds)
    if asked.loads:
        found = measured(partial(with_loads, kept=asked.draws), seeds, asked.threads)
        write_csv(found, folder / "estimators_loads.csv")
        return
    if asked.cost:
        some = drawn(SCENARIOS[0], asked.tolerances[0], 101, asked.draws)
        write_cost(chosen(), some, folder / "estimators_cost.csv")
        return
    name = "estimators_offset" if asked.offset else "estimators_realistic" if asked.realistic else "estimators"
    rows, began = pd.DataFrame(), time.perf_counter()
    changes = REALISTIC if asked.realistic else ()
    for costly in (False,) if asked.offset else (False, True):
        some = {n: one for n, one in chosen().items() if one.costly == costly}
        for tolerance, scenario in itertools.product(OFFSET_AT if asked.offset else asked.tolerances, SCENARIOS):
            if costly and tolerance not in COSTLY_AT:
                continue

            def one(seed: int, scenario: str = scenario, tolerance: float = tolerance, some: dict = some) -> Rows:
                found = drawn(scenario, tolerance, seed, asked.draws, changes, zero_known=not asked.offset)
                return assess(found, scenario, tolerance, some)

            rows = pd.concat([rows, measured(one, seeds, asked.threads)])
            print(f"{time.perf_counter() - began:7.0f} s  tolerance ×{tolerance:g}, {scenario}", flush=True)
        write_csv(rows, folder / f"{name}.csv")
