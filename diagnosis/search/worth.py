"""What a cause is worth to a user: the simulation's error that it alone removes, in newton metres at the output."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.fft import irfft, rfft, rfftfreq

from ..data.segments import BALANCES
from ..fit.noise import whiten
from ..fit.residual import Problem
from ..fit.solver import Columns, Fit, Point, bounded_step

OCTAVES = 8
"""Of frequency in which an effect's worth is judged: the slowest holds all that takes longer than a second or so."""
_FAR = 1e4
"""Mean square that an effect and what others would do in its place make together, over that of the effect alone, beyond which the
linear model is of no use."""


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
    return found * problem.output_scale**2


def unexplained(problem: Problem, point: Point) -> np.ndarray:
    """Mean squares of what is left of a residual beyond the sensors' noise, [N·m]², by balance."""
    whole, noise = mean_squares(problem, point.residual), mean_squares(problem, point.noise)
    return np.maximum(whole - noise, 0.0)


def left_by(problem: Problem, f: Fit) -> float:
    """Mean square of what a fit leaves beyond the sensors' noise, over all balances [N·m]²."""
    return float(np.sum(unexplained(problem, f.point)))


def noise_of(problem: Problem, f: Fit) -> float:
    """Mean square of the sensors' noise in what a fit leaves, over all balances [N·m]²."""
    return float(np.sum(mean_squares(problem, f.point.noise)))


@dataclass(frozen=True)
class Worth:
    """What one effect of a model is worth.

    Attributes:
      own: mean squares of the residual that it alone removes, by balance [N·m]².
      share: mean square that it removes where it acts over what is left there beyond the sensors' noise, in the balance where
        that is most: means over time and octaves of frequency weighted by the square of what it removes there, so that an
        effect that acts rarely, or a ripple beside slow friction, is judged where it acts.
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
    _, own, squares = _removed(problem, f, columns, effect, others, amount)
    return Worth(squares, _share(problem, own, f.point))


def instead(
    problem: Problem, f: Fit, columns: Columns, effect: np.ndarray, others: np.ndarray, amount: np.ndarray
) -> np.ndarray:
    """By how much the other unknowns would move if an effect of a linear model were not there, shape (len(others),); arguments as
    of `worth`."""
    return _removed(problem, f, columns, effect, others, amount)[0]


def _removed(
    problem: Problem, f: Fit, columns: Columns, effect: np.ndarray, others: np.ndarray, amount: np.ndarray
) -> tuple[np.ndarray, Columns, np.ndarray]:
    """`instead`, the series that the effect alone removes, and its mean squares by balance; arguments as of `worth`.

    The others do not move where they would do far worse than that: rows that do not count in a fit say nothing of what they do
    there.
    """
    rows = whiten(problem.segments, f.noise, columns).rows
    G = rows.T @ rows
    low, high = (limit - f.theta for limit in problem.bounds(f.model))
    precision = 1 / problem.spread(f.model)[others] ** 2
    step = bounded_step(
        G[np.ix_(others, others)] + np.diag(precision),
        precision * f.theta[others] - G[np.ix_(others, effect)] @ amount,
        low[others],
        high[others],
    )
    change = np.zeros(columns[0].shape[-1])
    change[effect], change[others] = amount, -step
    own, alone = [c @ change for c in columns], [c[..., effect] @ amount for c in columns]
    squares, most = mean_squares(problem, own), mean_squares(problem, alone)
    if squares.sum() > _FAR * most.sum():
        return np.zeros_like(step), alone, most
    return step, own, squares


def _share(problem: Problem, own: Columns, point: Point) -> float:
    """Largest share over balances of what is removed to what is left, where and in the octaves in which it is removed."""
    removed, left = np.zeros(len(BALANCES)), np.zeros(len(BALANCES))
    for segment, x, r, n in zip(problem.segments, own, point.residual, point.noise, strict=True):
        use = (segment.usable | segment.held_out) & ~segment.at_rest[:, None]
        energy, whole, noise = (_octaves(np.where(use, series, 0.0)) ** 2 for series in (x, r, n))
        level = np.sum(noise, axis=1, keepdims=True) / np.maximum(np.sum(use, axis=0), 1)
        removed += np.sum(energy * energy, axis=(0, 1))
        left += np.sum(energy * (whole - level), axis=(0, 1))
    floor = 1e-3 * removed
    return float(np.max(np.where(removed > 0, removed / np.maximum(np.maximum(left, floor), 1e-300), 0.0)))


def _octaves(x: np.ndarray) -> np.ndarray:
    """Series, shape (k, c), by octaves of frequency from the Nyquist frequency down, shape (bands, k, c); they sum to x."""
    spectrum = rfft(x, axis=0)
    octave = np.minimum(-np.log2(np.maximum(2 * rfftfreq(len(x)), 2.0**-OCTAVES)).astype(int), OCTAVES - 1)
    return irfft(np.where(octave[:, None] == np.arange(OCTAVES)[:, None, None], spectrum, 0.0), len(x), axis=1)
