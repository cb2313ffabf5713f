"""Calibration: the joint without causes, or with those it has, at its most probable numbers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..fit.noise import EVEN
from ..fit.residual import Problem
from ..fit.solver import Fit, Fitter
from ..fit.tare import tared
from .worth import left_by, noise_of


@dataclass(frozen=True)
class CalibrateSettings:
    """How the joint is calibrated before any cause is tried.

    Attributes:
      iterations: of Gauss–Newton.
      slow: ratio of slow to fast model discrepancy from which on the fit is also tried from least squares.
      plainly: times as small as that of the likelier fit that the error of the other must be, to be the better one, `chance`
        of the sensors' noise (mean square) aside.
    """

    iterations: int = 9
    slow: float = 2.0
    plainly: float = 1.5
    chance: float = 0.1


SETTINGS = CalibrateSettings()


def calibrate(fitter: Fitter, settings: CalibrateSettings = SETTINGS) -> Fit:
    """The joint without causes at its most probable numbers."""
    problem = fitter.problem
    start = tared(problem, problem.start(None, ()), ())
    annealed = fitter.fit((), start, None, settings.iterations)
    return from_least_squares(fitter, annealed, settings) if is_slow(annealed, settings) else annealed


def is_slow(f: Fit, settings: CalibrateSettings = SETTINGS) -> bool:
    """Whether what a fit leaves is mostly slow.

    A slow discrepancy can hold what parameters would: gravity and friction then decide nothing, and the likelihood has a second
    maximum with much of it.
    """
    fast, slow = np.split(f.noise.discrepancy, [2], axis=1)
    return bool(np.any(slow.max(axis=1) > settings.slow * fast.max(axis=1)))


def from_least_squares(
    fitter: Fitter, annealed: Fit, settings: CalibrateSettings = SETTINGS, beside: Fit | None = None
) -> Fit:
    """The better of a fit, and one that goes on from least squares; `beside` as of `Fitter.fit`."""
    problem, model = fitter.problem, annealed.model
    least_squares = Fitter(problem, fitter.settings, EVEN)
    quick = least_squares.fit(model, annealed.theta, annealed, settings.iterations, anew=True)
    other = fitter.fit(model, quick.theta, quick, settings.iterations, beside, anew=True)
    if _plainly_less(problem, quick, other, settings):
        # Further on, slow discrepancy takes over here too.
        other = fitter.fit(model, quick.theta, None, 1, beside)
    return better(problem, annealed, other, settings)


def better(problem: Problem, a: Fit, b: Fit, settings: CalibrateSettings = SETTINGS) -> Fit:
    """The likelier of two fits of a model; but whatever the likelihood says, a simulation that is off by several times as much is
    no calibration."""
    for one, other in ((a, b), (b, a)):
        if _plainly_less(problem, one, other, settings):
            return one
    return max((a, b), key=lambda f: f.log_evidence)


def _plainly_less(problem: Problem, one: Fit, other: Fit, settings: CalibrateSettings) -> bool:
    """Whether a fit leaves several times less than another, by more than the chance of the sensors' noise."""
    chance = settings.chance * noise_of(problem, other)
    return left_by(problem, one) + chance < left_by(problem, other) / settings.plainly**2
