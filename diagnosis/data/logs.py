"""Tables of other programs: columns by name, from any file that is read; those of messages are in `messages`.

A reader gives nested arrays, and `Arrays` makes columns of them: a group, struct or record is a part of a name (`arm/q`), and so
is an element of a list, by its index (`observation.state/0`).
"""

from __future__ import annotations

import json
import math
import re
import zipfile
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from io import BytesIO
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from ...models.errors import InputError, first_line
from ...models.tables import reading_parquet
from ...models.text_tables import TextForm, TextTable, elements, find_head, numbers
from .log import LABELS, Log, needing, reading
from .messages import open_messages

READ = "CSV and other text, Parquet, JSON, NumPy, MATLAB, HDF5, Excel (.xlsx), Arrow, MCAP, ROS 1 and ROS 2 bags"
_WIDEST = 512  # elements of a row of an array: more is an image


@dataclass(frozen=True)
class LogForm:
    """What a mapping states of a log's form."""

    text: TextForm = field(default_factory=TextForm)
    interleaved: Mapping[str, int] = field(default_factory=dict)
    """Columns that take turns in a file of one number a line, by patterns of file names."""


# Arrays -----------------------------------------------------------------------------------------------------------------------


def _leaves(value: Any, name: str = "") -> Iterator[tuple[str, np.ndarray]]:
    """Arrays in nested ones, with their names; what is neither is left out."""
    if isinstance(value, Mapping):
        if value and all(str(key).isdecimal() for key in value):  # a column by the numbers of its rows
            yield from _leaves(list(value.values()), name)
            return
        for key, one in value.items():
            for inner, leaf in _leaves(one, f"{name}/{key}" if name else str(key)):
                yield from _labelled(inner, leaf, value)
        return
    if isinstance(value, list):
        value = _array(value)
    if not isinstance(value, np.ndarray) or value.ndim == 0 or (value.dtype.kind in "cV" and not value.dtype.names):
        return
    if value.dtype.names:
        yield from _leaves({key: value[key] for key in value.dtype.names}, name)
        return
    if value.dtype.kind == "O":
        flat = value.ravel()
        some = [one for one in flat if one is not None]
        if some and all(isinstance(one, Mapping) for one in some):
            keys = dict.fromkeys(key for one in some for key in one)
            yield from _leaves({key: [(one or {}).get(key) for one in flat] for key in keys}, name)
            return
        if some and all(isinstance(one, (list, tuple, np.ndarray)) or elements(one) for one in some):
            found = [elements(one) if not _is_text(one) else list(one) for one in flat]
            width, text = max(map(len, found)), any(map(_is_text, some))
            if 0 < width <= _WIDEST and value.ndim == 1:
                fill = "" if text else np.nan
                rows = [[*one, *[fill] * (width - len(one))] for one in found]
                yield name, np.array(rows, dtype=str if text else None)
            return
    yield name, value


def _is_text(one: Any) -> bool:
    return isinstance(one, (list, tuple, np.ndarray)) and len(one) > 0 and all(isinstance(x, str) for x in one)


def _array(values: list) -> np.ndarray:
    """A list as an array: of numbers, where it has such alone, else of objects, shape (n,) or (n, k)."""
    try:
        found = np.array(values)
        if found.dtype.kind in "fiub":
            return found
    except (ValueError, OverflowError, TypeError):
        pass
    found = np.empty(len(values), dtype=object)
    found[:] = values
    return found


def _labelled(name: str, leaf: np.ndarray, around: Mapping[str, Any]) -> Iterator[tuple[str, np.ndarray]]:
    """Split an array into columns if a list next to it names its elements; return other arrays unchanged."""
    if leaf.ndim == 2 and leaf.dtype.kind not in "US":
        for key in (*LABELS, "columns"):
            found = around.get(key)
            first = found[0] if isinstance(found, list) and found and isinstance(found[0], list) else found
            if isinstance(first, (list, np.ndarray)) and len(first) == leaf.shape[1] and _is_text(first):
                for k, label in enumerate(first):
                    yield f"{name.rpartition('/')[0] if key == 'columns' else name}/{label}".strip("/"), leaf[:, k]
                return
    yield name, leaf


