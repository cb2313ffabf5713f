"""Fits that go on from other fits."""

import numpy as np
import pytest

import flexspline as fs
from flexspline.diagnosis.data.segments import segments
from flexspline.diagnosis.fit.coordinates import hypotheses
from flexspline.diagnosis.fit.residual import Problem
from flexspline.diagnosis.fit.solver import Fitter
from flexspline.diagnosis.search.calibrate import CalibrateSettings, calibrate
from flexspline.models import causes
from flexspline.models.joint import load_joint

SEED = 5


def test_what_an_effect_replaces_has_no_say_beside_it():
    """A torque constant of its own beside one that calibration had moved to its end: derivatives that were taken over held
    that in place, and the effect came out at a third, 1.2 standard deviations from none, and was thrown away."""
    cause, number, factor = "torque_constant", "Kt", 0.91
    print(f"seed {SEED}")
    described = load_joint("test-joint")
    value = factor * described.numbers[number].value
    numbers = described.numbers | {number: described.numbers[number].model_copy(update={"value": value})}
    true = described.model_copy(update={"numbers": numbers})
    run = fs.simulate("link_sweep", joint=true, filters=["RAREKF"], duration=10, seed=SEED)
    problem = Problem(*segments([run.as_recording()], described), described)
    fitter = Fitter(problem)
    base = calibrate(problem, fitter, CalibrateSettings(iterations=4))
    at = problem.calibration.names.index(number)
    assert abs(base.theta[at]) > 1.5
    (effect,) = hypotheses(causes.get(cause), problem.calibration.record(np.zeros(problem.calibration.size)))
    found = fitter.fit((effect,), problem.start(base.theta, (effect,)), base)
    assert abs(found.theta[at]) < 1e-6
    assert not any(j[..., at].any() for j in found.jacobian)
    u, covariance = found.theta[problem.size :], found.covariance[problem.size :, problem.size :]
    ((name, told),) = effect.values(u).items()
    assert abs(told - value) < 4 * effect.deviation(u, covariance)[name]
    assert abs(told - value) < 0.3 * abs(value - described.numbers[number].value)
    # And it has its say again where the effect has gone.
    without = fitter.fit((), found.theta[: problem.size], found)
    assert any(j[..., at].any() for j in without.jacobian)
    assert without.theta[at] == pytest.approx(base.theta[at], abs=0.3)
