"""When an effect is accepted: settings, what is told of every hypothesis, and what a fit says of one of its effects."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.special import gammaincc

from ..fit.noise import normalised_rms, whiten
from ..fit.residual import Problem
from ..fit.solver import Columns, Fit, huber_loss
from .worth import Worth, instead, mean_squares, unexplained, worth

MORE_THAN_NOISE = 1.25
"""Residual over the sensors' noise (RMS) from which on more than noise is left: sound joints have 1.00, real ones 1.5 or more."""


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
        there is decided by `worth` again, but for one that alone is left, of which `worth_large` is asked.
      chance: part of the sensors' noise (mean square) by which what two fits leave may differ by chance.
      alike: part of the mean square that a cause takes away that another one must take away to be its rival.
      same: part of the root mean square of what is worth most that another one must be worth, for the likelier to come first.
      drowned: times what nothing explains that all of what a number makes must be, for an effect that scales it: of a signal that
        is buried in errors, least squares finds a part.
      slight: part of the root mean square of what nothing explains that it must be worth, where that is not far above the noise
        (where it is, something is there that the library does not have).
      little: part of the mean square of what is not explained that a cause must take away, for another one to be fitted after it;
        where the best takes less and the residual is more than `plain` times the sensors' noise, further hypotheses are fitted.
      held_out_share: of what it gains on the data of the fit, it must gain so much on as many held-out data.
      race: rivals that are worth more than this part of the best are fitted to the end.
      finalists: hypotheses fitted in the first round; far_finalists: where the residual is more than `far` times the sensors'
        noise and the linear model no good judge; per_cause: at most of one cause.
      general: log evidence that a more general cause must add to a special case of it, under one noise, times the residual over
        the sensors' noise, `loosest` at most; temper: by how much of it less makes the special one e times as likely;
        temper_general: by how much of it more, once more times that residual, the general one. By draws: of a load-dependent
        friction and a back-driving with imperfections, 24 (seeds 561 and 562), three were taken for the other.
      bent: largest confidence of what is not in every combination that plainly leaves no more, where a number that the data know
        well stands at the end of its tolerance.
      unlikely: probability of a combination of causes, over that of the likeliest, from which on it may stand in its place.
      edge: standard deviations of its tolerance within which an effect's value is near its edge: whether the joint at the edge
        would do is then asked of fits without the noise's share (`_at_the_edge`), of `polish` iterations.
      lost: ratio of mean squares of what is not explained, without an effect and with it, from which on a few steps may have gone
        astray, or slow discrepancy holds what the numbers would: it is then fitted both ways, to the end.
      most: causes at once; rounds: of them fitted through the replay before the others are selected in the linear model;
        rounds_again: selections after one from which a cause of `large` size was taken back, or that left a number in doubt.
      close: part of a cause's gain that a rival must have gained for both to be compared again beside all other causes;
        contested: part of its ordinary size from which on a cause is.
      again: normalised RMS against the sensors' noise, left at the end, from which on the search is done once more: as long as
        `far_again` is left through the replay, and of causes that hold the likeliest first, not the one that is worth most
        (`likeliest`), in so many rounds at most (`rounds_likeliest`). Imperfections of joints leave 1.5 to 3.2.
      cancelling: part of what orders of one law of the link's angle vary each that they vary together, below which they cancel
        each other over the angles that were visited: 1 to 15 % where they stood for another friction.
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
    chance: float = 0.1
    alike: float = 0.3
    same: float = 0.7
    drowned: float = 2.0
    slight: float = 0.25
    little: float = 0.1
    plain: float = MORE_THAN_NOISE
    held_out_share: float = 0.2
    race: float = 0.6
    finalists: int = 3
    far_finalists: int = 6
    far: float = 10.0
    per_cause: int = 2
    general: float = 8.0
    temper: float = 4.0
    temper_general: float = 12.0
    loosest: float = 5.0
    bent: float = 0.7
    unlikely: float = 0.05
    edge: float = 6.0
    polish: int = 8
    lost: float = 2.25
    most: int = 5
    rounds: int = 3
    rounds_again: int = 1
    close: float = 0.5
    contested: float = 0.12
    again: float = 5.0
    far_again: float = 3.0
    likeliest: bool = False
    rounds_likeliest: int = 4
    cancelling: float = 0.3
    gross: float = 60.0
    coarse: tuple[float, ...] = (-1.5, -0.7, 0.4, 0.7, 1.0, 1.5)

    def likeliest_first(self) -> AcceptSettings:
        """The same for the search that is done once more."""
        return replace(self, likeliest=True, far=self.far_again, far_finalists=4, rounds=self.rounds_likeliest)


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


def significance(problem: Problem, f: Fit, index: int = -1) -> float:
    """How many of its standard deviations one of a fit's effects is away from absent."""
    h = f.model[index]
    block = problem.place(f.model, index % len(f.model))
    where = block.start + np.asarray(h.magnitudes)
    away = amount_of(problem, f, index)[h.magnitudes]
    return float(np.sqrt(max(float(away @ np.linalg.solve(f.covariance[np.ix_(where, where)], away)), 0.0)))


def plainly_more(left: float, noise: float, settings: AcceptSettings) -> float:
    """Mean square [N·m]² from which on a fit plainly leaves more of the simulation's error than another, which leaves `left` with
    so much of the sensors' noise in it."""
    return (1 + settings.worth) * left + settings.chance * noise


