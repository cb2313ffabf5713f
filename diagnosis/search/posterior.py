"""Posterior probability of a set of causes: tempered evidence of its fit, and a prior of three parts for every cause.

A cause is absent, an imperfection that every real joint has a little of, or an effect of ordinary size (a spike and two slabs).
Whether this joint has imperfections is unknown, too: in a joint that follows the laws, a cause is an effect or a trace of the
numerics.

The evidence is Laplace's (`Fit.log_evidence`). No description is exact, so samples carry less information than the noise model
states: the log likelihood is divided by a temper (a coarsened posterior: Miller and Dunson, 2019).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any

import numpy as np

from ..fit.noise import EVEN, normalised_rms
from ..fit.residual import Problem
from ..fit.solver import Fit, scatter_by_unknown
from .contribution import amount_of, contribution_of, magnitudes_at, size_of

TEMPER = 4.0  # divisor of the log likelihood where only noise is left; times the noise ratio,
MOST = 2.5  # this one at most
IMPERFECTION = 0.05  # standard deviation of an imperfection, in ordinary sizes
COMMON = 0.1  # prior odds that a real joint has a given one
TRACE = 0.01  # standard deviation of an absent cause through the reconstruction of the motion, in ordinary sizes
IDEAL, WIDTH = (
    1.15,
    0.02,
)  # noise ratio at which a joint is as likely real as ideal; change that makes one e times as likely
LOOKALIKE = 2.0  # part of the unexplained error where a cause acts (RMS) that may look like it
UNKNOWN = 10.0  # log prior odds of a known cause against an unknown effect, and of a usual against an unusual place
EFFECT = 0.1  # probability of an effect below which a cause counts as an imperfection
KNOWN = 0.1  # variance of an unknown over its prior's below which the data determine it
_HELD = 1e-6  # spread of an unknown that does not move
NOTHING: Mapping[int, float] = MappingProxyType({})
NO_PAIRS: Mapping[tuple[int, int], float] = MappingProxyType({})


def quiet_rms(problem: Problem, f: Fit) -> float:
    """Return the noise ratio: normalised RMS of a fit's residual against the sensors' noise alone, one at least."""
    bare = replace(f.noise, discrepancy=np.zeros_like(f.noise.discrepancy))
    return max(1.0, normalised_rms(problem.segments, bare, f.point.residual))


def dispersion(problem: Problem, f: Fit) -> float:
    """Return the score's scatter between pieces of a second over the noise model's, one at least.

    The median over unknowns that the data determine.
    """
    pieces, information = scatter_by_unknown(problem, f)
    known = information > 1 / (KNOWN * problem.spread(f.model) ** 2)
    ratio = np.sum(pieces**2, axis=0)[known] / information[known]
    return max(float(np.median(ratio)), 1.0) if known.any() else 1.0


@dataclass(frozen=True)
class Judged:
    """A fitted model.

    Attributes:
      score: its log posterior, up to a constant of the measurement.
      effects: probability of each cause that it is an effect and no imperfection, given that it is present.
    """

    fit: Fit
    score: float
    effects: tuple[float, ...]

    @property
    def keys(self) -> frozenset[Any]:
        """Its causes."""
        return self.fit.keys


class ModelPosterior:
    """Log posterior of models of one problem.

    Args:
      reference: the fit whose residual sets the temper, and whether the joint is real.
      number: of causes that are looked at.
    """

    def __init__(self, problem: Problem, reference: Fit, number: int):
        self.problem, self.reference, self.number = problem, reference, number
        quiet = quiet_rms(problem, reference)
        self.temper = TEMPER * min(quiet, MOST)
        if reference.noise.bands == EVEN:  # a lasting error is not in the noise, and counts once, not sample by sample
            self.temper = max(self.temper, dispersion(problem, reference))
        self.real = float(np.clip((quiet - IDEAL) / WIDTH, -20.0, 20.0))

    def judge(
        self,
        f: Fit,
        lost: Mapping[int, float] = NOTHING,
        looks_like: Mapping[int, float] = NOTHING,
        both_small: Mapping[tuple[int, int], float] = NO_PAIRS,
    ) -> Judged:
        """Return the log posterior of a model.

        Args:
          lost: by index of a cause, loss of log likelihood in a fit without it: at the end of a number's tolerance a cause is
            better known than by its curvature.
          looks_like: by index of a cause, its `unexplained_size`: the prior of an imperfection is that much wider.
          both_small: the same of the first of two causes, if the second is an imperfection, too: each of them alone
            can be small if the other is large.
        """
        if not np.isfinite(f.log_evidence):
            return Judged(f, -np.inf, (0.0,) * len(f.model))
        T, n = self.temper, len(f.model)
        evidence = f.log_evidence - self.reference.log_evidence
        ordinary, small, trace = np.full((3, n), -np.inf)
        pairs = np.zeros((2, n, n))
        for i, h in enumerate(f.model):
            if h.cause.name == "unknown":  # neighbouring coefficients are alike: its evidence is tempered as a whole
                ordinary[i] = -np.log(self.number) - UNKNOWN * (1 if getattr(h, "usual", False) else 2)
                continue
            sigma = float(h.spread[h.magnitudes[0]])
            where = magnitudes_at(self.problem, f, i)
            precision = np.linalg.inv(f.covariance[np.ix_(where, where)]) * sigma**2
            u = amount_of(self.problem, f, i)[h.magnitudes] / sigma
            # Each part of the prior, untempered, replaces the ordinary prior in the tempered evidence.
            evidence += 0.5 * np.linalg.slogdet(precision)[1] + np.log(h.alternatives) + 0.5 * float(u @ u)
            values, vectors = np.linalg.eigh(0.5 * (precision + precision.T) - np.eye(len(u)))
            known, along = np.maximum(values, 1e-9) / T, vectors.T @ u
            if i in lost and u @ u > 0:
                known = np.maximum(known, 2 * lost[i] / T / float(u @ u))
            many = np.log(h.alternatives)
            if h.cause.includes:  # that it is more than its special case is as usual as an imperfection
                many -= np.log(COMMON)
            ordinary[i] = _slab(known, along, 1.0) - np.log(self.number) - many
            for part, pair, least in ((small, pairs[0], IMPERFECTION), (trace, pairs[1], TRACE)):
                own = _slab(known, along, float(np.hypot(least, looks_like.get(i, 0.0))) / sigma)
                part[i] = own + np.log(COMMON) - many
                for (first, second), width in both_small.items():
                    if first == i:
                        pair[i, second] = min(_slab(known, along, float(np.hypot(least, width)) / sigma) - own, 0.0)
        (real, effects_real), (ideal, effects_ideal) = (
            _combined(ordinary, part, pair) for part, pair in ((small, pairs[0]), (trace, pairs[1]))
        )
        log_real, log_ideal = real + min(0.0, self.real), ideal + min(0.0, -self.real)
        both = float(np.logaddexp(log_real, log_ideal))
        effects = np.exp(log_ideal - both) * effects_ideal + np.exp(log_real - both) * effects_real
        return Judged(f, float(evidence / T + both), tuple(float(x) for x in effects))


def _combined(effect: np.ndarray, imperfection: np.ndarray, pairs: np.ndarray) -> tuple[float, np.ndarray]:
    """Return the log sum over which of n causes are effects and which are imperfections, and each one's probability of an effect.

    Args:
      effect, imperfection: log weights, shape (n,).
      pairs: added for each two that are both imperfections, shape (n, n).
    """
    either = np.logaddexp(effect, imperfection)
    total, found = float(either.sum()), np.exp(effect - either)
    tied = np.flatnonzero(pairs.any(axis=0) | pairs.any(axis=1))
    if not len(tied):
        return total, found
    small = (np.arange(2 ** len(tied))[:, None] >> np.arange(len(tied))) % 2 == 1  # every combination of these
    log = np.where(small, imperfection[tied], effect[tied]).sum(axis=1)
    log = log + np.einsum("si,ij,sj->s", small, pairs[np.ix_(tied, tied)], small) - either[tied].sum()
    weight = np.exp(log)
    found[tied] = (weight @ ~small) / weight.sum()
    return total + float(np.log(weight.sum())), found


def unexplained_size(problem: Problem, f: Fit, linear: Fit, index: int, effects: Sequence[float]) -> float:
    """Return the size that the unexplained error, where a cause acts, may have of it, in ordinary sizes.

    Args:
      linear: the fit with `solver.tamed` derivatives.
      effects: probability of each cause that it is an effect; an imperfection does not answer.
    """
    spread = problem.spread(f.model)
    for i, effect in enumerate(effects):
        if effect < EFFECT:
            spread[problem.place(f.model, i)] = _HELD
    share = contribution_of(problem, f, linear, index, spread).share
    return LOOKALIKE * size_of(problem, f, index) / max(share, 1e-12) ** 0.5


def _slab(known: np.ndarray, along: np.ndarray, width: float) -> float:
    """Log evidence of a normal prior of a `width` over that at the likelihood's maximum, in its own axes.

    Args:
      known: precision of the likelihood by axis; along: place of its maximum.
    """
    w = width * width
    return float(np.sum(-0.5 * np.log1p(known * w) - 0.5 * along**2 / (1 / known + w)))
