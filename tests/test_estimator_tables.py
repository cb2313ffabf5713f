"""The tables of docs/estimators.md agree with the CSVs next to it (`python -m benchmarks estimators --tables`)."""

from __future__ import annotations

import shutil
from pathlib import Path

from benchmarks import estimator_tables

ROOT = Path(__file__).resolve().parents[1]


def copied(folder: Path) -> Path:
    """Copy the page and its tables."""
    for path in (ROOT / "docs").glob("estimators*"):
        shutil.copy(path, folder)
    return folder / "estimators.md"


def test_the_page_agrees_with_its_csvs(tmp_path: Path):
    page = copied(tmp_path)
    estimator_tables.write(page)
    assert page.read_text("utf-8") == (ROOT / "docs" / "estimators.md").read_text("utf-8")


def test_a_changed_csv_changes_the_page(tmp_path: Path):
    page = copied(tmp_path)
    table = tmp_path / "estimators.csv"
    lines = table.read_text("utf-8").splitlines()
    (at,) = (i for i, line in enumerate(lines) if line.startswith(f"{estimator_tables.OVERALL},1,augmented,"))
    cells = lines[at].split(",")
    lines[at] = ",".join([*cells[:4], "0.7654", "0.7", "0.8", *cells[7:]])
    table.write_text("\n".join(lines), "utf-8")
    estimator_tables.write(page)
    assert "| `augmented` | 0.77 [0.70, 0.80] |" in page.read_text("utf-8")
