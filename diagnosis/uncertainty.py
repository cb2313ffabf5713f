"""How well a diagnosis knows the joint that it has found, for the joint's description (`models.joint.Uncertainty`).

The covariance of the fit's unknowns becomes that of the description's numbers, effects and discrepancies, by their derivatives.
It includes the learned model discrepancy, as an rms per balance. Its growth beyond the data is measured at the ends of their
ranges, each held out from a separate fit (`fit.regions`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from ..models.joint import Joint
from ..models.joint_parts import Uncertainty
from ..models.parameters import short_way
from .data.segments import BALANCES, LINK, TORQUE
from .fit.regions import Region, region_masks, valid_range
from .fit.residual import Problem
from .fit.solver import Fit, Point, covariances, root_of
from .search.contribution import excess_by_balance

_STEP = 1e-3
_DIGITS = 4
_DEEP = 0.01  # mean distance of a region from the rest of the data, in ranges, from which on it says how errors grow
_STEEP, _STEEPEST = (
    10.0,
    30.0,
)  # growth over a range, in what the fit cannot hold: where no region says, and the largest


def stated(problem: Problem, fit: Fit, joint: Joint, regions: Sequence[Region]) -> Uncertainty:
    """How well a fit knows the joint that was extended by it.

    Args:
      joint: the extended joint; its last effects and discrepancies are those of the fit's model, in order.
      regions: of the measurement, each held out from a separate fit.
    """
    covariance = larger(*covariances(problem, fit))
    if fit.least_covariance is not None:
        covariance = larger(covariance, fit.least_covariance)
    names, period, values = _quantities(problem, fit, joint)
    base = values(fit.theta)

    def slope_by(step: float) -> np.ndarray:
        changes = np.stack([values(fit.theta + step * e) - base for e in np.eye(len(fit.theta))], axis=1)
        return short_way(changes, period[:, None]) / step

    slope = slope_by(_STEP)
    slope = np.where(slope == 0.0, slope_by(-_STEP), slope)  # at the end of what an effect can be, from inside
    root = root_of(covariance)
    # L of L Lᵀ = (slope·root)(slope·root)ᵀ, also where numbers share all that is not known of them.
    lower = np.asarray(np.linalg.qr((slope @ root).T, mode="r")).T
    n = len(names)
    factor = np.zeros((n, n))
    factor[:, : lower.shape[1]] = lower * np.sign(np.where(np.diag(lower) == 0, 1.0, np.diag(lower)))
    # The learned discrepancy lacks a mean and slow parts: it is at least the residual.
    square = np.sum(fit.noise.discrepancy**2, axis=1)
    square = np.maximum(square, excess_by_balance(problem, fit.point) / problem.output_scale**2)
    if problem.has_torque:  # a torque reading has it, and nothing of the description
        square[[TORQUE, LINK]] += problem.crosstalk_at(fit.theta, covariance) ** 2
    return Uncertainty(
        names=names,
        factor=[[_rounded(x) for x in row[: i + 1]] for i, row in enumerate(factor)],
        discrepancy=_by_balance(problem, square),
        beyond=_rounded(growth(problem, fit, regions)),
    )


def of_description(problem: Problem, described: Point) -> Uncertainty:
    """How well a description that nothing was added to is known: what it leaves of the data, which its tolerances need not hold.

    Args:
      described: residuals with the described numbers.
    """
    before = problem.joint.uncertainty or Uncertainty(names=[], factor=[])
    left = _by_balance(problem, excess_by_balance(problem, described) / problem.output_scale**2)
    return before.model_copy(
        update={"discrepancy": {name: max(rms, before.discrepancy.get(name, 0.0)) for name, rms in left.items()}}
    )


def _by_balance(problem: Problem, square: np.ndarray) -> dict[Any, float]:
    """Root mean squares of the balances that can be formed, by their names."""
    formed = np.any([segment.balances for segment in problem.segments], axis=0)
    return {name: _rounded(x) for name, x, there in zip(BALANCES, np.sqrt(square), formed, strict=True) if there}


def growth(problem: Problem, fit: Fit, regions: Sequence[Region]) -> float:
    """How many times as large what a fit cannot hold is a whole range beyond its data.

    Of each region that lies beyond the rest of the data: what its error gains by not having been seen, over the error, by how far
    it lies beyond the rest, in ranges; the median of these.
    """
    masks = region_masks(problem)
    slopes = []
    for region in regions:
        rest = valid_range(problem, [~mask for mask in masks[region.name]])
        if rest is None:
            continue
        far = [
            rest.distance(s.link_position[use], s.state[use, 3], s.load[use])
            for s, mask in zip(problem.segments, masks[region.name], strict=True)
            if (use := mask & ~s.at_rest & s.usable.any(axis=1)).any()
        ]
        depth = float(np.mean(np.concatenate(far))) if far else 0.0
        if depth > _DEEP:
            gained = np.sqrt(max(region.unseen**2 - region.extended**2, 0.0)) / max(region.extended, 1e-12)
            slopes.append(gained / depth)
    return 1.0 + min(float(np.median(slopes)), _STEEPEST) if slopes else 1.0 + _STEEP


def larger(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """The covariance that is at least as large as either of two, shape (n, n) each, for every combination of the unknowns.

    With one = L Lᵀ and L⁻¹ other L⁻ᵀ = V Λ Vᵀ it is L V max(Λ, 1) Vᵀ Lᵀ.
    """
    scale = np.sqrt(np.diag(one))
    root = root_of(one / scale[:, None] / scale)
    inner = np.linalg.solve(root, np.linalg.solve(root, other / scale[:, None] / scale).T)
    values, vectors = np.linalg.eigh(0.5 * (inner + inner.T))
    wide = scale[:, None] * (root @ vectors) * np.sqrt(np.maximum(values, 1.0))
    return wide @ wide.T


def _rounded(x: float) -> float:
    return float(f"{x:.{_DIGITS}g}")


def _quantities(
    problem: Problem, fit: Fit, joint: Joint
) -> tuple[list[str], np.ndarray, Callable[[np.ndarray], np.ndarray]]:
    """Names of the joint's quantities that a fit has moved, shape (n,) the period of those that have one, and their values, shape
    (n,), as a function of its unknowns."""
    c = problem.calibration
    names = [slot.name for slot in c.slots]
    period = [0.0] * len(names)
    known = [h for h in fit.model if h.free]
    first = len(joint.effects) - len(known)
    for i, h in enumerate(known):
        names += [f"effects.{first + i}.{q.name}" for q in h.free]
        period += [q.period or 0.0 for q in h.free]
    splines = [h for h in fit.model if not h.free]
    first = len(joint.discrepancies) - len(splines)
    for i, h in enumerate(splines):
        names += [f"discrepancies.{first + i}.{k}" for k in range(h.size)]
        period += [0.0] * h.size

    def values(theta: np.ndarray) -> np.ndarray:
        found = [c.value(slot, theta[: c.size]) for slot in c.slots]
        parts = problem.split(theta, fit.model)
        for h, u in zip(fit.model, parts, strict=True):
            if h.free:
                found += [h.values(u)[q.name] for q in h.free]
        for h, u in zip(fit.model, parts, strict=True):
            if not h.free:
                found += np.atleast_1d(h.values(u)["coefficients"]).tolist()
        return np.array(found)

    return names, np.array(period), values
