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
from dataclasses import dataclass, field, replace

import numpy as np

from ...models import causes
from ...models.calibration import WITHIN
from ..fit.coordinates import Hypothesis
from ..fit.noise import Noise, learn, normalised_rms, whiten
from ..fit.residual import Model, Problem
from ..fit.solver import Fit, Fitter, Point, huber_loss, losses_of, prior_cost, tamed, with_dispersion
from ..fit.tare import roughness, tared
from .calibrate import CalibrateSettings, afresh, better_of_both, calibrate, doubtful, hand_over
from .screen import Library, Screened, ScreenSettings, screen
from .worth import Worth, unexplained, worth

Progress = Callable[[str, float], None]
"""Called with a stage's name and the share of the work that is done."""


@dataclass(frozen=True)
class AcceptSettings:
    """When a cause is accepted.

    Attributes:
      threshold: log evidence that it must add.
      smallest: part of the ordinary size below which it is not named: the laws themselves are not better than that.
      significant: standard deviations that it must be away from absent, by those that no noise model has to be right for too
        (`solver.with_dispersion`); nearly: so many are enough where another one would be accepted that explains less and adds
        less to the log evidence.
      worth: mean square that it alone removes, as a share of the model discrepancy that is left beside it. Less than that is
        one of many things that the description does not hold, and no answer to what the simulation gets wrong.
      large, worth_large: from this part of the ordinary size on, so much is enough to be fitted beside the others; what holds
        there is decided by `worth` again.
      alike: part of the mean square that a cause takes away that another one must take away to be its rival.
      slight: part of the root mean square of what nothing explains that it must be worth, where that is not far above the noise
        (where it is, something is there that the library does not have).
      little: part of the mean square of what is not explained that a cause must take away, for another one to be fitted after it;
        where the best takes less and the residual is more than `plain` times the sensors' noise, further hypotheses are fitted.
      held_out_share: of what it gains on the data of the fit, it must gain so much on as many held-out data.
      race: rivals that are worth more than this part of the best are fitted to the end.
      finalists: hypotheses fitted in the first round; far_finalists: where the residual is more than `far` times the sensors'
        noise and the linear model no good judge; per_cause: at most of one cause.
      general: log evidence that a more general cause must add to a special case of it, under one noise; temper: log evidence
        by which the replay's own errors let it differ.
      edge: standard deviations of its tolerance within which an effect's value is near its edge: whether the joint at the edge
        would do is then asked of fits without the noise's share (`_at_the_edge`), of `polish` iterations.
      lost: ratio of mean squares of what is not explained, without an effect and with it, from which on a few steps may have gone
        astray, or slow discrepancy holds what the numbers would: it is then fitted both ways, to the end.
      most: causes at once; rounds: of them fitted through the replay before the others are selected in the linear model.
      gross: normalised RMS against the sensors' noise from which on hypotheses are also tried at `coarse` ordinary sizes, without
        the linear model.
    """

    threshold: float = 7.0
    smallest: float = 0.03
    significant: float = 4.0
    nearly: float = 3.0
    worth: float = 0.5
    large: float = 0.3
    worth_large: float = 0.15
    alike: float = 0.3
    slight: float = 0.25
    little: float = 0.1
    plain: float = 1.6
    held_out_share: float = 0.2
    race: float = 0.6
    finalists: int = 3
    far_finalists: int = 6
    far: float = 10.0
    per_cause: int = 2
    general: float = 30.0
    temper: float = 12.0
    edge: float = 6.0
    polish: int = 8
    lost: float = 2.25
    most: int = 5
    rounds: int = 3
    gross: float = 60.0
    coarse: tuple[float, ...] = (-1.5, -0.7, 0.4, 0.7, 1.0, 1.5)


@dataclass(frozen=True)
class SearchSettings:
    """Settings of all stages."""

    calibrate: CalibrateSettings = field(default_factory=CalibrateSettings)
    screen: ScreenSettings = field(default_factory=ScreenSettings)
    accept: AcceptSettings = field(default_factory=AcceptSettings)


SETTINGS = SearchSettings()


