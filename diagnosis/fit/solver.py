"""The joint and effects fitted to a measurement: maximum a posteriori by Gauss–Newton, with noise that is learned on the way.

The data are the whitened residuals of the replay; outliers beyond `SolverSettings.huber` standard deviations count linearly.

*Annealing.* Encoders are so precise that a wrong model is wrong by hundreds of standard deviations, where nothing is linear. The
noise is therefore learned anew after every step (`noise.learn`): what the model cannot hold yet counts as discrepancy, balance by
balance and band by band, and becomes quieter as the model improves.

*Errors in variables.* Parameters scale the noise that the measured motion brings into the residuals (a stiffer spring makes more
torque of an encoder's count), and least squares would choose those that make it small. Noise replicates tell the noise's share of
objective, gradient and curvature; taking it out leaves what the signal says (corrected least squares).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from ...models.kernels import kernel
from ..data.segments import BALANCES
from .noise import SETTINGS as NOISE
from .noise import Noise, NoiseSettings, White, learn, rows_of, sensor_noise, whiten
from .residual import Model, Problem


@dataclass(frozen=True)
class SolverSettings:
    """How a fit goes.

    Attributes:
      huber: standard deviations beyond which a residual counts linearly.
      tolerance: a fit ends when the objective (in units of χ²) changes by less.
      good: share of the expected change of the objective below which derivatives are computed anew.
      far: step of a calibration variable [standard deviations] after which they are, too.
      chord: change of an effect's coordinates since its derivatives were computed after which they are computed anew; where the
        common ones are, too, any change.
      noisy: share of the noise in the whitened energy from which on it is taken out (errors in variables).
      chance: standard deviations of the difference of two sums of squares below zero that still count as nothing.
      leverage: a residual whose derivative in a common unknown is so many times the usual one counts as much less: where the
        replay is about to leave the range of a law, the smallest error of the motion decides. noise_leverage: likewise where
        the noise makes so many times the usual derivative.
      cluster: residuals within so many seconds may have to do with each other in ways that the noise model does not know.
    """

    huber: float = 3.0
    tolerance: float = 0.5
    good: float = 0.7
    far: float = 0.5
    chord: float = 0.1
    noisy: float = 0.15
    chance: float = 6.0
    leverage: float = 20.0
    noise_leverage: float = 2.0
    cluster: float = 1.0


SETTINGS = SolverSettings()

Columns = list[np.ndarray]
"""Residuals or derivatives by segment: shape (k, len(BALANCES)) or (k, len(BALANCES), n)."""


@dataclass(frozen=True)
class Point:
    """Residuals at a point: of the measurement, and what the noise replicates add to them; shape (k, len(BALANCES)) a
    segment."""

    residual: Columns
    noise: Columns


@dataclass(frozen=True)
class Fit:
    """A model at its maximum a posteriori.

    Attributes:
      model: the hypotheses in it.
      theta: the unknowns.
      point: residuals there.
      jacobian: derivatives of the residuals, shape (k, len(BALANCES), n) a segment.
      noise_jacobian: what the noise replicates add to them; None where noise does not matter.
      noise: learned at this fit.
      covariance: of the unknowns (Laplace).
      log_evidence: Laplace approximation of the log of the marginal likelihood, up to a constant of the measurement.
      loss: robust sum of squares of the whitened residual, less the noise's share.
      history: objective after every iteration.
      least: covariance of the unknowns that is the least there is, where not only noise is unknown; None for none.
    """

    model: Model
    theta: np.ndarray
    point: Point
    jacobian: Columns = field(repr=False)
    noise_jacobian: Columns | None = field(repr=False)
    noise: Noise
    covariance: np.ndarray = field(repr=False)
    log_evidence: float
    loss: float
    history: tuple[float, ...]
    least: np.ndarray | None = field(default=None, repr=False)


def evaluate_point(problem: Problem, theta: np.ndarray, model: Model) -> Point:
    """Residuals of the measurement and its noise replicates at a point."""
    r = problem.residuals([theta], [model])[0]
    other = problem.residuals([theta], [model], replicate=True)[0]
    return Point(r, [b - a for a, b in zip(r, other, strict=True)])


def huber_loss(r: np.ndarray, limit: float) -> np.ndarray:
    """Twice the Huber loss of every residual."""
    a = np.abs(r)
    return np.where(a > limit, limit * (2 * a - limit), r * r)


def huber_weight(r: np.ndarray, limit: float) -> np.ndarray:
    """Weights that make least squares of the Huber loss."""
    a = np.abs(r)
    return np.where(a > limit, limit / np.maximum(a, limit), 1.0)


def prior_cost(problem: Problem, theta: np.ndarray, model: Model) -> float:
    """Minus twice the log prior, without its constants."""
    z = theta / problem.spread(model)
    return float(z @ z)


def corrected_loss(
    problem: Problem,
    r: np.ndarray,
    share: np.ndarray | None,
    weight: np.ndarray | float = 1.0,
    settings: SolverSettings = SETTINGS,
) -> float:
    """Robust loss of a whitened residual less that of the noise's share of it.

    What is left of a segment's balance is about zero at best; what is below that by more than chance counts as if it were
    above. Where the replicate has a little more noise than the data, parameters that make all noise large would win otherwise.
    """
    whole = weight * huber_loss(r, settings.huber)
    if share is None:
        return float(np.sum(whole))
    lengths = np.repeat([-(-len(s.at) // s.block) for s in problem.segments], len(BALANCES))
    starts = np.concatenate([[0], np.cumsum(lengths)[:-1]])
    total, part = (np.add.reduceat(x, starts) for x in (whole, weight * huber_loss(share, settings.huber)))
    floor = -settings.chance * np.sqrt(np.maximum(np.minimum(total, part), 1.0))
    left = total - part
    return float(np.sum(np.where(left > floor, left, 2 * floor - left)))


def bounded_step(A: np.ndarray, g: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Minimise g·s + s·A·s/2 within low ≤ s ≤ high: unknowns that leave are held at their bound, the rest answers."""
    step = np.zeros(len(g))
    held = np.zeros(len(g), bool)
    for _ in range(20):
        free = ~held
        step[free] = np.linalg.solve(A[np.ix_(free, free)], -g[free] - A[np.ix_(free, held)] @ step[held])
        out = free & ((step < low - 1e-12) | (step > high + 1e-12))
        if not out.any():
            # Let go of those that the objective pulls back inside.
            slope = g + A @ step
            back = held & (((step >= high) & (slope > 1e-9)) | ((step <= low) & (slope < -1e-9)))
            if not back.any():
                break
            held &= ~back
            continue
        step[out] = np.clip(step[out], low[out], high[out])
        held |= out
    return np.clip(step, low, high)


