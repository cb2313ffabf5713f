"""Recordings in, causes out: what a joint hides, how sure that is, and the joint extended by it."""

from __future__ import annotations

import itertools
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from ..models import causes
from ..models.joint import Joint
from ..models.recording import Measurement
from .answer import BalanceResidual, Diagnosis, Finding, ParameterEstimate, ParameterShift
from .data import coverage
from .data.mistakes import NO_CHANGE, Mistake, find_mistakes
from .data.segments import BALANCES, SETTINGS, UNITS, pushed, segments
from .extension import DELAYS, extended, parameter_shifts
from .fit.coordinates import Hypothesis, hypotheses
from .fit.instruments import instrumented
from .fit.noise_bias import without_noise_bias
from .fit.regions import DrawnBack, drawn_back, held_out_regions, mean_ratio, valid_range
from .fit.residual import Problem
from .fit.solver import Fit, Fitter, normal_equations, tamed, with_dispersion
from .improvement import removed, serves
from .search import discrepancy
from .search.acceptance import (
    MORE_THAN_NOISE,
    AcceptSettings,
    Decision,
    by_chance,
    drowned,
    made_by,
    quiet_rms,
    significance,
    size_of,
    without_it,
    worth_of,
)
from .search.described import as_described
from .search.discrepancy import Unknown
from .search.identifiability import limits
from .search.settle import is_calibration, why_needed, without_effect
from .search.stages import SETTINGS as SEARCH
from .search.stages import Progress, Search, SearchSettings, likeliest_first, search
from .search.worth import Worth, left_by, noise_of
from .uncertainty import stated


@dataclass(frozen=True)
class AnswerSettings:
    """How what was found is told.

    Attributes:
      temper: by how much log evidence is divided before it becomes a probability: the laws are not exact and neither is the noise
        model; `inexact` of what other hypotheses still gain is added.
      significant: standard deviations that an effect must be away from absent where the fit ends; by those that are inflated, it
        is no surer than `beside` below, and minor below `barely`; plainly: one worth so many times what nothing explains is never
        minor for it, and may be sure from `barely` on.
      slim: share of what all effects are worth together (mean square) below which one is sure only from `clearly` standard
        deviations on, and an unknown one never: what a law of another leaves, in the hundredths, may look like it.
      entangled: share of what two effects are worth together (mean square) below which what either is worth beside the other says
        nothing: how they share it is not told, and neither is sure.
      surest: largest confidence; beside: of a cause beside which an unknown effect was found; unsure: of what does not hold where
        it was not fitted, or could be anything.
      plain_share: share of the explanations from which on a cause and its special cases are told apart.
      nearly_all: share of the causes that could not have shown, from which on a measurement is inconclusive.
      minor, quiet: part of the ordinary size below which an effect is minor, where the residual is more than `quiet` times the
        sensors' noise even with all of them: a real joint has a little of everything. Minor effects are part of the extended
        joint, and told, but none of the causes.
      little: part of the rated torque that an unknown effect must be worth there, not to be a minor one; or `mostly` of what all
        effects are worth together (mean square), or so much that what nothing explains would be `plainer` times as large (mean
        square) without it: what real joints have a little of everything of does not stand out so.
      inflation: largest factor on standard deviations where more than noise is left; lookalike: part of an effect's ordinary size
        that may then be small imperfections which look like it; inexact_size: where only noise is left, part that may be the
        reconstruction of the motion from counts; inexact_bias: part that is not known of by how much the motion's noise moves a
        number: in the mean it is one draw, and to second order, and averages are not free of it.
      slight: part of the root mean square of what nothing explains that a cause beside an unknown effect must be worth.
      diluted: part of the information about an inertia that may be the encoders' noise, for it to be sure.
      useless: ratio of the mean square that is left with causes to the one without from which on no cause is sure.
      simpler: ratio of errors on regions that a fit has not seen up to which, where nearly nothing could have shown, numbers
        as described are preferred to numbers that calibration moved.
      end: standard deviations of its tolerance from which on a number is at the end of it.
      far, worth: a residual so many times the sensors' noise, and of so large a share of the rated torque, is never consistent,
        and with one encoder no cause is sure where so many times the noise is left;
        near: so many times the noise, where the fit was taken back that would explain it.
    """

    temper: float = 5.0
    inexact: float = 0.02
    significant: float = 3.0
    barely: float = 2.0
    plainly: float = 2.0
    slim: float = 0.01
    clearly: float = 5.0
    entangled: float = 0.01
    surest: float = 0.99
    unsure: float = 0.5
    beside: float = 0.7
    plain_share: float = 0.95
    nearly_all: float = 2 / 3
    minor: float = 0.12
    quiet: float = MORE_THAN_NOISE
    little: float = 0.015
    mostly: float = 0.6
    plainer: float = 4.0
    inflation: float = 5.0
    lookalike: float = 0.05
    inexact_size: float = 0.01
    inexact_bias: float = 0.35
    slight: float = 0.25
    end: float = 2.9
    far: float = 5.0
    near: float = 2.0
    worth: float = 0.02
    diluted: float = 0.1
    useless: float = 1.05
    simpler: float = 2.0