@dataclass(frozen=True)
class Decision:
    """What became of one hypothesis at one stage.

    Attributes:
      stage: `fit`, `select` (with the number of causes that were in the model), `settle` or `described`.
      cause, fixed: its name and its whole-number parameters.
      gain: log evidence that it adds.
      worth: root mean square of the simulation's error that it removes [N·m at the output].
      size: in ordinary sizes.
      fitted: whether it was fitted through the replay, or judged in the linear model.
      taken: whether it was accepted.
      reason: why, or why not, for people.
    """

    stage: str
    cause: str
    fixed: dict[str, float]
    gain: float
    worth: float
    size: float
    fitted: bool
    taken: bool
    reason: str


@dataclass(frozen=True)
class Rivals:
    """What else could stand where a cause was accepted.

    Attributes:
      cause: its name.
      gain: log evidence that it added.
      others: name and gain, at the same place, of causes that are not needed any more with it.
      share: of the explanations between which the evidence does not decide, those that have it.
    """

    cause: str
    gain: float
    others: tuple[tuple[str, float], ...]
    share: float = 1.0


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


# --- stages ----------------------------------------------------------------------------------------------------------


def quiet_rms(problem: Problem, f: Fit) -> float:
    """Normalised RMS of a fit's residual against the sensors' noise alone: one where nothing but noise is left."""
    bare = replace(f.noise, discrepancy=np.zeros_like(f.noise.discrepancy))
    return max(1.0, normalised_rms(problem.segments, bare, f.point.residual))


def size_of(problem: Problem, f: Fit, index: int = -1) -> float:
    """Size of one of a fit's effects, in ordinary sizes from where the joint would be without it."""
    return float(np.linalg.norm(amount_of(problem, f, index)[f.model[index].magnitudes]))


def amount_of(problem: Problem, f: Fit, index: int) -> np.ndarray:
    """Coordinates of one of a fit's effects less those at which it does nothing, shape (size,)."""
    h = f.model[index]
    parts = problem.split(f.theta, f.model)
    if not h.free:
        return parts[index]
    kept = [i for i in range(len(f.model)) if i != index % len(f.model)]
    theta = np.concatenate([f.theta[: problem.size], *(parts[i] for i in kept)])
    before = problem.records(theta, tuple(f.model[i] for i in kept))[0][0]
    return parts[index] - h.coordinates(h.cause.centre(before, h.fixed))


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


def finalists_of(
    problem: Problem,
    fitter: Fitter,
    base: Fit,
    screened: Sequence[Screened],
    settings: AcceptSettings,
    done: Sequence[Finalist] = (),
) -> list[Finalist]:
    """The best hypotheses that are not done, fitted through the replay; a close race is decided by fits at their ends."""
    names = {f.name for f in done}
    good = [
        s for s in screened
        if s.noise and s.gain > 0.5 * settings.threshold and s.size > 0.5 * settings.smallest
        and s.hypothesis.cause.name not in names
    ]  # fmt: skip
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
            fitter.fit((*base.model, s.hypothesis), _start(problem, base, s), base, 4, base.point.noise),
        )
        for s in chosen
    ]  # fmt: skip
    fitted.sort(key=lambda f: -f.gain)
    if len(fitted) > 1 and fitted[1].gain > max(settings.race * fitted[0].gain, settings.threshold):
        best = fitted[0].gain
        for i, f in enumerate(fitted):
            if f.gain > settings.race * best:
                more = fitter.fit(f.fit.model, f.fit.theta, f.fit, 4, base.point.noise)
                fitted[i] = max((f, as_finalist(problem, base, more)), key=lambda x: x.gain)
    return sorted(fitted, key=lambda f: -f.gain)


