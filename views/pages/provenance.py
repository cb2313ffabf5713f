"""Where a page comes from: date, versions, and the data."""

from __future__ import annotations

import hashlib
import platform
from datetime import datetime
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from ...models.recording import Recording

_DIGITS = 12


def now() -> str:
    """Return date and time, as pages state them."""
    return datetime.now().astimezone().strftime("%Y-%m-%d %H:%M %Z")


def versions() -> dict[str, str]:
    """Return the versions of this package and of what computes, by name."""
    packages = {name: metadata.version(name) for name in ("flexspline", "mujoco", "numpy", "scipy")}
    return packages | {"Python": platform.python_version()}


def file_digest(path: Path) -> str:
    """Return the first digits of a file's SHA-256."""
    return hashlib.sha256(path.read_bytes()).hexdigest()[:_DIGITS]


def fingerprint(recording: Recording) -> str:
    """Return the first digits of the SHA-256 of a recording's columns: equal for the same data."""
    digest = hashlib.sha256()
    for name, values in recording.columns.items():
        digest.update(name.encode())
        digest.update(np.ascontiguousarray(values, "<f8").tobytes())
    return digest.hexdigest()[:_DIGITS]