ANSWER = AnswerSettings()


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
        return _meaningless(measurement, joint, mistakes, time.monotonic() - begin)
    problem = Problem(*segments(list(measurement.recordings), joint), joint)
    missing = coverage.undetermined(measurement, joint)
    if not any(s.usable.any() for s in problem.segments):
        return _nothing(joint, mistakes, missing, time.monotonic() - begin)
    record = problem.calibration.record(np.zeros(problem.calibration.size))
    available = [n for n in causes.of(joint) if coverage.can_show(n, measurement, problem.link_measured)]
    present = {effect.name: effect.values for effect in joint.effects}
    offered = [h for n in available for h in hypotheses(causes.get(n), record, present.get(n))]
    tried = problem.with_room((), offered)
    fitter = Fitter(problem)
    found = search(problem, tried, settings, progress, deadline, fitter)
    progress("looking for unknown effects", 0.88)
    looked, late = discrepancy.UnknownEffects(), time.monotonic() >= deadline
    if not late:
        looked = discrepancy.find(fitter, found.base, found.chosen)
        best = found.chosen if looked.unknown is None else looked.unknown.fit
        astray = problem.link_measured and quiet_rms(problem, best) > settings.accept.again
        late = astray and time.monotonic() >= deadline
        if astray and not late:
            progress("searching once more, the likeliest first", 0.9)
            again = likeliest_first(fitter, found, tried, settings, progress, deadline)
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
    progress("regions that a fit has not seen", 0.97)
    no_worse = serves(measurement, joint)
    drawn = drawn_back(problem, final, serves=lambda f: no_worse(extended(problem, f, joint, unknown)))
    undetermined, alike = _limits(problem, found, final, tried, missing)
    outcome = _Outcome(problem, found, unknown, judged, final, drawn, missing, undetermined, alike, looked.doubted)
    few = bool(found.chosen.model) and outcome.nearly_all and problem.link_measured
    if all(pushed(r) for r in measurement.recordings):
        outcome = replace(outcome, surest=ANSWER.unsure)  # what a push did cannot be told from what a cause does
    elif not problem.link_measured and quiet_rms(problem, final) > ANSWER.far:
        # The other end moves otherwise than it was taken to, which looks like any number of the joint.
        outcome = replace(outcome, surest=ANSWER.beside)
    if drawn.share == 0.0 or few or outcome.only_unknown:
        # What does not hold where it was not fitted is not sure to be there, nor is one of few that could have shown.
        late = time.monotonic() >= deadline
        described = None if late else _as_described(outcome, tried, missing, settings)
        most = ANSWER.unsure if drawn.share == 0.0 else 1.0
        found = replace(found, complete=found.complete and not late)
        outcome = described or replace(outcome, found=found, surest=min(outcome.surest, most))
    return replace(_told(outcome, measurement), mistakes=mistakes, seconds=time.monotonic() - begin)


