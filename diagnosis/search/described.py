"""What the data say of a joint that is just as it is described: for measurements that calibration explains away.

A short measurement knows little, and what is not known of stiffness, inertia and friction then stands in for any effect on
the way, and for nothing beyond it. Here all numbers but the zeros of encoder and torque sensor stay as described, nothing slow is
taken for model discrepancy, and a cause is accepted where it explains most of what is left, makes no balance worse, holds on
regions that its fit has not seen, and no other cause does so as well.

Beside the first, causes are tried alone and in pairs: gravity that pulls from elsewhere and friction that grows with the load
explain little one without the other. Of explanations between which the evidence does not decide, the one with the fewest numbers
is taken, if most of them have one of its causes; how many have a cause is how sure it is.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...models.causes import Cause
from ..fit.coordinates import Hypothesis
from ..fit.noise import EVEN
from ..fit.regions import Region, held_out_regions, mean_ratio
from ..fit.residual import Problem
from ..fit.solver import Fit, Fitter, with_dispersion
from ..fit.tare import described, tared
from .acceptance import Decision, Rivals, quiet_rms, significance, size_of
from .finalists import Finalist, as_finalist, finalists_of, rivals_of
from .screen import Library, screen
from .select import others_than
from .stages import SETTINGS, Search, SearchSettings
from .worth import unexplained


@dataclass(frozen=True)
class DescribedSettings:
    """When a cause is accepted.

    Attributes:
      removes: part of the mean square that is not explained that it must take away.
      worse: ratio of the mean square of one balance from which on it is worse there.
      mean, worst: geometric mean over regions, and largest, of the ratio of errors (`regions.Region.ratio`) up to which it holds
        where its fit has not been.
      alike: ratio of these means up to which another cause that holds is as good: then neither is accepted.
      beside: part of the mean square that causes beside the first must take away; mean_beside: as `mean`, of errors with them
        over errors with the first alone.
      margin: part of what an explanation adds to the log evidence by which others must differ from it to be told apart.
      finalists: causes that are fitted at each step, which costs little where nothing else moves.
    """

    removes: float = 0.5
    worse: float = 1.1
    mean: float = 0.75
    worst: float = 1.5
    alike: float = 1.5
    beside: float = 0.3
    mean_beside: float = 0.95
    margin: float = 0.05
    finalists: int = 8


DESCRIBED = DescribedSettings()


def as_described(
    problem: Problem,
    hypotheses: Sequence[Hypothesis],
    settings: SearchSettings = SETTINGS,
    accept: DescribedSettings = DESCRIBED,
) -> Search | None:
    """Causes that hold with all numbers as described; None where there are none.

    Args:
      problem: in which only zeros may move (`Problem.as_described`).
    """
    fitter = Fitter(problem, noise=EVEN)
    start = tared(problem, problem.start(None, ()), ())
    first = fitter.fit((), start, iterations=settings.calibrate.iterations)
    library = Library(problem, first, hypotheses, settings.screen.coarse_probe)
    one = _first(fitter, first, library, settings, accept)
    if one.chosen is None:
        return None
    library = Library(
        problem, one.chosen, others_than(problem, hypotheses, one.chosen.model), settings.screen.coarse_probe
    )
    more = _beside(fitter, one.chosen, library, hypotheses, settings, accept)
    at = more.chosen or one.chosen
    if more.chosen is not None:
        library = Library(problem, at, others_than(problem, hypotheses, at.model), settings.screen.coarse_probe)
    return Search(
        first,
        at,
        library,
        (*one.rivals, *more.rivals),
        (*one.decisions, *more.decisions),
        (quiet_rms(problem, first), quiet_rms(problem, at)),
        confusable=(*one.confusable, *more.confusable),
    )


@dataclass(frozen=True)
class _Step:
    """What a step came to: the fit with what was accepted, if anything was; its rivals; pairs that cannot be told apart."""

    chosen: Fit | None
    rivals: tuple[Rivals, ...]
    decisions: tuple[Decision, ...]
    confusable: tuple[tuple[str, str], ...] = ()


def _first(fitter: Fitter, base: Fit, library: Library, settings: SearchSettings, accept: DescribedSettings) -> _Step:
    """The first cause: it alone must explain most, and no other may hold as well."""
    problem = fitter.problem
    before = described(problem)
    decisions: list[Decision] = []
    good: list[tuple[float, Finalist, Fit]] = []
    for f in finalists_of(fitter, base, screen(problem, base, library, settings.screen), settings.accept):
        found = fitter.fit(f.fit.model, f.fit.theta, None, settings.calibrate.iterations)
        regions = held_out_regions(problem, found, described=before)
        reason = _objection(problem, base, found, f.gain, regions, settings, accept)
        if not reason:
            good.append((mean_ratio(regions), f, found))
        decisions.append(_decision(problem, f, found, reason or "holds also where its fit has not been"))
    if not good:
        return _Step(None, (), tuple(decisions))
    mean, chosen, found = min(good, key=lambda one: one[0])
    alike = [f for other, f, _ in good if f.name != chosen.name and other < accept.alike * mean]
    if alike:
        # Each would say something else of motion that nobody has seen.
        names = ", ".join(f.name.replace("_", " ") for f in alike)
        decisions.append(_decision(problem, chosen, found, f"cannot be told from {names}"))
        return _Step(None, (), tuple(decisions), tuple((chosen.name, f.name) for f in alike))
    away = significance(problem, with_dispersion(problem, found))
    if away < settings.accept.significant:
        told = f"{away:.1f} standard deviations from absent, must be {settings.accept.significant:g}"
        decisions.append(_decision(problem, chosen, found, told))
        return _Step(None, (), tuple(decisions))
    told = f"takes {_rms(chosen):.2g} N·m RMS from the simulation's error, also where its fit has not been"
    decisions.append(_decision(problem, chosen, found, told, True))
    rivals = rivals_of(chosen, {f.name: f.gain for _, f, _ in good}, {}, settings.accept)
    return _Step(found, (rivals,), tuple(decisions))


@dataclass(frozen=True)
class _Explanation:
    """One or two causes beside the first.

    Attributes:
      found: a fit with them; effects: they themselves.
      alone: log evidence that the best of two adds alone.
      numbers: that they set free; numbers of the description that a cause changes count as one more, since here those hold.
    """

    found: Finalist
    effects: tuple[Hypothesis, ...]
    alone: float
    numbers: int

    @property
    def fit(self) -> Fit:
        """The fit with them."""
        return self.found.fit

    @property
    def gain(self) -> float:
        """Log evidence that they add."""
        return self.found.gain

    @property
    def rms(self) -> float:
        """Root mean square that they take from the simulation's error [N·m]."""
        return _rms(self.found)

    @property
    def names(self) -> tuple[str, ...]:
        """The causes' names."""
        return tuple(h.cause.name for h in self.effects)

    def has(self, cause: Cause) -> bool:
        """Whether a cause is among them, itself, as a special case of one or more general than one."""
        return any(
            h.cause.name == cause.name or cause.name in h.cause.generalises or h.cause.name in cause.generalises
            for h in self.effects
        )


