"""What pages quote from the estimators' tables (`python -m benchmarks quotes`)."""

from __future__ import annotations

import shutil
from pathlib import Path

from benchmarks import quotes

ROOT = Path(__file__).resolve().parents[1]


def copied(folder: Path) -> tuple[Path, Path]:
    """Page and README, with the tables beside the page."""
    for path in (ROOT / "README.md", *(ROOT / "docs").glob("estimators*")):
        shutil.copy(path, folder)
    return folder / "estimators.md", folder / "README.md"


def test_pages_quote_what_the_tables_say(tmp_path: Path):
    page, readme = copied(tmp_path)
    quotes.write(page, readme)
    assert page.read_text("utf-8") == (ROOT / "docs" / "estimators.md").read_text("utf-8")
    assert readme.read_text("utf-8") == (ROOT / "README.md").read_text("utf-8")


def test_another_table_is_quoted_otherwise(tmp_path: Path):
    page, readme = copied(tmp_path)
    table = tmp_path / "estimators.csv"
    lines = table.read_text("utf-8").splitlines()
    (at,) = (i for i, line in enumerate(lines) if line.startswith(f"{quotes.OVERALL},1,augmented,"))
    cells = lines[at].split(",")
    lines[at] = ",".join([*cells[:4], "0.7654", "0.7", "0.8", *cells[7:]])
    table.write_text("\n".join(lines), "utf-8")
    quotes.write(page, readme)
    assert "0.77 of RAREKF's error at ×1" in page.read_text("utf-8")
    assert "| `augmented` | 0.77 [0.70, 0.80] |" in readme.read_text("utf-8")