def _coarse(
    problem: Problem, hypotheses: Sequence[Hypothesis], settings: SearchSettings
) -> list[tuple[Hypothesis, np.ndarray]]:
    """Hypotheses with which the uncalibrated joint comes closest, where nothing is linear; where to start each.

    Every one is tried at a few sizes on the joint as it is described; the zero of the link encoder answers.
    """
    zero = tared(problem, problem.start(None, ()), ())
    thetas, models = [], []
    for h in hypotheses:
        if len(h.magnitudes) != 1:
            continue
        for size in settings.accept.coarse:
            u = np.zeros(h.size)
            u[h.magnitudes[0]] = size
            if np.allclose(h.confine(u), u):
                thetas.append(np.concatenate([zero, u]))
                models.append((h,))
    rough = [roughness(problem, rs) for rs in problem.residuals(thetas, models)]
    found: list[tuple[Hypothesis, np.ndarray]] = []
    for i in np.argsort(rough):
        h = models[i][0]
        if len(found) < 2 and all(g.cause.name != h.cause.name for g, _ in found):
            found.append((h, tared(problem, thetas[i], models[i])))
    return found


def as_finalist(problem: Problem, base: Fit, f: Fit) -> Finalist:
    """A fit beside the one that it was made on."""
    removed = float(np.sum(unexplained(problem, base.point)) - np.sum(unexplained(problem, f.point)))
    return Finalist(f, f.log_evidence - base.log_evidence, removed)


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
            rivals.append(rivals_of(*pending, _gains(screened), accept))
            pending = None
        late = time.monotonic() > deadline
        if late:
            break
        progress("fitting the causes that look best", 0.3 + 0.15 * len(at.model))
        fitted = finalists_of(problem, fitter, at, screened, accept)
        if quiet > accept.gross and not at.model and not afreshed:
            # So far off that the linear model says little.
            for h, start in _coarse(problem, hypotheses, settings):
                f = fitter.fit((h,), start, None, settings.calibrate.iterations, at.point.noise)
                fitted = sorted([*fitted, as_finalist(problem, at, f)], key=lambda f: -f.gain)
        seen, chosen = _first(problem, at, screened, fitted, accept)
        slight = chosen is not None and chosen.removed < accept.little * float(np.sum(unexplained(problem, at.point)))
        if slight and quiet > accept.plain:
            # What is likeliest explains next to nothing, and is not all that is there.
            fitted = sorted(
                [*fitted, *finalists_of(problem, fitter, at, screened, accept, fitted)], key=lambda f: -f.gain
            )
            seen, chosen = _first(problem, at, screened, fitted, accept)
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
        more, seen, others = _select(problem, at, library, accept, settings.screen, pending)
        decisions += seen
        rivals += others
        if more:
            progress("settling all causes", 0.8)
            at, rivals, seen = _together(problem, fitter, at, library, more, rivals)
            decisions += seen
        at, rivals, settled = _settle(problem, fitter, at, rivals, hypotheses, accept, together=bool(more))
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


def _gains(screened: Sequence[Screened]) -> dict[str, float]:
    """The largest gain of each cause."""
    gains: dict[str, float] = {}
    for s in screened:
        gains[s.hypothesis.cause.name] = max(s.gain, gains.get(s.hypothesis.cause.name, -np.inf))
    return gains


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


def _first(
    problem: Problem, base: Fit, screened: Sequence[Screened], fitted: Sequence[Finalist], settings: AcceptSettings
) -> tuple[list[Decision], Finalist | None]:
    """The first cause: of the finalists that the data speak for, the one that is worth most."""
    reasons = {id(f): _objection(problem, base, f, settings) for f in fitted}
    good = [f for f in fitted if not reasons[id(f)]]
    chosen = max(good, key=lambda f: f.removed, default=None)
    if chosen is not None:
        # Of those that explain about the same the likeliest.
        least = min(chosen.removed, chosen.removed / 1.5)
        chosen = max((f for f in good if f.removed >= least), key=lambda f: f.gain)
        # Two causes that are well known may stand for one that is not.
        nearly = replace(settings, significant=settings.nearly)
        better = [f for f in fitted if f.gain > chosen.gain and f.removed > chosen.removed and reasons[id(f)]]
        chosen = next((f for f in better if not _objection(problem, base, f, nearly)), chosen)
    decisions = []
    for f in fitted:
        h, reason = f.fit.model[-1], reasons[id(f)]
        rms = float(np.sqrt(max(f.removed, 0.0)))
        if chosen is not None and f is chosen:
            reason = f"adds {f.gain:.0f} to the log evidence and takes {rms:.2g} N·m RMS from the simulation's error"
        elif chosen is not None and not reason:
            reason = f"explains less than {chosen.name.replace('_', ' ')}; judged again with that in the model"
        decisions.append(
            Decision("fit", f.name, h.fixed, f.gain, rms, size_of(problem, f.fit), True, f is chosen, reason)
        )
    done = {f.fit.model[-1].key for f in fitted}
    for s in screened:
        if s.hypothesis.key not in done:
            decisions.append(_not_fitted(s, settings, "fit"))
    return decisions, chosen


