"""Scenarios that are too long to be held in memory: simulated, estimated and written stretch after stretch.

A stretch is a run that begins later. Its signals and estimates are to the bit those of the whole, and so are the measures,
which are taken from the tables (`evaluation.streamed`). For figures and the viewer stands a run with some of the samples:
those at which what is drawn is lowest or highest in a bin of the time.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import fields, replace
from functools import partial
from operator import attrgetter
from pathlib import Path
from typing import Any

import numpy as np

from ..estimator import registry
from ..estimator.estimator import CausalEstimator, Estimator, Posterior
from ..estimator.online import PassingEstimate, PassingSamples
from ..models import own_sensors
from ..models.errors import InputError
from ..models.joint import AnalogSpec
from ..models.signals import CHANNELS, SENSED
from ..models.streams import PairwiseSum, parts
from ..models.tables import ROWS, TableParts
from ..sim.loop import CONTROL_PERIOD, ClosedLoop
from ..sim.sensors import NoiseCourse
from . import course
from .course import Course, Stamps
from .evaluation.streamed import StreamedReference, first_after
from .experiment import LONGEST_HELD, Experiment
from .run import BeyondCount, Run, Thinned, at_limit, notes_of
from .run_folder import View, save_stretches
from .scenario import Scenario

LONG = ROWS
"""Samples from which on a run is written in stretches where it can be: up to there its tables are the same file either way."""
STRETCH = 1 << 15
"""Samples of a stretch: with four filters, and all that is made of them on the way, 100 MB."""
BINS = 1500
"""Bins of the time of which each keeps its lowest and highest samples: a pixel's width each in a figure."""
_SIZES = 10.0 ** np.linspace(-9.0, 9.0, 3601)  # N·m: of errors; 1.2 % apart


def is_long(scenario: Scenario, folder: Path | None = None) -> bool:
    """Whether a scenario is to be run in stretches.

    Raises:
      InputError: one that cannot be run in stretches and is too long to be held.
    """
    if scenario.ticks <= LONG:
        return False
    why = _held_for(scenario, folder)
    if why and scenario.duration > LONGEST_HELD:
        raise InputError(
            f"scenario {scenario.name}: duration: expected at most {LONGEST_HELD:g} s with {why}, for which all of it is held in "
            f"memory, got {scenario.duration:g} s"
        )
    return not why


def _held_for(scenario: Scenario, folder: Path | None) -> str:
    """What of a scenario needs all of it at once; empty where nothing does."""
    joint, _ = scenario.load_joint(folder)
    for name in SENSED:
        spec = joint.sensors.of(CHANNELS[name])
        if isinstance(spec, AnalogSpec) and spec.flicker > 0.0:
            return f"flicker noise of {name}"
    ahead = [name for name, one in scenario.estimators().items() if not _passes(one)]
    if ahead:
        return f"filters that look ahead ({', '.join(ahead)})"
    if own_sensors.names():
        return f"sensors of plugins ({', '.join(own_sensors.names())})"
    return "" if scenario.lever is None else "a wrench by which the force at the link is measured"


def _passes(estimator: Estimator) -> bool:
    return isinstance(estimator, CausalEstimator) and type(estimator).estimate is CausalEstimator.estimate


def run_long(
    scenario: Scenario,
    folder: Path | None,
    out: Path,
    views: Sequence[View] = (),
    within: Path | None = None,
    threads: int = 1,
    block: int = STRETCH,
) -> Run:
    """Run a scenario in stretches and write its folder (`run_folder.save_run`).

    Args:
      scenario: what to run, none that `is_long` refuses; folder: of its file.
      out: the run's folder; views: what else is to be in it; within: a folder that `out` must not lead out of.
      threads: filters at a time; the result does not depend on it.
      block: samples of a stretch.

    Returns:
      The run, thinned, with the measures of all of it.

    Raises:
      InputError, FilterDiverged: as `run.run_scenario` and `save_run`.
    """
    acting = Course(scenario).next(min(block, scenario.ticks))
    experiment = Experiment.of(scenario, folder, acting=acting)
    summary = _Summary(experiment)
    stretches = map(summary.take, _stretches(experiment, block, threads))
    return save_stretches(scenario, stretches, lambda made: summary.whole(made, threads), out, views, within)


