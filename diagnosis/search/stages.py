"""Which causes the data speak for, in stages: calibrate, screen, fit, accept; again until no further cause earns its place.

Every stage returns a frozen result, and every hypothesis that was looked at leaves a decision that says why it was taken or not.
The noise, with what no description can hold (`fit.noise`), is learned for every model that is compared: a cause is worth what it
makes likelier *beside* its own discrepancy, not in units of the encoders' noise.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from ..data.segments import BALANCES
from ..fit.coordinates import Hypothesis
from ..fit.noise import normalised_rms, whiten
from ..fit.residual import REACH, Model, Problem
from ..fit.solver import SETTINGS as SOLVER
from ..fit.solver import Fit, Fitter, huber_loss, prior_cost, with_dispersion
from .screen import Library, Screened, ScreenSettings, screen

Progress = Callable[[str, float], None]
"""Called with a stage's name and the share of the work that is done."""


@dataclass(frozen=True)
class CalibrateSettings:
    """How the joint is calibrated before any cause is tried.

    Attributes:
      tare: values of the link encoder's zero, in its standard deviations, from which the best is where fits start: a
        milliradian is several newton metres, where nothing is linear.
      iterations: of Gauss–Newton.
      stuck: a number that the data know well and that sits so many standard deviations from nominal may stand in for an effect.
      unsettled: normalised RMS against the sensors' noise from which on a second start is tried.
    """

    tare: tuple[float, ...] = (-2.4, -1.8, -1.2, -0.6, 0.0, 0.6, 1.2, 1.8, 2.4)
    iterations: int = 9
    stuck: float = 0.92 * REACH
    unsettled: float = 1.35


@dataclass(frozen=True)
class AcceptSettings:
    """When a further cause is accepted.

    Attributes:
      threshold: log evidence that it must add.
      smallest: part of the ordinary size below which it is not named: the laws themselves are not better than that.
      significant: standard deviations that it must be away from absent.
      small, least_gain: one that earns less than this part of what the first did, or less than this log evidence, must be as
        significant by standard deviations that no noise model has to be right for (`solver.with_dispersion`).
      held_out_share: of what it gains on the data of the fit, it must gain so much on as many held-out data.
      proxy: one that earns less than this part of what another earns stands in for it.
      race: rivals that earn more than this part of the best are fitted to the end.
      finalists: hypotheses fitted in a round; per_cause: at most of one cause.
      most: causes at once.
    """

    threshold: float = 7.0
    smallest: float = 0.03
    significant: float = 4.0
    small: float = 0.2
    least_gain: float = 100.0
    held_out_share: float = 0.2
    proxy: float = 0.5
    race: float = 0.7
    finalists: int = 3
    per_cause: int = 2
    most: int = 3


@dataclass(frozen=True)
class SearchSettings:
    """Settings of all stages."""

    calibrate: CalibrateSettings = field(default_factory=CalibrateSettings)
    screen: ScreenSettings = field(default_factory=ScreenSettings)
    accept: AcceptSettings = field(default_factory=AcceptSettings)


SETTINGS = SearchSettings()


@dataclass(frozen=True)
class Decision:
    """What became of one hypothesis in one round.

    Attributes:
      round: from 1.
      cause, fixed: its name and its whole-number parameters.
      gain: log evidence that it added, of the linear model where it was not fitted.
      size: in ordinary sizes.
      fitted: whether it was fitted through the replay.
      taken: whether it was accepted.
      reason: why, or why not, for people.
    """

    round: int
    cause: str
    fixed: dict[str, float]
    gain: float
    size: float
    fitted: bool
    taken: bool
    reason: str


@dataclass(frozen=True)
class Finalist:
    """A hypothesis fitted on top of a base: its log evidence over the base's, and whether it is large enough to be named and beyond
    what tolerances can express."""

    fit: Fit
    gain: float
    nameable: bool

    @property
    def name(self) -> str:
        """The cause's name."""
        return self.fit.model[-1].cause.name


@dataclass(frozen=True)
class Round:
    """One round of the search: a base model, all hypotheses by their linearised gain, and the finalists, best first."""

    base: Fit
    quiet: float
    screened: tuple[Screened, ...]
    finalists: tuple[Finalist, ...]
    decisions: tuple[Decision, ...]

    @property
    def named(self) -> list[tuple[str, float]]:
        """Names and gains of those that could be named, best first."""
        return [(f.name, f.gain) for f in self.finalists if f.nameable]