def _not_fitted(s: Screened, settings: AcceptSettings, stage: str) -> Decision:
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


def _objection(problem: Problem, base: Fit, f: Finalist, settings: AcceptSettings) -> str:
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
        return f"gains {gained:.0f} in log likelihood on data that the fit did not see, must gain {needed:.0f}"
    return ""


def held_out_cost(problem: Problem, f: Fit, under: Fit) -> float:
    """Minus twice the log likelihood of held-out residuals of a fit, under the noise of another, less the noise's share."""
    kept = [replace(s, usable=s.held_out) for s in problem.segments]
    pairs = [np.stack([a, b], -1) for a, b in zip(f.point.residual, f.point.noise, strict=True)]
    white = whiten(kept, under.noise, pairs)
    rows = white.rows
    return float(np.sum(huber_loss(rows[:, 0], 10.0)) - np.sum(huber_loss(rows[:, 1], 10.0))) + white.log_determinant


def significance(problem: Problem, f: Fit, index: int = -1) -> float:
    """How many of its standard deviations one of a fit's effects is away from absent."""
    h = f.model[index]
    block = problem.place(f.model, index % len(f.model))
    where = block.start + np.asarray(h.magnitudes)
    away = amount_of(problem, f, index)[h.magnitudes]
    return float(np.sqrt(max(float(away @ np.linalg.solve(f.covariance[np.ix_(where, where)], away)), 0.0)))


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


# --- further causes, in the linear model -------------------------------------------------------------------------------


def _select(
    problem: Problem,
    at: Fit,
    library: Library,
    settings: AcceptSettings,
    screening: ScreenSettings,
    before: tuple[Finalist | Screened, dict[str, float]] | None,
) -> tuple[list[Screened], list[Decision], list[Rivals]]:
    """Further causes one after the other in the linear model about a fit: the one first that is worth most.

    `before`: the cause that was accepted last, with the gains of all when it was.
    """
    chosen: list[Screened] = []
    decisions: list[Decision] = []
    rivals: list[Rivals] = []
    here, rest = tamed(problem, at), library
    seen: dict[tuple, Decision] = {}
    while len(at.model) + len(chosen) < settings.most + 1:
        screened = screen(problem, here, rest, screening)
        gains = _gains(screened)
        if before is not None:
            rivals.append(rivals_of(*before, gains, settings))
        stage = f"select {len(at.model) + len(chosen) + 1}"
        good: list[tuple[Screened, Worth]] = []
        for s in screened:
            name = s.hypothesis.cause.name
            key = s.hypothesis.key
            if s.gain <= settings.threshold or s.size <= settings.smallest or s.noise is None:
                seen[key] = _not_fitted(s, settings, stage)
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
        best, w = max(good, key=lambda pair: pair[1].rms)
        top = max(good, key=lambda pair: pair[0].gain)
        if top[1].rms > 0.7 * w.rms:
            best, w = top
        reason = (
            f"would add {best.gain:.0f} to the log evidence and take {w.rms:.2g} N·m RMS from the simulation's error"
        )
        name = best.hypothesis.cause.name
        seen.pop(best.hypothesis.key, None)
        decisions.append(Decision(stage, name, best.hypothesis.fixed, best.gain, w.rms, best.size, False, True, reason))
        before = (best, _gains([s for s in screened if s.removed > settings.alike * best.removed]))
        chosen.append(best)
        here = _with(problem, here, rest, best)
        rest = rest.keeping(others_than(problem, rest.hypotheses, here.model))
    return chosen, [*decisions, *seen.values()], rivals


