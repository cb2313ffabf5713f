"""Maximum a posteriori fit of a joint and effects to a measurement: Gauss–Newton, with noise that is learned on the way.

The data are the whitened residuals of the replay; those beyond `HUBER` standard deviations count linearly.

*Annealing.* Encoders are so precise that a wrong model is wrong by hundreds of standard deviations, where nothing is linear.
Noise is therefore learned before every step (`noise.learn`): the model's current error counts as discrepancy, by balance and
band, and shrinks as the model improves.

*Errors in variables.* Parameters scale the noise that the measured motion brings into the residuals: a stiffer spring makes more
torque of an encoder's count. Least squares would choose those that make it small. Noise replicates give the noise's share of
objective, gradient and curvature, and it is subtracted (corrected least squares).
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from ...models.kernels import kernel
from ..data.segments import BALANCES
from .noise import BANDS, Noise, learn, rows_of, sensor_noise, whiten
from .residual import Model, Problem

HUBER = 3.0  # standard deviations beyond which a residual counts linearly
TOLERANCE = 0.5  # change of the objective (in χ²) below which a fit ends
GOOD = 0.7  # share of the expected change of the objective below which derivatives are renewed
NEARER = 8  # halvings of the way to the description, until the replay follows a start
FAR = 0.5  # step of a calibration variable [standard deviations] after which they are renewed
CHORD = 0.1  # change of an effect's coordinates after which its derivatives are renewed
NOISY = 0.15  # share of noise in the whitened energy from which it is subtracted (errors in variables)
CHANCE = 6.0  # standard deviations below zero of a difference of two sums of squares that still count as zero
LEVERAGE = 20.0
"""A row with a derivative so many times the usual one counts less: where the replay is about to leave the range of a law, the
smallest error of the motion decides."""
NOISE_LEVERAGE = 2.0  # the same for the noise's part of the derivative
CLUSTER = 1.0  # seconds within which residuals may depend on each other beyond the noise model

Columns = list[np.ndarray]
"""Residuals or derivatives by segment: shape (k, len(BALANCES)) or (k, len(BALANCES), n)."""


@dataclass(frozen=True)
class Point:
    """Residuals at a point, and the noise replicates' part; shape (k, len(BALANCES)) a segment."""

    residual: Columns
    noise: Columns


@dataclass(frozen=True)
class Fit:
    """A model at its maximum a posteriori.

    Attributes:
      model: its hypotheses.
      theta: the unknowns, shape (n,).
      point: residuals there.
      jacobian: derivatives of the residuals, shape (k, len(BALANCES), n) a segment.
      noise_jacobian: the noise replicates' part; None where noise is not subtracted.
      noise: learned at this fit.
      covariance: of the unknowns (Laplace), shape (n, n).
      log_evidence: Laplace approximation of the log marginal likelihood, up to a constant of the measurement.
      least_covariance: lower bound of the covariance where not only noise is unknown; None for none.
      weight: of the rows by leverage, shape (total,), with which its evidence is computed.
    """

    model: Model
    theta: np.ndarray
    point: Point
    jacobian: Columns = field(repr=False)
    noise_jacobian: Columns | None = field(repr=False)
    noise: Noise
    covariance: np.ndarray = field(repr=False)
    log_evidence: float
    least_covariance: np.ndarray | None = field(default=None, repr=False)
    weight: np.ndarray | None = field(default=None, repr=False)

    @property
    def keys(self) -> frozenset[Any]:
        """Identities of the model's hypotheses."""
        return frozenset(h.key for h in self.model)


def evaluate_point(problem: Problem, theta: np.ndarray, model: Model) -> Point:
    """Evaluate residuals of the measurement and of its noise replicates."""
    residual = problem.residuals([theta], [model])[0]
    return Point(residual, replicate_noise(problem, theta, model, residual))


def replicate_noise(problem: Problem, theta: np.ndarray, model: Model, residual: Columns) -> Columns:
    """Return what the noise replicates add to a residual."""
    other = problem.residuals([theta], [model], replicate=True)[0]
    return [b - a for a, b in zip(residual, other, strict=True)]


def huber_loss(r: np.ndarray) -> np.ndarray:
    """Twice the Huber loss of every residual."""
    a = np.abs(r)
    return np.where(a > HUBER, HUBER * (2 * a - HUBER), r * r)


