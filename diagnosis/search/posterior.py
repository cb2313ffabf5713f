"""How probable a set of causes is: tempered evidence of its fit, with a prior of three parts for every cause.

A cause is absent, an imperfection that every real joint has a little of, or an effect of ordinary size (a spike and two slabs).
Whether this joint has imperfections at all is unknown, too: joints that follow the laws leave nothing but noise, and a cause in
them is an effect or a trace of the numerics.

The evidence is Laplace's (`Fit.log_evidence`). No description holds exactly, so that samples say less than the noise model takes
them to say: the log likelihood is divided by a temper (a coarsened posterior: Miller and Dunson, 2019).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np

from ..fit import solver
from ..fit.noise import EVEN, normalised_rms
from ..fit.residual import Problem
from ..fit.solver import Fit
from .worth import amount_of, magnitudes_at, size_of, worth_of


@dataclass(frozen=True)
class PriorSettings:
    """The prior, and how much samples say.

    Attributes:
      temper: by which the log likelihood is divided where nothing but noise is left; times the residual over the noise, `most`
        at most.
      imperfection: standard deviation of an imperfection, in ordinary sizes.
      common: prior odds that a real joint has one of them.
      trace: standard deviation of what the reconstruction of the motion makes of a cause that is not there, in ordinary sizes.
      ideal, width: normalised RMS of the residual at which a joint is as likely real as ideal, and by how much more or less it is
        e times as likely one of them.
      lookalike: times what is left unexplained where a cause acts (RMS) that may look like it: a cause that is not there has
        taken the part of it that looks like the cause most.
      unknown: log prior odds of a known cause against an unknown effect, and of a place where effects of its variable usually sit
        against another.
    """

    temper: float = 4.0
    most: float = 2.5
    imperfection: float = 0.05
    common: float = 0.1
    trace: float = 0.01
    ideal: float = 1.15
    width: float = 0.02
    lookalike: float = 2.0
    unknown: float = 10.0


SETTINGS = PriorSettings()
NOTHING: Mapping[int, float] = MappingProxyType({})


def quiet_rms(problem: Problem, f: Fit) -> float:
    """Normalised RMS of a fit's residual against the sensors' noise alone: one where nothing but noise is left."""
    bare = replace(f.noise, discrepancy=np.zeros_like(f.noise.discrepancy))
    return max(1.0, normalised_rms(problem.segments, bare, f.point.residual))


def dispersion(problem: Problem, f: Fit) -> float:
    """Return by how much more the score scatters between pieces of a second than the noise model says: the median over the
    unknowns that the data know, and one at least."""
    pieces, information = solver.scatter_by_unknown(problem, f)
    known = information > 1 / (_KNOWN * problem.spread(f.model) ** 2)
    ratio = np.sum(pieces**2, axis=0)[known] / information[known]
    return max(float(np.median(ratio)), 1.0) if known.any() else 1.0


_KNOWN = 0.1
"""Variance of an unknown over its prior's below which the data know it."""


@dataclass(frozen=True)
class Judged:
    """A model that was fitted.

    Attributes:
      score: its log posterior, up to a constant of the measurement.
      effects: of each of its causes, the probability that it is an effect and no imperfection, if it is there.
    """

    fit: Fit
    score: float
    effects: tuple[float, ...]

    @property
    def keys(self) -> frozenset:
        """Its causes."""
        return frozenset(h.key for h in self.fit.model)


