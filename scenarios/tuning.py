"""Finding each filter's knobs on training seeds, and what it is worth with them on other seeds.

The plant runs once per scenario and seed; a filter's settings do not change what the sensors see, so each trial is a filter
over stored signals (`offline`). What is minimised is the RMS error after the transient, over several scenarios its
geometric mean. The search is Nelder & Mead's in the knobs' own scales, from the best of the defaults and a coarse scan of
the first knob, and again from where it ended. The best of all that was tried is returned, so training never ends worse
than the defaults. No randomness.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from scipy.optimize import minimize
from scipy.stats import qmc

from ..estimator import FilterDiverged
from ..models.errors import InputError
from ..models.files import write_into_place
from . import metrics
from .intervals import Interval, interval
from .offline import Contender, rms_error, run_alone
from .run import Run
from .scenario import FilterChoice, Scenario

EVALUATIONS = 300
"""Settings that are tried of a filter whose update takes less than a microsecond; a tenth of it of one that takes ten."""
_SCAN = 7  # values of the first knob before the search
_STEP = 0.08  # of a knob's range: the first simplex
_FAILED = 1e6  # N·m


@dataclass(frozen=True)
class Tuned:
    """A filter's knobs found on training seeds, and what it is worth on others.

    Attributes:
        default, tuned: the filter before and after.
        values: knobs, by field.
        train: RMS error on the training seeds, geometric mean over scenarios [N·m], default and tuned.
        evaluations: settings tried.
        test_default, test_tuned: Shape (scenarios, seeds), RMS errors on the test seeds [N·m].
        at_bound: knobs that ended at a bound of their range.
    """

    default: Contender
    tuned: Contender
    values: dict[str, float]
    train: tuple[float, float]
    evaluations: int
    test_default: np.ndarray
    test_tuned: np.ndarray
    at_bound: tuple[str, ...]

    @property
    def name(self) -> str:
        """The filter's name."""
        return self.default.name

    @property
    def gain(self) -> Interval:
        """Tuned RMS less the default's on the same test runs [N·m], paired over seeds; below zero where tuning helps."""
        return interval((self.test_tuned - self.test_default).mean(axis=0))


def simulated(scenarios: Sequence[tuple[Scenario, Path | None]], seeds: Sequence[int]) -> list[list[Run]]:
    """Run every scenario with every seed: one list of runs per scenario.

    Raises:
        InputError: no seeds; a scenario with an estimate fed back (`offline.run_alone`).
    """
    if not seeds:
        raise InputError("tune: expected at least one seed, got none")
    return [[run_alone(scenario, folder, seed) for seed in seeds] for scenario, folder in scenarios]


def errors(contender: Contender, runs: Sequence[Sequence[Run]], threads: int = 1) -> np.ndarray:
    """RMS error [N·m] over each run, shape (scenarios, seeds); a large number where the filter diverges."""

    def one(run: Run) -> float:
        try:
            return rms_error(contender.estimate(run).torque, run)
        except FilterDiverged:
            return _FAILED

    flat = [run for several in runs for run in several]
    with ThreadPoolExecutor(threads) as pool:
        found = list(pool.map(one, flat))
    return np.nan_to_num(np.array(found), nan=_FAILED, posinf=_FAILED).reshape(len(runs), -1)


def score(rms: np.ndarray) -> float:
    """One number of RMS errors (scenarios, seeds): over seeds the root mean square, over scenarios the geometric mean."""
    return float(np.exp(np.mean(np.log(np.sqrt(np.mean(rms**2, axis=1))))))


