"""Calibration: the joint without causes, or with those it has, at its most probable numbers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...models.calibration import NARROW, Slot, factor_of, variable_of
from ..fit.coordinates import Hypothesis
from ..fit.noise import EVEN
from ..fit.residual import REACH, Model, Problem
from ..fit.solver import Fit, Fitter
from ..fit.tare import tared
from .worth import left_by, noise_of


@dataclass(frozen=True)
class CalibrateSettings:
    """How the joint is calibrated before any cause is tried.

    Attributes:
      iterations: of Gauss–Newton.
      stuck: a number that the data know well and that sits so many standard deviations from nominal may stand in for an effect.
      unsettled: normalised RMS against the sensors' noise from which on a second start is tried.
      slow: ratio of slow to fast model discrepancy from which on the fit is also tried from least squares.
      plainly: times as small as that of the likelier fit that the error of the other must be, to be the better one, `chance`
        of the sensors' noise (mean square) aside.
    """

    iterations: int = 9
    stuck: float = 0.92 * REACH
    unsettled: float = 1.35
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


def doubtful(problem: Problem, f: Fit, quiet: float, settings: CalibrateSettings) -> bool:
    """Whether a fit may sit in a local minimum: more than noise is left, and a number is `at_the_end`."""
    return at_the_end(problem, f, settings) and quiet > settings.unsettled


def at_the_end(problem: Problem, f: Fit, settings: CalibrateSettings = SETTINGS) -> bool:
    """Whether a number that the data know well is near the end of its tolerance."""
    n = problem.calibration.size
    known = np.diag(f.covariance)[:n] < 0.3**2
    return bool(np.any(known & (np.abs(f.theta[:n]) > settings.stuck)))


def fields_at_the_end(problem: Problem, f: Fit, settings: CalibrateSettings = SETTINGS) -> set[str]:
    """Fields of the record whose numbers are at the end of their tolerances: a cause may go on where they cannot."""
    at_end = {n for n, x in zip(problem.calibration.names, f.theta, strict=False) if abs(x) > settings.stuck}
    return {s.field for s in problem.calibration.slots if {s.name, f"shared {s.number.shared}"} & at_end}


def afresh(fitter: Fitter, f: Fit, settings: CalibrateSettings) -> Fit:
    """The same model calibrated anew, its effects as they are: numbers that stood in for an effect let go of it."""
    problem = fitter.problem
    theta = np.concatenate([np.zeros(problem.size), f.theta[problem.size :]])
    return fitter.fit(f.model, tared(problem, theta, f.model), iterations=settings.iterations)


def hand_over(problem: Problem, theta: np.ndarray, model: Model) -> np.ndarray:
    """The same joint with less strain: what a cause that scales numbers can do better than their tolerances, it does.

    Along that path products stay constant, which is straight to first order only: Gauss–Newton does not find the way.
    """
    theta = theta.copy()
    c, at = problem.calibration, problem.size
    for h in model:
        slots = _scaled(problem, h)
        if slots:
            name = h.free[0].name
            x, u = theta[: c.size], theta[at : at + 1]
            now = h.values(u)[name]
            best, chosen = np.inf, None
            for scale in (now, *(now * np.geomspace(0.6, 1.6, 121))):
                shares = _shares(problem, slots, x, now / scale)
                v = h.coordinates({name: scale})
                low, high = h.limits
                if shares is None or not low[0] <= v[0] <= high[0]:
                    continue
                cost = float(sum(y * y for y in shares.values()) + (v[0] / h.spread[0]) ** 2)
                if cost < best - 1e-9:
                    best, chosen = cost, (shares, v)
            if chosen is not None:
                for name, y in chosen[0].items():
                    theta[c.names.index(name)] = y
                theta[at : at + 1] = chosen[1]
        at += h.size
    return theta


def _scaled(problem: Problem, h: Hypothesis) -> list[Slot]:
    """The numbers with tolerances that a cause of one parameter multiplies; none where it does something else."""
    if not h.cause.scales or len(h.free) != 1 or h.free[0].relative:
        return []
    return [s for s in problem.calibration.slots if s.index < 0 and s.field in h.cause.scales]


def _shares(problem: Problem, slots: list[Slot], x: np.ndarray, factor: float) -> dict[str, float] | None:
    """Calibration variables that make the numbers `factor` times what they are at x; None where tolerances end."""
    c, joint = problem.calibration, problem.joint
    ratios = {s.name: factor * c.value(s, x) / s.number.value for s in slots}
    shared = {s.number.shared for s in slots}
    found: dict[str, float] = {}
    common = 1.0
    if shared != {None}:
        if len(shared) != 1:
            return None
        name = shared.pop()
        assert name is not None
        spread = joint.shared_tolerances[name]
        logs = np.log([ratios[s.name] for s in slots])
        own = np.array([s.number.tolerance for s in slots])
        weight = 1 / np.maximum(own, 1e-6) ** 2
        width = np.log1p(spread) if spread > NARROW else spread
        y = width * np.sum(weight * logs) / (1 + width**2 * np.sum(weight))
        found[f"shared {name}"] = float(y)
        common = float(factor_of(np.array(spread), np.array(y)))
    for s in slots:
        if s.number.tolerance:
            found[s.name] = variable_of(s.number.tolerance, ratios[s.name] / common)
    return found if all(abs(y) <= REACH for y in found.values()) else None
