"""The start from a plain regression: the effects that least squares puts beyond the joint's tolerances, fitted in the replay.

With one encoder a measurement says of a joint what a regression of its torque on its motion says: gravity, inertia, friction,
offset, torque constant. Each is a cause of the library. They are fitted together by least squares, with the joint's tolerances as priors. An effect without
which held-out data are predicted as well goes again: the tolerances express it, or it is not there.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..fit.coordinates import Hypothesis
from ..fit.noise import EVEN
from ..fit.residual import Problem
from ..fit.solver import Fit, Fitter
from ..regression import Regression

CAUSES = {
    "gravity_moment": "gravity_moment",
    "inertia": "link_inertia",
    "rotor_inertia": "rotor_inertia",
    "Fc": "mesh_friction",
    "viscous": "viscous_friction",
    "load_dependent_friction": "load_dependent_friction",
    "offset": "current_offset",
    "Kt": "torque_constant",
}
"""Causes by what a coefficient of a regression says (`regression.Coefficient.means`)."""
_ITERATIONS = 10
_NEEDED = 0.03
"""Share by which what is left of held-out data must grow without an effect, for it to stay."""


def plain_fit(fitter: Fitter, offered: Sequence[Hypothesis], found: Sequence[Regression]) -> Fit | None:
    """The joint with the effects that a regression needs beyond its tolerances, by least squares.

    Args:
      offered: hypotheses that the measurement can show.
      found: the regressions of the measurement.

    Returns:
      None where tolerances can express all of them.
    """
    least_squares = Fitter(fitter.problem, fitter.settings, EVEN)
    problem = least_squares.problem
    names = {CAUSES[c.means] for one in found for c in one.coefficients if c.means in CAUSES}
    model = tuple(
        h for i, h in enumerate(offered) if h.cause.name in names and h.cause not in [g.cause for g in offered[:i]]
    )
    if not model:
        return None
    f = least_squares.fit(model, problem.start(None, model), None, _ITERATIONS)
    while f.model:
        others = [_without(least_squares, f, i) for i in range(len(f.model))]
        best = min(others, key=lambda other: held_out_square(problem, other))
        if held_out_square(problem, best) > (1 + _NEEDED) * held_out_square(problem, f):
            return f
        f = best
    return None


def _without(fitter: Fitter, f: Fit, index: int) -> Fit:
    """A fit without one of its effects."""
    block = fitter.problem.place(f.model, index)
    theta = np.delete(f.theta, np.arange(block.start, block.stop))
    return fitter.fit(tuple(h for i, h in enumerate(f.model) if i != index), theta, f, 6, anew=True)


def held_out_square(problem: Problem, f: Fit) -> float:
    """Mean square of what a fit leaves in motion of the blocks that it has not seen, of all where there are none [N·m at the
    output]², over all balances."""
    total = 0.0
    for b, scale in enumerate(problem.output_scale):
        use = [k[:, b] & ~s.at_rest for k, s in zip(problem.judged, problem.segments, strict=True)]
        squares = np.concatenate([r[u, b] ** 2 for r, u in zip(f.point.residual, use, strict=True)])
        total += float(np.mean(squares)) * scale**2 if len(squares) else 0.0
    return total
