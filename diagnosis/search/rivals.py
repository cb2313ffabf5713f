"""What else could stand where a cause was chosen, asked again once all causes are fitted.

A cause is chosen while others are still missing, often in the linear model alone: a rival that looked a little worse there may do
better beside the others, or as well, which its confidence must say. So may one that goes on where a number has come to the end of
its tolerance: many numbers move together on that way, and the linear model does not see it.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace

import numpy as np

from ..fit.coordinates import Hypothesis
from ..fit.residual import Problem
from ..fit.solver import Fit, Fitter
from .acceptance import AcceptSettings, Decision, Rivals, quiet_rms, size_of
from .calibrate import fields_at_the_end
from .finalists import Finalist, explains_little, finalists_of, objection
from .screen import Library, ScreenSettings, screen
from .select import others_than
from .settle import without_effect


def against_rivals(
    fitter: Fitter,
    f: Fit,
    rivals: Sequence[Rivals],
    hypotheses: Sequence[Hypothesis],
    settings: AcceptSettings,
    screening: ScreenSettings,
) -> tuple[Fit, list[Rivals], list[Decision]]:
    """Every cause of some size against its close rivals, beside all others: the likelier stays, the gains are told anew."""
    problem = fitter.problem
    told, decisions = list(rivals), list[Decision]()
    unsettled = quiet_rms(problem, f) > settings.plain
    index = 0
    for _ in range(len(rivals)):
        r, h = told[index], f.model[index]
        close = {n for n, g in r.others if g > settings.close * r.gain} - {g.cause.name for g in f.model}
        if h.alternatives > 1 and unsettled:
            close.add(h.cause.name)  # another order: two may each be a part of what one is
        if not close or size_of(problem, f, index) < settings.contested:
            index += 1
            continue
        without = without_effect(fitter, f, index, settings)
        # Under the sensors' noise that the rivals' fits have, too.
        here = fitter.fit(f.model, f.theta, f, 1, without)
        own = here.log_evidence - without.log_evidence
        offered = [
            o for o in others_than(problem, hypotheses, without.model) if o.cause.name in close and o.key != h.key
        ]
        fitted = _fitted(fitter, without, offered, settings, screening)
        gains: dict[str, float] = {}
        for other in fitted:
            gains.setdefault(other.name, other.gain)
        untried = tuple((n, g) for n, g in r.others if n not in close)
        best = _better(problem, without, fitted, own, settings)
        if best is None:
            told[index] = replace(r, gain=own, others=(*gains.items(), *untried))
            index += 1
            continue
        reason = (
            f"beside the others {best.name.replace('_', ' ')} adds {best.gain:.0f} to the log evidence, it {own:.0f}"
        )
        nan = float("nan")
        decisions += [
            Decision("settle", h.cause.name, h.fixed, own, nan, size_of(problem, f, index), True, False, reason),
            Decision("settle", best.name, best.fit.model[-1].fixed, best.gain, nan, size_of(problem, best.fit), True, True,
                     f"adds {best.gain:.0f} to the log evidence in the place of {h.cause.name.replace('_', ' ')}"),
        ]  # fmt: skip
        gains = {**gains, h.cause.name: own}
        del gains[best.name]
        # The one that takes its place stands last, as does what is told of it.
        told = [*told[:index], *told[index + 1 :], Rivals(best.name, best.gain, tuple(gains.items()))]
        f = best.fit
    return f, told, decisions


def beyond_the_ends(
    fitter: Fitter,
    f: Fit,
    rivals: Sequence[Rivals],
    hypotheses: Sequence[Hypothesis],
    settings: AcceptSettings,
    screening: ScreenSettings,
) -> tuple[Fit, list[Rivals], list[Decision]]:
    """With the cause that goes on where a number has come to the end of its tolerance, where that is likelier; what stood in its
    place is taken back afterwards (`settle`)."""
    problem = fitter.problem
    ends = fields_at_the_end(problem, f)
    further = {o.cause.name for o in hypotheses if ends & {*o.cause.sets.values(), *o.cause.scales}}
    offered = [o for o in others_than(problem, hypotheses, f.model) if o.cause.name in further]
    if not offered or quiet_rms(problem, f) < settings.plain:
        return f, list(rivals), []
    best = _better(problem, f, _fitted(fitter, f, offered, settings, screening, ask=further), 0.0, settings)
    if best is None or explains_little(problem, f, best, settings):
        return f, list(rivals), []
    rms = float(np.sqrt(max(best.removed, 0.0)))
    reason = f"a number is at the end of its tolerance; to go on adds {best.gain:.0f} to the log evidence"
    decision = Decision(
        "settle", best.name, best.fit.model[-1].fixed, best.gain, rms, size_of(problem, best.fit), True, True, reason
    )
    return best.fit, [*rivals, Rivals(best.name, best.gain, ())], [decision]


def _fitted(
    fitter: Fitter,
    base: Fit,
    offered: Sequence[Hypothesis],
    settings: AcceptSettings,
    screening: ScreenSettings,
    ask: Collection[str] = (),
) -> list[Finalist]:
    """Of the hypotheses that are offered on top of a fit the best, through the replay; those that are asked for in any case."""
    problem = fitter.problem
    screened = screen(problem, base, Library(problem, base, offered, screening.probe), screening)
    return finalists_of(fitter, base, screened, settings, ask=ask)


def _better(
    problem: Problem, without: Fit, fitted: Sequence[Finalist], own: float, settings: AcceptSettings
) -> Finalist | None:
    """The likeliest rival that is plainly likelier than what stands there, and to which nothing objects."""
    likelier = (f for f in fitted if own + settings.threshold < f.gain < np.inf)
    return next((f for f in likelier if not objection(problem, without, f, settings)), None)
