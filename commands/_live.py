"""A run that a viewer shows as it goes on."""

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
    from ..scenarios.run import Run
    from ..views.rerun import RunRecording

ADDRESS = "127.0.0.1"  # address of the viewer: this computer only
UPDATE = 0.04  # time between two updates of the viewer [s]
_LONGEST = 1.0  # longest time between two updates on a slow computer [s]
_PATIENCE = 30.0  # time for a viewer to open [s]


def show_live(run: Run, words: list[str], environment: dict[str, str], port: int, speed: float) -> None:
    """Open a viewer, and play a run in it at `speed` seconds per second, until the viewer is closed; `words`,
    `environment`: of the viewer's process, which listens on `port`. Raises `InputError`: a viewer that does not open."""
    os.environ.setdefault("RUST_LOG", "off")  # a closed viewer is not an error
    import rerun as rr

    from ..views.rerun import RunRecording

    with viewer_process(words, environment, subprocess.DEVNULL) as viewer:
        _wait_for(viewer, port)
        stream = rr.RecordingStream(f"flexspline live {run.name}")
        stream.connect_grpc(f"rerun+http://{ADDRESS}:{port}/proxy")
        try:
            if play(RunRecording(stream, run, live=True), speed, viewer):
                stream.flush(timeout_sec=_PATIENCE)
                viewer.wait()
        finally:
            stream.disconnect()


def play(shown: RunRecording, speed: float, viewer: subprocess.Popen[bytes] | None = None) -> bool:
    """Show a run at `speed`, stretch by stretch; return False if the viewer was closed before the end."""
    begin, done, ticks = time.monotonic(), 0, len(shown.run.time)
    period = float(shown.run.time[1]) / speed  # s, of a tick
    while done < ticks:
        now = time.monotonic() - begin + UPDATE
        end = min(max(min(round(now / period), done + round(_LONGEST / period)), done + 2), ticks)
        end = ticks if ticks - end == 1 else end  # a single tick has no period
        shown.send(slice(done, end))
        done = end
        time.sleep(max(begin + done * period - time.monotonic(), 0.0))
        if viewer is not None and viewer.poll() is not None:
            return False
    shown.finish()
    return True


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
