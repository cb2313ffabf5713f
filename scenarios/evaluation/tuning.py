"""Tuning of estimators on training seeds, and their errors on test seeds.

The plant runs once per scenario and seed, and every trial is an estimator over the stored signals. The cost is the RMS error
after the transient, over several scenarios its geometric mean. The search is Nelder & Mead's in the parameters' scales. It
starts at the best of the defaults and a coarse scan of the first parameter, and restarts where it ended. The best of all
trials is returned, which is never worse than the defaults on training seeds. There is no randomness.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats.qmc import Halton

from ...estimator.estimator import Estimator, value_of, with_values
from ...models.errors import FilterDiverged, InputError
from ...models.files import write_text, yaml_text
from ...models.notebook import shortened
from ..filters import FilterEntry
from ..run import Run, simulate_scenario
from ..scenario import Scenario
from . import metrics
from .draws import of_seed
from .intervals import Interval, interval

EVALUATIONS = 300  # trials of an estimator; a tenth for estimators that simulate the joint
_SCAN = 7  # values of the first parameter before the search
_STEP = 0.08  # of a parameter's range: the first simplex
_FAILED = 1e6  # N·m


@dataclass(frozen=True)
class Tuned:
    """An estimator's tuned parameters, and its errors on training and test seeds."""

    name: str  # of the estimator
    default: Estimator  # before
    tuned: Estimator  # after
    values: dict[str, float]  # tuning parameters, by field
    # RMS error on the training seeds, geometric mean over scenarios [N·m], default and tuned
    train: tuple[float, float]
    evaluations: int  # number of trials
    # test_default, test_tuned: shape (scenarios, seeds), RMS errors on the test seeds [N·m]
    test_default: np.ndarray
    test_tuned: np.ndarray
    at_bound: tuple[str, ...]  # parameters at a bound of their range

    @property
    def default_score(self) -> float:
        """Score of the default's RMS errors on the test seeds [N·m] (`score`)."""
        return score(self.test_default)

    @property
    def tuned_score(self) -> float:
        """Score of the tuned estimator's [N·m]."""
        return score(self.test_tuned)

    @property
    def difference(self) -> Interval:
        """Tuned RMS minus the default's on the same test runs [N·m], paired over seeds; negative if tuning helps."""
        return interval((self.test_tuned - self.test_default).mean(axis=0))


def simulated(
    scenarios: Sequence[tuple[Scenario, Path | None]], seeds: Sequence[int], vary: bool = True
) -> list[list[Run]]:
    """Run every scenario with every seed, without estimates; return a list of runs per scenario. `vary`: whether start,
    pace and pushes are drawn per seed (`draws.varied`); otherwise all seeds have the same motion, and intervals over
    them are wrong. Raises `InputError`: no seeds; a scenario with an estimate fed back (`run.simulate_scenario`)."""
    if not seeds:
        raise InputError("tune: expected at least one seed, got none")
    return [
        [simulate_scenario(of_seed(scenario, seed, vary), folder, seed) for seed in seeds]
        for scenario, folder in scenarios
    ]


def errors(estimator: Estimator, runs: Sequence[Sequence[Run]], threads: int = 1) -> np.ndarray:
    """Return the RMS error [N·m] of each run, shape (scenarios, seeds); a large number if the estimate diverges."""

    def one(run: Run) -> float:
        try:
            error = estimator.estimate(run.signals, run.known).mean - run.truth("joint_torque")
        except FilterDiverged:
            return _FAILED
        return float(np.sqrt(np.mean(error[run.time >= run.scenario.transient] ** 2)))

    with ThreadPoolExecutor(threads) as pool:
        found = list(pool.map(one, [run for several in runs for run in several]))
    return np.nan_to_num(np.array(found), nan=_FAILED, posinf=_FAILED).reshape(len(runs), -1)


def score(rms: np.ndarray) -> float:
    """Return one number for RMS errors (scenarios, seeds): root mean square over seeds, geometric mean over scenarios."""
    return float(np.exp(np.mean(np.log(np.sqrt(np.mean(rms**2, axis=1))))))


def with_parameters(estimator: Estimator, values: Mapping[str, float]) -> Estimator:
    """Return an estimator with other tuning parameters; P0 = V for the paper's, as X̂(0) is the measurement."""
    return with_values(estimator, _completed(estimator, values))


def _completed(estimator: Estimator, values: Mapping[str, float]) -> dict[str, float]:
    return {"P0": values["V"], **values} if "V" in values and hasattr(estimator, "P0") else dict(values)


