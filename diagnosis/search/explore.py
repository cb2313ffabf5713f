"""Search for the most probable set of causes by adding, dropping and swapping causes.

A step proposes models one move from the best one. Proposals come from a linear model of all residuals about the best fit
(`screen`); each is fitted through the replay and judged by its log posterior (`posterior`). The search ends when no proposal is
more probable. The models about the best one that are nearly as probable (Occam's window: Madigan and Raftery, 1994) give the
probability of each cause.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations
from typing import Any

import numpy as np

from ..fit.coordinates import Hypothesis
from ..fit.residual import Model, Problem
from ..fit.solver import Fit, Fitter, tamed
from .contribution import alone, magnitudes_at, size_of
from .posterior import EFFECT, Judged, ModelPosterior, quiet_rms, unexplained_size
from .screen import PROBE, Library, Screened, ranked, screen

Progress = Callable[[str, float], None]
"""Called with a stage's name and the share of the work that is done."""


BEAM = 3  # proposals of a kind that are fitted at a step
NEAR = 0.4
"""Part of the best proposal's linear gain that another one must have, and of a cause's gain that its substitute must have: fits
through the replay differ from it by no more."""
STEPS = 12  # after which the search ends in any case
WINDOW = 5.0  # log posterior by which a model may be less probable than the best one and still count
FIT, WHOLE = 4, 6  # iterations of a fit, and of one with a long way to go
COARSE = 0.3  # part of the ordinary size at which causes are probed far from the noise
FAR = 2.0  # noise ratio from which a fit is far from the noise
SWAP = 0.1  # log posterior that a swap must gain: two fits of one model differ by less


@dataclass(frozen=True)
class Decision:
    """A proposal and its result.

    Attributes:
      stage: `add`, `drop` or `swap`.
      cause, fixed: name and whole numbers of the cause that is added, dropped, or replaces another.
      gain: log posterior over that of the best model at that step.
      size: of the cause, in ordinary sizes.
      taken: whether the cause is in the model afterwards.
      reason: in words.
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
    """Result of the search.

    Attributes:
      base: the calibrated joint without causes.
      best: the most probable model.
      models: judged in the last step, the best one first.
      library: derivatives in the other hypotheses near the best.
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
        """Return the probability that a cause is present, and that it is present as an effect and no imperfection.

        It is present, too, where a more general one that includes it is.
        """
        there = float(
            _weights(self.models)
            @ [any(key == h.key or key[0] == h.cause.includes for h in m.fit.model) for m in self.models]
        )
        first = self.models[0]
        return there, there * first.effects[[h.key for h in first.fit.model].index(key)]

    def alike(self) -> list[tuple[str, str]]:
        """Return pairs of causes: one in the best model, the other in its place in a model within the window."""
        most = max(m.score for m in self.models)
        mine = self.best.keys
        found = []
        for m in self.models:
            more, gone = m.keys - mine, mine - m.keys
            if m.score > most - WINDOW and len(more) == len(gone) == 1:
                found.append((next(iter(gone))[0], next(iter(more))[0]))
        return [(a, b) for a, b in found if a != b]


