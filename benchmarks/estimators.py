"""What each estimator is worth on joints that nobody knows exactly: `python -m benchmarks estimators` writes the tables of
docs/estimators.md, their numbers, docs/estimators.csv, and README's table.

Every number is over independent draws (`scenarios.evaluation.draws`): joint within a share of its tolerances, start, pace, pushes
and noise, all drawn per seed; every estimator over the same signals. Ratios are geometric means of the ratio of RMS errors to
RAREKF's, draw by draw. With `--draws FOLDER` signals are kept, and an estimator that has changed is measured without
simulating again. Tables go between the markers `<!-- begin NAME -->` and `<!-- end NAME -->` of the page.
"""

from __future__ import annotations

import argparse
import csv
import pickle
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from flexspline.estimator import registry
from flexspline.estimator.errors import FilterDiverged
from flexspline.estimator.estimator import Estimator, KnownJoint, Spread
from flexspline.estimator.tuning_parameters import with_values
from flexspline.models.errors import InputError
from flexspline.models.files import write_into_place
from flexspline.models.joint import load_joint
from flexspline.scenarios.evaluation import metrics
from flexspline.scenarios.evaluation.draws import DrawnExperiment, draw, geometric, rms
from flexspline.scenarios.evaluation.intervals import Interval, interval
from flexspline.scenarios.scenario import load_scenario
from flexspline.sim.loop import CONTROL_PERIOD
from flexspline.views.limit_tables import markdown

from .pages import ROOT, fill, share, text
from .quotes import OVERALL, REFERENCE
from .quotes import write as write_quotes
from .timing import alternately

SCENARIOS = ("no_load", "link_sweep", "external_push")
TOLERANCES = (1.0, 0.2, 0.05, 0.0)
NAMES = (
    "augmented", "dynamics_ekf", "momentum_torsion", "momentum", "current", "EKF", "AREKF", REFERENCE, "REKF", "inverse",
    "lowpass", "kalman", "strong_tracking", "h_infinity", "huber",
)  # fmt: skip
"""In the tables; `inverse` is RAREKF with the reading `inverse` of Eq. (23)."""
COSTLY_AT = (1.0, 0.0)
"""Tolerances at which the estimators that simulate the joint run; a second each, where the others take a hundredth."""
APART = 0.25
"""Time [s] between errors that count for NEES."""


@dataclass(frozen=True)
class Row:
    """What an estimator is worth in a draw: RMS error [N·m] of all, moving, at rest; mean NEES; response to pushes [ms] and the
    share of pushes that it never follows."""

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
    """The estimators of the tables by name."""
    inverse = with_values(registry.get(REFERENCE), {"name": "inverse", "alpha": "inverse"})
    return {name: inverse if name == "inverse" else registry.get(name) for name in names}


UNTARED_AT = (1.0, 0.2)
"""Tolerances at which joints are drawn whose link encoder's zero nobody has tared."""
REALISTIC = ("sensors=realistic",)
"""Changes of a scenario that make sensors, clock and drive what they are."""


def drawn(
    scenario: str,
    tolerance: float,
    seed: int,
    folder: Path | None,
    changes: Sequence[str] = (),
    load: float | None = None,
    tared: bool = True,
) -> DrawnExperiment:
    """A draw, from a folder where it has been kept; `changes`: of the scenario, `key=value`; `load`: gravity moment at
    horizontal of what is bolted on [N·m], instead of the scenario's; `tared`: whether the link encoder's zero is known."""
    of = "".join(f"_{change}" for change in changes) + ("" if load is None else f"_load={load:g}")
    of += "" if tared else "_untared"
    kept = None if folder is None else folder / f"{scenario}_{tolerance:g}_{seed}{of}.pkl"
    if kept is not None and kept.is_file():
        with kept.open("rb") as file:
            return pickle.load(file)
    described, home = load_scenario(scenario, list(changes))
    found = draw(described, home, seed, tolerance, tared, load=load)
    if kept is not None:
        kept.parent.mkdir(parents=True, exist_ok=True)
        with write_into_place(kept) as temporary:
            temporary.write_bytes(pickle.dumps(found))
    return found


