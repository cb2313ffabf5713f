"""The paper's claims, measured: `python -m benchmarks claims` writes tables and a figure of docs/paper.md, and
docs/paper.csv.

Every claim over the readings of Eq. (23), V, W and calibration errors, on independent draws of one joint (start, pace,
pushes and noise per seed: `scenarios.evaluation.draws`). A calibration error changes what the filter knows, so all
filters see the same signals. The filters of one line share the measurement Y and differ in the recursion alone.
"""

from __future__ import annotations

import argparse
import csv
import time
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.draws import DrawnExperiment, rms
from flexspline.estimator import recursion, registry
from flexspline.estimator.compliance import measurement_variance
from flexspline.estimator.estimator import KnownJoint
from flexspline.estimator.tuning_parameters import with_values
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
CLAIMS = (
    "no load: within 0.1 N·m", "no load: optimal", "from optimal to robust under load", "quick and quiet in pushes",
)  # fmt: skip
"""Titles of the claims."""


@dataclass(frozen=True)
class Found:
    """What one setting did in one draw: RMS error [N·m], share of robust mode, of time within 0.1 N·m, robust share by load in
    motion and at rest, response to pushes [ms], noise over that of Y."""

    scenario: str
    mismatch: str
    reading: str
    V: str
    W: str
    seed: int
    rms: float
    robust: float
    within: float
    by_load: tuple[float, ...]
    resting: float
    response: float
    noise: float


def settings(reading: str, variance: float, walk: float) -> np.ndarray:
    """RAREKF's settings with a reading, V and W, for `recursion.run`."""
    base = registry.get("AREKF" if reading == "one" else "RAREKF")
    alpha = {} if reading == "one" else {"alpha": reading}
    return with_values(base, {"V": variance, "P0": variance, "W": walk, **alpha}).record()  # type: ignore[attr-defined]


def mistaken(known: KnownJoint, factors: Mapping[str, float]) -> KnownJoint:
    """What is known, with numbers that are off by a factor."""
    return known.with_numbers(**{name: factor * known.p[name] for name, factor in factors.items()})


def examine(scenario: str, one: DrawnExperiment, variances: Mapping[str, float] = V) -> Iterator[Found]:
    """Every setting over a draw; V [(N·m)²] by name."""
    truth, kept = one.truth, one.kept
    steady = metrics.steady(truth, CONTROL_PERIOD, kept)
    events = [(a, b) for a, b in metrics.pushes(one.external_torque, CONTROL_PERIOD) if kept[a]]
    load = np.abs(truth)
    for label, factors in MISMATCHES.items():
        y = registry.get("model").estimate(one.signals, mistaken(one.known, factors)).mean
        raw = metrics.noise(y, truth, CONTROL_PERIOD, steady)
        for reading in READINGS:
            for v, variance in variances.items():
                for w, walk in W.items():
                    states = np.zeros(len(y), recursion.STATE)
                    _, status = recursion.run(np.ascontiguousarray(y), settings(reading, variance, walk), states)
                    if status != recursion.OK:
                        continue
                    error, robust = states["torque"] - truth, states["robust"] > 0
                    moving = kept & one.moving
                    bins = tuple(
                        float(np.mean(robust[at])) if np.count_nonzero(at) > 100 else np.nan
                        for at in (moving & (load >= low) & (load < high) for low, high in LOADS)
                    )
                    followed = metrics.responses(states["torque"], truth, CONTROL_PERIOD, events)
                    yield Found(
                        scenario, label, reading, v, w, one.seed, rms(error, kept), float(np.mean(robust[kept])),
                        float(np.mean(np.abs(error[kept]) < 0.1)), bins, float(np.mean(robust[kept & ~one.moving])),
                        1e3 * float(np.nanmean(followed)) if np.isfinite(followed).any() else np.nan,
                        metrics.noise(states["torque"], truth, CONTROL_PERIOD, steady) / raw,
                    )  # fmt: skip


