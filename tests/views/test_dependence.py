"""What a residual depends on: found where it was put."""

from __future__ import annotations

import numpy as np
import pytest

from flexspline.views.residuals import ORDERS, ResidualSeries, explained, means, orders, strongest_variable


@pytest.fixture
def balance(rng):
    """Return a function: residual before → a balance whose variables are random and whose noise is 0.01 A."""
    k = 4000
    velocity, link = rng.uniform(-60, 60, k), rng.uniform(-1, 1, k)
    other = {name: rng.uniform(0, 9, k) for name in ("time", "motor", "load")}
    noise, rising = 0.01 * rng.standard_normal(k), rng.random(k) < 0.5

    def made(effect) -> ResidualSeries:
        before = noise + effect(velocity, link)
        return ResidualSeries(
            "motor_current", "A", before, noise, 0.01, link=link, velocity=velocity, rising=rising, **other
        )

    return made


def test_variable_that_gives_the_cause_away(balance):
    quiet = balance(lambda velocity, link: 0.0)
    stepped = balance(lambda velocity, link: 0.1 * np.sign(velocity))
    b, key, share = strongest_variable([quiet, stepped])
    assert b is stepped and key in ("direction", "velocity") and share > 0.9
    assert explained(b, b.after, key) < 0.05
    _, key, _ = strongest_variable([balance(lambda velocity, link: 0.1 * (link > 0.5))])
    assert key == "link"
    assert strongest_variable([quiet]) is None


def test_means_of_bins_follow_the_residual(balance):
    b = balance(lambda velocity, link: link)
    x, mean = means(b.link, b.before, b.limits("link"))
    np.testing.assert_allclose(mean, x, atol=0.02)


def test_orders_are_found_by_least_squares():
    motor = np.linspace(-300, 400, 20000)
    amplitude = orders(motor, 0.3 * np.sin(2 * motor + 1) + 0.1 * np.cos(0.5 * motor) + 0.05)
    expected = np.where(ORDERS == 2, 0.3, np.where(ORDERS == 0.5, 0.1, 0.0))
    np.testing.assert_allclose(amplitude, expected, atol=5e-3)
