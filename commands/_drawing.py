"""Views of runs, drawn in processes of their own while scenarios still run: matplotlib and Rerun are loaded there, meanwhile.

A run goes to them through a pipe. Nothing that a process would load or execute is written to a folder, which others may share.
"""

from __future__ import annotations

import gc
import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, wait
from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from ..models import plugins, processes
from ..models.output import at_end

if TYPE_CHECKING:
    from ..scenarios.run import Run

_PACKAGE, _, _ROOM = (__package__ or "").rpartition(".")
_MODULES = {
    "figures": (
        "matplotlib.backends.backend_agg",
        "matplotlib.figure",
        "PIL.PngImagePlugin",
        *(f"{_PACKAGE}.views.figures.{name}" for name in ("error", "experiments", "filters", "overview", "zoom")),
    ),
    "recording": (f"{_PACKAGE}.views.rerun",),
}
"""What each view loads beside the run."""
_LARGE = 1 << 20
"""Samples from which on a run is drawn in this process: another would hold all of it once more."""

Begin = Callable[["Run", Path], Callable[[], object]]
"""Begins to draw a run into its folder; what it gives waits for the end."""


@contextmanager
def drawing(views: Sequence[str], runs: int) -> Iterator[list[Begin]]:
    """Processes that draw `views`, of `figures` and `recording`, of so many runs; one function that begins, or none.

    They are as many as there are cores, and a run is shared out to as many of them as it has to itself.
    """
    if not views:
        yield []
        return
    method = "forkserver" if "forkserver" in multiprocessing.get_all_start_methods() else "spawn"
    context = multiprocessing.get_context(method)
    if method == "forkserver":  # a server that has loaded what is needed, from which each of them begins
        first = (f"{_PACKAGE}.{_ROOM}._server", __name__, f"{_PACKAGE}.scenarios.run")
        context.set_forkserver_preload([*first, *(module for view in views for module in _MODULES[view])])
    shares = max(1, (os.cpu_count() or 1) // runs)
    count = min(os.cpu_count() or 1, runs * shares)
    pool = ProcessPoolExecutor(count, mp_context=context, initializer=_ready, initargs=(plugins.files(),))
    starting = threading.Thread(target=_start, args=(pool, count))
    starting.start()
    with at_end(partial(_stop, starting)):
        try:
            yield [lambda run, folder: _begin(pool, views, run, folder, shares)]
        finally:
            starting.join()
            pool.shutdown(cancel_futures=True)


def _stop(starting: threading.Thread) -> None:
    """End the processes, and the server from which they begin, whose loading takes seconds."""
    from multiprocessing import forkserver

    server = getattr(forkserver._forkserver, "_forkserver_pid", None)
    if server is not None:
        os.kill(server, signal.SIGTERM)
    starting.join(1.0)
    processes.end()


def _start(pool: ProcessPoolExecutor, count: int) -> None:
    """Begin the processes."""
    with processes.no_interrupts(), suppress(EOFError, OSError):  # what `_stop` leaves
        for _ in range(count):
            pool.submit(_ready, ())


def _begin(
    pool: ProcessPoolExecutor, views: Sequence[str], run: Run, folder: Path, shares: int
) -> Callable[[], object]:
    if len(run.time) > _LARGE:
        return partial(_draw, run, folder, views, 0, 1)
    whole = run.complete()
    begun = [pool.submit(_draw, whole, folder, tuple(views), share, shares) for share in range(shares)]

    def finish() -> None:
        wait(begun)  # what fails does not leave others writing into a folder that is given up
        for future in begun:
            future.result()

    return finish


def _ready(known: Sequence[Path]) -> None:
    processes.begin(known)
    gc.freeze()
    gc.enable()


def _draw(run: Run, folder: Path, views: Sequence[str], share: int, shares: int) -> None:
    """Draw a run's figures from the `share` on, each `shares`th; the last share, which has fewest, writes the recording."""
    if "figures" in views:
        from ..views.figures import save_figures

        save_figures(run, folder / "figures", share, shares)
    if "recording" in views and share == shares - 1:
        from ..views.rerun import write_rerun

        write_rerun(run, folder / "run.rrd")
