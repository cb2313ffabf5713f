"""Diagnosis of a measurement against a joint's description: causes, their confidence, and the extended joint."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np
from threadpoolctl import threadpool_limits

from ..estimator.conditioning import as_logged, condition
from ..models import causes
from ..models.calibration import in_quadratures
from ..models.joint import Joint
from ..models.recording import Measurement
from .answer import Diagnosis
from .conclusion import ANSWER, Conclusion
from .data import coverage
from .data.mistakes import Mistake, find_mistakes, unclipped
from .data.segments import pushed, segments
from .data.stretches import most_telling
from .extension import extended
from .fit import encoder_zero
from .fit.coordinates import Hypothesis, hypotheses
from .fit.motion_noise import fit_to_averages, without_noise_mean
from .fit.regions import shrunk, unseen_square
from .fit.residual import Problem
from .fit.solver import Fit, Fitter, with_dispersion
from .improvement import serves
from .regression import Regression, regressions
from .search import discrepancy
from .search.calibrate import CHANCE, PLAINLY, calibrate
from .search.clock import wrong_clock
from .search.contribution import excess, noise_square
from .search.explore import Explored, Explorer, Progress, without
from .search.identifiability import limits
from .search.least_squares import fitter_in_motion, least_squares, regression_fit
from .search.posterior import IMPERFECTION, TRACE, quiet_rms
from .verdict import answer_of, invalid_data


# Replays use the cores; BLAS's threads would only wait for them, spinning.
@threadpool_limits.wrap(limits=1, user_api="blas")
def diagnose(
    measurement: Measurement,
    joint: Joint,
    progress: Progress = lambda stage, done: None,
    seconds: float = np.inf,
) -> Diagnosis:
    """Diagnose a measurement against a joint's description.

    Args:
      measurement: recordings of the joint.
      joint: its description, with any effects that are known.
      progress: called as a stage begins, with its name and the share of the work that is done.
      seconds: time after which no further stage begins; the answer is the best by then.
    """
    begin = time.monotonic()
    answer = _diagnosed(measurement, joint, progress, begin + seconds)
    reasons = (*answer.reasons, *measurement.fixed)  # with what `flexspline import --fix` changed
    return replace(answer, reasons=reasons, seconds=time.monotonic() - begin)


def _diagnosed(measurement: Measurement, joint: Joint, progress: Progress, deadline: float) -> Diagnosis:
    """Check the data, search, fit, and judge on held-out data."""
    progress("looking for mistakes in the data", 0.0)
    mistakes = find_mistakes(measurement, joint)
    if any(m.severe for m in mistakes):
        return invalid_data(joint, mistakes)
    whole = unclipped(measurement, joint, mistakes)
    measurement = most_telling(whole)
    described = as_logged(joint, measurement.recordings)
    joint = in_quadratures(described)
    conditioned = [condition(r, joint) for r in measurement.recordings]
    problem = Problem(*segments(conditioned, joint), joint)
    pairs = zip(measurement.recordings, conditioned, strict=True)
    missing = coverage.undetermined(measurement, joint, [coverage.summarise(r, joint, c) for r, c in pairs])
    plain = regressions(measurement, joint, conditioned)
    nothing = coverage.too_little(measurement, joint)
    if nothing is None and not any(s.usable.any() for s in problem.segments):
        nothing = "no part without gaps moves the rotor far enough to settle its friction"
    if nothing is not None:
        return Diagnosis(
            "inconclusive", (nothing,), (), {}, (), missing, {}, (), described, mistakes=mistakes, regressions=plain,
            used=measurement,
        )  # fmt: skip
    offered = _offered(problem, measurement)
    progress("calibrating the joint", 0.02)
    found, slow, clock = _search(problem, offered, plain, progress, deadline)
    if clock is not None:
        return invalid_data(joint, (*mistakes, clock))
    progress("numbers and their uncertainty", 0.92)
    if slow:
        problem, final = _corrected(problem, _polished(Fitter(problem), found.best))
        judged = final = _inflated(problem, final)
    else:
        # The likelihood is the one with the smaller error on unseen time.
        fits = [(fit(problem, found.best), fit) for fit in (_by_least_squares, _annealed)]
        judged, again = min(fits, key=lambda one: unseen_square(problem, one[0]))
        judged, final = _inflated(problem, judged), _inflated(problem, again(problem.with_held_out(), found.best))
    progress("regions that a fit has not seen", 0.97)
    no_worse = serves(measurement, joint, conditioned)
    small = shrunk(problem, final, lambda f: no_worse(extended(problem, f, joint)))
    undetermined, alike = _limits(problem, found, final, offered, missing)
    zeros = _zeros(measurement, problem, final)
    # An encoder zero that moves looks like a spring, an unmeasured push like any cause.
    open_ = zeros or all(pushed(r) for r in measurement.recordings) or small.share == 0.0
    surest, vague = (ANSWER.unsure if x else ANSWER.surest for x in (open_, _rotor_unknown(problem, judged)))
    conclusion = Conclusion(problem, found, judged, final, small, missing, undetermined, alike, surest, vague, zeros)
    answer = answer_of(conclusion, measurement, conditioned)
    if small.share == 0.0:  # nothing was learned of the phases
        kept = {"kinematic_error": described.kinematic_error}
        answer = replace(answer, extended=answer.extended.model_copy(update=kept))
    if measurement is not whole:
        part, all_ = (sum(len(r.time) * r.interval for r in m.recordings) for m in (measurement, whole))
        why = f"the {part:.0f} s with the most information were diagnosed, of {all_:.0f} s: errors are those in these parts"
        answer = replace(answer, reasons=(*answer.reasons, why))
    return replace(answer, mistakes=mistakes, regressions=plain, used=measurement)


def _search(
    problem: Problem,
    offered: list[Hypothesis],
    plain: tuple[Regression, ...],
    progress: Progress,
    deadline: float,
) -> tuple[Explored, bool, Mistake | None]:
    """Search known and unknown effects.

    Returns:
      The result, whether slow errors may count as model discrepancy in the best fit, and a wrong clock that explains more.
    """
    slow = problem.link_measured
    if slow:
        fitter = Fitter(problem)
        base = start = calibrate(fitter)
    else:
        # One encoder determines what a regression does: start from there, by least squares.
        fitter, first = fitter_in_motion(problem), regression_fit(problem, offered, plain)
        start = fitter.fit(first.model, first.theta)
        base = fitter.fit((), first.theta[: problem.size]) if first.model else start
    explorer = Explorer(fitter, offered, progress=progress, deadline=deadline)
    found = explorer.explore(base, start)
    if time.monotonic() < deadline:
        progress("looking for unknown effects", 0.85)
        found = _with_unknown(problem, explorer, found, slow)
    else:
        found = replace(found, complete=False)
    if slow and quiet_rms(problem, found.best) > ANSWER.far and time.monotonic() < deadline:
        # A slow discrepancy can hold what causes would, with a likelihood as good.
        progress("searching by least squares", 0.9)
        fitter = fitter_in_motion(problem)
        start = fitter.fit((), encoder_zero.zeroed(problem, problem.start(None, ()), ()))
        explorer = Explorer(fitter, offered, deadline=deadline)
        other = explorer.explore(start, start)
        if unseen_square(problem, other.best) < unseen_square(problem, found.best):
            found, slow = other, False
    clock = wrong_clock(explorer, found) if time.monotonic() < deadline else None
    return (found if slow else _serving(problem, explorer, found, start)), slow, clock


def _with_unknown(problem: Problem, explorer: Explorer, found: Explored, slow: bool) -> Explored:
    """Add an unknown effect to a result, if that is more probable.

    Far from the noise the causes found may compensate for one: the calibrated joint is looked at first. With one encoder (not
    `slow`) it must predict unseen time better, too.
    """
    astray = quiet_rms(problem, found.best) > ANSWER.far and found.best.model
    for at in (found.base, found.best) if astray else (found.best,):
        one = discrepancy.find(explorer.fitter, explorer.posterior(at), found.base, at)
        other = None if one is None else explorer.with_unknown(found, one)
        if other is not None and (slow or unseen_square(problem, other.best) < unseen_square(problem, found.best)):
            return other
    return found


def _serving(problem: Problem, explorer: Explorer, found: Explored, plain: Fit) -> Explored:
    """Return a result that predicts unseen time no worse than the regression's fit (`plain`), or than with a cause less."""
    fitter = explorer.fitter
    error, best = min(((unseen_square(problem, f), f) for f in (found.best, plain)), key=lambda one: one[0])
    if any(not h.free for h in best.model):  # an unknown effect would take the place of any cause
        return found
    while best.model:
        linear = [without(problem, best, i) for i in range(len(best.model))]
        start = min(linear, key=lambda one: one[1])[0]  # the cause of which the data say least
        less = fitter.fit(start.model, start.theta)
        if (fewer := unseen_square(problem, less)) > error:
            break
        best, error = less, fewer
    if best is found.best:
        return found
    _, models = explorer.neighbours(best, explorer.library(best))
    return replace(found, best=best, models=tuple(models))