@dataclass(frozen=True)
class _Outcome:
    """What was found, before it is told.

    Attributes:
      found, unknown: what the search came to, and an unknown effect beside it.
      judged: the model at its end, from which blocks of the data were kept.
      final: the same, with one encoder fitted to these blocks too; drawn: that, drawn back to what holds where it was not fitted.
      missing: causes that such a measurement cannot show at ordinary size, with the reason.
      undetermined: these and others that could not have shown; alike: pairs that look the same.
      doubted: causes in whose place an unknown effect might stand (`discrepancy.UnknownEffects`).
      surest: largest confidence of a cause.
    """

    problem: Problem
    found: Search
    unknown: Unknown | None
    judged: Fit
    final: Fit
    drawn: DrawnBack
    missing: dict[str, str]
    undetermined: dict[str, str]
    alike: tuple[tuple[str, str], ...]
    doubted: frozenset[tuple[Any, ...]] = frozenset()
    surest: float = 1.0

    @property
    def nearly_all(self) -> bool:
        """Whether nearly all causes could not have shown."""
        return len(self.undetermined) >= ANSWER.nearly_all * len(causes.of(self.problem.joint))

    @property
    def only_unknown(self) -> bool:
        """Whether no known cause was found, and what else was does not hold everywhere that it was not fitted."""
        return self.unknown is not None and not self.found.chosen.model and self.drawn.share < 1.0


def _as_described(
    outcome: _Outcome, tried: list[Hypothesis], missing: dict[str, str], settings: SearchSettings
) -> _Outcome | None:
    """What the data say with all numbers as described; None where that is nothing, or worse on regions that it has not seen."""
    problem = outcome.problem.as_described()
    other = as_described(problem, tried, settings)
    if other is None:
        return None
    final = _inflated(problem, with_dispersion(problem, other.chosen))
    regions = held_out_regions(problem, final)
    most = 1.0 if outcome.only_unknown else ANSWER.simpler
    if outcome.drawn.share > 0.0 and mean_ratio(regions) >= most * mean_ratio(outcome.drawn.regions):
        return None
    found = replace(other, decisions=(*outcome.found.decisions, *other.decisions), complete=outcome.found.complete)
    undetermined, alike = _limits(problem, found, final, tried, missing)
    drawn = DrawnBack(1.0, final, regions)
    return _Outcome(
        problem, found, None, final, final, drawn, missing, undetermined, alike,
        surest=min(outcome.surest, ANSWER.beside),
    )  # fmt: skip


def _told(outcome: _Outcome, measurement: Measurement) -> Diagnosis:
    """An outcome as the answer."""
    problem, found, final, joint = outcome.problem, outcome.found, outcome.drawn.fit, outcome.problem.joint
    findings, minor, entangled = _findings(outcome, measurement)
    useless = bool(findings) and _explains_nothing(problem, found.base, outcome.judged)
    surest = min(outcome.surest, ANSWER.unsure) if useless else outcome.surest
    findings, minor = ([replace(f, confidence=min(f.confidence, surest)) for f in fs] for fs in (findings, minor))
    if outcome.nearly_all:
        # Something is wrong; where it sits cannot be told from what could not have shown.
        findings = [
            replace(f, confidence=min(f.confidence, ANSWER.unsure)) if f.name == "unknown" else f for f in findings
        ]
    residual = _balances(problem, found.base, outcome.judged if outcome.drawn.share == 1.0 else final)
    verdict, reason = _verdict(outcome, findings, minor, residual, useless)
    calibration = parameter_shifts(problem, final)
    reason = _joined(reason, _at_the_end(calibration), _holds_back(outcome))
    extended_joint = joint
    if outcome.drawn.share > 0.0:
        extended_joint = extended(problem, final, joint, outcome.unknown)
        known = {
            "valid": valid_range(problem, final),
            "uncertainty": stated(problem, final, extended_joint, outcome.drawn.regions),
        }
        extended_joint = extended_joint.model_copy(update=known)
    ripples = [(h.cause.name, name) for h in outcome.final.model for name in _other_ripples(problem, h)]
    alike = {
        (min(pair), max(pair)) for pair in (*outcome.alike, *_close(found), *ripples, *entangled, *found.confusable)
    }
    return Diagnosis(
        verdict=verdict,
        reason=reason,
        causes=tuple(sorted(findings, key=lambda f: -f.worth)),
        calibration=calibration,
        confusable=tuple(sorted(alike)),
        undetermined=outcome.undetermined,
        residual=residual,
        regions=outcome.drawn.regions,
        extended=extended_joint,
        minor=tuple(sorted(minor, key=lambda f: -f.worth)),
        decisions=found.decisions,
        problem=problem,
        search=found,
        final=final,
        whole=outcome.final,
        share=outcome.drawn.share,
        before=found.base.point.residual,
        after=final.point.residual,
        held_out=_held_out(problem),
        complete=found.complete,
    )