def assess(one: DrawnExperiment, scenario: str, tolerance: float, estimators: dict[str, Estimator]) -> list[Row]:
    """What every estimator is worth in a draw; infinity where it diverges."""
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

    def at(self, tolerance: float) -> list[str]:
        """The estimators that have run at a tolerance, the best first."""
        names = [n for n in self.names if self.has(tolerance, n)]
        return sorted(names, key=lambda n: self.overall(tolerance, n).mean)

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


def overall_table(results: Results) -> str:
    """Ratio to RAREKF over the three experiments, by tolerance; the best at ×1 first."""

    def cell(tolerance: float, name: str) -> str:
        if not results.has(tolerance, name):
            return "–"
        return "1" if name == REFERENCE else text(results.overall(tolerance, name))

    names = results.at(results.tolerances[0])
    names += [n for n in results.names if n not in names]
    rows = [(n, *(cell(t, n) for t in results.tolerances)) for n in names]
    return markdown(("estimator", *(f"tolerance ×{t:g}" for t in results.tolerances)), rows)


def realistic_table(results: Results, digits: int = 2) -> str:
    """Ratio to RAREKF over the three experiments, by tolerance, and errors in each of them at the smallest."""
    least = min(results.tolerances)
    rows = []
    for n in results.at(results.tolerances[0]):
        row = [n]
        for t in results.tolerances:
            some = results.has(t, n)
            row.append("1" if n == REFERENCE else text(results.overall(t, n), digits) if some else "–")
        for s in SCENARIOS:
            row.append(text(interval(results.values(s, least, n)), 3) if results.has(least, n) else "–")
        rows.append(row)
    heads = ["estimator", *(f"tolerance ×{t:g}" for t in results.tolerances)]
    return markdown([*heads, *(f"×{least:g}, {s}: RMS [N·m]" for s in SCENARIOS)], rows)


def worst_nees(results: Results, name: str = "augmented") -> str:
    """The draw in which an estimator knows its own error least."""
    one = max((row for row in results.rows if row.estimator == name), key=lambda row: row.nees)
    (other,) = (row.rms for row in results._by[one.scenario, one.tolerance, REFERENCE] if row.seed == one.seed)
    return (
        f"`{name}` knows its own error least in one draw of `{one.scenario}` at ×{one.tolerance:g}: {one.rms:.2g} N·m RMS with a "
        f"NEES of {one.nees:.1f}, where {REFERENCE} has {other:.2g} N·m."
    )


def scenario_table(results: Results, tolerance: float) -> str:
    """RMS error and ratio to RAREKF in every experiment at a tolerance, in motion and at rest."""
    heads = ["estimator"]
    for name in SCENARIOS:
        heads += [f"{name}: RMS [N·m]", "moving", "at rest", "/ RAREKF", "largest"]
    rows = []
    for n in results.at(tolerance):
        row = [n]
        for s in SCENARIOS:
            row += [text(interval(results.values(s, tolerance, n, m)), 3) for m in ("rms", "moving", "resting")]
            largest = np.max(results.values(s, tolerance, n) / results.values(s, tolerance, REFERENCE))
            row += [text(results.ratio(s, tolerance, n)), f"{largest:.2f}"]
        rows.append(row)
    return markdown(heads, rows)


def nees_table(results: Results) -> str:
    """Mean NEES with its interval over draws: 1 where an estimator knows its own error."""
    rows = []
    for n in results.names:
        ran = [t for t in results.tolerances if results.has(t, n)]
        if np.all(np.isnan(results.values(SCENARIOS[0], ran[0], n, "nees"))):
            continue
        row = [n]
        for t in results.tolerances:
            some = results.has(t, n)
            row += [text(interval(results.values(s, t, n, "nees"))) if some else "–" for s in SCENARIOS]
        rows.append(row)
    return markdown(("estimator", *(f"{s} ×{t:g}" for t in results.tolerances for s in SCENARIOS)), rows)


