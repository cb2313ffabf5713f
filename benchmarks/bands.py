"""Bands outside the range of the fit: `python -m benchmarks bands` writes docs/bands.csv and a table of docs/diagnosis.md.

A draw is a joint (`diagnosis.trials.draw`), with imperfections or without; every other one has one hidden effect. 60 % of
its angles are diagnosed. Then it moves through its whole range (`benchmarks.band_draws`). Samples in motion outside the
data count if the noise-free reading lies in its 95 % band. Draws are kept (`--kept`) and not computed again.
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks import band_draws as bands
from flexspline.diagnosis.trials.draw import Challenge, Hidden
from flexspline.scenarios.evaluation.intervals import interval
from flexspline.views.tables import markdown_table

from . import kept, plots
from .pages import ROOT, fill, share

SEED = 531
KINDS: tuple[Hidden, ...] = ("none", "one")
LABELS = {
    "motor_current": "motor current",
    "joint_torque": "joint torque",
    "link_position": "link position",
    "RAREKF": "estimate: RAREKF",
    "current": "estimate: `current`",
    "payload_smoothed": "estimate: `payload_smoothed`",
}
ENOUGH = 1000
"""Samples beyond the data from which on a draw counts."""
LEAST = 0.9
"""Share inside from which on a draw's band holds."""


@dataclass(frozen=True)
class Row:
    """A band of a draw: samples beyond the data, share of the truth inside, RMS of error and of the band's standard deviation."""

    real: bool
    draw: int
    cause: str
    named: str
    channel: str
    samples: int
    inside: float
    error: float
    deviation: float


def held(real: bool, index: int) -> list[Row]:
    """One draw's bands."""
    challenge = Challenge(seed=SEED, hidden=KINDS[index % len(KINDS)], real=real)
    part = bands.diagnosed_part(challenge, index)
    found = part.found
    cause = ", ".join(e.name for e in part.drawn.effects) or "none"
    named = ", ".join(c.name for c in found.causes if c.confidence >= 0.5) or found.verdict
    return [
        Row(real, index, cause, named, name, h.samples, *(float(f"{x:.4g}") for x in (h.inside, h.error, h.width)))
        for name, h in (bands.channels_held(part) | bands.estimates_held(part)).items()
    ]


def about(rows: Sequence[Row]) -> str:
    """How many draws there are, and of what."""
    real, sound = (sorted({r.draw for r in rows if r.real == kind}) for kind in (True, False))
    return (
        f"({len(real)} joints with imperfections, {len(sound)} without, seed {SEED}; every other one hides an effect)"
    )


def table(rows: Sequence[Row]) -> str:
    """By channel and kind of joint: mean share inside over draws, its interval, and how many draws have at least 90 %."""
    body = []
    for name, label in LABELS.items():
        cells = []
        for real in (True, False):
            some = np.array([r.inside for r in rows if r.real == real and r.channel == name and r.samples >= ENOUGH])
            cells += [share(some), f"{np.sum(some >= LEAST)} of {len(some)}"] if len(some) else ["–", "–"]
        body.append((label, *cells))
    heads = (
        "95 % band of",
        "with imperfections: inside [%]",
        "draws with ≥ 90 %",
        "without: inside [%]",
        "draws with ≥ 90 %",
    )
    return markdown_table(heads, body)


def figure(rows: Sequence[Row], path: Path) -> None:
    """Draw the shares inside, by channel."""
    panels: dict[str, list[plots.Point]] = {}
    for real, title in ((True, "with imperfections"), (False, "without imperfections")):
        for name, label in LABELS.items():
            some = [100 * r.inside for r in rows if r.real == real and r.channel == name and r.samples >= ENOUGH]
            panels.setdefault(title, []).append((label.replace("`", ""), "", interval(some)))
    plots.intervals(path, panels, "samples inside the 95 % band [%]", log=False)


def main(arguments: Sequence[str] = ()) -> None:
    """Compute the draws that are not kept yet, keep them, and write the table."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks bands", description=__doc__)
    parser.add_argument(
        "--draws", type=int, default=30, help="joints with imperfections; 0 writes the table of what is kept"
    )
    parser.add_argument("--sound", type=int, default=0, help="joints without")
    parser.add_argument("--processes", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--kept", type=Path, default=ROOT / "docs" / "bands.csv")
    parser.add_argument("--page", type=Path, default=ROOT / "docs" / "diagnosis.md")
    asked = parser.parse_args(arguments)
    rows, began = kept.read(asked.kept, Row), time.monotonic()
    have = {(r.real, r.draw) for r in rows}
    wanted = [(real, k) for real, n in ((True, asked.draws), (False, asked.sound)) for k in range(n)]
    for _, done in kept.computed(held, [one for one in wanted if one not in have], asked.processes):
        rows = sorted([*rows, *done.result()], key=lambda r: (not r.real, r.draw, list(LABELS).index(r.channel)))
        kept.write(asked.kept, rows, Row)
        minutes = (time.monotonic() - began) / 60
        print(f"{len({(r.real, r.draw) for r in rows})} draws; {minutes:.1f} min", flush=True)
    fill(asked.page, {"bands": table(rows), "bands about": about(rows)})
    figure(rows, asked.page.parent / "figures" / "bands.png")
    print(table(rows))
