"""Where a page comes from: when it was written, by what, from which data."""

from __future__ import annotations

import hashlib
import platform
from datetime import datetime
from importlib import metadata
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from pathlib import Path

    from ...models.recording import Measurement, Recording

_DIGITS = 12


def provenance(measurement: Measurement) -> dict[str, Any]:
    """Date, versions, and of each recording its name, samples, columns and the beginning of a hash."""
    return {
        "date": now(),
        "versions": versions(),
        "data": [(r.name, len(r.time), ", ".join(r.columns), fingerprint(r)) for r in measurement.recordings],
    }


def now() -> str:
    """Date and time, as pages state them."""
    return datetime.now().astimezone().strftime("%Y-%m-%d %H:%M %Z")


def versions() -> dict[str, str]:
    """Versions of this package and of what computes, by name."""
    packages = {name: metadata.version(name) for name in ("flexspline", "mujoco", "numpy", "scipy")}
    return packages | {"Python": platform.python_version()}


def file_digest(path: Path) -> str:
    """First digits of a file's SHA-256."""
    return hashlib.sha256(path.read_bytes()).hexdigest()[:_DIGITS]


def fingerprint(recording: Recording) -> str:
    """First digits of the SHA-256 of a recording's columns: whether two pages speak of the same data."""
    digest = hashlib.sha256()
    for name, values in recording.columns.items():
        digest.update(name.encode())
        digest.update(np.ascontiguousarray(values, "<f8").tobytes())
    return digest.hexdigest()[:_DIGITS]
