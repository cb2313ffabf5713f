"""Further causes, one after the other in the linear model about a fit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ..fit.coordinates import Hypothesis
from ..fit.noise import learn
from ..fit.residual import Model, Problem
from ..fit.solver import Fit, Point, tamed
from .acceptance import AcceptSettings, Decision, Rivals
from .finalists import Finalist, not_fitted, rivals_of
from .screen import Library, Screened, ScreenSettings, screen
from .worth import Worth, worth


def others_than(problem: Problem, hypotheses: Sequence[Hypothesis], model: Model) -> list[Hypothesis]:
    """Hypotheses that a model has room for and not already: of causes that add, those with other whole numbers.

    Beside a cause there is none that is a special case of it, or of which it is one: either says all.
    """

    def repeats(h: Hypothesis) -> bool:
        return any(
            (o.cause.name == h.cause.name and (not h.cause.adds or o.fixed == h.fixed or not h.fixed))
            or o.cause.name in h.cause.generalises
            or h.cause.name in o.cause.generalises
            for o in model
        )

    return problem.with_room(model, [h for h in hypotheses if not repeats(h)])


def gains_of(screened: Sequence[Screened]) -> dict[str, float]:
    """The largest gain of each cause."""
    gains: dict[str, float] = {}
    for s in screened:
        gains[s.hypothesis.cause.name] = max(s.gain, gains.get(s.hypothesis.cause.name, -np.inf))
    return gains


def select(
    problem: Problem,
    at: Fit,
    library: Library,
    settings: AcceptSettings,
    screening: ScreenSettings,
    before: tuple[Finalist | Screened, dict[str, float]] | None,
) -> tuple[list[Screened], list[Decision], list[Rivals]]:
    """Further causes one after the other in the linear model about a fit: the one first that is worth most, and of those that
    are worth about the same the likeliest.

    `before`: the cause that was accepted last, with the gains of all when it was.
    """
    chosen: list[Screened] = []
    decisions: list[Decision] = []
    rivals: list[Rivals] = []
    here, rest = tamed(problem, at), library
    seen: dict[tuple, Decision] = {}
    while len(at.model) + len(chosen) < settings.most + 1:
        screened = screen(problem, here, rest, screening)
        gains = gains_of(screened)
        if before is not None:
            rivals.append(rivals_of(*before, gains, settings))
        stage = f"select {len(at.model) + len(chosen) + 1}"
        good: list[tuple[Screened, Worth]] = []
        for s in screened:
            name = s.hypothesis.cause.name
            key = s.hypothesis.key
            if s.gain <= settings.threshold or s.size <= settings.smallest or s.noise is None:
                seen[key] = not_fitted(s, settings, stage)
                continue
            w = _worth_of(problem, here, rest, s)
            needed = settings.worth if s.size < settings.large else settings.worth_large
            if w.share < needed:
                reason = (
                    f"would take {w.rms:.2g} N·m RMS from the simulation's error, {100 * w.share:.0f} % of the mean square "
                    f"that the description does not hold beside it; {100 * needed:.0f} % is worth naming"
                )
                seen[key] = Decision(stage, name, s.hypothesis.fixed, s.gain, w.rms, s.size, False, False, reason)
                continue
            good.append((s, w))
        if not good or len(at.model) + len(chosen) >= settings.most:
            break
        # Of those that are worth about the same the likeliest.
        most = max(w.rms for _, w in good)
        best, w = max((pair for pair in good if pair[1].rms > settings.same * most), key=lambda pair: pair[0].gain)
        reason = (
            f"would add {best.gain:.0f} to the log evidence and take {w.rms:.2g} N·m RMS from the simulation's error"
        )
        name = best.hypothesis.cause.name
        seen.pop(best.hypothesis.key, None)
        decisions.append(Decision(stage, name, best.hypothesis.fixed, best.gain, w.rms, best.size, False, True, reason))
        before = (best, gains_of([s for s in screened if s.removed > settings.alike * best.removed]))
        chosen.append(best)
        here = with_effect(problem, here, rest, best)
        rest = rest.keeping(others_than(problem, rest.hypotheses, here.model))
    return chosen, [*decisions, *seen.values()], rivals


def with_effect(problem: Problem, f: Fit, library: Library, s: Screened) -> Fit:
    """The linear model about a fit with one more effect in it, its noise learned anew."""
    h, columns = s.hypothesis, library.of(s.hypothesis)
    origin = library.origins[library.hypotheses.index(h)]
    change = s.start[h.magnitudes] - origin[h.magnitudes]
    full = [np.zeros((*c.shape[:2], h.size)) for c in columns]
    for whole, c in zip(full, columns, strict=True):
        whole[..., h.magnitudes] = c
    residual = [a + J @ s.shift + c @ change for a, J, c in zip(f.point.residual, f.jacobian, columns, strict=True)]
    low, high = problem.bounds((*f.model, h))
    theta = np.clip(np.concatenate([f.theta + s.shift, s.start]), low, high)
    return replace(
        f, model=(*f.model, h), theta=theta, point=Point(residual, f.point.noise), noise_jacobian=None,
        jacobian=[np.concatenate([J, w], -1) for J, w in zip(f.jacobian, full, strict=True)],
        noise=learn(
            problem.segments, residual, f.point.noise, problem.quantum(), None, f.noise.settings, rest=f.noise.rest
        ),
    )  # fmt: skip


def _worth_of(problem: Problem, f: Fit, library: Library, s: Screened) -> Worth:
    """What a hypothesis would be worth in the linear model about a fit."""
    after = with_effect(problem, f, library, s)
    h = s.hypothesis
    n = f.jacobian[0].shape[-1]
    effect = n + np.asarray(h.magnitudes)
    origin = library.origins[library.hypotheses.index(h)]
    return worth(problem, after, after.jacobian, effect, np.arange(n), (s.start - origin)[h.magnitudes])
