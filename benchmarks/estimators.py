"""Errors of every estimator on joints within a tolerance: `python -m benchmarks estimators` runs them and writes
docs/estimators.csv, then the tables and the figure of docs/estimators.md from all CSVs (`--tables`: only these).

Every number is over independent draws (`scenarios.evaluation.draws`): joint within a share of its tolerances, start,
pace, pushes and noise are drawn per seed; every estimator gets the same signals. Ratios are geometric means of the ratio
of RMS errors to RAREKF's, draw by draw. `--draws FOLDER` keeps the signals, so that a changed estimator is measured
without simulating again.
"""

from __future__ import annotations

import argparse
import csv
import pickle
import time
from collections.abc import Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.draws import DrawnExperiment, draw, geometric, rms
from flexspline.estimator import registry
from flexspline.estimator.errors import FilterDiverged
from flexspline.estimator.estimator import Estimator
from flexspline.estimator.tuning_parameters import with_values
from flexspline.models.errors import InputError
from flexspline.models.files import write_into_place
from flexspline.scenarios.evaluation import metrics
from flexspline.scenarios.evaluation.intervals import Interval, interval
from flexspline.scenarios.scenario import load_scenario
from flexspline.sim.loop import CONTROL_PERIOD

from . import estimator_tables
from .estimator_tables import OVERALL, REFERENCE, SCENARIOS
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
APART = 0.25
"""Time [s] between errors that count for NEES."""


@dataclass(frozen=True)
class Row:
    """An estimator's errors in a draw: RMS [N·m] of all samples, moving, at rest; mean NEES; response to pushes [ms] and the
    share of pushes that it misses."""

    scenario: str
    tolerance: float
    seed: int
    estimator: str
    rms: float
    moving: float
    resting: float
    nees: float = np.nan
    response: float = np.nan
    missed: float = np.nan


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


def assess(one: DrawnExperiment, scenario: str, tolerance: float, estimators: dict[str, Estimator]) -> list[Row]:
    """Measure every estimator in a draw; infinity where it diverges."""
    rows = []
    events = [(a, b) for a, b in metrics.pushes(one.external_torque, CONTROL_PERIOD) if one.kept[a]]
    for name, estimator in estimators.items():
        try:
            found = estimator.estimate(one.signals, one.known)
        except FilterDiverged:
            rows.append(Row(scenario, tolerance, one.seed, name, np.inf, np.inf, np.inf))
            continue
        error = found.mean - one.truth
        nees = np.nan
        if found.variance is not None:
            apart = np.flatnonzero(one.kept)[:: round(APART / CONTROL_PERIOD)]
            nees = float(np.mean(error[apart] ** 2 / found.variance[apart]))
        response, missed = np.nan, np.nan
        if events:
            followed = metrics.responses(found.mean, one.truth, CONTROL_PERIOD, events)
            missed = float(np.mean(np.isnan(followed))) if len(followed) else np.nan
            response = 1e3 * float(np.nanmean(followed)) if missed < 1.0 else np.nan
        rows.append(
            Row(
                scenario, tolerance, one.seed, name, rms(error, one.kept), rms(error, one.kept & one.moving),
                rms(error, one.kept & ~one.moving), nees, response, missed,
            )
        )  # fmt: skip
    return rows


class Results:
    """All rows, by scenario, tolerance and estimator."""

    def __init__(self, rows: Sequence[Row]):
        self.rows = rows
        self.names = [n for n in NAMES if any(r.estimator == n for r in rows)]
        self.tolerances = [t for t in TOLERANCES if any(r.tolerance == t for r in rows)]
        self._by: dict[tuple[str, float, str], list[Row]] = {}
        for row in sorted(rows, key=lambda r: r.seed):
            self._by.setdefault((row.scenario, row.tolerance, row.estimator), []).append(row)

    def has(self, tolerance: float, name: str) -> bool:
        """Whether an estimator has run at a tolerance."""
        return (SCENARIOS[-1], tolerance, name) in self._by

    def values(self, scenario: str, tolerance: float, name: str, measure: str = "rms") -> np.ndarray:
        """A measure of every draw, shape (draws,), by seed."""
        return np.array([getattr(row, measure) for row in self._by[scenario, tolerance, name]])

    def ratio(self, scenario: str, tolerance: float, name: str, measure: str = "rms") -> Interval:
        """Geometric mean of the ratio to RAREKF."""
        return geometric(
            self.values(scenario, tolerance, name, measure), self.values(scenario, tolerance, REFERENCE, measure)
        )

    def overall(self, tolerance: float, name: str) -> Interval:
        """Likewise over the three experiments."""
        both = [[self.values(s, tolerance, n) for s in SCENARIOS] for n in (name, REFERENCE)]
        return geometric_over(*both)


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
        (name, f"{cost[name]:.2f}", f"{cost[name] / cost[REFERENCE]:.1f}")
        for name in sorted(cost, key=cost.__getitem__)
    ]
    with write_into_place(path) as temporary, temporary.open("w", newline="", encoding="utf-8") as file:
        csv.writer(file).writerows([("estimator", "us", "ratio"), *rows])


