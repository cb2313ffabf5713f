"""Long series in parts, and columns in files instead of memory."""

from __future__ import annotations

import threading
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np

from .tables import naming

BLOCK = 1 << 16
"""Samples of a long series per part: they fit a processor's cache."""


def parts(count: int, block: int = BLOCK) -> Iterator[slice]:
    """Yield the parts of a series of `count` samples, each of `block`, the last of the rest."""
    return (slice(begin, min(begin + block, count)) for begin in range(0, count, block))


class StoredColumns(Mapping[str, np.ndarray]):
    """Columns of float64 by name, shape (n,) each, in memory or in files; parts without values are NaN."""

    def __init__(self, n: int, folder: Path | None = None, stem: str = ""):
        """Start without columns. `folder`: existing, for files whose names begin with `stem`; None: in memory."""
        self._n, self._folder, self._stem = n, folder, stem
        self._columns: dict[str, Path | np.ndarray] = {}
        self._lock = threading.Lock()

    def put(self, name: str, part: slice, values: np.ndarray) -> None:
        """Write a part of a column."""
        with self._lock:
            column = self._columns.get(name)
            if column is None:
                column = self._columns[name] = self._blank()
        if isinstance(column, np.ndarray):
            column[part] = values
            return
        with naming(column), column.open("r+b") as file:
            file.seek(8 * part.start)
            file.write(np.ascontiguousarray(values, dtype=np.float64).data)

    def _blank(self) -> Path | np.ndarray:
        if self._folder is None:
            return np.full(self._n, np.nan)
        path = self._folder / f"{self._stem}_{len(self._columns)}"
        with naming(path), path.open("wb") as file:
            for part in parts(self._n):
                file.write(np.full(part.stop - part.start, np.nan).data)
        return path

    def keep(self, names: Sequence[str]) -> None:
        """Select and order columns."""
        self._columns = {name: self._columns[name] if name in self._columns else self._blank() for name in names}

    def __getitem__(self, name: str) -> np.ndarray:
        column = self._columns[name]
        if isinstance(column, np.ndarray):
            return column
        return np.asarray(np.memmap(column, np.float64, "r", shape=(self._n,)))

    def __iter__(self) -> Iterator[str]:
        return iter(self._columns)

    def __len__(self) -> int:
        return len(self._columns)
