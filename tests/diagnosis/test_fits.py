"""Fits that go on from other fits."""

from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest
from swing import recording

import flexspline as fs
from flexspline.diagnosis.data.segments import segments
from flexspline.diagnosis.extension import calibrated
from flexspline.diagnosis.fit.coordinates import hypotheses
from flexspline.diagnosis.fit.residual import Problem
from flexspline.diagnosis.fit.solver import Fit, Fitter, evaluate_point, prior_cost
from flexspline.diagnosis.search.calibrate import better, calibrate
from flexspline.diagnosis.search.contribution import alone
from flexspline.models import causes
from flexspline.models.joint import load_joint
from flexspline.models.joint_parts import Effect, Estimate

SEED = 5


def test_what_an_effect_replaces_has_no_say_next_to_it():
    """A torque constant of its own next to one that calibration had moved to its end: derivatives that were taken over held
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
    base = calibrate(fitter, iterations=4)
    at = problem.calibration.names.index(number)
    assert abs(base.theta[at]) > 1.5
    (effect,) = hypotheses(causes.get(cause), problem.calibration.record(np.zeros(problem.calibration.size)))
    found = fitter.fit((effect,), problem.start(base.theta, (effect,)), base)
    assert abs(found.theta[at]) < 1e-6
    assert not any(j[..., at].any() for j in found.jacobian)
    u, covariance = found.theta[problem.size :], found.covariance[problem.size :, problem.size :]
    ((name, reported),) = effect.values(u).items()
    assert abs(reported - value) < 4 * effect.deviation(u, covariance)[name]
    assert abs(reported - value) < 0.3 * abs(value - described.numbers[number].value)
    # And it has its say again where the effect has gone.
    without = fitter.fit((), found.theta[: problem.size], found)
    assert any(j[..., at].any() for j in without.jacobian)
    assert without.theta[at] == pytest.approx(base.theta[at], abs=0.3)


def test_numbers_that_the_data_hardly_tell_stay_near_the_description_where_more_than_noise_is_left():
    """Five times the noise: what the data know well stays, and the numbers are less far from the description altogether."""
    print(f"seed {SEED}")
    described = load_joint("test-joint")
    run = fs.simulate("link_sweep", filters=["RAREKF"], duration=10, seed=SEED)
    problem = Problem(*segments([run.as_recording()], described), described)
    fitter = Fitter(problem)
    fit = fitter.polish(calibrate(fitter, iterations=4))
    known = np.sqrt(np.diag(fit.covariance)) < 0.04
    # Two standard deviations away where the data say least: how far a fit goes there by itself is chance.
    _, directions = np.linalg.eigh(fit.covariance)
    theta = fit.theta + 2.0 * directions[:, -1]
    fit = replace(fit, theta=theta, point=evaluate_point(problem, theta, ()))
    found = fitter.settle(replace(fit, noise=fit.noise.louder(5.0)))
    assert known.sum() >= 3
    assert np.all(np.abs(found.theta - fit.theta)[known] < 0.15)
    assert prior_cost(problem, found.theta, ()) < 0.7 * prior_cost(problem, fit.theta, ())
    assert (
        np.linalg.slogdet(found.covariance)[1] > np.linalg.slogdet(fit.covariance)[1]
    )  # and less is known of them altogether


@pytest.mark.parametrize("name", causes.names())
def test_whatever_a_fit_does_its_effects_can_be_written(name):
    """A model without one of its effects, on a big joint, had a periodic friction larger than a joint's file may hold."""
    print(f"seed {SEED}")
    rng = np.random.default_rng(SEED)
    cause = causes.get(name)
    for effect in hypotheses(cause, load_joint("test-joint").record()):
        low, high = effect.limits
        assert not effect.at_bound(np.where(np.isin(range(effect.size), effect.magnitudes), 0.1, 0.0))
        for far in (*rng.uniform(np.maximum(low, -300), np.minimum(high, 300), (20, effect.size)), high):
            values = effect.values(far)
            Effect(name=name, parameters={q: Estimate(value=values[q], unit="") for q in values})
        assert effect.at_bound(high) == bool(effect.magnitudes)