LOADS = (4.0, 9.0, 12.0)
"""Gravity moments at horizontal [N·m]; the scenarios' own is the second."""
LOADED = SCENARIOS[1:]
LOADED_AT = (1.0, 0.2, 0.0)
LOADED_NAMES = ("augmented", "momentum_torsion", REFERENCE)


def with_load(scenario: str, load: float) -> str:
    """What an experiment with a load is called."""
    return f"{scenario}, {load:g} N·m"


def load_rows(seeds: Iterable[int], kept: Path | None, threads: int) -> list[Row]:
    """Measure the estimators with other loads than the scenarios'; leave out draws whose joint cannot bear the heaviest."""
    estimators, rows = chosen(LOADED_NAMES), []

    def one(seed: int) -> list[Row]:
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

    with ThreadPoolExecutor(threads) as pool:
        for some in pool.map(one, seeds):
            rows += some
    return rows


MEASURES = ("rms", "moving", "resting", "nees", "response", "missed")


def write_csv(results: Results, path: Path) -> None:
    """Means over draws and the ratio, each with its interval, a line for each scenario, tolerance and estimator; the ratio over
    all three experiments in separate lines."""

    def cells(found: Interval) -> list[str]:
        return ["" if np.isnan(x) else f"{x:.5g}" for x in (found.mean, found.low, found.high)]

    with write_into_place(path) as temporary, temporary.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        heads = ["scenario", "tolerance", "estimator", "draws"]
        for measure in ("ratio", *MEASURES):
            heads += [measure, f"{measure}_low", f"{measure}_high"]
        writer.writerow(heads)
        for (scenario, tolerance, name), rows in results._by.items():
            line = [scenario, f"{tolerance:g}", name, str(len(rows)), *cells(results.ratio(scenario, tolerance, name))]
            for measure in MEASURES:
                values = results.values(scenario, tolerance, name, measure)
                line += cells(interval(values[np.isfinite(values)])) if np.isfinite(values).any() else [""] * 3
            writer.writerow(line)
        for tolerance in results.tolerances:
            for name in (n for n in results.names if results.has(tolerance, n)):
                found = results.overall(tolerance, name)
                blank = [""] * 3 * len(MEASURES)
                writer.writerow([OVERALL, f"{tolerance:g}", name, found.n, *cells(found), *blank])


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
        found = Results(load_rows(seeds, asked.draws, asked.threads))
        write_csv(found, folder / "estimators_loads.csv")
        return
    if asked.cost:
        some = drawn(SCENARIOS[0], asked.tolerances[0], 101, asked.draws)
        write_cost(chosen(), some, folder / "estimators_cost.csv")
        return
    name = "estimators_offset" if asked.offset else "estimators_realistic" if asked.realistic else "estimators"
    rows, began = [], time.perf_counter()
    for costly in (False,) if asked.offset else (False, True):
        some = {n: one for n, one in chosen().items() if one.costly == costly}
        for tolerance in OFFSET_AT if asked.offset else asked.tolerances:
            if costly and tolerance not in COSTLY_AT:
                continue
            for scenario in SCENARIOS:
                changes = REALISTIC if asked.realistic else ()
                rows += _rows(scenario, tolerance, seeds, some, asked.draws, asked.threads, changes, not asked.offset)
                print(f"{time.perf_counter() - began:7.0f} s  tolerance ×{tolerance:g}, {scenario}", flush=True)
        write_csv(Results(rows), folder / f"{name}.csv")


def _rows(
    scenario: str,
    tolerance: float,
    seeds: Iterable[int],
    estimators: dict[str, Estimator],
    kept: Path | None,
    threads: int,
    changes: Sequence[str] = (),
    zero_known: bool = True,
) -> list[Row]:
    def one(seed: int) -> list[Row]:
        return assess(
            drawn(scenario, tolerance, seed, kept, changes, zero_known=zero_known), scenario, tolerance, estimators
        )

    with ThreadPoolExecutor(threads) as pool:
        return [row for several in pool.map(one, seeds) for row in several]
