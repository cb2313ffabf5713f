"""Unknown effects: their derivatives, causes next to them, and what replaced them."""

from __future__ import annotations

import numpy as np
import pytest
from swing import recording

from flexspline.diagnosis.data.segments import segments
from flexspline.diagnosis.diagnose import diagnose
from flexspline.diagnosis.fit.residual import Problem
from flexspline.diagnosis.search.discrepancy import FirstLook, splines
from flexspline.diagnosis.trials.draw import Challenge, draw
from flexspline.models.joint import load_joint
from flexspline.models.parameters import PLACES, VARIABLES


@pytest.fixture(scope="module")
def problem() -> Problem:
    joint = load_joint("test-joint")
    return Problem(*segments([recording(seconds=4.0)], joint), joint)


def apart(problem, spline, J, rng):
    """By how much derivatives differ from a small step of the replay in a direction of all coefficients, of their norm."""
    theta, u, h = np.zeros(problem.size), rng.standard_normal(spline.count), 1e-4
    ends = [np.concatenate([theta, s * h * u]) for s in (1, -1)]
    after, before = (np.concatenate(r) for r in problem.residuals(ends, [(spline,), (spline,)]))
    expected = (after - before) / (2 * h)
    return np.linalg.norm(np.concatenate(J) @ u - expected) / np.linalg.norm(expected)


@pytest.mark.parametrize("place", PLACES[1:])
@pytest.mark.parametrize("variable", VARIABLES)
def test_derivatives_are_what_the_replay_does(problem, rng, place, variable):
    spline = next((s for s in splines(problem) if (s.place, s.variable) == (place, variable)), None)
    if spline is None:
        pytest.skip("this motion does not show it")
    columns = problem.size + np.arange(spline.count)
    J = problem.jacobian(np.zeros(problem.size + spline.count), (spline,), columns)
    assert apart(problem, spline, J, rng) < 0.05


@pytest.mark.parametrize("place", PLACES[1:])
@pytest.mark.parametrize("variable", ["link_position", "motor_velocity", "time"])
def test_a_first_look_is_as_good(problem, rng, place, variable):
    spline = next(s for s in splines(problem) if (s.place, s.variable) == (place, variable))
    assert apart(problem, spline, FirstLook(problem, np.zeros(problem.size), ()).columns(spline), rng) < 0.05


@pytest.mark.slow
@pytest.mark.long
@pytest.mark.parametrize("name", ["rotor_pulse", "quadratic_friction"])
def test_no_cause_stands_next_to_an_effect_of_which_it_is_a_part(name):
    """A pulse has all orders of cogging in it, and a friction that bends is none that is viscous."""
    drawn = draw(Challenge(seed=391, hidden="outside", real=True, only=(name,)), 0)
    found = diagnose(drawn.measurement, drawn.nominal)
    assert found.causes[0].name == "unknown" and found.causes[0].component == drawn.effects[0].component
    assert not {"cogging", "viscous_friction", "position_dependent_friction"} & {c.name for c in found.causes}


@pytest.mark.slow
@pytest.mark.long
@pytest.mark.parametrize("seed, index", [(411, 8), (411, 15), (431, 13)])
def test_what_acts_slowly_is_seen_under_what_is_taken_for_discrepancy(seed, index):
    """Friction that grows with the load, replaced by back-driving; a link encoder off centre, for which orders 2 and 3 and an
    unknown error did; viscous friction, for which an unknown one did at 0.95."""
    drawn = draw(Challenge(seed=seed, hidden="one", real=True), index)
    found = diagnose(drawn.measurement, drawn.nominal)
    assert found.causes[0].name == drawn.effects[0].name
