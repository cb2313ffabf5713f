"""The one search: which set of causes is the most probable, by adding, dropping and swapping causes.

A step proposes models one move away from the best one: with a cause more, without one, with another one in its place. What to
propose is read off a linear model of all residuals about the best fit (`screen`); what is proposed is fitted through the replay
and judged by its log posterior (`posterior`). The search ends where no proposal is more probable; the models about the best one
that are nearly as probable (Occam's window: Madigan and Raftery, 1994) say how sure each cause is.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from ..fit.coordinates import Hypothesis
from ..fit.residual import Model, Problem
from ..fit.solver import Fit, Fitter, tamed
from .posterior import EFFECT, Judged, ModelPosterior, quiet_rms, unexplained_size
from .screen import Library, ranked, screen
from .worth import alone, magnitudes_at, size_of

if TYPE_CHECKING:
    from .discrepancy import Unknown

Progress = Callable[[str, float], None]
"""Called with a stage's name and the share of the work that is done."""


@dataclass(frozen=True)
class ExploreSettings:
    """Settings of the search.

    Attributes:
      beam: proposals of a kind that are fitted at a step.
      near: part of the best proposal's gain in the linear model that another one must have, and of what a cause gains that one in
        its place must: fits through the replay differ from it by no more.
      steps: after which the search ends in any case.
      window: log posterior by which a model may be less probable than the best one and still count.
      whole: iterations of a fit that has a long way to go.
      fine, coarse: part of the ordinary size at which causes are probed, near the noise and far from it.
      far: normalised RMS of the residual from which on a fit is far from the noise.
    """

    beam: int = 3
    near: float = 0.4
    steps: int = 12
    window: float = 5.0
    whole: int = 6
    fine: float = 0.03
    coarse: float = 0.3
    far: float = 2.0


SETTINGS = ExploreSettings()


@dataclass(frozen=True)
class Decision:
    """What became of one proposal.

    Attributes:
      stage: `add`, `drop` or `swap`.
      cause, fixed: name and whole numbers of the cause that is added, dropped, or put in the place of another.
      gain: log posterior of the proposal over that of the best model then.
      size: of the cause, in ordinary sizes.
      taken: whether the cause is in the model afterwards.
      reason: for people.
    """

    stage: str
    cause: str
    fixed: dict[str, float]
    gain: float
    size: float
    taken: bool
    reason: str


@dataclass(frozen=True)
class Explored:
    """What the search found.

    Attributes:
      base: the calibrated joint without causes.
      best: the most probable model.
      models: that were judged in the end, the best one first.
      library: columns of the other hypotheses near the best.
      decisions: about every proposal.
      complete: whether the search ended before time was up.
    """

    base: Fit
    best: Fit
    models: tuple[Judged, ...]
    library: Library
    decisions: tuple[Decision, ...] = ()
    complete: bool = True

    def probabilities(self, key: tuple[Any, ...]) -> tuple[float, float]:
        """Probability that a cause is there, and that it is there as an effect of its own and no imperfection."""
        there = float(sum(w for m, w in zip(self.models, _weights(self.models), strict=True) if key in m.keys))
        first = self.models[0]
        return there, there * first.effects[[h.key for h in first.fit.model].index(key)]

    def alike(self) -> list[tuple[str, str]]:
        """Pairs of causes of which one stands in the best model, and the other in its place in one that still counts."""
        most = max(m.score for m in self.models)
        mine = {h.key for h in self.best.model}
        found = []
        for m in self.models:
            more, gone = m.keys - mine, mine - m.keys
            if m.score > most - SETTINGS.window and len(more) == len(gone) == 1:
                found.append((next(iter(gone))[0], next(iter(more))[0]))
        return [(a, b) for a, b in found if a != b]


def _weights(models: Sequence[Judged]) -> np.ndarray:
    """Probability of each model; of several fits of the same causes the most probable alone counts."""
    score = np.array([m.score for m in models])
    first: dict[frozenset[Any], int] = {}
    for i in np.argsort(-score):
        first.setdefault(models[i].keys, int(i))
    counts = np.isin(np.arange(len(models)), list(first.values()))
    w = np.where(counts, np.exp(score - score.max()), 0.0)
    return w / w.sum()


