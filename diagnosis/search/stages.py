"""Which causes the data speak for, in stages: calibrate, screen, fit, select, settle.

*Calibrate* the joint without causes. *Screen* the library there and *fit* the few that look best through the replay: the first
cause may be large, where nothing is linear. With it in the model what is left is small, and further causes are *selected* in the
linear model of a second library, one after the other; *settle* fits all of them together and takes back what does not hold.

Every stage returns a frozen result, and every hypothesis that was looked at leaves a decision that says why it was taken or not.
The noise, with what no description can hold (`fit.noise`), is learned for every model that is compared: a cause is worth what it
makes likelier *beside* its own discrepancy, not in units of the encoders' noise. Among causes that the data speak for, the one
that is worth most to a user comes first: the mean square of the simulation's error that it alone removes (`worth`).
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from ..fit.coordinates import Hypothesis
from ..fit.residual import Problem
from ..fit.solver import Fit, Fitter
from .acceptance import AcceptSettings, Decision, Rivals, quiet_rms
from .calibrate import CalibrateSettings, afresh, calibrate, doubtful, hand_over
from .finalists import Finalist, as_finalist, coarse_starts, finalists_of, first_cause, rivals_of
from .screen import Library, ScreenSettings, screen
from .select import gains_of, others_than, select
from .settle import settle, together
from .worth import unexplained

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


def search(
    problem: Problem,
    hypotheses: Sequence[Hypothesis],
    settings: SearchSettings = SETTINGS,
    progress: Progress = lambda stage, done: None,
    deadline: float = np.inf,
) -> Search:
    """Find the causes.

    Args:
      progress: told the stages as they begin.
      deadline: of `time.monotonic` [s], after which no further stage begins and the best so far is the answer.
    """
    fitter, accept = Fitter(problem), settings.accept
    progress("calibrating the joint", 0.02)
    at = first = calibrate(problem, fitter, settings.calibrate)
    decisions: list[Decision] = []
    rivals: list[Rivals] = []
    pending: tuple[Finalist, dict[str, float]] | None = None
    afreshed = late = slight = False
    while True:
        quiet = quiet_rms(problem, at)
        coarse = not at.model and quiet >= settings.screen.quiet
        probe = settings.screen.coarse_probe if coarse else settings.screen.probe
        progress("screening the library of causes", 0.2 + 0.15 * len(at.model))
        library = Library(problem, at, others_than(problem, hypotheses, at.model), probe)
        if at.model and (quiet < accept.far or len(at.model) >= accept.rounds or slight):
            break  # what is left is small, or no cause of the library explains it: the linear model serves
        screened = screen(problem, at, library, settings.screen)
        if pending is not None:
            rivals.append(rivals_of(*pending, gains_of(screened), accept))
            pending = None
        late = time.monotonic() > deadline
        if late:
            break
        progress("fitting the causes that look best", 0.3 + 0.15 * len(at.model))
        fitted = finalists_of(problem, fitter, at, screened, accept)
        if quiet > accept.gross and not at.model and not afreshed:
            # So far off that the linear model says little.
            for h, start in coarse_starts(problem, hypotheses, accept):
                f = fitter.fit((h,), start, None, settings.calibrate.iterations, at.point.noise)
                fitted = sorted([*fitted, as_finalist(problem, at, f)], key=lambda f: -f.gain)
        seen, chosen = first_cause(problem, at, screened, fitted, accept)
        slight = chosen is not None and chosen.removed < accept.little * float(np.sum(unexplained(problem, at.point)))
        if slight and quiet > accept.plain:
            # What is likeliest explains next to nothing, and is not all that is there.
            fitted = sorted(
                [*fitted, *finalists_of(problem, fitter, at, screened, accept, fitted)], key=lambda f: -f.gain
            )
            seen, chosen = first_cause(problem, at, screened, fitted, accept)
        decisions += seen
        if chosen is None:
            if at.model or afreshed or not doubtful(problem, at, quiet, settings.calibrate):
                break
            afreshed = True
            other = afresh(problem, fitter, at, settings.calibrate)
            if other.log_evidence < at.log_evidence + 1.0:
                break
            at = first = other
            continue
        progress(f"settling {chosen.name.replace('_', ' ')}", 0.4 + 0.15 * len(at.model))
        slight = chosen.removed < accept.little * float(np.sum(unexplained(problem, at.point)))
        at = _settled(problem, fitter, chosen, settings.calibrate)
        alike = [f for f in fitted if f.removed > accept.alike * chosen.removed]
        pending = (chosen, {f.name: f.gain for f in reversed(alike)})
    late = late or time.monotonic() > deadline
    if not late:
        progress("selecting further causes", 0.7)
        more, seen, others = select(problem, at, library, accept, settings.screen, pending)
        decisions += seen
        rivals += others
        if more:
            progress("settling all causes", 0.8)
            at, rivals, seen = together(problem, fitter, at, library, more, rivals)
            decisions += seen
        at, rivals, settled = settle(problem, fitter, at, rivals, hypotheses, accept, together=bool(more))
        decisions += settled
    elif pending is not None:
        rivals.append(rivals_of(*pending, {}, accept))
    return Search(
        first,
        at,
        library,
        tuple(rivals),
        tuple(decisions),
        (quiet_rms(problem, first), quiet_rms(problem, at)),
        not late,
    )


def _settled(problem: Problem, fitter: Fitter, chosen: Finalist, settings: CalibrateSettings) -> Fit:
    """A finalist fitted to its end with derivatives of its own."""
    at = fitter.fit(chosen.fit.model, hand_over(problem, chosen.fit.theta, chosen.fit.model), None, 4)
    if doubtful(problem, at, quiet_rms(problem, at), settings):
        at = max((at, afresh(problem, fitter, at, settings)), key=lambda f: f.log_evidence)
    return at