def _inflated(problem: Problem, f: Fit) -> Fit:
    """The fit, less sure by its residual's normalised RMS of what the data say where more than noise is left (Birge's ratio).

    What no description holds is not random: it leans on the parameters the same way all the time. Small imperfections that look
    like an effect (an encoder's eccentricity like a kinematic error) are part of its size, however well that is known.
    """
    ratio = quiet_rms(problem, f)
    plain = ratio <= ANSWER.quiet
    inexact = np.zeros(len(f.theta))
    for i, h in enumerate(f.model):
        if h.free:
            inexact[problem.place(f.model, i)] = ANSWER.inexact_size if plain else ANSWER.lookalike
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


def _at_the_end(calibration: dict[str, ParameterShift]) -> str:
    """Numbers that calibration moved to the end of their tolerances: they may be what is wrong; empty where there are none."""
    ends = [
        f"{name} ({s.value:.3g} {s.unit})" if s.nominal == 0.0 else f"{name} ({100 * (s.value / s.nominal - 1):+.0f} %)"
        for name, s in calibration.items()
        if abs(s.moved) > ANSWER.end and name not in DELAYS.values()
    ]
    late = [
        f"{sensor.replace('_', ' ')} is read {1e3 * abs(s.value - s.nominal):.1f} ms {'later' if s.moved > 0 else 'earlier'} "
        "than described"
        for sensor, name in DELAYS.items()
        if (s := calibration.get(name)) is not None and abs(s.moved) > ANSWER.end
    ]
    return _joined(f"at the end of what the description allows: {', '.join(ends)}" if ends else "", *late)


def _holds_back(outcome: _Outcome) -> str:
    """Why the extended joint is not what a fit of all numbers says; empty where it is."""
    drawn = outcome.drawn
    if drawn.share < 1.0 and not drawn.regions:
        return "too little motion to keep a region of it from the fit: joint.yaml is the description"
    if drawn.share < 1.0:
        if drawn.refused:
            why = "with what was found estimates of torque are worse than with the description"
        elif drawn.share == 0.0:
            why = "what was found does worse than the description where a fit has not seen the data"
        else:
            why = "what was found does worse than the description in a region that a fit has not seen"
        left = f"the numbers in joint.yaml are drawn back to {100 * drawn.share:.0f} % of the way"
        return f"{why}: {left if drawn.share else 'joint.yaml is the description'}"
    if not outcome.problem.held.any():
        return ""
    worse = ", ".join(f"{r.name} ({r.ratio:.1f} times)" for r in drawn.regions if r.worse)
    alike = dict.fromkeys(n for pair in outcome.found.confusable for n in pair)
    names = " or ".join(name.replace("_", " ") for name in alike)
    return _joined(
        "no numbers within tolerance hold where a fit has not seen the data: they are left as described, and the causes are what "
        "explains most with these",
        f"on regions that were kept from the fit worse than the description in {worse}" if worse else "",
        f"what is left beside may be {names}, which this motion cannot tell apart" if names else "",
    )


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
            worse = bool(found.chosen.model) and _explains_nothing(less, found.base, corrected)
            if worse and not _explains_nothing(problem, found.base, found.chosen):
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
    return f if _plainly_more(whole, found, f) else found


def _at_its_end(fitter: Fitter, f: Fit) -> Fit:
    """A model fitted to its end. Where taking out the noise's share leaves plainly more, as at a stop, whose stiffness multiplies
    noise, the fit stays, and neither is right to better than what is between them."""
    problem = fitter.problem
    polished = fitter.polish(f)
    return with_dispersion(problem, _as_it_was(f, polished) if _plainly_more(problem, polished, f) else polished)


def _as_it_was(before: Fit, after: Fit) -> Fit:
    """A fit without its correction, known no better than what is between them."""
    away = after.theta - before.theta
    return replace(before, covariance=before.covariance + np.outer(away, away))


def _plainly_more(problem: Problem, after: Fit, before: Fit) -> bool:
    """Whether a correction leaves plainly more than there was before it."""
    accept = SEARCH.accept
    return left_by(problem, after) > accept.lost * left_by(problem, before) + accept.chance * noise_of(problem, before)


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
    if _plainly_more(problem, found, told):
        return problem, replace(_as_it_was(told, found), noise=f.noise)
    covariance = found.covariance
    for after, before in ((unbiased, told), (found, unbiased)):
        unknown = ANSWER.inexact_bias * (after.theta - before.theta)
        covariance = covariance + np.outer(unknown, unknown)
    return less, replace(found, noise=f.noise, covariance=covariance, least=covariance)