def tune(
    contender: Contender,
    train: Sequence[Sequence[Run]],
    test: Sequence[Sequence[Run]],
    evaluations: int = EVALUATIONS,
    threads: int = 1,
) -> Tuned:
    """Tune a filter's knobs on training runs and measure it on test runs.

    Args:
        contender: with its defaults; without knobs it is only measured.
        train, test: runs by scenario (`simulated`).
        evaluations: about how many settings are tried; a tenth for the filters that simulate the joint.
        threads: runs at a time; the result does not depend on it.
    """
    knobs = contender.knobs
    budget = max(evaluations // 10, 2 * len(knobs) + 2) if contender.costly else evaluations
    tried: dict[tuple[float, ...], float] = {}

    def cost(place: np.ndarray) -> float:
        place = tuple(float(min(max(u, 0.0), 1.0)) for u in place)
        if place not in tried:
            values = {k.field: k.from_unit(u) for k, u in zip(knobs, place, strict=True)}
            tried[place] = math.log(score(errors(contender.turned(values), train, threads)))
        return tried[place]

    before = score(errors(contender, train, threads))
    best, least = contender, before
    values = {k.field: contender.value(k) for k in knobs}
    at_bound: tuple[str, ...] = ()
    if knobs:
        start = np.array([k.to_unit(contender.value(k)) for k in knobs])
        cost(start)
        if not contender.costly:
            for u in np.linspace(0.0, 1.0, _SCAN):
                cost(np.r_[u, start[1:]])
        # The simplex may collapse early: begin again from the best, until that gives nothing.
        gained = True
        while gained and len(tried) < budget:
            lowest = min(tried.values())
            origin = np.array(min(tried, key=tried.get))
            simplex = np.tile(origin, (len(knobs) + 1, 1))
            for i in range(len(knobs)):
                simplex[i + 1, i] += _STEP if origin[i] + _STEP <= 1.0 else -_STEP
            minimize(
                cost, origin, method="Nelder-Mead", bounds=[(0.0, 1.0)] * len(knobs),
                options={
                    "initial_simplex": simplex, "maxfev": budget - len(tried), "xatol": 1e-3, "fatol": 1e-5,
                },
            )  # fmt: skip
            gained = min(tried.values()) < lowest - 1e-3
        place = min(tried, key=tried.get)
        if math.exp(tried[place]) < before:
            values = {k.field: k.from_unit(u) for k, u in zip(knobs, place, strict=True)}
            best, least = contender.turned(values), math.exp(tried[place])
            at_bound = tuple(k.field for k, u in zip(knobs, place, strict=True) if u < 1e-3 or u > 1 - 1e-3)
    return Tuned(
        contender, best, values, (before, least), len(tried) + 1,
        errors(contender, test, threads), errors(best, test, threads), at_bound,
    )  # fmt: skip


# --- noise against delay -------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Front:
    """The settings of a filter of which no other one has both less noise and less delay.

    Attributes:
        name: of the filter.
        points: Shape (P, 2), delay to a push [ms], noise in steady state [N·m]; by delay.
        settings: the knobs of each point.
        default, tuned: the same two numbers of the filter's defaults, and of the tuned one where there is one.
    """

    name: str
    points: np.ndarray
    settings: tuple[dict[str, float], ...]
    default: tuple[float, float]
    tuned: tuple[float, float] | None = None


def noise_and_delay(contender: Contender, runs: Sequence[Run], threads: int = 1) -> tuple[float, float]:
    """Mean delay [ms] and noise [N·m] over runs with pushes (`metrics`); NaN where one is not defined."""

    def one(run: Run) -> tuple[float, float]:
        try:
            estimate = contender.estimate(run).torque
        except FilterDiverged:
            return math.nan, math.nan
        r = run.reference
        lag = metrics.delay(estimate, r.truth, r.dt, r.during) if r.events else None
        return math.nan if lag is None else 1e3 * lag, metrics.noise(estimate, r.truth, r.dt, r.calm)

    with ThreadPoolExecutor(threads) as pool:
        found = np.array(list(pool.map(one, runs)))
    return float(found[:, 0].mean()), float(found[:, 1].mean())


def undominated(points: np.ndarray) -> np.ndarray:
    """Indices, by the first column, of the points (P, k) of which no other is as small in all columns and smaller in one."""
    order = np.lexsort(points.T[::-1])
    kept: list[int] = []
    for i in order:
        if np.all(np.isfinite(points[i])) and not any(
            np.all(points[j] <= points[i]) and np.any(points[j] < points[i]) for j in kept
        ):
            kept.append(int(i))
    return np.array(kept, dtype=int)


def pareto(
    contender: Contender, runs: Sequence[Run], tuned: Contender | None = None, count: int = 96, threads: int = 1
) -> Front:
    """Sweep a filter's knobs and keep the front of noise against delay.

    A third of the settings turn the first knob alone, over all of its range; the rest spread over all knobs (Halton's
    sequence). Filters that simulate the joint get a sixteenth.

    Args:
        contender: with its defaults. runs: with pushes.
        tuned: the same filter after `tune`; its other knobs are then those of the sweep of the first one.
        count: settings; threads: runs at a time.
    """
    knobs, base = contender.knobs, tuned or contender
    count = max(count // 16, 4) if contender.costly else count
    if not knobs:
        choices = [{}]
    elif len(knobs) == 1:
        choices = [{knobs[0].field: knobs[0].from_unit(u)} for u in np.linspace(0, 1, count)]
    else:
        choices = [{knobs[0].field: knobs[0].from_unit(u)} for u in np.linspace(0, 1, max(count // 3, 3))]
        spread = qmc.Halton(len(knobs), scramble=False).random(count - len(choices) + 1)[1:]
        choices += [{k.field: k.from_unit(u) for k, u in zip(knobs, place, strict=True)} for place in spread]
    own = [{k.field: c.value(k) for k in knobs} for c in (contender, *((tuned,) if tuned else ()))]
    all_choices = [*own, *choices]
    found = np.array([noise_and_delay(base.turned(c) if c else base, runs, threads) for c in all_choices])
    kept = undominated(found)
    return Front(
        contender.name, found[kept], tuple({**own[-1], **all_choices[i]} for i in kept),
        _pair(found[0]), _pair(found[1]) if tuned else None,
    )  # fmt: skip


def _pair(point: np.ndarray) -> tuple[float, float]:
    return float(point[0]), float(point[1])


# --- the file ------------------------------------------------------------------------------------------------------


def write_tuned(
    found: Sequence[Tuned], scenarios: Sequence[str], train: Sequence[int], test: Sequence[int], path: Path
):
    """Write `tuned.yaml`: the paper's filters as a scenario's `filters`, the baselines' knobs by name."""
    filters, others = [], {}
    for one in found:
        if one.default.is_paper:
            settings = one.tuned.settings
            numbers = {k: float(f"{getattr(settings, k):.6g}") for k in ("W", "V", "P0", "rho", "k", "gamma")}
            filters.append(FilterChoice(name=one.name, rule=settings.rule, **numbers).model_dump(exclude_none=True))
        elif one.values:
            others[one.name] = {field: float(f"{value:.6g}") for field, value in one.values.items()}
    data: dict[str, Any] = {
        "format": 1,
        "scenarios": list(scenarios),
        "train": [int(s) for s in train],
        "test": [int(s) for s in test],
        "rms": {
            one.name: {
                "train": [round(v, 6) for v in one.train],
                "test": [round(score(rms), 6) for rms in (one.test_default, one.test_tuned)],
            }
            for one in found
        },
        "filters": filters,
        "baselines": others,
    }
    text = "# Found by `flexspline tune`. rms: default, tuned [N·m]. `filters` can be copied into a scenario.\n"
    text += yaml.safe_dump(data, allow_unicode=True, sort_keys=False, width=120)
    with write_into_place(path) as temporary:
        temporary.write_text(text, encoding="utf-8")
