"""The dataset of a study: a Parquet file per finished chunk of runs, and a note that describes the study.

    OUT/study.json                                      the study, its source, digest and seeds, versions
    OUT/rows/scenario=NAME/cell=0007/runs-000032-000047.parquet

A file is moved into place when it is complete. Any Parquet reader reads `OUT/rows` as one table, with scenario and cell from the
folders' names.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from ...models.errors import InputError
from ...models.files import check_format, read_json, write_into_place, write_json
from ...models.output import MANIFEST
from ...models.tables import reading_parquet
from .design import Design
from .study import Study

try:
    import fcntl
except ImportError:  # no such locks on Windows
    fcntl = None  # type: ignore[assignment]

_LARGEST_NOTE = 1_000_000_000  # largest size of a note in bytes; it lists every seed
_PART = re.compile(r"^runs-(\d+)-(\d+)\.parquet$")


@dataclass(frozen=True)
class Chunk:
    """Runs begin … end − 1 (indices of seeds) of one cell."""

    cell: int
    begin: int
    end: int


class Dataset:
    """Rows of a study in a folder."""

    def __init__(self, folder: Path, design: Design):
        self.folder, self.design = folder, design
        self._whole: set[Path] = set()

    @classmethod
    def open(cls, folder: Path, design: Design, versions: dict[str, str], source: str = "") -> Dataset:
        """Make a study's folder, or continue one of the same study, possibly with more seeds. `versions`: of the
        packages that compute it; `source`: name of the shipped study, or path of its file relative to the folder, or
        empty. Raises `InputError`: a folder with other content, of another study, or of other versions."""
        note = folder / "study.json"
        study = design.study.model_dump(mode="json")
        seeds = list(design.study.seed_list)
        if not note.is_file():
            if folder.exists() and not (
                folder.is_dir() and all(one.name.startswith(MANIFEST) for one in folder.iterdir())
            ):
                raise InputError(f"{folder}: expected an empty or new folder, or one of a sweep, got something else")
        else:
            before = read_note(note)
            if before["digest"] != design.digest:
                raise InputError(
                    f"{folder}: expected a sweep of the same study, got one of {before['study']['name']} that differs in "
                    f"{_difference(before['study'], study)}; choose another --out"
                )
            if before["versions"] != versions:
                name = next(n for n in versions if before["versions"].get(n) != versions[n])
                raise InputError(
                    f"{folder}: expected {name} {before['versions'].get(name)}, as for the rows there, got {versions[name]}; "
                    "choose another --out"
                )
            shorter, longer = sorted((before["seeds"], seeds), key=len)
            if longer[: len(shorter)] != shorter:
                raise InputError(
                    f"{folder}: expected the seeds of its sweep, or more, got others; choose another --out"
                )
            source = source or before.get("source", "")
            if len(seeds) <= len(before["seeds"]):
                if source == before.get("source", ""):
                    return cls(folder, design)
                seeds, study = before["seeds"], before["study"]
        text = {"format": 1, "digest": design.digest, "versions": versions, "seeds": seeds, "study": study}
        write_json(note, text | ({"source": source} if source else {}))
        return cls(folder, design)

    @contextmanager
    def locked(self) -> Iterator[None]:
        """Hold an exclusive lock on the folder, until the process ends at the latest. Raises `InputError`: another
        process holds it."""
        with (self.folder / "lock").open("w") as file:
            try:
                if fcntl is not None:
                    fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError as error:
                raise InputError(f"{self.folder}: expected no other sweep in this folder, found one") from error
            yield

    def home(self, cell: int) -> Path:
        """Return the folder of a cell's rows."""
        return self.folder / "rows" / f"scenario={self.design.cells[cell].scenario}" / f"cell={cell:04d}"

    def write(self, chunk: Chunk, table: pa.Table) -> None:
        """Write the rows of a chunk."""
        path = self.home(chunk.cell) / f"runs-{chunk.begin:06d}-{chunk.end - 1:06d}.parquet"
        if not path.parent.resolve().is_relative_to(self.folder.resolve()):
            raise InputError(f"{path.parent}: expected a folder inside {self.folder}, got a link that leads elsewhere")
        with write_into_place(path) as temporary:
            pq.write_table(table, temporary, compression="zstd", write_page_checksum=True)

    def parts(self, cell: int) -> list[tuple[int, int, Path]]:
        """Return the files of a cell in order: first run, last run + 1, path."""
        found = []
        for path in self.home(cell).glob("runs-*.parquet"):
            match = _PART.match(path.name)
            if match:
                found.append((int(match[1]), int(match[2]) + 1, path))
        return sorted(found)

    def gaps(self, cell: int) -> list[tuple[int, int]]:
        """Return the missing runs of a cell as intervals; damaged files are removed. Raises `InputError`: a file that
        cannot be read now, but may be complete."""
        found, at, total = [], 0, len(self.design.study.seed_list)
        for begin, end, path in self.parts(cell):
            if path not in self._whole:
                if not _is_whole(path):
                    path.unlink()
                    continue
                self._whole.add(path)
            if begin > at:
                found.append((at, min(begin, total)))
            at = max(at, end)
        if at < total:
            found.append((at, total))
        return [(a, b) for a, b in found if a < b]

    def missing(self, size: int) -> Iterator[Chunk]:
        """Yield missing runs in chunks of `size` runs, the first runs of all cells first."""
        gaps = {cell.index: self.gaps(cell.index) for cell in self.design.cells}
        for begin in range(0, len(self.design.study.seed_list), size):
            for cell, open_runs in gaps.items():
                for a, b in open_runs:
                    a, b = max(a, begin), min(b, begin + size)
                    if a < b:
                        yield Chunk(cell, a, b)

    def done(self) -> int:
        """Return the number of finished runs."""
        return self.design.runs - sum(b - a for cell in self.design.cells for a, b in self.gaps(cell.index))

    def read(self, cell: int, columns: list[str] | None = None) -> pa.Table:
        """Return the rows of a cell, of the design's seeds, sorted by run and by the study's filters."""
        tables, total = [], len(self.design.study.seed_list)
        for begin, end, path in self.parts(cell):
            if begin >= total:  # the folder may have more seeds
                continue
            with pq.ParquetFile(path) as file:  # without columns from the folders' names
                table = file.read(columns=columns)
                if end > total:
                    table = table.filter(pc.less(file.read(columns=["run"])["run"], total))
                tables.append(table)
        return pa.concat_tables(tables) if tables else pa.table({})


