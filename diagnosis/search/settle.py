"""All causes fitted together: those are taken back that do not hold beside the others."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ...models.calibration import WITHIN
from ..fit.coordinates import Hypothesis
from ..fit.noise import Noise
from ..fit.residual import Problem
from ..fit.solver import Fit, Fitter, losses_of, tamed, weights_of, with_dispersion
from .acceptance import (
    AcceptSettings,
    Decision,
    Rivals,
    drowned,
    much_more,
    plainly_more,
    quiet_rms,
    significance,
    size_of,
    worth_of,
)
from .calibrate import SETTINGS as CALIBRATE
from .calibrate import better, from_least_squares, hand_over, is_slow
from .screen import Library, Screened
from .select import with_effect
from .worth import left_by, noise_of


def together(
    fitter: Fitter,
    at: Fit,
    library: Library,
    chosen: Sequence[Screened],
    rivals: list[Rivals],
    settings: AcceptSettings,
) -> tuple[Fit, list[Rivals], list[Decision]]:
    """All causes fitted together through the replay, from where the linear model puts them; as before where that is no gain."""
    problem = fitter.problem
    here, rest = tamed(problem, at), library
    for s in chosen:
        here = with_effect(problem, here, rest, s)
    half = np.concatenate([0.5 * (at.theta + here.theta[: len(at.theta)]), here.theta[len(at.theta) :]])
    starts = [here.theta, np.concatenate([at.theta, here.theta[len(at.theta) :]]), half]
    found = problem.residuals(starts, [here.model] * len(starts))
    start = starts[int(np.nanargmin(losses_of(problem, here.noise, at, found)))]
    f = fitter.fit(here.model, hand_over(problem, start, here.model), at, 6, at)

    before = left_by(problem, at)
    plainly_less = before - settings.chance * noise_of(problem, at)

    def no_gain(x: Fit) -> bool:
        return x.log_evidence < at.log_evidence and left_by(problem, x) > plainly_less

    if left_by(problem, f) < 0.5 * before or no_gain(f):
        f = fitter.fit(f.model, f.theta, None, 4, at)  # far from where the common derivatives were taken
    if not no_gain(f):
        return f, rivals, []
    first = len(at.model)
    reason = (
        f"fitted together {left_by(problem, f) ** 0.5:.2g} N·m RMS of the simulation's error is not explained, "
        f"without {before**0.5:.2g}"
    )
    dropped = [
        Decision("settle", h.cause.name, h.fixed, f.log_evidence - at.log_evidence, float("nan"),
                 size_of(problem, f, first + i), True, False, reason)
        for i, h in enumerate(f.model[first:])
    ]  # fmt: skip
    return at, rivals[:first], dropped


def settle(
    fitter: Fitter,
    f: Fit,
    rivals: list[Rivals],
    hypotheses: Sequence[Hypothesis],
    settings: AcceptSettings,
    *,
    together: bool,
) -> tuple[Fit, list[Rivals], list[Decision]]:
    """Of effects that were taken those that hold beside the others, beyond the joint's tolerances and as general as needed."""
    problem = fitter.problem
    decisions: list[Decision] = []
    near_edge = any(is_calibration(problem, f, i, settings.edge) for i in range(len(f.model)))
    if together or near_edge or len(f.model) > 1:
        f, rivals, decisions = _prune(fitter, f, rivals, settings)
    before = f
    f, rivals, settled = _as_general_as_needed(fitter, f, rivals, hypotheses, settings)
    decisions += settled
    if f is not before and len(f.model) > 1:
        # Another may have stood for what the one that was replaced could not do.
        f, rivals, settled = _prune(fitter, f, rivals, settings)
        decisions += settled
    return f, rivals, decisions