class Arrays(Log):
    """Nested arrays as a table."""

    def __init__(self, path: Path, tree: Any, note: str = ""):
        self.path, self.note = path, note
        leaves = [(name, leaf) for name, leaf in _leaves(tree) if leaf.size]
        sizes = Counter(size for _, leaf in leaves for size in {s for s in leaf.shape if s > 1})
        self.rows = max(sizes, key=lambda size: (sizes[size], size), default=0)
        self._columns: dict[str, np.ndarray] = {}
        for name, leaf in leaves:
            if self.rows in leaf.shape:
                leaf = np.moveaxis(leaf, leaf.shape.index(self.rows), 0)
            width = math.prod(leaf.shape[1:])
            if width > _WIDEST:
                continue
            for at in np.ndindex(leaf.shape[1:]):
                key = "/".join(filter(None, [name, *(map(str, at) if width > 1 else ())]))
                self._columns[key] = leaf[(slice(None), *at)]
        self.names = list(self._columns)

    def read(self, wanted: list[str]) -> dict[str, np.ndarray]:
        found = {name: self._numbers(self._columns[name]) for name in wanted}
        first = wanted[0]
        for name, values in found.items():
            if len(values) != len(found[first]):
                raise InputError(
                    f"{self.path}: column {name!r}: expected {len(found[first])} rows, as {first!r} has, got {len(values)}"
                )
        return found

    @staticmethod
    def _numbers(values: np.ndarray) -> np.ndarray:
        if values.dtype.kind in "mM":
            return values.astype(f"{'timedelta64' if values.dtype.kind == 'm' else 'datetime64'}[ns]")
        if values.dtype.kind in "fiub":  # nanoseconds of a date of today lose a quarter of a microsecond
            return values.astype(np.float64)
        cells = [one.decode(errors="replace") if isinstance(one, bytes) else one for one in values.tolist()]
        return numbers(cells)

    def fault(self, column: str, index: int) -> str:
        cell = self._columns[column][index]
        said = "none" if cell is None else repr(cell) if isinstance(cell, str) else str(cell)
        return f"column {column!r}, {self.row(index)}: expected a finite number, got {said}"


# Files ------------------------------------------------------------------------------------------------------------------------

Source = Path | BytesIO
Reader = Callable[[Source, set[str], TextForm], Any]
"""Reads nested arrays from a file, with a note if some are left out; gets the wanted columns and the table's stated form."""


def _bytes(source: Source) -> bytes:
    return source.read_bytes() if isinstance(source, Path) else source.getvalue()


def _numpy(source: Source, wanted: set[str], form: TextForm) -> Any:
    found = np.load(source)
    if isinstance(found, np.ndarray):
        return found
    tree = {}
    with found:
        for name in found.files:
            try:
                tree[name] = found[name]
            except ValueError:  # Python objects, which are not unpacked, as they can run code
                if name in wanted:
                    raise
    return tree


def _matlab(source: Source, wanted: set[str], form: TextForm) -> Any:
    from scipy.io import loadmat

    def plain(value: Any) -> Any:
        if isinstance(value, Mapping):
            return {key: plain(one) for key, one in value.items()}
        if isinstance(value, (list, np.ndarray)) and getattr(value, "dtype", np.dtype("O")).kind == "O":
            return [plain(one) for one in value]
        return value

    found = {k: v for k, v in loadmat(source, simplify_cells=True).items() if not k.startswith("__")}
    if any(type(value).__name__ == "MatlabOpaque" for value in found.values()) and not wanted <= found.keys():
        raise ValueError(
            "it has tables, timetables or other objects of MATLAB, which it alone reads: save arrays or structs"
        )
    return {key: plain(value) for key, value in found.items()}