@dataclass(frozen=True)
class Search:
    """What the search found: the rounds, the chosen model, and the library's columns there.

    Attributes:
      complete: whether all rounds were done; not so where time was up.
    """

    rounds: tuple[Round, ...]
    chosen: Fit
    library: Library
    complete: bool = True

    @property
    def decisions(self) -> tuple[Decision, ...]:
        """All decisions, in order."""
        return tuple(d for r in self.rounds for d in r.decisions)


def calibrate(problem: Problem, fitter: Fitter, settings: CalibrateSettings = SETTINGS.calibrate) -> Fit:
    """The joint without causes at its most probable numbers."""
    return fitter.fit((), tared(problem, problem.start(None, ()), (), settings), iterations=settings.iterations)


def tared(problem: Problem, theta: np.ndarray, model: Model, settings: CalibrateSettings) -> np.ndarray:
    """The same unknowns with the link encoder's zero where the residual is smallest, on a grid."""
    names = problem.calibration.names
    if "link_encoder_zero" not in names or not problem.link_measured:
        return theta
    at = names.index("link_encoder_zero")
    tried = [np.r_[theta[:at], x, theta[at + 1 :]] for x in settings.tare]
    found = problem.residuals(tried, [model] * len(tried))
    return tried[int(np.nanargmin([_roughness(problem, rs) for rs in found]))]


def _roughness(problem: Problem, residuals: Sequence[np.ndarray]) -> float:
    """Sum of the logarithms of mean absolute residuals in motion: robust, and without a noise model."""
    total = 0.0
    for segment, r in zip(problem.segments, residuals, strict=True):
        for b in range(len(BALANCES)):
            use = segment.usable[:, b] & ~segment.at_rest
            if use.any():
                total += use.sum() * np.log(np.mean(np.abs(r[use, b])) + 1e-12)
    return float(total)


def quiet_rms(problem: Problem, f: Fit) -> float:
    """Normalised RMS of a fit's residual against the sensors' noise alone: one where nothing but noise is left."""
    bare = replace(f.noise, discrepancy=np.zeros_like(f.noise.discrepancy))
    return max(1.0, normalised_rms(problem.segments, bare, f.point.residual))


def finalists(screened: Sequence[Screened], settings: AcceptSettings, least: float) -> list[Screened]:
    """The best hypotheses that could matter, at most `per_cause` of the same cause."""
    chosen: list[Screened] = []
    taken: dict[str, int] = {}
    for s in screened:
        name = s.hypothesis.cause.name
        if s.gain <= least or s.size <= 0.5 * settings.smallest:
            continue
        if taken.get(name, 0) < settings.per_cause and len(taken | {name: 0}) <= settings.finalists:
            taken[name] = taken.get(name, 0) + 1
            chosen.append(s)
    return chosen


def _start(problem: Problem, base: Fit, s: Screened) -> np.ndarray:
    """Where to start a finalist: at the linear solution, a part of the way to it, or where the effect is absent."""
    model = (*base.model, s.hypothesis)
    low, high = problem.bounds(model)
    u = s.hypothesis.confine(np.clip(s.start, -3.0, 3.0))
    step = np.concatenate([np.clip(s.shift, -2.0, 2.0), u])
    absent = np.concatenate([base.theta, np.zeros(len(u))])
    starts = [np.clip(absent + part * step, low, high) for part in (1.0, 0.5)]
    starts += [t for t in (hand_over(problem, t, model) for t in starts[:1]) if not np.array_equal(t, starts[0])]
    found = problem.residuals(starts, [model] * len(starts))
    noise = s.noise or base.noise
    costs = [
        float(np.sum(huber_loss(whiten(problem.segments, noise, [r[..., None] for r in rs]).rows[:, 0], SOLVER.huber)))
        + prior_cost(problem, theta, model)
        for rs, theta in zip(found, starts, strict=True)
    ]
    return starts[int(np.nanargmin(costs))]


def size_of(problem: Problem, f: Fit) -> float:
    """Size of a fit's last effect, in ordinary sizes from where the joint would be without it."""
    h = f.model[-1]
    before = problem.records(f.theta[: len(f.theta) - h.size], f.model[:-1])[0][0]
    absent = h.coordinates(h.cause.centre(before, h.fixed))
    return float(np.linalg.norm((problem.split(f.theta, f.model)[-1] - absent)[h.magnitudes]))


