"""The first cause: hypotheses that look best are fitted through the replay; of those that hold the one worth most is taken."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...models import causes
from ..fit.coordinates import Hypothesis
from ..fit.residual import Problem
from ..fit.solver import Fit, Fitter, losses_of, prior_cost, with_dispersion
from ..fit.tare import roughness, tared
from .acceptance import AcceptSettings, Decision, Rivals, held_out_cost, quiet_rms, significance, size_of
from .calibrate import hand_over
from .screen import Screened
from .worth import left_by, noise_of


@dataclass(frozen=True)
class Finalist:
    """A hypothesis fitted on top of a base: its log evidence over the base's, and by how much the mean square of what is not
    explained is smaller than the base's [N·m]²."""

    fit: Fit
    gain: float
    removed: float

    @property
    def name(self) -> str:
        """The cause's name."""
        return self.fit.model[-1].cause.name


def _start(problem: Problem, base: Fit, s: Screened) -> np.ndarray:
    """Where to start a finalist: at the linear solution or a part of the way to it."""
    model = (*base.model, s.hypothesis)
    low, high = problem.bounds(model)
    u = s.hypothesis.confine(np.clip(s.start, -3.0, 3.0))
    step = np.concatenate([np.clip(s.shift, -2.0, 2.0), u])
    absent = np.concatenate([base.theta, np.zeros(len(u))])
    starts = [np.clip(absent + part * step, low, high) for part in (1.0, 0.5)]
    starts += [t for t in (hand_over(problem, t, model) for t in starts[:1]) if not np.array_equal(t, starts[0])]
    found = problem.residuals(starts, [model] * len(starts))
    noise = s.noise or base.noise
    losses = losses_of(problem, noise, base, found)
    costs = [x + prior_cost(problem, theta, model) for x, theta in zip(losses, starts, strict=True)]
    return starts[int(np.nanargmin(costs))]