@dataclass
class Explorer:
    """The search over one problem.

    Attributes:
      fitter: of the problem. offered: hypotheses that the measurement can show.
      progress: told what is done; deadline: of `time.monotonic` [s], after which no step begins.
      decisions: so far.
    """

    fitter: Fitter
    offered: Sequence[Hypothesis]
    settings: ExploreSettings = SETTINGS
    progress: Progress = lambda stage, done: None
    deadline: float = np.inf
    decisions: list[Decision] = field(default_factory=list)
    _seen: set[frozenset[Any]] = field(default_factory=set)

    @property
    def problem(self) -> Problem:
        """Of the fitter."""
        return self.fitter.problem

    def posterior(self, best: Fit) -> ModelPosterior:
        """Of models about a fit."""
        return ModelPosterior(self.problem, best, max(len({h.cause.name for h in self.offered}), 1))

    def explore(self, base: Fit, start: Fit | None = None) -> Explored:
        """Search from the calibrated joint, or from a model with causes in it."""
        best, models = start or base, list[Judged]()
        for step in range(self.settings.steps):
            self.progress("searching for causes", 0.1 + 0.7 * step / self.settings.steps)
            library = self.library(best)
            if late := time.monotonic() > self.deadline:
                break
            other = self._grown(best, library)
            if other is not best and not self._little(best, other):
                models = []
            else:
                if other is not best:
                    best = self._pruned(other)
                other, models = self.neighbours(best, library.keeping(self._room(best)))
            if other is best or (keys := frozenset(h.key for h in other.model)) in self._seen:
                break  # or back where it was: between models that are as probable
            self._seen.add(keys)
            best = self._pruned(self._fit(other.model, other.theta))
        if not models:
            models = [self.posterior(best).judge(best)]
        return Explored(base, best, tuple(models), library, tuple(self.decisions), not late)

    def beside(self, found: Explored, unknown: Unknown) -> tuple[Explored, Unknown | None]:
        """What the search finds from an unknown effect on; what was found where that is not more probable."""
        other = replace(self, _seen=set(), decisions=self.decisions).explore(found.base, unknown.fit)
        problem, best = self.problem, other.best
        last = [h for h in best.model if h is unknown.spline]
        if not last:
            return found, None
        order = [i for i, h in enumerate(best.model) if h is not last[0]]
        order.append(best.model.index(last[0]))
        parts = problem.split(best.theta, best.model)
        theta = np.concatenate([best.theta[: problem.size], *(parts[i] for i in order)])
        fit = self._fit(tuple(best.model[i] for i in order), theta)  # the unknown effect last
        post = self.posterior(fit)
        if post.judge(fit).score <= post.judge(found.best).score:
            return found, None
        _, models = self.neighbours(fit, other.library)
        models.append(post.judge(found.best))
        return replace(other, best=fit, models=tuple(models), complete=found.complete), replace(unknown, fit=fit)

    def _fit(self, model: Model, theta: np.ndarray, near: Fit | None = None, beside: Fit | None = None) -> Fit:
        """A model fitted through the replay: with derivatives near by and the noise of another, or with its own."""
        return self.fitter.fit(model, theta, near, 4, beside)

    def _whole(self, post: ModelPosterior, f: Fit, beside: Fit) -> Judged:
        """A model fitted to its end: where calibration has a long way back, a few steps do not get there."""
        return post.judge(self.fitter.fit(f.model, f.theta, None, self.settings.whole, beside))

    def _little(self, best: Fit, other: Fit) -> bool:
        """Whether a model is so little more probable that nothing else would be seen from there."""
        post = self.posterior(other)
        return post.judge(other).score < post.judge(best).score + self.settings.window

    def _room(self, best: Fit) -> list[Hypothesis]:
        have = {h.key for h in best.model}
        return self.problem.with_room(best.model, [h for h in self.offered if h.key not in have])

    def library(self, best: Fit) -> Library:
        """Columns of every hypothesis that the best model has not, and for which there is room."""
        left = self._room(best)
        far = quiet_rms(self.problem, best) > self.settings.far and not best.model
        return Library(self.problem, best, left, self.settings.coarse if far else self.settings.fine)

    def _grown(self, best: Fit, library: Library) -> Fit:
        """With every cause more that makes it more probable, one after the other; the same where there is none."""
        at, left = best, library
        while left.hypotheses and time.monotonic() <= self.deadline:
            post = self.posterior(at)
            now = post.judge(at)
            likely = screen(self.problem, at, left) if at is best else ranked(self.problem, at, left)[:1]
            likely = [x for x in likely if x.gain > max(post.temper, self.settings.near * likely[0].gain)]
            proposed = []
            for x in likely[: self.settings.beam]:
                theta = np.concatenate([at.theta + x.shift, x.start])
                proposed.append((x, post.judge(self._fit((*at.model, x.hypothesis), theta, at, at))))
            if not proposed:
                return at
            x, top = max(proposed, key=lambda p: p[1].score)
            if now.score - self.settings.window < top.score <= now.score + self.settings.window:
                top = max(top, self._whole(post, top.fit, at), key=lambda p: p.score)
                proposed = [(y, top if y is x else p) for y, p in proposed]
            for y, p in proposed:
                gain, taken = p.score - now.score, y is x and p.score > now.score
                why = (
                    "makes the joint most probable"
                    if taken
                    else "less probable"
                    if gain <= 0
                    else "another is likelier"
                )
                self._decide("add", y.hypothesis, gain, size_of(self.problem, p.fit), taken, why)
            if top.score <= now.score:
                return at
            at = top.fit
            left = left.keeping(
                self.problem.with_room(at.model, [h for h in left.hypotheses if h.key != x.hypothesis.key])
            )
        return at

    def _pruned(self, best: Fit) -> Fit:
        """Without causes that are no longer needed."""
        while best.model:
            post = self.posterior(best)
            now = post.judge(best)
            dropped = [(i, m) for i, m, _ in self._drops(best, best, post, range(len(best.model)))]
            i, found = max(dropped, key=lambda d: d[1].score, default=(0, now))
            if found.score <= now.score:
                return best
            gain = found.score - now.score
            self._decide("drop", best.model[i], gain, size_of(self.problem, best, i), False, "more probable without it")
            best = self._fit(found.fit.model, found.fit.theta)
        return best

    def _drops(
        self, best: Fit, linear: Fit, post: ModelPosterior, indices: Iterable[int]
    ) -> Iterable[tuple[int, Judged, float]]:
        """Models without one of some causes, of those that are not plainly needed, and the log likelihood that each loses."""
        for i in indices:
            less, lost = _without(self.problem, linear, i)
            if lost < 4 * self.settings.window * post.temper:
                f = self._fit(less.model, less.theta, best, best)
                if np.isfinite(f.log_evidence):
                    yield i, post.judge(f), max(best.log_evidence - f.log_evidence, 0.0)

    def neighbours(self, best: Fit, library: Library) -> tuple[Fit, list[Judged]]:
        """The best of all models without one of the effects or with another cause in its place, and all that were judged."""
        problem, post = self.problem, self.posterior(best)
        linear = tamed(problem, best)
        effects = post.judge(best).effects
        own = [i for i, effect in enumerate(effects) if effect >= EFFECT]
        dropped = list(self._drops(best, linear, post, own))
        lost = {i: x for i, _, x in dropped}
        now = post.judge(best, lost, {i: unexplained_size(problem, best, linear, i, effects) for i in own})
        models = [now, *(m for _, m, _ in dropped)]
        pairs: list[tuple[int, ...]] = [(i,) for i in own]
        pairs += [(i, j) for i in own for j in range(len(best.model)) if j != i and _correlated(problem, best, i, j)]
        pairs = list({frozenset(pair): pair for pair in pairs}.values())
        for gone in pairs:
            less, gained = _without(problem, linear, *gone)
            left = library.keeping(problem.with_room(less.model, library.hypotheses))
            for x in ranked(problem, less, left)[:2]:
                if x.gain < self.settings.near * gained:
                    continue
                _, stays, _ = alone(problem, best, *gone)
                near = replace(less, jacobian=[J[..., stays] for J in best.jacobian])
                theta = np.concatenate([less.theta + x.shift, x.start])
                other = post.judge(self._fit((*less.model, x.hypothesis), theta, near, best))
                if now.score - 4 * self.settings.window < other.score < now.score + _MORE:
                    other = max(other, self._whole(post, other.fit, best), key=lambda m: m.score)
                models.append(other)
                gain = other.score - now.score
                why = f"in the place of {' and '.join(best.model[i].cause.name.replace('_', ' ') for i in gone)}"
                self._decide("swap", x.hypothesis, gain, size_of(problem, other.fit), gain > _MORE, why)
        better = max(models, key=lambda m: m.score)
        return (better.fit if better.score > now.score + _MORE else best), models

    def _decide(self, stage: str, h: Hypothesis, gain: float, size: float, taken: bool, reason: str) -> None:
        self.decisions.append(Decision(stage, h.cause.name, h.fixed, float(gain), size, taken, reason))