def search(
    problem: Problem,
    hypotheses: Sequence[Hypothesis],
    settings: SearchSettings = SETTINGS,
    progress: Progress = lambda stage, done: None,
    deadline: float = np.inf,
) -> Search:
    """Find the causes: calibrate, screen, fit the finalists, accept the best; again until none earns its place.

    Args:
      deadline: of `time.monotonic` [s], after which no further round begins and the best so far is the answer.
    """
    fitter = Fitter(problem)
    accept = settings.accept
    progress("calibrating the joint", 0.05)
    base = calibrate(problem, fitter, settings.calibrate)
    rounds: list[Round] = []
    again = False
    while True:
        number = len(rounds) + 1
        progress(f"screening causes, round {number}", min(0.1 + 0.25 * number, 0.8))
        quiet = quiet_rms(problem, base)
        tried = [h for h in hypotheses if not _repeats(h, base.model)]
        probe = settings.screen.probe if quiet < settings.screen.quiet else settings.screen.coarse_probe
        library = Library(problem, base, tried, probe)
        screened = screen(problem, base, library, settings.screen)
        progress(f"fitting causes, round {number}", min(0.2 + 0.25 * number, 0.85))
        fitted = [
            _finalist(problem, fitter, base, s, accept) for s in finalists(screened, accept, 0.5 * accept.threshold)
        ]
        fitted = _race(problem, fitter, base, fitted, accept)
        first = rounds[0].finalists[0].gain if rounds and rounds[0].finalists else 0.0
        decisions, chosen = _decide(problem, base, screened, fitted, first, number, accept)
        late = time.monotonic() > deadline
        if chosen is None and not again and not late and _doubtful(problem, base, quiet, settings.calibrate):
            again = True
            other = afresh(problem, fitter, base, settings.calibrate)
            if other.log_evidence > base.log_evidence + 1.0:
                base = other
                continue
        rounds.append(
            Round(
                base,
                quiet,
                screened,
                tuple(fitted),
                tuple(decisions),
            )
        )
        if chosen is None or late:
            break
        progress(f"settling {chosen.name.replace('_', ' ')}", min(0.3 + 0.25 * number, 0.88))
        theta = hand_over(problem, chosen.fit.theta, chosen.fit.model)
        base = fitter.fit(chosen.fit.model, theta, iterations=6)
        if _doubtful(problem, base, quiet_rms(problem, base), settings.calibrate):
            base = max((base, afresh(problem, fitter, base, settings.calibrate)), key=lambda f: f.log_evidence)
        if len(base.model) >= accept.most:
            library = Library(
                problem, base, [h for h in hypotheses if not _repeats(h, base.model)], settings.screen.probe
            )
            break
    return Search(tuple(rounds), base, library, complete=time.monotonic() <= deadline)


def _repeats(h: Hypothesis, model: Model) -> bool:
    """Whether a model has the same cause already: of those that add, with the same whole numbers."""
    for other in model:
        if other.cause.name == h.cause.name and (not h.cause.adds or other.fixed == h.fixed):
            return True
    return False


def _finalist(problem: Problem, fitter: Fitter, base: Fit, s: Screened, settings: AcceptSettings) -> Finalist:
    f = fitter.fit(
        (*base.model, s.hypothesis), _start(problem, base, s), near=base, iterations=4, sensors=base.point.noise
    )
    return _judged(problem, base, f, settings)


def _judged(problem: Problem, base: Fit, f: Fit, settings: AcceptSettings) -> Finalist:
    large = size_of(problem, f) > settings.smallest
    return Finalist(f, f.log_evidence - base.log_evidence, large and not problem.is_calibration(f.theta, f.model))


def _race(
    problem: Problem, fitter: Fitter, base: Fit, fitted: list[Finalist], settings: AcceptSettings
) -> list[Finalist]:
    """A close race is decided by fits at their ends."""
    fitted = sorted(fitted, key=lambda f: -f.gain)
    if len(fitted) > 1 and fitted[1].gain > max(settings.race * fitted[0].gain, settings.threshold):
        best = fitted[0].gain
        rivals = []
        for f in fitted:
            if f.gain > settings.race * best:
                more = fitter.fit(f.fit.model, f.fit.theta, iterations=5, sensors=base.point.noise)
                f = max((f, _judged(problem, base, more, settings)), key=lambda x: x.gain)
            rivals.append(f)
        fitted = sorted(rivals, key=lambda f: -f.gain)
    return fitted


