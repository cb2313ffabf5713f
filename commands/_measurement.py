"""The measurement that a command is given, and mistakes in it."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from ..models.output import manifest
from ._console import print_table

if TYPE_CHECKING:
    from rich.console import Console

    from ..diagnosis.data.mistakes import Mistake
    from ..models.joint import Joint
    from ..models.recording import Measurement


def load_measurement(path: str | Path, option: str | None) -> tuple[Measurement, Joint]:
    """Load a measurement, split where samples are missing, and its joint; report splits on stderr."""
    from ..diagnosis.data.samples import parted

    data = read_measurement_files(path)
    joint = data.load_joint(option)
    data, messages = parted(data, joint)
    for text in messages:
        print(f"flexspline: {text}", file=sys.stderr)
    return data, joint


def read_measurement_files(path: str | Path) -> Measurement:
    """Read a measurement; report on stderr tables of its folder that are not part of it, except those of commands."""
    from ..models.recording import read_measurement

    found = read_measurement(path)
    for text in found.fixed:
        print(f"flexspline: {text}", file=sys.stderr)
    ours = manifest(found.folder) if found.passed_over else {}
    for table, why in found.passed_over.items():
        if table.name not in ours:
            print(f"flexspline: {table}: not read, as {why}", file=sys.stderr)
    return found


def print_mistakes(terminal: Console, mistakes: Sequence[Mistake], command: str = "", corrected: bool = False) -> None:
    """Print mistakes; `command`: line that corrects them, if there is one; `corrected`: whether they are corrected
    already."""
    if not mistakes:
        terminal.print("no mistake in the data was found")
        return
    heads = ("mistake", "column", "recording", "what", "correction", "confidence")
    rows = [
        (m.name, m.columns or "–", m.recording or "all", m.description, m.change, f"{m.confidence:.2f}")
        for m in mistakes
    ]
    print_table(terminal, f"Mistakes in the data, {'corrected' if corrected else 'and corrections'}", heads, rows, 6)
    if command and any(m.sure for m in mistakes):
        terminal.print(f"to correct them: {command}", soft_wrap=True)
    if not all(m.sure or m.lost for m in mistakes):
        terminal.print("no correction makes the channels fit this joint; --fix applies none below a confidence of 0.5")
