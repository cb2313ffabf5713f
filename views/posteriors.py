"""What a run's estimators said of themselves, read for showing: modes, innovations, the time that counts."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from ..scenarios.run import Run


def settled(run: Run) -> np.ndarray:
    """After the transient, shape (n,), bool."""
    return run.time >= run.scenario.transient


def modes(run: Run, name: str) -> np.ndarray:
    """Whether a filter is in robust mode, shape (n,); never, where it has no modes."""
    robust = run.estimates[name].robust
    return np.zeros(len(run.time), dtype=bool) if robust is None else robust


def robust_share(run: Run, name: str, part: np.ndarray) -> float:
    """Share of the time in robust mode [%], in a part of the samples."""
    return 100 * float(np.mean(modes(run, name)[part]))


def switching(run: Run) -> list[str]:
    """Filters that switch between optimal and robust mode; the others are always in one of them."""
    kept = settled(run)
    return [name for name in run.estimates if 0 < np.mean(modes(run, name)[kept]) < 1]


def innovating(run: Run) -> list[str]:
    """Filters of one measurement that state an innovation and its variance."""
    found = run.estimates.items()
    return [name for name, one in found if one.innovation is not None and one.innovation.shape[1] == 1]