def own_variance(known: KnownJoint) -> float:
    """V [(N·m)²] that the encoders of a joint leave in Y, with counts as uniform noise."""
    n, p = known.noise, known.p
    return measurement_variance(
        float(p["K2"]), n.motor_resolution, n.link_resolution, n.link_noise, n.motor_noise, ratio=float(p["N"])
    )


class Map:
    """All that was found, by setting."""

    def __init__(self, found: Sequence[Found]):
        self._by: dict[tuple[str, str, str, str, str], list[Found]] = {}
        for one in found:
            self._by.setdefault((one.mismatch, one.reading, one.V, one.W, one.scenario), []).append(one)
        self.settings = list(dict.fromkeys(key[:4] for key in self._by))

    def values(self, setting: tuple[str, ...], scenario: str, measure: str) -> np.ndarray:
        """A measure of every draw."""
        return np.array([getattr(one, measure) for one in self._by.get((*setting, scenario), ())])  # type: ignore[arg-type]

    def loads(self, setting: tuple[str, ...], scenario: str = "link_sweep") -> np.ndarray:
        """Share of robust mode by load in motion, mean over draws; shape (bins,)."""
        return np.nanmean(self.values(setting, scenario, "by_load"), axis=0)

    def claims(self, setting: tuple[str, ...]) -> tuple[bool, bool, bool, bool]:
        """Within 0.1 N·m without load 99 % of the time; optimal there 90 %; in motion optimal 90 % below 1 N·m and robust half of
        the time from 4 N·m on; a push followed within 10 ms at no more than two thirds of the noise."""
        shares = self.loads(setting)
        grows = bool(shares[0] <= 0.1 and np.all(shares[3:] >= 0.5))
        response = np.nanmean(self.values(setting, "external_push", "response"))
        return (
            bool(np.mean(self.values(setting, "no_load", "within")) >= 0.99),
            bool(np.mean(self.values(setting, "no_load", "robust")) <= 0.1),
            grows,
            bool(response <= 10.0 and np.mean(self.values(setting, "external_push", "noise")) <= 2 / 3),
        )


def shown(found: Map) -> list[tuple[str, str, str, str]]:
    """Select the settings of the tables: exact calibration, the smaller W. The CSV has all."""
    return [s for s in found.settings if s[0] == "exact" and s[3] == next(iter(W))]


def claim_table(found: Map) -> str:
    """Make the table of claims that hold, by reading and V."""
    rows = [(*s[1:3], *("yes" if held else "no" for held in found.claims(s))) for s in shown(found)]
    return markdown_table(("α", "V", *CLAIMS), rows)


def calibration_table(found: Map) -> str:
    """Make the table of claims that hold, by number, over calibration errors and V."""
    walk = next(iter(W))
    rows = [(label, v, *(_codes(found, (label, r, v, walk)) for r in READINGS)) for label in MISMATCHES for v in V]
    return markdown_table(("calibration", "V", *READINGS), rows)


def _codes(found: Map, setting: tuple[str, ...]) -> str:
    """Write the numbers of the claims that hold."""
    return "".join(str(i) for i, held in enumerate(found.claims(setting), 1) if held) or "none"


def _shares(found: Map, setting: tuple[str, ...]) -> list[str]:
    """Share of robust mode [%]: without load, in the sweep by load while it moves, at rest."""
    shares = [f"{100 * x:.0f}" for x in found.loads(setting)]
    no_load = f"{100 * np.mean(found.values(setting, 'no_load', 'robust')):.1f}"
    return [no_load, *shares, f"{100 * np.mean(found.values(setting, 'link_sweep', 'resting')):.0f}"]


_BINS = [f"sweep, {a:g}–{b:g} N·m" if b < 99 else f"sweep, over {a:g} N·m" for a, b in LOADS]


def mode_table(found: Map) -> str:
    """Share of robust mode by load, exact calibration."""
    rows = [(*s[1:3], *_shares(found, s)) for s in shown(found)]
    return markdown_table(("α", "V", "no load", *_BINS, "at rest"), rows)


