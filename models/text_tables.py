"""Tables as text (CSV and similar) of users and programs.

Encoding, separator, decimal mark and header line are detected if not stated. Lines before the header, comments, a row
of units and an incomplete last line are not rows.
"""

from __future__ import annotations

import csv
import re
import warnings
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from datetime import date, time, timedelta
from io import StringIO
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from .errors import InputError

COMMENTS = ("#", "%", "//")
_SEPARATORS = ",;\t| "
_LOOKED_AT = 400  # lines
_BLOCK = 1 << 16  # rows that are converted at once
_NUMBER = re.compile(r"[-+]?(?:\d+(?:([.,])\d*)?|([.,])\d+)(?:[eE][-+]?\d+)?|[-+]?(?:nan|inf|infinity)", re.IGNORECASE)
_CLOCK = re.compile(r"(?:(\d+):)?(\d{1,2}):(\d{1,2})(?:([.,:])(\d+))?")
_DATE = re.compile(
    r"\d+[-/.]\w+[-/.]\d+[T ]\s*\d+:\d\d(?::\d\d(?:[.,:]\d+)?)?\s*(?:[AP]M|Z|UTC|[-+]\d\d:?\d\d)?", re.IGNORECASE
)
_LIST = re.compile(r"[\[(]\s*[-+.\d].*[\])]", re.DOTALL)


@dataclass(frozen=True)
class TextForm:
    """Text format of a table; None is detected."""

    separator: str | None = None
    decimal: str | None = None
    skip: int = 0
    """Lines to skip at the start."""
    headless: bool = False
    """Whether columns are named by number in spite of a header."""


# Cells ------------------------------------------------------------------------------------------------------------------------


def _kind(cell: str) -> str:
    """Return the kind of a cell: `number`, `date`, `clock`, `list`, or empty."""
    if _NUMBER.fullmatch(cell):
        return "number"
    if _CLOCK.fullmatch(cell):
        return "clock"
    if _LIST.fullmatch(cell):
        return "list"
    return "date" if _DATE.fullmatch(cell) else ""


def elements(cell: object) -> list[float]:
    """Return the numbers of a list in a cell, `[1, 2]` or `[1 2]`; empty for other cells."""
    if isinstance(cell, str):
        cell = re.split(r"[,;\s]+", cell.strip().strip("[]()").strip()) if _LIST.fullmatch(cell.strip()) else []
    return [_number(one, ".") for one in cell] if isinstance(cell, (list, tuple, np.ndarray)) else []


def _number(cell: object, decimal: str) -> float:
    if isinstance(cell, str):
        if decimal == ",":
            cell = "" if "." in cell else cell.replace(",", ".")
        if "_" in cell:  # allowed in Python's numbers
            return np.nan
    try:
        return float(cell)  # type: ignore[arg-type]
    except (TypeError, ValueError, OverflowError):
        return np.nan


def _clock(cell: str) -> np.timedelta64:
    found = _CLOCK.fullmatch(cell.strip())
    if not found:
        return np.timedelta64("NaT", "ns")
    hours, minutes, whole, mark, rest = found.groups()
    fraction = 0 if rest is None else int(rest) * 10**6 if mark == ":" else int(rest[:9].ljust(9, "0"))
    seconds = 3600 * int(hours or 0) + 60 * int(minutes) + int(whole)
    return np.timedelta64(seconds * 10**9 + fraction, "ns")


def _as_text(cell: object) -> str:
    if cell is None:
        return ""
    if isinstance(cell, time):
        return cell.isoformat()
    return cell.strip() if isinstance(cell, str) else str(cell)


