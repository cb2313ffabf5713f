"""Which causes the data speak for, in stages: calibrate, screen, fit, select, compare, settle.

*Calibrate* the joint without causes. *Screen* the library there and *fit* the few that look best through the replay: the first
cause may be large, where nothing is linear. With it in the model what is left is small, and further causes are *selected* in the
linear model of a second library, one after the other, and fitted together. Each is *compared* with its close rivals beside all
others, *settle* takes back what does not hold, and *combinations* of causes that imitate each other stand in each other's place.
Where far more than noise is left all is done once more, `likeliest_first`.

Every stage returns a frozen result, and every hypothesis that was looked at leaves a decision that says why it was taken or not.
The noise, with what no description can hold (`fit.noise`), is learned for every model that is compared: a cause is worth what it
makes likelier *beside* its own discrepancy, not in units of the encoders' noise. Among causes that the data speak for, the one
that is worth most to a user comes first: the mean square of the simulation's error that it alone removes (`worth`).
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from ..fit.coordinates import Hypothesis
from ..fit.residual import Problem
from ..fit.solver import Fit, Fitter
from .acceptance import AcceptSettings, Decision, Rivals, quiet_rms
from .calibrate import CalibrateSettings, afresh, calibrate, doubtful, from_least_squares, hand_over, is_slow
from .combinations import in_place_of_each_other
from .finalists import Finalist, coarse_finalists, explains_little, finalists_of, first_cause, ranked, rivals_of
from .plain import as_rivals
from .rivals import against_rivals, beyond_the_ends
from .screen import Library, ScreenSettings, screen
from .select import gains_of, others_than, select
from .settle import settle, together

Progress = Callable[[str, float], None]
"""Called with a stage's name and the share of the work that is done."""


@dataclass(frozen=True)
class SearchSettings:
    """Settings of all stages."""

    calibrate: CalibrateSettings = field(default_factory=CalibrateSettings)
    screen: ScreenSettings = field(default_factory=ScreenSettings)
    accept: AcceptSettings = field(default_factory=AcceptSettings)


SETTINGS = SearchSettings()


@dataclass(frozen=True)
class Search:
    """What the search found.

    Attributes:
      base: the calibrated joint without causes.
      chosen: the model with all causes that were accepted.
      library: columns of all other hypotheses near it.
      rivals: of every accepted cause, in the model's order.
      decisions: about every hypothesis, stage by stage.
      quiet: normalised RMS against the sensors' noise of `base` and of `chosen`.
      complete: whether all stages were done; not so where time was up.
      confusable: pairs of causes of which one is there that the measurement cannot tell.
    """

    base: Fit
    chosen: Fit
    library: Library
    rivals: tuple[Rivals, ...]
    decisions: tuple[Decision, ...]
    quiet: tuple[float, float]
    complete: bool = True
    confusable: tuple[tuple[str, str], ...] = ()


@dataclass(frozen=True)
class _Found:
    """What was found so far.

    Attributes:
      first: the calibrated joint; at: with the causes; library: columns of the others near it.
      last: the cause that was accepted last, with the gains of what looks like it; None where its rivals are told already.
      late: whether time was up. confusable: as of `Search`.
    """

    first: Fit
    at: Fit
    library: Library
    rivals: tuple[Rivals, ...] = ()
    decisions: tuple[Decision, ...] = ()
    last: tuple[Finalist, dict[str, float]] | None = None
    late: bool = False
    confusable: tuple[tuple[str, str], ...] = ()


def search(
    problem: Problem,
    hypotheses: Sequence[Hypothesis],
    settings: SearchSettings = SETTINGS,
    progress: Progress = lambda stage, done: None,
    deadline: float = np.inf,
    fitter: Fitter | None = None,
    start: Fit | None = None,
) -> Search:
    """Find the causes.

    Args:
      progress: told the stages as they begin.
      deadline: of `time.monotonic` [s], after which no further stage begins and the best so far is the answer.
      fitter: of this problem, with what it has kept.
      start: a model to begin with (`plain.plain_fit`); by default the joint without causes.
    """
    fitter = fitter or Fitter(problem)
    progress("calibrating the joint", 0.02)
    first = calibrate(fitter, settings.calibrate)
    return _from(fitter, first, hypotheses, settings, progress, deadline, start)


