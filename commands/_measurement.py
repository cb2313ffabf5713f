"""The measurement that a command was given."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from ..models.recording import Measurement


def measurement_at(path: str | Path) -> Measurement:
    """Read a measurement (`models.recording.read_measurement`); tables in its folder that are no part of it are told."""
    from ..models.recording import read_measurement

    found = read_measurement(path)
    for table in found.passed_over:
        beside = table.with_suffix(".yaml").name
        print(f"flexspline: {table}: not read, as no {beside} lies beside it", file=sys.stderr)
    return found
