"""What a cause is worth to a user: the simulation's error that it alone removes, in newton metres at the output."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..data.segments import BALANCES, CURRENT
from ..fit.noise import whiten
from ..fit.residual import Problem
from ..fit.solver import Columns, Fit, Point, bounded_step


def mean_squares(problem: Problem, columns: Columns) -> np.ndarray:
    """Mean squares of a series in motion by balance, [N·m at the output]², shape (len(BALANCES),).

    Residuals of the fit and held-out ones alike; where the joint never moves, all of them. A current counts as the output torque
    N Kt i that it makes.
    """
    total, count = np.zeros(len(BALANCES)), np.zeros(len(BALANCES))
    for segment, x in zip(problem.segments, columns, strict=True):
        use = (segment.usable | segment.held_out) & ~segment.at_rest[:, None]
        total += np.sum(np.where(use, x, 0.0) ** 2, axis=0)
        count += np.sum(use, axis=0)
    found = np.divide(total, count, out=np.zeros(len(BALANCES)), where=count > 0)
    return found * output_scale(problem) ** 2


def unexplained(problem: Problem, point: Point) -> np.ndarray:
    """Mean squares of what is left of a residual beyond the sensors' noise, [N·m]², by balance."""
    whole, noise = mean_squares(problem, point.residual), mean_squares(problem, point.noise)
    return np.maximum(whole - noise, 0.0)


@dataclass(frozen=True)
class Worth:
    """What one effect of a model is worth.

    Attributes:
      own: mean squares of the residual that it alone removes, by balance [N·m]².
      share: mean square that it removes where it acts over what is left there beyond the sensors' noise, in the balance where
        that is most: means weighted by the square of what it removes, so that an effect that acts rarely is judged where it
        does.
    """

    own: np.ndarray
    share: float

    @property
    def rms(self) -> float:
        """Root of what it removes, over all balances [N·m]."""
        return float(np.sqrt(self.own.sum()))


def worth(
    problem: Problem, f: Fit, columns: Columns, effect: np.ndarray, others: np.ndarray, amount: np.ndarray
) -> Worth:
    """What an effect of a linear model removes that the other unknowns could not have removed instead.

    Args:
      columns: derivatives, shape (k, len(BALANCES), n) a segment; `effect`, `others`: indices of columns.
      amount: of the effect's coordinates, from absent.
    """
    rows = whiten(problem.segments, f.noise, columns).rows
    X, made = rows[:, others], rows[:, effect] @ amount
    low, high = (limit - f.theta for limit in problem.bounds(f.model))
    precision = 1 / problem.spread(f.model)[others] ** 2
    answer = bounded_step(
        X.T @ X + np.diag(precision), precision * f.theta[others] - X.T @ made, low[others], high[others]
    )
    own = [c[..., effect] @ amount - c[..., others] @ answer for c in columns]
    return Worth(mean_squares(problem, own), _share(problem, own, f.point))


def _share(problem: Problem, own: Columns, point: Point) -> float:
    """Largest share over balances of what is removed to what is left, where it is removed."""
    noise = mean_squares(problem, point.noise) / np.maximum(output_scale(problem), 1e-30) ** 2
    removed, left, weight = np.zeros(len(BALANCES)), np.zeros(len(BALANCES)), np.zeros(len(BALANCES))
    for segment, x, r in zip(problem.segments, own, point.residual, strict=True):
        use = (segment.usable | segment.held_out) & ~segment.at_rest[:, None]
        energy = np.where(use, x, 0.0) ** 2
        removed += np.sum(energy * energy, axis=0)
        left += np.sum(energy * (r * r - noise), axis=0)
        weight += np.sum(energy, axis=0)
    floor = 1e-3 * removed
    return float(np.max(np.where(weight > 0, removed / np.maximum(np.maximum(left, floor), 1e-300), 0.0)))


def output_scale(problem: Problem) -> np.ndarray:
    """Newton metres at the output per unit of each balance: of a current N Kt, of a torque one."""
    scale = np.ones(len(BALANCES))
    scale[CURRENT] = problem.joint.numbers["N"].value * problem.joint.numbers["Kt"].value
    return scale
