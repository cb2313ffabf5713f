"""A log of another program as a table: what every reader gives."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from ...models.errors import InputError, first_line

LABELS = ("name", "names", "joint_names", "interface_names", "actuator_names")
"""Lists of names of other lists' elements, as `sensor_msgs/JointState` has."""


class Log:
    """A log as a table: names of its columns, and their values when they are asked for."""

    path: Path
    names: list[str]
    note = ""
    """What was left out, or read otherwise than it says."""
    why = ""
    """Why a column may not be found."""
    units: Mapping[str, str] = {}
    """Of columns, in small letters, where the log has a row of them."""

    def find(self, column: str) -> str | None:
        """Return the log's name of a column: the same, or the only one with this ending; `a.b` and `a[0]` are `a/b` and `a/0`."""
        if column in self.names:
            return column
        plain = {name: _plain(name) for name in self.names}
        for fits in (lambda name: name == _plain(column), lambda name: name.endswith("/" + _plain(column))):
            found = [name for name, one in plain.items() if fits(one)]
            if len(found) == 1:
                return found[0]
        return None

    def read(self, wanted: list[str]) -> dict[str, np.ndarray]:
        """Columns as numbers, dates or clock times, shape (n,) each, of the same length; NaN or NaT for a cell that is none."""
        raise NotImplementedError

    def row(self, index: int) -> str:
        """A row for people, counted from 0."""
        return f"row {index}"

    def fault(self, column: str, index: int) -> str:
        """What is wrong with a cell that is no number."""
        return f"column {column!r}, {self.row(index)}: expected a finite number, got none"


def _plain(name: str) -> str:
    return re.sub(r"[./\[\]()]+", "/", name).strip("/ #%")


@contextmanager
def reading(path: Path, what: str) -> Iterator[None]:
    """Say in one line that a file is damaged, for any error of its library."""
    try:
        yield
    except InputError:
        raise
    except Exception as error:
        raise InputError(f"{path}: not a readable {what}: {first_line(error)}") from error


@contextmanager
def needing(packages: str, what: str, extra: str = "logs") -> Iterator[None]:
    """Say in one line which packages are not installed."""
    try:
        yield
    except ImportError as error:
        raise InputError(f"{what}: expected the {packages}; install flexspline[{extra}]") from error