def _decide(problem, base, screened, fitted, first, number, settings) -> tuple[list[Decision], Finalist | None]:
    """Why each hypothesis was taken or not; and the one that was."""
    best = fitted[0].gain if fitted else 0.0
    chosen, decisions = None, []
    done = {(f.name, *f.fit.model[-1].fixed.items()) for f in fitted}
    for f in fitted:
        reason = _objection(problem, base, f, best, first, settings)
        taken = not reason and chosen is None
        if taken:
            chosen = f
            reason = f"adds {f.gain:.0f} to the log evidence, more than any other"
        elif not reason:
            reason = f"adds {f.gain:.0f}, less than {chosen.name.replace('_', ' ')} with {chosen.gain:.0f}"
        h = f.fit.model[-1]
        decisions.append(Decision(number, f.name, h.fixed, f.gain, size_of(problem, f.fit), True, taken, reason))
    for s in screened:
        if (s.hypothesis.cause.name, *s.hypothesis.fixed.items()) in done:
            continue
        if s.gain <= 0.5 * settings.threshold:
            reason = f"would add {s.gain:.1f} to the log evidence by the linear model, needs {0.5 * settings.threshold:g} to be fitted"
        elif s.size <= 0.5 * settings.smallest:
            reason = f"would be {100 * s.size:.1f} % of its ordinary size, less than {50 * settings.smallest:g} %"
        else:
            reason = f"would add {s.gain:.0f} by the linear model; {settings.finalists} causes looked better"
        decisions.append(
            Decision(number, s.hypothesis.cause.name, s.hypothesis.fixed, s.gain, s.size, False, False, reason)
        )
    return decisions, chosen


def _objection(problem, base: Fit, f: Finalist, best: float, first: float, settings: AcceptSettings) -> str:
    """Why a finalist is not to be accepted; empty where nothing speaks against it."""
    if f.gain <= settings.threshold:
        return f"adds {f.gain:.1f} to the log evidence, must add more than {settings.threshold:g}"
    if not f.nameable:
        size = size_of(problem, f.fit)
        if size <= settings.smallest:
            return f"{100 * size:.1f} % of its ordinary size, less than {100 * settings.smallest:g} %"
        return "what it changes is within the joint's tolerances: calibration, no cause"
    if _relieves(problem, base, f.fit, settings.threshold):
        return ""
    if f.gain < settings.proxy * best:
        return f"adds {f.gain:.0f}, less than {100 * settings.proxy:g} % of what another adds: may stand in for it"
    away = significance(problem, f.fit)
    if away < settings.significant:
        return f"{away:.1f} standard deviations from absent, must be {settings.significant:g}"
    if f.gain < max(settings.small * first, settings.least_gain):
        away = significance(problem, with_dispersion(problem, f.fit))
        if away < settings.significant:
            return f"{away:.1f} standard deviations from absent as residuals scatter from second to second, must be {settings.significant:g}"
    share = sum(s.held_out.sum() for s in problem.segments) / max(sum(s.usable.sum() for s in problem.segments), 1)
    if share < 0.02:
        return ""
    gained = held_out_cost(problem, base, f.fit) - held_out_cost(problem, f.fit, f.fit)
    needed = settings.held_out_share * 2 * f.gain * share
    if gained <= needed:
        return f"gains {gained:.0f} in χ² on data that the fit did not see, must gain {needed:.0f}"
    return ""


def _relieves(problem: Problem, base: Fit, f: Fit, threshold: float) -> bool:
    """Whether a cause that scales numbers takes strain from them: they are then at odds with what is known, not with the data."""
    if not f.model[-1].cause.scales:
        return False
    return 0.5 * (prior_cost(problem, base.theta, base.model) - prior_cost(problem, f.theta, f.model)) > threshold


def held_out_cost(problem: Problem, f: Fit, under: Fit) -> float:
    """Robust sum of squares of a fit's residual on held-out samples under the noise of another, less the noise's share."""
    kept = [replace(s, usable=s.held_out) for s in problem.segments]
    pairs = [np.stack([a, b], -1) for a, b in zip(f.point.residual, f.point.noise, strict=True)]
    rows = whiten(kept, under.noise, pairs).rows
    return float(np.sum(huber_loss(rows[:, 0], 10.0)) - np.sum(huber_loss(rows[:, 1], 10.0)))


