"""`flexspline view`: runs or a diagnosis in the Rerun viewer, or a run that is played in it."""

from __future__ import annotations

import contextlib
import os
import shutil
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ..models.errors import InputError
from ..models.output import at_end
from ._console import console
from ._options import AsJson, Changes, Seed, argument, option, shipped, with_plugins

if TYPE_CHECKING:
    from ..scenarios.run import Run
    from ..views.rerun import RunRecording

RECORDINGS = ("run.rrd", "report.rrd")  # file names of a run's and of a diagnosis's recording
_MAGIC = b"RRF"
ADDRESS = "127.0.0.1"  # address of the viewer: this computer only
UPDATE = 0.04  # time between two updates of the viewer [s]
_LONGEST = 1.0  # longest time between two updates on a slow computer [s]
_PATIENCE = 30.0  # time for a viewer to open [s]

EXAMPLES = (
    "flexspline view runs/external_push",
    "flexspline view diagnosis --web",
    "flexspline view runs/external_push again/external_push",
    "flexspline view --live external_push --set controller.kp=6 --speed 0.5",
)


@with_plugins
def command(
    folders: Annotated[
        list[Path] | None,
        argument(
            "Folder of a run or a diagnosis, or an .rrd recording; or several runs, to overlay.", metavar="[FOLDER…]"
        ),
    ] = None,
    live: Annotated[
        str | None,
        option(
            "Run a scenario (name or path) and play it; nothing is written.",
            metavar="SCENARIO",
            autocompletion=shipped("scenarios"),
        ),
    ] = None,
    changes: Changes = None,
    seed: Seed = None,
    speed: Annotated[float, option("Of `--live`: seconds of the scenario per second.", min=0.01, max=1000)] = 1.0,
    web: Annotated[bool, option("In the browser, instead of a window.", "--web")] = False,
    as_json: AsJson = False,
) -> Any:
    """Open one or several runs, a diagnosis, or a scenario as it goes on (`--live`) in the Rerun viewer.

    The viewer listens on 127.0.0.1 only and sends no usage data. `--live` runs until its viewer is closed, or Ctrl-C.
    """
    if (live is None) == (not folders):
        raise InputError(
            f"view: expected folders, or --live with a scenario, got {'neither' if live is None else 'both'}"
        )
    if live is None and (changes or seed is not None or speed != 1.0):
        raise InputError("view: --set, --seed, --speed: expected --live with them, got a folder")
    recording = find_recording(folders[0]) if folders and len(folders) == 1 else None
    display = os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    if not web and sys.platform.startswith("linux") and not display:
        raise InputError("view: expected a display for the viewer's window, found none; use --web")
    if live is not None:
        return _show_live(live, changes, seed, speed, web, as_json)
    assert folders is not None
    if as_json:
        _print_opened(folders)
    if recording is None:
        raise typer.Exit(_overlaid(folders, web))
    words = viewer_command(recording, web)
    if os.name == "posix":
        os.execve(words[0], words, viewer_environment())  # the viewer replaces this process
    raise typer.Exit(subprocess.call(words, env=viewer_environment()))


def _show_live(name: str, changes: list[str] | None, seed: int | None, speed: float, web: bool, as_json: bool) -> Any:
    from ..scenarios.run import run_scenario
    from ..scenarios.scenario import load_scenario

    run = run_scenario(*load_scenario(name, changes, seed), os.cpu_count() or 1)
    show_live(run, web, speed)
    if as_json:
        return {run.name: {"folder": None, **run.metrics}}
    from ..views.tables import comparison_table

    terminal = console()
    terminal.print(comparison_table({run.name: run.metrics}))
    for note in run.notes:
        terminal.print(f"{run.name}: {note}", style="yellow")


def show_live(run: Run, web: bool, speed: float) -> None:
    """Open a viewer, and play a run in it at `speed` seconds per second, until the viewer is closed. Raises `InputError`:
    a viewer that does not open."""
    os.environ.setdefault("RUST_LOG", "off")  # a closed viewer is not an error
    import rerun as rr

    from ..views.rerun import RunRecording

    with socket.socket() as free:
        free.bind((ADDRESS, 0))
        port = int(free.getsockname()[1])
    with viewer_process(viewer_command(None, web, port), subprocess.DEVNULL) as viewer:
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


