"""Calibration: most probable numbers of the joint without causes."""

from __future__ import annotations

import numpy as np

from ..fit.encoder_zero import zeroed
from ..fit.noise import EVEN
from ..fit.residual import Problem
from ..fit.solver import Fit, Fitter
from .contribution import excess, noise_square

SLOW = 2.0  # ratio of slow to fast model discrepancy from which the fit also starts from least squares
PLAINLY = 1.5  # ratio of two errors (RMS) from which the larger one is no fit, whatever the likelihood
CHANCE = 0.1  # part of the sensors' noise (mean square) by which two errors may differ by chance


def calibrate(fitter: Fitter, iterations: int = 9) -> Fit:
    """Fit the joint without causes.

    A slow discrepancy can hold what parameters would: gravity and friction then decide nothing, and the likelihood has a second
    maximum. Where the residual is mostly slow, a fit from least squares is therefore tried as well.
    """
    problem = fitter.problem
    annealed = fitter.fit((), zeroed(problem, problem.start(None, ()), ()), None, iterations)
    fast, slow = np.split(annealed.noise.discrepancy, [2], axis=1)
    if not np.any(slow.max(axis=1) > SLOW * fast.max(axis=1)):
        return annealed
    quick = Fitter(problem, EVEN).fit((), annealed.theta, annealed, iterations, renew=True)
    other = fitter.fit((), quick.theta, quick, iterations, renew=True)
    if _plainly_less(problem, quick, other):
        # Later steps lost it to slow discrepancy: one step only.
        other = fitter.fit((), quick.theta, None, 1)
    return better(problem, annealed, other)


def better(problem: Problem, a: Fit, b: Fit) -> Fit:
    """Return the likelier of two fits of a model, unless its simulation error is several times as large."""
    for one, other in ((a, b), (b, a)):
        if _plainly_less(problem, one, other):
            return one
    return max((a, b), key=lambda f: f.log_evidence)


def _plainly_less(problem: Problem, one: Fit, other: Fit) -> bool:
    """Whether the error of a fit is several times smaller than another's, by more than chance."""
    chance = CHANCE * noise_square(problem, other)
    return excess(problem, one) + chance < excess(problem, other) / PLAINLY**2