def _hdf5(source: Source, wanted: set[str], form: TextForm) -> Any:
    with needing("package h5py", "reading HDF5 and MATLAB 7.3 files"):
        import h5py

    def plain(group: Any) -> dict[str, Any]:
        tree: dict[str, Any] = {}
        for key, one in group.items():
            if key.startswith("#") or one is None:
                continue
            if isinstance(one, h5py.Group):
                tree[key] = plain(one)
            elif one.dtype.kind in "fiubVSO" and one.size and one.size <= _WIDEST * max(one.shape, default=1):
                if h5py.check_ref_dtype(one.dtype) is None and one.attrs.get("MATLAB_class") != b"char":
                    tree[key] = one[()].T if "MATLAB_class" in one.attrs else one[()]
        for key in [key for key in tree if key.endswith("_items") and f"{key[:-6]}_values" in tree]:  # of pandas
            names = [n.decode() if isinstance(n, bytes) else str(n) for n in tree.pop(key)]
            tree |= dict(zip(names, np.transpose(tree.pop(f"{key[:-6]}_values")), strict=True))
        return tree

    with h5py.File(source, "r") as file:
        return plain(file)


def _excel(source: Source, wanted: set[str], form: TextForm) -> Any:
    with needing("package openpyxl", "reading Excel files"):
        from openpyxl import load_workbook
    book = load_workbook(source, read_only=True, data_only=True)
    sheets: dict[str, dict[str, list]] = {}
    for sheet in book.worksheets:
        rows = [row for row in sheet.iter_rows(values_only=True)][form.skip :]
        while rows and not any(cell is not None for cell in rows[-1]):
            rows.pop()
        width = max((j + 1 for row in rows for j, cell in enumerate(row) if cell is not None), default=0)
        texts = [["" if cell is None else str(cell).strip() for cell in row[:width]] for row in rows[:400]]
        # A row with one cell is a title.
        rows_ = [row[: len(row) if any(row[1:]) else int(any(row))] if len(row) > 1 else row for row in texts]
        head = find_head(rows_, wanted, form.headless)
        body = [row for row in rows[head.begin :] if any(cell is not None for cell in row)]
        sheets[sheet.title] = {name: [row[j] for row in body] for j, name in enumerate(head.names) if body}
    found = {title: columns for title, columns in sheets.items() if columns}
    return next(iter(found.values())) if len(found) == 1 else found


def _json(source: Source, wanted: set[str], form: TextForm) -> Any:
    from ...models.text_tables import decoded

    text = decoded(_bytes(source)) or ""
    try:
        return _split_table(json.loads(text))
    except (ValueError, RecursionError) as error:
        lines = [line for line in text.splitlines() if line.strip()]
        entries, note = [], ""
        for i, line in enumerate(lines):
            try:
                entries.append(json.loads(line))
            except (ValueError, RecursionError):
                if i < len(lines) - 1 or i < 2:
                    raise ValueError(first_line(error)) from None
                note = "the last line is left out: it is incomplete"
        return entries, note


def _split_table(data: Any) -> Any:
    """Convert a table of rows, with names (`columns` and `data`) or without, to columns; return other data unchanged."""
    if isinstance(data, dict) and isinstance(data.get("columns"), list) and isinstance(data.get("data"), list):
        columns = [c.get("name", "") if isinstance(c, dict) else str(c) for c in data["columns"]]
        return dict(zip(columns, map(list, zip(*data["data"], strict=False)), strict=False))
    if isinstance(data, list) and data and isinstance(data[0], list) and _is_text(data[0]):
        return dict(zip(data[0], map(list, zip(*data[1:], strict=False)), strict=False))
    return data


def _arrow(source: Source, wanted: set[str], form: TextForm) -> Any:
    import pyarrow.feather as feather

    return _arrow_columns(feather.read_table(source))


def _arrow_columns(table: Any) -> dict[str, Any]:
    return {name: _arrow_column(table.column(name)) for name in table.column_names}