def likeliest_first(
    fitter: Fitter,
    before: Search,
    hypotheses: Sequence[Hypothesis],
    settings: SearchSettings = SETTINGS,
    progress: Progress = lambda stage, done: None,
    deadline: float = np.inf,
) -> Search:
    """What was found, or, where that is likelier, what is found with the likeliest cause first instead of the one worth most.

    What was found is not complete where time was up before that was known.

    Some are seen only beside others that are worth little: a hysteresis that a ripple winds to and fro, beside the kinematic
    error that makes the ripple. Arguments as of `search`.
    """
    again = replace(settings, accept=settings.accept.likeliest_first())
    found = _from(fitter, before.base, hypotheses, again, progress, deadline)
    if found.chosen.log_evidence < before.chosen.log_evidence + settings.accept.threshold:
        return replace(before, complete=before.complete and found.complete)
    return replace(found, decisions=(*before.decisions, *found.decisions))


def _from(
    fitter: Fitter,
    first: Fit,
    hypotheses: Sequence[Hypothesis],
    settings: SearchSettings,
    progress: Progress,
    deadline: float,
    start: Fit | None = None,
) -> Search:
    """The causes beside a calibrated joint."""
    problem, accept = fitter.problem, settings.accept
    found = _one_by_one(fitter, first, hypotheses, settings, progress, deadline, start=start)
    if not (found.at.model or found.late) and doubtful(problem, first, quiet_rms(problem, first), settings.calibrate):
        other = afresh(fitter, first, settings.calibrate)
        if other.log_evidence >= first.log_evidence + 1.0:
            again = _one_by_one(fitter, other, hypotheses, settings, progress, deadline, coarsely=False)
            found = replace(again, decisions=(*found.decisions, *again.decisions))
    if found.late or time.monotonic() > deadline:
        last = () if found.last is None else (rivals_of(*found.last, {}, accept),)
        found = replace(found, rivals=(*found.rivals, *last), late=True)
    else:
        found = _further(fitter, found, hypotheses, settings, progress, deadline)
    quiet = (quiet_rms(problem, found.first), quiet_rms(problem, found.at))
    return Search(
        found.first, found.at, found.library, found.rivals, found.decisions, quiet, not found.late, found.confusable
    )


def _further(
    fitter: Fitter,
    found: _Found,
    hypotheses: Sequence[Hypothesis],
    settings: SearchSettings,
    progress: Progress,
    deadline: float,
) -> _Found:
    """Select, fit together, settle; once more where something stood for what shows only beside what is settled."""
    problem = fitter.problem
    accept = settings.accept
    at, library, last = found.at, found.library, found.last
    rivals, decisions = list(found.rivals), list(found.decisions)
    for done in range(accept.rounds_again + 1):
        room = replace(accept, most=max(accept.most, len(at.model) + 2)) if done else accept
        progress("selecting further causes", 0.7 + 0.08 * done)
        more, seen, others = select(problem, at, library, room, settings.screen, last)
        decisions += seen
        if done and not any(s.size > accept.contested for s in more):
            break  # of what every real joint has, all was selected before
        rivals += others
        dropped: list[Decision] = []
        if more:
            progress("settling all causes", 0.75 + 0.08 * done)
            at, rivals, dropped = together(fitter, at, library, more, rivals, accept)
        at, rivals, compared = against_rivals(fitter, at, rivals, hypotheses, accept, settings.screen)
        at, rivals, gone_on = beyond_the_ends(fitter, at, rivals, hypotheses, accept, settings.screen)
        # Where nothing came of those that were selected, all is as it was before they were.
        anew = len(more) > len(dropped) or bool(gone_on)
        at, rivals, settled = settle(fitter, at, rivals, hypotheses, accept, together=anew)
        decisions += [*dropped, *compared, *gone_on, *settled]
        gone = [d for d in (*dropped, *settled) if not d.taken]
        # An effect that was taken back stood for something, as numbers at the end of their tolerances do.
        unsettled = any(d.size > accept.large for d in gone)
        unsettled = unsettled or doubtful(problem, at, quiet_rms(problem, at), settings.calibrate)
        if not (more and unsettled) or time.monotonic() > deadline:
            break
        keys = {(d.cause, *d.fixed.items()) for d in (*gone, *compared) if not d.taken}
        offered = [h for h in others_than(problem, hypotheses, at.model) if h.key not in keys]
        library, last = Library(problem, at, offered, settings.screen.probe), None
    alike: tuple[tuple[str, str], ...] = ()
    late = time.monotonic() > deadline
    if not late:
        combined = in_place_of_each_other(fitter, at, rivals, hypotheses, accept)
        alike, decisions = combined.confusable, [*decisions, *combined.decisions]
        at, rivals = combined.fit, combined.rivals
        if combined.decisions:
            at, rivals, settled = settle(fitter, at, rivals, hypotheses, accept, together=True)
            decisions += settled
    return replace(
        found, at=at, rivals=tuple(rivals), decisions=tuple(decisions), last=None, confusable=alike, late=late
    )


