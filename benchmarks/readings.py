"""Which reading of Eq. (23) is best: `python -m benchmarks readings` writes a table of docs/paper.md, and docs/readings.csv.

RAREKF with each reading over draws that no other table uses, over experiments with light and heavy loads, with described
and realistic sensors. All filters of a draw share its signals and the measurement Y. Ratios are geometric means of the
ratio of RMS errors. Draws are kept (`--kept`) and not computed again. A draw whose joint cannot bear the load is replaced
by the next one.
"""

from __future__ import annotations

import argparse
import csv
import itertools
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.draws import draw_of, geometric, rms
from flexspline.estimator import recursion, registry
from flexspline.models.errors import InputError
from flexspline.models.files import write_into_place
from flexspline.scenarios.evaluation.draws import drawn_record, known_within, varied
from flexspline.scenarios.experiment import Experiment
from flexspline.scenarios.scenario import load_scenario
from flexspline.views.tables import markdown_table

from . import kept
from .claims import READINGS, V, settings
from .estimators import REALISTIC, TOLERANCES, geometric_over
from .pages import ROOT, fill, text

EXPERIMENTS: tuple[tuple[str, float | None], ...] = (
    ("no_load", None), ("link_sweep", 4.0), ("link_sweep", None), ("link_sweep", 12.0), ("external_push", 4.0),
    ("external_push", None), ("external_push", 12.0), ("tip_force", None),
)  # fmt: skip
"""Scenario, and gravity moment at horizontal of what is bolted on [N·m]; none: the scenario's own."""
SENSORS = {"ideal": (), "realistic": REALISTIC}
"""Changes of a scenario."""
SHOWN = tuple(t for t in TOLERANCES if t != 0.05)
"""Tolerances of the table; the CSV has all."""
W = 1e-4


@dataclass(frozen=True)
class Row:
    """RMS error [N·m] of a reading in an experiment of a draw; infinite where the filter diverged. `load` [N·m]: 0 for the
    scenario's own."""

    sensors: str
    tolerance: float
    scenario: str
    load: float
    seed: int
    reading: str
    V: str
    rms: float


def examined(seed: int) -> Iterator[Row]:
    """Every reading with every V in all experiments of a draw."""
    for sensors, changes in SENSORS.items():
        for tolerance in TOLERANCES:
            for name, load in EXPERIMENTS:
                scenario, home = load_scenario(name, list(changes))
                experiment = Experiment.of(varied(scenario, seed), home, load)
                record = drawn_record(experiment, seed, tolerance, True)
                simulation = experiment.simulate(seed, record, experiment.build(record))
                one = draw_of(experiment, simulation, record, known_within(experiment.known, tolerance, True), seed)
                y = np.ascontiguousarray(registry.get("model").estimate(one.signals, one.known).mean)
                for reading in READINGS:
                    for v, variance in V.items():
                        states = np.zeros(len(y), recursion.STATE)
                        _, status = recursion.run(y, settings(reading, variance, W), states)
                        error = rms(states["torque"] - one.truth, one.kept) if status == recursion.OK else np.inf
                        yield Row(sensors, tolerance, name, load or 0.0, seed, reading, v, float(f"{error:.6g}"))


class Results:
    """Rows of all draws."""

    def __init__(self, rows: Sequence[Row]):
        self._by: dict[tuple[str, float, str, float, str, str], list[float]] = {}
        for row in sorted(rows, key=lambda row: row.seed):
            key = (row.sensors, row.tolerance, row.scenario, row.load, row.reading, row.V)
            self._by.setdefault(key, []).append(row.rms)

    def values(
        self, sensors: str, tolerance: float, where: tuple[str, float | None], reading: str, v: str
    ) -> np.ndarray:
        """RMS error of every draw, shape (draws,) [N·m]."""
        return np.array(self._by[sensors, tolerance, where[0], where[1] or 0.0, reading, v])

    def overall(self, sensors: str, tolerance: float, reading: str, v: str, reference: tuple[str, str]) -> str:
        """Ratio to a reading with a V, over all experiments."""
        both = [[self.values(sensors, tolerance, e, *one) for e in EXPERIMENTS] for one in ((reading, v), reference)]
        return text(geometric_over(*both))


def titles() -> list[str]:
    """The experiments in words."""
    return [name if load is None else f"{name}, {load:g} N·m" for name, load in EXPERIMENTS]


def overall_table(results: Results) -> str:
    """Ratio to `max` with the shipped V, over all experiments."""
    shipped = next(iter(V))
    rows = []
    for v in V:
        for sensors in SENSORS:
            for tolerance in SHOWN:
                cells = [
                    "1" if (reading, v) == ("max", shipped)
                    else results.overall(sensors, tolerance, reading, v, ("max", shipped))
                    for reading in READINGS
                ]  # fmt: skip
                rows.append((v, sensors, f"×{tolerance:g}", *cells))
    return markdown_table(("V", "sensors", "tolerance", *READINGS), rows)


def write_csv(results: Results, path: Path) -> None:
    """Mean RMS error [N·m] of every reading, and its ratio to `max` with the same V."""
    with write_into_place(path) as temporary, temporary.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(["sensors", "tolerance", "experiment", "V", "reading", "draws", "rms", "ratio", "low", "high"])
        for sensors in SENSORS:
            for tolerance in TOLERANCES:
                for experiment, title in zip(EXPERIMENTS, titles(), strict=True):
                    for v in V:
                        for reading in READINGS:
                            own = results.values(sensors, tolerance, experiment, reading, v)
                            ratio = geometric(own, results.values(sensors, tolerance, experiment, "max", v))
                            cells = (np.mean(own), ratio.mean, ratio.low, ratio.high)
                            head = (sensors, f"{tolerance:g}", title, v, reading, len(own))
                            writer.writerow([*head, *(f"{x:.4g}" for x in cells)])


def main(arguments: Sequence[str] = ()) -> None:
    """Compute the draws that are not kept yet, keep them, and write the tables."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks readings", description=__doc__)
    parser.add_argument("--draws", type=int, default=30, help="seeds 201 and on")
    parser.add_argument("--kept", type=Path, default=Path("runs/readings.csv"))
    parser.add_argument("--page", type=Path, default=ROOT / "docs" / "paper.md")
    asked = parser.parse_args(arguments)
    rows, began = kept.read(asked.kept, Row), time.perf_counter()
    asked.kept.parent.mkdir(parents=True, exist_ok=True)
    seeds: list[int] = []
    for seed in itertools.count(201):
        if len(seeds) == asked.draws:
            break
        if not any(row.seed == seed for row in rows):
            try:
                rows += list(examined(seed))
            except InputError as error:
                print(f"draw {seed} is left out: {error}", flush=True)
                continue
            kept.write(asked.kept, rows, Row)
            print(f"{time.perf_counter() - began:7.0f} s  draw {seed}", flush=True)
        seeds.append(seed)
    results = Results([row for row in rows if row.seed in seeds])
    fill(asked.page, {"readings": overall_table(results)})
    write_csv(results, asked.page.with_name("readings.csv"))
