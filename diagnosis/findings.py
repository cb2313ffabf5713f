"""What was found, cause by cause: what each is worth, how sure it is, and what it cannot be told apart from."""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from ..models import causes
from ..models.recording import Measurement
from .answer import Finding, ParameterEstimate
from .conclusion import ANSWER, Conclusion
from .data.segments import BALANCES
from .extension import extended
from .fit.coordinates import Hypothesis
from .fit.residual import Problem
from .fit.solver import Fit, normal_equations, tamed
from .improvement import removed
from .search import discrepancy
from .search.acceptance import by_chance, made_by, quiet_rms, significance, size_of, without_it, worth_of
from .search.discrepancy import Unknown
from .search.stages import Search
from .search.worth import Worth, left_by, noise_of


def findings_of(
    conclusion: Conclusion, measurement: Measurement
) -> tuple[list[Finding], list[Finding], list[tuple[str, str]]]:
    """The effects of the final model, each with what it is worth, in the order in which they matter: causes, and minor ones;
    pairs that share what one explains.
    """
    problem, found, final, unknown = conclusion.problem, conclusion.found, conclusion.final, conclusion.unknown
    held_before, held_after = (_held_out_squares(problem, f) for f in (found.base, conclusion.judged))
    explained = max(held_before - held_after, 0.0) / held_before if held_before > 0.0 else 0.0
    real = quiet_rms(problem, final) > ANSWER.quiet
    left = left_by(problem, final) ** 0.5
    findings: dict[int, Finding] = {}  # by their places in the model
    minor: dict[int, Finding] = {}
    linear = tamed(problem, final)
    worths = [worth_of(problem, final, linear, i) for i in range(len(final.model))]
    total = max(sum(w.rms**2 for w in worths), 1e-30)
    named = len(final.model) - (unknown is not None)
    # Where more than noise is left deviations are widened by it, and say less than what an effect is worth.
    plain = [real and w.rms >= ANSWER.plainly * left for w in worths]
    away = [significance(problem, final, i) for i in range(named)]
    slim = [w.rms**2 < ANSWER.slim * total and x < ANSWER.clearly for w, x in zip(worths, away, strict=False)]
    away = [np.inf if plain[i] and x >= ANSWER.barely else x for i, x in enumerate(away)]
    unseen = [h.cause.name in conclusion.missing for h in final.model]
    # What makes data worse that no fit saw is not sure, nor is which of two makes a ripple that either could.
    orders = Counter(h.cause.series for h in final.model if _turns_with_the_link(h))
    unsure = [
        held_after > held_before
        or h.key in conclusion.doubted
        or bool(other_ripples(problem, h))
        or orders[h.cause.series] >= ANSWER.orders
        for h in final.model
    ]
    pairs = _entangled(problem, final, linear, worths)
    entangled = {i for pair in pairs for i in pair}
    doubtful = [
        x < ANSWER.significant or slim[i] or unseen[i] or unsure[i] or i in entangled for i, x in enumerate(away)
    ]
    looked_at = len({(d.cause, *d.fixed.items()) for d in found.decisions})
    chance = [by_chance(x, len(h.magnitudes), looked_at) for x, h in zip(away, final.model, strict=False)]
    most = [ANSWER.beside if d else max(1.0 - p, ANSWER.beside) for d, p in zip(doubtful, chance, strict=True)]
    confidences = _confidences(problem, found, final, unknown, most)
    for i, (h, u) in enumerate(zip(final.model, problem.split(final.theta, final.model), strict=True)):
        w = worths[i]
        share = float(np.clip(explained * w.rms**2 / total, 0.0, 1.0))
        if unknown is not None and i == named:
            confidence = float(np.clip(1 - np.exp(-unknown.gain / (8 * ANSWER.temper)), 0.3, 0.95))
            if w.rms**2 < ANSWER.slim * total:
                confidence = min(confidence, ANSWER.beside)
            # Knees that are smooth, friction that is not quite viscous: many small things are in no library.
            rated = problem.joint.numbers["rated_torque"].value
            little = real and w.rms < ANSWER.little * rated and w.rms**2 < ANSWER.mostly * total
            little = little and left_by(problem, found.chosen) < ANSWER.plainer * left**2
            (minor if little else findings)[i] = Finding(
                "unknown", unknown.spline.component, confidence, {}, share, w.rms, discrepancy.describe(unknown),
                discrepancy.depends_on(unknown.spline.variable),
            )  # fmt: skip
            continue
        block = problem.place(final.model, i)
        values, std = h.values(u), problem.deviation(h, u, final.covariance[block, block])
        parameters = {
            q.name: ParameterEstimate(values[q.name], float(std.get(q.name, 0.0)), "" if q.unit == "1" else q.unit)
            for q in h.cause.parameters
        }
        small = real and (size_of(problem, final, i) < ANSWER.minor or (away[i] < ANSWER.barely and not plain[i]))
        if unknown is not None:  # what the unknown effect has left of it
            small = small or w.rms < ANSWER.slight * left or significance(problem, final, i) < ANSWER.significant
            # A pulse is a sum of orders: one that is less than what depends on the same angle at the same place is part of it.
            same = h.cause.series == (unknown.spline.place, unknown.spline.variable)
            small = small or (same and w.rms < worths[named].rms)
        (minor if small else findings)[i] = Finding(
            h.cause.name, h.cause.component, confidences[i], parameters, share, w.rms
        )
    if len(findings) > 1:
        gained = _gained(conclusion, measurement, linear, list(findings))
        whole = total + sum(gained.values())
        for i, g in gained.items():
            both = float(np.hypot(worths[i].rms, g**0.5))
            share = float(np.clip(explained * both**2 / whole, 0.0, 1.0))
            findings[i] = replace(findings[i], explains=share, worth=both, estimation=g**0.5)
    names = [h.cause.name for h in final.model]
    sizes = [size_of(problem, final, i) for i in range(named)] + [1.0] * (len(final.model) - named)
    ordered = _in_order(findings, sizes), _in_order(minor, sizes)
    return *ordered, [(names[i], names[j]) for i, j in pairs]


