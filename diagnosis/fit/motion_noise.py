"""Corrections of a fit for the noise of the measured motion: mean of the residuals, and bias of closed-loop identification.

*Mean.* Where a law bends, zero-mean noise has a nonzero mean behind it: hysteresis grows with the travel of the torsion, which
encoder counts make longer, and is fitted too strong. To second order this mean equals what another draw of the noise adds again.
It is the mean over a noise replicate and its mirror image, in which everything linear cancels (simulation extrapolation: Cook &
Stefanski, *Simulation-Extrapolation Estimation in Parametric Measurement Error Models*, 1994; antithetic draws).

*Closed loop.* The drive's controller acts on the counts that the log holds, so the rotor follows its encoder's error within the
bandwidth. This error is part of motion and measurement alike; least squares attributes it to the joint: an inertia comes out too
large, a damping too small, both with too much confidence. At the frequencies of the motion itself the error is small. Where
derivatives are noisy, residuals and derivatives are therefore averaged over `PERIOD` before the fit (Janot, Vandanjon & Gautier,
*A Generic Instrumental Variable Approach for Industrial Robot Identification*, IEEE TCST 2014, filter and decimate alike).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..data.segments import DECIMATION, STEP
from .noise import whiten
from .residual import Model, Problem
from .solver import Columns, Fit, Fitter, Point, bounded_step, normal_equations

MATTERS = 0.2  # shift of an unknown, in its standard deviations, from which the mean is removed
PERIOD = 0.032  # of the averages [s]
NOISY = 0.004  # share of noise in an unknown's information from which averages are fitted,
LEFT = 0.05  # if they keep this share of that information
SLOW = 0.3  # share that they must keep of an effect's; an effect at high frequencies stays as it was fitted


def without_noise_mean(problem: Problem, fit: Fit) -> tuple[Problem, Fit]:
    """Remove the mean of the motion's noise from residuals and fit; return both unchanged where it is small."""
    bias = bias_of(problem, fit.theta, fit.model, fit.point)
    normal = normal_equations(problem, fit.noise, fit.model, fit.theta, fit.point, fit.jacobian, fit.noise_jacobian)
    rows = whiten(problem.segments, fit.noise, bias, fit.jacobian).rows
    gradient = -rows[:, 1:].T @ (normal.weight * rows[:, 0])
    low, high = problem.bounds(fit.model)
    shift = bounded_step(normal.hessian, gradient, low - fit.theta, high - fit.theta)
    if np.all(np.abs(shift) < MATTERS * np.sqrt(np.diag(fit.covariance))):
        return problem, fit
    less = problem.less(bias)
    point = Point([r - x for r, x in zip(fit.point.residual, bias, strict=True)], fit.point.noise)
    return less, Fitter(less).settle(replace(fit, point=point))


def bias_of(problem: Problem, theta: np.ndarray, model: Model, point: Point) -> Columns:
    """Return the mean of the residuals due to the noise of motion and readings, shape (k, len(BALANCES)) a segment.

    Args:
      point: the residuals at `theta`.
    """
    other = problem.mirrored().residuals([theta], [model], replicate=True)[0]
    return [0.5 * (n + o - r) for r, n, o in zip(point.residual, point.noise, other, strict=True)]


def fit_to_averages(problem: Problem, fit: Fit) -> Fit:
    """Fit averages of residuals, free of the closed-loop bias; return the fit unchanged where the noise does not matter.

    Args:
      problem: the noise's mean is removed from its residuals.
      fit: of that problem.
    """
    if fit.noise_jacobian is None or not problem.link_measured:
        return fit  # with one encoder a ripple of the gear is faster than any motion, and averages do not contain it
    block = max(round(PERIOD / (STEP * DECIMATION)), 1)
    slow = problem.with_segments(lambda s: replace(s, block=max(block, s.block)))
    fast, averages = (
        normal_equations(p, fit.noise, fit.model, fit.theta, fit.point, fit.jacobian, fit.noise_jacobian)
        for p in (problem, slow)
    )
    prior = 1 / problem.spread(fit.model) ** 2
    whole, left, share = np.diag(fast.hessian) - prior, np.diag(averages.hessian) - prior, np.diag(fast.share)
    if not np.any((left > LEFT * whole) & (share > NOISY * (whole + share))):
        return fit
    held = left < SLOW * whole
    held[: problem.size] = False
    found = Fitter(slow).settle(fit, held=held)
    if not held.any():
        return found
    # Unknowns that were held are as uncertain as before; their uncertainty passes on to the others.
    free, covariance, before = ~held, found.covariance, fit.covariance[np.ix_(held, held)]
    rest, wider = covariance[np.ix_(held, held)], covariance.copy()
    gain = covariance[np.ix_(free, held)] @ np.linalg.inv(rest)
    wider[np.ix_(free, free)] += gain @ (before - rest) @ gain.T
    wider[np.ix_(free, held)] = gain @ before
    wider[np.ix_(held, free)] = wider[np.ix_(free, held)].T
    wider[np.ix_(held, held)] = before
    return replace(found, covariance=wider)
