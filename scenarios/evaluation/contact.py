"""Collision detection on each estimator's external torque: false alarms, delay, and the smallest push found.

A detector is a threshold on |external torque|. One half of the runs without contact gives the thresholds, the other half the
false alarms per hour. Runs with drawn pushes give the share that is found, and the delay. Every run is a draw (`draws`):
another joint within tolerance, another start and pace, other noise, and another lag of the drive with `sensors: realistic`.
The joint's error is constant within a run, so that intervals are bootstrapped over runs.

* **False alarms**: seconds in which the threshold is exceeded, per hour without contact.
* **Found**: the threshold is exceeded between a push's onset and 0.1 s after its end, and not in the half second before.
* **Delay**: from the onset, at which the torque is zero, to the alarm.
* **Smallest push**: the size of which 90 % are found, by logistic regression over the log size.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from scipy.special import expit

from ...estimator.estimator import Estimator
from ...estimator.external import external_torque
from ...models.errors import FilterDiverged, InputError
from ...models.notebook import shortened
from ...sim.loop import CONTROL_PERIOD
from ...sim.sensors import stream
from ..experiment import Experiment
from ..run import Run, run_of
from ..scenario import Disturbance, Scenario
from .draws import drawn_record, known_within, varied
from .metrics import finite

SENSOR = "torque sensor"  # name of the torque sensor's reading among the estimators
SIZES = (0.05, 8.0)  # smallest and largest drawn push [N·m], log-uniform, either sign
DURATIONS = (0.1, 0.5)  # shortest and longest drawn push [s], a half sine, log-uniform
BY_LINK = ", by the link"
"""Suffix for the link's observer with an estimator's joint torque, if the estimator has its own external torque."""
DEFAULT = ("augmented", "momentum", "momentum_torsion", "current", "RAREKF", "AREKF", "EKF", "model")
"""Estimators by default: fast ones, a few of each kind."""
LARGE = 2.0  # smallest push for the delay [N·m]
SHARE = 0.9  # share of pushes found at the smallest size
_PERIOD = 5.0  # s: a push in each
_SECOND = 1.0  # s: alarms within it count as one
_AFTER = 0.1  # s after a push, in which it may still be found
_BEFORE = 0.5  # s before a push, without alarm
_RIDGE = 0.002  # of the logistic slope: keeps it finite if found and missed sizes do not overlap


@dataclass(frozen=True)
class Detector:
    """An estimator's external torque without and with contact."""

    name: str  # of the estimator
    # shape (runs, seconds), largest |external torque| [N·m] in each second without contact; infinite after it diverged
    quiet: np.ndarray
    size: np.ndarray  # shape (runs, pushes), |torque| of pushes at their largest [N·m]
    before: np.ndarray  # shape (runs, pushes), largest |external torque| in the half second before
    # shape (runs, pushes, ticks), largest |external torque| since the onset, until 0.1 s after the push
    rising: np.ndarray
    # reasons of the runs without contact in which its estimate is not to be trusted (`estimator.trust`)
    untrusted: tuple[str, ...] = ()

    @property
    def hours(self) -> float:
        """Time without contact [h] for counting false alarms."""
        return self._counted.size * _SECOND / 3600.0

    @property
    def _counted(self) -> np.ndarray:
        return self.quiet[1::2]

    @property
    def diverged(self) -> int:
        """Number of runs without contact in which the estimate diverged."""
        return int(np.count_nonzero(np.isinf(self.quiet).any(axis=1)))

    def threshold(self, rate: float) -> float:
        """Return the threshold [N·m] that is exceeded in `rate` seconds per hour without contact; NaN if the time is too short,
        infinite if the estimate diverged for longer."""
        seconds = np.sort(self.quiet[::2].reshape(-1))[::-1]
        exceeded = _exceeded(rate, len(seconds))
        return float(seconds[round(exceeded)]) if 1.0 <= exceeded < len(seconds) - 0.5 else math.nan

    def thresholds(self) -> np.ndarray:
        """Return thresholds for curves, shape (≤ 40,): from an alarm every other second to a single alarm."""
        seconds = np.sort(self.quiet[::2].reshape(-1))
        above = np.unique(np.round(np.geomspace(1, len(seconds) // 2, 40)).astype(int))
        return np.unique(seconds[len(seconds) - above][np.isfinite(seconds[len(seconds) - above])])

    def alarms(self, threshold: float) -> np.ndarray:
        """Return the false alarms per hour of each run for counting, shape (runs/2,)."""
        return 3600.0 / _SECOND * np.mean(self._counted > threshold, axis=1)

    def found(self, threshold: float) -> np.ndarray:
        """Return which pushes are found, shape (runs, pushes), bool."""
        return (self.rising[:, :, -1] > threshold) & ~(self.before > threshold)

    def delays(self, threshold: float) -> np.ndarray:
        """Return the delay of every push [s], shape (runs, pushes); NaN if it is not found."""
        late = np.argmax(self.rising > threshold, axis=2) * CONTROL_PERIOD
        return np.where(self.found(threshold), late, np.nan)


MEASURES = ("false_alarms_per_hour", "smallest_push", "found_of_large", "delay")
"""Measures of a detector at a threshold: per hour, [N·m], [1], [s]."""


def at(detector: Detector, threshold: float, resamples: int = 200, seed: int = 0) -> dict[str, Any]:
    """Evaluate a detector at a threshold [N·m]: `estimator`, `threshold`, `MEASURES`, each with the ends `_low` and
    `_high` of its 95 % interval (bootstrap over runs; none without `resamples`), and `reason`, which is empty if
    nothing is missing. Undefined numbers are None; a smallest push of None at a threshold means that no size is found.
    """
    mean, ends = [math.nan] * 4, np.full((2, 4), math.nan)
    if math.isfinite(threshold):
        alarms, found, delays = detector.alarms(threshold), detector.found(threshold), detector.delays(threshold)
        large = detector.size >= LARGE
        rng = np.random.default_rng(seed)

        def measures(quiet: np.ndarray, pushed: np.ndarray) -> list[float]:
            of_large = large[pushed]
            late = delays[pushed][of_large]
            late = late[np.isfinite(late)]
            return [
                float(np.mean(alarms[quiet])),
                smallest_push(detector.size[pushed].reshape(-1), found[pushed].reshape(-1)),
                float(np.mean(found[pushed][of_large])) if of_large.any() else math.nan,
                float(np.median(late)) if len(late) else math.nan,
            ]

        n, m = len(alarms), len(found)
        mean = measures(np.arange(n), np.arange(m))
        if resamples:
            drawn = [measures(rng.integers(0, n, n), rng.integers(0, m, m)) for _ in range(resamples)]
            ends = np.column_stack([_quantiles(column) for column in np.array(drawn).T])
    row: dict[str, Any] = {"estimator": detector.name, "threshold": finite(threshold)}
    for i, name in enumerate(MEASURES):
        values = (mean[i], *ends[:, i])
        row |= {f"{name}{end}": finite(x) for end, x in zip(("", "_low", "_high"), values, strict=True)}
    return row | {"reason": _reason(detector, threshold, mean[1])}


def _reason(detector: Detector, threshold: float, smallest: float) -> str:
    """Reason for a missing threshold or smallest push, a diverged or an untrusted estimate."""
    of = f"of {len(detector.quiet)} runs without contact"
    reasons = [f"its estimate diverged in {detector.diverged} {of}"] if detector.diverged else []
    if detector.untrusted:
        count = len(detector.untrusted)
        reasons.append(
            f"its estimate is not to be trusted in {count} {of}, in the first of them: {detector.untrusted[0]}"
        )
    if not math.isfinite(threshold):
        reasons.append("no threshold has so few false alarms")
    elif math.isinf(smallest):
        reasons.append(f"it finds fewer than {100 * SHARE:.0f} % of the pushes of any size")
    return "; ".join(reasons)


def ranked(detectors: Iterable[Detector], rate: float, tolerance: float) -> list[dict[str, Any]]:
    """Evaluate detectors at `rate` false alarms per hour, the smallest push first; rows of `at` with the tolerance."""
    rows = [{"tolerance": tolerance} | at(one, one.threshold(rate)) for one in detectors]
    return sorted(rows, key=lambda row: math.inf if row["smallest_push"] is None else row["smallest_push"])


def curve(detector: Detector, tolerance: float) -> Iterator[dict[str, Any]]:
    """Yield a row per threshold with the measures of `at`, without intervals; delay in ms."""
    for threshold in detector.thresholds():
        point = at(detector, float(threshold), resamples=0)
        delay = point["delay"]
        values = {"threshold": point["threshold"]} | {name: point[name] for name in MEASURES[:3]}
        values["delay_ms"] = None if delay is None else 1e3 * delay
        rounded = {name: None if x is None else float(f"{x:.4g}") for name, x in values.items()}
        runs = {"hours": detector.hours, "runs": len(detector.quiet)}
        yield {"tolerance": tolerance, "estimator": detector.name} | rounded | runs


def _quantiles(values: np.ndarray) -> np.ndarray:
    """Return the 2.5 and 97.5 % quantiles of values, without NaN."""
    values = np.sort(values[~np.isnan(values)])
    if not len(values):
        return np.full(2, np.nan)
    return values[np.round(np.array([0.025, 0.975]) * (len(values) - 1)).astype(int)]


def smallest_push(size: np.ndarray, found: np.ndarray) -> float:
    """Return the size [N·m] of which `SHARE` are found, `found` of `size`, shape (n,) each: logistic regression,
    P(found) = 1/(1 + exp(−(a + b ln size))). Infinite if it is more than twice the largest, or if larger pushes are not
    found more often."""
    if not found.any():
        return math.inf
    X = np.column_stack([np.ones(len(size)), np.log(size)])
    ridge = np.diag([1e-6, _RIDGE])
    beta = np.zeros(2)
    for _ in range(60):
        p = expit(X @ beta)
        gradient = X.T @ (found - p) - ridge @ beta
        step = np.linalg.solve((X * (p * (1.0 - p))[:, None]).T @ X + ridge, gradient)
        beta = beta + step * min(1.0, 2.0 / max(float(np.max(np.abs(step))), 1e-12))
        if float(np.max(np.abs(step))) < 1e-8:
            break
    if beta[1] <= 0.0:
        return math.inf
    logarithm = (math.log(SHARE / (1.0 - SHARE)) - beta[0]) / beta[1]
    return math.exp(logarithm) if logarithm <= math.log(2.0 * float(np.max(size))) else math.inf


def pushes(scenario: Scenario, seed: int) -> list[Disturbance]:
    """Draw pushes, one in every five seconds after the transient: onset, duration, size and sign."""
    rng = stream(seed, f"contact {scenario.name}")
    found = []
    for begin in np.arange(scenario.transient + 1.0, scenario.duration - _PERIOD, _PERIOD):
        duration = float(np.exp(rng.uniform(*np.log(DURATIONS))))
        torque = float(np.exp(rng.uniform(*np.log(SIZES))) * rng.choice((-1.0, 1.0)))
        start = float(round(begin + rng.uniform(_BEFORE, _PERIOD - _BEFORE - duration - _AFTER), 3))
        found.append(Disturbance(kind="push", start=start, duration=duration, torque=torque))
    return found


@dataclass(frozen=True)
class ContactStudy:
    """Collision detectors on the external torque of estimators, at the same number of false alarms.

    Attributes:
        scenario, joint: their names.
        rate: false alarms per hour at which detectors are compared.
        hours: without contact, as asked; `hours_counted`: for counting false alarms [h]; `runs`: without contact.
        detectors: rows of `at` with the tolerance, by tolerance, the smallest push first.
        curves: rows of `curve`: false alarms against smallest push and delay.
    """

    scenario: str
    joint: str
    rate: float
    hours: float
    hours_counted: float
    runs: int
    detectors: tuple[dict[str, Any], ...]
    curves: tuple[dict[str, Any], ...]

    def __repr__(self) -> str:
        def best(row: Mapping[str, Any]) -> str:
            push = "no push found" if row["smallest_push"] is None else f"{row['smallest_push']:.3g} N·m"
            return f"  tolerance ×{row['tolerance']:g}, {row['estimator']}: {push}"

        head = f"ContactStudy({self.scenario!r} of {self.joint}, {self.rate:g} false alarms per hour; smallest push:"
        return shortened(head, [best(row) for row in self.detectors])

    def to_json(self) -> dict[str, Any]:
        """Return plain data without the curves."""
        names = ("scenario", "joint", "rate", "hours", "hours_counted", "runs")
        return {name: getattr(self, name) for name in names} | {"detectors": list(self.detectors)}


def study(
    scenario: Scenario,
    folder: Path | None,
    estimators: Mapping[str, Estimator],
    hours: float = 1.0,
    tolerances: Sequence[float] = (0.0, 1.0),
    rate: float = 10.0,
    threads: int = 1,
    progress: Callable[[float], None] = lambda tolerance: None,
) -> ContactStudy:
    """Compare detectors at `rate` false alarms per hour, for several shares of the joint's tolerances; the rest as of
    `assess`. `progress`: called with the share after each pair of runs. Raises `InputError`: as `check`."""
    check(scenario, estimators, hours, rate, tolerances)
    detectors, curves, found = [], [], []
    for share in tolerances:
        found = assess(scenario, folder, estimators, hours, share, threads, partial(progress, share))
        detectors += ranked(found, rate, share)
        curves += [row for one in found for row in curve(one, share)]
    return ContactStudy(
        scenario.name, scenario.load_joint(folder)[0].name, rate, hours, found[0].hours, len(found[0].quiet),
        tuple(detectors), tuple(curves),
    )  # fmt: skip


def check(
    scenario: Scenario,
    estimators: Mapping[str, Estimator],
    hours: float,
    rate: float | None = None,
    tolerances: Sequence[float] = (1.0,),
) -> None:
    """Check the arguments of `study`. Raises `InputError`: a share that is negative or occurs twice, an estimator that
    looks ahead, torque feedback, or too little time."""
    shares = list(tolerances)
    if not shares or len(set(shares)) < len(shares) or not all(0 <= share <= 100 for share in shares):
        raise InputError(f"tolerance: expected shares from 0 to 100, each once, got {shares}")
    for name, estimator in estimators.items():
        if not estimator.causal:
            raise InputError(f"contact: {name}: expected a causal estimator, got one that looks ahead")
    if scenario.feedback != "none":
        raise InputError(f"contact: scenario {scenario.name}: feedback: expected none, got {scenario.feedback!r}")
    if len(pushes(scenario, 1)) == 0:
        raise InputError(
            f"contact: scenario {scenario.name}: duration: expected room for a push, got {scenario.duration:g} s"
        )
    if rate is not None and _exceeded(rate, runs_of(scenario, hours) // 2 * _seconds_of(scenario)) < 1.0:
        raise InputError(
            f"hours: expected at least {2 / rate:.2g} for thresholds of {rate:g} false alarms per hour, got {hours:g}"
        )


def runs_of(scenario: Scenario, hours: float) -> int:
    """Return the number of runs without contact of `assess`: even, four at least."""
    return max(2 * math.ceil(hours * 1800.0 / _seconds_of(scenario)), 4)


def _seconds_of(scenario: Scenario) -> int:
    return max(math.floor((scenario.duration - scenario.transient) / _SECOND + 1e-9), 1)


def _exceeded(rate: float, seconds: int) -> float:
    """Return the number of seconds without contact that exceed a threshold of that rate."""
    return rate * seconds * _SECOND / 3600.0


def assess(
    scenario: Scenario,
    folder: Path | None,
    estimators: Mapping[str, Estimator],
    hours: float = 1.0,
    tolerance: float = 1.0,
    threads: int = 1,
    progress: Callable[[], None] = lambda: None,
) -> list[Detector]:
    """Draw runs without contact for so many hours, and as many with pushes; return a detector for every external torque
    of causal estimators and of the torque sensor. The disturbances of the scenario are not used.

    The draws are within `tolerance` times the joint's tolerances. The estimators know the nominal numbers, their
    tolerances and the link encoder's zero. The result does not depend on `threads`. `progress`: called after each pair
    of runs. Raises `InputError`: as `check`.
    """
    check(scenario, estimators, hours)
    scenario = scenario.model_copy(update={"disturbances": []})
    every: dict[str, Estimator | None] = {SENSOR: None, **estimators}

    def one(index: int) -> dict[str, tuple[bool, str | None, list[list[np.ndarray]]]]:
        quiet = _simulated(scenario, folder, 2 * index + 1, tolerance, [])
        chosen = pushes(scenario, 2 * index + 2)
        touched = _simulated(scenario, folder, 2 * index + 2, tolerance, chosen)
        found = {}
        for name, each in every.items():
            (silent, why), (heard, _) = _heard(each, quiet), _heard(each, touched)
            rows = [[_seconds(silent[i], scenario), *_around(heard[i], chosen)] for i in (0, -1)]
            found[name] = len(silent) + len(heard) > 2, why, rows
        progress()
        return found

    with ThreadPoolExecutor(threads, thread_name_prefix="contact") as pool:
        done = list(pool.map(one, range(runs_of(scenario, hours))))
    detectors = []
    for name in every:
        own, why, rows = zip(*(d[name] for d in done), strict=True)
        untrusted = tuple(reason for reason in why if reason is not None)
        for i, label in enumerate((name, f"{name}{BY_LINK}") if any(own) else (name,)):
            silent, size, before, rising = (np.array(column) for column in zip(*(row[i] for row in rows), strict=True))
            detectors.append(Detector(label, silent, size, before, rising, untrusted))
    return detectors


def _simulated(
    scenario: Scenario, folder: Path | None, seed: int, tolerance: float, pushed: Sequence[Disturbance]
) -> Run:
    chosen = varied(scenario, seed).model_copy(update={"disturbances": list(pushed)})
    experiment = Experiment.of(chosen, folder)
    record, known = drawn_record(experiment, seed, tolerance, True), known_within(experiment.known, tolerance, True)
    experiment = replace(experiment, record=record, known=known)
    return run_of(experiment, experiment.simulate())


def _heard(estimator: Estimator | None, run: Run) -> tuple[list[np.ndarray], str | None]:
    """Return |external torque| [N·m], shape (n,), and the reason if the estimate is not to be trusted: an estimator's
    own, if it has one, and that of the link's observer with its joint torque, infinite if it diverged. Without an
    estimator, the joint torque is the torque sensor's."""
    signals, known, p = run.signals, run.known, run.known.p
    if estimator is None:
        reading = run.reading("joint_torque")
        torque = (reading - p["torque_offset"] - p["torque_rate"] * known.since(signals.time)) / p["torque_gain"]
        return [np.abs(external_torque(signals, torque, known))], None
    try:
        found = estimator.estimate(signals, known)
    except FilterDiverged:
        return [np.full(len(signals.time), np.inf)], None
    own = [] if found.external is None else [np.abs(found.external)]
    return [*own, np.abs(external_torque(signals, found.mean, known))], found.untrusted


def _seconds(heard: np.ndarray, scenario: Scenario) -> np.ndarray:
    """Return the largest value in each second after the transient."""
    width = round(_SECOND / CONTROL_PERIOD)
    kept = heard[round(scenario.transient / CONTROL_PERIOD) :]
    return kept[: len(kept) // width * width].reshape(-1, width).max(axis=1)


def _around(heard: np.ndarray, pushed: Sequence[Disturbance]) -> Iterator[np.ndarray]:
    """Yield sizes of the pushes, the largest value before each, and the running maximum from its onset."""
    width = round((DURATIONS[1] + _AFTER) / CONTROL_PERIOD)
    before, rising = [], []
    for one in pushed:
        begin = math.ceil(one.start / CONTROL_PERIOD - 1e-6)
        end = min(math.ceil((one.start + one.duration + _AFTER) / CONTROL_PERIOD), begin + width)
        before.append(heard[max(begin - round(_BEFORE / CONTROL_PERIOD), 0) : begin + 1].max())
        rising.append(np.pad(np.maximum.accumulate(heard[begin:end]), (0, width - (end - begin)), mode="edge"))
    yield np.array([abs(one.torque) for one in pushed])
    yield np.array(before)
    yield np.array(rising)