_MORE = 0.1
"""Log posterior by which a swap must be more probable: less is what two fits of one model differ by."""


def _correlated(problem: Problem, f: Fit, i: int, j: int) -> bool:
    """Whether of two causes the one is half of what it is because the other is there: a third may stand for both."""
    a, b = magnitudes_at(problem, f, i), magnitudes_at(problem, f, j)
    spread = np.sqrt(np.diag(f.covariance))
    correlation = f.covariance[np.ix_(a, b)] / spread[a][:, None] / spread[b]
    return bool(np.max(correlation**2) > 0.5)


def _without(problem: Problem, best: Fit, *indices: int) -> tuple[Fit, float]:
    """A fit without some of its causes, in the linear model: the other unknowns answer. And the log likelihood that it loses."""
    where, keep, u = alone(problem, best, *indices)
    V = best.covariance
    pull = np.linalg.solve(V[np.ix_(where, where)], u)
    step = -V[np.ix_(keep, where)] @ pull
    residual = [
        r + J[..., keep] @ step - J[..., where] @ u
        for r, J in zip(best.point.residual, best.jacobian, strict=True)
    ]  # fmt: skip
    less = replace(
        best, model=tuple(g for j, g in enumerate(best.model) if j not in indices), theta=best.theta[keep] + step,
        point=replace(best.point, residual=residual), jacobian=[J[..., keep] for J in best.jacobian],
        covariance=V[np.ix_(keep, keep)],
    )  # fmt: skip
    return less, float(0.5 * u @ pull)
