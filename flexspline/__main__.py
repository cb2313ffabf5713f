"""`flexspline`, or `python -m flexspline`: the command line."""

from __future__ import annotations

import signal
from contextlib import suppress


def main() -> None:
    """Run the command line; Ctrl-C ends it without a traceback also while it is still being loaded."""
    with suppress(ValueError):  # not in the main thread
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    from .commands import main as run

    run()


if __name__ == "__main__":
    main()
