"""Collision detectors: the link's observer in closed form, thresholds, delays and the smallest push on signals that are known."""

from __future__ import annotations

import math

import numpy as np
import pytest

from flexspline.estimator import KnownJoint, registry
from flexspline.estimator.external import external_torque, lowpassed
from flexspline.models.errors import InputError
from flexspline.models.joint import load_joint
from flexspline.models.signals import Signals
from flexspline.scenarios.evaluation import contact
from flexspline.scenarios.evaluation.contact import Detector
from flexspline.scenarios.scenario import load_scenario

DT = 1e-3


def test_the_links_observer_is_a_low_pass_of_what_acts():
    """A pendulum, its motion stated and its torque with it: a step of external torque comes out as τ(1 − exp(−K t)), which at
    samples h apart, stepped implicitly, is τ(1 − (1 + K h)⁻ⁿ)."""
    joint = load_joint("test-joint")
    mounting = joint.mount("link")
    known = KnownJoint.of(joint, mounting)
    time = np.arange(4000) * DT
    external = np.where(time >= 2.0, 3.0, 0.0)
    angle = 0.6 * np.sin(1.3 * time)
    acceleration = -0.6 * 1.3**2 * np.sin(1.3 * time)
    torque = mounting.inertia * acceleration + mounting.gravity_moment * np.sin(angle) - external
    signals = Signals(time, {"motor_position": 100.0 * angle, "link_position": angle})
    found = external_torque(signals, torque, known, bandwidth=10.0, cutoff=200.0)
    steps = np.maximum(np.arange(4000) - 1999, 0)
    stepped = 3.0 * (1.0 - (1.0 + 2 * math.pi * 10.0 * DT) ** -steps)
    np.testing.assert_allclose(found[500:], stepped[500:], atol=5e-3)
    exact = 3.0 * (1.0 - np.exp(-2 * math.pi * 10.0 * np.maximum(time - 2.0, 0.0)))
    assert np.abs(found - exact)[500:].max() < 1.05 * 3.0 * 2 * math.pi * 10.0 * DT  # a sample
    # What an estimate is wrong by comes out alike.
    wrong = external_torque(signals, torque - 0.5, known, bandwidth=10.0, cutoff=200.0)
    np.testing.assert_allclose((wrong - found)[1000:], 0.5, atol=1e-3)
    with pytest.raises(InputError, match="shape"):
        external_torque(signals, torque[:-1], known)


def test_the_velocitys_low_pass_has_its_cutoff_and_any_signals_derivatives():
    """Butterworth's of second order: 1/√2 at the cutoff, a quarter of a turn late; rate and acceleration are the value's. The
    observer hears a velocity through it: a link that sets off without a torque was pushed, as late as the velocity is."""
    time, cutoff = np.arange(40_000) * 1e-5, 30.0
    found = lowpassed(time, np.sin(2 * math.pi * cutoff * time), cutoff)
    late = time > 0.2
    expected = -np.cos(2 * math.pi * cutoff * time) / math.sqrt(2.0)
    np.testing.assert_allclose(found[late, 0], expected[late], atol=0.01)
    for k in (1, 2):
        np.testing.assert_allclose(np.diff(found[:, k - 1]), found[1:, k] * 1e-5, atol=1e-12)
    assert lowpassed(time, np.full(len(time), 3.0), cutoff)[-1] == pytest.approx([3.0, 0.0, 0.0])
    known = KnownJoint.of(load_joint("test-joint"), load_joint("test-joint").mount("no_load"))
    angle = 0.5 * np.maximum(time - 0.1, 0.0)
    weightless = known.with_numbers(Mg=0.0)
    signals = Signals(time, {"motor_position": 100.0 * angle, "link_position": angle})
    push = external_torque(signals, np.zeros(len(time)), weightless, bandwidth=400.0, cutoff=5.0)
    momentum = np.cumsum(push) * 1e-5
    expected = weightless.p["Jl"] * 0.5 * (1.0 - np.exp(-2 * math.pi * 5.0 * np.maximum(time - 0.1, 0.0)))
    np.testing.assert_allclose(momentum, expected, atol=0.02 * expected.max())


def white(seed: int, runs: int = 60, seconds: int = 60):
    """A detector of white noise of unit variance that hears half-sine pushes perfectly, at once."""
    rng = np.random.default_rng(seed)
    quiet = np.abs(rng.standard_normal((runs, seconds, 200))).max(axis=2)
    size = np.exp(rng.uniform(np.log(0.5), np.log(20.0), (runs, 10)))
    ramp = np.minimum(np.arange(300) / 200.0, 1.0)
    rising = np.maximum.accumulate(size[:, :, None] * ramp, axis=2)
    return Detector("white", quiet, size, np.zeros_like(size), rising)


