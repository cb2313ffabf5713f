"""Modes and innovations of a run's estimators for views."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from .series import share

if TYPE_CHECKING:
    from ..scenarios.run import Run

SHARE_WINDOW = 0.25  # window [s] over which the working mode is shown as a share of the time


def settled(run: Run) -> np.ndarray:
    """Return the samples after the transient, shape (n,), bool."""
    return run.time >= run.scenario.transient


def modes(run: Run, name: str) -> np.ndarray:
    """Return whether a filter is in robust mode, shape (n,), bool; never for a filter without modes."""
    robust = run.estimates[name].robust
    return np.zeros(len(run.time), dtype=bool) if robust is None else robust


def robust_share(run: Run, name: str, part: np.ndarray) -> float:
    """Return the share of robust mode [%] in a part of the samples."""
    return 100 * float(np.mean(modes(run, name)[part]))


def moving_mean(run: Run, values: np.ndarray) -> np.ndarray:
    """Return the mean over `SHARE_WINDOW` of flags or values, shape (n,)."""
    return share(values, round(SHARE_WINDOW / float(run.time[1] - run.time[0])))


def robust_shares(run: Run, name: str) -> np.ndarray:
    """Return the moving share of robust mode [%], shape (n,)."""
    return 100 * moving_mean(run, modes(run, name))


def switching(run: Run) -> list[str]:
    """Return the filters that switch between optimal and robust mode."""
    kept = settled(run)
    return [name for name in run.estimates if 0 < np.mean(modes(run, name)[kept]) < 1]


@dataclass(frozen=True)
class Innovation:
    """Innovation of a filter with one measurement; n samples."""

    values: np.ndarray  # in the filter's unit, shape (n,)
    deviation: np.ndarray  # expected standard deviation √P_Y, shape (n,)
    nis: np.ndarray  # normalised innovation squared, shape (n,)


def innovations(run: Run) -> dict[str, Innovation]:
    """Return the innovations of filters with one measurement, if they have a variance."""
    found = {}
    for name, one in run.estimates.items():
        nis = one.nis
        if one.innovation is None or one.innovation_covariance is None or nis is None or one.innovation.shape[1] != 1:
            continue
        found[name] = Innovation(one.innovation[:, 0], np.sqrt(one.innovation_covariance[:, 0, 0]), nis)
    return found
