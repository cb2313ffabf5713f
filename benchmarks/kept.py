"""Keep rows of a benchmark in a CSV next to the pages; compute the missing ones on several processes."""

from __future__ import annotations

import csv
import itertools
import math
import multiprocessing
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from dataclasses import fields
from pathlib import Path
from typing import Any, TypeVar

from flexspline.models.files import write_into_place

Row = TypeVar("Row")
_READ: Mapping[str, Any] = {"str": str, "int": int, "float": float, "bool": "True".__eq__}


def read(path: Path, row: type[Row]) -> list[Row]:
    """Rows that are kept, of a dataclass of texts, numbers and truth values; none where there is no file."""
    if not path.exists():
        return []
    kinds = {f.name: str(f.type) for f in fields(row)}  # type: ignore[arg-type]
    with path.open(newline="", encoding="utf-8") as file:
        return [row(**{k: _READ[kinds[k]](v) for k, v in line.items()}) for line in csv.DictReader(file)]


def write(path: Path, rows: Sequence[Any], row: type[Any]) -> None:
    """Keep rows in their order."""
    names = [f.name for f in fields(row)]
    with write_into_place(path) as temporary, temporary.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(names)
        writer.writerows([getattr(r, name) for name in names] for r in rows)


def computed(
    function: Callable[..., Any],
    wanted: Iterable[tuple[Any, ...]],
    processes: int,
    minutes: float = math.inf,
    initializer: Callable[[], object] | None = None,
) -> Iterator[tuple[tuple[Any, ...], Future[Any]]]:
    """Yield arguments and results of `function` from several processes.

    Args:
      function: importable.
      wanted: arguments, in the order in which they begin.
      minutes: after which no further one begins.
      initializer: of each process.
    """
    waiting, began = iter(wanted), time.monotonic()
    with ProcessPoolExecutor(processes, multiprocessing.get_context("spawn"), initializer) as pool:
        running = {pool.submit(function, *one): one for one in itertools.islice(waiting, processes)}
        while running:
            for done in wait(running, return_when=FIRST_COMPLETED).done:
                one = running.pop(done)
                if time.monotonic() - began < 60 * minutes and (more := next(waiting, None)) is not None:
                    running[pool.submit(function, *more)] = more
                yield one, done