def _stretches(experiment: Experiment, block: int, threads: int) -> Iterator[Run]:
    """A run, stretch after stretch."""
    scenario, known = experiment.scenario, experiment.known
    acts, stamps = Course(scenario), Stamps(scenario)
    noise = NoiseCourse(experiment.joint, scenario.seed, CONTROL_PERIOD)
    interval, samples = course.interval(scenario), PassingSamples(known)
    model = registry.get("model")
    assert isinstance(model, CausalEstimator)
    filters = {name: one for name, one in scenario.estimators().items() if isinstance(one, CausalEstimator)}
    along = [PassingEstimate(one, known, interval) for one in (model, *filters.values())]
    loop: ClosedLoop | None = None
    with ThreadPoolExecutor(threads, thread_name_prefix="estimate") as pool:
        for part in parts(scenario.ticks, block):
            n = part.stop - part.start
            given = acts.next(n)
            driven = replace(experiment, **given._asdict()).driven(noise=noise.next(n), stamps=stamps.next(n))
            if loop is None:
                loop = ClosedLoop(experiment.build(), (driven,))
            else:
                loop.go_on_with((driven,))
            loop.advance(n)
            experiment.check(loop, before=part.start)
            stretch = Run(scenario, experiment.joint, experiment.known_joint, known, loop.simulation, {})
            samples.take(stretch.signals)
            raw, *found = pool.map(lambda one: one.advance(samples), along)
            stretch = replace(stretch, estimates=dict(zip(filters, found, strict=True)))
            vars(stretch).update(
                position_command=given.position, external_torque=given.external_torque, model_torque=raw.mean
            )
            yield stretch


