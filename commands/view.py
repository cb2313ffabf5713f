"""`flexspline view`: runs or a diagnosis in the Rerun viewer."""

from __future__ import annotations

import contextlib
import os
import shutil
import subprocess
import sys
import tempfile
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import typer

from ..models.errors import InputError
from ..models.output import at_end
from ._live import ADDRESS, viewer_process
from ._options import AsJson, Changes, Seed, shipped, with_plugins

RECORDINGS = ("run.rrd", "report.rrd")  # file names of a run's and of a diagnosis's recording
_MAGIC = b"RRF"

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
        typer.Argument(
            help="Folder of a run or a diagnosis, or an .rrd recording; or several runs, to overlay.",
            metavar="[FOLDER…]",
        ),
    ] = None,
    live: Annotated[
        str | None,
        typer.Option(
            "--live",
            metavar="SCENARIO",
            help="Run a scenario (name or path) and play it; nothing is written.",
            autocompletion=shipped("scenarios"),
        ),
    ] = None,
    changes: Changes = None,
    seed: Seed = None,
    speed: Annotated[
        float, typer.Option("--speed", min=0.01, max=1000, help="Of `--live`: seconds of the scenario per second.")
    ] = 1.0,
    web: Annotated[bool, typer.Option("--web", help="In the browser, instead of a window.")] = False,
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
    from ._console import console
    from ._live import free_port, show_live

    run, port = run_scenario(*load_scenario(name, changes, seed), os.cpu_count() or 1), free_port()
    show_live(run, viewer_command(None, web, port), viewer_environment(), port, speed)
    if as_json:
        return {run.name: {"folder": None, **run.metrics}}
    from ..views.tables import comparison_table

    terminal = console()
    terminal.print(comparison_table({run.name: run.metrics}))
    for note in run.notes:
        terminal.print(f"{run.name}: {note}", style="yellow")


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
        with viewer_process(viewer_command(path, web), viewer_environment()) as viewer:
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
