"""The joint and its hidden effects fitted to a measurement: maximum a posteriori, by Gauss–Newton.

Unknowns are the joint's calibration variables (`models.calibration`, standard normal by construction), the times by
which the current and torque samples may be off, and the coordinates of the effects under test (`coordinates`).
The data are the whitened residuals of the replay; outliers beyond `HUBER` standard deviations count linearly.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..models.calibration import Calibration
from ..models.joint import Joint
from .coordinates import Hypothesis
from .noise import Noise, whiten
from .replay import Drive, residuals

HUBER = 3.0
TIMING = (0.5e-3, 0.3e-3)
"""Prior standard deviation [s] of the time by which current and joint torque samples are off the encoders'."""
REACH = 2.6
"""Standard deviations within which every calibration variable stays: joints are drawn within 2.5, and two variables that
move the same number (its own tolerance and a shared one) reach little further together than the number's own limit
(`models.calibration.WITHIN`)."""
_STEP_X, _STEP_U = 0.05, 0.03


_LINEAR = ("Jm", "bm", "bl", "Jl", "Mg", "current_offset", "torque_offset")


class Problem:
    """A measurement, a joint, and what may move.

    Attributes:
      drives: the stretches of the measurement.
      calibration: the joint's variables.
      linear: unknowns whose derivatives do not depend on where they are taken.
      size: number of variables that every model has: calibration and two sample times.
    """

    def __init__(self, drives: list[Drive], twins: list[Drive], joint: Joint):
        self.drives = drives
        self.twins = twins
        self.joint = joint
        self.calibration = Calibration(joint)
        self.mountings = [d.mounting for d in drives]
        self.size = self.calibration.size + 2
        linear = {slot.name for slot in self.calibration.slots if slot.field in _LINEAR}
        self.linear = np.array(
            [i for i, name in enumerate(self.calibration.names) if name in linear]
            + [self.calibration.size, self.calibration.size + 1]
        )
        self.has_torque = any(len(d.torque) for d in drives)

    def match_twins(self, factors: list[float]) -> None:
        """Make the noise of the twins' motion `factors` times as large, one a stretch."""
        self.twins = [
            twin
            if f == 1.0
            else replace(
                twin, rotor=drive.rotor + f * (twin.rotor - drive.rotor), link=drive.link + f * (twin.link - drive.link)
            )
            for drive, twin, f in zip(self.drives, self.twins, factors, strict=True)
        ]

    def split(self, theta: np.ndarray, model: tuple[Hypothesis, ...]) -> list[np.ndarray]:
        """Coordinates of each hypothesis in the vector of unknowns."""
        parts, at = [], self.size
        for h in model:
            parts.append(theta[at : at + h.size])
            at += h.size
        return parts

    def records(self, theta: np.ndarray, model: tuple[Hypothesis, ...]) -> list[np.ndarray]:
        """Parameter records of the joint at `theta`, one a stretch."""
        parts = self.split(theta, model)
        made: dict[tuple[float, ...], np.ndarray] = {}
        found = []
        for mounting in self.mountings:
            key = (mounting.inertia, mounting.gravity_moment, mounting.gravity_angle)
            if key not in made:
                record = self.calibration.record(theta[: self.calibration.size], mounting)
                for h, u in zip(model, parts, strict=True):
                    h.cause.apply(record[0], h.values(u))
                made[key] = record
            found.append(made[key])
        return found

    def residuals(
        self, thetas: list[np.ndarray], models: list[tuple[Hypothesis, ...]], twin: bool = False
    ) -> list[list[np.ndarray]]:
        """Residuals, shape (k, 3) a stretch, at each of several points (of several models), in parallel."""
        stretches = self.twins if twin else self.drives
        tasks = [
            (drive, record, theta)
            for theta, model in zip(thetas, models, strict=True)
            for drive, record in zip(stretches, self.records(theta, model), strict=True)
        ]
        done = iter(self.replayed(tasks))
        return [[next(done) for _ in stretches] for _ in thetas]

    def replayed(self, tasks: list[tuple[Drive, np.ndarray, np.ndarray]]) -> list[np.ndarray]:
        """Residuals, shape (k, 3), of stretches under records, at the sample times of unknowns theta; in parallel."""
        found = residuals([(drive, record) for drive, record, _ in tasks])
        for (drive, _, theta), r in zip(tasks, found, strict=True):
            r[:, :2] -= drive.measured_rate * theta[self.calibration.size : self.size] * TIMING
        return found

    def jacobian(
        self,
        theta: np.ndarray,
        model: tuple[Hypothesis, ...],
        base: list[np.ndarray],
        columns: np.ndarray | None = None,
        twin: bool = False,
    ) -> list[np.ndarray]:
        """Derivatives of the residuals, shape (k, 3, len(columns)) a stretch, by differences."""
        n = len(theta)
        columns = np.arange(n) if columns is None else columns
        step = np.where(np.arange(n) < self.size, _STEP_X, _STEP_U)
        replayed = [j for j in columns if not self.calibration.size <= j < self.size]
        moved = [theta + step[j] * np.eye(n)[j] for j in replayed]
        done = dict(zip(replayed, self.residuals(moved, [model] * len(moved), twin), strict=True))
        found = []
        for s, drive in enumerate(self.twins if twin else self.drives):
            J = np.zeros((*base[s].shape, len(columns)))
            for i, j in enumerate(columns):
                if j in done:
                    J[..., i] = (done[j][s] - base[s]) / step[j]
                else:  # a sample time: the reading's own rate
                    c = j - self.calibration.size
                    J[:, c, i] = -drive.measured_rate[:, c] * TIMING[c]
            found.append(J)
        return found

    def is_calibration(self, theta: np.ndarray, model: tuple[Hypothesis, ...]) -> bool:
        """Whether tolerances can express what the last hypothesis makes of the joint: then it is no cause."""
        records = self.records(theta, model)
        before = self.records(theta[: len(theta) - model[-1].size], model[:-1])
        return all(self.calibration.expresses(*trio) for trio in zip(records, before, self.mountings, strict=True))

    def spread(self, model: tuple[Hypothesis, ...]) -> np.ndarray:
        """Prior standard deviation of every unknown."""
        return np.concatenate([np.ones(self.size), *(h.spread for h in model)])

    def start(self, x: np.ndarray | None, model: tuple[Hypothesis, ...]) -> np.ndarray:
        """A vector of unknowns: the common ones at x, the effects absent."""
        return np.concatenate([np.zeros(self.size) if x is None else x, np.zeros(sum(h.size for h in model))])