def _meaningless(measurement: Measurement, joint: Joint, mistakes: tuple[Mistake, ...], seconds: float) -> Diagnosis:
    """The answer while mistakes in the data make physics meaningless."""
    named = ", ".join(sorted({m.name for m in mistakes if m.severe}))
    reason = f"mistakes in the data ({named}) make physics meaningless; `flexspline import --fix` writes them mended"
    everything = {n: "mistakes in the data" for n in causes.of(joint)}
    told = Diagnosis("inconclusive", reason, (), {}, (), everything, {}, (), joint, mistakes=mistakes, seconds=seconds)
    return told if told.mendable else replace(told, reason=f"{NO_CHANGE}; what would mend most: {named}")


def _nothing(joint: Joint, mistakes: tuple[Mistake, ...], missing: dict[str, str], seconds: float) -> Diagnosis:
    shortest = SETTINGS.shortest
    reason = f"no part of the measurement without gaps has {shortest[0]} samples and {shortest[1]:g} s"
    return Diagnosis("inconclusive", reason, (), {}, (), missing, {}, (), joint, mistakes=mistakes, seconds=seconds)


def _held_out(problem: Problem) -> str:
    """How data were kept from the fits, and over what the numbers of `residual` are means."""
    return (
        f"every {SETTINGS.held_out_every}th block of {SETTINGS.held_out_block:g} s of each recording was kept from every fit; "
        "RMS in motion, while what was measured of the motion is followed; `regions`: the ends of the range of angle, speed and "
        "load, and whole recordings, each kept from a fit of its own"
    )


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