def _rotor_unknown(problem: Problem, f: Fit) -> bool:
    """Whether a residual may be of the rotor's motion, which neither an encoder nor a torque sensor shows."""
    shown = any(s.rotor_measured or s.has_torque for s in problem.segments)
    return not shown and quiet_rms(problem, f) > ANSWER.far


def _offered(problem: Problem, measurement: Measurement) -> list[Hypothesis]:
    """Every hypothesis that the measurement can show and the joint has room for."""
    joint = problem.joint
    record = problem.calibration.record(np.zeros(problem.calibration.size))
    present = {effect.name: effect.values for effect in joint.effects}
    shown = [n for n in causes.of(joint) if coverage.can_show(n, measurement, problem.link_measured)]
    return problem.with_room((), [h for n in shown for h in hypotheses(causes.get(n), record, present.get(n))])


def _zeros(measurement: Measurement, problem: Problem, f: Fit) -> dict[str, float]:
    """Link encoder's zero of each recording relative to the first [rad]; empty if it did not move, or the fit is good."""
    if len(measurement.recordings) < 2 or quiet_rms(problem, f) <= ANSWER.far:
        return {}
    moved, less = encoder_zero.zero_by_recording(problem)
    numbers = problem.joint.numbers
    most = ANSWER.rezeroed * numbers["rated_torque"].value / numbers["K1"].value
    if not less >= ANSWER.less or np.ptp([*moved.values()]) < most:
        return {}
    first = next(iter(moved.values()))
    return {name: x - first for name, x in moved.items()}


