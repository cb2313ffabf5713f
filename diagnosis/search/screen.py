"""Screening: linearised gain in log evidence of every hypothesis at a fit, with all other unknowns free to answer.

The derivative of the replayed residuals in every cause (a secant at part of its ordinary size) gives its approximate log evidence
in closed form. The best few are judged again with the noise that would be learned with them: what they explain is then no
discrepancy.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..data.segments import BALANCES
from ..fit.coordinates import Hypothesis
from ..fit.noise import AutoregressiveNoise, Noise, Sensors, learn, sensor_noise, whiten
from ..fit.residual import Problem
from ..fit.solver import Columns, Fit, bounded_step, gram, huber_loss, huber_weight, leverage_weight, prior_cost, tamed

PROBE = 0.03  # part of the ordinary size at which a cause is probed
LEAST_GAIN = 3.5  # linearised log evidence below which a hypothesis is left out
SMALLEST = 0.015  # part of the ordinary size below which it is left out
AGAIN = 5  # hypotheses of either ranking that are judged again with their noise


@dataclass(frozen=True)
class Screened:
    """A hypothesis in the linear model.

    Attributes:
      gain: in log evidence.
      start: coordinates of the hypothesis.
      shift: change of the other unknowns that goes with them.
    """

    hypothesis: Hypothesis
    gain: float
    start: np.ndarray
    shift: np.ndarray

    @property
    def size(self) -> float:
        """In ordinary sizes."""
        return float(np.linalg.norm(self.start[self.hypothesis.magnitudes]))


@dataclass(frozen=True)
class Library:
    """Derivatives of the residuals in every hypothesis at a fit.

    Attributes:
      hypotheses: the hypotheses.
      origins: coordinates of each at which the joint does not change, shape (size,).
      columns: derivatives of the residuals in the magnitudes of each, shape (k, len(BALANCES), m) a segment.
    """

    hypotheses: list[Hypothesis]
    origins: list[np.ndarray]
    columns: list[Columns]

    @classmethod
    def at(cls, problem: Problem, fit: Fit, hypotheses: Sequence[Hypothesis], probe: float = PROBE) -> Library:
        """Probe hypotheses at a fit, at part `probe` of their ordinary size."""
        thetas, models = [], []
        record = problem.records(fit.theta, fit.model)[0][0]
        # A cause that replaces a number starts from its calibrated value.
        origins = [h.coordinates(h.cause.centre(record, h.fixed)) for h in hypotheses]
        for h, origin in zip(hypotheses, origins, strict=True):
            for j in h.magnitudes:
                u = origin.copy()
                u[j] += probe
                thetas.append(np.concatenate([fit.theta, u]))
                models.append((*fit.model, h))
        base, *moved = problem.residuals([fit.theta, *thetas], [fit.model, *models])
        done = iter(moved)
        columns = []
        for h in hypotheses:
            parts = [next(done) for _ in h.magnitudes]
            columns.append([np.stack([(part[s] - base[s]) / probe for part in parts], -1) for s in range(len(base))])
        return cls(list(hypotheses), origins, columns)

    @property
    def whole(self) -> Columns:
        """Columns of all hypotheses in one array a segment; there is at least one."""
        return [np.concatenate(parts, -1) for parts in zip(*self.columns, strict=True)]

    def keeping(self, hypotheses: Sequence[Hypothesis]) -> Library:
        """Return the library of some of its hypotheses."""
        kept = [i for i, h in enumerate(self.hypotheses) if any(h is g for g in hypotheses)]
        return Library(
            [self.hypotheses[i] for i in kept], [self.origins[i] for i in kept], [self.columns[i] for i in kept]
        )


class _Linear:
    """The linear model about a fit under a noise: normal equations of its unknowns, and whitened columns of hypotheses."""

    def __init__(self, problem: Problem, noise: Noise, at: Fit, columns: Columns):
        white = whiten(problem.segments, noise, at.point.residual, at.jacobian, columns)
        self.problem, self.at, self.rows, self.log_determinant = problem, at, white.rows, white.log_determinant
        rows = white.rows
        n = at.jacobian[0].shape[-1]
        # Rows of high leverage have little weight: with extreme derivatives the linear model is wrong.
        self.leverage = leverage_weight(rows[:, 1 : problem.size + 1])
        G = gram(rows, self.leverage * huber_weight(rows[:, 0]))
        prior = 1 / problem.spread(at.model) ** 2
        self.H = G[1 : n + 1, 1 : n + 1] + np.diag(prior)
        self.g = G[1 : n + 1, 0] + prior * at.theta
        self.cross = G[n + 1 :, 1 : n + 1]
        self.own = G[n + 1 :, n + 1 :]
        self.score = G[n + 1 :, 0]
        low, high = problem.bounds(at.model)
        self.low, self.high = low - at.theta, high - at.theta
        self.held = (self.low >= -1e-6) | (self.high <= 1e-6)  # at the end of its tolerance: cannot answer further
        held = self.H + np.diag(np.where(self.held, 1e15, 0.0))
        self.solved = np.linalg.solve(held, self.cross.T)
        self.information = self.own - self.cross @ self.solved
        self.left = -self.score + self.solved.T @ self.g
        # Calibration's return from its bounds is no merit of a cause.
        step = bounded_step(self.H, self.g, self.low, self.high)
        self.idle = float(self.g @ step + 0.5 * step @ self.H @ step)

    def judge(self, h: Hypothesis, origin: np.ndarray, block: slice) -> Screened:
        """Return gain and place of a hypothesis with its columns at `block`."""
        at = h.magnitudes
        spread, begin = h.spread[at], origin[at]
        A = self.information[block, block] + np.diag(1 / spread**2)
        b = self.left[block] - begin / spread**2
        change = np.linalg.solve(A, b)
        _, logdet = np.linalg.slogdet(A * spread[:, None] * spread)
        cost = 0.5 * logdet + np.log(h.alternatives)
        gain = 0.5 * b @ change - cost
        start = np.zeros(h.size)
        start[at] = begin + change
        if not h.polar and np.any(h.confine(start) != start):
            # An impossible sign: the bound decides.
            start = h.confine(start)
            change = start[at] - begin
            gain = b @ change - 0.5 * change @ A @ change - cost
        shift = -self.solved[:, block] @ change
        if self.held.any():
            # A number at its bound may return when the cause takes over its part.
            joined = np.block(
                [[self.H, self.cross[block].T], [self.cross[block], self.own[block, block] + np.diag(1 / spread**2)]]
            )
            slope = np.concatenate([self.g, self.score[block] + begin / spread**2])
            u_low, u_high = (limit[at] - begin for limit in h.limits)
            step = bounded_step(joined, slope, np.concatenate([self.low, u_low]), np.concatenate([self.high, u_high]))
            n = len(self.H)
            relieved = self.idle - (slope @ step + 0.5 * step @ joined @ step) - cost
            if relieved > gain:
                gain, shift = relieved, step[:n]
                start[at] = begin + step[n:]
        return Screened(h, float(gain), start, shift)

    def evidence(self, s: Screened | None = None, origin: np.ndarray | None = None) -> float:
        """Return the log evidence of the linear model, with a hypothesis that has the only columns; comparable between noises."""
        problem, theta, spread = self.problem, self.at.theta, self.problem.spread(self.at.model)
        n = len(spread)
        r, X = self.rows[:, 0], self.rows[:, 1 : n + 1]
        cost = self.log_determinant
        if s is not None:
            assert origin is not None
            here = s.hypothesis.magnitudes
            theta = theta + s.shift
            X = self.rows[:, 1:]
            r = r + X @ np.concatenate([s.shift, s.start[here] - origin[here]])
            spread = np.concatenate([spread, s.hypothesis.spread[here]])
            cost += float(np.sum((s.start[here] / s.hypothesis.spread[here]) ** 2))
        H = gram(X, self.leverage * huber_weight(r)) + np.diag(1 / spread**2)
        cost += float(np.sum(self.leverage * huber_loss(r))) + prior_cost(problem, theta, self.at.model)
        return -0.5 * (cost + float(np.linalg.slogdet(H * spread[:, None] * spread)[1]))


def screen(problem: Problem, at: Fit, library: Library) -> list[Screened]:
    """Return the linearised gain of every hypothesis, best first: the best start of each cause and order.

    While all slow errors count as discrepancy, a slow cause gains little. So the best under the learned noise and the best under
    white noise as loud as the residual are judged again.
    """
    if not library.hypotheses:
        return []
    at, whole = tamed(problem, at), library.whole
    linear = _Linear(problem, at.noise, at, whole)
    first = _ranked(linear, library)
    plain = _ranked(_Linear(problem, plain_noise(problem, at), at, whole), library)
    # A hypothesis starts where the learned noise puts it, if it is seen there; else where white noise does.
    seen = {s.hypothesis.key: s for s in first if s.gain > LEAST_GAIN}
    chosen = {s.hypothesis.key: seen.get(s.hypothesis.key, s) for s in (*_best(first), *_best(plain))}
    reference = linear.evidence() if chosen else 0.0
    sensors = sensor_noise(problem.segments, at.point.noise)
    again = [_again(problem, at, library, s, reference, sensors) for s in chosen.values()]
    # Its own noise makes a hypothesis no less likely than the noise that was learned without it.
    again = [replace(s, gain=max(s.gain, seen[key].gain)) if (key := s.hypothesis.key) in seen else s for s in again]
    return sorted([*again, *(s for s in first if s.hypothesis.key not in chosen)], key=lambda s: -s.gain)


def ranked(problem: Problem, at: Fit, library: Library) -> list[Screened]:
    """Return the linearised gain of every hypothesis under a fit's noise, as `screen` does."""
    return _ranked(_Linear(problem, at.noise, at, library.whole), library) if library.hypotheses else []