class ModelPosterior:
    """Log posterior of models of one problem.

    Args:
      reference: the fit whose residual says how much samples say, and whether the joint is real.
      number: of causes that are looked at.
    """

    def __init__(self, problem: Problem, reference: Fit, number: int, settings: PriorSettings = SETTINGS):
        self.problem, self.reference, self.number, self.settings = problem, reference, number, settings
        quiet = quiet_rms(problem, reference)
        self.temper = settings.temper * min(quiet, settings.most)
        if reference.noise.settings is EVEN:  # what lasts is not in the noise, and counts once, not sample by sample
            self.temper = max(self.temper, dispersion(problem, reference))
        self.real = float(np.clip((quiet - settings.ideal) / settings.width, -20.0, 20.0))

    def judge(self, f: Fit, lost: Mapping[int, float] = NOTHING, looks_like: Mapping[int, float] = NOTHING) -> Judged:
        """The log posterior of a model.

        Args:
          lost: by index of a cause, log likelihood that is lost without it, where a fit without it was made: where a number's
            tolerance ends a cause is better known than its curvature at the fit says.
          looks_like: by index of a cause, the size that what nothing explains may have of it (`unexplained_size`): its part of
            the prior that is no effect is that much wider.
        """
        if not np.isfinite(f.log_evidence):
            return Judged(f, -np.inf, (0.0,) * len(f.model))
        T, s = self.temper, self.settings
        evidence = f.log_evidence - self.reference.log_evidence
        ordinary, small, trace = [], [], []
        for i, h in enumerate(f.model):
            if h.cause.name == "unknown":  # neighbouring coefficients are alike: its evidence is tempered as a whole
                ordinary.append(-np.log(self.number) - s.unknown * (1 if getattr(h, "usual", False) else 2))
                small.append(-np.inf)
                trace.append(-np.inf)
                continue
            sigma = float(h.spread[h.magnitudes[0]])
            where = magnitudes_at(self.problem, f, i)
            precision = np.linalg.inv(f.covariance[np.ix_(where, where)]) * sigma**2
            u = amount_of(self.problem, f, i)[h.magnitudes] / sigma
            # Out of the evidence, divided by the temper with it, goes the ordinary prior; in comes each part of the prior, whole.
            evidence += 0.5 * np.linalg.slogdet(precision)[1] + np.log(h.alternatives) + 0.5 * float(u @ u)
            values, vectors = np.linalg.eigh(0.5 * (precision + precision.T) - np.eye(len(u)))
            known, along = np.maximum(values, 1e-9) / T, vectors.T @ u
            if i in lost and u @ u > 0:
                known = np.maximum(known, 2 * lost[i] / T / float(u @ u))
            many = np.log(h.alternatives)
            ordinary.append(_slab(known, along, 1.0) - np.log(self.number) - many)
            for part, width in ((small, s.imperfection), (trace, s.trace)):
                width = float(np.hypot(width, looks_like.get(i, 0.0)))
                part.append(_slab(known, along, width / sigma) + np.log(s.common) - many)
        o = np.array(ordinary)
        real, ideal = (np.logaddexp(o, np.array(rest)) for rest in (small, trace))
        log_real, log_ideal = real.sum() + min(0.0, self.real), ideal.sum() + min(0.0, -self.real)
        both = float(np.logaddexp(log_real, log_ideal))
        effects = np.exp(log_ideal - both + o - ideal) + np.exp(log_real - both + o - real)
        return Judged(f, float(evidence / T + both), tuple(float(x) for x in effects))


def unexplained_size(
    problem: Problem, f: Fit, linear: Fit, index: int, effects: Sequence[float], settings: PriorSettings = SETTINGS
) -> float:
    """Size that what nothing explains may have of one of a fit's causes, in ordinary sizes: what is left where the cause acts,
    taken for it.

    Args:
      linear: the fit with `solver.tamed` derivatives.
      effects: of each cause, the probability that it is an effect: another one that is not takes over nothing.
    """
    spread = problem.spread(f.model)
    for i, effect in enumerate(effects):
        if effect < EFFECT:
            spread[magnitudes_at(problem, f, i)] = _HELD
    share = worth_of(problem, f, linear, index, spread).share
    return settings.lookalike * size_of(problem, f, index) / max(share, 1e-12) ** 0.5


_HELD = 1e-6  # spread of what does not move
EFFECT = 0.1
"""Probability of an effect below which a cause is taken for an imperfection."""


def _slab(known: np.ndarray, along: np.ndarray, width: float) -> float:
    """Log evidence of a normal prior of a `width` over that at the likelihood's maximum, in its own axes.

    Args:
      known: precision of the likelihood by axis; along: where its maximum is.
    """
    w = width * width
    return float(np.sum(-0.5 * np.log1p(known * w) - 0.5 * along**2 / (1 / known + w)))
