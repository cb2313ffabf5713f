"""Runs of a study into rows of its dataset, on threads or on a cluster.

The closed loop is compiled and releases the interpreter's lock, and so do the estimators and the costly measures: threads
step as many joints side by side as there are cores. Every run is computed alone, from its own streams: rows are the same to
the bit for any number of threads or workers, any chunk size, and any interruption.
"""

from __future__ import annotations

import json
import math
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import FIRST_COMPLETED, ThreadPoolExecutor, wait
from dataclasses import dataclass
from functools import cache
from importlib import metadata
from itertools import islice

import numpy as np
import pyarrow as pa

from ...estimator import FilterDiverged, FilterSettings
from ...estimator.baselines import JointSignals
from ...models.errors import InputError
from ...sim import callbacks
from ..loop import CONTROL_PERIOD, READINGS, TRUTH, Signals
from ..metrics import Reference
from ..offline import sensor_noise
from ..run import STATE_COLUMNS, Experiment
from .dataset import Chunk, Dataset
from .grid import Cell, Plan

_LARGEST_CHUNK = 16
_ROBUST, _NIS = STATE_COLUMNS.index("robust"), STATE_COLUMNS.index("nis")
_building = threading.Lock()


@cache
def versions() -> dict[str, str]:
    """Versions of what the bits of a row depend on."""
    return {name: metadata.version(name) for name in ("flexspline", "mujoco", "numpy", "scipy", "numba")}


@dataclass(frozen=True)
class Outcome:
    """What became of one variant in one run: measures by name, or why there are none."""

    metrics: dict[str, float | None]
    failure: str = ""


def compute(plan: Plan, chunk: Chunk, stop: threading.Event | None = None) -> pa.Table | None:
    """The rows of a chunk: runs of one cell, one after the other. None when asked to stop.

    Raises:
      InputError: a scenario that cannot run.
    """
    cell = plan.cells[chunk.cell]
    with _building:
        callbacks.install()
        experiment = plan.experiment(cell)
        model = experiment.build()
    rows = []
    for run in range(chunk.begin, chunk.end):
        if stop is not None and stop.is_set():
            return None
        seed = plan.study.seed_list[run]
        record = plan.hidden(cell, seed, experiment.record)
        other = model
        if record is not None:
            with _building:
                other = experiment.build(record)
        outcomes = run_one(plan, cell, seed, experiment, record, other)
        head = {"run": run, "seed": seed, "key": plan.key(cell, seed), **cell.columns}
        for variant, outcome in zip(plan.variants, outcomes, strict=True):
            rows.append(head | variant.columns | {"filter": variant.name, "failure": outcome.failure} | outcome.metrics)
    table = pa.Table.from_pylist(rows, schema=schema(plan))
    return table.replace_schema_metadata({"versions": json.dumps(versions(), sort_keys=True)})


def schema(plan: Plan) -> pa.Schema:
    """Columns of the dataset, but for scenario and cell, which its folders name."""
    kinds = {"cause": pa.string()}
    for axis in plan.study.axes:
        text = isinstance(getattr(axis, "values", [0.0])[0], str)
        kinds[axis.name] = pa.string() if text else pa.float64()
    columns = [*plan.cells[0].columns, *(axis.name for axis in plan.study.filter_axes)]
    return pa.schema(
        [("run", pa.int64()), ("seed", pa.int64()), ("key", pa.string())]
        + [(name, kinds[name]) for name in columns]
        + [("filter", pa.string()), ("failure", pa.string())]
        + [(name, pa.float64()) for name in plan.study.metrics]
    )


def run_one(plan: Plan, cell: Cell, seed: int, experiment: Experiment, record, model) -> list[Outcome]:
    """Simulate once; what became of every variant. A filter that diverges leaves the others as they are."""
    variants, failed = plan.variants, {}
    bank = [i for i, v in enumerate(variants) if isinstance(v.settings, FilterSettings)]
    extra = _fed_back(plan, experiment)
    signals = None
    while signals is None:
        settings = [variants[i].settings for i in bank] + extra
        try:
            signals = experiment.run(settings, plan.noise_seed(cell, seed), record, model)
        except FilterDiverged as error:
            which = next((i for i in bank if variants[i].settings.name == error.filter), None)
            if which is None or variants[which].name == experiment.scenario.feedback:
                return [Outcome({}, str(error))] * len(variants)
            failed[which] = Outcome({}, str(error))
            bank.remove(which)
        except InputError as error:
            return [Outcome({}, str(error))] * len(variants)
    return _measured(plan, experiment, signals, bank, failed)