def _findings(
    outcome: _Outcome, measurement: Measurement
) -> tuple[list[Finding], list[Finding], list[tuple[str, str]]]:
    """The effects of the final model, each with what it is worth: causes, and minor ones; pairs that share what one explains."""
    problem, found, final, unknown = outcome.problem, outcome.found, outcome.final, outcome.unknown
    held_before, held_after = (_held_out_squares(problem, f) for f in (found.base, outcome.judged))
    explained = max(held_before - held_after, 0.0) / held_before if held_before > 0.0 else 0.0
    real = quiet_rms(problem, final) > ANSWER.quiet
    left = left_by(problem, final) ** 0.5
    findings: dict[int, Finding] = {}  # by their places in the model
    minor: dict[int, Finding] = {}
    linear = tamed(problem, final)
    worths = [worth_of(problem, final, linear, i) for i in range(len(final.model))]
    total = max(sum(w.rms**2 for w in worths), 1e-30)
    named = len(final.model) - (unknown is not None)
    # Where more than noise is left deviations are widened by it, and say less than what an effect is worth.
    plain = [real and w.rms >= ANSWER.plainly * left for w in worths]
    away = [significance(problem, final, i) for i in range(named)]
    slim = [w.rms**2 < ANSWER.slim * total and x < ANSWER.clearly for w, x in zip(worths, away, strict=False)]
    away = [np.inf if plain[i] and x >= ANSWER.barely else x for i, x in enumerate(away)]
    unseen = [h.cause.name in outcome.missing for h in final.model]
    # What makes data worse that no fit saw is not sure, nor is which of two makes a ripple that either could.
    unsure = [
        held_after > held_before or h.key in outcome.doubted or bool(_other_ripples(problem, h)) for h in final.model
    ]
    pairs = _entangled(problem, final, linear, worths)
    entangled = {i for pair in pairs for i in pair}
    doubtful = [
        x < ANSWER.significant or slim[i] or unseen[i] or unsure[i] or i in entangled for i, x in enumerate(away)
    ]
    looked_at = len({(d.cause, *d.fixed.items()) for d in found.decisions})
    chance = [by_chance(x, len(h.magnitudes), looked_at) for x, h in zip(away, final.model, strict=False)]
    most = [ANSWER.beside if d else max(1.0 - p, ANSWER.beside) for d, p in zip(doubtful, chance, strict=True)]
    confidences = _confidences(problem, found, final, unknown, most)
    for i, (h, u) in enumerate(zip(final.model, problem.split(final.theta, final.model), strict=True)):
        w = worths[i]
        share = float(np.clip(explained * w.rms**2 / total, 0.0, 1.0))
        if unknown is not None and i == named:
            confidence = float(np.clip(1 - np.exp(-unknown.gain / (8 * ANSWER.temper)), 0.3, 0.95))
            if w.rms**2 < ANSWER.slim * total:
                confidence = min(confidence, ANSWER.beside)
            # Knees that are smooth, friction that is not quite viscous: many small things are in no library.
            rated = problem.joint.numbers["rated_torque"].value
            little = real and w.rms < ANSWER.little * rated and w.rms**2 < ANSWER.mostly * total
            little = little and left_by(problem, found.chosen) < ANSWER.plainer * left**2
            (minor if little else findings)[i] = Finding(
                "unknown", unknown.spline.component, confidence, {}, share, w.rms, discrepancy.describe(unknown),
                discrepancy.depends_on(unknown.spline.variable),
            )  # fmt: skip
            continue
        block = problem.place(final.model, i)
        values, std = h.values(u), h.deviation(u, final.covariance[block, block])
        parameters = {
            q.name: ParameterEstimate(values[q.name], float(std.get(q.name, 0.0)), "" if q.unit == "1" else q.unit)
            for q in h.cause.parameters
        }
        small = real and (size_of(problem, final, i) < ANSWER.minor or (away[i] < ANSWER.barely and not plain[i]))
        if unknown is not None:  # what the unknown effect has left of it
            small = small or w.rms < ANSWER.slight * left or significance(problem, final, i) < ANSWER.significant
            # A pulse is a sum of orders: one that is less than what depends on the same angle at the same place is part of it.
            same = h.cause.series == (unknown.spline.place, unknown.spline.variable)
            small = small or (same and w.rms < worths[named].rms)
        (minor if small else findings)[i] = Finding(
            h.cause.name, h.cause.component, confidences[i], parameters, share, w.rms
        )
    if len(findings) > 1:
        gained = _gained(outcome, measurement, linear, list(findings))
        whole = total + sum(gained.values())
        for i, g in gained.items():
            both = float(np.hypot(worths[i].rms, g**0.5))
            share = float(np.clip(explained * both**2 / whole, 0.0, 1.0))
            findings[i] = replace(findings[i], explains=share, worth=both, estimation=g**0.5)
    names = [h.cause.name for h in final.model]
    return list(findings.values()), list(minor.values()), [(names[i], names[j]) for i, j in pairs]


def _entangled(problem: Problem, f: Fit, linear: Fit, worths: Sequence[Worth]) -> list[tuple[int, int]]:
    """Pairs of effects that together make much, and beside each other next to nothing: data that one of them explains."""

    def little(both: Worth, i: int) -> bool:
        return worths[i].rms ** 2 < ANSWER.entangled * both.rms**2

    slight = [i for i, w in enumerate(worths) if w.rms**2 < ANSWER.entangled * sum(made_by(problem, f, linear, i))]
    pairs = [(pair, worth_of(problem, f, linear, *pair)) for pair in itertools.combinations(slight, 2)]
    return [pair for pair, both in pairs if all(little(both, i) for i in pair)]


def _gained(outcome: _Outcome, measurement: Measurement, linear: Fit, indices: Sequence[int]) -> dict[int, float]:
    """Mean square of estimators' error [N·m]² that each of some effects removes, as far as other unknowns would not instead; none
    where no torque was measured."""
    problem, final, joint = outcome.problem, outcome.final, outcome.problem.joint
    without = []
    for i in indices:
        unknown = None if final.model[i].cause.name == "unknown" else outcome.unknown
        without.append(extended(problem, without_it(problem, final, linear, i), joint, unknown))
    gained = removed(measurement, extended(problem, final, joint, outcome.unknown), without)
    return dict(zip(indices, gained, strict=False))


def _explains_nothing(problem: Problem, base: Fit, final: Fit) -> bool:
    """Whether a model with causes leaves more of the simulation's error than the calibrated joint, whatever the evidence says."""
    before, after = (left_by(problem, f) for f in (base, final))
    noise = noise_of(problem, base)
    return after > ANSWER.useless * before + (ANSWER.useless - 1) * noise


