"""Causes of the final model: contribution and confidence of each."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from ..estimator.conditioning import Conditioned
from ..models import causes
from ..models.recording import Measurement
from .answer import Finding, ParameterEstimate
from .conclusion import ANSWER, Conclusion
from .data.segments import BALANCES
from .extension import extended
from .fit.regions import WORSE
from .fit.residual import Problem
from .fit.solver import Fit, normal_equations, tamed
from .improvement import removed
from .search import discrepancy
from .search.calibrate import CHANCE
from .search.contribution import contribution_of, excess, noise_square, size_of, without_effect


def findings_of(
    conclusion: Conclusion, measurement: Measurement, conditioned: Sequence[Conditioned]
) -> tuple[list[Finding], list[Finding]]:
    """Return causes and minor effects of the final model, the most important first.

    An effect is minor if it is more probably an imperfection of the kind that every real joint has.
    """
    problem, found, final = conclusion.problem, conclusion.found, conclusion.final
    held_before, held_after = (held_out_squares(problem, f) for f in (found.base, conclusion.judged))
    explained = max(held_before - held_after, 0.0) / held_before if held_before > 0.0 else 0.0
    linear = tamed(problem, final)
    contributions = [contribution_of(problem, final, linear, i).rms for i in range(len(final.model))]
    total = max(sum(w**2 for w in contributions), 1e-30)
    left = (excess(problem, final) + CHANCE * noise_square(problem, final)) ** 0.5
    findings: dict[int, Finding] = {}  # by index in the model
    minor: dict[int, Finding] = {}
    for i, (h, u) in enumerate(zip(final.model, problem.split(final.theta, final.model), strict=True)):
        share = float(np.clip(explained * contributions[i] ** 2 / total, 0.0, 1.0))
        surest = conclusion.surest if share >= ANSWER.about else min(conclusion.surest, conclusion.vague)
        there, effect = found.probabilities(h.key)
        if h.cause.ripple and not problem.link_measured:
            there, effect = 0.5 * there, 0.5 * effect  # one encoder does not separate motor from gear
        if isinstance(h, discrepancy.Spline):
            findings[i] = Finding(
                "unknown", h.component, min(there, surest), {}, share, contributions[i],
                h.describe(u), discrepancy.depends_on(h.variable),
            )  # fmt: skip
            continue
        block = problem.place(final.model, i)
        values, std = h.values(u), problem.deviation(h, u, final.covariance[block, block])
        parameters = {
            q.name: ParameterEstimate(values[q.name], float(std.get(q.name, 0.0)), "" if q.unit == "1" else q.unit)
            for q in h.cause.parameters
        }
        # A size at its bound, or found in the encoders' noise, is not sure, however much it explains.
        beyond = h.at_bound(u) or out_of_proportion(problem, h.cause.name, values) or _diluted(problem, final, i)
        small = effect < max(ANSWER.small * there, ANSWER.likely) or h.cause.name in conclusion.missing
        small = small or contributions[i] < ANSWER.slight * left
        confidence = min(there if small else effect, ANSWER.unsure if beyond else ANSWER.surest, surest)
        one = Finding(h.cause.name, h.cause.component, confidence, parameters, share, contributions[i])
        if one.determined:
            (minor if small else findings)[i] = one
    if len(findings) > 1:
        indices = list(findings)
        without = [extended(problem, without_effect(problem, final, linear, i), problem.joint) for i in indices]
        whole_joint = extended(problem, final, problem.joint)
        gained = dict(zip(indices, removed(measurement, whole_joint, without, conditioned), strict=False))
        whole = total + sum(gained.values())
        for i, g in gained.items():
            both = float(np.hypot(contributions[i], g**0.5))
            share = float(np.clip(explained * both**2 / whole, 0.0, 1.0))
            findings[i] = replace(findings[i], explains=share, contribution=both, estimation=g**0.5)
    sizes = [1.0 if h.cause.name == "unknown" else size_of(problem, final, i) for i, h in enumerate(final.model)]
    return _in_order(findings, sizes), _in_order(minor, sizes)


def _in_order(findings: dict[int, Finding], sizes: Sequence[float]) -> list[Finding]:
    """Sort by contribution; of about equal ones the largest for its kind first.

    Args:
      sizes: of all effects of the model, in ordinary ones.
    """
    left, found = dict(findings), list[Finding]()
    while left:
        most = max(f.contribution for f in left.values())
        first = max((i for i, f in left.items() if f.contribution >= ANSWER.about * most), key=lambda i: sizes[i])
        found.append(left.pop(first))
    return found


def explains_nothing(problem: Problem, base: Fit, final: Fit) -> bool:
    """Return whether a model with causes leaves a larger simulation error than the calibrated joint."""
    before, after = (excess(problem, f) for f in (base, final))
    return after > WORSE * before + (WORSE - 1) * noise_square(problem, base)


def _diluted(problem: Problem, f: Fit, index: int) -> bool:
    """Return whether much of the acceleration that an inertia acts on is encoder noise, so that it is found too small.

    Taking out the noise's share corrects this regression dilution to first order only.
    """
    cause = f.model[index].cause
    if f.noise_jacobian is None or not {"Jm", "Jl"} & {*cause.sets.values(), *cause.scales}:
        return False
    normal = normal_equations(problem, f.noise, f.model, f.theta, f.point, f.jacobian, f.noise_jacobian)
    block = problem.place(f.model, index)
    noise, prior = np.diag(normal.share)[block], 1 / problem.spread(f.model)[block] ** 2
    whole = noise + np.diag(normal.hessian)[block] - prior
    return bool(np.any(noise > ANSWER.diluted * whole))


def held_out_squares(problem: Problem, f: Fit) -> float:
    """Mean square of held-out residuals beyond the sensors' noise, over all balances [N·m]²; of all if none is held out."""
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


def out_of_proportion(problem: Problem, name: str, values: Mapping[str, float]) -> float:
    """Ratio of a cause's number to the description's where no description is that wrong; else 0."""
    most = causes.get(name).multiple
    if not np.isfinite(most):
        return 0.0
    q = causes.get(name).parameters[0]
    factor = values[q.name] / (float(problem.joint.record()[0][q.relative]) if q.relative else 1.0)
    return factor if not 1 / most < factor < most else 0.0
