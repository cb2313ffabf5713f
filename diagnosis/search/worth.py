"""What one effect of a fit is: its size, how far it is from absent, and the simulation's error that it alone removes, in newton
metres at the output."""

from __future__ import annotations

from dataclasses import dataclass, replace

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
    problem: Problem,
    f: Fit,
    columns: Columns,
    effect: np.ndarray,
    others: np.ndarray,
    amount: np.ndarray,
    spread: np.ndarray | None = None,
) -> Worth:
    """What an effect of a linear model removes that the other unknowns could not have removed instead.

    Args:
      columns: derivatives, shape (k, len(BALANCES), n) a segment; `effect`, `others`: indices of columns.
      amount: of the effect's coordinates, from absent.
      spread: prior standard deviations of all unknowns, shape (n,); the problem's by default.
    """
    _, own, squares = _removed(problem, f, columns, effect, others, amount, spread)
    return Worth(squares, _share(problem, own, f.point))


def instead(
    problem: Problem, f: Fit, columns: Columns, effect: np.ndarray, others: np.ndarray, amount: np.ndarray
) -> np.ndarray:
    """By how much the other unknowns would move if an effect of a linear model were not there, shape (len(others),); arguments as
    of `worth`."""
    return _removed(problem, f, columns, effect, others, amount)[0]


def _removed(
    problem: Problem,
    f: Fit,
    columns: Columns,
    effect: np.ndarray,
    others: np.ndarray,
    amount: np.ndarray,
    spread: np.ndarray | None = None,
) -> tuple[np.ndarray, Columns, np.ndarray]:
    """`instead`, the series that the effect alone removes, and its mean squares by balance; arguments as of `worth`.

    The others do not move where they would do far worse than that: rows that do not count in a fit say nothing of what they do
    there.
    """
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


def size_of(problem: Problem, f: Fit, index: int = -1) -> float:
    """Size of one of a fit's effects, in ordinary sizes from where the joint would be without it."""
    return float(np.linalg.norm(amount_of(problem, f, index)[f.model[index].magnitudes]))


def amount_of(problem: Problem, f: Fit, index: int) -> np.ndarray:
    """Coordinates of one of a fit's effects less those at which it does nothing, shape (size,)."""
    h = f.model[index]
    parts = problem.split(f.theta, f.model)
    if not h.free:
        return parts[index]
    kept = [i for i in range(len(f.model)) if i != index % len(f.model)]
    theta = np.concatenate([f.theta[: problem.size], *(parts[i] for i in kept)])
    before = problem.records(theta, tuple(f.model[i] for i in kept))[0][0]
    return parts[index] - h.coordinates(h.cause.centre(before, h.fixed))


def magnitudes_at(problem: Problem, f: Fit, index: int) -> np.ndarray:
    """Where the magnitudes of one of a fit's effects stand in its unknowns."""
    return problem.place(f.model, index).start + np.asarray(f.model[index].magnitudes)


def worth_of(problem: Problem, f: Fit, linear: Fit, index: int, spread: np.ndarray | None = None) -> Worth:
    """What one of a fit's effects is worth; `linear`: the fit with `solver.tamed` derivatives, `spread` as of `worth`."""
    columns = _as_without(problem, f, linear.jacobian, index)
    return worth(problem, f, columns, *alone(problem, f, index), spread)


def made_by(problem: Problem, f: Fit, linear: Fit, index: int) -> np.ndarray:
    """Mean squares of what one of a fit's effects makes while no other unknown answers, by balance [N·m]²."""
    own, _, amount = alone(problem, f, index)
    return mean_squares(problem, [J[..., own] @ amount for J in linear.jacobian])


def without_it(problem: Problem, f: Fit, linear: Fit, index: int) -> Fit:
    """A fit as it would be without one of its effects, in the linear model: the other unknowns do what they can instead. It has
    the linear model's derivatives."""
    effect, others, amount = alone(problem, f, index)
    step = instead(problem, f, _as_without(problem, f, linear.jacobian, index), effect, others, amount)
    model = tuple(g for j, g in enumerate(f.model) if j != index)
    return replace(
        f, model=model, theta=f.theta[others] + step, jacobian=[J[..., others] for J in linear.jacobian],
        covariance=f.covariance[np.ix_(others, others)],
    )  # fmt: skip


def _as_without(problem: Problem, f: Fit, columns: Columns, index: int) -> Columns:
    """Derivatives of a fit, those in the joint's numbers as they are without one of its effects: a number that it multiplies by
    2.3 moves with its tolerance 2.3 times as much beside it as in its place."""
    h, calibration = f.model[index], problem.calibration
    if not h.cause.scales:
        return columns
    factor = h.values(problem.split(f.theta, f.model)[index])[h.cause.parameters[0].name]
    moved: dict[str, set[str]] = {}
    for slot in calibration.slots:
        for name in (slot.name, f"shared {slot.number.shared}"):
            moved.setdefault(name, set()).add(slot.field)
    scaled = [j for j, name in enumerate(calibration.names) if moved.get(name, {""}) <= set(h.cause.scales)]
    weight = np.ones(columns[0].shape[-1])
    weight[scaled] = 1.0 / max(factor, 1e-3)
    return [c * weight for c in columns]


def alone(problem: Problem, f: Fit, *indices: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Places of some of a fit's effects and of all other unknowns, and these effects' coordinates from absent."""
    blocks = [problem.place(f.model, i) for i in indices]
    magnitudes = [np.asarray(f.model[i].magnitudes) for i in indices]
    own = np.concatenate([block.start + m for block, m in zip(blocks, magnitudes, strict=True)])
    amounts = np.concatenate([amount_of(problem, f, i)[m] for i, m in zip(indices, magnitudes, strict=True)])
    inside = np.concatenate([np.arange(block.start, block.stop) for block in blocks])
    return own, np.setdiff1d(np.arange(len(f.theta)), inside), amounts