@cache
def swung(off: float = 0.0) -> tuple[Problem, Fit]:
    """The test joint in a swing, its link encoder's zero off; all numbers but zeros as described, fitted."""
    joint, one = load_joint("test-joint"), recording(seconds=8.0)
    columns = one.columns | {"link_position": one.columns["link_position"] + off}
    problem = Problem(*segments([replace(one, columns=columns)], joint), joint).only_zero()
    return problem, Fitter(problem).fit((), problem.start(None, ()), iterations=4)


def test_zeros_next_to_numbers_as_described_are_written():
    """Numbers that have but a shared tolerance shifted what is held: other numbers were written, and the zero was not."""
    problem, fit = swung(1.5e-4)
    joint = problem.joint
    written = calibrated(problem, fit, joint)
    zero = written.sensors.link_encoder.zero
    assert zero is not None and abs(zero.value - 1.5e-4) < 3e-5 and zero.std
    for name, number in written.numbers.items():
        assert number == joint.numbers[name], name
    assert written.sensors.motor_current.offset == joint.sensors.motor_current.offset


def test_the_likelier_fit_is_the_better_one_unless_it_leaves_several_times_as_much():
    problem, fit = swung()
    for times, chosen in ((1.1, True), (30.0, False)):
        residual = [times * r for r in fit.point.residual]
        likelier = replace(fit, point=replace(fit.point, residual=residual), log_evidence=fit.log_evidence + 100.0)
        assert (better(problem, fit, likelier) is likelier) == chosen == (better(problem, likelier, fit) is likelier)


@pytest.mark.parametrize("name", ["stiffness", "encoder_delay", "hysteresis", "link_flexibility", "cogging"])
def test_a_size_at_the_end_of_what_it_can_be_is_not_known_exactly(name):
    """A fit that is clipped to its bounds had a standard deviation of 0 there, and a plan nothing to ask of it."""
    record = load_joint("test-joint").record()
    effect = hypotheses(causes.get(name), record)[0]
    end = np.array([2e3, 0.0]) if effect.polar else effect.limits[1]
    covariance = np.diag(np.full(effect.size, 0.04))
    inside, at_its_end = (effect.deviation(u, covariance) for u in (0.5 * effect.confine(0.02 * end), end))
    for q in effect.free:
        assert inside[q.name] > 0.0 and at_its_end[q.name] > 0.0, q.name


def test_an_effect_is_taken_away_from_absent():
    """Of what another effect replaces the size goes, and not where or how it acts: what these make of it is none of it."""
    joint, values = load_joint("test-joint"), {"torque": 1.0, "extent": 1.5e-4}
    problem = Problem(*segments([recording(seconds=4.0)], joint), joint)
    (effect, *_) = hypotheses(causes.get("hysteresis"), problem.calibration.record(np.zeros(problem.calibration.size)))
    u = effect.coordinates(values)
    (shape,) = set(range(effect.size)) - set(effect.magnitudes)
    u[shape] = np.log(values["extent"] / effect.start["extent"]) / effect.scale["extent"] + 0.8
    theta = np.concatenate([np.zeros(problem.size), u])
    (with_it,), (without,) = (
        problem.residuals([t], [model])[0] for t, model in ((theta, (effect,)), (theta[: problem.size], ()))
    )
    (J,) = problem.jacobian(theta, (effect,))
    at = SimpleNamespace(theta=theta, model=(effect,))
    own, others, amount = alone(problem, at, 0)
    block = problem.place((effect,), 0)
    assert set(others) == set(range(problem.size))
    off, whole = (
        np.linalg.norm(r - without) for r in (with_it - J[..., own] @ amount, with_it - J[..., block] @ theta[block])
    )
    print(off, whole, np.linalg.norm(with_it - without))
    assert off < 0.7 * whole