def without_cancelling(fitter: Fitter, f: Fit, settings: AcceptSettings) -> tuple[Fit, list[int], list[Decision]]:
    """A fit without orders of one law of the link's angle that cancel each other over the angles which were visited: what is left
    of them there is a constant, of which an angle says nothing. Which effects were taken back, and what is said of it.

    Each alone holds beside the other, so that only together they can be taken back. A Stribeck friction that is described too low
    was orders 1 and 2 of the mesh friction, at 0.98.
    """
    problem, decisions, taken = fitter.problem, list[Decision](), list[int]()
    parts = problem.split(f.theta, f.model)
    angle = np.concatenate([s.link_position[s.usable.any(axis=1) & ~s.at_rest] for s in problem.segments])
    orders: dict[tuple[str, str], list[int]] = {}
    for i, h in enumerate(f.model):
        if h.cause.series is not None and "order" in h.fixed and h.cause.series[1].endswith("link_position"):
            orders.setdefault(h.cause.series, []).append(i)
    for own in orders.values():
        values = [f.model[i].values(parts[i]) for i in own]
        laws = [v["amplitude"] * np.sin(v["order"] * angle + v["phase"]) for v in values]
        each = float(np.sqrt(np.sum(np.var(laws, axis=1))))
        varies = float(np.std(np.sum(laws, axis=0)))
        if len(own) < 2 or not varies < settings.cancelling * each:
            continue
        taken += own
        reason = (
            f"its orders vary by {100 * varies / each:.0f} % of each over the angles that were visited: they cancel"
        )
        decisions += [
            Decision(
                "settle", h.cause.name, h.fixed, float("nan"), float("nan"), size_of(problem, f, i), True, False, reason
            )
            for i in own
            for h in (f.model[i],)
        ]
    for i in sorted(taken, reverse=True):
        f = without_effect(fitter, f, i, settings)
    return f, taken, decisions


def is_calibration(problem: Problem, f: Fit, index: int, within: float = WITHIN) -> bool:
    """Whether tolerances can express what one of a fit's effects makes of the joint that the others make."""
    order = [*(j for j in range(len(f.model)) if j != index), index]
    parts = problem.split(f.theta, f.model)
    theta = np.concatenate([f.theta[: problem.size], *(parts[j] for j in order)])
    return problem.is_calibration(theta, tuple(f.model[j] for j in order), within)


def without_effect(fitter: Fitter, f: Fit, index: int, settings: AcceptSettings) -> Fit:
    """A fit without one of its effects."""
    return _not_lost(fitter, f, _quickly_without(fitter, f, index), settings, None)


def _quickly_without(fitter: Fitter, f: Fit, index: int, beside: Fit | None = None) -> Fit:
    """The same with the derivatives of the fit with it, which may end where those do not serve any more.

    Args:
      beside: the fit with which it is compared, as in `Fitter.fit`.
    """
    problem = fitter.problem
    block = problem.place(f.model, index)
    kept = np.delete(np.arange(len(f.theta)), np.arange(block.start, block.stop))
    model = tuple(g for j, g in enumerate(f.model) if j != index)
    return fitter.fit(model, f.theta[kept], f, 4, beside)


def _not_lost(fitter: Fitter, f: Fit, other: Fit, settings: AcceptSettings, beside: Fit | None) -> Fit:
    """A fit without an effect, thoroughly where it leaves much more: only then is that for want of the effect. The better of the
    two: a thorough fit that is kept began elsewhere.

    Args:
      beside: that with which `other` was made.
    """
    problem = fitter.problem
    if left_by(problem, other) < much_more(left_by(problem, f), noise_of(problem, f), settings):
        return other
    return better(problem, other, fitter.once(other.model, lambda: _thoroughly(fitter, other, beside), beside))


def _thoroughly(fitter: Fitter, f: Fit, beside: Fit | None) -> Fit:
    """A fit that goes on with derivatives of its own, from least squares where what it leaves is slow."""
    if is_slow(f):
        return from_least_squares(fitter, f, beside=beside)
    return fitter.fit(f.model, f.theta, f, CALIBRATE.iterations, beside, anew=True)


def why_needed(problem: Problem, f: Fit, without: Fit, settings: AcceptSettings) -> str:
    """Why an effect stays, however little is known of its size: without it the data are not explained. Empty where they are."""
    here, there = (left_by(problem, x) for x in (f, without))
    most = plainly_more(here, noise_of(problem, f), settings)
    if without.log_evidence < f.log_evidence - settings.threshold and there > most:
        return f"without it what is not explained grows from {here**0.5:.2g} to {there**0.5:.2g} N·m RMS"
    return ""