def _diluted(problem: Problem, f: Fit, index: int) -> bool:
    """Whether the acceleration on which an inertia acts is in good part the encoders' noise: it is then found too small.

    That is regression dilution, which taking out the noise's share mends to first order only.
    """
    cause = f.model[index].cause
    if f.noise_jacobian is None or not {"Jm", "Jl"} & {*cause.sets.values(), *cause.scales}:
        return False
    normal = normal_equations(problem, f.noise, f.model, f.theta, f.point, f.jacobian, f.noise_jacobian)
    block = problem.place(f.model, index)
    noise, prior = np.diag(normal.share)[block], 1 / problem.spread(f.model)[block] ** 2
    whole = noise + np.diag(normal.hessian)[block] - prior
    return bool(np.any(noise > ANSWER.diluted * whole))


def _held_out_squares(problem: Problem, f: Fit) -> float:
    """Mean square of held-out residuals beyond the sensors' noise, over all balances [N·m]²; of all where none is held out."""
    total, some = 0.0, any(s.held_out.any() for s in problem.segments)
    for b in range(len(BALANCES)):
        squares, noise, count = 0.0, 0.0, 0
        for segment, r, n in zip(problem.segments, f.point.residual, f.point.noise, strict=True):
            use = (segment.held_out if some else segment.usable)[:, b] & ~segment.at_rest
            squares, noise, count = squares + np.sum(r[use, b] ** 2), noise + np.sum(n[use, b] ** 2), count + use.sum()
        if count:
            total += max(squares - noise, 0.0) / count * problem.output_scale[b] ** 2
    return float(total)


def _confidences(
    problem: Problem, found: Search, final: Fit, unknown: Unknown | None, most: Sequence[float]
) -> list[float]:
    """Probability of each of the final model's causes: among its rivals, and as far as those on which it rests are there.

    Where the sizes of two causes are correlated by ρ, the part ρ² of the one is what it is because the other is there too.

    Args:
      most: largest of each: less where it is few standard deviations from absent (`by_chance`), and where the measurement is none
        that shows it or tells it from another, or data that no fit saw are the worse for what was found.
    """
    model = final.model if unknown is None else final.model[:-1]
    alone, sizes = [], []
    for i, (h, u) in enumerate(zip(model, problem.split(final.theta, final.model), strict=False)):
        confidence = _confidence(found, h, unknown)
        if h.cause.resonance and not problem.link_measured:
            confidence = min(confidence, ANSWER.beside)
        if h.at_bound(u) or _diluted(problem, final, i):  # an inertia of nothing is no answer, whatever it explains
            confidence = min(confidence, ANSWER.unsure)
        alone.append(min(confidence, most[i]))
        sizes.append(problem.place(final.model, i).start + np.asarray(h.magnitudes))
    spread = np.sqrt(np.diag(final.covariance))
    correlation = final.covariance / np.maximum(spread[:, None] * spread, 1e-300)

    def rests_on(i: int, j: int) -> float:
        return float(np.max(correlation[np.ix_(sizes[i], sizes[j])] ** 2))

    return [
        min([p, *(1 - (1 - q) * rests_on(i, j) for j, q in enumerate(alone) if j != i)]) for i, p in enumerate(alone)
    ]


def _confidence(found: Search, h: Hypothesis, unknown: Unknown | None) -> float:
    """Probability of a cause among those that could stand where it does, and of there being one at all."""
    rivals = {g.key: r for g, r in zip(found.chosen.model, found.rivals, strict=False)}.get(h.key)
    if rivals is None:
        return 0.5
    name = h.cause.name
    others = [g for n, g in rivals.others if n != name and _superseded(found, n)]
    best = max([rivals.gain, *others])
    temper = _temper(found.quiet[1], rivals.gain)
    weights = [np.exp((g - best) / temper) for g in others]
    own = float(np.exp((rivals.gain - best) / temper))
    none = float(np.exp(-(best - 3.5) / _temper(1.0, rivals.gain)))
    p = rivals.share * own / (own + sum(weights) + none)
    return float(min(p, ANSWER.surest if unknown is None else ANSWER.beside))


def _temper(quiet: float, gain: float) -> float:
    """What differences of log evidence are divided by: what no description holds decides nothing between rivals.

    Args:
      quiet: normalised RMS of what is left against the sensors' noise.
    """
    beside = float(np.clip(quiet, 1.0, ANSWER.inflation))
    return beside * (ANSWER.temper + ANSWER.inexact * float(np.clip(gain, 0.0, 500.0 * beside**2)))