@contextlib.contextmanager
def viewer_process(words: list[str], stdout: int | None = None) -> Iterator[subprocess.Popen[bytes]]:
    """Start a viewer by its command line and end it with the block; `stdout` as of `subprocess.Popen`."""
    viewer = subprocess.Popen(words, env=viewer_environment(), stdout=stdout)
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


def _print_opened(folders: list[Path]) -> None:
    """Print what is opened as JSON; the viewer's output goes to stderr."""
    from ..models.files import json_text

    print(json_text({"opened": [str(folder) for folder in folders], "address": ADDRESS}), flush=True)
    with contextlib.suppress(OSError, ValueError):
        os.dup2(sys.stderr.fileno(), sys.stdout.fileno())


def _overlaid(folders: list[Path], web: bool) -> int:
    """Show several runs on one timeline, from a temporary recording; return the viewer's exit code."""
    with (
        tempfile.TemporaryDirectory(prefix="flexspline-") as folder,
        at_end(partial(shutil.rmtree, folder, ignore_errors=True)),
    ):
        path = overlay(folders, Path(folder) / "runs.rrd")
        with viewer_process(viewer_command(path, web)) as viewer:
            return viewer.wait()


def overlay(folders: list[Path], path: Path) -> Path:
    """Write a recording of several runs' folders, named by folder or by path. Raises `InputError`: a folder that is not
    a run, or named twice."""
    from ..scenarios.run_folder import load_run
    from ..views.rerun import write_rerun_overlay

    if len({folder.resolve() for folder in folders}) < len(folders):
        raise InputError("view: expected each run once, got one twice")
    names = [folder.name for folder in folders]
    if len(set(names)) < len(names):
        names = [folder.as_posix() for folder in folders]
    runs = [load_run(folder) for folder in folders]
    return write_rerun_overlay(list(zip(names, runs, strict=True)), path)


def viewer_command(recording: Path | None, web: bool = False, port: int | None = None) -> list[str]:
    """Return the command line of a viewer of a recording, or of one that waits for data at a port; every port is bound
    to this computer only."""
    import rerun_cli

    folder = Path(rerun_cli.__file__).parent
    program = next((folder / name for name in ("rerun", "rerun.exe") if (folder / name).is_file()), None)
    start = [sys.executable, "-m", "rerun_cli"] if program is None else [str(program)]
    shown = [str(recording)] if recording is not None else ["--expect-data-soon"]
    words = [*start, *shown, "--bind", ADDRESS, "--port", "auto" if port is None else str(port)]
    return [*words, "--web-viewer", "--web-viewer-port", "0"] if web else words


def viewer_environment() -> dict[str, str]:
    """Return this process's environment, changed so that Rerun collects no usage data: on CI machines it collects none."""
    return {name: value for name, value in os.environ.items() if name != "FORCE_RERUN_ANALYTICS"} | {"CI": "1"}


def find_recording(run: Path) -> Path:
    """Return the Rerun recording in a folder of a run or a diagnosis, the only one in another folder, or the recording
    itself. Raises `InputError`: there is none, or it is not a Rerun recording."""
    if not run.exists():
        raise InputError(f"{run}: expected a folder of a run or a diagnosis, or an .rrd recording, found nothing")
    recording = run
    if run.is_dir():
        there = [run / name for name in RECORDINGS if (run / name).is_file()] or sorted(run.glob("*.rrd"))
        if not there:
            below = sorted(path.parent.name for path in run.glob("*/*.rrd"))
            hint = f" (there is one in {', '.join(below)} below it)" if below else ""
            raise InputError(f"{run}: expected a folder with {' or '.join(RECORDINGS)}, found none in it{hint}")
        if len(there) > 1:
            raise InputError(f"{run}: expected one recording, found {', '.join(path.name for path in there)}: name one")
        recording = there[0]
    if not recording.is_file():  # a pipe may never end
        raise InputError(f"{recording}: expected a Rerun recording, got no file")
    try:
        with open(recording, "rb") as file:
            magic = file.read(len(_MAGIC))
    except OSError as error:
        raise InputError(f"{recording}: cannot be read: {error.strerror}") from error
    if magic != _MAGIC:
        raise InputError(f"{recording}: expected a Rerun recording, got another kind of file")
    return recording
