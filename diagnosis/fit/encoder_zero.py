"""The link encoder's zero relative to the motor encoder: a description does not specify it, so it is found from the data.

A joint with this zero found, and all other numbers as described, is called *zeroed*.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.optimize import minimize_scalar

from ..data.segments import BALANCES
from .residual import Model, Problem

GRID = (-2.4, -1.8, -1.2, -0.6, 0.0, 0.6, 1.2, 1.8, 2.4)
"""First values of the zero, in its standard deviations: a milliradian is several newton metres, where nothing is linear."""
FARTHEST, FINEST = 12.8e-3, 0.1e-3
"""Largest and smallest shift of one recording's zero that is tried [rad], each twice the one before."""


def described(problem: Problem) -> list[np.ndarray]:
    """Return residuals of the zeroed joint, shape (k, len(BALANCES)) a segment."""
    return problem.residuals([zeroed(problem, problem.start(None, ()), ())], [()])[0]


def zeroed(problem: Problem, theta: np.ndarray, model: Model) -> np.ndarray:
    """Return the unknowns with the link encoder's zero at the smallest residual on a grid."""
    names = problem.calibration.names
    if "link_encoder_zero" not in names or not problem.link_measured:
        return theta
    at = names.index("link_encoder_zero")
    best, step = theta, GRID[1] - GRID[0]
    tried = [np.r_[theta[:at], x, theta[at + 1 :]] for x in GRID]
    for _ in range(2):  # the grid, and a finer one about its best
        found = problem.residuals(tried, [model] * len(tried))
        best = tried[int(np.nanargmin([roughness(problem, rs) for rs in found]))]
        finer = best[at] + step * np.array([-0.6, -0.4, -0.2, 0.0, 0.2, 0.4, 0.6])
        tried = [np.r_[best[:at], x, best[at + 1 :]] for x in finer]
    return best


def zero_by_recording(problem: Problem) -> tuple[dict[str, float], float]:
    """Find the link encoder's zero of each recording alone, all other numbers as described.

    Returns:
      Shift against the common zero [rad] by recording, to about 0.1 mrad: a wrong stiffness moves it too. And by how much the
      logarithm of the residual falls (its median, in the mean over samples).
    """
    zero = next((s for s in problem.calibration.slots if s.name == "link_encoder_zero"), None)
    if zero is None or zero.name not in problem.calibration.names or not problem.link_measured:
        return {}, 0.0
    theta = zeroed(problem, problem.start(None, ()), ())
    unit = np.eye(len(theta))[problem.calibration.names.index(zero.name)] / problem.calibration.deviation(zero)
    steps = FINEST * 2.0 ** np.arange(round(np.log2(FARTHEST / FINEST)) + 1)
    tried = np.r_[-steps[::-1], 0.0, steps]
    found, less, samples = {}, 0.0, 0
    for name in dict.fromkeys(s.name for s in problem.segments):
        own = problem.of_recording(name)

        def left(changes: Sequence[float], own: Problem = own) -> list[float]:
            residuals = own.residuals([theta + x * unit for x in changes], [()] * len(changes))
            return [roughness(own, rs) for rs in residuals]

        each = left(tried)
        best = int(np.nanargmin(each))
        ends = (tried[max(best - 1, 0)], tried[min(best + 1, len(tried) - 1)])
        end = minimize_scalar(
            lambda x, left=left: left([x])[0], bounds=ends, method="bounded", options={"xatol": 0.02 * FINEST}
        )
        change, least = (end.x, end.fun) if end.fun < each[best] else (tried[best], each[best])
        found[name] = float(change)
        less += each[len(steps)] - least
        samples += sum(int((s.usable & ~s.at_rest[:, None]).sum()) for s in own.segments)
    return found, less / max(samples, 1)


def roughness(problem: Problem, residuals: Sequence[np.ndarray]) -> float:
    """Sum of the logarithms of median absolute residuals in motion: robust, and without a noise model."""
    total = 0.0
    for segment, r in zip(problem.segments, residuals, strict=True):
        for b in range(len(BALANCES)):
            use = segment.usable[:, b] & ~segment.at_rest
            if use.any():
                total += use.sum() * np.log(np.median(np.abs(r[use, b])) + 1e-12)
    return float(total)