def count_table(found: Mapping[int, Map]) -> str:
    """Make the table of claims that hold, by number, over the motor encoder's counts, with exact calibration."""
    walk = next(iter(W))
    rows = [
        (str(counts), v, *(_codes(one, ("exact", r, v, walk)) for r in READINGS))
        for counts, one in found.items()
        for v in (SHIPPED, OWN)
    ]
    return markdown_table(("counts", "V", *READINGS), rows)


def mode_figure(csv_path: Path, path: Path) -> None:
    """Draw the share of the robust mode over the load in motion, from paper.csv."""
    with csv_path.open(newline="", encoding="utf-8") as file:
        rows = [
            r for r in csv.DictReader(file)
            if (r["calibration"], r["W"], r["scenario"]) == ("exact", next(iter(W)), "link_sweep")
        ]  # fmt: skip
    panels: dict[str, list[plots.Point]] = {}
    for (low, high), label in zip(LOADS, _BINS, strict=True):
        for r in rows:
            share = 100 * float(r[f"robust_{low:g}_{high:g}"])
            panels.setdefault(f"V = {r['V']}", []).append((label, r["alpha"], Interval(share, share, share, 1)))
    plots.intervals(path, panels, "time in robust mode [%]", log=False)


def error_table(found: Map) -> str:
    """RMS errors, response and noise, exact calibration."""
    rows = []
    for s in shown(found):
        cells = [text(interval(found.values(s, name, "rms")), 4) for name in SCENARIOS]
        response = text(interval(found.values(s, "external_push", "response")), 1)
        within = f"{100 * np.mean(found.values(s, 'no_load', 'within')):.1f}"
        noise = f"{np.mean(found.values(s, 'external_push', 'noise')):.2f}"
        rows.append((*s[1:3], within, *cells, response, noise))
    heads = (
        "α", "V", "no load within 0.1 N·m [%]", *(f"{name} [N·m]" for name in SCENARIOS), "response [ms]",
        "noise / raw",
    )  # fmt: skip
    return markdown_table(heads, rows)


def write_csv(found: Map, path: Path) -> None:
    """Means over draws of every setting."""
    with write_into_place(path) as temporary, temporary.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        bins = [f"robust_{a:g}_{b:g}" for a, b in LOADS]
        writer.writerow(
            [
                "calibration",
                "alpha",
                "V",
                "W",
                "scenario",
                "rms",
                "robust",
                "within",
                *bins,
                "resting",
                "response_ms",
                "noise",
            ]
        )
        for key in found._by:
            setting, scenario = key[:4], key[4]
            first = [np.mean(found.values(setting, scenario, m)) for m in ("rms", "robust", "within")]
            last = [np.mean(found.values(setting, scenario, m)) for m in ("resting", "response", "noise")]
            shares = found.values(setting, scenario, "by_load")
            middle = [np.nanmean(c) if np.isfinite(c).any() else np.nan for c in shares.T]
            writer.writerow([*key, *("" if np.isnan(x) else f"{x:.4g}" for x in (*first, *middle, *last))])


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


def measured(pool: ThreadPoolExecutor, seeds: Sequence[int], kept: Path | None, counts: int | None = None) -> Map:
    """Every setting over every draw; `counts`: of another motor encoder, with its own V and the shipped one."""
    found, began = [], time.perf_counter()
    changes = [] if counts is None else [f"sensors.motor_encoder.counts={counts}"]
    for scenario in SCENARIOS:

        def one(seed: int, scenario: str = scenario) -> list[Found]:
            draw = drawn(scenario, 0.0, seed, kept, changes)
            own = V if counts is None else {SHIPPED: V[SHIPPED], OWN: own_variance(draw.known)}
            return list(examine(scenario, draw, own))

        found += [x for several in pool.map(one, seeds) for x in several]
        print(f"{time.perf_counter() - began:7.0f} s  {counts or ''} {scenario}", flush=True)
    return Map(found)
