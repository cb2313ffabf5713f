"""A study on a running Dask cluster: chunks are its tasks, and lost workers only cost time.

Workers need the same versions of this package and its dependencies. They must find the files of joints, scenarios and plugins
under the same paths.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import islice
from pathlib import Path
from typing import Any

import pyarrow as pa

from ...models import plugins
from ...models.errors import InputError
from .dataset import Chunk
from .design import Design
from .sweep import Done, compute

_ATTEMPTS = 20  # workers that may be lost with a chunk before the sweep ends
_PATIENCE = 20  # s


def on_cluster(design: Design, chunks: Iterator[Chunk], address: str) -> Done:
    """Yield chunks with their rows as they finish; few are submitted at a time. Raises `InputError`: Dask is not
    installed, there is no scheduler at the address, or workers cannot compute."""
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