def _arrow_column(column: Any) -> Any:
    """A column of Arrow as an array, shape (n,) or (n, k)."""
    import pyarrow as pa

    kind = column.type
    if pa.types.is_dictionary(kind):
        column = column.cast(kind.value_type)
        kind = column.type
    if pa.types.is_timestamp(kind) or pa.types.is_date(kind):
        return column.cast(pa.timestamp("ns")).to_numpy()
    if pa.types.is_duration(kind) or pa.types.is_time(kind):
        ticks = column.cast(pa.time64("ns") if pa.types.is_time(kind) else pa.duration("ns"))
        return ticks.cast(pa.int64()).to_numpy().astype("timedelta64[ns]")
    if pa.types.is_integer(kind) and not column.null_count:
        return column.to_numpy()
    if pa.types.is_primitive(kind) or pa.types.is_decimal(kind):  # numbers, also with empty cells, and booleans
        return column.cast(pa.float64(), safe=False).to_numpy()
    if pa.types.is_list(kind) or pa.types.is_large_list(kind) or pa.types.is_fixed_size_list(kind):
        flat = column.combine_chunks().flatten() if len(column) else []
        width = len(flat) // max(len(column), 1)
        whole = width and not column.null_count and len(flat) == width * len(column)
        if whole and (pa.types.is_fixed_size_list(kind) or set(map(len, column.slice(0, 100))) == {width}):
            return np.asarray(_arrow_column(pa.chunked_array([flat]))).reshape(len(column), width)
    return column.to_pylist()


class _Parquet(Log):
    """A Parquet file: the names are those of its first rows, and what is read are the columns that are wanted."""

    def __init__(self, path: Path, source: Source):
        import pyarrow as pa
        import pyarrow.parquet as pq

        self.path = path
        self._table: Arrays | None = None
        with reading_parquet(path):
            self._file = pq.ParquetFile(source)
            first = pa.Table.from_batches(islice(self._file.iter_batches(1000), 1), self._file.schema_arrow)
        tree = _arrow_columns(first) if len(first) else dict.fromkeys(first.column_names, np.zeros(1))
        self.names = Arrays(path, tree).names

    def read(self, wanted: list[str]) -> dict[str, np.ndarray]:
        roots = self._file.schema_arrow.names
        mine = [max((one for one in roots if f"{name}/".startswith(f"{one}/")), key=len) for name in wanted]
        with reading_parquet(self.path):
            tree = _arrow_columns(self._file.read(list(dict.fromkeys(mine)), use_pandas_metadata=False))
        if not self._file.metadata.num_rows:
            return {name: np.empty(0) for name in wanted}
        self._table = Arrays(self.path, tree)
        return self._table.read(wanted)

    def fault(self, column: str, index: int) -> str:
        return self._table.fault(column, index) if self._table else super().fault(column, index)


class _Text(Log):
    """A table as text."""

    def __init__(self, path: Path, source: Source, wanted: set[str], form: LogForm):
        self.path = path
        self._table = TextTable(path, _bytes(source), wanted, form.text)
        self.names = self._table.names
        self.units, self.why = self._table.head.units, self._table.head.why
        torn = self._table.torn
        self.note = f"the last line is left out: it is incomplete ({torn[:40]!r})" if torn else ""
        self._turns = next((k for pattern, k in form.interleaved.items() if fnmatchcase(path.name, pattern)), 0)
        if self._turns:
            if len(self.names) != 1:
                raise InputError(f"{path}: interleaved: expected one number a line, got {len(self.names)} columns")
            self.names = [str(k) for k in range(self._turns)]

    def read(self, wanted: list[str]) -> dict[str, np.ndarray]:
        if not self._turns:
            return self._table.read(wanted)
        ((name, values),) = self._table.read(self._table.names).items()
        if len(values) % self._turns:
            raise InputError(
                f"{self.path}: interleaved: expected a multiple of {self._turns} numbers, got {len(values)} ({name!r})"
            )
        return {one: values[int(one) :: self._turns] for one in wanted}

    def row(self, index: int) -> str:
        return self._table.row(index * (self._turns or 1))

    def fault(self, column: str, index: int) -> str:
        if not self._turns:
            return self._table.fault(column, index)
        return self._table.fault(self._table.names[0], index * self._turns + int(column))


_NO_TABLES = (".urdf", ".xml", ".yaml", ".yml", ".md", ".py", ".png", ".jpg", ".mp4", ".pdf", "")


