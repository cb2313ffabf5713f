"""The measurement that a command was given."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from ..models.joint import Joint
    from ..models.recording import Measurement


def parted_measurement(path: str | Path, option: str | None) -> tuple[Measurement, Joint]:
    """A measurement with gaps where samples are missing that its time does not show, which is told; and its description."""
    from ..diagnosis.data.samples import parted

    data = measurement_at(path)
    joint = data.load_joint(option)
    data, said = parted(data, joint)
    for text in said:
        print(f"flexspline: {text}", file=sys.stderr)
    return data, joint


def measurement_at(path: str | Path) -> Measurement:
    """Read a measurement (`models.recording.read_measurement`); tables in its folder that are no part of it are told,
    but not those that a command wrote beside it: a run folder holds signals and estimates."""
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
