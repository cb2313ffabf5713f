"""Recordings in, causes out: what a joint hides, how sure that is, and the joint extended by it."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np
from threadpoolctl import threadpool_limits

from ..estimator.conditioning import as_logged
from ..models import causes
from ..models.joint import Joint
from ..models.recording import Measurement
from .answer import Diagnosis
from .conclusion import ANSWER, Conclusion
from .data import coverage
from .data.mistakes import find_mistakes
from .data.segments import pushed, segments
from .data.stretches import most_telling
from .extension import extended
from .fit import tare
from .fit.coordinates import Hypothesis, hypotheses
from .fit.instruments import instrumented
from .fit.noise_bias import without_noise_bias
from .fit.regions import drawn_back, held_out_regions
from .fit.residual import Problem
from .fit.solver import Fit, Fitter, with_dispersion
from .improvement import serves
from .regression import regressions
from .search import discrepancy
from .search.calibrate import calibrate
from .search.explore import Explored, Explorer, Progress
from .search.identifiability import limits
from .search.plain import least_squares, moving, plain_fit
from .search.posterior import quiet_rms
from .search.worth import alone, left_by, noise_of
from .telling import answer_of, meaningless, nothing_usable


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
      joint: its description; effects in it are known already.
      progress: told the stages as they begin, with the share that is done.
      seconds: after which no further stage begins: the answer is the best by then.
    """
    begin = time.monotonic()
    deadline = begin + seconds
    progress("looking for mistakes in the data", 0.0)
    mistakes = find_mistakes(measurement, joint)
    if any(m.severe for m in mistakes):
        return _noted(meaningless(joint, mistakes, time.monotonic() - begin), measurement)
    measurement = most_telling(measurement)
    joint = as_logged(joint, measurement.recordings)
    problem = Problem(*segments(list(measurement.recordings), joint), joint)
    missing = coverage.undetermined(measurement, joint)
    if not any(s.usable.any() for s in problem.segments):
        why = coverage.too_little(measurement, joint)
        return _noted(nothing_usable(why, joint, mistakes, missing, time.monotonic() - begin), measurement)
    offered = _offered(problem, measurement)
    said = regressions(measurement, joint)
    progress("calibrating the joint", 0.02)
    slow_too = problem.link_measured  # whether what lasts may be model discrepancy, or least squares has to hold it
    if slow_too:
        fitter = Fitter(problem)
        base = start = calibrate(fitter)
    else:
        # With one encoder a measurement says what a regression says: from there, and by least squares.
        fitter, plain = moving(problem), plain_fit(problem, offered, said)
        start = fitter.fit(plain.model, plain.theta)
        base = fitter.fit((), plain.theta[: problem.size]) if plain.model else start
    explorer = Explorer(fitter, offered, progress=progress, deadline=deadline)
    found = explorer.explore(base, start)
    unknown = None
    if time.monotonic() < deadline:
        progress("looking for unknown effects", 0.85)
        # Where much is left the causes that were found may stand for it, and their fit is no place to look from.
        astray = quiet_rms(problem, found.best) > ANSWER.far and found.best.model
        for at in (base, found.best) if astray else (found.best,):
            one = discrepancy.find(fitter, explorer.posterior(at), base, at)
            if one is not None:
                other, unknown = explorer.beside(found, one)
                if not slow_too and _unseen(problem, other.best) > _unseen(problem, found.best):
                    unknown = None
                found = found if unknown is None else other
            if unknown is not None:
                break
    else:
        found = replace(found, complete=False)
    if slow_too and quiet_rms(problem, found.best) > ANSWER.far and time.monotonic() < deadline:
        # A slow discrepancy can hold what causes would, and has a likelihood as good.
        progress("searching by least squares", 0.9)
        fitter = moving(problem)
        base = fitter.fit((), tare.tared(problem, problem.start(None, ()), ()))
        other = Explorer(fitter, offered, deadline=deadline).explore(base, base)
        if _unseen(problem, other.best) < _unseen(problem, found.best):
            found, unknown, slow_too = other, None, False
    progress("numbers and their uncertainty", 0.92)
    if not slow_too and unknown is None:
        found = _serving(problem, explorer, found)
    if slow_too:
        problem, final = _corrected(problem, _at_its_end(Fitter(problem), found.best))
        judged = final = _inflated(problem, final)
    else:
        # Which likelihood serves is seen where the fit has not been.
        fits = [(fit(problem, found.best), fit) for fit in (_by_least_squares, _annealed)]
        judged, end = min(fits, key=lambda one: _unseen(problem, one[0]))
        judged, final = _inflated(problem, judged), _inflated(problem, end(problem.with_held_out(), found.best))
    progress("regions that a fit has not seen", 0.97)
    no_worse = serves(measurement, joint)
    drawn = drawn_back(problem, final, serves=lambda f: no_worse(extended(problem, f, joint, unknown)))
    undetermined, alike = _limits(problem, found, final, offered, missing)
    surest, zeros = ANSWER.surest, _zeros(measurement, problem, final)
    # A zero that moves between recordings looks like a spring, a push that was not measured like any cause, and what does not
    # hold where it was not fitted is not sure to be there.
    if zeros or all(pushed(r) for r in measurement.recordings) or drawn.share == 0.0:
        surest = ANSWER.unsure
    conclusion = Conclusion(
        problem, found, unknown, judged, final, drawn, missing, undetermined, alike, surest, zeros
    )  # fmt: skip
    answer = replace(answer_of(conclusion, measurement), mistakes=mistakes, regressions=said)
    return _noted(replace(answer, seconds=time.monotonic() - begin), measurement)


