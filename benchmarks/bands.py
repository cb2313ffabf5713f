"""Bands outside the range of the fit: `python -m benchmarks bands` writes docs/bands.csv and a table of docs/diagnosis.md.

A draw is a joint (`diagnosis.trials.draw`), with imperfections or without; every other one has one hidden effect. 60 % of
its angles are diagnosed. Then it moves through its whole range (`benchmarks.band_draws`). Samples in motion outside the
data count if the noise-free reading lies in its 95 % band. Draws are kept (`--kept`) and not computed again.
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd

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


def held(real: bool, index: int) -> kept.Rows:
    """One draw's bands: samples beyond the data, share of the truth inside, RMS of error and of the band's standard deviation."""
    challenge = Challenge(seed=SEED, hidden=KINDS[index % len(KINDS)], real=real)
    part = bands.diagnosed_part(challenge, index)
    cause = ", ".join(e.name for e in part.drawn.effects) or "none"
    named = ", ".join(c.name for c in part.found.causes if c.confidence >= 0.5) or part.found.verdict
    head = {"real": real, "draw": index, "cause": cause, "named": named}
    return [
        head | {"channel": name, "samples": h.samples}
        | {k: float(f"{x:.4g}") for k, x in (("inside", h.inside), ("error", h.error), ("deviation", h.width))}
        for name, h in (bands.channels_held(part) | bands.estimates_held(part)).items()
    ]  # fmt: skip


def _inside(rows: pd.DataFrame, real: bool, channel: str) -> np.ndarray:
    """Share inside in every draw with enough samples."""
    return rows.inside[(rows.real == real) & (rows.channel == channel) & (rows.samples >= ENOUGH)].to_numpy()


def about(rows: pd.DataFrame) -> str:
    """How many draws there are, and of what."""
    real, sound = (rows.draw[rows.real == kind].nunique() for kind in (True, False))
    return f"({real} joints with imperfections, {sound} without, seed {SEED}; every other one hides an effect)"


def table(rows: pd.DataFrame) -> str:
    """By channel and kind of joint: mean share inside over draws, its interval, and how many draws have at least 90 %."""
    body = []
    for name, label in LABELS.items():
        cells = []
        for real in (True, False):
            some = _inside(rows, real, name)
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


def figure(rows: pd.DataFrame, path: Path) -> None:
    """Draw the shares inside, by channel."""
    panels: dict[str, list[plots.Point]] = {}
    for real, title in ((True, "with imperfections"), (False, "without imperfections")):
        for name, label in LABELS.items():
            some = interval(100 * _inside(rows, real, name))
            panels.setdefault(title, []).append((label.replace("`", ""), "", some))
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
    wanted = [(real, k) for real, n in ((True, asked.draws), (False, asked.sound)) for k in range(n)]
    order = {"real": (True, False), "draw": None, "channel": tuple(LABELS)}
    rows = kept.completed(asked.kept, held, wanted, ("real", "draw"), order, asked.processes)
    fill(asked.page, {"bands": table(rows), "bands about": about(rows)})
    figure(rows, asked.page.parent / "figures" / "bands.png")
    print(table(rows))