def _is_whole(path: Path) -> bool:
    """Whether a file is complete: a full disk may have cut its end, or a page inside it."""
    try:
        with path.open("rb") as file:
            content = file.read()
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from error
    try:
        # Without Arrow's threads: one that frees memory while Python exits causes SIGABRT.
        with pq.ParquetFile(pa.BufferReader(content), page_checksum_verification=True) as part:
            names = part.read(use_threads=False).column_names
    except (OSError, pa.ArrowException):
        return False
    if not {"run", "seed", "key", "filter"} <= set(names):
        raise InputError(f"{path}: expected rows of a sweep, got the columns {', '.join(names)}")
    return True


def read_values(folder: Path, study: Study) -> dict[str, dict[str, tuple[np.ndarray, np.ndarray]]]:
    """Return the first metric of all rows of a sweep's folder, with their seeds: scenario → filter → values and seeds,
    shape (n,) each, ascending, without failed runs. Raises `InputError`: a file with other content, or with filters
    that the study does not have."""
    metric = study.metrics[0]
    columns = pa.schema([("seed", pa.int64()), ("filter", pa.string()), (metric, pa.float64())])
    found: dict[str, dict[str, list[pa.Table]]] = {}
    for path in sorted(folder.glob("rows/scenario=*/cell=*/runs-*.parquet")):
        with reading_parquet(path), pq.ParquetFile(path) as file:
            table = file.read(columns=columns.names).select(columns.names).cast(columns).drop_null()
            names = pc.unique(table["filter"]).to_pylist()
        if foreign := set(names) - set(study.names):
            raise InputError(f"{path}: filter: expected one of {', '.join(study.names)}, got {min(foreign)!r}")
        scenario = found.setdefault(path.parent.parent.name.partition("=")[2], {})
        for name in names:
            scenario.setdefault(name, []).append(table.filter(pc.equal(table["filter"], name)))
    sorted_ = {s: {n: pa.concat_tables(t).sort_by(metric) for n, t in of.items()} for s, of in found.items()}
    return {s: {n: (t[metric].to_numpy(), t["seed"].to_numpy()) for n, t in of.items()} for s, of in sorted_.items()}


def read_note(note: Path) -> dict[str, Any]:
    """Read the note of a dataset: `study`, `digest`, `versions`, `seeds`, and `source` if known (`Dataset.open`).
    Raises `InputError`: a file with other content."""
    before = read_json(note, "the note of a sweep", _LARGEST_NOTE)
    kinds = {"digest": str, "versions": dict, "seeds": list, "study": dict}
    of_its_kind = isinstance(before, dict) and all(isinstance(before.get(key), kind) for key, kind in kinds.items())
    if not of_its_kind or not all(isinstance(x, str) for x in (before["study"].get("name"), before.get("source", ""))):
        raise InputError(f"{note}: expected the note of a sweep, got something else")
    check_format(before, note)
    return before


def _difference(before: dict, now: dict) -> str:
    for key in now:
        if key not in ("seeds", "description", "reference") and before.get(key) != now[key]:
            return key
    return "its scenarios' or joint's files"