def much_more(left: float, noise: float, settings: AcceptSettings) -> float:
    """The same from which on it leaves several times more, as where it lacks something or ended too early."""
    return settings.lost * left + settings.chance * noise


def by_chance(away: float, dimensions: int, looked_at: int) -> float:
    """Probability that the largest of so many effects is that far from absent by chance, at most (Bonferroni's bound).

    Args:
      away: standard deviations from absent, over all of an effect's coordinates that vanish with it.
      dimensions: how many these are: an amplitude with a phase has two.
    """
    return float(min(looked_at * gammaincc(0.5 * dimensions, 0.5 * away**2), 1.0))


def drowned(problem: Problem, f: Fit, index: int, settings: AcceptSettings) -> str:
    """Why a number that one of a fit's effects scales cannot be told: all of what it makes is hardly more than what nothing
    explains, in every balance (regression dilution by what no replicate of the noise knows). Empty where it is not so."""
    h, block = f.model[index], problem.place(f.model, index)
    fields = {s.field for s in problem.calibration.slots}
    if len(h.free) != 1 or not fields & {*h.cause.scales, *h.cause.sets.values()}:
        return ""
    whole = f.theta[block] - h.coordinates({h.free[0].name: 0.0})
    if np.allclose(whole, amount_of(problem, f, index)):  # the number is nothing without the effect
        return ""
    made = mean_squares(problem, [J[..., block] @ whole for J in f.jacobian])
    left = unexplained(problem, f.point)
    if np.any(made > settings.drowned**2 * left):
        return ""
    return f"all of what it scales is {made.sum() ** 0.5:.2g} N·m RMS, and {left.sum() ** 0.5:.2g} is left that nothing explains"


def held_out_cost(problem: Problem, f: Fit, under: Fit) -> float:
    """Minus twice the log likelihood of held-out residuals of a fit, under the noise of another, less the noise's share."""
    kept = [replace(s, usable=s.held_out) for s in problem.segments]
    white = whiten(kept, under.noise, f.point.residual, f.point.noise)
    rows = white.rows
    return float(np.sum(huber_loss(rows[:, 0], 10.0)) - np.sum(huber_loss(rows[:, 1], 10.0))) + white.log_determinant


def worth_of(problem: Problem, f: Fit, linear: Fit, *indices: int) -> Worth:
    """What one of a fit's effects is worth, or several together; `linear`: the fit with `solver.tamed` derivatives."""
    columns = linear.jacobian
    for index in indices:
        columns = _as_without(problem, f, columns, index)
    return worth(problem, f, columns, *alone(problem, f, *indices))


def made_by(problem: Problem, f: Fit, linear: Fit, index: int) -> np.ndarray:
    """Mean squares of what one of a fit's effects makes while no other unknown answers, by balance [N·m]²."""
    own, _, amount = alone(problem, f, index)
    return mean_squares(problem, [J[..., own] @ amount for J in linear.jacobian])


def without_it(problem: Problem, f: Fit, linear: Fit, index: int) -> Fit:
    """A fit as it would be without one of its effects, in the linear model: the other unknowns do what they can instead. It has
    the linear model's derivatives."""
    effect, others, amount = alone(problem, f, index)
    step = instead(problem, f, _as_without(problem, f, linear.jacobian, index), effect, others, amount)
    model = tuple(g for j, g in enumerate(f.model) if j != index)
    return replace(
        f, model=model, theta=f.theta[others] + step, jacobian=[J[..., others] for J in linear.jacobian],
        covariance=f.covariance[np.ix_(others, others)],
    )  # fmt: skip


def _as_without(problem: Problem, f: Fit, columns: Columns, index: int) -> Columns:
    """Derivatives of a fit, those in the joint's numbers as they are without one of its effects: a number that it multiplies by
    2.3 moves with its tolerance 2.3 times as much beside it as in its place."""
    h, calibration = f.model[index], problem.calibration
    if not h.cause.scales:
        return columns
    factor = h.values(problem.split(f.theta, f.model)[index])[h.cause.parameters[0].name]
    moved: dict[str, set[str]] = {}
    for slot in calibration.slots:
        for name in (slot.name, f"shared {slot.number.shared}"):
            moved.setdefault(name, set()).add(slot.field)
    scaled = [j for j, name in enumerate(calibration.names) if moved.get(name, {""}) <= set(h.cause.scales)]
    weight = np.ones(columns[0].shape[-1])
    weight[scaled] = 1.0 / max(factor, 1e-3)
    return [c * weight for c in columns]


def alone(problem: Problem, f: Fit, *indices: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Places of some of a fit's effects and of all other unknowns, and these effects' coordinates from absent."""
    blocks = [problem.place(f.model, i) for i in indices]
    magnitudes = [np.asarray(f.model[i].magnitudes) for i in indices]
    own = np.concatenate([block.start + m for block, m in zip(blocks, magnitudes, strict=True)])
    amounts = np.concatenate([amount_of(problem, f, i)[m] for i, m in zip(indices, magnitudes, strict=True)])
    inside = np.concatenate([np.arange(block.start, block.stop) for block in blocks])
    return own, np.setdiff1d(np.arange(len(f.theta)), inside), amounts
