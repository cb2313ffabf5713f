"""`flexspline`, or `python -m flexspline`: the command line."""

from __future__ import annotations

import atexit
import gc
import os
import signal
import sys
import threading
from contextlib import suppress

_COLLECT_AFTER = 250_000
"""Objects before the first garbage collection. Imports make 170,000 that stay; by default Python would collect 240 times, for a
third of a second."""
_PATIENCE = 0.5  # s, for the end of a thread


def main() -> None:
    """Run the command line; Ctrl-C ends it without a traceback, also during imports."""
    with suppress(ValueError):  # not in the main thread
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    _open_closed_streams()
    gc.set_threshold(_COLLECT_AFTER)
    os.environ.setdefault("MUJOCO_GL", "off")  # nothing is rendered; the search for OpenGL takes 0.1 s
    from .commands import main as run

    try:
        run()
    except SystemExit as stop:
        _end(stop.code)
        raise
    _end(0)


def _open_closed_streams() -> None:
    """Redirect streams that the caller has closed: otherwise the next opened file would get their numbers, and the output."""
    for number, name in enumerate(("stdin", "stdout", "stderr")):
        if getattr(sys, name) is not None:
            continue
        nowhere = os.open(os.devnull, os.O_RDWR)
        if nowhere != number:
            try:
                os.fstat(number)
            except OSError:
                os.dup2(nowhere, number)
            os.close(nowhere)
        setattr(sys, name, open(os.devnull, "r" if number == 0 else "w", encoding="utf-8"))


def _end(code: object) -> None:
    """Exit without the half second that Python needs to delete its objects.

    Returns without exit if a thread is still running, output cannot be written, or there is a message.
    """
    for thread in threading.enumerate():
        if thread is not threading.current_thread() and not thread.daemon:
            thread.join(_PATIENCE)
            if thread.is_alive():
                return
    if code is not None and not isinstance(code, int):
        return
    try:
        atexit._run_exitfuncs()
        sys.stdout.flush()
        sys.stderr.flush()
    except (OSError, ValueError):
        return
    os._exit(code or 0)


if __name__ == "__main__":
    main()
