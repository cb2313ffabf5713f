"""Which reading of Eq. (23) is best: `python -m benchmarks readings` writes a table of docs/paper.md, and docs/readings.csv.

RAREKF with each reading over draws that no other table uses, over experiments with light and heavy loads, with described
and realistic sensors. All filters of a draw share its signals and the measurement Y. Ratios are geometric means of the
ratio of RMS errors. Draws are kept (`--kept`) and not computed again. A draw whose joint cannot bear the load is replaced
by the next one.
"""

from __future__ import annotations

import argparse
import itertools
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from benchmarks.draws import geometric, rms
from flexspline.models.errors import FilterDiverged, InputError
from flexspline.models.files import write_rows
from flexspline.views.tables import markdown_table

from .claims import READINGS, V, reading_of
from .estimators import REALISTIC, TOLERANCES, drawn, geometric_over
from .pages import ROOT, fill, text

EXPERIMENTS: tuple[tuple[str, float | None], ...] = (
    ("no_load", None), ("link_sweep", 4.0), ("link_sweep", None), ("link_sweep", 12.0), ("external_push", 4.0),
    ("external_push", None), ("external_push", 12.0), ("tip_force", None),
)  # fmt: skip
"""Scenario, and gravity moment at horizontal of what is bolted on [N·m]; none: the scenario's own."""
SENSORS = {"ideal": (), "realistic": REALISTIC}
"""Changes of a scenario."""
W = 1e-4
KEY = ["sensors", "tolerance", "experiment", "V", "reading"]


def examined(seed: int) -> Iterator[dict[str, Any]]:
    """RMS error [N·m] of every reading with every V in all experiments of a draw; infinite where the filter diverged."""
    for sensors, tolerance, (name, load) in itertools.product(SENSORS, TOLERANCES, EXPERIMENTS):
        one = drawn(name, tolerance, seed, None, SENSORS[sensors], load)
        for v, reading in itertools.product(V, READINGS):
            try:
                found = reading_of(reading, V[v], W).estimate(one.signals, one.known)
                error = float(f"{rms(found.mean - one.truth, one.kept):.6g}")  # as kept
            except FilterDiverged:
                error = np.inf
            title = name if load is None else f"{name}, {load:g} N·m"
            yield dict(zip(["seed", *KEY, "rms"], (seed, sensors, tolerance, title, v, reading, error), strict=True))


def overall_table(rows: pd.DataFrame) -> str:
    """Ratio to `max` with the shipped V, over all experiments."""
    errors = rows.pivot(index=[k for k in KEY if k != "experiment"], columns=["experiment", "seed"], values="rms")

    def cell(*setting: str, reference: tuple[str, str] = (next(iter(V)), "max")) -> str:
        own, other = (errors.loc[*setting[:2], *one].unstack("seed").to_numpy() for one in (setting[2:], reference))
        return "1" if setting[2:] == reference else text(geometric_over(own, other))

    lines = [
        (v, sensors, f"×{tolerance:g}", *(cell(sensors, tolerance, v, reading) for reading in READINGS))
        for v, sensors, tolerance in itertools.product(V, SENSORS, TOLERANCES)
        if tolerance != 0.05  # the CSV has all
    ]
    return markdown_table(("V", "sensors", "tolerance", *READINGS), lines)


def means(rows: pd.DataFrame) -> list[dict[str, Any]]:
    """Mean RMS error [N·m] of every reading, and its ratio to `max` with the same V."""
    errors = {key: one.sort_values("seed")["rms"].to_numpy() for key, one in rows.groupby(KEY, sort=False)}
    lines = []
    for key, own in errors.items():
        ratio = geometric(own, errors[*key[:-1], "max"])
        cells = {"rms": np.mean(own), "ratio": ratio.mean, "low": ratio.low, "high": ratio.high}
        said = dict(zip(KEY, key, strict=True)) | {"tolerance": f"{key[1]:g}", "draws": len(own)}
        lines.append(said | {name: f"{value:.4g}" for name, value in cells.items()})
    return lines


def main(arguments: Sequence[str] = ()) -> None:
    """Compute the draws that are not kept yet, keep them, and write the tables."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks readings", description=__doc__)
    parser.add_argument("--draws", type=int, default=30, help="seeds 201 and on")
    parser.add_argument("--kept", type=Path, default=Path("runs/readings.csv"))
    parser.add_argument("--page", type=Path, default=ROOT / "docs" / "paper.md")
    asked = parser.parse_args(arguments)
    began = time.perf_counter()
    rows = pd.read_csv(asked.kept, dtype={"V": str}) if asked.kept.exists() else pd.DataFrame({"seed": []})
    asked.kept.parent.mkdir(parents=True, exist_ok=True)
    seeds: list[int] = []
    for seed in itertools.count(201):
        if len(seeds) == asked.draws:
            break
        if seed not in set(rows["seed"]):
            try:
                rows = pd.concat([rows, pd.DataFrame(examined(seed))])
            except InputError as error:
                print(f"draw {seed} is left out: {error}", flush=True)
                continue
            rows.to_csv(asked.kept, index=False)
            print(f"{time.perf_counter() - began:7.0f} s  draw {seed}", flush=True)
        seeds.append(seed)
    rows = rows[rows["seed"].isin(seeds)]
    fill(asked.page, {"readings": overall_table(rows)})
    write_rows(asked.page.with_name("readings.csv"), means(rows))
