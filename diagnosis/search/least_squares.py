"""Start of the search with one encoder: a plain regression, and least squares in the replay.

With one encoder a measurement determines what a regression of its torque on its motion does: gravity, inertia, friction, offset,
torque constant. Each of these numbers is a cause of the library. A number that the regression puts beyond its tolerance starts in
the model.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ..data.segments import Segment
from ..fit.coordinates import Hypothesis
from ..fit.noise import EVEN
from ..fit.regions import least_speed
from ..fit.residual import Model, Problem
from ..fit.solver import Fit, Fitter
from ..regression import Regression
from .posterior import dispersion

CAUSES = {
    "gravity_moment": ("gravity_moment", "scale"),
    "inertia": ("link_inertia", "scale"),
    "link_inertia": ("link_inertia", "scale"),
    "rotor_inertia": ("rotor_inertia", "value"),
    "Fc": ("mesh_friction", "scale"),
    "viscous": ("viscous_friction", "coefficient"),
    "load_dependent_friction": ("load_dependent_friction", "coefficient"),
    "offset": ("current_offset", "value"),
    "Kt": ("torque_constant", "value"),
    "arm_scale": ("arm_load", "scale"),
    "link_friction": ("link_friction", "torque"),
}
"""Cause and its parameter by the meaning of a regression's coefficient (`regression.Coefficient.means`)."""
FRICTION = {"Fc": "Fc", "viscous": "bw"}
"""Numbers of the joint, of wide tolerance, that start where a regression puts them, by its coefficient's meaning."""
FARTHEST = 2.0  # of their start, in standard deviations of the tolerance
BEYOND = 3.0
"""Standard deviations, of tolerance and regression together, from which a number starts in the model."""
_ITERATIONS = 12


def regression_fit(problem: Problem, offered: Sequence[Hypothesis], found: Sequence[Regression]) -> Fit:
    """Fit the joint with the effects that a regression puts beyond its tolerances, by least squares in motion.

    Args:
      offered: hypotheses that the measurement can show.
      found: the regressions of the measurement.
    """
    record = problem.calibration.record(np.zeros(problem.calibration.size))[0]
    started: dict[str, tuple[Hypothesis, np.ndarray]] = {}
    common = problem.start(None, ())
    for one in found:
        for c in one.coefficients:
            name, parameter = CAUSES.get(c.means, ("", ""))
            h = next((g for g in offered if g.cause.name == name), None)
            # The description states no tolerance of its effects.
            assumed = c.tolerance == 0.0 and c.described != 0.0
            if h is None or name in started or assumed or c.beyond <= BEYOND:
                _put(problem, common, FRICTION.get(c.means, ""), c.number / c.described if c.described else 0.0)
                continue
            now = h.cause.present(record)[parameter]
            value = now + (c.number - c.described) * (now / c.described if c.described else 1.0)
            started[name] = h, h.confine(h.coordinates({q.name: value for q in h.cause.parameters}))
    model = tuple(h for h, _ in started.values())
    start = np.concatenate([common, *(u for _, u in started.values())])
    if not all(np.isfinite(r).all() for r in problem.residuals([start], [model])[0]):
        model, start = (), problem.start(None, ())  # a load so light that nothing moves like it
    return least_squares(problem, model, start)


def _put(problem: Problem, x: np.ndarray, name: str, ratio: float) -> None:
    """Set the variable that changes a number of the joint most to a multiple of the description, in place."""
    calibration = problem.calibration
    slot = next((s for s in calibration.slots if s.name == name), None)
    if slot is None or not ratio > 0.0:
        return
    value, one = calibration.value(slot, np.zeros(calibration.size)), np.eye(calibration.size)
    step = {j: np.log(calibration.value(slot, one[j]) / value) for j in calibration.variables(slot)}
    most = max(step, key=lambda j: step[j])
    x[most] = np.clip(np.log(ratio) / step[most], -FARTHEST, FARTHEST)


def fitter_in_motion(problem: Problem) -> Fitter:
    """Return a least-squares fitter of the samples that a regression uses."""
    least = least_speed(problem)

    def moving(s: Segment) -> Segment:
        fast = (np.abs(s.state[:, 3]) > least)[:, None]
        return replace(s, usable=s.usable & fast, held_out=s.held_out & fast)

    return Fitter(problem.with_segments(moving), EVEN)


def least_squares(problem: Problem, model: Model, start: np.ndarray) -> Fit:
    """Fit a model by least squares in motion, tempered.

    Residuals within one second depend on each other, which the noise of least squares ignores. It is therefore multiplied by the
    `dispersion`, so that tolerances hold numbers that the data hardly determine (a coarsened posterior: Miller and Dunson, 2019).
    """
    fitter = fitter_in_motion(problem)
    f = fitter.fit(model, start, None, _ITERATIONS)
    louder = f.noise.louder(dispersion(fitter.problem, f) ** 0.5)
    return fitter.settle(replace(f, noise=louder), _ITERATIONS)