def _at_the_edge(fitter: Fitter, f: Fit, without: Fit, settings: AcceptSettings) -> str:
    """Why an effect that is just beyond tolerance is not named: the joint at the edge of its tolerances explains about as much.

    Fits that are compared by evidence leave the noise's share of the derivatives in, which holds an inertia where it is: both are
    polished first.
    """
    problem = fitter.problem
    here, there = (left_by(problem, fitter.polish(x, settings.polish)) ** 0.5 for x in (f, without))
    if there**2 > plainly_more(here**2, noise_of(problem, f), settings):
        return ""
    return (
        f"a little beyond the joint's tolerances; at their edge {there:.2g} N·m RMS of the simulation's error is not "
        f"explained, with it {here:.2g}"
    )


def added(fitter: Fitter, general: Fit, special: Fit) -> float:
    """Log evidence that a more general model adds to a special case, both under one noise and the same weights of the rows: the
    mean over the noise learned with either.

    Noise learned for each of two models that leave next to nothing differs by chance, and with it the evidence by hundreds; the
    weights that their derivatives give to rows, by tens. A row counts as little as with either.
    """

    def evidence(f: Fit, noise: Noise, weight: np.ndarray) -> float:
        return fitter.finish(f.model, f.theta, f.point, f.jacobian, None, noise, weight=weight).log_evidence

    found = []
    for noise in (general.noise, special.noise):
        weight = np.minimum(*(weights_of(fitter.problem, noise, f) for f in (general, special)))
        found.append(evidence(general, noise, weight) - evidence(special, noise, weight))
    return float(np.mean(found))


def _as_general_as_needed(
    fitter: Fitter,
    f: Fit,
    rivals: list[Rivals],
    hypotheses: Sequence[Hypothesis],
    settings: AcceptSettings,
) -> tuple[Fit, list[Rivals], list[Decision]]:
    """Of a cause and its special cases the special one where the data do not plainly ask for more; how sure that is."""
    problem = fitter.problem
    decisions: list[Decision] = []
    for i in range(len(f.model)):
        for g in hypotheses:
            h = f.model[i]
            simpler = g.cause.name in h.cause.generalises
            if not (simpler or h.cause.name in g.cause.generalises) or any(o.key == g.key for o in f.model):
                continue
            other = _in_place_of(fitter, f, i, g)
            general, special = (f, other) if simpler else (other, f)
            more = added(fitter, general, special)
            # What no description holds speaks for the more general one too.
            loose = float(np.clip(quiet_rms(problem, f), 1.0, settings.loosest))
            if simpler and more < settings.general * loose:
                # It can do all that the special one can: from there.
                again = _in_place_of(fitter, special, i, h)
                general, more = max(((x, added(fitter, x, special)) for x in (f, again)), key=lambda x: x[1])
            elif not simpler and more > settings.general * loose:
                # What the special one gains by being fitted as long is not the more general one's.
                again = _in_place_of(fitter, general, i, h)
                special, more = min(((x, added(fitter, general, x)) for x in (f, again)), key=lambda x: x[1])
            asked = more > loose * settings.general
            sure = _sure(max(more, 0.0) / loose - settings.general, loose, settings)
            name = general.model[i].cause.name.replace("_", " ")
            reason = f"{name}, which is more general, adds {more:.0f} to the log evidence"
            taken = asked != simpler
            size, gain = size_of(problem, other, i), -more if simpler else more
            decisions.append(Decision("settle", g.cause.name, g.fixed, gain, float("nan"), size, True, taken, reason))
            f = general if asked else special
            if i < len(rivals):
                rivals = list(rivals)
                rivals[i] = replace(rivals[i], cause=f.model[i].cause.name, share=rivals[i].share * sure)
            break
    return f, rivals, decisions


def _sure(beyond: float, loose: float, settings: AcceptSettings) -> float:
    """Probability that the right one of a cause and its special case was taken, by the log evidence beyond what decides.

    A general model can do all that its special case can: how far below it ends says nothing. What no description holds adds to
    what it explains, the more the more is left.
    """
    temper = settings.temper if beyond < 0 else settings.temper_general * loose
    return float(1.0 / (1.0 + np.exp(-abs(beyond) / temper)))