@dataclass(frozen=True)
class Normal:
    """Normal equations at a point: Hessian and gradient (of half the objective), objective without the prior, the noise's share
    of the information, the whitened residual with its log determinant, and the weights of its rows by leverage."""

    hessian: np.ndarray
    gradient: np.ndarray
    loss: float
    share: np.ndarray
    white: White
    weight: np.ndarray


def leverage_weight(
    X: np.ndarray, limit: float, noise: np.ndarray | None = None, noise_limit: float = np.inf
) -> np.ndarray:
    """Weights of whitened rows X, shape (total, n), that keep single ones from deciding alone: bounded influence (Mallows).

    `noise`, what noise replicates add to them, may lie as far out elsewhere: rows count by the farther one.
    """
    energy, counted = _energy(X)
    if not len(counted):
        return np.ones(len(X))
    part = np.sort(np.abs(X[counted[:: max(len(counted) // 2000, 1)]]), axis=0)
    rms = np.sqrt(energy / len(counted))
    # What acts in a few rows only, as a load that one recording has, is usual there.
    acting = np.sum(part > 0.0, axis=0)
    ninth = np.minimum(len(part) - (0.1 * acting).astype(int), len(part)) - 1
    usual = np.maximum(np.take_along_axis(part, ninth[None], axis=0)[0], 0.03 * rms) + 1e-300
    far = _farthest(X, 1.0 / usual) / limit
    if noise is not None:
        far = np.maximum(far, _farthest(noise, 1.0 / usual) / noise_limit)
    return 1.0 / np.clip(far, 1.0, 1e100) ** 2


@kernel
def _energy(X):
    """Sums of squares of the columns of X, shape (n,), and the rows that are not zero."""
    rows, n = X.shape
    energy, counted, k = np.zeros(n), np.empty(rows, np.int64), 0
    for i in range(rows):
        any_of_it = 0.0
        for j in range(n):
            square = X[i, j] * X[i, j]
            energy[j] += square
            any_of_it += abs(X[i, j])
        if any_of_it != 0.0:
            counted[k] = i
            k += 1
    return energy, counted[:k]


@kernel
def _farthest(X, scale):
    """Largest entry of every row of X in units of its column's, shape (rows,); no number where one of a row is none."""
    rows, n = X.shape
    found = np.empty(rows)
    for i in range(rows):
        most = 0.0
        for j in range(n):
            x = abs(X[i, j]) * scale[j]
            if x > most or x != x:
                most = x
        found[i] = most
    return found


def weights_of(problem: Problem, noise: Noise, at: Fit, settings: SolverSettings = SETTINGS) -> np.ndarray:
    """Weights of the rows by leverage of a fit's derivatives under a noise, shape (total,)."""
    white = whiten(problem.segments, noise, [j[..., : problem.size] for j in at.jacobian]).rows
    return leverage_weight(white, settings.leverage)


def tamed(problem: Problem, at: Fit, settings: SolverSettings = SETTINGS) -> Fit:
    """A fit with derivatives for a linear model: small in rows of extreme leverage.

    Where the replay is about to leave the range of a law, derivatives are huge and say nothing of a change of any size.
    """
    root = np.sqrt(weights_of(problem, at.noise, at, settings))
    jacobian, first = [], 0
    for one, j in zip(problem.segments, at.jacobian, strict=True):
        blocks = len(one.at[:: one.block])
        rows = root[first : first + blocks * len(BALANCES)].reshape(len(BALANCES), blocks)
        first += rows.size
        jacobian.append(j * np.repeat(rows, one.block, axis=1).T[: len(j), :, None])
    return replace(at, jacobian=jacobian)


def products(rows: np.ndarray, limit: float, weight: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Weighted JᵀJ and Jᵀr of whitened rows [r, J]."""
    found = huber_weight(rows[:, 0], limit)
    G = gram(rows, found if weight is None else found * weight)
    return G[1:, 1:], G[1:, 0]


def gram(rows: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """XᵀWX of rows X, shape (total, n), with weights; one symmetric product, without empty rows."""
    part = _scaled(rows, np.sqrt(weight))
    return part.T @ part


@kernel
def _scaled(rows, factor):
    """Rows that are not zero, each times its factor."""
    total, n = rows.shape
    found, k = np.empty((total, n)), 0
    for i in range(total):
        any_of_it = False
        for j in range(n):
            any_of_it |= rows[i, j] != 0.0
        if any_of_it:
            for j in range(n):
                found[k, j] = factor[i] * rows[i, j]
            k += 1
    return found[:k]


def normal_equations(
    problem: Problem,
    noise: Noise,
    model: Model,
    theta: np.ndarray,
    point: Point,
    jacobian: Columns,
    noise_jacobian: Columns | None,
    settings: SolverSettings = SETTINGS,
    weight: np.ndarray | None = None,
) -> Normal:
    """Normal equations of the posterior, the noise's share taken out where its derivatives are given.

    Args:
      weight: of the rows, shape (total,); by leverage (`leverage_weight`) where it is not given.
    """
    curvature = 1 / problem.spread(model) ** 2
    white = whiten(problem.segments, noise, point.residual, jacobian)
    common, noise_rows = slice(1, problem.size + 1), None
    if noise_jacobian is not None:
        noise_rows = whiten(problem.segments, noise, point.noise, noise_jacobian).rows
    if weight is None:
        weight = leverage_weight(
            white.rows[:, common],
            settings.leverage,
            None if noise_rows is None else noise_rows[:, common],
            settings.noise_leverage,
        )
    information, g = products(white.rows, settings.huber, weight)
    g = g + curvature * theta
    share = np.zeros_like(information)
    if noise_rows is not None:
        share, noise_gradient = products(noise_rows, settings.huber, weight)
        g = g - noise_gradient
        information = _positive(information - share, problem.spread(model))
    loss = corrected_loss(problem, white.rows[:, 0], None if noise_rows is None else noise_rows[:, 0], weight, settings)
    return Normal(
        information + np.diag(curvature), g, loss, share, White(white.rows[:, :1], white.log_determinant), weight
    )  # fmt: skip


def _positive(information: np.ndarray, spread: np.ndarray) -> np.ndarray:
    """The nearest positive matrix, in units of the prior: what looks like less than no information is none."""
    values, vectors = np.linalg.eigh(information * spread[:, None] * spread)
    return (vectors * np.maximum(values, 0.0)) @ vectors.T / spread[:, None] / spread


def noise_share(problem: Problem, noise: Noise, point: Point) -> float:
    """Share of the sensors' noise in the whitened energy of a residual."""
    white = whiten(problem.segments, noise, point.residual, point.noise)
    energy = np.sum(np.minimum(white.rows**2, SETTINGS.huber**2), axis=0)
    return float(energy[1] / max(energy[0], 1e-300))


class _Effects:
    """Derivatives in a model's effects, each computed anew where its coordinates have moved.

    Args:
      chord: change of a coordinate after which they are.
      near: a fit whose derivatives serve where its coordinates are near.
    """

    def __init__(self, problem: Problem, model: Model, chord: float, near: Fit | None):
        self.problem, self.model, self.chord = problem, model, chord
        self.columns: list[Columns | None] = [None] * len(model)
        self.at = [np.full(h.size, np.inf) for h in model]
        for i, h in enumerate(model):
            j = None if near is None else next((j for j, g in enumerate(near.model) if g is h), None)
            if near is not None and j is not None:
                block = problem.place(near.model, j)
                self.columns[i], self.at[i] = [J[..., block] for J in near.jacobian], near.theta[block]

    def beside(self, common: Columns, theta: np.ndarray) -> Columns:
        """The derivatives in the common unknowns, and beside them those in the effects at `theta`."""
        problem, model = self.problem, self.model
        blocks = [problem.place(model, i) for i in range(len(model))]
        old = [i for i in range(len(model)) if self.columns[i] is None or self._moved(i, theta) > self.chord]
        # All that is computed anew in one go: derivatives come several at a time.
        replayed = [i for i in old if not hasattr(model[i], "derivatives")]
        if replayed:
            columns = np.concatenate([np.arange(blocks[i].start, blocks[i].stop) for i in replayed])
            found = problem.jacobian(theta, model, columns)
            ends = np.cumsum([0, *(model[i].size for i in replayed)])
            for i, begin, end in zip(replayed, ends[:-1], ends[1:], strict=True):
                self.columns[i] = [J[..., begin:end] for J in found]
        for i in old:
            h = model[i]
            if hasattr(h, "derivatives"):
                self.columns[i] = h.derivatives(problem, theta, model)
            self.at[i] = theta[blocks[i]].copy()
        parts = [common, *(c for c in self.columns if c is not None)]
        return common if len(parts) == 1 else [np.concatenate(p, -1) for p in zip(*parts, strict=True)]

    def forget(self, theta: np.ndarray) -> bool:
        """Let what was not computed at `theta` be computed anew; whether there was any."""
        old = [i for i in range(len(self.model)) if self._moved(i, theta) > 0.0]
        for i in old:
            self.columns[i] = None
        return bool(old)

    def _moved(self, index: int, theta: np.ndarray) -> float:
        """By how much an effect's coordinates have moved since; 0 for one linear in them, which gives its own derivatives."""
        if hasattr(self.model[index], "derivatives"):
            return 0.0
        u = theta[self.problem.place(self.model, index)]
        return float(np.max(np.abs(u - self.at[index]), initial=0.0))


class Fitter:
    """Fits models of one problem, and keeps what neighbouring fits have in common.

    Derivatives cost as many replays as there are unknowns: they are computed where a fit has moved far, and taken over from the
    fit that it began at otherwise (the chord method).

    Args:
      noise: of the model discrepancy that is learned.
    """

    def __init__(self, problem: Problem, settings: SolverSettings = SETTINGS, noise: NoiseSettings = NOISE):
        self.problem, self.settings, self.noise = problem, settings, noise
        self._kept: dict[tuple[int, ...], tuple[Fit, Fit | None]] = {}

    def once(self, model: Model, thoroughly: Callable[[], Fit], beside: Fit | None = None) -> Fit:
        """A model's thorough fit, made beside another or alone the first time that it is asked for, and kept."""
        key = (id(beside), *map(id, model))  # what is kept holds the hypotheses and the other fit
        if key not in self._kept:
            self._kept[key] = thoroughly(), beside
        return self._kept[key][0]

    def fit(
        self,
        model: Model,
        theta: np.ndarray,
        near: Fit | None = None,
        iterations: int = 8,
        beside: Fit | None = None,
        *,
        anew: bool | None = None,
    ) -> Fit:
        """Fit a model by damped Gauss–Newton from `theta`, the noise learned anew before every step.

        The noise's share is left in (`polish` takes it out): fits are compared by a log evidence from which it is taken.

        Args:
          near: a fit whose derivatives in the common unknowns serve, and in the effects that both have; without it they are
            computed as often as a step is larger than they are good for.
          anew: whether derivatives in the common unknowns are computed anew as the fit moves far; as said without `near`.
          beside: the fit with which it is compared: sensor noise and the disturbance at rest are then taken for the same. What
            a model leaves at rest, where friction may be anything, decides by hundreds otherwise.
        """
        problem, settings = self.problem, self.settings
        low, high = problem.bounds(model)
        theta = np.clip(theta, low, high)
        residual = problem.residuals([theta], [model])[0]
        if beside is None:
            other = problem.residuals([theta], [model], replicate=True)[0]
            replicates, rest = [b - a for a, b in zip(residual, other, strict=True)], None
        else:
            replicates, rest = beside.point.noise, beside.noise.rest
        history: list[float] = []
        common = None if near is None else self._taken_over(near, theta, model)
        sensed = sensor_noise(problem.segments, replicates, self.noise)
        fresh, damping = near is None, 0.0
        anew = near is None if anew is None else anew
        effects = _Effects(problem, model, settings.chord, near)
        for _ in range(iterations):
            if fresh:
                columns = (
                    np.arange(problem.size) if common is None else np.setdiff1d(np.arange(problem.size), problem.linear)
                )
                common = _put(common, problem.jacobian(theta, model, columns), columns, problem.size)
            assert common is not None
            jacobian = effects.beside(common, theta)
            noise = learn(problem.segments, residual, replicates, problem.quantum(), None, self.noise, sensed, rest)
            normal = normal_equations(
                problem, noise, model, theta, Point(residual, replicates), jacobian, None, settings
            )
            cost = normal.loss + prior_cost(problem, theta, model)
            history.append(cost)
            accepted = False
            for _attempt in range(4):
                A = normal.hessian + damping * np.diag(np.abs(np.diag(normal.hessian)))
                step = bounded_step(A, normal.gradient, low - theta, high - theta)
                trial = problem.residuals([theta + step], [model])[0]
                after = self._cost(noise, trial, theta + step, model, normal.weight)
                accepted = after < cost
                if accepted:
                    break
                damping = max(8 * damping, 1e-2)
            if not accepted:
                if effects.forget(theta):
                    fresh = False
                    continue
                if fresh or not anew:
                    break
                fresh = True
                continue
            expected = -(2 * normal.gradient @ step + step @ normal.hessian @ step)
            theta, residual = theta + step, trial
            damping *= 0.1
            if cost - after < settings.tolerance:
                break
            good = cost - after > settings.good * expected
            if anew or not good:
                effects.forget(theta)
            fresh = anew and (not good or bool(np.max(np.abs(step[: problem.size])) > settings.far))
        # Where the common derivatives would be needed anew, the last step was small: the chord's serve.
        assert common is not None
        jacobian = effects.beside(common, theta)
        other = problem.residuals([theta], [model], replicate=True)[0]
        own = [b - a for a, b in zip(residual, other, strict=True)]
        if beside is None:
            replicates, sensed = own, sensor_noise(problem.segments, own, self.noise)
        noise = learn(problem.segments, residual, replicates, problem.quantum(), None, self.noise, sensed, rest)
        return self.finish(model, theta, Point(residual, own), jacobian, None, noise, tuple(history))

    def _taken_over(self, near: Fit, theta: np.ndarray, model: Model) -> Columns:
        """Derivatives in the common unknowns as they are near by; those anew of numbers that an effect replaces in but one of the
        two models."""
        common = [j[..., : self.problem.size] for j in near.jacobian]
        apart = [h for h in model if all(h is not g for g in near.model)]
        apart += [g for g in near.model if all(g is not h for h in model)]
        columns = self.problem.replaced(apart)
        if not len(columns):
            return common
        return _put(common, self.problem.jacobian(theta, model, columns), columns, self.problem.size)

    def polish(self, f: Fit, iterations: int = 4) -> Fit:
        """The same model fitted to its end, the noise's share taken out (errors in variables), under noise that stays."""
        problem, settings = self.problem, self.settings
        low, high = problem.bounds(f.model)
        theta, point = f.theta, f.point
        jacobian = problem.jacobian(theta, f.model)
        extra: Columns | None = None
        if noise_share(problem, f.noise, point) > settings.noisy:
            again = problem.jacobian(theta, f.model, replicate=True)
            extra = [b - a for a, b in zip(jacobian, again, strict=True)]
        noise = self._learn(point, jacobian, f.covariance)
        history = list(f.history)
        refused = np.zeros(len(theta))
        for _ in range(iterations):
            normal = normal_equations(problem, noise, f.model, theta, point, jacobian, extra, settings)
            cost = normal.loss + prior_cost(problem, theta, f.model)
            history.append(cost)
            step = bounded_step(normal.hessian, normal.gradient, low - theta, high - theta)
            moved = False
            for part in (1.0, 0.3):
                trial = evaluate_point(problem, theta + part * step, f.model)
                share = trial.noise if extra is not None else None
                after = self._cost(noise, trial.residual, theta + part * step, f.model, normal.weight, share)
                if after < cost:
                    theta, point, moved = theta + part * step, trial, True
                    break
            refused = np.zeros(len(theta)) if moved else step
            if not moved or cost - after < settings.tolerance:
                break
        found = self.finish(f.model, theta, point, jacobian, extra, noise, tuple(history))
        # Where the corrected equations and the corrected objective disagree, neither is right to better than that.
        return replace(found, covariance=found.covariance + np.outer(refused, refused))

    def settle(self, f: Fit, iterations: int = 4, held: np.ndarray | None = None) -> Fit:
        """Where this problem's normal equations are solved, from the fit of a problem that is nearly the same, with its
        derivatives and noise. A step that changes the residual by more beside what derivatives say than they say is damped.

        Args:
          f: its residuals are those of this problem.
          held: unknowns that stay where they are, shape (n,).
        """
        problem, settings = self.problem, self.settings
        low, high = problem.bounds(f.model)
        if held is not None:
            low, high = np.where(held, f.theta, low), np.where(held, f.theta, high)
        theta, point = f.theta, f.point
        refused = np.zeros(len(theta))
        for _ in range(iterations):
            normal = normal_equations(problem, f.noise, f.model, theta, point, f.jacobian, f.noise_jacobian, settings)
            whole = bounded_step(normal.hessian, normal.gradient, low - theta, high - theta)
            if whole @ normal.hessian @ whole < settings.tolerance:
                break
            refused = whole
            for damping in (0.0, 0.1, 1.0, 10.0):
                A = normal.hessian + damping * np.diag(np.diag(normal.hessian))
                step = bounded_step(A, normal.gradient, low - theta, high - theta)
                trial = evaluate_point(problem, theta + step, f.model)
                change = [j @ step for j in f.jacobian]
                beyond = [t - r - c for t, r, c in zip(trial.residual, point.residual, change, strict=True)]
                rows = whiten(problem.segments, f.noise, beyond, change).rows
                left, moved = normal.weight @ rows**2
                if left <= moved:
                    theta, point, refused = theta + step, trial, whole - step
                    break
            if left > moved or moved < settings.tolerance:
                break
        found = self.finish(f.model, theta, point, f.jacobian, f.noise_jacobian, f.noise, f.history)
        return with_dispersion(problem, replace(found, covariance=found.covariance + np.outer(refused, refused)))

    def _cost(
        self,
        noise: Noise,
        residual: Columns,
        theta: np.ndarray,
        model: Model,
        weight: np.ndarray,
        share: Columns | None = None,
    ) -> float:
        rows = whiten(self.problem.segments, noise, residual, *(() if share is None else (share,))).rows
        loss = corrected_loss(self.problem, rows[:, 0], None if share is None else rows[:, 1], weight, self.settings)
        total = loss + prior_cost(self.problem, theta, model)
        return total if np.isfinite(total) else np.inf

    def _learn(self, point: Point, jacobian: Columns, covariance: np.ndarray) -> Noise:
        """Noise at a point, with what the residual may still be off as the parameters are uncertain."""
        root = root_of(covariance)
        spread = [j @ root for j in jacobian]
        return learn(self.problem.segments, point.residual, point.noise, self.problem.quantum(), spread, self.noise)

    def finish(self, model, theta, point, jacobian, extra, noise, history=(), weight=None) -> Fit:
        """The Laplace approximation of a model at its maximum, under a noise; rows by leverage unless weights are given."""
        problem = self.problem
        if not all(np.isfinite(r).all() for r in point.residual):  # beyond what the replay follows
            prior = np.diag(problem.spread(model) ** 2)
            return Fit(model, theta, point, jacobian, extra, noise, prior, -np.inf, np.inf, tuple(history))
        normal = normal_equations(problem, noise, model, theta, point, jacobian, extra, self.settings, weight)
        spread = problem.spread(model)
        _, logdet = np.linalg.slogdet(normal.hessian * spread[:, None] * spread)
        cost = normal.loss + normal.white.log_determinant + prior_cost(problem, theta, model)
        evidence = -0.5 * (cost + logdet) - sum(np.log(h.alternatives) for h in model)
        if extra is None:
            # What a model gains by making noise small is none of its merit.
            rows = whiten(problem.segments, noise, point.noise).rows[:, 0]
            evidence += 0.5 * float(np.sum(normal.weight * huber_loss(rows, self.settings.huber)))
        # The corrected gradient is noisier than the curvature says: the columns' noise counts once with the residual, once
        # as the replicate's share taken out (Godambe's information in place of Fisher's).
        prior = np.diag(1 / spread**2)
        S = normal.hessian - prior
        V = S + 2 * _positive(normal.share, spread)
        covariance = _as_described(problem, _inverse(_godambe(S, V, prior, 1e-12) + prior))
        return Fit(
            model, theta, point, jacobian, extra, noise, covariance, float(evidence), normal.loss, tuple(history)
        )


def _put(before: Columns | None, part: Columns, columns: np.ndarray, size: int) -> Columns:
    """Columns put into what was known before, shape (k, len(BALANCES), size) a segment."""
    found = []
    for s, new in enumerate(part):
        whole = np.zeros((*new.shape[:2], size)) if before is None else before[s][..., :size].copy()
        whole[..., columns] = new
        found.append(whole)
    return found


def _as_described(problem: Problem, covariance: np.ndarray) -> np.ndarray:
    """A covariance in which what is held is known as well as it was described, and no better."""
    held = np.flatnonzero(problem.held)
    found = covariance.copy()
    found[held], found[:, held] = 0.0, 0.0
    found[held, held] = 1.0
    return found


def _inverse(A: np.ndarray) -> np.ndarray:
    """Inverse of a positive matrix, scaled to unit diagonal first; positive even where rounding left that not quite so."""
    d = 1 / np.sqrt(np.diag(A))
    scaled = A * d[:, None] * d
    found = np.linalg.inv(scaled)
    if not np.all(np.diag(found) > 0.0):
        values, vectors = np.linalg.eigh(0.5 * (scaled + scaled.T))
        found = (vectors / np.maximum(values, 1e-12)) @ vectors.T
    return d[:, None] * found * d


def root_of(covariance: np.ndarray) -> np.ndarray:
    """L of L Lᵀ, shape (n, n), of a covariance that rounding may have left a little below positive."""
    scale = np.sqrt(np.diag(covariance))
    values, vectors = np.linalg.eigh(covariance / scale[:, None] / scale)
    return scale[:, None] * vectors * np.sqrt(np.maximum(values, 1e-12))


def _godambe(S: np.ndarray, V: np.ndarray, prior: np.ndarray, rcond: float) -> np.ndarray:
    """Godambe's information S V⁻¹ S of curvature S and score variance V, over what V knows to be more than `rcond`."""
    d = 1 / np.sqrt(np.diag(V) + 1e-9 * np.diag(prior))
    known = S @ (d[:, None] * np.linalg.pinv(V * d[:, None] * d, rcond=rcond, hermitian=True) * d) @ S
    return 0.5 * (known + known.T)


def with_dispersion(problem: Problem, f: Fit, settings: SolverSettings = SETTINGS) -> Fit:
    """The fit with a covariance that no noise model has to be right for, where that is the larger one (`covariances`)."""
    _, covariance = covariances(problem, f, settings)
    larger = np.sqrt(np.maximum(np.diag(covariance) / np.diag(f.covariance), 1.0))
    return replace(f, covariance=f.covariance * larger[:, None] * larger)


def covariances(problem: Problem, f: Fit, settings: SolverSettings = SETTINGS) -> tuple[np.ndarray, np.ndarray]:
    """Covariance of the unknowns by the noise model (Laplace), and one that no noise model has to be right for.

    In the latter the score's own scatter between pieces of `cluster` seconds takes the place of its expected variance (the
    sandwich of Huber and White, clustered): what the laws leave over, in time together, then counts as what it is.
    """
    normal = normal_equations(problem, f.noise, f.model, f.theta, f.point, f.jacobian, f.noise_jacobian, settings)
    scattered = _scatter(_piece_scores(problem, f, normal, settings))
    prior = np.diag(1 / problem.spread(f.model) ** 2)
    found = _inverse(_godambe(normal.hessian - prior, scattered, prior, 1e-9) + prior)
    return _as_described(problem, _inverse(normal.hessian)), _as_described(problem, found)


def scatter_by_unknown(problem: Problem, f: Fit, settings: SolverSettings = SETTINGS) -> tuple[np.ndarray, np.ndarray]:
    """Return the score by pieces of `cluster` seconds, shape (pieces, n), and the information on each unknown, shape (n,)."""
    normal = normal_equations(problem, f.noise, f.model, f.theta, f.point, f.jacobian, f.noise_jacobian, settings)
    information = np.diag(normal.hessian) - 1 / problem.spread(f.model) ** 2
    return _piece_scores(problem, f, normal, settings, settings.cluster), information


def _piece_scores(
    problem: Problem, f: Fit, normal: Normal, settings: SolverSettings, piece: float | None = None
) -> np.ndarray:
    """Gradient of half the objective without the prior, piece by piece, shape (pieces, n).

    Args:
      piece: its length [s]; by default `cluster` or less, so that there are more pieces than unknowns, as a scatter matrix needs.
    """
    rows = whiten(problem.segments, f.noise, f.point.residual, f.jacobian).rows
    score = _scores(rows, settings.huber, normal.weight)
    if f.noise_jacobian is not None:
        rows = whiten(problem.segments, f.noise, f.point.noise, f.noise_jacobian).rows
        score -= _scores(rows, settings.huber, normal.weight)
    segment, _, at = rows_of(problem.segments)
    seconds = sum(float(s.at[-1] - s.at[0]) for s in problem.segments)
    piece = piece or min(settings.cluster, seconds / (4 * score.shape[1]))
    pieces = [int(s.at[-1] / piece) + 1 for s in problem.segments]
    first = np.concatenate([[0], np.cumsum(pieces)])
    total = np.zeros((first[-1], score.shape[1]))
    np.add.at(total, first[segment] + (at / piece).astype(int), score)
    return total


def _scatter(pieces: np.ndarray) -> np.ndarray:
    """Variance of a score by the scatter of its pieces, shape (n, n), its inverse without bias (an inverse Wishart matrix's)."""
    counted = pieces[np.any(pieces, axis=1)]
    unbiased = max(len(counted) - counted.shape[1] - 1, 0.25 * len(counted)) / max(len(counted), 1)
    return counted.T @ counted / unbiased


def _scores(rows: np.ndarray, limit: float, weight: np.ndarray) -> np.ndarray:
    """Gradient of half the weighted robust loss, row by row, of whitened rows [r, J]."""
    r, X = rows[:, 0], rows[:, 1:]
    return (weight * huber_weight(r, limit) * r)[:, None] * X
