"""Runs of a study into rows of its dataset (simulation, estimation, metrics), on threads or on a cluster.

The closed loop, the estimators and the costly metrics are compiled and release the interpreter's lock, so that threads use all
cores. Every run has its own random streams: rows are the same to the bit for any number of threads or workers, any chunk size,
and any interruption.
"""

from __future__ import annotations

import json
import math
import threading
from collections.abc import Callable, Generator, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from itertools import islice
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pyarrow as pa

from ...models import plugins
from ...models.errors import FilterDiverged, InputError
from ..experiment import Experiment
from ..run import run_of
from ..run_folder import versions
from .dataset import Chunk, Dataset
from .design import Design

_LARGEST_CHUNK = 16
_ATTEMPTS = 20  # workers of a cluster that may be lost with a chunk before the sweep ends
_PATIENCE = 20  # s
Done = Generator[tuple[Chunk, pa.Table], None, None]  # chunks with their rows, as they finish


def compute(design: Design, chunk: Chunk, stop: threading.Event | None = None) -> pa.Table | None:
    """Compute the rows of a chunk, which are runs of one cell; None when `stop` is set. Raises `InputError`: a scenario
    that cannot run."""
    cell = design.cells[chunk.cell]
    experiment = design.experiment(cell)
    model = experiment.build()
    rows = []
    for run in range(chunk.begin, chunk.end):
        if stop is not None and stop.is_set():
            return None
        seed = design.study.seed_list[run]
        drawn, record = design.drawn(cell, seed, experiment)
        found = results(design, drawn, model if record is None else drawn.build())
        head: dict[str, Any] = {"run": run, "seed": seed, "key": design.key(cell, seed), **cell.columns}
        for variant, result in zip(design.variants, found, strict=True):
            rows.append(head | variant.columns | {"filter": variant.name} | result)
    table = pa.Table.from_pylist(rows, schema=schema(design))
    return table.replace_schema_metadata({"versions": json.dumps(versions(), sort_keys=True)})


def schema(design: Design) -> pa.Schema:
    """Return the columns of the dataset, without scenario and cell, which its folders name."""
    kinds: dict[str, pa.DataType] = {"cause": pa.string()}
    for axis in design.study.axes:
        text = isinstance(getattr(axis, "values", [0.0])[0], str)
        kinds[axis.name] = pa.string() if text else pa.float64()
    columns = [*design.cells[0].columns, *(axis.name for axis in design.study.filter_axes)]
    return pa.schema(
        [("run", pa.int64()), ("seed", pa.int64()), ("key", pa.string())]
        + [(name, kinds[name]) for name in columns]
        + [("filter", pa.string()), ("failure", pa.string())]
        + [(name, pa.float64()) for name in design.study.metrics]
    )


def results(design: Design, experiment: Experiment, model: mujoco.MjModel) -> list[dict[str, Any]]:
    """Simulate once; return for every variant its metrics and `failure`, the reason if it has none."""
    try:
        one = run_of(experiment, experiment.simulate(model))
        reference = one.reference
    except (InputError, FilterDiverged) as error:
        return [{"failure": str(error)}] * len(design.variants)
    found: list[dict[str, Any]] = []
    for variant in design.variants:
        try:
            posterior = variant.estimator.estimate(one.signals, one.known)
        except (InputError, FilterDiverged) as error:
            found.append({"failure": str(error)})
            continue
        if not np.isfinite(posterior.mean).all():
            found.append({"failure": f"{variant.estimator.name}: the estimate is no longer a finite number"})
            continue
        measured = reference.evaluate_posterior(posterior)
        found.append({"failure": ""} | {name: measured[name] for name in design.study.metrics})
    return found


def on_threads(design: Design, chunks: Iterator[Chunk], jobs: int) -> Done:
    """Yield chunks with their rows as they finish, on `jobs` threads; few are submitted at a time."""
    stop = threading.Event()
    with ThreadPoolExecutor(jobs, thread_name_prefix="sweep") as pool:
        pending: dict[Future[pa.Table | None], Chunk] = {}
        try:
            while True:
                for chunk in islice(chunks, 2 * jobs - len(pending)):
                    pending[pool.submit(compute, design, chunk, stop)] = chunk
                if not pending:
                    return
                finished, _ = wait(pending, return_when=FIRST_COMPLETED)
                for future in finished:
                    yield pending.pop(future), future.result()
        finally:
            stop.set()
            for future in pending:
                future.cancel()


def on_cluster(design: Design, chunks: Iterator[Chunk], address: str) -> Done:
    """Yield chunks with their rows as they finish, on the workers of a Dask cluster; lost workers only cost time. They
    need the same versions, and the files of joints, scenarios and plugins under the same paths. Raises `InputError`:
    Dask is not installed, there is no scheduler at the address, or workers cannot compute."""
    try:
        from distributed import CancelledError, Client, KilledWorker, as_completed
    except ImportError as error:
        raise InputError("--scheduler: needs Dask; install flexspline[cluster]") from error
    try:
        client = Client(address, timeout=_PATIENCE, set_as_default=False)
    except (OSError, ValueError) as error:
        raise InputError(f"--scheduler {address}: expected the address of a Dask scheduler, got none there") from error
    try:
        attempts: dict[Chunk, int] = {}
        pending: dict[str, Chunk] = {}
        finished = as_completed(loop=client.loop)

        def submit(chunk: Chunk) -> None:
            attempts[chunk] = attempts.get(chunk, 0) + 1
            key = f"sweep-{design.digest[:12]}-{chunk.cell}-{chunk.begin}-{chunk.end}-{attempts[chunk]}"
            future = client.submit(_compute, plugins.files(), design, chunk, key=key, pure=False)
            pending[str(future.key)] = chunk
            finished.add(future)

        def fill() -> None:
            threads: Any = client.nthreads()
            wanted = 2 * max(1, sum(threads.values()))
            for chunk in islice(chunks, max(0, wanted - len(pending))):
                submit(chunk)

        fill()
        while pending:
            future = next(finished)
            chunk = pending.pop(str(future.key))
            try:
                table = future.result()
            except (KilledWorker, CancelledError) as error:
                if attempts[chunk] >= _ATTEMPTS:
                    raise InputError(f"{address}: {chunk}: {attempts[chunk]} workers were lost with it") from error
                submit(chunk)
                continue
            except ImportError as error:
                raise InputError(f"{address}: expected workers with flexspline installed, got: {error}") from error
            del attempts[chunk]
            future.release()
            yield chunk, table
            fill()
    finally:
        client.close()


def _compute(known: tuple[Path, ...], design: Design, chunk: Chunk) -> pa.Table | None:
    for path in known:
        plugins.load(path)
    return compute(design, chunk)


def sweep(
    design: Design,
    dataset: Dataset,
    jobs: int = 1,
    chunk: int | None = None,
    scheduler: str | None = None,
    progress: Callable[[int], None] = lambda runs: None,
) -> None:
    """Compute the missing rows of a study's dataset and write them at once. It may be interrupted at any time, and
    called again.

    `jobs`: threads; `chunk`: runs per chunk and file, by default as many as keep all jobs busy; `scheduler`: address of a
    Dask scheduler, to compute on its workers; `progress`: called with the number of runs that have been written. Raises
    `InputError`: no such scheduler; workers with other versions; another sweep in the same folder.
    """
    with dataset.locked():
        per_job = math.ceil(design.runs / (4 * jobs))
        chunks = dataset.missing(chunk or max(1, min(_LARGEST_CHUNK, per_job, len(design.study.seed_list))))
        done = on_cluster(design, chunks, scheduler) if scheduler else on_threads(design, chunks, jobs)
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
