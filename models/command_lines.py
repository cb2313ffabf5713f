"""Command lines in texts and pages, to copy."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import TYPE_CHECKING

from . import plugins
from .joint import Joint, known_joints

if TYPE_CHECKING:
    from .recording import Measurement


def command_line(*words: object) -> str:
    """Return a command line of this program with the known plugin files; words are quoted where a shell needs it."""
    texts = [word.as_posix() if isinstance(word, Path) else str(word) for word in words]
    return f"{shlex.join(['flexspline', *texts])}{plugins.options()}"


def checking(measurement: Measurement, joint: Joint) -> str:
    """Return the command line that checks a measurement of a joint."""
    return command_line("check", measurement.path, *of_joint(measurement, joint))


def mending(measurement: Measurement, joint: Joint, out: str = "MENDED") -> str:
    """Return the command line that writes a corrected measurement of a joint."""
    return command_line("import", measurement.path, "--fix", *of_joint(measurement, joint), "--out", out)


def of_joint(measurement: Measurement, joint: Joint) -> tuple[object, ...]:
    """Return the option with which a command takes this joint; none if the recordings name it, or it has no file."""
    named = measurement.recordings[0].joint
    shipped = {name: path.resolve() for name, path in known_joints().items()}
    own = shipped.get(named.replace("_", "-"), (measurement.folder / named).resolve())
    if joint.path in (own, Path()):
        return ()
    return "--joint", next((name for name, path in shipped.items() if path == joint.path), joint.path)