def _in_order(findings: dict[int, Finding], sizes: Sequence[float]) -> list[Finding]:
    """What is worth most first; of what is worth about the same, the one that is the largest for its kind.

    Args:
      sizes: of all effects of the model, in ordinary ones.
    """
    left, found = dict(findings), list[Finding]()
    while left:
        most = max(f.worth for f in left.values())
        first = max((i for i, f in left.items() if f.worth >= ANSWER.about * most), key=lambda i: sizes[i])
        found.append(left.pop(first))
    return found


def _turns_with_the_link(h: Hypothesis) -> bool:
    """Whether an effect is an order of a law of the link's angle."""
    return h.cause.series is not None and h.cause.series[1].endswith("link_position")


def _entangled(problem: Problem, f: Fit, linear: Fit, worths: Sequence[Worth]) -> list[tuple[int, int]]:
    """Pairs of effects that together make much, and beside each other next to nothing: data that one of them explains."""

    def little(both: Worth, i: int) -> bool:
        return worths[i].rms ** 2 < ANSWER.entangled * both.rms**2

    slight = [i for i, w in enumerate(worths) if w.rms**2 < ANSWER.entangled * sum(made_by(problem, f, linear, i))]
    pairs = [(pair, worth_of(problem, f, linear, *pair)) for pair in itertools.combinations(slight, 2)]
    return [pair for pair, both in pairs if all(little(both, i) for i in pair)]


def _gained(conclusion: Conclusion, measurement: Measurement, linear: Fit, indices: Sequence[int]) -> dict[int, float]:
    """Mean square of estimators' error [N·m]² that each of some effects removes, as far as other unknowns would not instead; none
    where no torque was measured."""
    problem, final, joint = conclusion.problem, conclusion.final, conclusion.problem.joint
    without = []
    for i in indices:
        unknown = None if final.model[i].cause.name == "unknown" else conclusion.unknown
        without.append(extended(problem, without_it(problem, final, linear, i), joint, unknown))
    gained = removed(measurement, extended(problem, final, joint, conclusion.unknown), without)
    return dict(zip(indices, gained, strict=False))


def explains_nothing(problem: Problem, base: Fit, final: Fit) -> bool:
    """Whether a model with causes leaves more of the simulation's error than the calibrated joint, whatever the evidence says."""
    before, after = (left_by(problem, f) for f in (base, final))
    noise = noise_of(problem, base)
    return after > ANSWER.useless * before + (ANSWER.useless - 1) * noise


def _diluted(problem: Problem, f: Fit, index: int) -> bool:
    """Whether the acceleration on which an inertia acts is in good part the encoders' noise: it is then found too small.

    That is regression dilution, which taking out the noise's share mends to first order only.
    """
    cause = f.model[index].cause
    if f.noise_jacobian is None or not {"Jm", "Jl"} & {*cause.sets.values(), *cause.scales}:
        return False
    normal = normal_equations(problem, f.noise, f.model, f.theta, f.point, f.jacobian, f.noise_jacobian)
    block = problem.place(f.model, index)
    noise, prior = np.diag(normal.share)[block], 1 / problem.spread(f.model)[block] ** 2
    whole = noise + np.diag(normal.hessian)[block] - prior
    return bool(np.any(noise > ANSWER.diluted * whole))


def _held_out_squares(problem: Problem, f: Fit) -> float:
    """Mean square of held-out residuals beyond the sensors' noise, over all balances [N·m]²; of all where none is held out."""
    total = 0.0
    moving = [judged & ~s.at_rest[:, None] for judged, s in zip(problem.judged, problem.segments, strict=True)]
    for b in range(len(BALANCES)):
        squares, noise, count = 0.0, 0.0, 0
        for judged, r, n in zip(moving, f.point.residual, f.point.noise, strict=True):
            use = judged[:, b]
            squares, noise, count = squares + np.sum(r[use, b] ** 2), noise + np.sum(n[use, b] ** 2), count + use.sum()
        if count:
            total += max(squares - noise, 0.0) / count * problem.output_scale[b] ** 2
    return float(total)