def push_table(results: Results) -> str:
    """Response to pushes and share of pushes never followed."""
    rows = []
    for n in results.names:
        row = [n]
        for t in results.tolerances:
            if not results.has(t, n):
                row += ["–", "–"]
                continue
            row.append(text(interval(results.values("external_push", t, n, "response")), 1))
            row.append(share(results.values("external_push", t, n, "missed")))
        rows.append(row)
    heads = ["estimator"]
    for t in results.tolerances:
        heads += [f"×{t:g}: response [ms]", "missed [%]"]
    return markdown(heads, rows)


def sheet(known: KnownJoint) -> KnownJoint:
    """The same numbers, known as well as the test joint's description says; the zero tared."""
    return replace(known, spread=Spread.of(load_joint("test-joint")), friction=0.15)


def weighed(share: float, stated: float) -> Callable[[KnownJoint], KnownJoint]:
    """The weight told as a share of the nominal one, known within `stated`."""
    return lambda known: replace(
        known.with_numbers(Mg=share * known.p["Mg"]), spread=replace(known.spread, gravity=stated)
    )


TOLD: Mapping[str, tuple[float, Callable[[KnownJoint], KnownJoint]]] = {
    "exact; the data sheet's tolerances": (0.0, sheet),
    "×0.2; the data sheet's tolerances": (0.2, sheet),
    "×1; a weight 5 % too low, said to be within 1 %": (1.0, weighed(0.95, 0.01)),
    "×1; a weight 20 % too low, said to be within 1 %": (1.0, weighed(0.8, 0.01)),
    "×1; a weight 20 % too low, said to be within 20 %": (1.0, weighed(0.8, 0.2)),
}
"""What the joint is, and what the estimators are told that is not so: tolerance, and change of what is known."""


def told_table(seeds: Sequence[int], kept: Path | None, threads: int) -> str:
    """Ratio to RAREKF where what is told of the joint is not so."""
    names = ("augmented", "momentum_torsion", REFERENCE)
    table = []
    for label, (tolerance, change) in TOLD.items():
        row = [label]
        for scenario in SCENARIOS[1:]:

            def one(seed: int, s: str = scenario, t: float = tolerance, c: Callable = change) -> list[float]:
                found = drawn(s, t, seed, kept)
                known = c(found.known)
                estimates = [registry.get(n).estimate(found.signals, known).mean for n in names]
                return [rms(e - found.truth, found.kept) for e in estimates]

            with ThreadPoolExecutor(threads) as pool:
                errors = np.array(list(pool.map(one, seeds)))
            row += [text(geometric(errors[:, i], errors[:, 2])) for i in (0, 1)]
        table.append(row)
    heads = ["joint; what is told of it"] + [f"{s}: {n}" for s in SCENARIOS[1:] for n in names[:2]]
    return markdown(heads, table)


READERS = ("augmented", "dynamics_ekf", "momentum_torsion", "momentum", "current")
"""The estimators of the tables that read the current sensor."""


def reading_table(seeds: Sequence[int], kept: Path | None, threads: int) -> str:
    """RMS error with the current sensor's noise over that with the command in its place, draw by draw."""
    rows = []
    for tolerance in COSTLY_AT:
        cells = []
        for scenario in SCENARIOS:

            def one(seed: int, s: str = scenario, t: float = tolerance) -> list[list[float]]:
                found = drawn(s, t, seed, kept)
                command = np.r_[0.0, found.signals["current_command"][:-1]]
                exact = found.signals.with_columns(motor_current=command)
                sure = replace(found.known, noise=replace(found.known.noise, current_noise=0.0))
                errors = []
                for name in READERS:
                    if t > 0.0 and registry.get(name).costly:
                        errors.append([np.nan, np.nan])
                        continue
                    pair = [
                        registry.get(name).estimate(signals, known).mean
                        for signals, known in ((found.signals, found.known), (exact, sure))
                    ]
                    errors.append([rms(mean - found.truth, found.kept) for mean in pair])
                return errors

            with ThreadPoolExecutor(threads) as pool:
                values = np.array(list(pool.map(one, seeds)))
            cells.append([text(geometric(values[:, i, 0], values[:, i, 1])) for i in range(len(READERS))])
        rows += [(name, f"×{tolerance:g}", *(c[i] for c in cells)) for i, name in enumerate(READERS)]
    return markdown(("estimator", "tolerance", *SCENARIOS), [r for r in rows if "–" not in r])