@dataclass(frozen=True)
class Fit:
    """A model at its maximum a posteriori.

    Attributes:
      model: the hypotheses in it.
      theta: the unknowns.
      state: residuals, and the noise's share of them (None without echo); shape (k, 3) a stretch.
      jacobian, twin_jacobian: derivatives of both, shape (k, 3, n) a stretch.
      covariance: of the unknowns (Laplace).
      log_evidence: Laplace approximation of the log of the marginal likelihood, up to a constant of the measurement.
      chi2: robust sum of squares of the whitened residual.
      history: objective after every iteration.
    """

    model: tuple[Hypothesis, ...]
    theta: np.ndarray
    state: tuple[list[np.ndarray], list[np.ndarray] | None]
    jacobian: list[np.ndarray]
    twin_jacobian: list[np.ndarray] | None
    covariance: np.ndarray
    log_evidence: float
    chi2: float
    history: tuple[float, ...]


def robust_loss(r: np.ndarray, limit: float = HUBER) -> tuple[float, np.ndarray]:
    """Twice the Huber loss, summed, and the weights that make least squares of it."""
    a = np.abs(r)
    return float(np.sum(_huber(r, limit))), np.where(a > limit, limit / np.maximum(a, limit), 1.0)


def _limit(r: np.ndarray) -> float:
    """Where the loss becomes linear: `HUBER`, or more where the bulk of the residual is far from white noise yet."""
    inside = np.abs(r[r != 0])
    return HUBER * max(1.0, 1.4826 * float(np.median(inside))) if len(inside) else HUBER


def prior_cost(problem: Problem, theta: np.ndarray, model: tuple[Hypothesis, ...]) -> float:
    """Minus twice the log prior, without its constants."""
    z = theta / problem.spread(model)
    return float(z @ z)