def tune(
    estimator: Estimator,
    train: Sequence[Sequence[Run]],
    test: Sequence[Sequence[Run]],
    evaluations: int = EVALUATIONS,
    threads: int = 1,
) -> Tuned:
    """Tune an estimator on training runs, from its defaults, and evaluate it on test runs (`simulated`); without tuning
    parameters it is only evaluated. `evaluations`: about the number of trials, a tenth for estimators that simulate the
    joint; the result does not depend on `threads`."""
    tuning = estimator.tuning
    budget = max(evaluations // 10, 2 * len(tuning) + 2) if estimator.costly else evaluations
    tried: dict[tuple[float, ...], float] = {}

    def values_at(place: Sequence[float]) -> dict[str, float]:
        return {t.field: t.from_unit(u) for t, u in zip(tuning, place, strict=True)}

    def cost(given: np.ndarray) -> float:
        place = tuple(float(min(max(u, 0.0), 1.0)) for u in given)
        if place not in tried:
            changed = with_parameters(estimator, values_at(place))
            tried[place] = math.log(score(errors(changed, train, threads)))
        return tried[place]

    before = score(errors(estimator, train, threads))
    best, least = estimator, before
    values = {t.field: float(value_of(estimator, t.field)) for t in tuning}
    at_bound: tuple[str, ...] = ()
    if tuning:
        start = np.array([t.to_unit(values[t.field]) for t in tuning])
        cost(start)
        if not estimator.costly:
            for u in np.linspace(0.0, 1.0, _SCAN):
                cost(np.r_[u, start[1:]])
        _search(cost, tried, len(tuning), budget)
        place = min(tried, key=lambda at: tried[at])
        if math.exp(tried[place]) < before:
            values = values_at(place)
            best, least = with_parameters(estimator, values), math.exp(tried[place])
            at_bound = tuple(t.field for t, u in zip(tuning, place, strict=True) if u < 1e-3 or u > 1 - 1e-3)
    return Tuned(
        estimator.name, estimator, best, values, (before, least), len(tried) + 1,
        errors(estimator, test, threads), errors(best, test, threads), at_bound,
    )  # fmt: skip


def _search(
    cost: Callable[[np.ndarray], float], tried: Mapping[tuple[float, ...], float], dimensions: int, budget: int
) -> None:
    """Run Nelder & Mead in the unit cube from the best trial, and again until there is no gain."""
    from scipy.optimize import minimize

    gained = True
    while gained and len(tried) < budget:  # the simplex may collapse early
        lowest = min(tried.values())
        origin = np.array(min(tried, key=lambda at: tried[at]))
        simplex = np.tile(origin, (dimensions + 1, 1))
        for i in range(dimensions):
            simplex[i + 1, i] += _STEP if origin[i] + _STEP <= 1.0 else -_STEP
        minimize(
            cost, origin, method="Nelder-Mead", bounds=[(0.0, 1.0)] * dimensions,
            options={"initial_simplex": simplex, "maxfev": budget - len(tried), "xatol": 1e-3, "fatol": 1e-5},
        )  # fmt: skip
        gained = min(tried.values()) < lowest - 1e-3


# --- noise against delay -------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Front:
    """Settings of an estimator that no other setting beats in both noise and delay."""

    name: str  # of the estimator
    points: np.ndarray  # shape (P, 2), delay to a push [ms], noise in steady state [N·m]; by delay
    settings: tuple[dict[str, float], ...]  # the tuning parameters of each point
    # default, tuned: delay and noise of the defaults, and of the tuned estimator, if any
    default: tuple[float, float]
    tuned: tuple[float, float] | None = None


def noise_and_delay(estimator: Estimator, runs: Sequence[Run], threads: int = 1) -> tuple[float, float]:
    """Return mean delay [ms] and noise [N·m] over runs with pushes (`metrics`); NaN if not defined."""

    def one(run: Run) -> tuple[float, float]:
        try:
            estimate = estimator.estimate(run.signals, run.known).mean
        except FilterDiverged:
            return math.nan, math.nan
        r = run.reference
        lag = metrics.delay(estimate, r.truth, r.dt, r.during) if r.events else None
        return math.nan if lag is None else 1e3 * lag, metrics.noise(estimate, r.truth, r.dt, r.calm)

    with ThreadPoolExecutor(threads) as pool:
        found = np.array(list(pool.map(one, runs)))
    return float(found[:, 0].mean()), float(found[:, 1].mean())


def undominated(points: np.ndarray) -> np.ndarray:
    """Return the indices of points (P, k) that no other point dominates, sorted by the first column."""
    order = np.lexsort(points.T[::-1])
    kept: list[int] = []
    for i in order:
        if np.all(np.isfinite(points[i])) and not any(
            np.all(points[j] <= points[i]) and np.any(points[j] < points[i]) for j in kept
        ):
            kept.append(int(i))
    return np.array(kept, dtype=int)


def pareto(
    estimator: Estimator, runs: Sequence[Run], tuned: Estimator | None = None, count: int = 96, threads: int = 1
) -> Front:
    """Sweep an estimator's tuning parameters over runs with pushes, and return the front of noise against delay.

    A third of the `count` settings vary the first parameter alone, over its whole range, with the other parameters of
    `tuned`. The rest is a Halton sequence over all parameters. Estimators that simulate the joint get a sixteenth of
    the settings.
    """
    tuning, base = estimator.tuning, tuned or estimator
    count = max(count // 16, 4) if estimator.costly else count
    choices: list[dict[str, float]] = [{}]
    if len(tuning) == 1:
        choices = [{tuning[0].field: tuning[0].from_unit(u)} for u in np.linspace(0, 1, count)]
    elif tuning:
        choices = [{tuning[0].field: tuning[0].from_unit(u)} for u in np.linspace(0, 1, max(count // 3, 3))]
        spread = Halton(len(tuning), scramble=False).random(count - len(choices) + 1)[1:]  # without zero
        choices += [{t.field: t.from_unit(u) for t, u in zip(tuning, place, strict=True)} for place in spread]
    ends = (estimator, tuned) if tuned else (estimator,)
    own = [{t.field: float(value_of(e, t.field)) for t in tuning} for e in ends]
    all_choices = [*own, *choices]
    found = np.array([noise_and_delay(with_parameters(base, c) if c else base, runs, threads) for c in all_choices])
    kept = undominated(found)
    return Front(
        estimator.name, found[kept], tuple({**own[-1], **all_choices[i]} for i in kept),
        tuple(found[0].tolist()), tuple(found[1].tolist()) if tuned else None,
    )  # fmt: skip


# --- several estimators --------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Tuning:
    """Estimators tuned on the same runs.

    Attributes:
        scenarios: names; the tuning is for all of them together.
        train, test: seeds.
        tuned: by name of the estimator.
        fronts: noise against delay, an estimator each; empty without pushes.
        pushed: the scenario of the fronts.
    """

    scenarios: tuple[str, ...]
    train: tuple[int, ...]
    test: tuple[int, ...]
    tuned: dict[str, Tuned]
    fronts: tuple[Front, ...] = ()
    pushed: str = ""

    @property
    def filters(self) -> list[dict[str, Any]]:
        """The tuned estimators as a scenario's `filters`, with six digits."""
        found = []
        for one in self.tuned.values():
            values = {k: float(f"{v:.6g}") for k, v in _completed(one.default, one.values).items()}
            entry = {"name": one.name, "estimator": one.name, **values}
            found.append(FilterEntry.model_validate(entry).model_dump())
        return found

    def __repr__(self) -> str:
        def line(one: Tuned) -> str:
            values = ", ".join(f"{name} {value:.3g}" for name, value in one.values.items()) or "no parameters"
            return f"  {one.name}: {one.default_score:.3g} -> {one.tuned_score:.3g} N·m; {values}"

        head = f"Tuning({', '.join(self.scenarios)}; RMS error on test seeds, default -> tuned:"
        return shortened(head, [line(one) for one in self.tuned.values()])

    def to_json(self) -> dict[str, Any]:
        """Return the content of `tuned.yaml`: estimators as a scenario's `filters`, and their RMS errors [N·m]."""
        rms = {
            one.name: {
                "train": [round(v, 6) for v in one.train],
                "test": [round(score(rms), 6) for rms in (one.test_default, one.test_tuned)],
            }
            for one in self.tuned.values()
        }
        head = {"format": 1, "scenarios": list(self.scenarios), "train": list(self.train), "test": list(self.test)}
        return head | {"rms": rms, "filters": self.filters}

    def write(self, path: Path) -> None:
        """Write `tuned.yaml`."""
        text = "# Found by `flexspline tune`. rms: default, tuned [N·m]. `filters` can be copied into a scenario.\n"
        write_text(path, text + yaml_text(self.to_json()))


def tune_all(
    estimators: Mapping[str, Estimator],
    scenarios: Sequence[tuple[Scenario, Path | None]],
    train: Sequence[int],
    test: Sequence[int],
    evaluations: int = EVALUATIONS,
    vary: bool = True,
    fronts: bool = False,
    threads: int = 1,
    progress: Callable[[int, str], None] = lambda done, name: None,
) -> Tuning:
    """Tune estimators on the training seeds of scenarios, all together, and evaluate them on the test seeds.

    `evaluations`, `threads`: as of `tune`; `vary`: as of `simulated`; `fronts`: whether to sweep noise against delay on
    the test runs of the first scenario with pushes; `progress`: called with the number of tuned estimators and the name
    of the next one. Raises `InputError`: a seed in both; no seeds; a scenario with an estimate fed back.
    """
    check_seeds(train, test)
    train_runs, test_runs = (simulated(scenarios, some, vary) for some in (train, test))
    pushed = next((runs for runs in test_runs if fronts and runs[0].reference.events), None)
    found, swept = {}, []
    for done, (name, estimator) in enumerate(estimators.items()):
        progress(done, name)
        found[name] = tune(estimator, train_runs, test_runs, evaluations, threads)
        if pushed:
            swept.append(pareto(estimator, pushed, found[name].tuned, threads=threads))
    names = tuple(scenario.name for scenario, _ in scenarios)
    return Tuning(
        names, tuple(map(int, train)), tuple(map(int, test)), found, tuple(swept), pushed[0].name if pushed else ""
    )


def check_seeds(train: Sequence[int], test: Sequence[int]) -> None:
    """Refuse a seed that is in both, with `InputError`."""
    both = sorted(set(train) & set(test))
    if both:
        raise InputError(f"test: expected other seeds than those of train, got {both[0]} in both")