def _beside(
    fitter: Fitter,
    base: Fit,
    library: Library,
    hypotheses: Sequence[Hypothesis],
    settings: SearchSettings,
    accept: DescribedSettings,
) -> _Step:
    """Causes beside the first: of explanations between which the evidence does not decide, the one with the fewest numbers."""
    problem = fitter.problem
    wide = replace(settings.accept, finalists=accept.finalists, far_finalists=accept.finalists)
    found = _explanations(fitter, base, library, hypotheses, replace(settings, accept=wide))
    decisions: list[Decision] = []
    near: list[_Explanation] = []
    for e in sorted(found, key=lambda e: -e.gain):
        if near and e.gain < near[0].gain - _margin(near[0].gain, settings, accept):
            reason = f"adds {near[0].gain - e.gain:.0f} less to the log evidence than {_told(near[0].names)}"
        else:
            reason = _objection_beside(problem, base, e, settings, accept)
            near += [] if reason else [e]
        decisions += _decisions(problem, e, reason or "holds also where its fit has not been")
    if not near:
        return _Step(None, (), tuple(decisions))
    chosen = min(near, key=lambda e: (e.numbers, -e.gain))
    others = sorted({n for e in near for n in e.names} - set(chosen.names))
    share = [float(np.mean([e.has(h.cause) for e in near])) for h in chosen.effects]
    if max(share) <= 0.5:
        told = f"cannot be told from {_told(others)}"
        alike = tuple((name, other) for name in chosen.names for other in others)
        return _Step(None, (), (*decisions, *_decisions(problem, chosen, told)), alike)
    rivals: list[Rivals] = []
    pairs: list[tuple[str, str]] = []
    for h, part in zip(chosen.effects, share, strict=True):
        rivals.append(Rivals(h.cause.name, max(e.gain for e in near if e.has(h.cause)), (), part))
        instead = [n for e in near if h.cause.name not in e.names for n in e.names if n not in chosen.names]
        pairs += [(h.cause.name, n) for n in dict.fromkeys(instead)]
    told = (
        f"{_told(chosen.names)}: {chosen.rms:.2g} N·m RMS of the simulation's error, also where their fit has not been"
    )
    return _Step(chosen.fit, tuple(rivals), (*decisions, *_decisions(problem, chosen, told, True)), tuple(pairs))


