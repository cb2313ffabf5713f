"""A fit that the noise of the measured motion does not lean on.

The drive's controller acts on the counts that the log holds: within its bandwidth the rotor follows its encoder's error, which is
then part of the motion as well as of the measurement. Least squares takes what the two have in common for the joint's (the bias
of identification in closed loop), and no noise replicate knows it: an inertia comes out too large, a damping too small, both as
sure as can be. At the frequencies of the motion proper the error is small beside it. Where derivatives have noise, numbers are
therefore those of residuals and derivatives averaged over `InstrumentSettings.period` (robots are identified from data that were
low-pass filtered and decimated alike: Janot, Vandanjon & Gautier, *A Generic Instrumental Variable Approach for Industrial Robot
Identification*, IEEE TCST 2014).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..data.segments import DECIMATION, STEP
from .residual import Problem
from .solver import Fit, Fitter, normal_equations


@dataclass(frozen=True)
class InstrumentSettings:
    """When a fit is one to averages.

    Attributes:
      period: over which derivatives and residuals are averaged [s].
      noisy: share of the noise in an unknown's information from which on it is.
      left: share of that information that must be left by the average.
      slow: share that must be left of an effect's; one that shows at high frequencies stays as it is.
    """

    period: float = 0.032
    noisy: float = 0.004
    left: float = 0.05
    slow: float = 0.3


SETTINGS = InstrumentSettings()


def averaged(problem: Problem, period: float) -> Problem:
    """The same problem with residuals that count as one within a period [s]."""
    block = max(round(period / (STEP * DECIMATION)), 1)
    return problem.with_segments(lambda s: replace(s, block=max(block, s.block)))


def instrumented(problem: Problem, fit: Fit, settings: InstrumentSettings = SETTINGS) -> Fit:
    """A fit to averages that the noise of the motion does not lean on; as it is where that noise does not matter.

    Args:
      problem: what is known of the noise's mean is taken from its residuals.
      fit: its point is that problem's.
    """
    if fit.noise_jacobian is None or not problem.link_measured:
        return fit  # with one encoder a ripple of the gear is faster than any motion, and averages have nothing of it
    slow = averaged(problem, settings.period)
    fast, averages = (
        normal_equations(p, fit.noise, fit.model, fit.theta, fit.point, fit.jacobian, fit.noise_jacobian)
        for p in (problem, slow)
    )
    prior = 1 / problem.spread(fit.model) ** 2
    whole, left, share = np.diag(fast.hessian) - prior, np.diag(averages.hessian) - prior, np.diag(fast.share)
    if not np.any((left > settings.left * whole) & (share > settings.noisy * (whole + share))):
        return fit
    held = left < settings.slow * whole
    held[: problem.size] = False
    found = Fitter(slow).settle(fit, held=held)
    return replace(found, covariance=_beside(found.covariance, fit.covariance, held))


def _beside(covariance: np.ndarray, before: np.ndarray, held: np.ndarray) -> np.ndarray:
    """A covariance in which unknowns that were held are as uncertain as before, and others beside them."""
    if not held.any():
        return covariance
    free = ~held
    found = covariance.copy()
    rest = covariance[np.ix_(held, held)]
    gain = covariance[np.ix_(free, held)] @ np.linalg.inv(rest)
    found[np.ix_(free, free)] += gain @ (before[np.ix_(held, held)] - rest) @ gain.T
    found[np.ix_(free, held)] = gain @ before[np.ix_(held, held)]
    found[np.ix_(held, free)] = found[np.ix_(free, held)].T
    found[np.ix_(held, held)] = before[np.ix_(held, held)]
    return found