def _superseded(found: Search, name: str) -> bool:
    """Whether a rival is not itself in the model: one that is was no rival."""
    return all(h.cause.name != name for h in found.chosen.model)


def _other_ripples(problem: Problem, h: Hypothesis) -> list[str]:
    """Causes that one encoder does not tell from one of the final model: other orders of the motor's angle."""
    if problem.link_measured or not h.cause.ripple:
        return []
    return [name for name in causes.of(problem.joint) if causes.get(name).ripple and name != h.cause.name]


def _close(found: Search) -> list[tuple[str, str]]:
    """Pairs of causes between which the evidence does not decide."""
    pairs = []
    for r in found.rivals:
        for name, gain in r.others:
            if gain > r.gain - 3 * _temper(found.quiet[1], r.gain) and _superseded(found, name):
                pairs.append((r.cause, name))
        if r.share < ANSWER.plain_share:
            special = causes.get(r.cause).generalises
            pairs += [(r.cause, n) for n in causes.names() if n in special or r.cause in causes.get(n).generalises]
    return pairs


def _verdict(
    outcome: _Outcome,
    findings: list[Finding],
    minor: list[Finding],
    residual: dict[str, BalanceResidual],
    useless: bool,
) -> tuple[str, str]:
    """Verdict and, where it is not plain, its reason: a residual far above the noise is never consistent, nor is one beside which
    a minor effect is worth as much as an unknown one that is told.

    Args:
      useless: whether the causes leave no less unexplained than calibration alone.
    """
    problem = outcome.problem
    # Not all that the fit found is in the joint of which `residual` is: what that leaves is no noise.
    taken_back = outcome.drawn.share < 1.0
    rated = problem.joint.numbers["rated_torque"].value
    scale = dict(zip(BALANCES, problem.output_scale, strict=True))
    times, worth = (ANSWER.far, ANSWER.worth) if findings or not taken_back else (ANSWER.near, 0.0)
    far = [
        (name, r) for name, r in residual.items()
        if r.after > times * r.noise and r.after * scale[name] > worth * rated
    ]  # fmt: skip
    left = "; ".join(
        f"{name.replace('_', ' ')}: {r.after:.3g} {r.unit} RMS is left, {r.after / max(r.noise, 1e-12):.0f} times the noise"
        for name, r in far
    )
    late = "" if outcome.found.complete else "time was up before every stage was done: with more, more may be found"
    if useless:
        return "inconclusive", _joined("the causes named leave no less unexplained than calibration alone", late, left)
    if findings:
        return "discrepancy", _joined(late, f"beside the causes named, {left}" if far else "")
    if outcome.nearly_all:
        return "inconclusive", _joined("nearly all causes could not have shown", late, left)
    if late:
        return "inconclusive", _joined(late, left)
    if far:
        return "inconclusive", left if taken_back else f"no known cause explains the residual; {left}"
    large = [f for f in minor if f.confidence >= ANSWER.unsure and f.worth > ANSWER.little * rated]
    if large:
        names = " and ".join(f"{f.name.replace('_', ' ')} ({f.worth:.2g} N·m)" for f in large)
        return "inconclusive", f"{names} may be there, too small or too little known to be named"
    return "consistent", ""


def _joined(*parts: str) -> str:
    return "; ".join(part for part in parts if part)


def _balances(problem: Problem, base: Fit, final: Fit) -> dict[str, BalanceResidual]:
    """RMS on held-out samples by balance, in motion: at rest friction may be anything up to its level."""
    found = {}
    for b, name in enumerate(BALANCES):
        use = [s.held_out[:, b] & ~s.at_rest for s in problem.segments]
        if not any(u.any() for u in use):
            use = [s.held_out[:, b] for s in problem.segments]
        if not any(u.any() for u in use):
            continue
        before, after, noise = (
            float(np.sqrt(np.mean(np.concatenate([r[u, b] for r, u in zip(rs, use, strict=True)]) ** 2)))
            for rs in (base.point.residual, final.point.residual, final.point.noise)
        )
        found[name] = BalanceResidual(before, after, noise, UNITS[name])
    return found
