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
from .findings import explains_nothing
from .fit import tare
from .fit.coordinates import Hypothesis, hypotheses
from .fit.instruments import instrumented
from .fit.noise_bias import without_noise_bias
from .fit.regions import DrawnBack, drawn_back, held_out_regions, mean_ratio
from .fit.residual import Problem
from .fit.solver import Fit, Fitter, with_dispersion
from .improvement import serves
from .regression import regressions
from .search import discrepancy
from .search.acceptance import (
    AcceptSettings,
    Decision,
    drowned,
    much_more,
    plainly_more,
    quiet_rms,
    significance,
    size_of,
)
from .search.described import as_described
from .search.identifiability import limits
from .search.plain import PLAINLY, as_rivals, held_out_square, least_squares, plain_fit
from .search.settle import is_calibration, why_needed, without_cancelling, without_effect
from .search.stages import SETTINGS as SEARCH
from .search.stages import Progress, Search, SearchSettings, likeliest_first, search
from .search.worth import left_by, noise_of
from .telling import answer_of, meaningless, nothing_usable


# Replays use the cores; BLAS's threads would only wait for them, spinning.
@threadpool_limits.wrap(limits=1, user_api="blas")
def diagnose(
    measurement: Measurement,
    joint: Joint,
    settings: SearchSettings = SEARCH,
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
    record = problem.calibration.record(np.zeros(problem.calibration.size))
    available = [n for n in causes.of(joint) if coverage.can_show(n, measurement, problem.link_measured)]
    present = {effect.name: effect.values for effect in joint.effects}
    offered = [h for n in available for h in hypotheses(causes.get(n), record, present.get(n))]
    tried = problem.with_room((), offered)
    fitter = Fitter(problem)
    said = regressions(measurement, joint)
    # With one encoder a measurement says what a regression says: from there, and never worse.
    plain = None if problem.link_measured else plain_fit(fitter, tried, said)
    found = search(problem, tried, settings, progress, deadline, fitter, plain)
    found, cancelled = _that_vary(fitter, found, settings.accept)
    if cancelled and (looser := _stribeck_open(joint)) is not None and time.monotonic() < deadline:
        progress("searching once more, the Stribeck friction's height left open", 0.86)
        before, joint = found.decisions, looser
        problem = Problem(problem.segments, problem.replicates, joint)
        fitter = Fitter(problem)
        # With the height open the joint may have a variable more: a fit of the narrower one has not its unknowns.
        plain = None if problem.link_measured else plain_fit(fitter, tried, said)
        found = search(problem, tried, settings, progress, deadline, fitter, plain)
        found, _ = _that_vary(fitter, found, settings.accept)
        found = replace(found, decisions=(*before, *found.decisions))
    looked, late = discrepancy.UnknownEffects(), time.monotonic() >= deadline
    if not late:
        progress("looking for unknown effects", 0.88)
        looked = discrepancy.find(fitter, found.base, found.chosen)
        best = found.chosen if looked.unknown is None else looked.unknown.fit
        astray = problem.link_measured and quiet_rms(problem, best) > settings.accept.again
        late = astray and time.monotonic() >= deadline
        if astray and not late:
            progress("searching once more, the likeliest first", 0.9)
            again = likeliest_first(fitter, found, tried, settings, progress, deadline)
            again, _ = _that_vary(fitter, again, settings.accept)
            likelier = again.chosen is not found.chosen and again.chosen.log_evidence > best.log_evidence
            found = replace(found, complete=found.complete and again.complete)
            late = likelier and time.monotonic() >= deadline
            if likelier and not late:
                progress("looking for unknown effects", 0.92)
                found, looked = again, discrepancy.find(fitter, again.base, again.chosen)
    found = replace(found, complete=found.complete and not late)
    unknown = looked.unknown
    progress("numbers and their uncertainty", 0.94)
    if unknown is None:
        given = problem
        problem, final, found = _polished(fitter, found, settings.accept)
        judged = _inflated(problem, final)
        final = judged if problem.link_measured else _inflated(problem, _on_all(given, final))
    else:
        problem, final = _corrected(problem, with_dispersion(problem, unknown.fit))
        judged = final = _inflated(problem, final)
    if plain is not None:
        known = tuple(h for h in judged.model if h.free)
        refitted = least_squares(fitter, known, judged.theta[: problem.size + sum(h.size for h in known)])
        fits = [judged, plain, refitted]
        left = [held_out_square(problem, f) for f in fits]
        best = fits[int(np.argmin(left))]
        if left[0] > PLAINLY * min(left):
            rivals = as_rivals(problem, plain) if best is plain else found.rivals[: len(known)]
            found, unknown = replace(found, chosen=best, rivals=rivals), None
            judged = final = _inflated(problem, with_dispersion(problem, best))
    progress("regions that a fit has not seen", 0.97)
    no_worse = serves(measurement, joint)
    drawn = drawn_back(problem, final, serves=lambda f: no_worse(extended(problem, f, joint, unknown)))
    undetermined, alike = _limits(problem, found, final, tried, missing)
    conclusion = Conclusion(problem, found, unknown, judged, final, drawn, missing, undetermined, alike, looked.doubted)
    few = bool(found.chosen.model) and conclusion.nearly_all and problem.link_measured
    zeros = _zeros(measurement, problem, final)
    if zeros:  # what moves a zero between recordings looks like anything that a spring does
        conclusion = replace(conclusion, zeros=zeros, surest=ANSWER.unsure)
    if all(pushed(r) for r in measurement.recordings):
        conclusion = replace(conclusion, surest=ANSWER.unsure)  # what a push did cannot be told from what a cause does
    elif not problem.link_measured and quiet_rms(problem, final) > ANSWER.far:
        # The other end moves otherwise than it was taken to, which looks like any number of the joint, and most of all like
        # friction and inertia where that end is the rotor.
        behind = not any("motor_position" in r for r in measurement.recordings)
        conclusion = replace(conclusion, surest=ANSWER.beside, behind=behind)
    if drawn.share == 0.0 or few or conclusion.only_unknown:
        # What does not hold where it was not fitted is not sure to be there, nor is one of few that could have shown.
        late = time.monotonic() >= deadline
        described = None if late else _as_described(conclusion, tried, missing, settings)
        most = ANSWER.unsure if drawn.share == 0.0 else 1.0
        found = replace(found, complete=found.complete and not late)
        conclusion = described or replace(conclusion, found=found, surest=min(conclusion.surest, most))
    answer = replace(answer_of(conclusion, measurement), mistakes=mistakes, regressions=said)
    return _noted(replace(answer, seconds=time.monotonic() - begin), measurement)


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


def _as_described(
    conclusion: Conclusion, tried: list[Hypothesis], missing: dict[str, str], settings: SearchSettings
) -> Conclusion | None:
    """What the data say with all numbers as described; None where that is nothing, or worse on regions that it has not seen."""
    problem = conclusion.problem.as_described()
    other = as_described(problem, tried, settings)
    if other is None:
        return None
    final = _inflated(problem, with_dispersion(problem, other.chosen))
    regions = held_out_regions(problem, final)
    most = 1.0 if conclusion.only_unknown else ANSWER.simpler
    if conclusion.drawn.share > 0.0 and mean_ratio(regions) >= most * mean_ratio(conclusion.drawn.regions):
        return None
    found = replace(
        other, decisions=(*conclusion.found.decisions, *other.decisions), complete=conclusion.found.complete
    )
    undetermined, alike = _limits(problem, found, final, tried, missing)
    drawn = DrawnBack(1.0, final, regions)
    return Conclusion(
        problem, found, None, final, final, drawn, missing, undetermined, alike,
        surest=min(conclusion.surest, ANSWER.beside), zeros=conclusion.zeros, behind=conclusion.behind,
    )  # fmt: skip


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


def _stribeck_open(joint: Joint) -> Joint | None:
    """The joint with static friction known apart from Coulomb friction no better than `ANSWER.stribeck`: of what Fs stands for
    datasheets say nothing. None where it is known no better already, or said to be known exactly."""
    number = joint.numbers["Fs"]
    exact = not number.tolerance and not (number.shared and joint.shared_tolerances[number.shared])
    if exact or number.tolerance >= ANSWER.stribeck:
        return None
    open_ = number.model_copy(update={"tolerance": ANSWER.stribeck})
    return joint.model_copy(update={"numbers": {**joint.numbers, "Fs": open_}})


def _that_vary(fitter: Fitter, found: Search, settings: AcceptSettings) -> tuple[Search, bool]:
    """What was found without orders of a law that cancel each other, and whether some were of the mesh friction; where nothing
    else was found, calibration if that leaves less."""
    f, taken, decisions = without_cancelling(fitter, found.chosen, settings)
    if not taken:
        return found, False
    if not f.model and left_by(fitter.problem, found.base) < left_by(fitter.problem, f):
        f = found.base
    rivals = tuple(r for i, r in enumerate(found.rivals) if i not in taken)
    friction = any(causes.get(d.cause).series == causes.get("position_dependent_friction").series for d in decisions)
    return replace(found, chosen=f, rivals=rivals, decisions=(*found.decisions, *decisions)), friction


def _polished(fitter: Fitter, found: Search, settings: AcceptSettings) -> tuple[Problem, Fit, Search]:
    """The chosen model at its end and corrected, without effects that the data do not tell from nothing there; as it was chosen
    where it leaves more than calibration alone at the end, and did not as chosen."""
    problem = fitter.problem
    kept: set[int] = set()
    final = _at_its_end(fitter, found.chosen)
    while True:
        less, corrected = problem, final
        away = [significance(problem, final, i) for i in range(len(final.model))]
        reasons = {
            i: f"{x:.1f} standard deviations from absent where the fit ends"
            for i, x in enumerate(away)
            if x < ANSWER.significant
        }
        lost = {i: why for i in range(len(final.model)) if (why := drowned(problem, final, i, settings))}
        if not lost and all(id(final.model[i]) in kept for i in reasons):
            less, corrected = _corrected(problem, final)
            reasons = {
                i: "what it changes is within the joint's tolerances where the fit ends"
                for i in range(len(final.model))
                if is_calibration(less, corrected, i)
            }
        reasons |= lost
        weak = [i for i in reasons if i in lost or id(final.model[i]) not in kept]
        if not weak:
            most = plainly_more(left_by(problem, found.base), noise_of(problem, found.base), settings)
            if not found.chosen.model and not found.base.model and left_by(less, corrected) > most:
                # Slow discrepancy has taken over what gravity and friction held.
                return problem, with_dispersion(problem, found.base), replace(found, chosen=found.base)
            worse = bool(found.chosen.model) and explains_nothing(less, found.base, corrected)
            if worse and not explains_nothing(problem, found.base, found.chosen):
                return problem, with_dispersion(problem, found.chosen), found
            return less, corrected, found
        i = min(weak, key=lambda i: away[i])
        h = final.model[i]
        other = without_effect(fitter, final, i, settings)
        needed = "" if i in lost else why_needed(problem, final, other, settings)
        reason, nan = needed or reasons[i], float("nan")
        decision = Decision(
            "settle", h.cause.name, h.fixed, nan, nan, size_of(problem, final, i), True, bool(needed), reason
        )
        found = replace(found, decisions=(*found.decisions, decision))
        if needed:
            kept.add(id(h))
            continue
        rivals = tuple(r for j, r in enumerate(found.rivals) if j != i)
        found = replace(found, chosen=other, rivals=rivals)
        final = _at_its_end(fitter, other)


def _on_all(problem: Problem, f: Fit) -> Fit:
    """A model fitted to all of the data, blocks that were kept from it too: with one encoder numbers are hardly told apart, and a
    sixth of the data says more of them than anything else could. As it was where that leaves plainly more."""
    whole = problem.with_held_out()
    fitter = Fitter(whole)
    _, found = _corrected(whole, _at_its_end(fitter, fitter.fit(f.model, f.theta)))
    return f if _much_more(whole, found, f) else found


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
    return left_by(problem, after) > much_more(left_by(problem, before), noise_of(problem, before), SEARCH.accept)


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
    problem: Problem, found: Search, final: Fit, tried: list[Hypothesis], missing: dict[str, str]
) -> tuple[dict[str, str], tuple[tuple[str, str], ...]]:
    """Causes that could not have shown, with the reason, and pairs that look alike."""
    weak, alike = limits(problem, found.chosen, found.library)
    named = {h.cause.name for h in final.model}
    undetermined = dict(missing)
    looked = {h.cause.name for h in tried}
    for name in causes.of(problem.joint):
        if name not in looked and name not in undetermined:
            undetermined[name] = "it lives in the torsion, which one encoder does not show"
    for name in weak:
        undetermined.setdefault(name, "at ordinary size it would drown in tolerances and noise")
    return {n: r for n, r in sorted(undetermined.items()) if n not in named}, tuple(alike)