def _with(problem: Problem, f: Fit, library: Library, s: Screened) -> Fit:
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
        noise=learn(problem.segments, residual, f.point.noise, problem.quantum()),
    )  # fmt: skip


def _worth_of(problem: Problem, f: Fit, library: Library, s: Screened) -> Worth:
    """What a hypothesis would be worth in the linear model about a fit."""
    after = _with(problem, f, library, s)
    h = s.hypothesis
    n = f.jacobian[0].shape[-1]
    effect = n + np.asarray(h.magnitudes)
    origin = library.origins[library.hypotheses.index(h)]
    return worth(problem, after, after.jacobian, effect, np.arange(n), (s.start - origin)[h.magnitudes])


def worth_of(problem: Problem, f: Fit, linear: Fit, index: int) -> Worth:
    """What one of a fit's effects is worth; `linear`: the fit with `solver.tamed` derivatives."""
    h, block = f.model[index], problem.place(f.model, index)
    effect = block.start + np.asarray(h.magnitudes)
    others = np.setdiff1d(np.arange(len(f.theta)), np.arange(block.start, block.stop))
    return worth(problem, f, linear.jacobian, effect, others, amount_of(problem, f, index)[h.magnitudes])


def _together(
    problem: Problem, fitter: Fitter, at: Fit, library: Library, chosen: Sequence[Screened], rivals: list[Rivals]
) -> tuple[Fit, list[Rivals], list[Decision]]:
    """All causes fitted together through the replay, from where the linear model puts them; as before where that is no gain."""
    here, rest = tamed(problem, at), library
    for s in chosen:
        here = _with(problem, here, rest, s)
    half = np.concatenate([0.5 * (at.theta + here.theta[: len(at.theta)]), here.theta[len(at.theta) :]])
    starts = [here.theta, np.concatenate([at.theta, here.theta[len(at.theta) :]]), half]
    found = problem.residuals(starts, [here.model] * len(starts))
    start = starts[int(np.nanargmin(losses_of(problem, here.noise, at, found)))]
    f = fitter.fit(here.model, hand_over(problem, start, here.model), at, 6)

    def left(x: Fit) -> float:
        return float(np.sum(unexplained(problem, x.point)))

    def no_gain(x: Fit) -> bool:
        return x.log_evidence < at.log_evidence and left(x) > left(at)

    if left(f) < 0.5 * left(at) or no_gain(f):
        f = fitter.fit(f.model, f.theta, None, 4)  # far from where the common derivatives were taken
    if not no_gain(f):
        return f, rivals, []
    first = len(at.model)
    reason = (
        f"fitted together {left(f) ** 0.5:.2g} N·m RMS of the simulation's error is not explained, "
        f"without {left(at) ** 0.5:.2g}"
    )
    dropped = [
        Decision("settle", h.cause.name, h.fixed, f.log_evidence - at.log_evidence, float("nan"),
                 size_of(problem, f, first + i), True, False, reason)
        for i, h in enumerate(f.model[first:])
    ]  # fmt: skip
    return at, rivals[:first], dropped


def _is_calibration(problem: Problem, f: Fit, index: int, within: float = WITHIN) -> bool:
    """Whether tolerances can express what one of a fit's effects makes of the joint that the others make."""
    order = [*(j for j in range(len(f.model)) if j != index), index]
    parts = problem.split(f.theta, f.model)
    theta = np.concatenate([f.theta[: problem.size], *(parts[j] for j in order)])
    return problem.is_calibration(theta, tuple(f.model[j] for j in order), within)


def without_effect(problem: Problem, fitter: Fitter, f: Fit, index: int, settings: AcceptSettings) -> Fit:
    """A fit without one of its effects."""
    block = problem.place(f.model, index)
    kept = np.delete(np.arange(len(f.theta)), np.arange(block.start, block.stop))
    model = tuple(g for j, g in enumerate(f.model) if j != index)
    other = fitter.fit(model, f.theta[kept], f, 4)
    if np.sum(unexplained(problem, other.point)) < settings.lost * np.sum(unexplained(problem, f.point)):
        return other
    return better_of_both(fitter, model, f.theta[kept])