def _best(ranking: Sequence[Screened]) -> list[Screened]:
    """The first of a ranking that may be present."""
    return [s for s in ranking if s.gain > LEAST_GAIN and s.size > SMALLEST][:AGAIN]


def plain_noise(problem: Problem, at: Fit) -> Noise:
    """Return white noise as loud as a fit's residual in motion, by balance."""
    total, count = np.zeros(len(BALANCES)), np.zeros(len(BALANCES))
    for segment, r in zip(problem.segments, at.point.residual, strict=True):
        use = segment.usable & ~segment.at_rest[:, None]
        total += np.sum(np.where(use, r, 0.0) ** 2, axis=0)
        count += np.sum(use, axis=0)
    rms = np.sqrt(np.divide(total, count, out=np.ones(len(BALANCES)), where=count > 0)) + 1e-12
    one = tuple(AutoregressiveNoise(np.zeros(1), float(x)) for x in rms)
    return Noise((one,) * len(problem.segments), np.zeros_like(at.noise.discrepancy), at.noise.rest, at.noise.bands)


def _ranked(linear: _Linear, library: Library) -> list[Screened]:
    found: dict[tuple, Screened] = {}
    position = 0
    for h, origin in zip(library.hypotheses, library.origins, strict=True):
        block = slice(position, position + len(h.magnitudes))
        position = block.stop
        one = linear.judge(h, origin, block)
        if h.key not in found or one.gain > found[h.key].gain:
            found[h.key] = one
    return sorted(found.values(), key=lambda s: -s.gain)


def _again(problem: Problem, at: Fit, library: Library, s: Screened, reference: float, sensors: Sensors) -> Screened:
    """Judge a hypothesis with the noise that would be learned with it, in the linear model."""
    h, index = s.hypothesis, library.hypotheses.index(s.hypothesis)
    columns, origin, here = library.columns[index], library.origins[index], h.magnitudes
    best = s
    for _ in range(2):
        change = best.start[here] - origin[here]
        r = [a + J @ best.shift + c @ change for a, J, c in zip(at.point.residual, at.jacobian, columns, strict=True)]
        noise = learn(
            problem.segments, r, at.point.noise, problem.quantum(), None, at.noise.bands, sensors, at.noise.rest
        )
        linear = _Linear(problem, noise, at, columns)
        best = linear.judge(h, origin, slice(0, len(here)))
    return replace(best, gain=float(linear.evidence(best, origin) - reference - np.log(h.alternatives)))
