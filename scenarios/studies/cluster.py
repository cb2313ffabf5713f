"""A study on a Dask cluster that is running already: chunks are its tasks, lost workers cost time only.

Workers need the same versions of this package and its dependencies, and see the joints', scenarios' and plugins' files under the
same paths (shipped ones are with the package).
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
from .rows import Done, compute

_ATTEMPTS = 20
"""Workers that a chunk may take down, or be on when they go, before it is thought to be its fault."""
_PATIENCE = 20  # s


def on_cluster(design: Design, chunks: Iterator[Chunk], address: str) -> Done:
    """Chunks with their rows as they finish. Few are under way at a time, however many there are.

    Raises:
      InputError: Dask is not installed, there is no scheduler at the address, workers cannot compute.
    """
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
            # Lost with its worker, a task begins again elsewhere; the scheduler does that itself.
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
    """The rows of a chunk, on a worker, which knows the plugins then."""
    plugins.load_all(known)
    return compute(design, chunk)
