"""Tables of float64 columns as Parquet files, with units and notes in the columns' metadata."""

from __future__ import annotations

import errno
import os
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from .errors import InputError, first_line

ROWS = 1 << 20  # rows of a Parquet group
Notes = Mapping[str, Mapping[str, str]]


@contextmanager
def table_writer(
    path: Path, units: Mapping[str, str], notes: Notes | None = None, metadata: Mapping[str, str] | None = None
) -> Iterator[Callable[[Mapping[str, np.ndarray]], None]]:
    """Yield a function that writes the next rows of a new table, a group of rows a call: columns by name, shape (n,) each.
    `units`: of every column, in order; `notes`: other metadata of a column; `metadata`: of the table."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    fields = [
        pa.field(name, pa.float64(), nullable=False, metadata={"unit": unit, **(notes or {}).get(name, {})})
        for name, unit in units.items()
    ]
    schema = pa.schema(fields, dict(metadata or {}))
    with naming(path):
        # Measured numbers rarely repeat: a dictionary costs time and saves nothing.
        writer = pq.ParquetWriter(path, schema, compression="zstd", use_dictionary=False)

    def write(columns: Mapping[str, np.ndarray]) -> None:
        # `pyarrow.array` would import pandas.
        numbers = [np.ascontiguousarray(columns[name], dtype=np.float64) for name in schema.names]
        arrays = [pa.Array.from_buffers(pa.float64(), len(x), [None, pa.py_buffer(x)]) for x in numbers]
        with naming(path):
            writer.write_table(pa.Table.from_arrays(arrays, schema=schema))

    try:
        yield write
    finally:
        with naming(path):
            writer.close()


def write_table(
    path: Path,
    columns: Mapping[str, np.ndarray],
    units: Mapping[str, str],
    notes: Notes | None = None,
    metadata: Mapping[str, str] | None = None,
) -> None:
    """Write columns, shape (n,) each, as Parquet; units, notes and metadata as for `table_writer`."""
    with table_writer(path, {name: units[name] for name in columns}, notes, metadata) as write:
        write(columns)


@contextmanager
def naming(path: Path) -> Iterator[None]:
    """Add the file's name to errors of the system, such as a full disk: Arrow and NumPy do not."""
    try:
        yield
    except OSError as error:
        number = error.errno or next((n for n in (errno.ENOSPC, errno.EDQUOT) if os.strerror(n) in str(error)), 0)
        if error.filename or not number:
            raise
        raise OSError(number, os.strerror(number), str(path)) from error


@contextmanager
def reading_parquet(path: Path) -> Iterator[None]:
    """Turn errors of a Parquet file into one line. Raises `InputError`: it cannot be read."""
    import pyarrow as pa

    try:
        yield
    except InputError:
        raise
    except (OSError, pa.ArrowException, ValueError, LookupError, ArithmeticError, TypeError) as error:  # a bad footer
        raise InputError(f"{path}: not a readable Parquet file: {first_line(error)}") from error


def read_table(path: Path) -> tuple[dict[str, np.ndarray], dict[str, dict[str, str]]]:
    """Return the columns of a Parquet file, shape (n,) each, and their metadata (`unit`, notes). Raises `InputError`:
    not a Parquet file."""
    import pyarrow.parquet as pq

    with reading_parquet(path):
        table = pq.read_table(path)
        # Names are decoded on access.
        columns = {name: table.column(name).to_numpy() for name in table.column_names}
        notes = {f.name: {k.decode(): v.decode() for k, v in (f.metadata or {}).items()} for f in table.schema}
    return columns, notes
