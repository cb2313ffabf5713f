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
"""Objects after which Python first looks for ones that only refer to each other. What a command imports are 170,000 that stay;
by its own measure Python would look 240 times meanwhile, a third of a second."""
_PATIENCE = 0.5  # s, for a thread that is about to end


def main() -> None:
    """Run the command line; Ctrl-C ends it without a traceback also while it is still being loaded."""
    with suppress(ValueError):  # not in the main thread
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    _open_what_is_closed()
    gc.set_threshold(_COLLECT_AFTER)
    os.environ.setdefault("MUJOCO_GL", "off")  # nothing is rendered, and looking for OpenGL takes a tenth of a second
    from .commands import main as run

    try:
        run()
    except SystemExit as stop:
        _end(stop.code)
        raise
    _end(0)


def _open_what_is_closed() -> None:
    """Let streams that the caller has closed lead nowhere: the next file to be opened would take their numbers, and with them
    what is printed."""
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
    """End at once, as Python would after half a second: taking apart what is loaded, object by object, helps nobody.

    Returns where that is not for here to do: a thread is still running, output cannot be written, or there is something to say.
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
