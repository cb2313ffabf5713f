"""Contribution of an effect to a fit: its size, and the simulation error that it alone removes [N·m at the output]."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.fft import irfft, rfft, rfftfreq

from ..data.segments import BALANCES
from ..fit.noise import whiten
from ..fit.residual import Problem
from ..fit.solver import Columns, Fit, Point, bounded_step

OCTAVES = 8
"""Octaves of frequency in which a contribution is judged; the slowest holds everything slower than about a second."""
_FAR = 1e4
"""Mean square of an effect together with the answer of the other unknowns, over that of the effect alone, beyond which the linear
model is not used."""


def mean_squares(problem: Problem, columns: Columns) -> np.ndarray:
    """Mean squares of a series in motion by balance, [N·m at the output]², shape (len(BALANCES),), held-out blocks included."""
    total, count = np.zeros(len(BALANCES)), np.zeros(len(BALANCES))
    for segment, x in zip(problem.segments, columns, strict=True):
        use = (segment.usable | segment.held_out) & ~segment.at_rest[:, None]
        total += np.sum(np.where(use, x, 0.0) ** 2, axis=0)
        count += np.sum(use, axis=0)
    found = np.divide(total, count, out=np.zeros(len(BALANCES)), where=count > 0)
    return found * problem.output_scale**2


def excess_by_balance(problem: Problem, point: Point) -> np.ndarray:
    """Mean squares of a residual beyond the sensors' noise by balance [N·m]²."""
    whole, noise = mean_squares(problem, point.residual), mean_squares(problem, point.noise)
    return np.maximum(whole - noise, 0.0)


def excess(problem: Problem, f: Fit) -> float:
    """Mean square of a fit's residual beyond the sensors' noise, over all balances [N·m]²."""
    return float(np.sum(excess_by_balance(problem, f.point)))


def noise_square(problem: Problem, f: Fit) -> float:
    """Mean square of the sensors' noise in a fit's residual, over all balances [N·m]²."""
    return float(np.sum(mean_squares(problem, f.point.noise)))


@dataclass(frozen=True)
class Contribution:
    """Contribution of an effect.

    Attributes:
      rms: of the residual that it alone removes, over all balances [N·m].
      share: mean square that it removes over the residual beyond the sensors' noise, in the balance where that is largest. Means
        over time and octaves are weighted by the square of what it removes there: a rare effect, or a ripple in addition to slow
        friction, is judged where it acts.
    """

    rms: float
    share: float


def contribution_of(
    problem: Problem, f: Fit, linear: Fit, index: int, spread: np.ndarray | None = None
) -> Contribution:
    """Return what an effect of a fit removes that the other unknowns could not have removed instead.

    Args:
      linear: the fit with `solver.tamed` derivatives.
      spread: prior standard deviations of all unknowns, shape (n,); the problem's by default.
    """
    _, own, squares = _removed(problem, f, linear, index, spread)
    return Contribution(float(np.sqrt(squares.sum())), _share(problem, own, f.point))


def without_effect(problem: Problem, f: Fit, linear: Fit, index: int) -> Fit:
    """Return a fit without one of its effects in the linear model: the other unknowns answer as far as they can."""
    step, _, _ = _removed(problem, f, linear, index)
    _, others, _ = alone(problem, f, index)
    model = tuple(g for j, g in enumerate(f.model) if j != index)
    return replace(
        f, model=model, theta=f.theta[others] + step, jacobian=[J[..., others] for J in linear.jacobian],
        covariance=f.covariance[np.ix_(others, others)],
    )  # fmt: skip


def made_by(problem: Problem, f: Fit, index: int) -> float:
    """Mean square of an effect of a fit while no other unknown answers, over all balances [N·m]²."""
    own, _, amount = alone(problem, f, index)
    return float(mean_squares(problem, [J[..., own] @ amount for J in f.jacobian]).sum())