def cost_table(estimators: dict[str, Estimator], one: DrawnExperiment, path: Path) -> str:
    """Core time of an update, median of nine measured in turns, and over RAREKF's; kept in a CSV as well."""
    part = one.signals.part(slice(0, 4000))
    runs = {n: lambda estimator=e: estimator.estimate(part, one.known) for n, e in estimators.items()}
    cost = {name: 1e6 * timing.core / len(part.time) for name, timing in alternately(runs, 9).items()}
    rows = [
        (name, f"{cost[name]:.2f}", f"{cost[name] / cost[REFERENCE]:.1f}")
        for name in sorted(cost, key=cost.__getitem__)
    ]
    with write_into_place(path) as temporary, temporary.open("w", newline="", encoding="utf-8") as file:
        csv.writer(file).writerows([("estimator", "us", "ratio"), *rows])
    return markdown(("estimator", "µs per update", f"/ {REFERENCE}"), rows)


LOADS = (4.0, 9.0, 12.0)
"""Gravity moments at horizontal [N·m]; the scenarios' own is the second."""
LOADED = SCENARIOS[1:]
LOADED_AT = (1.0, 0.2, 0.0)
LOADED_NAMES = ("augmented", "momentum_torsion", REFERENCE)


def with_load(scenario: str, load: float) -> str:
    """What an experiment with a load is called."""
    return f"{scenario}, {load:g} N·m"


def load_rows(seeds: Iterable[int], kept: Path | None, threads: int) -> list[Row]:
    """What the estimators are worth with other loads than the scenarios'; a draw whose joint cannot bear the heaviest is left
    out of all."""
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


def load_table(results: Results) -> str:
    """By tolerance and load: ratios to RAREKF, the largest of `augmented`, and its NEES."""
    heads = ["tolerance", "load [N·m]"]
    for s in LOADED:
        heads += [f"{s}: {n} / {REFERENCE}" for n in LOADED_NAMES[:2]] + ["largest of augmented", "its NEES"]
    rows = []
    for tolerance in LOADED_AT:
        for load in LOADS:
            row = [f"×{tolerance:g}", f"{load:g}"]
            for s in (with_load(s, load) for s in LOADED):
                row += [text(results.ratio(s, tolerance, n)) for n in LOADED_NAMES[:2]]
                own, other = (results.values(s, tolerance, n) for n in (LOADED_NAMES[0], REFERENCE))
                row += [
                    f"{np.max(own / other):.2f}",
                    text(interval(results.values(s, tolerance, LOADED_NAMES[0], "nees"))),
                ]
            rows.append(row)
    return markdown(heads, rows)


MEASURES = ("rms", "moving", "resting", "nees", "response", "missed")