def _fed_back(plan: Plan, experiment: Experiment) -> list[FilterSettings]:
    """The filter that is fed back where the study does not list it."""
    name = experiment.scenario.feedback
    if name in ("none", "sensor", *plan.study.names):
        return []
    return [f.settings() for f in experiment.scenario.filters if f.name == name]


def _measured(plan: Plan, experiment: Experiment, signals: Signals, bank: list[int], failed: dict) -> list[Outcome]:
    truth = np.ascontiguousarray(signals.truth[:, TRUTH.index("joint_torque")])
    reading = {name: np.ascontiguousarray(signals.readings[:, i]) for i, name in enumerate(READINGS[:4])}
    reference = Reference(
        truth, reading["joint_torque"], signals.model_torque, experiment.external_torque, CONTROL_PERIOD,
        experiment.scenario.transient,
    )  # fmt: skip
    seen = JointSignals(
        signals.time, reading["motor_position"], reading["link_position"], reading["motor_current"], signals.command
    )
    noise, outcomes = sensor_noise(experiment.known), []
    for i, variant in enumerate(plan.variants):
        if i in failed:
            outcomes.append(failed[i])
            continue
        found = {}
        if i in bank:
            state = signals.filters[:, bank.index(i)]
            estimate = np.ascontiguousarray(state[:, 0])
            found["robust_share"] = float(np.mean(state[reference.kept, _ROBUST] > 0))
            found["mean_nis"] = float(np.mean(state[reference.kept, _NIS]))
        else:
            try:
                estimate = variant.settings.estimate(seen, experiment.calibration, noise).torque
            except FilterDiverged as error:
                outcomes.append(Outcome({}, str(error)))
                continue
        if not np.isfinite(estimate).all():
            outcomes.append(Outcome({}, f"{variant.label}: the estimate is no longer a finite number"))
            continue
        found |= reference.evaluate(estimate)
        outcomes.append(Outcome({name: found.get(name) for name in plan.study.metrics}))
    return outcomes


def chunk_size(plan: Plan, jobs: int) -> int:
    """Runs per chunk: 16, fewer where that would leave jobs without work."""
    per_job = math.ceil(plan.runs / (4 * jobs))
    return max(1, min(_LARGEST_CHUNK, per_job, len(plan.study.seed_list)))


Done = Iterator[tuple[Chunk, pa.Table]]


def on_threads(plan: Plan, chunks: Iterator[Chunk], jobs: int) -> Done:
    """Chunks with their rows as they finish, on `jobs` threads; few are under way at a time, however many there are."""
    stop = threading.Event()
    with ThreadPoolExecutor(jobs, thread_name_prefix="sweep") as pool:
        pending = {}
        try:
            while True:
                for chunk in islice(chunks, 2 * jobs - len(pending)):
                    pending[pool.submit(compute, plan, chunk, stop)] = chunk
                if not pending:
                    return
                finished, _ = wait(pending, return_when=FIRST_COMPLETED)
                for future in finished:
                    yield pending.pop(future), future.result()
        finally:
            stop.set()
            for future in pending:
                future.cancel()


def sweep(
    plan: Plan,
    dataset: Dataset,
    jobs: int = 1,
    chunk: int | None = None,
    scheduler: str | None = None,
    progress: Callable[[int], None] = lambda runs: None,
) -> None:
    """Compute what is missing of a dataset and write it as it comes. May be interrupted at any time, and called again.

    Args:
      plan: the study.
      dataset: of this study.
      jobs: threads; on a cluster, chunks under way are twice the cluster's threads.
      chunk: runs per chunk and file; by default as many as keep all jobs busy.
      scheduler: address of a Dask scheduler, to compute on its workers instead of here.
      progress: called with the number of runs that have just been written.

    Raises:
      InputError: no such scheduler; workers with other versions; another sweep at work in the folder.
    """
    with dataset.alone():
        _sweep(plan, dataset, jobs, chunk, scheduler, progress)


def _sweep(plan, dataset, jobs, chunk, scheduler, progress) -> None:
    chunks = dataset.missing(chunk or chunk_size(plan, jobs))
    if scheduler is None:
        done = on_threads(plan, chunks, jobs)
    else:
        from .cluster import on_cluster

        done = on_cluster(plan, chunks, scheduler)
    ours = json.dumps(versions(), sort_keys=True).encode()
    try:
        for one, table in done:
            theirs = (table.schema.metadata or {}).get(b"versions")
            if theirs != ours:
                raise InputError(
                    f"{scheduler}: expected workers with {ours.decode()}, got one with {(theirs or b'none').decode()}"
                )
            dataset.write(one, table)
            progress(one.end - one.begin)
    finally:
        done.close()