def _removed(
    problem: Problem, f: Fit, linear: Fit, index: int, spread: np.ndarray | None = None
) -> tuple[np.ndarray, Columns, np.ndarray]:
    """Shift of the other unknowns without an effect, the series that it alone removes, and its mean squares by balance.

    The others stay if they would answer with far more than the effect: rows without weight in a fit do not restrict them.
    """
    columns = _as_without(problem, f, linear.jacobian, index)
    effect, others, amount = alone(problem, f, index)
    rows = whiten(problem.segments, f.noise, columns).rows
    G = rows.T @ rows
    low, high = (limit - f.theta for limit in problem.bounds(f.model))
    precision = 1 / (problem.spread(f.model) if spread is None else spread)[others] ** 2
    step = bounded_step(
        G[np.ix_(others, others)] + np.diag(precision),
        precision * f.theta[others] - G[np.ix_(others, effect)] @ amount,
        low[others],
        high[others],
    )
    change = np.zeros(columns[0].shape[-1])
    change[effect], change[others] = amount, -step
    own, only = [c @ change for c in columns], [c[..., effect] @ amount for c in columns]
    squares, most = mean_squares(problem, own), mean_squares(problem, only)
    if squares.sum() > _FAR * most.sum():
        return np.zeros_like(step), only, most
    return step, own, squares


def _share(problem: Problem, own: Columns, point: Point) -> float:
    """Largest ratio over balances of removed to remaining squares, where and in the octaves in which it is removed."""
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
    """Split series, shape (k, c), into octaves of frequency from the Nyquist frequency down, shape (bands, k, c), with sum x."""
    spectrum = rfft(x, axis=0)
    octave = np.minimum(-np.log2(np.maximum(2 * rfftfreq(len(x)), 2.0**-OCTAVES)).astype(int), OCTAVES - 1)
    return irfft(np.where(octave[:, None] == np.arange(OCTAVES)[:, None, None], spectrum, 0.0), len(x), axis=1)


def size_of(problem: Problem, f: Fit, index: int = -1) -> float:
    """Return the size of an effect of a fit, in ordinary sizes from the joint without it."""
    return float(np.linalg.norm(amount_of(problem, f, index)[f.model[index].magnitudes]))


def amount_of(problem: Problem, f: Fit, index: int) -> np.ndarray:
    """Return coordinates of an effect of a fit less those at which it does nothing, shape (size,)."""
    h = f.model[index]
    parts = problem.split(f.theta, f.model)
    if not h.free:
        return parts[index]
    kept = [i for i in range(len(f.model)) if i != index % len(f.model)]
    theta = np.concatenate([f.theta[: problem.size], *(parts[i] for i in kept)])
    before = problem.records(theta, tuple(f.model[i] for i in kept))[0][0]
    return parts[index] - h.coordinates(h.cause.centre(before, h.fixed))


def magnitudes_at(problem: Problem, f: Fit, index: int) -> np.ndarray:
    """Return indices of the magnitudes of an effect in a fit's unknowns."""
    return problem.place(f.model, index).start + np.asarray(f.model[index].magnitudes)


def _as_without(problem: Problem, f: Fit, columns: Columns, index: int) -> Columns:
    """Derivatives of a fit, in the joint's numbers as they are without an effect: one that it multiplies by 2.3 moves with its
    tolerance 2.3 times as much with the effect."""
    h, calibration = f.model[index], problem.calibration
    if not h.cause.scales:
        return columns
    factor = h.values(problem.split(f.theta, f.model)[index])[h.cause.parameters[0].name]
    other = {j for s in calibration.slots if s.field not in h.cause.scales for j in calibration.variables(s)}
    scaled = [j for j in range(calibration.size) if j not in other]
    weight = np.ones(columns[0].shape[-1])
    weight[scaled] = 1.0 / max(factor, 1e-3)
    return [c * weight for c in columns]


def alone(problem: Problem, f: Fit, *indices: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return indices of some effects' magnitudes and of all other unknowns, and the magnitudes' coordinates from absent."""
    blocks = [problem.place(f.model, i) for i in indices]
    magnitudes = [np.asarray(f.model[i].magnitudes) for i in indices]
    own = np.concatenate([block.start + m for block, m in zip(blocks, magnitudes, strict=True)])
    amounts = np.concatenate([amount_of(problem, f, i)[m] for i, m in zip(indices, magnitudes, strict=True)])
    inside = np.concatenate([np.arange(block.start, block.stop) for block in blocks])
    return own, np.setdiff1d(np.arange(len(f.theta)), inside), amounts
