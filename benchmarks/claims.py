"""The paper's claims, measured: `python -m benchmarks claims` writes tables and a figure of docs/paper.md, and
docs/paper.csv.

Every claim over the readings of Eq. (23), V, W and calibration errors, on independent draws of one joint (start, pace,
pushes and noise per seed: `scenarios.evaluation.draws`). A calibration error changes what the filter knows, so all
filters see the same signals. The filters of one line share the measurement Y and differ in the recursion alone.
"""

from __future__ import annotations

import argparse
import itertools
import time
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from benchmarks.draws import DrawnExperiment, rms
from flexspline.estimator import registry
from flexspline.estimator.compliance import measurement_variance
from flexspline.estimator.estimator import CausalEstimator, KnownJoint, with_values
from flexspline.models.errors import FilterDiverged
from flexspline.models.files import write_into_place
from flexspline.scenarios.evaluation import metrics
from flexspline.scenarios.evaluation.intervals import Interval, interval
from flexspline.sim.loop import CONTROL_PERIOD
from flexspline.views.tables import markdown_table

from . import plots
from .estimators import SCENARIOS, drawn
from .pages import ROOT, fill, text

READINGS = ("max", "inverse", "printed", "one")
"""Of Eq. (23); `one`: α = 1, the AREKF."""
SHIPPED, OWN = "1e-2", "own"
V = {SHIPPED: 1e-2, "2.2e-3": 2.2e-3}
"""The shipped one, and what the encoders leave with 4096 counts; `OWN`: with as many as there are."""
W = {"1e-4": 1e-4, "1e-3": 1e-3}
MISMATCHES: Mapping[str, Mapping[str, float]] = {
    "exact": {}, "stiffness 10 % high": {"K1": 1.1, "K2": 1.1, "K3": 1.1}, "Kw0 15 % high": {"Kw0": 1.15},
    "no kinematic error known": {"amplitude": 0.0},
}  # fmt: skip
"""What the filters know, as a factor of the true value."""
LOADS = ((0.0, 1.0), (1.0, 2.0), (2.0, 4.0), (4.0, 6.0), (6.0, 99.0))
"""Bins of the joint torque's size [N·m], in motion."""
BINS = {f"robust_{a:g}_{b:g}": (a, b) for a, b in LOADS}
_TITLES = [f"sweep, {a:g}–{b:g} N·m" if b < 99 else f"sweep, over {a:g} N·m" for a, b in LOADS]
CLAIMS = (
    "no load: within 0.1 N·m", "no load: optimal", "from optimal to robust under load", "quick and quiet in pushes",
)  # fmt: skip
"""Titles of the claims."""


KEY = ["calibration", "alpha", "V", "W", "scenario"]
Setting = tuple[str, str, str, str]
"""Calibration, α, V, W."""


def reading_of(reading: str, variance: float, walk: float) -> CausalEstimator:
    """Return RAREKF with a reading, V [(N·m)²] and W [(N·m)² per step]."""
    base = registry.get("AREKF" if reading == "one" else "RAREKF")
    alpha = {} if reading == "one" else {"alpha": reading}
    return with_values(base, {"V": variance, "P0": variance, "W": walk, **alpha})  # type: ignore[return-value]


def mistaken(known: KnownJoint, factors: Mapping[str, float]) -> KnownJoint:
    """What is known, with numbers that are off by a factor."""
    return known.with_numbers(**{name: factor * known.p[name] for name, factor in factors.items()})


