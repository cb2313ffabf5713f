"""Runs of a study into rows of its dataset, on threads or on a cluster.

The closed loop, the estimators and the costly metrics are compiled and release the interpreter's lock, so that threads use all
cores. Every run has its own random streams: rows are the same to the bit for any number of threads or workers, any chunk size,
and any interruption.
"""

from __future__ import annotations

import json
import math
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from itertools import islice

import pyarrow as pa

from ...models.errors import InputError
from .dataset import Chunk, Dataset
from .design import Design
from .rows import Done, compute, versions

_LARGEST_CHUNK = 16


def chunk_size(design: Design, jobs: int) -> int:
    """Return the runs per chunk: 16, or fewer to keep all jobs busy."""
    per_job = math.ceil(design.runs / (4 * jobs))
    return max(1, min(_LARGEST_CHUNK, per_job, len(design.study.seed_list)))


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

    Args:
      jobs: threads; on a cluster, twice the cluster's threads are submitted.
      chunk: runs per chunk and file; by default as many as keep all jobs busy.
      scheduler: address of a Dask scheduler, to compute on its workers.
      progress: called with the number of runs that have been written.

    Raises:
      InputError: no such scheduler; workers with other versions; another sweep in the same folder.
    """
    with dataset.locked():
        chunks = dataset.missing(chunk or chunk_size(design, jobs))
        if scheduler is None:
            done = on_threads(design, chunks, jobs)
        else:
            from .cluster import on_cluster

            done = on_cluster(design, chunks, scheduler)
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