def significance(problem: Problem, f: Fit) -> float:
    """How many of its standard deviations the last effect of a fit is away from absent."""
    h = f.model[-1]
    before = problem.records(f.theta[: len(f.theta) - h.size], f.model[:-1])[0][0]
    absent = h.coordinates(h.cause.centre(before, h.fixed))[h.magnitudes]
    where = len(f.theta) - h.size + np.asarray(h.magnitudes)
    away = f.theta[where] - absent
    return float(np.sqrt(max(away @ np.linalg.solve(f.covariance[np.ix_(where, where)], away), 0.0)))


def _doubtful(problem: Problem, f: Fit, quiet: float, settings: CalibrateSettings) -> bool:
    """Whether a fit may sit in a local minimum: a number that the data know well is near the end of its tolerance."""
    n = problem.calibration.size
    known = np.diag(f.covariance)[:n] < 0.3**2
    return bool(np.any(known & (np.abs(f.theta[:n]) > settings.stuck))) and quiet > settings.unsettled


def afresh(problem: Problem, fitter: Fitter, f: Fit, settings: CalibrateSettings) -> Fit:
    """The same model calibrated anew, its effects as they are: numbers that stood in for an effect let go of it."""
    theta = np.concatenate([np.zeros(problem.size), f.theta[problem.size :]])
    return fitter.fit(f.model, tared(problem, theta, f.model, settings), iterations=settings.iterations)


def hand_over(problem: Problem, theta: np.ndarray, model: Model) -> np.ndarray:
    """The same joint with less strain: what a cause that scales numbers can do better than their tolerances, it does.

    Along that path products stay constant, which is straight to first order only: Gauss–Newton does not find the way.
    """
    theta = theta.copy()
    c, at = problem.calibration, problem.size
    for h in model:
        slots = _scaled(problem, h, theta[: c.size])
        if slots:
            name = h.free[0].name
            x, u = theta[: c.size], theta[at : at + 1]
            now = h.values(u)[name]
            best, chosen = np.inf, None
            for scale in (now, *(now * np.geomspace(0.6, 1.6, 121))):
                shares = _shares(problem, slots, x, now / scale)
                v = h.coordinates({name: scale})
                low, high = h.limits
                if shares is None or not low[0] <= v[0] <= high[0]:
                    continue
                cost = float(sum(y * y for y in shares.values()) + (v[0] / h.spread[0]) ** 2)
                if cost < best - 1e-9:
                    best, chosen = cost, (shares, v)
            if chosen is not None:
                for name, y in chosen[0].items():
                    theta[c.names.index(name)] = y
                theta[at : at + 1] = chosen[1]
        at += h.size
    return theta


def _scaled(problem: Problem, h: Hypothesis, x: np.ndarray) -> list:
    """The numbers with tolerances that a cause of one parameter multiplies; none where it does something else."""
    if not h.cause.scales or len(h.free) != 1 or h.free[0].relative:
        return []
    return [s for s in problem.calibration.slots if s.index < 0 and s.field in h.cause.scales]


def _shares(problem: Problem, slots: list, x: np.ndarray, factor: float) -> dict[str, float] | None:
    """Calibration variables that make the numbers `factor` times what they are at x; None where tolerances end."""
    c, joint = problem.calibration, problem.joint
    ratios = {s.name: factor * c.value(s, x) / s.number.value for s in slots}
    shared = {s.number.shared for s in slots}
    found: dict[str, float] = {}
    common = 1.0
    if shared != {None}:
        if len(shared) != 1:
            return None
        name = shared.pop()
        spread = joint.shared_tolerances[name]
        logs = np.log([ratios[s.name] for s in slots])
        own = np.array([s.number.tolerance for s in slots])
        weight = 1 / np.maximum(own, 1e-6) ** 2
        y = spread * np.sum(weight * logs) / (1 + spread**2 * np.sum(weight))
        found[f"shared {name}"] = float(y)
        common = 1 + spread * y
    for s in slots:
        if s.number.tolerance:
            found[s.name] = (ratios[s.name] / common - 1) / s.number.tolerance
    return found if all(abs(y) <= REACH for y in found.values()) else None