def _one_by_one(
    fitter: Fitter,
    first: Fit,
    hypotheses: Sequence[Hypothesis],
    settings: SearchSettings,
    progress: Progress,
    deadline: float,
    *,
    coarsely: bool = True,
    start: Fit | None = None,
) -> _Found:
    """Screen and fit, as long as much is left and a cause explains a good part of it.

    Args:
      coarsely: whether causes are also tried without the linear model, where the calibrated joint is far off.
      start: a model with causes in it to begin with.
    """
    problem = fitter.problem
    accept, iterations = settings.accept, settings.calibrate.iterations
    at, rivals, decisions = first, list[Rivals](), list[Decision]()
    if start is not None and start.model:
        at, rivals = fitter.fit(start.model, start.theta, None, 4), list(as_rivals(problem, start))
    last: tuple[Finalist, dict[str, float]] | None = None
    slight = False
    coarsely = coarsely and not accept.likeliest
    while True:
        quiet = quiet_rms(problem, at)
        far = not at.model and quiet >= settings.screen.quiet
        progress("screening the library of causes", 0.2 + 0.15 * len(at.model))
        probe = settings.screen.coarse_probe if far else settings.screen.probe
        library = Library(problem, at, others_than(problem, hypotheses, at.model), probe)
        found = _Found(first, at, library, tuple(rivals), tuple(decisions), last)
        if at.model and (quiet < accept.far or len(at.model) >= accept.rounds or slight):
            return found  # what is left is small, or no cause of the library explains it: the linear model serves
        screened = screen(problem, at, library, settings.screen)
        if last is not None:
            rivals.append(rivals_of(*last, gains_of(screened), accept))
            found = replace(found, rivals=tuple(rivals), last=None)
        if time.monotonic() > deadline:
            return replace(found, late=True)
        progress("fitting the causes that look best", 0.3 + 0.15 * len(at.model))
        fitted = finalists_of(fitter, at, screened, accept)
        if coarsely and not at.model and quiet > accept.gross:
            fitted = ranked([*fitted, *coarse_finalists(fitter, at, hypotheses, accept, iterations)])
        seen, chosen = first_cause(problem, at, screened, fitted, accept)
        little = chosen is not None and not accept.likeliest and explains_little(problem, at, chosen, accept)
        if little and quiet > accept.plain:
            # What is likeliest explains next to nothing, and is not all that is there.
            fitted = ranked([*fitted, *finalists_of(fitter, at, screened, accept, done=fitted)])
            seen, chosen = first_cause(problem, at, screened, fitted, accept)
        decisions += seen
        if chosen is None:
            return replace(found, decisions=tuple(decisions))
        progress(f"settling {chosen.name.replace('_', ' ')}", 0.4 + 0.15 * len(at.model))
        slight = not accept.likeliest and explains_little(problem, at, chosen, accept)
        alike = [f for f in fitted if f.removed > accept.alike * chosen.removed]
        last = (chosen, {f.name: f.gain for f in reversed(alike)})
        at = _settled(fitter, chosen, settings)


def _settled(fitter: Fitter, chosen: Finalist, settings: SearchSettings) -> Fit:
    """A finalist fitted to its end with derivatives of its own."""
    problem = fitter.problem
    at = fitter.fit(chosen.fit.model, hand_over(problem, chosen.fit.theta, chosen.fit.model), None, 4)
    if doubtful(problem, at, quiet_rms(problem, at), settings.calibrate):
        at = max((at, afresh(fitter, at, settings.calibrate)), key=lambda f: f.log_evidence)
    if quiet_rms(problem, at) > settings.accept.far and is_slow(at, settings.calibrate):
        # Discrepancy holds nearly all that is left, and the fit creeps: further on from least squares.
        at = from_least_squares(fitter, at, settings.calibrate)
    return at