def finalists_of(
    fitter: Fitter,
    base: Fit,
    screened: Sequence[Screened],
    settings: AcceptSettings,
    done: Sequence[Finalist] = (),
    ask: Collection[str] = (),
) -> list[Finalist]:
    """The best hypotheses that are not done, fitted through the replay; a close race is decided by fits at their ends.

    Args:
      ask: causes that are fitted whatever the linear model says of them.
    """
    problem = fitter.problem
    names = {f.name for f in done}
    good = [
        s for s in screened
        if s.noise and s.gain > 0.5 * settings.threshold and s.size > 0.5 * settings.smallest
        and s.hypothesis.cause.name not in names
    ]  # fmt: skip
    asked = [s for s in screened if s.hypothesis.cause.name in ask and not any(s is g for g in good)]
    chosen: list[Screened] = []
    most = settings.finalists if quiet_rms(problem, base) < settings.far else settings.far_finalists
    for s in sorted(good, key=lambda s: -s.removed)[: most - 1 - most // 4] + good:
        taken = [c.hypothesis.cause.name for c in chosen]
        if any(c is s for c in chosen) or taken.count(s.hypothesis.cause.name) >= settings.per_cause:
            continue
        if len(chosen) < most:
            chosen.append(s)
    fitted = [
        as_finalist(
            problem, base,
            fitter.fit((*base.model, s.hypothesis), _start(problem, base, s), base, 4, base),
        )
        for s in (*chosen, *asked)
    ]  # fmt: skip
    fitted.sort(key=lambda f: -f.gain)
    if len(fitted) > 1 and fitted[1].gain > max(settings.race * fitted[0].gain, settings.threshold):
        best = fitted[0].gain
        for i, f in enumerate(fitted):
            if f.gain > settings.race * best:
                more = fitter.fit(f.fit.model, f.fit.theta, f.fit, 4, base)
                fitted[i] = max((f, as_finalist(problem, base, more)), key=lambda x: x.gain)
    return ranked(fitted)


def ranked(fitted: Sequence[Finalist]) -> list[Finalist]:
    """Finalists, the likeliest first."""
    return sorted(fitted, key=lambda f: -f.gain)


def explains_little(problem: Problem, base: Fit, f: Finalist, settings: AcceptSettings) -> bool:
    """Whether a finalist takes away but a little of what is not explained."""
    return f.removed < settings.little * left_by(problem, base)


def coarse_finalists(
    fitter: Fitter,
    base: Fit,
    hypotheses: Sequence[Hypothesis],
    settings: AcceptSettings,
    iterations: int,
) -> list[Finalist]:
    """Hypotheses with which the uncalibrated joint comes closest, fitted from there."""
    problem = fitter.problem
    return [
        as_finalist(problem, base, fitter.fit((h,), start, None, iterations, base))
        for h, start in _coarse_starts(problem, hypotheses, settings)
    ]


def _coarse_starts(
    problem: Problem, hypotheses: Sequence[Hypothesis], settings: AcceptSettings
) -> list[tuple[Hypothesis, np.ndarray]]:
    """Hypotheses with which the uncalibrated joint comes closest, where nothing is linear; where to start each.

    Every one is tried at a few sizes on the joint as it is described, the two that come closest again at each size with the zero
    of the link encoder where it belongs beside it: a late encoder pulls that aside by twice its tolerance.
    """
    zero = tared(problem, problem.start(None, ()), ())
    thetas, models = [], []
    for h in hypotheses:
        if len(h.magnitudes) != 1:
            continue
        for size in settings.coarse:
            u = np.zeros(h.size)
            u[h.magnitudes[0]] = size
            if np.allclose(h.confine(u), u):
                thetas.append(np.concatenate([zero, u]))
                models.append((h,))
    rough = [roughness(problem, rs) for rs in problem.residuals(thetas, models)]
    closest: list[Hypothesis] = []
    for i in np.argsort(rough):
        h = models[i][0]
        if len(closest) < 2 and all(g.cause.name != h.cause.name for g in closest):
            closest.append(h)
    found = []
    for h in closest:
        starts = [tared(problem, theta, model) for theta, model in zip(thetas, models, strict=True) if model[0] is h]
        rough = [roughness(problem, rs) for rs in problem.residuals(starts, [(h,)] * len(starts))]
        found.append((h, starts[int(np.argmin(rough))]))
    return found


def as_finalist(problem: Problem, base: Fit, f: Fit) -> Finalist:
    """A fit beside the one that it was made on."""
    removed = left_by(problem, base) - left_by(problem, f)
    return Finalist(f, f.log_evidence - base.log_evidence, removed)


def first_cause(
    problem: Problem, base: Fit, screened: Sequence[Screened], fitted: Sequence[Finalist], settings: AcceptSettings
) -> tuple[list[Decision], Finalist | None]:
    """The first cause: of the finalists that the data speak for, the one that is worth most; or the likeliest."""
    reasons = {id(f): objection(problem, base, f, settings) for f in fitted}
    good = [f for f in fitted if not reasons[id(f)]]
    chosen = max(good, key=lambda f: f.gain if settings.likeliest else f.removed, default=None)
    if chosen is not None and not settings.likeliest:
        # Of those that explain about the same the likeliest.
        least = min(chosen.removed / 1.5, chosen.removed - settings.chance * noise_of(problem, base))
        chosen = max((f for f in good if f.removed >= least), key=lambda f: f.gain)
        # Two causes that are well known may stand for one that is not.
        nearly = replace(settings, significant=settings.nearly)
        better = [f for f in fitted if f.gain > chosen.gain and f.removed > chosen.removed and reasons[id(f)]]
        chosen = next((f for f in better if not objection(problem, base, f, nearly)), chosen)
    decisions = []
    for f in fitted:
        h, reason = f.fit.model[-1], reasons[id(f)]
        rms = float(np.sqrt(max(f.removed, 0.0)))
        if chosen is not None and f is chosen:
            reason = f"adds {f.gain:.0f} to the log evidence and takes {rms:.2g} N·m RMS from the simulation's error"
        elif chosen is not None and not reason:
            how = "adds less" if settings.likeliest else "explains less"
            reason = f"{how} than {chosen.name.replace('_', ' ')}; judged again with that in the model"
        decisions.append(
            Decision("fit", f.name, h.fixed, f.gain, rms, size_of(problem, f.fit), True, f is chosen, reason)
        )
    done = {f.fit.model[-1].key for f in fitted}
    for s in screened:
        if s.hypothesis.key not in done:
            decisions.append(not_fitted(s, settings, "fit"))
    return decisions, chosen


def not_fitted(s: Screened, settings: AcceptSettings, stage: str) -> Decision:
    if s.gain <= 0.5 * settings.threshold:
        reason = (
            f"would add {s.gain:.1f} to the log evidence, needs {0.5 * settings.threshold:g} to be looked at closer"
        )
    elif s.size <= 0.5 * settings.smallest:
        reason = f"would be {100 * s.size:.1f} % of its ordinary size, less than {50 * settings.smallest:g} %"
    else:
        reason = f"would add {s.gain:.0f} to the log evidence; others looked better"
    return Decision(
        stage, s.hypothesis.cause.name, s.hypothesis.fixed, s.gain, float("nan"), s.size, False, False, reason
    )


def objection(problem: Problem, base: Fit, f: Finalist, settings: AcceptSettings) -> str:
    """Why a finalist is not to be accepted; empty where nothing speaks against it."""
    if f.gain <= settings.threshold:
        return f"adds {f.gain:.1f} to the log evidence, must add more than {settings.threshold:g}"
    size = size_of(problem, f.fit)
    if size <= settings.smallest:
        return f"{100 * size:.1f} % of its ordinary size, less than {100 * settings.smallest:g} %"
    if problem.is_calibration(f.fit.theta, f.fit.model):
        return "what it changes is within the joint's tolerances: calibration, no cause"
    relief = 0.5 * (prior_cost(problem, base.theta, base.model) - prior_cost(problem, f.fit.theta, f.fit.model))
    if f.fit.model[-1].cause.scales and relief > settings.threshold:
        return ""  # numbers are at odds with what is known of them, not with the data
    away = significance(problem, with_dispersion(problem, f.fit))
    if away < settings.significant:
        return f"{away:.1f} standard deviations from absent, must be {settings.significant:g}"
    return _not_held_out(problem, base, f.fit, f.gain, settings)


def _not_held_out(problem: Problem, base: Fit, f: Fit, gain: float, settings: AcceptSettings) -> str:
    share = sum(s.held_out.sum() for s in problem.segments) / max(sum(s.usable.sum() for s in problem.segments), 1)
    if share < 0.02:
        return ""
    gained = held_out_cost(problem, base, base) - held_out_cost(problem, f, f)
    needed = settings.held_out_share * 2 * gain * share
    if gained <= needed:
        return f"gains {gained / 2:.0f} in log likelihood on data that the fit did not see, must gain {needed / 2:.0f}"
    return ""


def rivals_of(
    chosen: Finalist | Screened, before: dict[str, float], after: dict[str, float], settings: AcceptSettings
) -> Rivals:
    """Rivals of a cause that was accepted: those that it has made superfluous, by gains before and after."""
    cause = (chosen.fit.model[-1] if isinstance(chosen, Finalist) else chosen.hypothesis).cause
    others = tuple(
        (n, g)
        for n, g in before.items()
        if n != cause.name
        and cause.name not in causes.get(n).generalises
        and n not in cause.generalises
        and g > settings.threshold
        and after.get(n, 0.0) < 0.2 * g
    )
    return Rivals(cause.name, chosen.gain, others)