def examine(scenario: str, one: DrawnExperiment, variances: Mapping[str, float] = V) -> Iterator[dict[str, Any]]:
    """What every setting did in a draw, V [(N·m)²] by name: RMS error [N·m], share of robust mode, of time within 0.1 N·m,
    robust share by load in motion and at rest, response to pushes [ms], noise over that of Y."""
    truth, kept = one.truth, one.kept
    steady = metrics.steady(truth, CONTROL_PERIOD, kept)
    events = [(a, b) for a, b in metrics.pushes(one.external_torque, CONTROL_PERIOD) if kept[a]]
    load, moving = np.abs(truth), kept & one.moving
    for label, factors in MISMATCHES.items():
        known = mistaken(one.known, factors)
        raw = metrics.noise(registry.get("model").estimate(one.signals, known).mean, truth, CONTROL_PERIOD, steady)
        for reading, v, w in itertools.product(READINGS, variances, W):
            try:
                found = reading_of(reading, variances[v], W[w]).estimate(one.signals, known)
            except FilterDiverged:
                continue
            error, robust = found.mean - truth, found.robust
            bins = {name: moving & (load >= low) & (load < high) for name, (low, high) in BINS.items()}
            followed = metrics.responses(found.mean, truth, CONTROL_PERIOD, events)
            yield dict(zip(KEY, (label, reading, v, w, scenario), strict=True)) | {
                "rms": rms(error, kept),
                "robust": np.mean(robust[kept]),
                "within": np.mean(np.abs(error[kept]) < 0.1),
                **{name: np.mean(robust[at]) if np.count_nonzero(at) > 100 else np.nan for name, at in bins.items()},
                "resting": np.mean(robust[kept & ~one.moving]),
                "response_ms": 1e3 * np.nanmean(followed) if np.isfinite(followed).any() else np.nan,
                "noise": metrics.noise(found.mean, truth, CONTROL_PERIOD, steady) / raw,
            }


def own_variance(known: KnownJoint) -> float:
    """V [(N·m)²] that the encoders of a joint leave in Y, with counts as uniform noise."""
    n, p = known.noise, known.p
    return measurement_variance(
        float(p["K2"]), n.motor_resolution, n.link_resolution, n.link_noise, n.motor_noise, ratio=float(p["N"])
    )


def means(rows: pd.DataFrame) -> pd.DataFrame:
    """Means over draws, by `KEY`."""
    return rows.groupby(KEY, sort=False).mean()


def claims(mean: pd.DataFrame, setting: Setting) -> tuple[bool, bool, bool, bool]:
    """Within 0.1 N·m without load 99 % of the time; optimal there 90 %; in motion optimal 90 % below 1 N·m and robust half of
    the time from 4 N·m on; a push followed within 10 ms at no more than two thirds of the noise."""
    no_load, sweep, push = (mean.loc[*setting, scenario] for scenario in SCENARIOS)
    shares = sweep[list(BINS)]
    return (
        bool(no_load["within"] >= 0.99),
        bool(no_load["robust"] <= 0.1),
        bool(shares.iloc[0] <= 0.1 and (shares.iloc[3:] >= 0.5).all()),
        bool(push["response_ms"] <= 10.0 and push["noise"] <= 2 / 3),
    )


def shown(mean: pd.DataFrame) -> list[Setting]:
    """Select the settings of the tables: exact calibration, the smaller W. The CSV has all."""
    settings = dict.fromkeys(key[:4] for key in mean.index)
    return [s for s in settings if s[0] == "exact" and s[3] == next(iter(W))]


def claim_table(rows: pd.DataFrame) -> str:
    """Make the table of claims that hold, by reading and V."""
    mean = means(rows)
    lines = [(*s[1:3], *("yes" if held else "no" for held in claims(mean, s))) for s in shown(mean)]
    return markdown_table(("α", "V", *CLAIMS), lines)


def calibration_table(rows: pd.DataFrame) -> str:
    """Make the table of claims that hold, by number, over calibration errors and V."""
    mean, walk = means(rows), next(iter(W))
    lines = [(label, v, *(_codes(mean, (label, r, v, walk)) for r in READINGS)) for label in MISMATCHES for v in V]
    return markdown_table(("calibration", "V", *READINGS), lines)


def _codes(mean: pd.DataFrame, setting: Setting) -> str:
    """Write the numbers of the claims that hold."""
    return "".join(str(i) for i, held in enumerate(claims(mean, setting), 1) if held) or "none"


def mode_table(rows: pd.DataFrame) -> str:
    """Share of robust mode [%], exact calibration: without load, in the sweep by load while it moves, at rest."""
    mean, lines = means(rows), []
    for s in shown(mean):
        sweep = 100 * mean.loc[*s, "link_sweep"]
        no_load = f"{100 * mean.loc[*s, 'no_load']['robust']:.1f}"
        lines.append((*s[1:3], no_load, *(f"{share:.0f}" for share in sweep[[*BINS, "resting"]])))
    return markdown_table(("α", "V", "no load", *_TITLES, "at rest"), lines)


def count_table(found: Mapping[int, pd.DataFrame]) -> str:
    """Make the table of claims that hold, by number, over the motor encoder's counts, with exact calibration."""
    walk = next(iter(W))
    lines = [
        (str(counts), v, *(_codes(means(rows), ("exact", r, v, walk)) for r in READINGS))
        for counts, rows in found.items()
        for v in (SHIPPED, OWN)
    ]
    return markdown_table(("counts", "V", *READINGS), lines)