def _weights(models: Sequence[Judged]) -> np.ndarray:
    """Probability of each model; of several fits of the same causes only the most probable counts."""
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
      fitter: of the problem; offered: hypotheses that the measurement can show.
      progress: called at every step; deadline: of `time.monotonic` [s], after which no step begins.
      decisions: so far.
    """

    fitter: Fitter
    offered: Sequence[Hypothesis]
    progress: Progress = lambda stage, done: None
    deadline: float = np.inf
    decisions: list[Decision] = field(default_factory=list)
    _seen: set[frozenset[Any]] = field(default_factory=set)

    @property
    def problem(self) -> Problem:
        """The fitter's problem."""
        return self.fitter.problem

    def posterior(self, best: Fit) -> ModelPosterior:
        """Return the posterior of models about a fit."""
        return ModelPosterior(self.problem, best, max(len({h.cause.name for h in self.offered}), 1))

    def explore(self, base: Fit, start: Fit | None = None) -> Explored:
        """Search from the calibrated joint, or from a model with causes in it."""
        best, models = start or base, list[Judged]()
        for step in range(STEPS):
            self.progress("searching for causes", 0.1 + 0.7 * step / STEPS)
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
            if other.keys == best.keys:
                best = other
                break
            if other.keys in self._seen:
                break  # a cycle of equally probable models
            self._seen.add(other.keys)
            best = self._pruned(self._fit(other.model, other.theta))
        if not models:
            models = [self.posterior(best).judge(best)]
        return Explored(base, best, tuple(models), library, tuple(self.decisions), not late)

    def with_unknown(self, found: Explored, one: Fit) -> Explored | None:
        """Search from a fit with an unknown effect as its last; None if the result is no more probable, or lacks the effect."""
        other = replace(self, _seen=set(), decisions=self.decisions).explore(found.base, one)
        model, theta = other.best.model, other.best.theta
        index = next((i for i, h in enumerate(model) if h is one.model[-1]), None)
        if index is None:
            return None
        place = self.problem.place(model, index)  # the unknown effect is moved to the end
        theta = np.concatenate([theta[: place.start], theta[place.stop :], theta[place]])
        fit = self._fit((*model[:index], *model[index + 1 :], model[index]), theta)
        post = self.posterior(fit)
        if post.judge(fit).score <= post.judge(found.best).score:
            return None
        _, models = self.neighbours(fit, other.library)
        models.append(post.judge(found.best))
        return replace(other, best=fit, models=tuple(models), complete=found.complete)

    def _fit(self, model: Model, theta: np.ndarray, near: Fit | None = None, reference: Fit | None = None) -> Fit:
        return self.fitter.fit(model, theta, near, FIT, reference)

    def _whole(self, post: ModelPosterior, f: Fit, reference: Fit, *known: Any) -> Judged:
        """Fit a model in which calibration has a long way to go, and judge it by what is `known` of its causes."""
        return post.judge(self.fitter.fit(f.model, f.theta, None, WHOLE, reference), *known)

    def _little(self, best: Fit, other: Fit) -> bool:
        """Whether a model is hardly more probable than another."""
        post = self.posterior(other)
        return post.judge(other).score < post.judge(best).score + WINDOW

    def _room(self, best: Fit) -> list[Hypothesis]:
        """Hypotheses that a model can have in addition."""
        have = best.keys
        return self.problem.with_room(best.model, [h for h in self.offered if h.key not in have])

    def library(self, best: Fit) -> Library:
        """Return the library of what a model can have in addition."""
        far = quiet_rms(self.problem, best) > FAR and not best.model
        return Library.at(self.problem, best, self._room(best), COARSE if far else PROBE)

    def _grown(self, best: Fit, library: Library) -> Fit:
        """Add causes one after the other as long as the model becomes more probable."""
        at, left = best, library
        while left.hypotheses and time.monotonic() <= self.deadline:
            post = self.posterior(at)
            now = post.judge(at)
            likely = screen(self.problem, at, left) if at is best else ranked(self.problem, at, left)[:1]
            likely = [x for x in likely if x.gain > max(post.temper, NEAR * likely[0].gain)]
            proposed = []
            for x in likely[:BEAM]:
                theta = np.concatenate([at.theta + x.shift, x.start])
                proposed.append((x, post.judge(self._fit((*at.model, x.hypothesis), theta, at, at))))
            if not proposed:
                return at
            x, top = max(proposed, key=lambda p: p[1].score)
            if now.score - WINDOW < top.score <= now.score + WINDOW:
                top = max(top, self._whole(post, top.fit, at), key=lambda p: p.score)
                proposed = [(y, top if y is x else p) for y, p in proposed]
            for y, p in proposed:
                gain, taken = p.score - now.score, y is x and p.score > now.score
                why = (
                    "less probable"
                    if gain <= 0
                    else "makes the joint most probable"
                    if taken
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
        """Drop causes one after the other as long as the model becomes more probable."""
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
        """Yield models without one of some causes, unless it is clearly needed, and the loss of log likelihood of each."""
        for i in indices:
            less, lost = without(self.problem, linear, i)
            if lost < 4 * WINDOW * post.temper:
                f = self._fit(less.model, less.theta, best, best)
                if np.isfinite(f.log_evidence):
                    yield i, post.judge(f), max(best.log_evidence - f.log_evidence, 0.0)

    def neighbours(self, best: Fit, library: Library) -> tuple[Fit, list[Judged]]:
        """Return the best model without one of the effects or with another cause in its place, and all that were judged.

        If none is better, the best model itself, in a better fit if there is one.
        """
        problem, post = self.problem, self.posterior(best)
        linear = tamed(problem, best)
        effects = post.judge(best).effects
        own = [i for i, effect in enumerate(effects) if effect >= EFFECT]
        dropped = list(self._drops(best, linear, post, own))
        lost = {i: x for i, _, x in dropped}
        close = [(i, j) for i in own for j in range(len(best.model)) if j != i and _correlated(problem, best, i, j)]
        alike = {i: unexplained_size(problem, best, linear, i, effects) for i in own}
        both = {
            (i, j): unexplained_size(problem, best, linear, i, [*effects[:j], 0.0, *effects[j + 1 :]])
            for i, j in combinations(own, 2)
        }
        now = post.judge(best, lost, alike, both)
        models = [now, *(m for _, m, _ in dropped)]
        pairs: list[tuple[int, ...]] = [(i,) for i in own]
        pairs += close
        pairs = list({frozenset(pair): pair for pair in pairs}.values())
        for gone in pairs:
            less, gained = without(problem, linear, *gone)
            left = library.keeping(problem.with_room(less.model, library.hypotheses))
            likeliest: dict[str, Screened] = {}  # of each cause
            for x in ranked(problem, less, left):
                likeliest.setdefault(x.hypothesis.cause.name, x)
            for x in [*likeliest.values()][:2]:
                if x.gain < NEAR * gained:
                    continue
                _, stays, _ = alone(problem, best, *gone)
                near = replace(less, jacobian=[J[..., stays] for J in best.jacobian])
                theta = np.concatenate([less.theta + x.shift, x.start])
                other = post.judge(self._fit((*less.model, x.hypothesis), theta, near, best))
                if now.score - 4 * WINDOW < other.score < now.score + SWAP:
                    other = max(other, self._whole(post, other.fit, best), key=lambda m: m.score)
                models.append(other)
                gain = other.score - now.score
                why = f"in place of {' and '.join(best.model[i].cause.name.replace('_', ' ') for i in gone)}"
                self._decide("swap", x.hypothesis, gain, size_of(problem, other.fit), gain > SWAP, why)
        better = max(models, key=lambda m: m.score)
        if better.score <= now.score + SWAP:
            return best, models
        again = self._whole(post, best, best, lost, alike, both)  # the others were fitted further than the best one
        if better.score > again.score + SWAP or again.score <= now.score:
            return better.fit, models
        return again.fit, [again, *models[1:]]

    def _decide(self, stage: str, h: Hypothesis, gain: float, size: float, taken: bool, reason: str) -> None:
        self.decisions.append(Decision(stage, h.cause.name, h.fixed, float(gain), size, taken, reason))


def _correlated(problem: Problem, f: Fit, i: int, j: int) -> bool:
    """Whether two causes share half of their variance: a third may replace both."""
    a, b = magnitudes_at(problem, f, i), magnitudes_at(problem, f, j)
    spread = np.sqrt(np.diag(f.covariance))
    correlation = f.covariance[np.ix_(a, b)] / spread[a][:, None] / spread[b]
    return bool(np.max(correlation**2) > 0.5)


def without(problem: Problem, best: Fit, *indices: int) -> tuple[Fit, float]:
    """Return a fit without some causes in the linear model, the other unknowns answering, and its loss of log likelihood."""
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