class _Folder(Log):
    """Files of a folder that belong together, row by row: columns are `FILE/COLUMN`."""

    def __init__(self, path: Path, wanted: set[str] | None, form: LogForm):
        self.path = path
        files = [one for one in sorted(path.iterdir()) if one.is_file() and one.suffix not in _NO_TABLES]
        mine = {
            one: None if wanted is None else {n[len(one.name) + 1 :] for n in wanted if n.startswith(f"{one.name}/")}
            for one in files
        }
        asked = {one: inner for one, inner in mine.items() if inner is None or inner}
        if not asked:
            raise InputError(
                f"{path}: expected a ROS 2 bag with its metadata.yaml, found none; or columns of files in it as FILE/COLUMN, "
                f"got none of {', '.join(one.name for one in files[:8]) or 'no file'}"
            )
        self._logs: dict[str, Log] = {}
        for one, inner in asked.items():
            try:
                self._logs[one.name] = open_log(one, inner, form)
            except InputError:
                if wanted is not None:
                    raise
        self.names = [f"{file}/{name}" for file, log in self._logs.items() for name in log.names]
        self.note = "; ".join(f"{file}: {log.note}" for file, log in self._logs.items() if log.note)

    def _split(self, column: str) -> tuple[Log, str]:
        file = max((one for one in self._logs if column.startswith(f"{one}/")), key=len)
        return self._logs[file], column[len(file) + 1 :]

    def read(self, wanted: list[str]) -> dict[str, np.ndarray]:
        found: dict[str, np.ndarray] = {}
        for file, log in self._logs.items():
            mine = [column[len(file) + 1 :] for column in wanted if self._split(column)[0] is log]
            found |= {f"{file}/{name}": values for name, values in (log.read(mine) if mine else {}).items()}
        by_length = sorted(found, key=lambda column: len(found[column]))
        few, many = by_length[0], by_length[-1]
        if len(found[few]) != len(found[many]):
            raise InputError(
                f"{self.path}: expected as many rows in every file, got {len(found[few])} of {few!r} and {len(found[many])} of "
                f"{many!r} (`interleaved` is for a file of one number a line)"
            )
        return {column: found[column] for column in wanted}

    def fault(self, column: str, index: int) -> str:
        log, name = self._split(column)
        return f"{log.path.name}: {log.fault(name, index)}"


_MAGIC: tuple[tuple[bytes, str], ...] = (
    (b"PAR1", "parquet"), (b"\x93NUMPY", "numpy"), (b"\x89HDF\r\n\x1a\n", "hdf5"), (b"MATLAB 7.3", "hdf5"), (b"MATLAB", "matlab"),
    (b"SQLite format 3", "db3"), (b"\x89MCAP0\r\n", "mcap"), (b"#ROSBAG V", "bag"), (b"ARROW1", "arrow"), (b"FEA1", "arrow"),
    (b"\xd0\xcf\x11\xe0", "xls"), *((bytes([0x80, version]), "pickle") for version in range(2, 6)),
)  # fmt: skip
_SUFFIXES = {
    ".parquet": "parquet", ".pq": "parquet", ".npz": "numpy", ".npy": "numpy", ".mat": "matlab", ".h5": "hdf5", ".hdf5": "hdf5",
    ".xlsx": "excel", ".xlsm": "excel", ".json": "json", ".jsonl": "json", ".ndjson": "json", ".mcap": "mcap", ".db3": "db3",
    ".bag": "bag", ".feather": "arrow", ".arrow": "arrow", ".pkl": "pickle", ".pickle": "pickle", ".xls": "xls",
}  # fmt: skip
_READERS: dict[str, tuple[Reader, str]] = {
    "numpy": (_numpy, "NumPy file"),
    "matlab": (_matlab, "MATLAB file"),
    "hdf5": (_hdf5, "HDF5 file"),
    "json": (_json, "JSON file"),
    "arrow": (_arrow, "Arrow file"),
    "excel": (_excel, "Excel file"),
}
_REFUSED = {
    "pickle": "a pickle file can run code when it is read: save the columns as CSV, Parquet or npz",
    "xls": "the older Excel format: save it as .xlsx or CSV",
    "zip": "an archive: unpack it first",
    "markup": "XML or HTML: save the columns as CSV",
}