def numbers(cells: Sequence[object] | np.ndarray, decimal: str = ".", like: np.dtype | None = None) -> np.ndarray:
    """Return cells of a column, text or numbers and dates, as float64, datetime64[ns] of dates, or timedelta64[ns] of
    clock times, shape (n,); NaN or NaT for other cells. `decimal`: mark of its numbers; `like`: type of earlier cells,
    by default detected."""
    kind = "" if like is None else {"f": "number", "M": "date", "m": "clock"}.get(like.kind, "")
    if not kind:
        some = [c for c in cells[:_LOOKED_AT] if c is not None]
        if some and all(isinstance(c, timedelta) for c in some):
            return np.array(cells, dtype="timedelta64[ns]")
        kinds = Counter(_kind(_as_text(c)) for c in some)
        kinds["date"] = max(kinds["date"], sum(isinstance(c, (date, np.datetime64)) for c in some))
        kind = max(("number", "date", "clock"), key=lambda k: kinds[k])
    elif kind == "number" and decimal == ".":
        with suppress(TypeError, ValueError, OverflowError):
            return np.array(cells, dtype=np.float64)
    if kind == "number":
        return np.array([_number(cell, decimal) for cell in cells], dtype=np.float64)
    if kind == "clock":
        return np.array([_clock(_as_text(cell)) for cell in cells], dtype="timedelta64[ns]")
    return _dates([_as_text(cell).replace(",", ".") for cell in cells])


def _dates(texts: list[str]) -> np.ndarray:
    """Return dates and times of text as datetime64[ns], NaT for other text. The order of day and month is that of the
    shorter log."""
    import pandas as pd

    def stamps(given: pd.Series, **how: Any) -> pd.Series:
        found = pd.to_datetime(given, errors="coerce", utc=True, **how).dt.tz_localize(None)
        return found.where((found > pd.Timestamp("1700")) & (found < pd.Timestamp("2250"))).astype("datetime64[ns]")

    given = pd.Series(texts, dtype=object)
    if re.match(r"\d{4}-", next((text for text in texts if text), "")):
        return stamps(given, format="ISO8601").to_numpy()
    found = []
    for dayfirst in (True, False):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # that the other order would also match
            one = stamps(given, dayfirst=dayfirst)
            if (others := one.isna() & (given != "")).any():
                one[others] = stamps(given[others], format="mixed", dayfirst=dayfirst)
        found.append((int(one.isna().sum()), one.max() - one.min(), one.to_numpy()))
    return min(found, key=lambda one: (one[0], one[1]))[2]


def seconds(stamps: np.ndarray) -> np.ndarray:
    """Return dates or clock times, shape (n,), as seconds since the first; clock times continue at midnight."""
    ticks = stamps.astype(np.int64)  # a float of today's date is wrong by up to a quarter of a microsecond
    there = ~np.isnat(stamps)
    found = np.full(len(stamps), np.nan)
    found[there] = 1e-9 * (ticks[there] - ticks[there][0]) if np.any(there) else 0.0
    if stamps.dtype.kind == "m":
        found[there] += 86400.0 * np.cumsum(np.diff(found[there], prepend=0.0) < -43200.0)
    return found


# The table --------------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Head:
    """The lines above the rows of a table: names of its columns, their units if there is a row of them, index of its
    first row."""

    names: list[str]
    units: dict[str, str]
    begin: int
    why: str = ""
    """Why a column may be missing, without names or rows."""


