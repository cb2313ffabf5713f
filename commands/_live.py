"""A scenario that runs while a viewer shows it."""

from __future__ import annotations

import contextlib
import os
import socket
import subprocess
import time
from collections.abc import Iterator
from typing import TYPE_CHECKING

from ..models.errors import InputError
from ..models.output import at_end

if TYPE_CHECKING:
    from ..scenarios.live import LiveRun
    from ..scenarios.run import Run
    from ..views.rerun import LiveRecording

ADDRESS = "127.0.0.1"  # address of the viewer: this computer only
UPDATE = 0.04  # time between two updates of the viewer [s]
_LONGEST = 1.0  # longest time between two updates on a slow computer [s]
_PATIENCE = 30.0  # time for a viewer to open [s]


def show_live(live: LiveRun, words: list[str], environment: dict[str, str], port: int, speed: float) -> Run | None:
    """Open a viewer, and run a scenario in it at `speed` seconds per second; `words`, `environment`: of the viewer's
    process, which listens on `port`. Return the whole run after the viewer is closed; None if it was closed before the
    end.

    Raises:
      InputError: a viewer that does not open.
      InputError, FilterDiverged: as `scenarios.run.run_scenario`.
    """
    os.environ.setdefault("RUST_LOG", "off")  # a closed viewer is not an error
    import rerun as rr

    from ..views.rerun import LiveRecording

    first = live.advance(speed * UPDATE)  # compiles kernels, and raises errors, before the window opens
    with viewer_process(words, environment, subprocess.DEVNULL) as viewer:
        _wait_for(viewer, port)
        stream = rr.RecordingStream(f"flexspline live {live.scenario.name}")
        stream.connect_grpc(f"rerun+http://{ADDRESS}:{port}/proxy")
        try:
            run = play(live, LiveRecording(stream, live.start), speed, first, viewer)
            if run is not None:
                stream.flush(timeout_sec=_PATIENCE)
                viewer.wait()
        finally:
            stream.disconnect()
    return run


def play(
    live: LiveRun,
    shown: LiveRecording,
    speed: float,
    first: Run | None = None,
    viewer: subprocess.Popen[bytes] | None = None,
) -> Run | None:
    """Run a scenario at `speed`, or as fast as possible, and show every stretch; `first`: stretch that is already
    simulated. Return the whole run; None if the viewer was closed before its end."""
    begin = time.monotonic() - live.done / speed
    if first is not None:
        shown.send(first)
    while not live.over:
        behind = speed * (time.monotonic() - begin) - live.done
        shown.send(live.advance(min(max(behind, 0.0) + speed * UPDATE, speed * _LONGEST)))
        left = begin + live.done / speed - time.monotonic()
        if left > 0:
            time.sleep(left)
        if viewer is not None and viewer.poll() is not None:
            return None
    run = live.finish()
    shown.finish(run)
    return run


def free_port() -> int:
    """Return a free port of this computer."""
    with socket.socket() as found:
        found.bind((ADDRESS, 0))
        return int(found.getsockname()[1])


@contextlib.contextmanager
def viewer_process(
    words: list[str], environment: dict[str, str], stdout: int | None = None
) -> Iterator[subprocess.Popen[bytes]]:
    """Start a viewer's process and end it with the block; arguments as of `subprocess.Popen`."""
    viewer = subprocess.Popen(words, env=environment, stdout=stdout)
    try:
        with at_end(viewer.terminate):
            yield viewer
    finally:
        if viewer.poll() is None:
            viewer.terminate()
            try:
                viewer.wait(timeout=5)
            except subprocess.TimeoutExpired:
                viewer.kill()
                viewer.wait()


def _wait_for(viewer: subprocess.Popen[bytes], port: int) -> None:
    end = time.monotonic() + _PATIENCE
    while viewer.poll() is None and time.monotonic() < end:
        with contextlib.suppress(OSError), socket.create_connection((ADDRESS, port), timeout=1.0):
            return
        time.sleep(0.05)
    raise InputError("view: expected a viewer that opens, got none; use --web if there is no display")