def test_thresholds_give_the_rate_they_are_for():
    """Of 200 independent normal values a second: P(alarm in a second) = 1 − erf(c/√2)²⁰⁰."""
    one = white(1)
    assert one.hours == pytest.approx(0.5)
    for rate in (1200.0, 300.0):
        c = one.threshold(rate)
        exact = 3600.0 * (1.0 - math.erf(c / math.sqrt(2.0)) ** 200)
        n = one.quiet.size / 2
        spread = 3600.0 * math.sqrt(rate / 3600.0 * (1 - rate / 3600.0) / n)
        assert exact == pytest.approx(rate, abs=4 * spread)
        assert np.mean(one.alarms(c)) == pytest.approx(exact, abs=4 * spread)
        point = contact.at(one, c, 100)
        assert point["false_alarms_per_hour_low"] < exact < point["false_alarms_per_hour_high"]
    assert math.isnan(one.threshold(0.5))  # half an hour does not show it
    assert np.all(np.diff(one.thresholds()) > 0)


def test_delay_and_what_is_found():
    """A push that rises evenly to its size in 0.2 s crosses the threshold c after c/size·0.2 s; what is alarmed before is not
    found."""
    one = white(2)
    found, delays = one.found(2.0), one.delays(2.0)
    assert np.array_equal(found, one.size > 2.0)
    # the first tick beyond the crossing
    np.testing.assert_allclose(delays[found], 2.0 / one.size[found] * 0.2, atol=1.001e-3)
    assert np.isnan(delays[~found]).all()
    alarmed = Detector("white", one.quiet, one.size, np.full_like(one.size, 3.0), one.rising)
    assert not alarmed.found(2.0).any()
    point = contact.at(one, 2.0, 50)
    assert point["found_of_large"] == 1.0 and point["smallest_push"] == pytest.approx(2.0, rel=0.1)
    assert point["delay_low"] < point["delay"] < point["delay_high"]


def test_smallest_push_by_logistic_regression():
    """Sizes found with a probability that is logistic in their logarithm: the fit gives its 90 %."""
    seed = 3
    print("seed", seed)
    rng = np.random.default_rng(seed)
    size = np.exp(rng.uniform(np.log(0.05), np.log(8.0), 20_000))
    a, b = 1.5, 2.5
    found = rng.uniform(size=len(size)) < 1.0 / (1.0 + np.exp(-(a + b * np.log(size))))
    exact = math.exp((math.log(9.0) - a) / b)
    assert contact.smallest_push(size, found) == pytest.approx(exact, rel=0.05)
    assert contact.smallest_push(size, np.zeros(len(size), bool)) == math.inf
    assert contact.smallest_push(size, size < 1.0) == math.inf  # larger ones are not found more often


def test_pushes_are_apart_and_within():
    scenario, _ = load_scenario("collision")
    for seed in range(20):
        found = contact.pushes(scenario, seed)
        ends = [p.start + p.duration for p in found]
        assert len(found) == 11 and all(b.start - e >= 0.6 for b, e in zip(found[1:], ends, strict=False))
        assert found[0].start > scenario.transient + 0.5 and ends[-1] < scenario.duration


@pytest.mark.slow
def test_the_whole_of_it():
    """Few short runs: shapes, the sensor among the estimators, a large push found, same for any number of threads."""
    scenario, folder = load_scenario(
        "collision", ["duration=12", "trajectory=[{time: 1, position: 0}, {time: 9, position: 0.8}]"]
    )
    chosen = {"RAREKF": registry.get("RAREKF"), "augmented": registry.get("augmented")}
    one, two = (contact.assess(scenario, folder, chosen, 0.01, 0.2, threads) for threads in (1, 2))
    assert [d.name for d in one] == [contact.SENSOR, "RAREKF", "augmented", f"augmented{contact.BY_LINK}"]
    for a, b in zip(one, two, strict=True):
        assert np.array_equal(a.quiet, b.quiet) and np.array_equal(a.rising, b.rising)
        assert a.quiet.shape == (4, 11) and a.rising.shape == (4, 1, 600)
        assert (np.diff(a.rising, axis=2) >= 0).all()
    (by_link,) = (d for d in one if d.name.endswith(contact.BY_LINK))
    assert by_link.found(float(by_link.quiet.max()))[by_link.size > 3.0].all()
    with pytest.raises(InputError, match="expected a causal estimator"):
        contact.assess(scenario, folder, {"rts_smoother": registry.get("rts_smoother")}, 0.01)
