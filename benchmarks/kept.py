"""Rows of a benchmark as they are kept beside the pages, a CSV: what is there is not computed again."""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any, TypeVar

from flexspline.models.files import write_into_place

Row = TypeVar("Row")
_READ: Mapping[str, Any] = {"str": str, "int": int, "float": float, "bool": "True".__eq__}


def read(path: Path, row: type[Row]) -> list[Row]:
    """Rows that are kept, of a dataclass of texts, numbers and truth values; none where there is no file."""
    if not path.exists():
        return []
    kinds = {f.name: str(f.type) for f in fields(row)}  # type: ignore[arg-type]
    with path.open(newline="", encoding="utf-8") as file:
        return [row(**{k: _READ[kinds[k]](v) for k, v in line.items()}) for line in csv.DictReader(file)]


def write(path: Path, rows: Sequence[Any], row: type[Any]) -> None:
    """Keep rows in their order."""
    names = [f.name for f in fields(row)]
    with write_into_place(path) as temporary, temporary.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(names)
        writer.writerows([getattr(r, name) for name in names] for r in rows)
