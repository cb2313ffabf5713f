"""Command lines in texts and pages, to copy."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import TYPE_CHECKING

from . import plugins
from .joint import Joint, known_joints

if TYPE_CHECKING:
    from .recording import Measurement


def checking(measurement: Measurement, joint: Joint) -> str:
    """Return the command line that checks a measurement of a joint."""
    return f"flexspline check {_quoted(measurement.path)}{of_joint(measurement, joint)}{plugins.options()}"


def mending(measurement: Measurement, joint: Joint, out: str = "MENDED") -> str:
    """Return the command line that writes a corrected measurement of a joint."""
    return f"flexspline import {_quoted(measurement.path)} --fix{of_joint(measurement, joint)} --out {out}{plugins.options()}"


def of_joint(measurement: Measurement, joint: Joint) -> str:
    """Return the option with which a command takes this joint; empty if the recordings name it, or it has no file."""
    named = measurement.recordings[0].joint
    shipped = {name: path.resolve() for name, path in known_joints().items()}
    own = shipped.get(named.replace("_", "-"), (measurement.folder / named).resolve())
    if joint.path in (own, Path()):
        return ""
    return f" --joint {_quoted(next((name for name, path in shipped.items() if path == joint.path), joint.path))}"


def _quoted(path: str | Path) -> str:
    return shlex.quote(path if isinstance(path, str) else path.as_posix())
