"""Where the link encoder's zero is: of the two encoders against each other a description says next to nothing."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize_scalar

from ..data.segments import BALANCES
from .residual import Model, Problem


@dataclass(frozen=True)
class TareSettings:
    """How the zero is found.

    Attributes:
      grid: its values that are tried first, evenly spaced, in its standard deviations: a milliradian is several newton metres,
        where nothing is linear.
      farthest, finest: changes of one recording's zero that are tried, each twice as large as the one before [rad].
    """

    grid: tuple[float, ...] = (-2.4, -1.8, -1.2, -0.6, 0.0, 0.6, 1.2, 1.8, 2.4)
    farthest: float = 12.8e-3
    finest: float = 0.1e-3


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


def zeros(problem: Problem, settings: TareSettings = SETTINGS) -> tuple[dict[str, float], float]:
    """Where each recording alone has the link encoder's zero by the description.

    Returns:
      By how much that moves the zero of all of them [rad], by recording: within 0.1 mrad or so, as a stiffness that is off moves
      it too. And the logarithm by which what is left becomes less (its median, in the mean over samples).
    """
    zero = next((s for s in problem.calibration.slots if s.name == "link_encoder_zero"), None)
    if zero is None or zero.name not in problem.calibration.names or not problem.link_measured:
        return {}, 0.0
    theta = tared(problem, problem.start(None, ()), ())
    unit = np.eye(len(theta))[problem.calibration.names.index(zero.name)] / problem.calibration.deviation(zero)
    steps = settings.finest * 2.0 ** np.arange(round(np.log2(settings.farthest / settings.finest)) + 1)
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
            lambda x, left=left: left([x])[0], bounds=ends, method="bounded", options={"xatol": 0.02 * settings.finest}
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