def _confidences(
    problem: Problem, found: Search, final: Fit, unknown: Unknown | None, most: Sequence[float]
) -> list[float]:
    """Probability of each of the final model's causes: among its rivals, and as far as those on which it rests are there.

    Where the sizes of two causes are correlated by ρ, the part ρ² of the one is what it is because the other is there too.

    Args:
      most: largest of each: less where it is few standard deviations from absent (`by_chance`), and where the measurement is none
        that shows it or tells it from another, or data that no fit saw are the worse for what was found.
    """
    model = final.model if unknown is None else final.model[:-1]
    alone, sizes = [], []
    for i, (h, u) in enumerate(zip(model, problem.split(final.theta, final.model), strict=False)):
        confidence = _confidence(found, h, unknown)
        if h.cause.resonance and not problem.link_measured:  # the other end's motion, or a controller's, looks the same
            confidence = min(confidence, ANSWER.unsure)
        beyond = out_of_proportion(problem, h.cause.name, h.values(u))
        if h.at_bound(u) or beyond or _diluted(problem, final, i):  # no answer, whatever it explains
            confidence = min(confidence, ANSWER.unsure)
        alone.append(min(confidence, most[i]))
        sizes.append(problem.place(final.model, i).start + np.asarray(h.magnitudes))
    spread = np.sqrt(np.diag(final.covariance))
    correlation = final.covariance / np.maximum(spread[:, None] * spread, 1e-300)

    def rests_on(i: int, j: int) -> float:
        return float(np.max(correlation[np.ix_(sizes[i], sizes[j])] ** 2))

    return [
        min([p, *(1 - (1 - q) * rests_on(i, j) for j, q in enumerate(alone) if j != i)]) for i, p in enumerate(alone)
    ]


def _confidence(found: Search, h: Hypothesis, unknown: Unknown | None) -> float:
    """Probability of a cause among those that could stand where it does, and of there being one at all."""
    rivals = {g.key: r for g, r in zip(found.chosen.model, found.rivals, strict=False)}.get(h.key)
    if rivals is None:
        return 0.5
    name = h.cause.name
    others = [g for n, g in rivals.others if n != name and _superseded(found, n)]
    best = max([rivals.gain, *others])
    temper = _temper(found.quiet[1], rivals.gain)
    weights = [np.exp((g - best) / temper) for g in others]
    own = float(np.exp((rivals.gain - best) / temper))
    none = float(np.exp(-(best - 3.5) / _temper(1.0, rivals.gain)))
    p = rivals.share * own / (own + sum(weights) + none)
    return float(min(p, ANSWER.surest if unknown is None else ANSWER.beside))


def _temper(quiet: float, gain: float) -> float:
    """What differences of log evidence are divided by: what no description holds decides nothing between rivals.

    Args:
      quiet: normalised RMS of what is left against the sensors' noise.
    """
    beside = float(np.clip(quiet, 1.0, ANSWER.inflation))
    return beside * (ANSWER.temper + ANSWER.inexact * float(np.clip(gain, 0.0, 500.0 * beside**2)))


def out_of_proportion(problem: Problem, name: str, values: Mapping[str, float]) -> float:
    """By what factor a cause has its number elsewhere than described, where no description is that wrong; else 0."""
    most = causes.get(name).multiple
    if not np.isfinite(most):
        return 0.0
    q = causes.get(name).parameters[0]
    factor = values[q.name] / (float(problem.joint.record()[0][q.relative]) if q.relative else 1.0)
    return factor if not 1 / most < factor < most else 0.0


def _superseded(found: Search, name: str) -> bool:
    """Whether a rival is not itself in the model: one that is was no rival."""
    return all(h.cause.name != name for h in found.chosen.model)


def other_ripples(problem: Problem, h: Hypothesis) -> list[str]:
    """Causes that one encoder does not tell from one of the final model: other orders of the motor's angle."""
    if problem.link_measured or not h.cause.ripple:
        return []
    return [name for name in causes.of(problem.joint) if causes.get(name).ripple and name != h.cause.name]


def close(found: Search) -> list[tuple[str, str]]:
    """Pairs of causes between which the evidence does not decide."""
    pairs = []
    for r in found.rivals:
        for name, gain in r.others:
            if gain > r.gain - 3 * _temper(found.quiet[1], r.gain) and _superseded(found, name):
                pairs.append((r.cause, name))
        if r.share < ANSWER.plain_share:
            special = causes.get(r.cause).generalises
            pairs += [(r.cause, n) for n in causes.names() if n in special or r.cause in causes.get(n).generalises]
    return pairs
