"""Which causes the data speak for: screening of the whole library, then evidence of the few that could be it.

*Screening* is linear: the derivative (secant at part of its ordinary size) of the replayed residuals with respect to every
cause, at the calibrated joint, with all calibration variables free to answer. It gives each cause's approximate log
evidence in closed form. *Finalists* are fitted through the replay together with the calibration, and compared by
their Laplace evidence. A further cause is added when it earns more than `THRESHOLD`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .calibrate import Echo, Fit, Problem, fit, normal_equations, robust_loss
from .coordinates import Hypothesis
from .noise import Noise, whiten

THRESHOLD = 7.0
"""Log evidence that a cause must add."""
SECANT = 0.3
"""Part of the ordinary size at which a cause is probed."""
FINALISTS = 5


@dataclass(frozen=True)
class Screened:
    """A hypothesis with its linearised gain in log evidence and the coordinates that the linear model gives it."""

    hypothesis: Hypothesis
    gain: float
    start: np.ndarray


class Library:
    """Columns of every hypothesis at a fit, for screening.

    Attributes:
      hypotheses: the hypotheses.
      columns: of each the derivatives of the residuals, shape (k, 3, m) a stretch.
      noise_columns: the motion noise's share of them.
    """

    def __init__(self, problem: Problem, at: Fit, hypotheses: list[Hypothesis]):
        self.hypotheses = hypotheses
        thetas, models = [], []
        for h in hypotheses:
            for j in _probed(h):
                u = np.zeros(h.size)
                u[j] = SECANT
                thetas.append(np.concatenate([at.theta, u]))
                models.append((*at.model, h))
        base = at.state[0]
        done = iter(problem.residuals(thetas, models))
        self.columns = []
        for h in hypotheses:
            parts = [next(done) for _ in _probed(h)]
            self.columns.append(
                [np.stack([(part[s] - base[s]) / SECANT for part in parts], -1) for s in range(len(base))]
            )


def _probed(h: Hypothesis) -> list[int]:
    return h.magnitudes


def screen(problem: Problem, noise: Noise, at: Fit, library: Library) -> list[Screened]:
    """Linearised gain in log evidence of every hypothesis, best first; one per cause and order, its best start."""
    count = [len(_probed(h)) for h in library.hypotheses]
    all_columns = [
        np.concatenate([c[s] for c in library.columns], axis=-1) for s in range(len(problem.drives))
    ]
    stack = whiten(
        problem.drives,
        noise,
        [
            np.concatenate([r[..., None], j, c], -1)
            for r, j, c in zip(at.state[0], at.jacobian, all_columns, strict=True)
        ],
    )
    r, X = stack[:, 0], stack[:, 1:]
    _, weight = robust_loss(r)
    n = at.jacobian[0].shape[-1]
    H, g, _ = normal_equations(problem, noise, at.model, at.theta, at.state, at.jacobian, at.twin_jacobian)
    C = X[:, n:]
    CW = C * weight[:, None]
    cross = CW.T @ X[:, :n]
    solved = np.linalg.solve(H, cross.T)
    information = CW.T @ C - cross @ solved
    score = -(CW.T @ r) + solved.T @ g
    found: dict[tuple, Screened] = {}
    position = 0
    for h, m in zip(library.hypotheses, count, strict=True):
        block = slice(position, position + m)
        position += m
        spread = h.spread[_probed(h)]
        A = information[block, block] + np.diag(1 / spread**2)
        b = score[block]
        u = np.linalg.solve(A, b)
        _, logdet = np.linalg.slogdet(A * spread[:, None] * spread)
        gain = 0.5 * b @ u - 0.5 * logdet - np.log(h.alternatives)
        start = np.zeros(h.size)
        start[_probed(h)] = u
        if not h.polar and np.any(h.confine(start) != start):
            # The sign is not possible: what the bound leaves.
            inside = h.confine(start)[_probed(h)]
            gain = b @ inside - 0.5 * inside @ A @ inside - 0.5 * logdet - np.log(h.alternatives)
            start = h.confine(start)
        key = (h.cause.name, *h.fixed.items())
        if key not in found or gain > found[key].gain:
            found[key] = Screened(h, float(gain), start)
    return sorted(found.values(), key=lambda s: -s.gain)


def finalists(screened: list[Screened], count: int, per_cause: int = 2) -> list[Screened]:
    """The best hypotheses, at most `per_cause` of the same cause."""
    chosen: list[Screened] = []
    taken: dict[str, int] = {}
    for s in screened:
        name = s.hypothesis.cause.name
        if taken.get(name, 0) < per_cause and len(taken | {name: 0}) <= count:
            taken[name] = taken.get(name, 0) + 1
            chosen.append(s)
    return chosen


def clean(problem: Problem, noise: Noise, at: Fit, library: Library) -> list[np.ndarray]:
    """Residuals without anything that a calibration variable or a cause can explain (ridge): noise, nearly."""
    columns = [
        np.concatenate([j, *(c[s] for c in library.columns)], axis=-1) for s, j in enumerate(at.jacobian)
    ]
    stack = whiten(
        problem.drives, noise, [np.concatenate([r[..., None], c], -1) for r, c in zip(at.state[0], columns, strict=True)]
    )
    r, X = stack[:, 0], stack[:, 1:]
    _, weight = robust_loss(r, 3.0 * max(1.0, 1.4826 * float(np.median(np.abs(r[r != 0])))))
    XW = X * weight[:, None]
    A = XW.T @ X
    d = np.sqrt(np.diag(A)) + 1e-12
    u = np.linalg.solve(A / d[:, None] / d + 1e-6 * np.eye(len(A)), XW.T @ r / d) / d
    return [res - c @ u for res, c in zip(at.state[0], columns, strict=True)]


def refine(
    problem: Problem, noise: Noise, base: Fit, candidates: list[Screened], echo: Echo, iterations: int = 6
) -> list[Fit]:
    """Fit every candidate on top of a base model through the replay."""
    fits = []
    for s in candidates:
        h = s.hypothesis
        theta = np.concatenate([base.theta, h.confine(np.clip(s.start, -3.0, 3.0))])
        model = (*base.model, h)
        kept = [j[..., : problem.size] for j in base.jacobian]
        fits.append(fit(problem, noise, model, theta, iterations, 0.5, common=kept, echo=echo))
    return sorted(fits, key=lambda f: -f.log_evidence)
