"""What a run's estimators said of themselves, read for showing: modes, innovations, the time that counts."""

from __future__ import annotations

from dataclasses import dataclass
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


@dataclass(frozen=True)
class Innovation:
    """What a filter of one measurement was surprised by; n samples.

    Attributes:
      values: in the filter's unit, shape (n,).
      deviation: standard deviation √P_Y that it expected, shape (n,).
      nis: normalised innovation squared, shape (n,).
    """

    values: np.ndarray
    deviation: np.ndarray
    nis: np.ndarray


def innovations(run: Run) -> dict[str, Innovation]:
    """Innovations of the filters of one measurement that state them with their variance."""
    found = {}
    for name, one in run.estimates.items():
        nis = one.nis
        if one.innovation is None or one.innovation_covariance is None or nis is None or one.innovation.shape[1] != 1:
            continue
        found[name] = Innovation(one.innovation[:, 0], np.sqrt(one.innovation_covariance[:, 0, 0]), nis)
    return found