def mode_figure(csv_path: Path, path: Path) -> None:
    """Draw the share of the robust mode over the load in motion, from paper.csv."""
    mean = pd.read_csv(csv_path, dtype=dict.fromkeys(KEY, str))
    mean = mean[(mean.calibration == "exact") & (mean.W == next(iter(W))) & (mean.scenario == "link_sweep")]
    panels: dict[str, list[plots.Point]] = {}
    for name, label in zip(BINS, _TITLES, strict=True):
        for v, alpha, share in zip(mean.V, mean.alpha, 100 * mean[name], strict=True):
            panels.setdefault(f"V = {v}", []).append((label, alpha, Interval(share, share, share, 1)))
    plots.intervals(path, panels, "time in robust mode [%]", log=False)


def error_table(rows: pd.DataFrame) -> str:
    """RMS errors, response and noise, exact calibration."""
    mean, draws, lines = means(rows), rows.groupby(KEY), []
    for s in shown(mean):
        cells = [text(interval(draws.get_group((*s, name))["rms"].to_numpy()), 4) for name in SCENARIOS]
        response = text(interval(draws.get_group((*s, "external_push"))["response_ms"].to_numpy()), 1)
        within = f"{100 * mean.loc[*s, 'no_load']['within']:.1f}"
        noise = f"{mean.loc[*s, 'external_push']['noise']:.2f}"
        lines.append((*s[1:3], within, *cells, response, noise))
    heads = (
        "α", "V", "no load within 0.1 N·m [%]", *(f"{name} [N·m]" for name in SCENARIOS), "response [ms]",
        "noise / raw",
    )  # fmt: skip
    return markdown_table(heads, lines)


def write_csv(rows: pd.DataFrame, path: Path) -> None:
    """Means over draws of every setting."""
    with write_into_place(path) as temporary:
        means(rows).to_csv(temporary, float_format="%.4g")


def main(arguments: Sequence[str] = ()) -> None:
    """Run everything and write the page's tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=30, help="draws, seeds 101 and on")
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--draws", type=Path, help="folder in which draws are kept, to be used again")
    parser.add_argument("--page", type=Path, default=ROOT / "docs" / "paper.md")
    parser.add_argument(
        "--counts",
        type=int,
        nargs="+",
        help="of the motor encoder: writes that section and its CSVs, and leaves the others",
    )
    asked = parser.parse_args(arguments)
    seeds, pool = range(101, 101 + asked.seeds), ThreadPoolExecutor(asked.threads)
    with pool:
        if asked.counts is not None:
            by_count = {counts: measured(pool, seeds, asked.draws, counts) for counts in asked.counts}
            fill(asked.page, {"counts": count_table(by_count)})
            for counts, one in by_count.items():
                write_csv(one, asked.page.with_name(f"paper_{counts}.csv"))
            return
        whole = measured(pool, seeds, asked.draws)
    tables = {"claims": claim_table, "calibration": calibration_table, "mode": mode_table, "errors": error_table}
    fill(asked.page, {name: make(whole) for name, make in tables.items()})
    write_csv(whole, asked.page.with_suffix(".csv"))
    mode_figure(asked.page.with_suffix(".csv"), asked.page.parent / "figures" / "paper_mode.png")


def measured(
    pool: ThreadPoolExecutor, seeds: Sequence[int], kept: Path | None, counts: int | None = None
) -> pd.DataFrame:
    """Every setting over every draw; `counts`: of another motor encoder, with its own V and the shipped one."""
    found, began = [], time.perf_counter()
    changes = [] if counts is None else [f"sensors.motor_encoder.counts={counts}"]
    for scenario in SCENARIOS:

        def one(seed: int, scenario: str = scenario) -> list[dict[str, Any]]:
            draw = drawn(scenario, 0.0, seed, kept, changes)
            own = V if counts is None else {SHIPPED: V[SHIPPED], OWN: own_variance(draw.known)}
            return list(examine(scenario, draw, own))

        found += [x for several in pool.map(one, seeds) for x in several]
        print(f"{time.perf_counter() - began:7.0f} s  {counts or ''} {scenario}", flush=True)
    return pd.DataFrame(found)