def why_needed(problem: Problem, f: Fit, without: Fit, settings: AcceptSettings) -> str:
    """Why an effect stays, however little is known of its size: without it the data are not explained. Empty where they are."""
    here, there = (float(np.sum(unexplained(problem, x.point))) for x in (f, without))
    if without.log_evidence < f.log_evidence - settings.threshold and there > (1 + settings.worth) * here:
        return f"without it what is not explained grows from {here**0.5:.2g} to {there**0.5:.2g} N·m RMS"
    return ""


def _at_the_edge(problem: Problem, fitter: Fitter, f: Fit, without: Fit, settings: AcceptSettings) -> str:
    """Why an effect that is just beyond tolerance is not named: the joint at the edge of its tolerances explains about as much.

    Fits that are compared by evidence leave the noise's share of the derivatives in, which holds an inertia where it is: both are
    polished first.
    """
    here, there = (
        float(np.sum(unexplained(problem, fitter.polish(x, settings.polish).point))) ** 0.5 for x in (f, without)
    )
    if there**2 > (1 + settings.worth) * here**2:
        return ""
    return (
        f"a little beyond the joint's tolerances; at their edge {there:.2g} N·m RMS of the simulation's error is not "
        f"explained, with it {here:.2g}"
    )


def added_under_one_noise(fitter: Fitter, general: Fit, special: Fit) -> float:
    """Log evidence that a more general model adds, both under one noise: the mean over that learned with either.

    Noise learned for each of two models that leave next to nothing differs by chance, and with it the evidence by hundreds.
    """

    def evidence(f: Fit, noise: Noise) -> float:
        return fitter.finish(f.model, f.theta, f.point, f.jacobian, None, noise).log_evidence

    return 0.5 * sum(evidence(general, f.noise) - evidence(special, f.noise) for f in (general, special))


def _as_general_as_needed(
    problem: Problem,
    fitter: Fitter,
    f: Fit,
    rivals: list[Rivals],
    hypotheses: Sequence[Hypothesis],
    settings: AcceptSettings,
) -> tuple[Fit, list[Rivals], list[Decision]]:
    """Of a cause and its special cases the special one where the data do not plainly ask for more; how sure that is."""
    decisions: list[Decision] = []
    for i in range(len(f.model)):
        for g in hypotheses:
            h = f.model[i]
            simpler = g.cause.name in h.cause.generalises
            if not (simpler or h.cause.name in g.cause.generalises) or any(o.key == g.key for o in f.model):
                continue
            parts = problem.split(f.theta, f.model)
            model = tuple(g if j == i else o for j, o in enumerate(f.model))
            values = h.values(parts[i]) if simpler else g.cause.present(problem.records(f.theta, f.model)[0][0])
            u = g.confine(g.coordinates({q.name: values[q.name] for q in g.cause.parameters}))
            theta = np.concatenate([f.theta[: problem.size], *(u if j == i else p for j, p in enumerate(parts))])
            other = fitter.fit(model, theta, None, 6)
            general, special = (f, other) if simpler else (other, f)
            more = added_under_one_noise(fitter, general, special)
            asked = more > settings.general
            sure = 1.0 / (1.0 + np.exp(-abs(more - settings.general) / settings.temper))
            name = general.model[i].cause.name.replace("_", " ")
            reason = f"{name}, which is more general, adds {more:.0f} to the log evidence"
            taken = asked != simpler
            size, gain = size_of(problem, other, i), -more if simpler else more
            decisions.append(Decision("settle", g.cause.name, g.fixed, gain, float("nan"), size, True, taken, reason))
            if taken:
                f = other
            if i < len(rivals):
                rivals = list(rivals)
                rivals[i] = replace(rivals[i], cause=f.model[i].cause.name, share=rivals[i].share * float(sure))
            break
    return f, rivals, decisions


