"""Columns that wait in files until they are asked for: what a long recording makes many of."""

from __future__ import annotations

import threading
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np

from . import streams
from .tables import naming


class Spool(Mapping[str, np.ndarray]):
    """Columns of float64 by name, shape (n,) each, in files; memory holds what of one is being read."""

    def __init__(self, folder: Path, stem: str, n: int):
        """Nothing yet; `stem`: of the files' names in the folder, which is there."""
        self._folder, self._stem, self._n = folder, stem, n
        self._files: dict[str, Path] = {}
        self._lock = threading.Lock()

    def put(self, name: str, part: slice, values: np.ndarray) -> None:
        """Write a part of a column; what was not written is NaN."""
        with self._lock:
            new = name not in self._files
            path = self._files.setdefault(name, self._folder / f"{self._stem}_{len(self._files)}")
        with naming(path):
            if new:
                with path.open("wb") as file:
                    for blank in streams.parts(self._n):
                        file.write(np.full(blank.stop - blank.start, np.nan).data)
            with path.open("r+b") as file:
                file.seek(8 * part.start)
                file.write(np.ascontiguousarray(values, dtype=np.float64).data)

    def keep(self, names: Sequence[str]) -> None:
        """Have the columns of these names, in their order; one that was never written is NaN."""
        for name in names:
            if name not in self._files:
                self.put(name, slice(0, 0), np.empty(0))
        self._files = {name: self._files[name] for name in names}

    def __getitem__(self, name: str) -> np.ndarray:
        return np.asarray(np.memmap(self._files[name], np.float64, "r", shape=(self._n,)))

    def __iter__(self) -> Iterator[str]:
        return iter(self._files)

    def __len__(self) -> int:
        return len(self._files)