def write_csv(results: Results, path: Path) -> None:
    """Means over draws and the ratio, each with its interval, a line for each scenario, tolerance and estimator; the ratio over
    all three experiments in lines of its own."""

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
    """Run everything and write the page's tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=30, help="draws, seeds 101 and on; tuned on 1 to 8")
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--draws", type=Path, help="folder in which draws are kept, to be used again")
    parser.add_argument("--tolerances", type=float, nargs="+", default=list(TOLERANCES))
    parser.add_argument("--page", type=Path, default=ROOT / "docs" / "estimators.md")
    parser.add_argument(
        "--realistic",
        action="store_true",
        help="with `sensors: realistic`: writes that section and its own CSV, and leaves the others",
    )
    parser.add_argument("--cost", action="store_true", help="measures the time of updates alone, and writes that table")
    parser.add_argument(
        "--loads", action="store_true", help="over light and heavy loads alone: writes that section and its own CSV"
    )
    parser.add_argument(
        "--untared",
        action="store_true",
        help="with the link encoder's zero drawn and not tared: writes that section and its own CSV",
    )
    parser.add_argument("--readme", type=Path, default=ROOT / "README.md")
    asked = parser.parse_args(arguments)
    if asked.loads:
        loaded = Results(load_rows(range(101, 101 + asked.seeds), asked.draws, asked.threads))
        fill(asked.page, {"loads": load_table(loaded)})
        write_csv(loaded, asked.page.with_name("estimators_loads.csv"))
        return
    if asked.cost:
        some = drawn(SCENARIOS[0], asked.tolerances[0], 101, asked.draws)
        fill(asked.page, {"cost": cost_table(chosen(), some, asked.page.with_name("estimators_cost.csv"))})
        write_quotes(asked.page, asked.readme)
        return
    if asked.untared:
        cheap = {name: one for name, one in chosen().items() if not one.costly}
        cases, seeds = [(s, t) for t in UNTARED_AT for s in SCENARIOS], range(101, 101 + asked.seeds)
        found = [_rows(*case, seeds, cheap, asked.draws, asked.threads, tared=False) for case in cases]
        untared = Results([row for some in found for row in some])
        fill(asked.page, {"untared": realistic_table(untared, 3), "untared worst": worst_nees(untared)})
        write_csv(untared, asked.page.with_name("estimators_untared.csv"))
        return
    estimators, rows, began = chosen(), [], time.perf_counter()
    seeds, changes = range(101, 101 + asked.seeds), REALISTIC if asked.realistic else ()
    for costly in (False, True):
        some = {name: one for name, one in estimators.items() if one.costly == costly}
        for tolerance in asked.tolerances:
            if costly and tolerance not in COSTLY_AT:
                continue
            for scenario in SCENARIOS:
                rows += _rows(scenario, tolerance, seeds, some, asked.draws, asked.threads, changes)
                print(f"{time.perf_counter() - began:7.0f} s  tolerance ×{tolerance:g}, {scenario}", flush=True)
        results = Results(rows)
        if asked.realistic:
            fill(asked.page, {"realistic": realistic_table(results)})
            write_csv(results, asked.page.with_name("estimators_realistic.csv"))
            continue
        if not costly:
            further = {"told": told_table, "reading": reading_table}
            fill(asked.page, {name: make(seeds, asked.draws, asked.threads) for name, make in further.items()})
        last = drawn(SCENARIOS[0], asked.tolerances[0], seeds[0], asked.draws)
        cost = cost_table(estimators, last, asked.page.with_name("estimators_cost.csv"))
        fill(asked.page, {**tables(results, asked.seeds), "cost": cost})
        write_csv(results, asked.page.with_suffix(".csv"))
    write_quotes(asked.page, asked.readme)


def _rows(
    scenario: str,
    tolerance: float,
    seeds: Iterable[int],
    estimators: dict[str, Estimator],
    kept: Path | None,
    threads: int,
    changes: Sequence[str] = (),
    tared: bool = True,
) -> list[Row]:
    def one(seed: int) -> list[Row]:
        return assess(drawn(scenario, tolerance, seed, kept, changes, tared=tared), scenario, tolerance, estimators)

    with ThreadPoolExecutor(threads) as pool:
        return [row for several in pool.map(one, seeds) for row in several]


def tables(results: Results, seeds: int) -> dict[str, str]:
    """The page's tables by name."""
    return {
        "about": about(seeds),
        "overall": overall_table(results),
        **{f"scenarios {t:g}": scenario_table(results, t) for t in results.tolerances},
        "nees": nees_table(results),
        "push": push_table(results),
    }


def about(seeds: int) -> str:
    """How the page's numbers were made."""
    return (
        f"Written by `python -m benchmarks estimators`: {seeds} draws a number (seeds 101 to {100 + seeds}; `augmented` tuned on "
        "seeds 1 to 8). Brackets are 95 % intervals over draws: Student's t, of log ratios for ratios. All numbers, as a table: "
        "[estimators.csv](estimators.csv)."
    )


if __name__ == "__main__":
    import sys

    main(sys.argv[1:])