def _explanations(
    fitter: Fitter,
    base: Fit,
    library: Library,
    hypotheses: Sequence[Hypothesis],
    settings: SearchSettings,
) -> list[_Explanation]:
    """Causes beside those of a fit, alone and in pairs, with derivatives of their own."""
    problem = fitter.problem
    screened = screen(problem, base, library, settings.screen)
    alone = {s.hypothesis.key: s.gain for s in screened}
    singles: list[_Explanation] = []
    for f in finalists_of(fitter, base, screened, settings.accept):
        fit = fitter.fit(f.fit.model, f.fit.theta, None, settings.calibrate.iterations)
        found = as_finalist(problem, base, fit)
        alone[fit.model[-1].key] = found.gain
        singles.append(_Explanation(found, fit.model[-1:], 0.0, _numbers(problem, fit.model[-1:])))
    pairs: dict[frozenset[tuple], _Explanation] = {}
    for one in singles:
        rest = Library(problem, one.fit, others_than(problem, hypotheses, one.fit.model), settings.screen.coarse_probe)
        for g in finalists_of(fitter, one.fit, screen(problem, one.fit, rest, settings.screen), settings.accept):
            effects = g.fit.model[-2:]
            key = frozenset(h.key for h in effects)
            if key not in pairs:
                fit = fitter.fit(g.fit.model, g.fit.theta, None, settings.calibrate.iterations)
                best = max(alone.get(h.key, 0.0) for h in effects)
                pairs[key] = _Explanation(as_finalist(problem, base, fit), effects, best, _numbers(problem, effects))
    return [*singles, *pairs.values()]


def _numbers(problem: Problem, effects: Sequence[Hypothesis]) -> int:
    """Numbers that effects set free, and one more for each that changes a number of the description."""
    free, before = 0, problem.calibration.record(np.zeros(problem.calibration.size), problem.mountings[0])[0]
    for h in effects:
        after = before.copy()
        h.cause.apply(after, h.values(np.full(h.size, 0.5)))
        free += h.size + any(np.any((before[n] != 0) & (before[n] != after[n])) for n in before.dtype.names or ())
    return free


def _margin(gain: float, settings: SearchSettings, accept: DescribedSettings) -> float:
    """Log evidence by which explanations must differ to be told apart."""
    return max(settings.accept.threshold, accept.margin * gain)


def _objection_beside(
    problem: Problem, base: Fit, e: _Explanation, settings: SearchSettings, accept: DescribedSettings
) -> str:
    """Why an explanation beside the first cause is not accepted; empty where it is."""
    needed = _margin(e.gain, settings, accept)
    if e.gain < e.alone + needed:
        return f"adds {e.gain - e.alone:.1f} to the log evidence of one of them alone, needs {needed:.1f}"
    if reason := _takes_too_little(problem, base, e.fit, accept.beside, accept):
        return reason
    regions = held_out_regions(problem, e.fit, described=base.point.residual)
    if not regions:
        return "too little motion to keep a region of it from the fit"
    worst, mean = max(r.ratio for r in regions), mean_ratio(regions)
    if worst > accept.worst or mean > accept.mean_beside:
        return (
            f"has up to {worst:.1f} times the error without it where its fit has not been, {mean:.2f} times in the mean"
        )
    return ""


def _told(names: Sequence[str]) -> str:
    return " and ".join(name.replace("_", " ") for name in names)


def _decisions(problem: Problem, e: _Explanation, reason: str, taken: bool = False) -> list[Decision]:
    """One decision for each cause of an explanation."""
    n = len(e.fit.model)
    beside = f"with {_told(e.names)}: " if len(e.effects) > 1 and not taken else ""
    return [
        Decision(
            "described", h.cause.name, h.fixed, e.gain, e.rms, size_of(problem, e.fit, n - len(e.effects) + i), True, taken,
            beside + reason,
        )
        for i, h in enumerate(e.effects)
    ]  # fmt: skip


def _decision(problem: Problem, f: Finalist, found: Fit, reason: str, taken: bool = False) -> Decision:
    return Decision(
        "described", f.name, found.model[-1].fixed, f.gain, _rms(f), size_of(problem, found), True, taken, reason
    )


def _objection(
    problem: Problem,
    base: Fit,
    f: Fit,
    gain: float,
    regions: Sequence[Region],
    settings: SearchSettings,
    accept: DescribedSettings,
) -> str:
    """Why a cause is not accepted; empty where it is."""
    if gain < settings.accept.threshold:
        return f"adds {gain:.1f} to the log evidence, needs {settings.accept.threshold:g}"
    if reason := _takes_too_little(problem, base, f, accept.removes, accept):
        return reason
    if not regions:
        return "too little motion to keep a region of it from the fit"
    worst = max(r.ratio for r in regions)
    if worst > accept.worst or mean_ratio(regions) > accept.mean:
        return f"has up to {worst:.1f} times the description's error where its fit has not been"
    return ""


def _takes_too_little(problem: Problem, base: Fit, f: Fit, least: float, accept: DescribedSettings) -> str:
    """Whether a fit takes less than a part of the mean square that is not explained, or makes one balance worse; empty if not."""
    before, after = unexplained(problem, base.point), unexplained(problem, f.point)
    if after.sum() > (1 - least) * before.sum():
        return f"takes {100 * (1 - after.sum() / before.sum()):.0f} % of the mean square, must take {100 * least:.0f} %"
    if np.any(after > accept.worse * before + 0.01 * before.sum()):
        return "makes another balance worse"
    return ""


def _rms(f: Finalist) -> float:
    """Root mean square that a fit takes from the simulation's error [N·m]."""
    return float(np.sqrt(max(f.removed, 0.0)))
