"""Keep rows of a benchmark in a CSV next to the pages; compute the missing ones on several processes."""

from __future__ import annotations

import itertools
import math
import multiprocessing
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from flexspline.models.files import write_into_place

Rows = list[dict[str, Any]]


def completed(
    path: Path,
    function: Callable[..., Rows],
    wanted: Sequence[tuple[Any, ...]],
    by: Sequence[str],
    order: Mapping[str, Sequence[Any] | None],
    processes: int = 1,
    minutes: float = math.inf,
) -> pd.DataFrame:
    """Compute the wanted draws that are not kept yet, keep the rows of each as it ends, and return all rows.

    Args:
      path: of the CSV.
      function: importable; rows of a draw.
      wanted: draws, the function's arguments; they are the columns `by`.
      order: columns by which rows are sorted, each with its values in order; None: their own order.
      processes: at a time. minutes: after which no further draw begins.
    """
    rows = (
        pd.read_csv(path, keep_default_na=False, na_values="nan") if path.exists() else pd.DataFrame(columns=list(by))
    )
    have, began = set(rows[list(by)].itertuples(index=False, name=None)), time.monotonic()
    for one, done in computed(function, [w for w in wanted if w not in have], processes, minutes):
        new = pd.DataFrame(done.result())
        rows = new if rows.empty else pd.concat([rows, new])
        places = [rows[c] if values is None else rows[c].map(list(values).index) for c, values in order.items()]
        rows = rows.iloc[np.lexsort(places[::-1])]
        with write_into_place(path) as temporary:
            rows.to_csv(temporary, index=False, na_rep="nan", lineterminator="\r\n")
        print(f"{(time.monotonic() - began) / 60:7.1f} min  {', '.join(map(str, one))}", flush=True)
    return rows


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