def _inflated(problem: Problem, f: Fit) -> Fit:
    """Widen a fit's covariance by the noise ratio where more than noise remains (Birge's ratio).

    Errors of the laws are not random: they bias parameters the same way all the time. Small imperfections that look like an
    effect (an encoder's eccentricity like a kinematic error) are part of its size, however well that is known. So is the
    difference between a real joint's law and ours (`Cause.inexact`).
    """
    ratio = quiet_rms(problem, f)
    quiet = ratio <= ANSWER.quiet
    inexact = np.zeros(len(f.theta))
    for i, (h, u) in enumerate(zip(f.model, problem.split(f.theta, f.model), strict=True)):
        if not h.free:
            continue
        inexact[problem.place(f.model, i)] = TRACE if quiet else IMPERFECTION
        if h.cause.inexact and not quiet:
            sizes, unit = h.values(u), h.deviation(u, np.eye(h.size))
            law = [h.cause.inexact * abs(sizes[q.name]) / unit[q.name] if q.magnitude else 0.0 for q in h.free]
            inexact[problem.place(f.model, i)] = np.hypot(IMPERFECTION, law)
    if quiet:
        return replace(f, covariance=f.covariance + np.diag(inexact**2))
    # Prior knowledge stays: of a friction that the data know only as a product, the tolerance.
    spread = problem.spread(f.model)
    spread[: problem.size][problem.held] = 1.0
    known = np.linalg.inv(f.covariance / spread[:, None] / spread) - np.eye(len(spread))
    values, vectors = np.linalg.eigh(0.5 * (known + known.T))
    inflation = min(ratio, ANSWER.far) ** 2
    scaled = (vectors / (1.0 + np.maximum(values, 0.0) / inflation)) @ vectors.T
    return replace(f, covariance=scaled * spread[:, None] * spread + np.diag(inexact**2))