def find_head(rows: list[list[str]], wanted: Iterable[str] = (), headless: bool = False) -> Head:
    """Find header and first row among the first rows of a table; a comment is a row whose first cell begins with its
    mark, an empty one has no cell. Of several possible headers the one with most `wanted` names is chosen; `headless`:
    columns are named by number."""
    wanted = set(wanted)
    plain = [row for row in rows if row and not row[0].startswith(COMMENTS)]
    late = plain[len(plain) // 2 :] if len(plain) > 1 else []
    width = Counter(map(len, late)).most_common(1)[0][0] if late else 0
    late = [row for row in late if len(row) == width]
    kinds = [[bool(_kind(row[j])) for row in late] for j in range(width)]
    numeric = [j for j in range(width) if 2 * sum(kinds[j]) >= len(late)]
    if not numeric:
        (names, *_) = plain or [[]]
        return Head(names, {}, len(rows), "no rows of numbers are found in it" if len(plain) > 1 else "")

    def is_data(row: list[str]) -> bool:
        return len(row) == width and 2 * sum(bool(_kind(row[j])) for j in numeric) >= len(numeric)

    begin = next(i for i, row in enumerate(rows) if row and not row[0].startswith(COMMENTS) and is_data(row))
    above = [fit for row in rows[:begin] if (fit := _fitted(row, late, width)) is not None]
    by_number = [str(j) for j in range(width)]
    if not above and width > 1 and rows[begin] in (by_number, ["", *by_number[:-1]]):  # a header of numbers
        above, begin = [*above, rows[begin]], begin + 1
    said = [row for row in above if not row[0].startswith(COMMENTS)]
    comments = [[row[0].lstrip("#%/ "), *row[1:]] for row in above if row[0].startswith(COMMENTS)]
    comments = [row for row in comments if (wanted & set(row) if wanted else width > 1)]
    found = said or comments
    if headless or not found:
        last = next((row for row in reversed(rows[:begin]) if len(row) > 1 and not row[0].startswith(COMMENTS)), [])
        why = f"its header has {len(last)} names, and its rows have {width} cells"
        if not last or headless:
            some = ", ".join(map(repr, by_number[:6])) + (", …" if width > 6 else "")
            why = f"it has no header, its columns are numbered: {some}"
        return Head(by_number, {}, begin, why)
    # The last line has the names, or the units of those above it.
    *names_first, last = found
    spelt = [cell.strip().strip("[](){}").strip().lower() for cell in last]
    is_units = bool(names_first) and 2 * sum(unit in _UNITS for unit in spelt) > len(spelt)
    usual = len(found) - (2 if is_units else 1)
    # A name may be in two lines, as `joint1,joint1` and `position,current`.
    several = [len(set(row)) < width for row in found]
    pairs = [i for i in range(1, len(found)) if several[i - 1] or several[i]]
    joined = {i: ["/".join(filter(None, pair)) for pair in zip(found[i - 1], found[i], strict=True)] for i in pairs}
    lines = [(names, i, several[i]) for i, names in enumerate(found)] + [
        (names, i, False) for i, names in joined.items()
    ]
    names, chosen, _ = max(lines, key=lambda one: (len(wanted & set(one[0])), one[1] == usual, not one[2], one[1]))
    units = dict(zip(names, spelt, strict=True)) if is_units and chosen != len(found) - 1 else {}
    return Head(names, units, begin)


_UNITS = set(
    "- 1 s sec ms us µs ns rad mrad deg ° rev counts ticks rad/s deg/s °/s rpm rad/s^2 rad/s² a ma nm n·m n*m n.m n-m mnm n v mv "
    "°c degc c hz k % w".split()
) | {""}


def _fitted(row: list[str], late: list[list[str]], width: int) -> list[str] | None:
    """Return a line above the rows as names of as many columns; None if it does not match."""
    if not row or not any(row):
        return None
    if len(row) > width:
        return row[:width] if not any(row[width:]) else None
    spare = width - len(row)
    if spare and not any(cell for one in late for cell in one[len(row) :]):  # every row ends with a separator
        return row + [""] * spare
    first = [one[0] for one in late]
    counted = all(cell.isdecimal() for cell in first) and set(np.diff([int(cell) for cell in first])) == {1}
    if spare == 1 and width > 2 and counted:  # a column of row numbers, which has no name
        return ["", *row]
    return row if not spare else None


def decoded(raw: bytes) -> str | None:
    """Return the text of bytes: UTF-8, UTF-16 (also without a mark), or else Latin-1; None for binary data."""
    marks = {b"\xef\xbb\xbf": "utf-8-sig", b"\xff\xfe\0\0": "utf-32", b"\xff\xfe": "utf-16", b"\xfe\xff": "utf-16"}
    for mark, name in marks.items():
        if raw.startswith(mark):
            return raw.decode(name, "replace")
    some = raw[:4096]
    if len(some) > 3 and some[1::2].count(0) > 0.4 * len(some[1::2]) and some[::2].count(0) < 4:
        return raw.decode("utf-16-le", "replace")
    if len(some) > 3 and some[::2].count(0) > 0.4 * len(some[::2]) and some[1::2].count(0) < 4:
        return raw.decode("utf-16-be", "replace")
    if sum(byte < 9 or 13 < byte < 27 for byte in some) > 0.01 * len(some):
        return None
    try:
        return raw.decode("utf-8")
    except UnicodeDecodeError:
        return raw.decode("latin-1")


class TextTable:
    """A table as text."""

    def __init__(self, path: Path, raw: bytes, wanted: Iterable[str] = (), form: TextForm | None = None):
        """Read the first lines of a file's bytes. `path`: for messages; `wanted`: names to look for in the header;
        `form`: its stated format. Raises `InputError`: not text, or an empty file."""
        self.path = path
        form = form or TextForm()
        text = decoded(raw)
        if text is None:
            raise InputError(f"{path}: expected a table as text, got bytes that are no text")
        self._text = text.rstrip("\0").lstrip("\ufeff").replace("\r\n", "\n").replace("\r", "\n")
        begin = 0
        for _ in range(form.skip):
            begin = self._text.find("\n", begin) + 1 or len(self._text)
        self._skipped = form.skip
        self._text = self._text[begin:]
        lines = list(islice(StringIO(self._text), _LOOKED_AT))
        if not any(line.strip() for line in lines):
            raise InputError(f"{path}: expected a header and rows, got an empty file")
        sample = [line.strip("\r\n") for line in lines]
        self.separator = form.separator or _separator(sample)
        if self.separator == " ":
            self._text = re.sub(r"(?m)^[ \t]+|[ \t]+$", "", re.sub(r"[ \t]+", " ", self._text))
        rows = [self._split(line) for line in sample]
        self.head = find_head(rows, wanted, form.headless)
        numeric = (m for row in rows[self.head.begin :] for c in row if (m := _NUMBER.fullmatch(c)))
        marks = {mark for m in numeric for mark in m.groups() if mark}
        self.decimal = form.decimal or ("," if marks == {","} else ".")
        columns: list[tuple[str, int, int | None]] = []  # name, cell, and element of the list in it
        for j, name in enumerate(self.head.names):
            count = max((len(elements(row[j])) for row in rows[self.head.begin :] if j < len(row)), default=0)
            columns += [(f"{name}/{k}", j, k) for k in range(count)] or [(name, j, None)]
        self.names = [name for name, _, _ in columns]
        """Names of the columns; elements of lists in cells as `name/0`."""
        self._index = {name: (j, k) for name, j, k in reversed(columns)}
        self._top = self.head.begin
        self._begin = sum(map(len, islice(StringIO(self._text), self._top)))
        self.torn = self._cut_last(rows)

    def _split(self, line: str) -> list[str]:
        line = line.strip() if self.separator == " " else line
        if line.lstrip(' "').startswith(COMMENTS):
            line = line.strip().strip('"')
            mark = re.match(r"[#%/]+\s*", line)
            line = "#" + line[mark.end() if mark else 0 :]
        line = re.sub(r"[ \t]+", " ", line) if self.separator == " " else line
        try:
            (cells, *_) = csv.reader([line], delimiter=self.separator, skipinitialspace=True) if line.strip() else [[]]
        except csv.Error:
            return [line]
        return [cell.strip() for cell in cells]

    def _cut_last(self, rows: list[list[str]]) -> str:
        """Remove an incomplete last line; return it."""
        end = len(self._text.rstrip())
        last = self._text[self._text.rfind("\n", self._begin, end) + 1 : end] if end > self._begin else ""
        data = rows[self.head.begin :]
        if not last or len(data) < 3:
            return ""
        cells, width = self._split(last), len(self.head.names)
        ended = self._text[end:].startswith(("\n", "\r"))
        short = len(cells) < width or last.count('"') % 2
        unlike = not ended and any(_kind(b) and not _kind(c) for b, c in zip(data[0], cells, strict=False))
        if not short and not unlike:
            return ""
        self._text = self._text[: end - len(last)]
        return last

    def _rows(self) -> Iterator[tuple[int, list[str]]]:
        """Yield line and cells of every row. A line is a row, also with an open quote at its end."""
        for number, line in enumerate(StringIO(self._text[self._begin :]), 1 + self._top + self._skipped):
            line = line.strip("\n\0") if self.separator == "\t" else line.strip(" \t\n\0")
            if line and not line.startswith(COMMENTS):
                yield number, line.split(self.separator) if '"' not in line else self._split(line)

    def read(self, wanted: list[str]) -> dict[str, np.ndarray]:
        """Return columns by name, shape (n,) each: numbers, dates or clock times; NaN or NaT for other cells."""
        where = {name: self._index[name] for name in wanted}
        if all(k is None for _, k in where.values()) and (found := self._read_at_once(wanted)) is not None:
            return found
        width = len(self.head.names)
        parts: dict[str, list[np.ndarray]] = {name: [] for name in wanted}
        rows = self._rows()
        while block := [row for _, row in islice(rows, _BLOCK)]:
            block = [row if len(row) == width else [""] * width for row in block]
            for name, (j, k) in where.items():
                cells: list = [row[j].strip() for row in block]
                if k is not None:
                    lists = [elements(cell) for cell in cells]
                    cells = [one[k] if k < len(one) else np.nan for one in lists]
                parts[name].append(numbers(cells, self.decimal, parts[name][0].dtype if parts[name] else None))
        return {name: np.concatenate(blocks) if blocks else np.empty(0) for name, blocks in parts.items()}

    def _read_at_once(self, wanted: list[str]) -> dict[str, np.ndarray] | None:
        """Return the columns of a plain table; None for others."""
        import pyarrow as pa
        import pyarrow.csv

        keys = [str(j) for j in range(len(self.head.names))]
        mine = {name: keys[self._index[name][0]] for name in wanted}
        body = self._text[self._begin :].encode()
        if not body.strip():
            return None
        try:
            table = pa.csv.read_csv(
                pa.BufferReader(body),
                read_options=pa.csv.ReadOptions(column_names=keys),
                parse_options=pa.csv.ParseOptions(delimiter=self.separator),
                convert_options=pa.csv.ConvertOptions(
                    column_types={key: pa.float64() for key in mine.values()}, include_columns=list(set(mine.values())),
                    null_values=[""], decimal_point=self.decimal,
                ),
            )  # fmt: skip
        except (ValueError, pa.ArrowException):
            return None
        return {name: table.column(key).to_numpy().astype(np.float64) for name, key in mine.items()}

    def row(self, index: int) -> str:
        """Return a row for messages: counted from 0, and its line in the file."""
        return self._at(index)[0]

    def _at(self, index: int) -> tuple[str, list[str]]:
        line, cells = next(islice(self._rows(), index, None), (index + self._top + 1, []))
        return f"row {index} (line {line})", cells

    def fault(self, name: str, index: int) -> str:
        """Return the fault of a cell that is not a number."""
        where, cells = self._at(index)
        if len(cells) != len(self.head.names):
            return f"{where}: expected {len(self.head.names)} columns, got {len(cells)}"
        return f"column {name!r}, {where}: expected a finite number, got {cells[self._index[name][0]].strip()!r}"


def _separator(lines: list[str]) -> str:
    """Return the separator with most numeric cells in rows of the same length."""

    def score(separator: str) -> tuple[float, int]:
        sample = [re.sub(r"[ \t]+", " ", line.strip()) for line in lines] if separator == " " else lines
        sample = [line for line in sample if line.strip() and not line.lstrip().startswith(COMMENTS)]
        try:
            rows = list(csv.reader(sample[len(sample) // 2 :], delimiter=separator, skipinitialspace=True))
        except csv.Error:
            return 0.0, 0
        width, often = Counter(map(len, rows)).most_common(1)[0] if rows else (0, 0)
        cells = [cell.strip() for row in rows if len(row) == width for cell in row]
        good = sum(bool(_kind(cell)) for cell in cells) / max(len([c for c in cells if c]), 1)
        header = bool(sample) and sample[0].count(separator) + 1 == width
        return round(good * often / max(len(rows), 1), 2) + 0.01 * header, width

    return max(_SEPARATORS, key=score)
