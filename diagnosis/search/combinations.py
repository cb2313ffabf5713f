"""What one cause makes, and others together make nearly as well, asked once all causes are fitted.

A torque constant and a gravity moment that are both 15 % up look like a torque sensor that reads 13 % low: torques have no scale
of their own but what inertias and stiffnesses give them. A friction that grows with the load and a torque constant look like
back-driving. Whichever is found first explains what the others would, so that none of them is ever looked at: they are fitted in
its place.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...models import causes
from ..fit.coordinates import Hypothesis
from ..fit.instruments import SETTINGS as MEANS
from ..fit.instruments import averaged
from ..fit.residual import Problem
from ..fit.solver import Fit, Fitter, noise_share
from .acceptance import AcceptSettings, Decision, Rivals, plainly_more, quiet_rms, size_of
from .calibrate import at_the_end
from .settle import added
from .worth import left_by, noise_of


@dataclass(frozen=True)
class Combined:
    """A model, with what it was compared with.

    Attributes:
      fit, rivals: the model, and what is told of its causes.
      decisions: about causes that were exchanged.
      confusable: pairs of causes of which one may stand for the other.
    """

    fit: Fit
    rivals: list[Rivals]
    decisions: tuple[Decision, ...] = ()
    confusable: tuple[tuple[str, str], ...] = ()


@dataclass(frozen=True)
class _Tried:
    """Causes in the place of others: the fit with them, and the log evidence that they add."""

    names: frozenset[str]
    fit: Fit
    more: float


def in_place_of_each_other(
    fitter: Fitter,
    f: Fit,
    rivals: list[Rivals],
    hypotheses: Sequence[Hypothesis],
    settings: AcceptSettings,
) -> Combined:
    """The combination of causes that imitate each other that the data speak for, one more only where they plainly ask for it; how
    sure each of its causes is, among all combinations."""
    problem = fitter.problem
    quiet = quiet_rms(problem, f)
    here = frozenset(h.cause.name for h in f.model if _imitates(h.cause.name))
    by_name = {h.cause.name: h for h in hypotheses if not h.fixed}
    others = combinations(here, by_name)
    if not others:
        return Combined(f, rivals)
    fits = [_exchanged(fitter, f, here, [by_name[n] for n in sorted(names)]) for names in others]
    tried = _compared(fitter, f, others, fits, settings)
    loose = float(np.clip(quiet, 1.0, settings.loosest))

    def beyond(one: _Tried) -> float:
        return one.more - settings.general * loose * (len(one.names) - len(here))

    stays = _Tried(here, f, 0.0)
    best = max(tried, key=beyond)
    chosen = best if beyond(best) > settings.threshold else stays
    most = max(one.more for one in (stays, *tried))
    weights = {
        one.names: float(np.exp((one.more - most) / (settings.temper_general * loose))) for one in (stays, *tried)
    }
    total = sum(weights.values())
    share = {n: sum(w for names, w in weights.items() if n in names) / total for n in chosen.names}
    most_left = plainly_more(left_by(problem, chosen.fit), noise_of(problem, chosen.fit), settings)
    close = [one for one in (stays, *tried) if left_by(problem, one.fit) <= most_left]
    if any(at_the_end(problem, one.fit) for one in close):
        # Something that no description holds has bent numbers as far as they go, and may decide between these.
        common = frozenset.intersection(chosen.names, *(one.names for one in close))
        share |= {n: min(share[n], settings.bent) for n in chosen.names - common}
    alike = {
        (gone, come)
        for one in (stays, *tried)
        if weights[one.names] > settings.unlikely
        for gone in chosen.names - one.names
        for come in one.names - chosen.names
    }
    before = {h.key: r for h, r in zip(f.model, rivals, strict=False)}
    gain = chosen.more + max(
        (before[h.key].gain for h in f.model if h.cause.name in here and h.key in before), default=0.0
    )
    found = []
    for h in chosen.fit.model:
        r = before.get(h.key) or Rivals(h.cause.name, gain if h.cause.name in chosen.names - here else 0.0, ())
        found.append(replace(r, share=r.share * share.get(h.cause.name, 1.0)))
    return Combined(chosen.fit, found, _decisions(problem, f, here, chosen), tuple(sorted(alike)))


def combinations(here: frozenset[str], available: Collection[str]) -> list[frozenset[str]]:
    """Sets of causes that may stand in the place of those that are here: one exchanged for such as imitate it, these for it, or
    one for another that does beside what is here.

    None has all that are here: what would be there beside them was asked before. Of a set what a measurement cannot show is left
    out: a torque constant is imitated by a gravity moment and a torque sensor's gain, without that sensor by the moment alone.
    """
    found, there = set[frozenset[str]](), {*available, *here}
    for name in there:
        cause = causes.get(name)
        for others in (frozenset(whole) & there for whole in cause.imitated_by):
            if not others or others <= {*cause.generalises}:  # a special case has been asked for
                continue
            if name in here:
                alone = {n for n in others if any(name in more for more in causes.get(n).imitated_by)}
                found |= {here - {name} | part for part in (others, *(frozenset({n}) for n in alone))}
            if others <= here:
                found.add(here - others | {name})
        if name in here:
            found |= {here - {name} | {o} for o, beside in cause.imitated_beside if beside in here and o in there}
    return sorted((names for names in found if not names >= here), key=sorted)


def _imitates(name: str) -> bool:
    """Whether a cause imitates others, or others it, or one does beside it."""
    return any(
        name == n or name in others
        for n in causes.names()
        for others in (*causes.get(n).imitated_by, *causes.get(n).imitated_beside)
    )


def _over_means(fitter: Fitter, f: Fit) -> tuple[Fitter, Fit] | None:
    """The fit to means over `InstrumentSettings.period`, where the noise of the measured motion would decide; else None.

    Torques have a scale by what inertias say, in accelerations that the counts make. The drive follows the counts, so that
    noise replicates are right about them to a tenth: a torque constant was less likely by 45 than what imitates it. Over
    means of 16, 32 and 64 ms it is more likely by 31, 19 and 15.
    """
    problem = fitter.problem
    if not problem.link_measured or noise_share(problem, f.noise, f.point) < fitter.settings.noisy:
        return None
    slow = Fitter(averaged(problem, MEANS.period), fitter.settings, fitter.noise)
    return slow, slow.fit(f.model, f.theta, f, 6, f, anew=True)


def _exchanged(fitter: Fitter, f: Fit, here: frozenset[str], instead: Sequence[Hypothesis]) -> Fit:
    """A fit with other causes in the place of those that are here, from where the new ones are absent."""
    problem = fitter.problem
    names = frozenset(h.cause.name for h in instead)
    kept = [i for i, h in enumerate(f.model) if h.cause.name not in here - names]
    new = [h for h in instead if h.cause.name not in here]
    parts = problem.split(f.theta, f.model)
    theta = np.concatenate([f.theta[: problem.size], *(parts[i] for i in kept), *(np.zeros(h.size) for h in new)])
    return fitter.fit((*(f.model[i] for i in kept), *new), theta, f, 6, f, anew=True)


def _compared(
    fitter: Fitter, f: Fit, names: Sequence[frozenset[str]], fits: Sequence[Fit], settings: AcceptSettings
) -> list[_Tried]:
    """Fits with other causes beside one: over means where the noise of the motion would decide, but those that plainly leave
    more."""
    problem = fitter.problem
    most = plainly_more(left_by(problem, f), noise_of(problem, f), settings)
    near = [left_by(problem, other) <= most for other in fits]
    means = _over_means(fitter, f) if any(near) else None

    def more(other: Fit, close: bool) -> float:
        if means is None or not close:
            return added(fitter, other, f)
        slow, base = means
        return added(slow, slow.fit(other.model, other.theta, other, 6, base, anew=True), base)

    return [_Tried(n, x, more(x, close)) for n, x, close in zip(names, fits, near, strict=True)]


def _decisions(problem: Problem, f: Fit, here: frozenset[str], chosen: _Tried) -> tuple[Decision, ...]:
    """What became of causes that were exchanged."""
    nan, found = float("nan"), []

    def said(names: Collection[str]) -> str:
        return " and ".join(n.replace("_", " ") for n in sorted(names))

    gone, come = here - chosen.names, chosen.names - here
    for model, of, taken in ((f, gone, False), (chosen.fit, come, True)):
        for i, h in enumerate(model.model):
            if h.cause.name in of:
                reason = (
                    f"in the place of {said(gone)} adds {chosen.more:.0f} to the log evidence" if taken
                    else f"with {said(come) or 'less'} in its place the log evidence is {chosen.more:.0f} higher"
                )  # fmt: skip
                size = size_of(problem, model, i)
                found.append(Decision("settle", h.cause.name, h.fixed, chosen.more, nan, size, True, taken, reason))
    return tuple(found)
