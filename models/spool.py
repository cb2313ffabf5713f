"""Columns that wait until they are asked for, in files where a long recording makes many of them."""

from __future__ import annotations

import threading
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np

from . import streams
from .tables import naming


class Spool(Mapping[str, np.ndarray]):
    """Columns of float64 by name, shape (n,) each; of those in files memory holds what is being read."""

    def __init__(self, n: int, folder: Path | None = None, stem: str = ""):
        """Nothing yet; `folder`: that is there, for files whose names begin with `stem`; None: all is in memory."""
        self._n, self._folder, self._stem = n, folder, stem
        self._columns: dict[str, Path | np.ndarray] = {}
        self._lock = threading.Lock()

    def put(self, name: str, part: slice, values: np.ndarray) -> None:
        """Write a part of a column; what was not written is NaN."""
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
            for blank in streams.parts(self._n):
                file.write(np.full(blank.stop - blank.start, np.nan).data)
        return path

    def keep(self, names: Sequence[str]) -> None:
        """Have the columns of these names, in their order; one that was never written is NaN."""
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
