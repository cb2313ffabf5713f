"""How well a diagnosis knows the joint that it has found, for the joint's description (`models.joint.Uncertainty`).

The covariance of the fit's unknowns becomes that of the description's numbers, effects and discrepancies, by their derivatives.
What the description could not hold, the model discrepancy that was learned beside them, goes with it as an rms a balance.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..models.joint import Joint, Uncertainty
from .data.segments import BALANCES
from .diagnose import Diagnosis
from .fit.residual import Problem
from .fit.solver import Fit

_STEP = 1e-3
_DIGITS = 4


def stated(problem: Problem, fit: Fit, joint: Joint) -> Uncertainty:
    """How well a fit knows the joint that was extended by it.

    Args:
      joint: the extended joint; its last effects and discrepancies are those of the fit's model, in order.
    """
    names, period, values = _quantities(problem, fit, joint)
    base = values(fit.theta)
    changes = np.stack([values(fit.theta + _STEP * e) - base for e in np.eye(len(fit.theta))], axis=1)
    changes -= period[:, None] * np.round(changes / np.where(period > 0, period, 1.0)[:, None])  # of an angle, the short way
    slope = changes / _STEP
    root = np.linalg.cholesky(fit.covariance + 1e-14 * np.diag(np.diag(fit.covariance)))
    # L of L Lᵀ = (slope·root)(slope·root)ᵀ, also where numbers share all that is not known of them.
    lower = np.linalg.qr((slope @ root).T, mode="r").T
    n = len(names)
    factor = np.zeros((n, n))
    factor[:, : lower.shape[1]] = lower * np.sign(np.where(np.diag(lower) == 0, 1.0, np.diag(lower)))
    rms = np.sqrt(np.sum(fit.noise.discrepancy**2, axis=1))
    formed = np.any([segment.balances for segment in problem.segments], axis=0)
    return Uncertainty(
        names=names,
        factor=[[_rounded(x) for x in row[: i + 1]] for i, row in enumerate(factor)],
        discrepancy={name: _rounded(x) for name, x, there in zip(BALANCES, rms, formed, strict=True) if there},
    )


def _rounded(x: float) -> float:
    return float(f"{x:.{_DIGITS}g}")


def _quantities(problem: Problem, fit: Fit, joint: Joint):
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
                found += list(h.values(u)["coefficients"])
        return np.array(found)

    return names, np.array(period), values


def with_uncertainty(diagnosis: Diagnosis) -> Diagnosis:
    """The diagnosis whose extended joint states how well it is known."""
    problem, final = diagnosis.problem, diagnosis.final
    if problem is None or final is None:
        return diagnosis
    known = stated(problem, final, diagnosis.extended)
    extended = diagnosis.extended.model_copy(update={"uncertainty": known})
    extended._path = diagnosis.extended._path
    return replace(diagnosis, extended=extended)
