"""Tables of other programs: columns by name from CSV and Parquet files; those of messages are in `messages`."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from ...models.errors import InputError
from ...models.recording import CsvFormat, csv_format, csv_header, read_csv_columns
from ...models.tables import reading_parquet


class Log(Protocol):
    """A log as a table: names of its columns, and their values when they are asked for."""

    @property
    def names(self) -> list[str]:
        """Names of the columns that can be asked for."""

    def read(self, wanted: list[str]) -> dict[str, np.ndarray]:
        """Columns as numbers, shape (n,) each, all of the same length; a cell that is no number is an error or NaN."""

    def row(self, index: int) -> str:
        """A row for people, counted from 0."""


def open_log(path: Path, sources: Iterable[str], separator: str | None = None, decimal: str | None = None) -> Log:
    """Open a log by what it is: Parquet, MCAP, a ROS 2 bag (its folder, or one of its files), else CSV.

    Args:
      path: of the file or folder.
      sources: columns that are going to be asked for, which say what topics are of interest.
      separator, decimal: of a CSV file; found in it where they are not stated.

    Raises:
      InputError: one that cannot be read.
    """
    if path.is_dir() or path.suffix in (".mcap", ".db3"):
        from .messages import open_messages

        return open_messages(path, sources)
    if path.suffix in (".parquet", ".pq"):
        return _Parquet(path)
    form = csv_format(path, separator, decimal)
    return _Csv(path, form, csv_header(path, form))


@dataclass(frozen=True)
class _Csv:
    path: Path
    form: CsvFormat
    names: list[str]

    def read(self, wanted: list[str]) -> dict[str, np.ndarray]:
        return read_csv_columns(self.path, wanted, self.form)

    def row(self, index: int) -> str:
        return f"row {index} (line {index + 2})"


class _Parquet:
    def __init__(self, path: Path):
        self.path = path
        with reading_parquet(path):
            self.file = pq.ParquetFile(path)
            self.schema = self.file.schema_arrow

    @property
    def names(self) -> list[str]:
        return list(self.schema.names)

    def read(self, wanted: list[str]) -> dict[str, np.ndarray]:
        with reading_parquet(self.path):
            table = self.file.read(wanted)
        return {name: self._numbers(name, table.column(name)) for name in wanted}

    def _numbers(self, name: str, column: pa.ChunkedArray) -> np.ndarray:
        kind = column.type
        if pa.types.is_timestamp(kind) or pa.types.is_duration(kind):
            # Seconds since the first: as a float, a date of today has lost a quarter of a microsecond.
            unit = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}[kind.unit]
            ticks = column.cast(pa.int64())
            first = next((t.as_py() for t in ticks if t.is_valid), 0)
            return unit * pc.subtract(ticks, first).cast(pa.float64()).to_numpy()
        if not (pa.types.is_floating(kind) or pa.types.is_integer(kind) or pa.types.is_decimal(kind)):
            raise InputError(f"{self.path}: column {name!r}: expected numbers, got {kind}")
        # Whole numbers beyond 2⁵³, as nanoseconds of a date of today, lose their last digits: a quarter of a microsecond.
        return column.cast(pa.float64(), safe=not pa.types.is_integer(kind)).to_numpy()

    def row(self, index: int) -> str:
        return f"row {index}"