def _by_least_squares(problem: Problem, f: Fit) -> Fit:
    """Fit a model by least squares in motion."""
    return with_dispersion(problem, least_squares(problem, f.model, f.theta))


def _annealed(problem: Problem, f: Fit) -> Fit:
    """Fit a model with slow errors as model discrepancy."""
    fitter = Fitter(problem)
    return _polished(fitter, fitter.fit(f.model, f.theta))


def _polished(fitter: Fitter, f: Fit) -> Fit:
    """Subtract the noise's share from a fit, unless that fails, as at a stop, whose stiffness amplifies noise."""
    polished = fitter.polish(f)
    if _lost(fitter.problem, polished, f):
        polished = _uncorrected(f, polished)
    return with_dispersion(fitter.problem, polished)


def _uncorrected(before: Fit, after: Fit) -> Fit:
    """A fit before a failed correction, with the correction as uncertainty."""
    away = after.theta - before.theta
    return replace(before, covariance=before.covariance + np.outer(away, away))


def _lost(problem: Problem, after: Fit, before: Fit) -> bool:
    """Whether a correction failed: the error is much larger after it."""
    return excess(problem, after) > PLAINLY**2 * excess(problem, before) + CHANCE * noise_square(problem, before)


def _corrected(problem: Problem, f: Fit) -> tuple[Problem, Fit]:
    """Correct a fit for the noise of the measured motion; return it with its problem, the noise's mean subtracted.

    Where more than noise remains, the noise is multiplied by the noise ratio: numbers that the data hardly determine stay near
    the description.
    """
    ratio = quiet_rms(problem, f)
    start = f
    # An unknown effect has no description to stay near.
    if ratio > ANSWER.quiet and not any(isinstance(h, discrepancy.Spline) for h in f.model):
        settled = Fitter(problem).settle(replace(f, noise=f.noise.louder(min(ratio, ANSWER.far))))
        start = f if _lost(problem, settled, f) else settled
    less, unbiased = without_noise_mean(problem, start)
    found = fit_to_averages(less, unbiased)
    if found is f:
        return problem, f
    if _lost(problem, found, start):
        return problem, replace(_uncorrected(start, found), noise=f.noise)
    covariance = found.covariance
    for after, before in ((unbiased, start), (found, unbiased)):
        unknown = ANSWER.inexact_bias * (after.theta - before.theta)
        covariance = covariance + np.outer(unknown, unknown)
    return less, replace(found, noise=f.noise, covariance=covariance, least_covariance=covariance)


def _limits(
    problem: Problem, found: Explored, final: Fit, offered: list[Hypothesis], missing: dict[str, str]
) -> tuple[dict[str, str], tuple[tuple[str, str], ...]]:
    """Undetectable causes with the reason, and confounded pairs."""
    weak, alike = limits(problem, found.best, found.library)
    named = {h.cause.name for h in final.model}
    undetermined = dict(missing)
    looked = {h.cause.name for h in offered}
    for name in causes.of(problem.joint):
        if name not in looked and name not in undetermined:
            undetermined[name] = "it affects the torsion, which one encoder does not measure"
    for name in weak:
        undetermined.setdefault(name, "at ordinary size it would drown in tolerances and noise")
    return {n: r for n, r in sorted(undetermined.items()) if n not in named}, tuple(alike)