def _in_place_of(fitter: Fitter, f: Fit, index: int, g: Hypothesis) -> Fit:
    """A fit with a more general hypothesis, or a special case, in an effect's place, from where it makes the same."""
    problem = fitter.problem
    h, parts = f.model[index], problem.split(f.theta, f.model)
    simpler = g.cause.name in h.cause.generalises
    values = h.values(parts[index]) if simpler else g.cause.present(problem.records(f.theta, f.model)[0][0])
    u = g.confine(g.coordinates({q.name: values[q.name] for q in g.cause.parameters}))
    theta = np.concatenate([f.theta[: problem.size], *(u if j == index else p for j, p in enumerate(parts))])
    model = tuple(g if j == index else o for j, o in enumerate(f.model))
    return fitter.fit(model, theta, f, 6, f, anew=True)


def _prune(
    fitter: Fitter, f: Fit, rivals: list[Rivals], settings: AcceptSettings
) -> tuple[Fit, list[Rivals], list[Decision]]:
    """Take back, one at a time, effects that do not hold beside the others once all are fitted together."""
    problem = fitter.problem
    decisions: list[Decision] = []
    kept: set[int] = set()  # effects without which the data are not explained, whatever the linear model says of them
    asked: set[int] = set()  # effects near the edge of tolerance that are needed
    quick: dict[int, Fit] = {}  # fits without one of the present effects
    for _ in range(3 * len(f.model)):
        honest, linear = with_dispersion(problem, f), tamed(problem, f)
        left, near = left_by(problem, f), quiet_rms(problem, f) < settings.far
        # Alone it is not one of many things that the description does not hold, but the one that was likeliest of all.
        needed_share = settings.worth if len(f.model) > 1 else settings.worth_large
        verdicts = []
        for_good: set[int] = set()  # effects that are taken back whatever they explain
        for i, h in enumerate(f.model):
            w = worth_of(problem, f, linear, i)
            size, away = size_of(problem, f, i), significance(problem, honest, i)
            if is_calibration(problem, f, i):
                reason = "what it changes is within the joint's tolerances once all causes are fitted together"
            else:
                reason = drowned(problem, f, i, settings)
            if reason:
                for_good.add(i)
            elif id(h) in kept:
                pass
            elif size <= settings.smallest:
                reason = f"{100 * size:.1f} % of its ordinary size once all causes are fitted together"
            elif near and w.rms < settings.slight * left**0.5:
                reason = f"takes {w.rms:.2g} N·m RMS from the simulation's error, {left**0.5:.2g} is left that nothing explains"
            elif away < settings.significant:
                reason = f"{away:.1f} standard deviations from absent once all causes are fitted together"
            elif w.share < needed_share:
                reason = (
                    f"takes {w.rms:.2g} N·m RMS from the simulation's error once all causes are fitted together, "
                    "too little to name"
                )
            verdicts.append((w, size, reason))
        bad = [i for i, (_, _, reason) in enumerate(verdicts) if reason]
        if bad:
            # Of those, the one without which the rest is most probable.
            tried = sorted(bad, key=lambda i: verdicts[i][0].share)[:3]
            quick |= {i: _quickly_without(fitter, f, i, f) for i in tried if i not in quick}
            i = max(tried, key=lambda i: quick[i].log_evidence)
            other = _not_lost(fitter, f, quick[i], settings, f)
            reason, gain = verdicts[i][2], float("nan")
            needed = "" if i in for_good else why_needed(problem, f, other, settings)
            if needed:
                kept.add(id(f.model[i]))
                reason, gain = needed, f.log_evidence - other.log_evidence
        else:
            near_edge = [
                i for i, h in enumerate(f.model) if id(h) not in asked and is_calibration(problem, f, i, settings.edge)
            ]
            if not near_edge:
                break
            i = min(near_edge, key=lambda i: verdicts[i][0].rms)
            other = without_effect(fitter, f, i, settings)
            asked.add(id(f.model[i]))
            reason, gain, needed = _at_the_edge(fitter, f, other, settings), float("nan"), ""
            if not reason:
                continue
        h, (w, size, _) = f.model[i], verdicts[i]
        decisions.append(Decision("settle", h.cause.name, h.fixed, gain, w.rms, size, True, bool(needed), reason))
        if not needed:
            rivals = [r for j, r in enumerate(rivals) if j != i]
            f, quick = other, {}
    return f, rivals, decisions