def bounds(problem: Problem, model: tuple[Hypothesis, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Smallest and largest value of every unknown."""
    common = np.full(problem.size, REACH)
    limits = [h.limits for h in model]
    low = np.concatenate([-common, *(l for l, _ in limits)])
    return low, np.concatenate([common, *(u for _, u in limits)])


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
class Echo:
    """What the noise of the measured motion does to the derivatives in the common unknowns, shape (k, 3, n) a stretch.

    Parameters scale the noise that the motion brings into the residuals (a stiffer spring makes more torque of an
    encoder's count). Least squares would choose parameters that make the noise small; taking the twin's share out of
    objective, gradient and curvature leaves what the signal says (corrected least squares).
    """

    jacobian: list[np.ndarray]


def fit(
    problem: Problem,
    noise: Noise,
    model: tuple[Hypothesis, ...],
    theta: np.ndarray,
    iterations: int = 8,
    tolerance: float = 0.3,
    common: list[np.ndarray] | None = None,
    echo: Echo | None = None,
    refresh: bool = True,
) -> Fit:
    """Fit a model by damped Gauss–Newton from `theta`.

    Args:
      tolerance: stop when the objective (in units of χ²) changes by less.
      common: derivatives in the common unknowns from a fit nearby, used as long as they serve.
      echo: of a fit nearby; without it the noise of the motion is left in.
      refresh: whether derivatives in the common unknowns may be computed anew.
    """
    drives = problem.drives
    effects = np.arange(problem.size, len(theta))
    low, high = bounds(problem, model)
    history: list[float] = []

    def evaluate_at(t):
        rs = problem.residuals([t], [model])[0]
        ns = None
        if echo is not None:
            twin = problem.residuals([t], [model], twin=True)[0]
            ns = [b - a for a, b in zip(rs, twin, strict=True)]
        return rs, ns

    def objective(state, t, limit):
        r = whiten(drives, noise, [x[..., None] for x in state[0]])[:, 0]
        share = None
        if state[1] is not None:
            share = whiten(drives, noise, [x[..., None] for x in state[1]])[:, 0]
        total = _loss(problem, r, share, limit) + prior_cost(problem, t, model)
        return total if np.isfinite(total) else np.inf

    state = evaluate_at(theta)
    damping = 0.0
    fresh = False
    jacobian = twin_jacobian = None
    update = common is None
    for _ in range(iterations):
        if update:
            known = common if jacobian is None else jacobian
            nonlinear = np.setdiff1d(np.arange(len(theta)), problem.linear if known is not None else [])
            part = problem.jacobian(theta, model, state[0], nonlinear)
            jacobian = []
            for s, columns in enumerate(part):
                J = np.empty((*columns.shape[:2], len(theta)))
                J[..., nonlinear] = columns
                if known is not None:
                    J[..., problem.linear] = known[s][..., problem.linear]
                jacobian.append(J)
            fresh = True
            if echo is not None and known is not None:
                echo = _echo_again(problem, theta, model, state, jacobian, echo)
        else:
            part = problem.jacobian(theta, model, state[0], effects)
            kept = [a[..., : problem.size] for a in (common if jacobian is None else jacobian)]
            jacobian = [np.concatenate([a, b], axis=-1) for a, b in zip(kept, part, strict=True)]
            fresh = False
        if echo is not None:
            twin_jacobian = _twin_jacobian(problem, theta, model, state, jacobian, echo)
        limit = _limit(whiten(drives, noise, [x[..., None] for x in state[0]])[:, 0])
        cost = objective(state, theta, limit)
        history.append(cost)
        H, g, *_ = normal_equations(problem, noise, model, theta, state, jacobian, twin_jacobian, limit)
        accepted = False
        for _ in range(6):
            A = H + damping * np.diag(np.abs(np.diag(H)))
            new = theta + bounded_step(A, g, low - theta, high - theta)
            trial = evaluate_at(new)
            c = objective(trial, new, limit)
            if c < cost:
                accepted = True
                break
            damping = max(5 * damping, 1e-2)
        if not accepted:
            if fresh or not refresh:
                break
            update = True
            continue
        moved = new - theta
        expected = -(2 * g @ moved + moved @ H @ moved)
        gain = cost - c
        theta, state = new, trial
        damping *= 0.2
        if gain < tolerance:
            break
        update = refresh and gain < 0.75 * expected
    return evaluate(problem, noise, model, theta, state, jacobian, twin_jacobian, tuple(history))


def _echo_again(problem, theta, model, state, jacobian, echo):
    """The echo where the fit is now; derivatives that do not depend on where they are taken are kept."""
    moving = np.setdiff1d(np.arange(problem.size), problem.linear)
    twin = [a + b for a, b in zip(*state, strict=True)]
    part = problem.jacobian(theta, model, twin, moving, twin=True)
    found = []
    for kept, new, own in zip(echo.jacobian, part, jacobian, strict=True):
        again = kept.copy()
        again[..., moving] = new - own[..., moving]
        found.append(again)
    return Echo(found)


def _twin_jacobian(problem, theta, model, state, jacobian, echo):
    """The noise's share of the derivatives: in the common unknowns from the echo, in the effects' computed here."""
    effects = np.arange(problem.size, len(theta))
    twin = [a + b for a, b in zip(*state, strict=True)]
    part = problem.jacobian(theta, model, twin, effects, twin=True)
    return [
        np.concatenate([a, b - j[..., problem.size :]], axis=-1)
        for a, b, j in zip(echo.jacobian, part, jacobian, strict=True)
    ]


def echo(problem: Problem, theta: np.ndarray, model: tuple[Hypothesis, ...], jacobian: list[np.ndarray]) -> Echo:
    """The noise's share of the derivatives in the common unknowns at a fit's maximum."""
    base = problem.residuals([theta], [model], twin=True)[0]
    twin = problem.jacobian(theta, model, base, np.arange(problem.size), twin=True)
    return Echo([b - a[..., : problem.size] for a, b in zip(jacobian, twin, strict=True)])


def normal_equations(problem, noise, model, theta, state, jacobian, twin_jacobian=None, limit=HUBER):
    """Hessian and gradient (of half the objective) of the posterior, robust loss, and the noise's share of the information."""

    def products(r, j, limit):
        """Whitened residual, and weighted products JᵀJ and Jᵀr; one symmetric product, without empty rows."""
        columns = [np.concatenate([a[..., None], b], -1) for a, b in zip(r, j, strict=True)]
        stack = whiten(problem.drives, noise, columns)
        weight = robust_loss(stack[:, 0], limit)[1]
        counted = np.flatnonzero(np.any(stack, axis=1))
        rows = stack[counted] * np.sqrt(weight[counted, None])
        G = rows.T @ rows
        return stack[:, 0], G[1:, 1:], G[1:, 0]

    curvature = 1 / problem.spread(model) ** 2
    r, information, g = products(state[0], jacobian, limit)
    g = g + curvature * theta
    noise_r, share = None, np.zeros_like(information)
    if twin_jacobian is not None:
        noise_r, share, noise_gradient = products(state[1], twin_jacobian, limit)
        g = g - noise_gradient
        information = information - share
    return (
        _positive(information, problem.spread(model)) + np.diag(curvature),
        g,
        _loss(problem, r, noise_r, limit),
        share,
    )


_CHANCE = 6.0
"""Three standard deviations of the difference of two sums of squares, over the root of either."""


def _loss(problem: Problem, r: np.ndarray, share: np.ndarray | None, limit: float) -> float:
    """Robust loss of a whitened residual less that of the noise's share of it.

    What is left of a stretch's channel is about zero at best; what is below that by more than chance counts as if it were
    above. Where the twin is a little louder than the data, parameters that make all noise louder would win otherwise.
    """
    if share is None:
        return robust_loss(r, limit)[0]
    lengths = np.repeat([-(-len(d.at) // d.block) for d in problem.drives], 3)
    starts = np.concatenate([[0], np.cumsum(lengths)[:-1]])
    whole, part = (np.add.reduceat(_huber(x, limit), starts) for x in (r, share))
    floor = -_CHANCE * np.sqrt(np.maximum(np.minimum(whole, part), 1.0))
    left = whole - part
    return float(np.sum(np.where(left > floor, left, 2 * floor - left)))


def _huber(r: np.ndarray, limit: float) -> np.ndarray:
    a = np.abs(r)
    return np.where(a > limit, limit * (2 * a - limit), r * r)


def _positive(information: np.ndarray, spread: np.ndarray) -> np.ndarray:
    """The nearest positive matrix, in units of the prior: what looks like less than no information is none."""
    values, vectors = np.linalg.eigh(information * spread[:, None] * spread)
    return (vectors * np.maximum(values, 0.0)) @ vectors.T / spread[:, None] / spread


def evaluate(problem, noise, model, theta, state, jacobian, twin_jacobian=None, history=()) -> Fit:
    """The Laplace approximation of a model at its maximum."""
    H, _, loss, share = normal_equations(problem, noise, model, theta, state, jacobian, twin_jacobian)
    spread = problem.spread(model)
    _, logdet = np.linalg.slogdet(H * spread[:, None] * spread)
    log_evidence = -0.5 * (loss + prior_cost(problem, theta, model) + logdet)
    log_evidence -= sum(np.log(h.alternatives) for h in model)
    # The corrected gradient is noisier than the curvature says: the columns' noise counts once with the residual, once
    # as the twin's share taken out (Godambe's information in place of Fisher's).
    prior = np.diag(1 / spread**2)
    S = H - prior
    V = S + 2 * _positive(share, spread)
    covariance = np.linalg.inv(_godambe(S, V, prior, 1e-12) + prior)
    degrees = max(sum(drive.usable.sum() / drive.block for drive in problem.drives) - len(theta), 1.0)
    covariance *= max(loss / degrees, 1.0)
    return Fit(model, theta, state, jacobian, twin_jacobian, covariance, float(log_evidence), loss, tuple(history))


def _godambe(S: np.ndarray, V: np.ndarray, prior: np.ndarray, rcond: float) -> np.ndarray:
    """Godambe's information S V⁻¹ S of curvature S and score variance V, over what V knows to be more than `rcond`."""
    d = 1 / np.sqrt(np.diag(V) + 1e-9 * np.diag(prior))
    known = S @ (d[:, None] * np.linalg.pinv(V * d[:, None] * d, rcond=rcond, hermitian=True) * d) @ S
    return 0.5 * (known + known.T)


CLUSTER = 1.0
"""Residuals within so many seconds may have to do with each other in ways that the noise model does not know."""


def with_dispersion(problem: Problem, noise: Noise, f: Fit) -> Fit:
    """The fit with a covariance that no noise model has to be right for, where that is the larger one.

    The score's own scatter between stretches of `CLUSTER` seconds takes the place of its expected variance (the
    sandwich of Huber and White, clustered): what the laws leave over, in time together, then counts as what it is.
    """
    jacobian = [np.concatenate([r[..., None], j], -1) for r, j in zip(f.state[0], f.jacobian, strict=True)]
    score = _scores(whiten(problem.drives, noise, jacobian), HUBER)
    if f.twin_jacobian is not None:
        share = [np.concatenate([r[..., None], j], -1) for r, j in zip(f.state[1], f.twin_jacobian, strict=True)]
        score -= _scores(whiten(problem.drives, noise, share), HUBER)
    cluster, count = [], 0
    for drive in problem.drives:
        index = count + ((drive.at[:: drive.block] - drive.at[0]) / CLUSTER).astype(int)
        cluster.append(np.tile(index, 3))
        count = int(index.max()) + 1
    total = np.zeros((count, score.shape[1]))
    np.add.at(total, np.concatenate(cluster), score)
    total = total[np.any(total, axis=1)]
    H = normal_equations(problem, noise, f.model, f.theta, f.state, f.jacobian, f.twin_jacobian)[0]
    prior = np.diag(1 / problem.spread(f.model) ** 2)
    S, V = H - prior, total.T @ total
    unbiased = max(len(total) - len(V) - 1, 0.25 * len(total)) / len(total)  # of an inverse Wishart matrix
    covariance = np.linalg.inv(unbiased * _godambe(S, V, prior, 1e-9) + prior)
    larger = np.sqrt(np.maximum(np.diag(covariance) / np.diag(f.covariance), 1.0))
    return replace(f, covariance=f.covariance * larger[:, None] * larger)


def _scores(stack: np.ndarray, limit: float) -> np.ndarray:
    """Gradient of half the robust loss, row by row, of a whitened stack of residual and columns."""
    r, X = stack[:, 0], stack[:, 1:]
    return (robust_loss(r, limit)[1] * r)[:, None] * X
