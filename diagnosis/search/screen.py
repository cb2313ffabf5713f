"""Screening: the linearised gain in log evidence of every hypothesis at a fit, with all other unknowns free to answer.

The derivative of the replayed residuals with respect to every cause (a secant at part of its ordinary size) gives each
cause's approximate log evidence in closed form. The few that look best are judged again with the noise that would be
left if they were there: what they explain is then no discrepancy any more.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..data.segments import BALANCES
from ..fit.coordinates import Hypothesis
from ..fit.noise import AutoregressiveNoise, Noise, Sensors, learn, sensor_noise, whiten
from ..fit.residual import Problem
from ..fit.solver import SETTINGS as SOLVER
from ..fit.solver import (
    Columns,
    Fit,
    bounded_step,
    gram,
    huber_loss,
    huber_weight,
    leverage_weight,
    prior_cost,
    tamed,
)
from .worth import mean_squares


@dataclass(frozen=True)
class ScreenSettings:
    """How hypotheses are screened.

    Attributes:
      probe: part of the ordinary size at which a cause is probed.
      least_gain: linearised log evidence below which a hypothesis is left out.
      smallest: part of the ordinary size below which it is left out.
      again: hypotheses of either ranking that are judged again with the noise that they would leave.
    """

    probe: float = 0.03
    least_gain: float = 3.5
    smallest: float = 0.015
    again: int = 5


SETTINGS = ScreenSettings()


@dataclass(frozen=True)
class Screened:
    """A hypothesis with its linearised gain in log evidence, and where the linear model puts it.

    Attributes:
      start: coordinates of the hypothesis.
      shift: change of the other unknowns that goes with them.
      noise: that it would leave, where it was judged again.
      removed: mean square that it alone would take from the residual [N·m at the output]², likewise.
    """

    hypothesis: Hypothesis
    gain: float
    start: np.ndarray
    shift: np.ndarray
    noise: Noise | None = None
    removed: float = 0.0

    @property
    def size(self) -> float:
        """In ordinary sizes."""
        return float(np.linalg.norm(self.start[self.hypothesis.magnitudes]))

    @property
    def key(self) -> tuple:
        """The cause with its whole numbers."""
        return (self.hypothesis.cause.name, *self.hypothesis.fixed.items())


class Library:
    """Columns of every hypothesis at a fit.

    Attributes:
      hypotheses: the hypotheses.
      origins: of each the coordinates at which the joint stays as it is, shape (size,).
      columns: of each the derivatives of the residuals in its magnitudes, shape (k, len(BALANCES), m) a segment.
    """

    def __init__(self, problem: Problem, at: Fit, hypotheses: Sequence[Hypothesis], probe: float):
        self.hypotheses = list(hypotheses)
        thetas, models = [], []
        record = problem.records(at.theta, at.model)[0][0]
        # A cause that replaces a number starts from what calibration has made of it.
        self.origins = [h.coordinates(h.cause.centre(record, h.fixed)) for h in self.hypotheses]
        for h, origin in zip(self.hypotheses, self.origins, strict=True):
            for j in h.magnitudes:
                u = origin.copy()
                u[j] += probe
                thetas.append(np.concatenate([at.theta, u]))
                models.append((*at.model, h))
        base, *moved = problem.residuals([at.theta, *thetas], [at.model, *models])
        done = iter(moved)
        self.columns: list[Columns] = []
        for h in self.hypotheses:
            parts = [next(done) for _ in h.magnitudes]
            columns = [np.stack([(part[s] - base[s]) / probe for part in parts], -1) for s in range(len(base))]
            self.columns.append(columns)

    def of(self, hypothesis: Hypothesis) -> Columns:
        """Columns of one hypothesis."""
        return self.columns[self.hypotheses.index(hypothesis)]

    @property
    def whole(self) -> Columns:
        """Columns of all hypotheses side by side; there is at least one."""
        return [np.concatenate(parts, -1) for parts in zip(*self.columns, strict=True)]

    def keeping(self, hypotheses: Sequence[Hypothesis]) -> Library:
        """The library of some of its hypotheses."""
        kept = [i for i, h in enumerate(self.hypotheses) if any(h is g for g in hypotheses)]
        found = object.__new__(Library)
        found.hypotheses = [self.hypotheses[i] for i in kept]
        found.origins = [self.origins[i] for i in kept]
        found.columns = [self.columns[i] for i in kept]
        return found


class _Linear:
    """The linear model about a fit under a noise: normal equations of the other unknowns, and whitened columns of hypotheses."""

    def __init__(self, problem: Problem, noise: Noise, at: Fit, columns: Columns):
        white = whiten(problem.segments, noise, at.point.residual, at.jacobian, columns)
        self.problem, self.at, self.rows, self.log_determinant = problem, at, white.rows, white.log_determinant
        rows = white.rows
        n = at.jacobian[0].shape[-1]
        # Rows that a fit hardly counts do not decide here either: where derivatives are extreme, the linear model is far off.
        self.leverage = leverage_weight(rows[:, 1 : problem.size + 1], SOLVER.leverage)
        G = gram(rows, self.leverage * huber_weight(rows[:, 0], SOLVER.huber))
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
        # Calibration's own way back from its bounds is no merit of a cause.
        step = bounded_step(self.H, self.g, self.low, self.high)
        self.idle = float(self.g @ step + 0.5 * step @ self.H @ step)

    def judge(self, h: Hypothesis, origin: np.ndarray, block: slice) -> Screened:
        """Gain and place of one hypothesis whose columns stand at `block`."""
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
            # The sign is not possible: what the bound leaves.
            start = h.confine(start)
            change = start[at] - begin
            gain = b @ change - 0.5 * change @ A @ change - cost
        shift = -self.solved[:, block] @ change
        if self.held.any():
            # What is at the end of its tolerance may come back when the cause takes over its part.
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
        """Log evidence of the linear model; of a hypothesis in it whose columns stand alone. Comparable between noises."""
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
        H = gram(X, self.leverage * huber_weight(r, SOLVER.huber)) + np.diag(1 / spread**2)
        cost += float(np.sum(self.leverage * huber_loss(r, SOLVER.huber))) + prior_cost(problem, theta, self.at.model)
        return -0.5 * (cost + float(np.linalg.slogdet(H * spread[:, None] * spread)[1]))


def screen(problem: Problem, at: Fit, library: Library, settings: ScreenSettings = SETTINGS) -> tuple[Screened, ...]:
    """Linearised gain in log evidence of every hypothesis, best first; one per cause and order, its best start.

    What a cause does slowly counts little as long as all that is slow is taken for discrepancy, also its own. So the ones that
    are judged again are the best under the noise that was learned and the best under white noise as loud as the residual.
    """
    if not library.hypotheses:
        return ()
    at, whole = tamed(problem, at), library.whole
    linear = _Linear(problem, at.noise, at, whole)
    ranked = _ranked(linear, library)
    plain = _ranked(_Linear(problem, plain_noise(problem, at), at, whole), library)
    # From where white noise puts it the noise that a hypothesis would leave is none beside which it is seen: from there only if
    # it is not seen under the noise that was learned.
    seen = {s.key: s for s in ranked if s.gain > settings.least_gain}
    chosen = {s.key: seen.get(s.key, s) for s in (*_best(ranked, settings), *_best(plain, settings))}
    reference = linear.evidence() if chosen else 0.0
    sensors = sensor_noise(problem.segments, at.point.noise)
    again = [_again(problem, at, library, s, reference, sensors) for s in chosen.values()]
    # Under the noise that is likeliest beside it a hypothesis is no less likely than under the one that was learned without it.
    again = [replace(s, gain=max(s.gain, seen[s.key].gain)) if s.key in seen else s for s in again]
    return tuple(sorted([*again, *(s for s in ranked if s.key not in chosen)], key=lambda s: -s.gain))


def ranked(problem: Problem, at: Fit, library: Library) -> list[Screened]:
    """Linearised gain of every hypothesis under a fit's noise, best first; one per cause and order, its best start."""
    return _ranked(_Linear(problem, at.noise, at, library.whole), library) if library.hypotheses else []


