"""The payload observers' model: a Kalman update with the current's equation written a second time."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from flexspline.estimator.filters.payload import (
    SIZE,
    Seen,
    external_torque,
    forget,
    friction_error,
    noise,
    prior,
    slow_friction,
    update,
)  # fmt: skip
from flexspline.models.dynamics import drive_state


@pytest.fixture
def p(known):
    """The test joint with friction that depends on load, a tenth of it, of which a part acts while the load drives."""
    return known.with_numbers(friction_load=0.1, back_driven_friction=0.4).p


def torque(x, link, velocity, acceleration, own, p) -> float:
    """The joint torque: own torque less the payload's, and the bearing's friction."""
    alpha, beta, inertia = x[:3]
    return own - (alpha * np.sin(link) + beta * np.cos(link) - inertia * acceleration) + p["bl"] * velocity


def current(x, link, velocity, acceleration, own, p) -> float:
    """I = c·T + r at a state [α, β, J, κ, r]."""
    w, mu = p["N"] * velocity, p["friction_load"] * abs(np.tanh(p["N"] * velocity))
    T = torque(x, link, velocity, acceleration, own, p)
    return (1 + mu if T * w > 0 else 1 - x[3] * mu) * T + x[4]


@pytest.mark.parametrize("velocity", [0.8, -0.8, 0.004, -1e-3])
@pytest.mark.parametrize("own", [30.0, -30.0])
def test_an_update_is_kalmans(rng, p, velocity, own):
    link, acceleration, rotor, rotor_acceleration, deviation = 0.7, -1.5, 0.4, -200.0, 0.8
    A = rng.standard_normal((SIZE, SIZE))
    P, at = A @ A.T, np.array([2.0, -1.0, 0.3, 0.5])
    x = np.append(at + 0.1 * rng.standard_normal(4), 0.2)
    w = p["N"] * velocity
    # Sliding friction without load, its bristle steady at that velocity; viscous friction.
    g = p["Fc"] + (p["Fs"] - p["Fc"]) * np.exp(-((w / p["vs"]) ** 2))
    z = g / p["s0"] * np.tanh(w)
    friction = p["s0"] * z + p["s1"] * (w - p["s0"] * abs(w) / g * z) + p["bw"] * w
    measured = p["N"] * (rotor - friction - (p["Jm"] + p["Jw"]) * rotor_acceleration)

    about, motion = np.append(at, 0.0), (link, velocity, acceleration, own, p)
    H = np.array([(current(about + d, *motion) - current(about - d, *motion)) / 2e-6 for d in 1e-6 * np.eye(SIZE)])
    near_rest = 4.0 * p["N"] * p["Fc"] * np.exp(-abs(w) / (4.0 * p["vs"]))
    gain = P @ H / (deviation**2 + near_rest**2 + H @ P @ H)
    expected = x + gain * (measured - current(about, *motion) - H @ (x - about))
    covariance = P - np.outer(gain, H @ P)

    state = drive_state(p["N"] * link, w, link, velocity, 0.0, 0.0, 0.0, 25.0)
    update(x, P, Seen(state, rotor_acceleration, acceleration, rotor, own), at, deviation, p)
    np.testing.assert_allclose(x, expected, rtol=1e-6)
    np.testing.assert_allclose(P, covariance, rtol=1e-6, atol=1e-8)


def test_prior(known):
    """A payload of 0.7 rated torques, its inertia as a metre away; friction off by its tolerance, a twentieth at least."""
    mean, deviation = prior(known).T
    moment = 0.7 * known.rated_torque
    np.testing.assert_allclose(mean, [0, 0, 0, known.p["back_driven_friction"], 0])
    np.testing.assert_allclose(
        deviation, [moment, moment, moment / 9.81, known.back_driven, friction_error(known)], rtol=1e-12
    )
    level = known.p["N"] * known.p["Fc"]
    for share, expected in ((0.2, 0.2), (0.01, 0.05)):
        assert friction_error(replace(known, friction=share)) == pytest.approx(expected * level)


def test_noise_is_the_currents_or_a_part_of_the_rated_torque(known):
    scale = known.p["N"] * known.p["Kt"]
    loud = replace(known, noise=replace(known.noise, current_noise=10.0))
    assert noise(loud) == pytest.approx(1.2 * scale * 10.0)
    assert noise(replace(known, noise=replace(known.noise, current_noise=0.0))) == pytest.approx(
        0.009 * known.rated_torque
    )


def test_torque_of_a_payload():
    x = np.array([2.0, 3.0, 0.5])
    assert external_torque(x, 0.3, 4.0) == pytest.approx(2.0 * np.sin(0.3) + 3.0 * np.cos(0.3) - 0.5 * 4.0)


def test_friction_near_rest_is_unknown_up_to_its_level(known):
    assert slow_friction(0.0, known.p) == pytest.approx(4.0 * known.p["N"] * known.p["Fc"])
    ratio = slow_friction(-8.0 * known.p["vs"], known.p) / slow_friction(0.0, known.p)
    assert ratio == pytest.approx(np.exp(-2.0))


def test_forgetting_returns_to_the_prior(rng):
    A = rng.standard_normal((SIZE, SIZE))
    x, P = rng.standard_normal(SIZE), A @ A.T
    D = np.diag([1.0, 1.0, 1.0, 1.0, 0.3])
    moved, covariance = D @ x, D @ P @ D + np.diag([0, 0, 0, 0, 2.0 * (1 - 0.09)])
    forget(x, P, 0.3, 2.0)
    np.testing.assert_allclose(x, moved, rtol=1e-12)
    np.testing.assert_allclose(P, covariance, rtol=1e-12)
