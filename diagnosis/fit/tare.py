"""Where the link encoder's zero is: of the two encoders against each other a description says next to nothing."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..data.segments import BALANCES
from .residual import Model, Problem


@dataclass(frozen=True)
class TareSettings:
    """How the zero is found.

    Attributes:
      grid: its values that are tried first, evenly spaced, in its standard deviations: a milliradian is several newton metres,
        where nothing is linear.
    """

    grid: tuple[float, ...] = (-2.4, -1.8, -1.2, -0.6, 0.0, 0.6, 1.2, 1.8, 2.4)


SETTINGS = TareSettings()


def described(problem: Problem) -> list[np.ndarray]:
    """Residuals of the joint as it is described, its zero tared, shape (k, len(BALANCES)) a segment."""
    return problem.residuals([tared(problem, problem.start(None, ()), ())], [()])[0]


def tared(problem: Problem, theta: np.ndarray, model: Model, settings: TareSettings = SETTINGS) -> np.ndarray:
    """The same unknowns with the link encoder's zero where the residual is smallest, on a grid."""
    names = problem.calibration.names
    if "link_encoder_zero" not in names or not problem.link_measured:
        return theta
    at = names.index("link_encoder_zero")
    step = settings.grid[1] - settings.grid[0]
    best, tried = theta, [np.r_[theta[:at], x, theta[at + 1 :]] for x in settings.grid]
    for _ in range(2):  # the grid, and a finer one about its best
        found = problem.residuals(tried, [model] * len(tried))
        best = tried[int(np.nanargmin([roughness(problem, rs) for rs in found]))]
        tried = [
            np.r_[best[:at], best[at] + part * step, best[at + 1 :]] for part in (-0.6, -0.4, -0.2, 0.0, 0.2, 0.4, 0.6)
        ]
    return best


def roughness(problem: Problem, residuals: Sequence[np.ndarray]) -> float:
    """Sum of the logarithms of median absolute residuals in motion: robust, and without a noise model."""
    total = 0.0
    for segment, r in zip(problem.segments, residuals, strict=True):
        for b in range(len(BALANCES)):
            use = segment.usable[:, b] & ~segment.at_rest
            if use.any():
                total += use.sum() * np.log(np.median(np.abs(r[use, b])) + 1e-12)
    return float(total)
