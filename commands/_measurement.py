"""The measurement that a command is given."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from ..models.joint import Joint
    from ..models.recording import Measurement


def load_measurement(path: str | Path, option: str | None) -> tuple[Measurement, Joint]:
    """Load a measurement, split where samples are missing, and its joint; report splits on stderr."""
    from ..diagnosis.data.samples import parted

    data = read_measurement_files(path)
    joint = data.load_joint(option)
    data, messages = parted(data, joint)
    for text in messages:
        print(f"flexspline: {text}", file=sys.stderr)
    return data, joint


def read_measurement_files(path: str | Path) -> Measurement:
    """Read a measurement; report on stderr tables of its folder that are not part of it, except those of commands."""
    from ..models.output import manifest
    from ..models.recording import read_measurement

    found = read_measurement(path)
    for text in found.fixed:
        print(f"flexspline: {text}", file=sys.stderr)
    ours = manifest(found.folder) if found.passed_over else {}
    for table, why in found.passed_over.items():
        if table.name not in ours:
            print(f"flexspline: {table}: not read, as {why}", file=sys.stderr)
    return found
