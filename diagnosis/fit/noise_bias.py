"""What the measured motion's noise does to a fit on average.

Where a law bends, noise that is zero in the mean is not so behind it: a torsion that an encoder's counts shake travels further
than the joint's does, so that hysteresis, which grows with that way, is fitted too strong; friction turns round more often than
the joint. To second order in the noise, what it makes of a residual in the mean is what another draw of it makes of the residual
again: the mean over a noise replicate and its mirror image, in which all that is linear in the noise cancels (simulation
extrapolation: Cook & Stefanski, *Simulation-Extrapolation Estimation in Parametric Measurement Error Models*, 1994; the mirror
image is what Monte Carlo calls an antithetic draw).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from .noise import whiten
from .residual import Model, Problem
from .solver import Columns, Fit, Fitter, Point, bounded_step, normal_equations


@dataclass(frozen=True)
class BiasSettings:
    """When a fit is corrected.

    Attributes:
      matters: shift of an unknown, in its standard deviations, from which on it is.
    """

    matters: float = 0.2


SETTINGS = BiasSettings()


def without_noise_bias(problem: Problem, fit: Fit, settings: BiasSettings = SETTINGS) -> tuple[Problem, Fit]:
    """A fit without what the noise of the measured motion adds to it in the mean, and the problem less that; both as they are
    where it is little."""
    bias = bias_of(problem, fit.theta, fit.model, fit.point)
    normal = normal_equations(problem, fit.noise, fit.model, fit.theta, fit.point, fit.jacobian, fit.noise_jacobian)
    rows = whiten(problem.segments, fit.noise, bias, fit.jacobian).rows
    gradient = -rows[:, 1:].T @ (normal.weight * rows[:, 0])
    low, high = problem.bounds(fit.model)
    shift = bounded_step(normal.hessian, gradient, low - fit.theta, high - fit.theta)
    if np.all(np.abs(shift) < settings.matters * np.sqrt(np.diag(fit.covariance))):
        return problem, fit
    less = problem.less(bias)
    point = Point([r - x for r, x in zip(fit.point.residual, bias, strict=True)], fit.point.noise)
    return less, Fitter(less).settle(replace(fit, point=point))


def bias_of(problem: Problem, theta: np.ndarray, model: Model, point: Point) -> Columns:
    """What the noise of motion and readings makes of the residuals in the mean, shape (k, len(BALANCES)) a segment.

    Args:
      point: the residuals at `theta`.
    """
    other = problem.mirrored().residuals([theta], [model], replicate=True)[0]
    return [0.5 * (n + o - r) for r, n, o in zip(point.residual, point.noise, other, strict=True)]