def _serving(problem: Problem, explorer: Explorer, found: Explored) -> Explored:
    """What was found less the causes without which regions that a fit has not seen are predicted as well."""
    best, fitter = found.best, explorer.fitter
    while any(h.free for h in best.model):
        fewer = [
            fitter.fit(tuple(g for g in best.model if g is not h), best.theta[alone(problem, best, i)[1]])
            for i, h in enumerate(best.model)
            if h.free
        ]
        less = min(fewer, key=lambda f: _unseen(problem, f))
        if _unseen(problem, less) > _unseen(problem, best):
            break
        best = less
    if best is found.best:
        return found
    _, models = explorer.neighbours(best, explorer.library(best))
    return replace(found, best=best, models=tuple(models))


def _unseen(problem: Problem, f: Fit) -> float:
    """Mean squares that a fit leaves of regions that it has not seen, summed; of everything where there is none [N·m]²."""
    regions = held_out_regions(problem, f)
    return sum(r.unseen**2 for r in regions) if regions else left_by(problem, f)


def _offered(problem: Problem, measurement: Measurement) -> list[Hypothesis]:
    """Every hypothesis that the measurement can show and for which the joint has room."""
    joint = problem.joint
    record = problem.calibration.record(np.zeros(problem.calibration.size))
    present = {effect.name: effect.values for effect in joint.effects}
    shown = [n for n in causes.of(joint) if coverage.can_show(n, measurement, problem.link_measured)]
    return problem.with_room((), [h for n in shown for h in hypotheses(causes.get(n), record, present.get(n))])


def _noted(found: Diagnosis, measurement: Measurement) -> Diagnosis:
    """The same, with what `flexspline import --fix` changed in the data among its reasons."""
    return replace(found, reasons=(*found.reasons, *measurement.fixed))


def _zeros(measurement: Measurement, problem: Problem, f: Fit) -> dict[str, float]:
    """By how much the link encoder's zero of each recording lies from that of the first [rad], where they differ and a fit leaves
    far more than noise; else empty."""
    if len(measurement.recordings) < 2 or quiet_rms(problem, f) <= ANSWER.far:
        return {}
    moved, less = tare.zeros(problem)
    numbers = problem.joint.numbers
    most = ANSWER.rezeroed * numbers["rated_torque"].value / numbers["K1"].value
    if not less >= ANSWER.less or np.ptp([*moved.values()]) < most:
        return {}
    first = next(iter(moved.values()))
    return {name: x - first for name, x in moved.items()}