def _best(ranked: Sequence[Screened], settings: ScreenSettings) -> list[Screened]:
    """The first of a ranking, as far as they could be there."""
    return [s for s in ranked if s.gain > settings.least_gain and s.size > settings.smallest][: settings.again]


def plain_noise(problem: Problem, at: Fit) -> Noise:
    """White noise as loud as a fit's residual is in motion, balance by balance."""
    total, count = np.zeros(len(BALANCES)), np.zeros(len(BALANCES))
    for segment, r in zip(problem.segments, at.point.residual, strict=True):
        use = segment.usable & ~segment.at_rest[:, None]
        total += np.sum(np.where(use, r, 0.0) ** 2, axis=0)
        count += np.sum(use, axis=0)
    rms = np.sqrt(np.divide(total, count, out=np.ones(len(BALANCES)), where=count > 0)) + 1e-12
    one = tuple(AutoregressiveNoise(np.zeros(1), float(x)) for x in rms)
    return Noise((one,) * len(problem.segments), np.zeros_like(at.noise.discrepancy), at.noise.rest, at.noise.settings)


def _ranked(linear: _Linear, library: Library) -> list[Screened]:
    found: dict[tuple, Screened] = {}
    position = 0
    for h, origin in zip(library.hypotheses, library.origins, strict=True):
        block = slice(position, position + len(h.magnitudes))
        position = block.stop
        one = linear.judge(h, origin, block)
        key = (h.cause.name, *h.fixed.items())
        if key not in found or one.gain > found[key].gain:
            found[key] = one
    return sorted(found.values(), key=lambda s: -s.gain)


def _again(problem: Problem, at: Fit, library: Library, s: Screened, reference: float, sensors: Sensors) -> Screened:
    """A hypothesis judged with the noise that it would leave, in the linear model."""
    columns, h = library.of(s.hypothesis), s.hypothesis
    origin = library.origins[library.hypotheses.index(h)]
    here = h.magnitudes
    best, gain = s, s.gain
    for last in (False, True):
        change = best.start[here] - origin[here]
        r = [a + J @ best.shift + c @ change for a, J, c in zip(at.point.residual, at.jacobian, columns, strict=True)]
        noise = learn(
            problem.segments, r, at.point.noise, problem.quantum(), None, at.noise.settings, sensors, at.noise.rest
        )
        linear = _Linear(problem, noise, at, columns)
        one = linear.judge(h, origin, slice(0, len(here)))
        if last:
            gain = linear.evidence(one, origin) - reference - np.log(h.alternatives)
        best = Screened(h, float(gain), one.start, one.shift, noise)
    change = best.start[here] - origin[here]
    own = [J @ best.shift + c @ change for J, c in zip(at.jacobian, columns, strict=True)]
    removed = mean_squares(problem, own).sum()
    return replace(best, removed=float(removed))