def _settle(
    problem: Problem,
    fitter: Fitter,
    f: Fit,
    rivals: list[Rivals],
    hypotheses: Sequence[Hypothesis],
    settings: AcceptSettings,
    *,
    together: bool,
) -> tuple[Fit, list[Rivals], list[Decision]]:
    """Of effects that were taken those that hold beside the others, beyond the joint's tolerances and as general as needed."""
    decisions: list[Decision] = []
    near_edge = any(_is_calibration(problem, f, i, settings.edge) for i in range(len(f.model)))
    if together or near_edge or len(f.model) > 1:
        f, rivals, decisions = _prune(problem, fitter, f, rivals, settings)
    before = f
    f, rivals, settled = _as_general_as_needed(problem, fitter, f, rivals, hypotheses, settings)
    decisions += settled
    if f is not before and len(f.model) > 1:
        # Another may have stood for what the one that was replaced could not do.
        f, rivals, settled = _prune(problem, fitter, f, rivals, settings)
        decisions += settled
    return f, rivals, decisions


def _prune(
    problem: Problem, fitter: Fitter, f: Fit, rivals: list[Rivals], settings: AcceptSettings
) -> tuple[Fit, list[Rivals], list[Decision]]:
    """Take back, one at a time, effects that do not hold beside the others once all are fitted together."""
    dropped: list[Decision] = []
    kept: set[int] = set()  # effects without which the data are not explained, whatever the linear model says of them
    asked: set[int] = set()  # effects near the edge of tolerance that are needed
    for _ in range(3 * len(f.model)):
        honest, linear = with_dispersion(problem, f), tamed(problem, f)
        left, near = float(np.sum(unexplained(problem, f.point))), quiet_rms(problem, f) < settings.far
        verdicts = []
        for i, h in enumerate(f.model):
            w = worth_of(problem, f, linear, i)
            size, away = size_of(problem, f, i), significance(problem, honest, i)
            reason = ""
            if _is_calibration(problem, f, i):
                reason = "what it changes is within the joint's tolerances once all causes are fitted together"
            elif size <= settings.smallest:
                reason = f"{100 * size:.1f} % of its ordinary size once all causes are fitted together"
            elif near and w.rms < settings.slight * left**0.5:
                reason = f"takes {w.rms:.2g} N·m RMS from the simulation's error, {left**0.5:.2g} is left that nothing explains"
            elif id(h) in kept:
                reason = ""
            elif away < settings.significant:
                reason = f"{away:.1f} standard deviations from absent once all causes are fitted together"
            elif w.share < settings.worth:
                reason = (
                    f"takes {w.rms:.2g} N·m RMS from the simulation's error once all causes are fitted together, "
                    "too little to name"
                )
            verdicts.append((w, size, reason))
        bad = [i for i, (_, _, reason) in enumerate(verdicts) if reason]
        if not bad:
            near_edge = [
                i for i, h in enumerate(f.model) if id(h) not in asked and _is_calibration(problem, f, i, settings.edge)
            ]
            if not near_edge:
                break
            i = min(near_edge, key=lambda i: verdicts[i][0].rms)
            w, size, _ = verdicts[i]
            h, other = f.model[i], without_effect(problem, fitter, f, i, settings)
            asked.add(id(h))
            if reason := _at_the_edge(problem, fitter, f, other, settings):
                dropped.append(
                    Decision("settle", h.cause.name, h.fixed, float("nan"), w.rms, size, True, False, reason)
                )
                rivals = [r for j, r in enumerate(rivals) if j != i]
                f = other
            continue
        # Of those, the one without which the rest is most probable.
        trials = [
            (i, without_effect(problem, fitter, f, i, settings))
            for i in sorted(bad, key=lambda i: verdicts[i][0].share)[:3]
        ]
        i, other = max(trials, key=lambda trial: trial[1].log_evidence)
        w, size, reason = verdicts[i]
        h = f.model[i]
        needed = why_needed(problem, f, other, settings)
        if needed and not _is_calibration(problem, f, i):
            kept.add(id(h))
            reason = needed
            gain = f.log_evidence - other.log_evidence
            dropped.append(Decision("settle", h.cause.name, h.fixed, gain, w.rms, size, True, True, reason))
            continue
        dropped.append(Decision("settle", h.cause.name, h.fixed, float("nan"), w.rms, size, True, False, reason))
        rivals = [r for j, r in enumerate(rivals) if j != i]
        f = other
    return f, rivals, dropped