def _inflated(problem: Problem, f: Fit) -> Fit:
    """The fit, less sure by its residual's normalised RMS of what the data say where more than noise is left (Birge's ratio).

    What no description holds is not random: it leans on the parameters the same way all the time. Small imperfections that look
    like an effect (an encoder's eccentricity like a kinematic error) are part of its size, however well that is known, and so is
    what a real joint's law makes of a number that is another law's (`Cause.inexact`).
    """
    ratio = quiet_rms(problem, f)
    plain = ratio <= ANSWER.quiet
    inexact = np.zeros(len(f.theta))
    for i, (h, u) in enumerate(zip(f.model, problem.split(f.theta, f.model), strict=True)):
        if not h.free:
            continue
        inexact[problem.place(f.model, i)] = ANSWER.inexact_size if plain else ANSWER.lookalike
        if h.cause.inexact and not plain:
            sizes, unit = h.values(u), h.deviation(u, np.eye(h.size))
            law = [h.cause.inexact * abs(sizes[q.name]) / unit[q.name] if q.magnitude else 0.0 for q in h.free]
            inexact[problem.place(f.model, i)] = np.hypot(ANSWER.lookalike, law)
    if plain:
        return replace(f, covariance=f.covariance + np.diag(inexact**2))
    # What is known before the data stays known: a friction of which they tell only the product with its tolerance.
    spread = problem.spread(f.model)
    spread[: problem.size][problem.held] = 1.0  # what is held is known as it was described
    known = np.linalg.inv(f.covariance / spread[:, None] / spread) - np.eye(len(spread))
    values, vectors = np.linalg.eigh(0.5 * (known + known.T))
    inflation = min(ratio, ANSWER.inflation) ** 2
    scaled = (vectors / (1.0 + np.maximum(values, 0.0) / inflation)) @ vectors.T
    return replace(f, covariance=scaled * spread[:, None] * spread + np.diag(inexact**2))


def _by_least_squares(problem: Problem, f: Fit) -> Fit:
    """A model by least squares in motion."""
    return with_dispersion(problem, least_squares(problem, f.model, f.theta))


def _annealed(problem: Problem, f: Fit) -> Fit:
    """A model at its end with what lasts taken for model discrepancy."""
    fitter = Fitter(problem)
    return _at_its_end(fitter, fitter.fit(f.model, f.theta))


def _at_its_end(fitter: Fitter, f: Fit) -> Fit:
    """A model fitted to its end. Where taking out the noise's share leaves plainly more, as at a stop, whose stiffness multiplies
    noise, the fit stays, and neither is right to better than what is between them."""
    problem = fitter.problem
    polished = fitter.polish(f)
    return with_dispersion(problem, _as_it_was(f, polished) if _much_more(problem, polished, f) else polished)


def _as_it_was(before: Fit, after: Fit) -> Fit:
    """A fit without its correction, known no better than what is between them."""
    away = after.theta - before.theta
    return replace(before, covariance=before.covariance + np.outer(away, away))


def _much_more(problem: Problem, after: Fit, before: Fit) -> bool:
    """Whether a correction leaves much more than there was before it."""
    return left_by(problem, after) > ANSWER.lost * left_by(problem, before) + ANSWER.chance * noise_of(problem, before)


def _corrected(problem: Problem, f: Fit) -> tuple[Problem, Fit]:
    """The fit without what the noise of the measured motion makes of it, and the problem less what it makes of the residuals.

    Where more than noise is left the data count for less by how much more (Birge's ratio): numbers of which they say little stay
    near the description.
    """
    ratio = quiet_rms(problem, f)
    told = f
    # Of an unknown effect nothing is known to which it should stay near.
    if ratio > ANSWER.quiet and not any(isinstance(h, discrepancy.Spline) for h in f.model):
        louder = f.noise.louder(min(ratio, ANSWER.inflation))
        told = Fitter(problem).settle(replace(f, noise=louder))
    less, unbiased = without_noise_bias(problem, told)
    found = instrumented(less, unbiased)
    if found is f:
        return problem, f
    if _much_more(problem, found, told):
        return problem, replace(_as_it_was(told, found), noise=f.noise)
    covariance = found.covariance
    for after, before in ((unbiased, told), (found, unbiased)):
        unknown = ANSWER.inexact_bias * (after.theta - before.theta)
        covariance = covariance + np.outer(unknown, unknown)
    return less, replace(found, noise=f.noise, covariance=covariance, least=covariance)


def _limits(
    problem: Problem, found: Explored, final: Fit, tried: list[Hypothesis], missing: dict[str, str]
) -> tuple[dict[str, str], tuple[tuple[str, str], ...]]:
    """Causes that could not have shown, with the reason, and pairs that look alike."""
    weak, alike = limits(problem, found.best, found.library)
    named = {h.cause.name for h in final.model}
    undetermined = dict(missing)
    looked = {h.cause.name for h in tried}
    for name in causes.of(problem.joint):
        if name not in looked and name not in undetermined:
            undetermined[name] = "it lives in the torsion, which one encoder does not show"
    for name in weak:
        undetermined.setdefault(name, "at ordinary size it would drown in tolerances and noise")
    return {n: r for n, r in sorted(undetermined.items()) if n not in named}, tuple(alike)