class _Summary:
    """What is kept of a run's stretches: counts and sums for the measures, and the samples that are drawn."""

    def __init__(self, experiment: Experiment):
        scenario, self._experiment = experiment.scenario, experiment
        self._n, self._done = scenario.ticks, 0
        self._first = first_after(scenario.transient, self._n, CONTROL_PERIOD)
        self._kept = self._n - self._first
        self._width = -(-self._n // BINS)
        self._limit = experiment.joint.numbers["current_limit"].value
        self._beyond = BeyondCount((experiment.joint, experiment.known_joint))
        self._limited, self._off = 0, 0.0
        self._missing, self._robust_count = Counter[str](), Counter[str]()
        self._following, self._nis = PairwiseSum(self._kept), dict[str, PairwiseSum]()
        self._low, self._high = np.inf, -np.inf
        self._robust: dict[str, np.ndarray] = {}
        self._sizes: dict[str, np.ndarray] = {}
        self._samples: list[Run] = []

    def take(self, stretch: Run) -> Run:
        """Take up the next stretch, and give it on."""
        ticks = np.arange(self._done, self._done + len(stretch.time))
        kept = ticks >= self._first
        truth, off = stretch.truth("joint_torque"), stretch.position_command - stretch.truth("link_position")
        self._beyond.add(stretch)
        self._limited += int(np.count_nonzero(at_limit(stretch.simulation.command, self._limit)))
        self._off = float(np.maximum(self._off, np.max(np.abs(off))))
        self._following.add(off[kept] ** 2)
        if kept.any():
            self._low, self._high = min(self._low, truth[kept].min()), max(self._high, truth[kept].max())
        for name, found in stretch.estimates.items():
            self._missing[name] += int(np.sum(~np.isfinite(found.mean)))
            nis = found.nis
            if nis is not None:
                self._nis.setdefault(name, PairwiseSum(self._kept)).add(nis[kept])
            if found.robust is not None:
                self._robust_count[name] += int(np.count_nonzero(found.robust[kept]))
                each = self._robust.setdefault(name, np.zeros(-(-self._n // self._width)))
                each += np.bincount(ticks // self._width, found.robust, len(each))
        torques = {name: found.mean for name, found in stretch.estimates.items()}
        for name, torque in {"raw model": stretch.model_torque, **torques}.items():
            each = self._sizes.setdefault(name, np.zeros(len(_SIZES) + 1))
            each += np.bincount(np.searchsorted(_SIZES, np.abs(torque - truth)[kept]), minlength=len(each))
        self._samples.append(_picked(stretch, self._shown(stretch)))
        self._done += len(stretch.time)
        return stretch

    def _shown(self, stretch: Run) -> np.ndarray:
        """Indices of the samples of a stretch that are drawn."""
        n = len(stretch.time)
        chosen = np.zeros(n, dtype=bool)
        chosen[0] |= self._done == 0
        chosen[-1] |= self._done + n == self._n
        # Cells of a bin each; the first and the last may be parts of one.
        ahead = self._done % self._width
        cells = -(-(ahead + n) // self._width)
        grid = np.full(cells * self._width, np.nan)
        for values in _drawn(stretch):
            grid[ahead : ahead + n] = values
            table = grid.reshape(cells, self._width)
            there = np.isfinite(table)
            for place in (
                np.where(there, table, np.inf).argmin(axis=1),
                np.where(there, table, -np.inf).argmax(axis=1),
            ):
                at = np.arange(cells) * self._width + place - ahead
                chosen[at[(at >= 0) & (at < n)]] = True
        return np.flatnonzero(chosen)

    def whole(self, folder: Path, threads: int) -> Run:
        """The run of the samples that are drawn, with the measures of all, whose tables are in the folder."""
        scenario = self._experiment.scenario
        start = np.arange(0, self._n, self._width)
        width = np.diff(np.append(start, self._n))
        thinned = Thinned(
            start * CONTROL_PERIOD,
            {name: count / width for name, count in self._robust.items()},
            _SIZES,
            {name: np.cumsum(count) for name, count in self._sizes.items()},
        )
        run = _joined(self._samples, thinned)
        shown = vars(run)  # where its cached properties keep what the whole has
        shown.update(beyond=self._beyond.shares, tip_force=None)
        shown["notes"] = notes_of(run, self._n, self._limited, self._off, self._missing)
        signals, estimates = (TableParts(folder / f"{name}.parquet") for name in ("signals", "estimates"))
        reading = partial(signals.column, "joint_torque")
        reference = StreamedReference(
            partial(signals.column, "true_joint_torque"), reading, partial(signals.column, "model_torque"),
            partial(signals.column, "external_torque"), self._n, CONTROL_PERIOD, scenario.transient,
        )  # fmt: skip
        reference.prepare()
        columns = {name: partial(estimates.column, f"torque_{name}") for name in run.estimates}
        with ThreadPoolExecutor(threads, thread_name_prefix="measure") as pool:
            model, sensor, *found = pool.map(reference.evaluate, (reference.raw, reading, *columns.values()))
        filters = {
            name: {
                **measures,
                "robust_share": self._robust_count[name] / self._kept if name in self._robust else None,
                "mean_nis": self._nis[name].value / self._kept if name in self._nis else None,
            }
            for name, measures in zip(columns, found, strict=True)
        }
        following = float(np.sqrt(self._following.value / self._kept))
        shown["metrics"] = {
            "scenario": scenario.name,
            "seed": scenario.seed,
            "filters": filters,
            "model": model,
            "sensor": sensor,
            "notes": list(run.notes),
            "truth": {"joint_torque_range": [float(self._low), float(self._high)]},
            "position_error": {"rms": following, "max": self._off, "unit": "rad"},
            "tip_force": None,
        }
        return run


def _drawn(run: Run) -> Iterator[np.ndarray]:
    """What figures and the viewer draw of a run, shape (n,) each."""
    truth, reading = run.truth("joint_torque"), run.reading("joint_torque")
    rotor, wave, link = (run.truth(f"{name}_position") for name in ("motor", "wave_generator", "link"))
    ratio = run.joint.numbers["N"].value
    yield from (run.position_command, link, run.position_command - link, rotor / ratio - link, rotor - wave)
    yield from (run.reading("motor_current"), run.truth("motor_current"), run.external_torque)
    yield from (truth, reading, run.model_torque, run.model_torque - truth)
    for found in run.estimates.values():
        yield from (found.mean, found.mean - truth, found.mean - reading)
        if found.innovation is not None and found.innovation_covariance is not None and found.innovation.shape[1] == 1:
            yield from (found.innovation[:, 0], found.innovation_covariance[:, 0, 0])


def _picked(run: Run, at: np.ndarray) -> Run:
    """Some of a run's samples."""
    return _mapped([run], lambda arrays: arrays[0][at])


def _joined(runs: Sequence[Run], thinned: Thinned) -> Run:
    """Samples of stretches as one run."""
    return _mapped(runs, np.concatenate, thinned)


def _mapped(
    runs: Sequence[Run], of: Callable[[Sequence[np.ndarray]], np.ndarray], thinned: Thinned | None = None
) -> Run:
    """A run whose arrays are each made of those of runs."""
    like, simulations = runs[0], [run.simulation for run in runs]

    def each(get: Callable[[Any], np.ndarray | None], things: Sequence[Any]) -> Any:
        found = [get(thing) for thing in things]
        return None if found[0] is None else of([values for values in found if values is not None])

    def posterior(name: str) -> Posterior:
        found = [run.estimates[name] for run in runs]
        one = {
            field.name: each(attrgetter(field.name), found)
            for field in fields(Posterior)
            if field.name not in _NOT_ARRAYS
        }
        columns = {column: of([p.columns[column] for p in found]) for column in found[0].columns}
        return Posterior(estimator=found[0].estimator, columns=columns, **one)

    arrays = {name: each(attrgetter(name), simulations) for name in ("time", "truth", "readings", "command", "stamps")}
    simulation = replace(simulations[0], **arrays, failed=(len(arrays["time"]), 0))
    run = replace(
        like, simulation=simulation, estimates={name: posterior(name) for name in like.estimates}, thinned=thinned
    )
    vars(run).update(
        {name: each(attrgetter(name), runs) for name in ("position_command", "external_torque", "model_torque")}
    )
    return run


_NOT_ARRAYS = ("estimator", "columns")