def huber_weight(r: np.ndarray) -> np.ndarray:
    """Weights that make least squares of the Huber loss."""
    a = np.abs(r)
    return np.where(a > HUBER, HUBER / np.maximum(a, HUBER), 1.0)


def prior_cost(problem: Problem, theta: np.ndarray, model: Model) -> float:
    """Minus twice the log prior, without constants."""
    z = theta / problem.spread(model)
    return float(z @ z)


def corrected_loss(problem: Problem, r: np.ndarray, share: np.ndarray | None, weight: np.ndarray) -> float:
    """Robust loss of a whitened residual less that of its noise share.

    The difference of a segment's balance is about zero at best. Below that by more than chance it counts as if it were above:
    with a replicate that has a little more noise than the data, parameters that amplify all noise would win otherwise.
    """
    whole = weight * huber_loss(r)
    if share is None:
        return float(np.sum(whole))
    lengths = np.repeat([-(-len(s.at) // s.block) for s in problem.segments], len(BALANCES))
    starts = np.concatenate([[0], np.cumsum(lengths)[:-1]])
    total, part = (np.add.reduceat(x, starts) for x in (whole, weight * huber_loss(share)))
    floor = -CHANCE * np.sqrt(np.maximum(np.minimum(total, part), 1.0))
    left = total - part
    return float(np.sum(np.where(left > floor, left, 2 * floor - left)))


def bounded_step(A: np.ndarray, g: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Minimise g·s + s·A·s/2 within low ≤ s ≤ high by an active set of bounds."""
    step = np.zeros(len(g))
    held = np.zeros(len(g), bool)
    for _ in range(20):
        free = ~held
        step[free] = np.linalg.solve(A[np.ix_(free, free)], -g[free] - A[np.ix_(free, held)] @ step[held])
        out = free & ((step < low - 1e-12) | (step > high + 1e-12))
        if not out.any():
            # Release those that the objective pulls back inside.
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
    """Normal equations at a point.

    Attributes:
      hessian, gradient: of half the objective.
      loss: objective without the prior.
      share: the noise's share of the information, shape (n, n).
      log_determinant: of the noise's covariance.
      weight: of the rows by leverage, shape (total,).
    """

    hessian: np.ndarray
    gradient: np.ndarray
    loss: float
    share: np.ndarray
    log_determinant: float
    weight: np.ndarray


def leverage_weight(X: np.ndarray, noise: np.ndarray | None = None) -> np.ndarray:
    """Weights of whitened rows X, shape (total, n), that bound the influence of single rows (Mallows).

    Args:
      noise: the noise replicates' part of the rows; it counts if it is farther out.
    """
    energy, counted = _energy(X)
    if not len(counted):
        return np.ones(len(X))
    part = np.sort(np.abs(X[counted[:: max(len(counted) // 2000, 1)]]), axis=0)
    rms = np.sqrt(energy / len(counted))
    # The usual size is the ninth decile of the rows in which a column acts: a load may be in one recording only.
    acting = np.sum(part > 0.0, axis=0)
    ninth = np.minimum(len(part) - (0.1 * acting).astype(int), len(part)) - 1
    usual = np.maximum(np.take_along_axis(part, ninth[None], axis=0)[0], 0.03 * rms) + 1e-300
    far = _farthest(X, 1.0 / usual) / LEVERAGE
    if noise is not None:
        far = np.maximum(far, _farthest(noise, 1.0 / usual) / NOISE_LEVERAGE)
    return 1.0 / np.clip(far, 1.0, 1e100) ** 2


@kernel
def _energy(X):
    """Sums of squares of the columns of X, shape (n,), and indices of the rows that are not zero."""
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
    """Largest scaled entry of every row of X, shape (rows,); NaN where the row has one."""
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


def tamed(problem: Problem, at: Fit) -> Fit:
    """Return a fit with derivatives for a linear model: small in rows of extreme leverage.

    Where the replay is about to leave the range of a law, derivatives are huge and hold for no step of any size.
    """
    rows = whiten(problem.segments, at.noise, [j[..., : problem.size] for j in at.jacobian]).rows
    root = np.sqrt(leverage_weight(rows))
    jacobian, first = [], 0
    for one, j in zip(problem.segments, at.jacobian, strict=True):
        blocks = len(one.at[:: one.block])
        part = root[first : first + blocks * len(BALANCES)].reshape(len(BALANCES), blocks)
        first += part.size
        jacobian.append(j * np.repeat(part, one.block, axis=1).T[: len(j), :, None])
    return replace(at, jacobian=jacobian)


def products(rows: np.ndarray, weight: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Weighted JᵀJ and Jᵀr of whitened rows [r, J], robust."""
    G = gram(rows, huber_weight(rows[:, 0]) * weight)
    return G[1:, 1:], G[1:, 0]


def gram(rows: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """XᵀWX of rows X, shape (total, n), with weights; one symmetric product, without empty rows."""
    part = _scaled(rows, np.sqrt(weight))
    return part.T @ part


@kernel
def _scaled(rows, factor):
    """Return the rows that are not zero, each times its factor."""
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
    weight: np.ndarray | None = None,
) -> Normal:
    """Return the normal equations of the posterior, without the noise's share if its derivatives are given.

    Args:
      weight: of the rows by leverage; by default that of these derivatives.
    """
    curvature = 1 / problem.spread(model) ** 2
    white = whiten(problem.segments, noise, point.residual, jacobian)
    common = slice(1, problem.size + 1)
    rows = noise_r = None
    if noise_jacobian is not None:
        rows = whiten(problem.segments, noise, point.noise, noise_jacobian).rows
        noise_r = rows[:, 0]
    if weight is None:
        weight = leverage_weight(white.rows[:, common], None if rows is None else rows[:, common])
    information, g = products(white.rows, weight)
    g = g + curvature * theta
    share = np.zeros_like(information)
    if rows is not None:
        share, noise_gradient = products(rows, weight)
        g = g - noise_gradient
        information = _positive(information - share, problem.spread(model))
    loss = corrected_loss(problem, white.rows[:, 0], noise_r, weight)
    return Normal(information + np.diag(curvature), g, loss, share, white.log_determinant, weight)


def normal_equations_of(problem: Problem, f: Fit) -> Normal:
    """Return the normal equations at a fit."""
    return normal_equations(problem, f.noise, f.model, f.theta, f.point, f.jacobian, f.noise_jacobian)


def _positive(information: np.ndarray, spread: np.ndarray) -> np.ndarray:
    """The nearest positive matrix, in units of the prior."""
    values, vectors = np.linalg.eigh(information * spread[:, None] * spread)
    return (vectors * np.maximum(values, 0.0)) @ vectors.T / spread[:, None] / spread


def noise_share(problem: Problem, noise: Noise, point: Point) -> float:
    """Share of the sensors' noise in the whitened energy of a residual."""
    white = whiten(problem.segments, noise, point.residual, point.noise)
    energy = np.sum(np.minimum(white.rows**2, HUBER**2), axis=0)
    return float(energy[1] / max(energy[0], 1e-300))


class _Derivatives:
    """Derivatives of the residuals in a model's unknowns, renewed only where these have moved (chord method).

    Args:
      near: a fit whose derivatives serve where its unknowns are near.
    """

    def __init__(self, problem: Problem, model: Model, theta: np.ndarray, near: Fit | None):
        self.problem, self.model = problem, model
        self.columns: Columns = [np.zeros((len(s.at), len(BALANCES), len(theta))) for s in problem.segments]
        self.old, self.at = np.ones(len(theta), bool), np.full(len(theta), np.inf)
        if near is None:
            return
        # Numbers that an effect of only one of the two models replaces are renewed.
        apart = [h for h in model if all(h is not g for g in near.model)]
        apart += [g for g in near.model if all(g is not h for h in model)]
        blocks = [(slice(problem.size), slice(problem.size))]
        shared = [(i, j) for i, h in enumerate(model) for j, g in enumerate(near.model) if g is h]
        blocks += [(problem.place(model, i), problem.place(near.model, j)) for i, j in shared]
        for here, there in blocks:
            for new, J in zip(self.columns, near.jacobian, strict=True):
                new[..., here] = J[..., there]
            self.old[here], self.at[here] = False, near.theta[there]
        self.old[problem.replaced(apart)] = True

    def renew_common(self) -> None:
        """Have those in the common unknowns renewed; linear ones are computed only once."""
        self.old[np.setdiff1d(np.arange(self.problem.size), self.problem.linear)] = True

    def of_all(self, theta: np.ndarray) -> Columns:
        """Return all; those in effects that have moved far are renewed."""
        self.forget(theta, CHORD)
        # All at a time: several directions cost as much as one.
        renewed = np.flatnonzero(self.old)
        if len(renewed):
            self.columns = [J.copy() for J in self.columns]
            for J, new in zip(self.columns, self.problem.jacobian(theta, self.model, renewed), strict=True):
                J[..., renewed] = new
            self.old[renewed], self.at[renewed] = False, theta[renewed]
        return self.columns

    def forget(self, theta: np.ndarray, change: float = 0.0) -> bool:
        """Have those in effects renewed whose coordinates changed by more since; return whether there are any."""
        # A spline is linear in its coordinates.
        places = [self.problem.place(self.model, i) for i, h in enumerate(self.model) if h.free]
        moved = [at for at in places if np.max(np.abs(theta[at] - self.at[at]), initial=0.0) > change]
        for at in moved:
            self.old[at] = True
        return bool(moved)


class Fitter:
    """Fits models of one problem.

    Args:
      bands: of the model discrepancy that is learned [s].
    """

    def __init__(self, problem: Problem, bands: tuple[float, ...] = BANDS):
        self.problem, self.bands = problem, bands

    def fit(
        self,
        model: Model,
        theta: np.ndarray,
        near: Fit | None = None,
        iterations: int = 8,
        reference: Fit | None = None,
        *,
        renew: bool | None = None,
    ) -> Fit:
        """Fit a model by damped Gauss–Newton from `theta`; noise is learned before every step.

        The noise's share stays in (`polish` subtracts it): fits are compared by a log evidence without it.

        Args:
          near: a fit whose derivatives in the common unknowns, and in shared effects, serve.
          renew: whether derivatives in the common unknowns are renewed as the fit moves far; default: without `near`.
          reference: the fit to compare with: sensor noise, disturbance at rest and weights of the rows are taken from it.
            Otherwise residuals at rest, where friction may be anything, and rows of extreme leverage would decide.
        """
        problem, segments = self.problem, self.problem.segments
        low, high = problem.bounds(model)
        theta = np.clip(theta, low, high)
        residual = problem.residuals([theta], [model])[0]
        for _ in range(NEARER):  # a linear prediction may be where the joint runs away
            if all(np.isfinite(r).all() for r in residual):
                break
            theta = 0.5 * (theta + np.clip(problem.start(None, model), low, high))
            residual = problem.residuals([theta], [model])[0]
        if reference is None:
            replicates, rest, weight = replicate_noise(problem, theta, model, residual), None, None
        else:
            replicates, rest, weight = reference.point.noise, reference.noise.rest, reference.weight
        sensed = sensor_noise(segments, replicates)
        fresh, damping = near is None, 0.0
        renew = near is None if renew is None else renew
        derivatives = _Derivatives(problem, model, theta, near)
        for _ in range(iterations):
            if fresh:
                derivatives.renew_common()
            jacobian = derivatives.of_all(theta)
            noise = learn(segments, residual, replicates, problem.quantum(), None, self.bands, sensed, rest)
            normal = normal_equations(problem, noise, model, theta, Point(residual, replicates), jacobian, None, weight)
            cost = normal.loss + prior_cost(problem, theta, model)
            for _attempt in range(4):
                A = normal.hessian + damping * np.diag(np.abs(np.diag(normal.hessian)))
                step = bounded_step(A, normal.gradient, low - theta, high - theta)
                trial = problem.residuals([theta + step], [model])[0]
                after = self._cost(noise, trial, theta + step, model, normal.weight)
                if after < cost:
                    break
                damping = max(8 * damping, 1e-2)
            else:
                if derivatives.forget(theta):
                    fresh = False
                    continue
                if fresh or not renew:
                    break
                fresh = True
                continue
            expected = -(2 * normal.gradient @ step + step @ normal.hessian @ step)
            theta, residual = theta + step, trial
            damping *= 0.1
            if cost - after < TOLERANCE:
                break
            good = cost - after > GOOD * expected
            if renew or not good:
                derivatives.forget(theta)
            fresh = renew and (not good or bool(np.max(np.abs(step[: problem.size])) > FAR))
        jacobian = derivatives.of_all(theta)
        own = replicate_noise(problem, theta, model, residual)
        if reference is None:
            replicates, sensed = own, sensor_noise(segments, own)
        noise = learn(segments, residual, replicates, problem.quantum(), None, self.bands, sensed, rest)
        return self._finish(model, theta, Point(residual, own), jacobian, None, noise, weight)

    def polish(self, f: Fit) -> Fit:
        """Fit the same model with the noise's share subtracted (errors in variables), under constant noise."""
        problem = self.problem
        low, high = problem.bounds(f.model)
        theta, point = f.theta, f.point
        jacobian = problem.jacobian(theta, f.model)
        extra: Columns | None = None
        if noise_share(problem, f.noise, point) > NOISY:
            again = problem.jacobian(theta, f.model, replicate=True)
            extra = [b - a for a, b in zip(jacobian, again, strict=True)]
        # The residual may still be off by as much as the parameters are uncertain.
        root = root_of(f.covariance)
        spread = [j @ root for j in jacobian]
        noise = learn(problem.segments, point.residual, point.noise, problem.quantum(), spread, self.bands)
        refused = np.zeros(len(theta))
        for _ in range(4):
            normal = normal_equations(problem, noise, f.model, theta, point, jacobian, extra)
            cost = normal.loss + prior_cost(problem, theta, f.model)
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
            if not moved or cost - after < TOLERANCE:
                break
        found = self._finish(f.model, theta, point, jacobian, extra, noise)
        # Where corrected equations and corrected objective disagree, the step between them is uncertainty.
        return replace(found, covariance=found.covariance + np.outer(refused, refused))

    def settle(self, f: Fit, iterations: int = 4, held: np.ndarray | None = None) -> Fit:
        """Solve this problem's normal equations from the fit of a similar problem, with its derivatives and noise.

        A step is damped if it changes the residual by more beyond the derivatives' prediction than they predict.

        Args:
          f: its residuals are those of this problem.
          held: unknowns that stay, shape (n,), bool.
        """
        problem = self.problem
        low, high = problem.bounds(f.model)
        if held is not None:
            low, high = np.where(held, f.theta, low), np.where(held, f.theta, high)
        theta, point = f.theta, f.point
        refused = np.zeros(len(theta))
        for _ in range(iterations):
            normal = normal_equations(problem, f.noise, f.model, theta, point, f.jacobian, f.noise_jacobian)
            whole = bounded_step(normal.hessian, normal.gradient, low - theta, high - theta)
            if whole @ normal.hessian @ whole < TOLERANCE:
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
            if left > moved or moved < TOLERANCE:
                break
        found = self._finish(f.model, theta, point, f.jacobian, f.noise_jacobian, f.noise)
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
        loss = corrected_loss(self.problem, rows[:, 0], None if share is None else rows[:, 1], weight)
        total = loss + prior_cost(self.problem, theta, model)
        return total if np.isfinite(total) else np.inf

    def _finish(
        self,
        model: Model,
        theta: np.ndarray,
        point: Point,
        jacobian: Columns,
        extra: Columns | None,
        noise: Noise,
        weight: np.ndarray | None = None,
    ) -> Fit:
        """Return the Laplace approximation of a model at its maximum, under a noise."""
        problem, spread = self.problem, self.problem.spread(model)
        if not all(np.isfinite(r).all() for r in point.residual):  # the replay does not follow it
            return Fit(model, theta, point, jacobian, extra, noise, np.diag(spread**2), -np.inf)
        normal = normal_equations(problem, noise, model, theta, point, jacobian, extra, weight)
        _, logdet = np.linalg.slogdet(normal.hessian * spread[:, None] * spread)
        cost = normal.loss + normal.log_determinant + prior_cost(problem, theta, model)
        evidence = -0.5 * (cost + logdet) - sum(np.log(h.alternatives) for h in model)
        if extra is None:
            # Small noise is no merit of a model: its part of the loss does not count.
            rows = whiten(problem.segments, noise, point.noise).rows[:, 0]
            evidence += 0.5 * float(np.sum(normal.weight * huber_loss(rows)))
        # The corrected gradient is noisier than the curvature: the columns' noise counts once with the residual, once as the
        # replicate's share that was subtracted (Godambe's information in place of Fisher's).
        prior = np.diag(1 / spread**2)
        S = normal.hessian - prior
        V = S + 2 * _positive(normal.share, spread)
        covariance = _as_described(problem, _inverse(_godambe(S, V, prior, 1e-12) + prior))
        return Fit(model, theta, point, jacobian, extra, noise, covariance, float(evidence), weight=normal.weight)


def _as_described(problem: Problem, covariance: np.ndarray) -> np.ndarray:
    """Give held unknowns the variance of their description."""
    held = np.flatnonzero(problem.held)
    found = covariance.copy()
    found[held], found[:, held] = 0.0, 0.0
    found[held, held] = 1.0
    return found


def _inverse(A: np.ndarray) -> np.ndarray:
    """Inverse of a positive matrix, scaled to unit diagonal; positive despite rounding."""
    d = 1 / np.sqrt(np.diag(A))
    scaled = A * d[:, None] * d
    found = np.linalg.inv(scaled)
    if not np.all(np.diag(found) > 0.0):
        values, vectors = np.linalg.eigh(0.5 * (scaled + scaled.T))
        found = (vectors / np.maximum(values, 1e-12)) @ vectors.T
    return d[:, None] * found * d


def root_of(covariance: np.ndarray) -> np.ndarray:
    """Return L with L Lᵀ = covariance, shape (n, n), despite rounding."""
    scale = np.sqrt(np.diag(covariance))
    values, vectors = np.linalg.eigh(covariance / scale[:, None] / scale)
    return scale[:, None] * vectors * np.sqrt(np.maximum(values, 1e-12))


def _godambe(S: np.ndarray, V: np.ndarray, prior: np.ndarray, rcond: float) -> np.ndarray:
    """Godambe's information S V⁻¹ S of curvature S and score variance V, over eigenvalues of V above `rcond`."""
    d = 1 / np.sqrt(np.diag(V) + 1e-9 * np.diag(prior))
    known = S @ (d[:, None] * np.linalg.pinv(V * d[:, None] * d, rcond=rcond, hermitian=True) * d) @ S
    return 0.5 * (known + known.T)


def with_dispersion(problem: Problem, f: Fit) -> Fit:
    """Return the fit with the larger of the two standard deviations of `covariances`."""
    _, covariance = covariances(problem, f)
    larger = np.sqrt(np.maximum(np.diag(covariance) / np.diag(f.covariance), 1.0))
    return replace(f, covariance=f.covariance * larger[:, None] * larger)


def covariances(problem: Problem, f: Fit) -> tuple[np.ndarray, np.ndarray]:
    """Return the covariance of the unknowns by the noise model (Laplace), and one that holds without it.

    The latter has the score's scatter between pieces of `CLUSTER` seconds in place of its expected variance (clustered sandwich
    of Huber and White): errors of the laws, which last, count as they are.
    """
    normal = normal_equations_of(problem, f)
    # A scatter matrix needs more pieces than unknowns.
    seconds = sum(float(s.at[-1] - s.at[0]) for s in problem.segments)
    pieces = _piece_scores(problem, f, normal, min(CLUSTER, seconds / (4 * len(f.theta))))
    counted = pieces[np.any(pieces, axis=1)]
    # The inverse of this scatter is unbiased (an inverse Wishart matrix).
    unbiased = max(len(counted) - counted.shape[1] - 1, 0.25 * len(counted)) / max(len(counted), 1)
    scattered = counted.T @ counted / unbiased
    prior = np.diag(1 / problem.spread(f.model) ** 2)
    found = _inverse(_godambe(normal.hessian - prior, scattered, prior, 1e-9) + prior)
    return _as_described(problem, _inverse(normal.hessian)), _as_described(problem, found)


def scatter_by_unknown(problem: Problem, f: Fit) -> tuple[np.ndarray, np.ndarray]:
    """Return the score by pieces of `CLUSTER` seconds, shape (pieces, n), and the information on each unknown, shape (n,)."""
    normal = normal_equations_of(problem, f)
    information = np.diag(normal.hessian) - 1 / problem.spread(f.model) ** 2
    return _piece_scores(problem, f, normal, CLUSTER), information


def _piece_scores(problem: Problem, f: Fit, normal: Normal, piece: float) -> np.ndarray:
    """Gradient of half the objective without the prior by pieces of some seconds, shape (pieces, n)."""

    def scores(residual: Columns, jacobian: Columns) -> np.ndarray:
        rows = whiten(problem.segments, f.noise, residual, jacobian).rows
        r = rows[:, 0]
        return (normal.weight * huber_weight(r) * r)[:, None] * rows[:, 1:]

    score = scores(f.point.residual, f.jacobian)
    if f.noise_jacobian is not None:
        score -= scores(f.point.noise, f.noise_jacobian)
    segment, _, at = rows_of(problem.segments)
    pieces = [int(s.at[-1] / piece) + 1 for s in problem.segments]
    first = np.concatenate([[0], np.cumsum(pieces)])
    total = np.zeros((first[-1], score.shape[1]))
    np.add.at(total, first[segment] + (at / piece).astype(int), score)
    return total
