"""`flexspline view`: a run in the Rerun viewer."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from typing import Annotated

import typer

from ..models.errors import InputError

ADDRESS = "127.0.0.1"
"""What the viewer listens on: this computer only."""
RECORDING = "run.rrd"
_MAGIC = b"RRF"


def command(
    run: Annotated[Path, typer.Argument(help="Run folder, or an .rrd recording.", metavar="RUN")],
    web: Annotated[bool, typer.Option("--web", help="In the browser, instead of a window.")] = False,
) -> None:
    """Open a run in the Rerun viewer, which listens on 127.0.0.1 only; Ctrl-C ends it."""
    recording = find_recording(run)
    if not web and sys.platform.startswith("linux") and not (_set("DISPLAY") or _set("WAYLAND_DISPLAY")):
        raise InputError("view: expected a display for the viewer's window, found none; use --web")
    words = viewer_command(recording, web)
    if os.name == "posix":
        os.execv(words[0], words)  # the viewer takes this process's place, so that what ends one ends the other
    raise typer.Exit(subprocess.call(words))


def viewer_command(recording: Path, web: bool = False) -> list[str]:
    """The command line that opens a recording; every port is free and bound to this computer only."""
    import rerun_cli

    folder = Path(rerun_cli.__file__).parent
    program = next((folder / name for name in ("rerun", "rerun.exe") if (folder / name).is_file()), None)
    start = [sys.executable, "-m", "rerun_cli"] if program is None else [str(program)]
    words = [*start, str(recording), "--bind", ADDRESS, "--port", "auto"]
    return [*words, "--web-viewer", "--web-viewer-port", "0"] if web else words


def find_recording(run: Path) -> Path:
    """The Rerun recording of a run folder, or the recording itself.

    Raises:
      InputError: there is none, or it is not a Rerun recording.
    """
    if not run.exists():
        raise InputError(f"{run}: expected a run folder or an .rrd recording, found nothing")
    recording = run / RECORDING if run.is_dir() else run
    try:
        with open(recording, "rb") as file:
            magic = file.read(len(_MAGIC))
    except FileNotFoundError as error:
        raise InputError(f"{run}: expected a run folder with {RECORDING}, found none in it") from error
    except OSError as error:
        raise InputError(f"{recording}: cannot be read: {error.strerror}") from error
    if magic != _MAGIC:
        raise InputError(f"{recording}: expected a Rerun recording, got another kind of file")
    return recording


def _set(variable: str) -> bool:
    return bool(os.environ.get(variable))
