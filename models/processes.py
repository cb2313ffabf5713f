"""Worker processes: with this process's plugins, without Ctrl-C, and ended with it."""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from . import plugins

_watching: list[threading.Thread] = []


def single_threaded() -> None:
    """Let linear algebra use one thread, here and in processes of this one, as other work is side by side."""
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(name, "1")


def begin(known: Sequence[Path]) -> None:
    """Begin as a worker: load the plugin files, ignore Ctrl-C, and end when the parent process has ended."""
    for path in known:
        plugins.load(path)
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = multiprocessing.parent_process()
    if parent is None or _watching:
        return

    def wait() -> None:
        parent.join()
        os._exit(1)

    _watching.append(threading.Thread(target=wait, daemon=True))
    _watching[0].start()


@contextmanager
def no_interrupts() -> Iterator[None]:
    """Block Ctrl-C in this thread, and in processes that it starts while they load: a terminal sends it to all."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def end() -> None:
    """End the processes of this one at once."""
    for process in multiprocessing.active_children():
        process.kill()