def _kind_of(path: Path, start: bytes, source: Source) -> str:
    """What a file is, by its first bytes, or else by its name."""
    if start.startswith(b"PK\x03\x04"):
        inside: list[str] = []
        with suppress(OSError, ValueError, NotImplementedError, zipfile.BadZipFile), zipfile.ZipFile(source) as archive:
            inside = archive.namelist()
        if "xl/workbook.xml" in inside:
            return "excel"
        return "numpy" if (inside and all(name.endswith(".npy") for name in inside)) or path.suffix == ".npz" else "zip"
    suffix = _SUFFIXES.get(path.suffix.lower(), "")
    for magic, kind in _MAGIC:
        if start.startswith(magic):
            return kind
    if re.match(rb"(?:\xef\xbb\xbf)?\s*<[?!\w]", start):
        return "markup"
    if not suffix and re.match(rb"(?:\xef\xbb\xbf)?\s*(?:\{\s*[\"}]|\[\s*[\[{])", start):
        return "json"
    return suffix


def _unpacked(path: Path, start: bytes) -> tuple[Source, str]:
    """What is read of a file, and what was left out: a compressed one is unpacked."""
    import bz2
    import gzip
    import lzma
    import zlib

    openers: dict[bytes, Callable[[Path], Any]] = {b"\x1f\x8b": gzip.open, b"BZh": bz2.open, b"\xfd7zXZ": lzma.open}
    opener = next((one for magic, one in openers.items() if start.startswith(magic)), None)
    if opener is None:
        return path, ""
    found, note = BytesIO(), ""
    try:
        with opener(path) as stream:
            while part := stream.read1(1 << 16):
                found.write(part)
    except EOFError:
        note = "the compressed file is cut short, and what there is of it is read"
    except (OSError, lzma.LZMAError, zlib.error, ValueError) as error:
        raise InputError(f"{path}: not a readable compressed file: {first_line(error)}") from error
    found.seek(0)
    return found, note


def open_log(path: Path, sources: Iterable[str] | None = None, form: LogForm | None = None) -> Log:
    """Open a log of any supported format.

    Args:
      path: of the file, of a ROS 2 bag's folder, or of a folder of files.
      sources: columns that are going to be asked for, which say what header and what topics are of interest; None: all.
      form: what is stated of it.

    Raises:
      InputError: an unreadable log.
    """
    wanted, form = None if sources is None else set(sources), form or LogForm()
    if path.is_dir():
        return open_messages(path, wanted) if (path / "metadata.yaml").is_file() else _Folder(path, wanted, form)
    try:
        with path.open("rb") as file:
            start = file.read(600)
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from error
    source, note = _unpacked(path, start)
    packed = not isinstance(source, Path)
    kind = _kind_of(path.with_suffix(""), _bytes(source)[:600], source) if packed else _kind_of(path, start, source)
    if kind in _REFUSED:
        raise InputError(f"{path}: not a format that is read: {_REFUSED[kind]}")
    if kind in ("bag", "mcap", "db3"):
        if packed:
            raise InputError(f"{path}: expected a bag or MCAP file that is not compressed as a whole; unpack it first")
        return open_messages(path, wanted)
    log: Log
    if kind == "parquet":
        log = _Parquet(path, source)
    elif kind in _READERS:
        reader, what = _READERS[kind]
        with reading(path, what):
            tree = reader(source, wanted or set(), form.text)
            log = Arrays(path, *(tree if isinstance(tree, tuple) else (tree,)))
        if not log.names:
            raise InputError(f"{path}: expected arrays or columns of numbers in the {what}, found none")
    else:
        try:
            log = _Text(path, source, wanted or set(), form)
        except InputError as error:
            if "no text" in str(error):
                raise InputError(f"{path}: not a format that is read ({READ})") from error
            raise
    log.note = "; ".join(filter(None, (log.note, note)))
    return log
