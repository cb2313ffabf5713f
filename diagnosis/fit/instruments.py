"""Equations that the noise of the measured motion does not lean on.

The drive's controller acts on the counts that the log holds: within its bandwidth the rotor follows its encoder's error, which is
then part of the motion as well as of the measurement. Least squares takes what the two have in common for the joint's (the bias
of identification in closed loop), and no noise replicate knows it: an inertia comes out too large, a damping too small, both as
sure as can be. At the frequencies of the motion proper the error is small beside it. The equations of unknowns whose derivatives
have noise are therefore those of derivatives and residuals averaged over `InstrumentSettings.period` (instrumental variables;
Janot, Vandanjon & Gautier, *A Generic Instrumental Variable Approach for Industrial Robot Identification*, IEEE TCST 2014).
"""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass, replace

import numpy as np

from ..data.segments import DECIMATION, STEP
from .noise import Noise
from .residual import Problem
from .solver import (
    Fit,
    Fitter,
    Normal,
    as_described,
    bounded_step,
    evaluate_point,
    normal_equations,
    piece_scores,
    scatter,
)


@dataclass(frozen=True)
class InstrumentSettings:
    """Which equations are replaced, and by what.

    Attributes:
      period: over which derivatives and residuals are averaged [s].
      noisy: share of the noise in an unknown's information from which on its equation is replaced.
      left: share of that information that must be left by the average; what shows at high frequencies alone stays.
      iterations: of Gauss–Newton with the new equations.
    """

    period: float = 0.032
    noisy: float = 0.004
    left: float = 0.05
    iterations: int = 2


SETTINGS = InstrumentSettings()


def averaged(problem: Problem, period: float) -> Problem:
    """The same problem with residuals that count as one within a period [s]."""
    block = max(round(period / (STEP * DECIMATION)), 1)
    other = copy(problem)
    other.segments, other.replicates = (
        [replace(s, block=max(block, s.block)) for s in segments] for segments in (problem.segments, problem.replicates)
    )
    return other


def instrumented(problem: Problem, fit: Fit, settings: InstrumentSettings = SETTINGS) -> Fit:
    """A fit by equations that the noise of the motion does not lean on; as it is where that noise does not matter."""
    if fit.noise_jacobian is None or not problem.link_measured:
        return fit  # with one encoder a ripple of the gear is faster than any motion, and averages have nothing of it
    slow = averaged(problem, settings.period)
    noise = Fitter(slow).learnt(fit.point, fit.jacobian, fit.covariance)
    low, high = problem.bounds(fit.model)
    found = fit
    for _ in range(settings.iterations):
        fast, averages, taken = _equations(problem, slow, found, noise, settings)
        if not taken.any():
            return fit
        matrix = np.where(taken[:, None], averages.hessian, fast.hessian)
        gradient = np.where(taken, averages.gradient, fast.gradient)
        theta = found.theta + bounded_step(matrix, gradient, low - found.theta, high - found.theta)
        found = replace(found, theta=theta, point=evaluate_point(problem, theta, fit.model))
        if not all(np.isfinite(r).all() for r in found.point.residual):
            return fit
    covariance = as_described(problem, _covariance(problem, slow, found, noise, settings))
    return replace(found, covariance=covariance)


def _equations(
    problem: Problem, slow: Problem, at: Fit, noise: Noise, settings: InstrumentSettings
) -> tuple[Normal, Normal, np.ndarray]:
    """Normal equations of all residuals and of their averages at a point, and the unknowns whose equation the averages give."""
    fast, averages = (
        normal_equations(p, n, at.model, at.theta, at.point, at.jacobian, at.noise_jacobian)
        for p, n in ((problem, at.noise), (slow, noise))
    )
    prior = 1 / problem.spread(at.model) ** 2
    whole, left, share = np.diag(fast.hessian) - prior, np.diag(averages.hessian) - prior, np.diag(fast.share)
    return fast, averages, (share > settings.noisy * (whole + share)) & (left > settings.left * whole)


def _covariance(problem: Problem, slow: Problem, at: Fit, noise: Noise, settings: InstrumentSettings) -> np.ndarray:
    """Covariance M⁻¹ V M⁻ᵀ of what solves mixed equations of matrix M, the score's variance V by the noise model; where the
    score's own scatter says more, as much larger."""
    fast, averages, taken = _equations(problem, slow, at, noise, settings)
    prior = np.diag(1 / problem.spread(at.model) ** 2)
    matrix = np.where(taken[:, None], averages.hessian, fast.hessian)
    # Of one unknown's averages and another's residuals the averages are what both have in common.
    both = taken[:, None] | taken
    variance = np.where(both, averages.hessian + 2 * averages.share, fast.hessian + 2 * fast.share)
    pieces = np.where(taken, piece_scores(slow, at, noise, averages), piece_scores(problem, at, at.noise, fast))
    modelled, scattered = (_solved(matrix, v) for v in (variance, scatter(pieces) + prior))
    wider = np.sqrt(np.maximum(np.diag(scattered) / np.diag(modelled), 1.0))
    return modelled * wider[:, None] * wider


def _solved(matrix: np.ndarray, variance: np.ndarray) -> np.ndarray:
    """M⁻¹ V M⁻ᵀ, of units of their own."""
    d = 1 / np.sqrt(np.abs(np.diag(matrix)))
    inverse = d[:, None] * np.linalg.inv(matrix * d[:, None] * d) * d
    return inverse @ variance @ inverse.T
