"""The laws against their inverses, difference quotients, SciPy's ODE solver and SciPy's B-spline."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.interpolate import BSpline

from flexspline.models import laws
from flexspline.models.joint import load_joint
from flexspline.models.parameters import PLACES, VARIABLES


@pytest.fixture
def p():
    return load_joint("test-joint").record()[0]


@pytest.mark.parametrize("backlash", [0.0, 4e-4])
def test_flexspline_spring_inverts_equation_2(p, backlash):
    p["backlash"] = backlash
    for torque in np.concatenate([np.linspace(-30, 30, 121), [-12.0, -3.9, 3.9, 12.0]]):
        torsion = laws.flexspline_torsion(torque, p)
        assert laws.flexspline_spring(torsion, p) == pytest.approx(torque, abs=1e-11)
    assert laws.flexspline_spring(0.0, p) == 0.0


def test_flexspline_spring_as_printed(p):
    """Eq. (2): slopes K1, K2, K3 with breakpoints at the torques T1, T2; odd."""
    step = 1e-9
    for torque, slope in ((1.0, 8400), (8.0, 9400), (20.0, 13000)):
        x = laws.flexspline_torsion(torque, p)
        got = (laws.flexspline_spring(x + step, p) - laws.flexspline_spring(x - step, p)) / (2 * step)
        assert got == pytest.approx(slope, rel=1e-6)
        assert laws.flexspline_spring(-x, p) == -laws.flexspline_spring(x, p)
    assert laws.flexspline_torsion(3.9, p) == pytest.approx(3.9 / 8400)
    assert laws.flexspline_torsion(12.0, p) == pytest.approx(3.9 / 8400 + 8.1 / 9400)


@pytest.mark.fast_every(2)
@pytest.mark.parametrize("backlash", [0.0, 4e-4])
@pytest.mark.parametrize("width", [5e-5, 2e-4, 1e-3])
def test_smooth_breakpoints(p, width, backlash):
    """Continuous with a continuous slope, odd, zero at rest, as printed away from the breakpoints; the inverse is right."""
    p["backlash"] = backlash
    x = np.linspace(0.0, 4e-3, 40_001)
    printed = np.array([laws.flexspline_spring(v, p) for v in x])
    p["knee_width"] = width
    smooth = np.array([laws.flexspline_spring(v, p) for v in x])
    odd = np.array([laws.flexspline_spring(-v, p) for v in x[::100]])
    np.testing.assert_array_equal(odd, -smooth[::100])
    assert smooth[0] == 0.0 and np.all(np.diff(smooth[x > 0.5 * backlash + 1e-9]) > 0)
    reach = min(width, 3.9 / 8400)  # no wider than the first place is far: the law is zero at rest
    breakpoints = 0.5 * backlash + np.array([3.9 / 8400, 3.9 / 8400 + 8.1 / 9400])
    away = np.all(np.abs(x[:, None] - breakpoints) > reach + 1e-7, axis=1)
    np.testing.assert_allclose(smooth[away], printed[away], atol=1e-9)
    excess = (smooth - printed)[~away]
    assert excess.min() > -1e-9
    # At a place a parabola is (K' − K)·width/4 above it.
    for place, K in zip(breakpoints, ((8400, 9400), (9400, 13000)), strict=True):
        if np.ptp(breakpoints) > 2 * reach:
            above = laws.flexspline_spring(place, p) - np.interp(place, x, printed)
            assert above == pytest.approx((K[1] - K[0]) * reach / 4, rel=0.02)
    step = 1e-9
    for v in np.linspace(0.5 * backlash + 1e-6, 4e-3, 200):
        slope = (laws.flexspline_spring(v + step, p) - laws.flexspline_spring(v - step, p)) / (2 * step)
        assert laws.flexspline_stiffness(v, p) == pytest.approx(slope, rel=1e-4)
        assert laws.flexspline_stiffness(-v, p) == laws.flexspline_stiffness(v, p)
    for torque in np.linspace(-40, 40, 201):
        assert laws.flexspline_spring(laws.flexspline_torsion(torque, p), p) == pytest.approx(torque, abs=1e-10)


def test_flexspline_stiffness_of_the_printed_law(p):
    p["backlash"] = 2e-4
    for torque, slope in ((1.0, 8400), (8.0, 9400), (20.0, 13000), (-20.0, 13000)):
        assert laws.flexspline_stiffness(laws.flexspline_torsion(torque, p), p) == slope
    assert laws.flexspline_stiffness(0.9e-4, p) == 0.0


def test_dead_zone(p):
    p["backlash"] = 4e-4
    assert laws.flexspline_spring(1.9e-4, p) == 0.0
    assert laws.flexspline_spring(-1.9e-4, p) == 0.0
    assert laws.flexspline_spring(3e-4, p) == pytest.approx(8400 * 1e-4)


def test_wave_generator_inverts_equation_5(p):
    for torque in (-0.8, -0.3, 0.2905, 0.5, 1.2):  # on the tangent beyond the logarithm's end, and about it
        assert laws.wave_generator_spring(laws.wave_generator_torsion(torque, p), p) == pytest.approx(torque, rel=1e-9)
    for torque in np.linspace(-0.29, 0.29, 101):
        torsion = laws.wave_generator_torsion(torque, p)
        assert torsion == pytest.approx(np.sign(torque) * (1 - np.exp(-20 * abs(torque))) / (20 * 1.14), abs=1e-15)
        assert laws.wave_generator_spring(torsion, p) == pytest.approx(torque, rel=1e-8, abs=1e-13)


def test_wave_generator_continues_beyond_its_logarithm(p):
    """δ = 1/(Cw·Kw0) is the end of Eq. (5); beyond it the torque continues as a straight line, not as NaN."""
    end = (1 - 1e-6) / (20 * 1.14)
    x = end + np.array([-1e-9, 0, 1e-9, 1e-4, 1e-2, 1.0])
    torque = np.array([laws.wave_generator_spring(value, p) for value in x])
    assert np.isfinite(torque).all()
    assert (np.diff(torque) > 0).all()
    slope_before, slope_after = np.diff(torque)[:2] / 1e-9
    assert slope_before == pytest.approx(slope_after, rel=2e-2)


def test_kinematic_error_slope(p, rng):
    step = 1e-6
    for angle in rng.uniform(-300, 300, 100):
        quotient = (laws.kinematic_error(angle + step, p) - laws.kinematic_error(angle - step, p)) / (2 * step)
        assert laws.kinematic_error_slope(angle, p) == pytest.approx(quotient, abs=1e-12 / step * 1e-1)
    assert laws.kinematic_error(0.0, p) == pytest.approx(1.2e-4 * np.sin(0.3) + 2e-5 * np.sin(1.1))


@pytest.mark.parametrize("w", [0.0, 1e-9, 0.3, -0.3, 5.0, -100.0])
@pytest.mark.parametrize("h", [2e-4, 1e-3])
def test_bristle_step_is_exact(p, w, h):
    """At constant velocity, against SciPy: also where the rate is stiff, 5.5e4 1/s at 100 rad/s."""
    g = laws.stribeck_friction(w, 0.0, 0.0, 0.0, 25.0, p)
    for z in (0.0, 1.2e-3, -2.0e-3):
        solved = solve_ivp(lambda _, y, g=g: w - p["s0"] * abs(w) / g * y, (0, h), [z], "Radau", rtol=1e-11, atol=1e-16)
        assert laws.bristle_step(z, w, g, h, p) == pytest.approx(solved.y[0, -1], rel=1e-8, abs=1e-14)


@pytest.mark.parametrize("v", [0.0, 1e-4, -1e-4, 0.02, -1.0])
def test_dahl_step_is_exact(p, v):
    p["hysteresis_extent"], p["hysteresis_torque"] = 80e-6, 1.0
    for z in (0.0, 5e-5, -8e-5):
        solved = solve_ivp(lambda _, y: v - abs(v) * y / 80e-6, (0, 1e-3), [z], "Radau", rtol=1e-11, atol=1e-18)
        assert laws.dahl_step(z, v, 1e-3, p) == pytest.approx(solved.y[0, -1], rel=1e-8, abs=1e-16)
    assert laws.hysteresis_torque(40e-6, p) == pytest.approx(0.5)


def test_steady_sliding_friction_is_the_stribeck_curve(p):
    for w in (0.5, 2.0, 50.0, -4.0):
        g = laws.stribeck_friction(w, 0.0, 0.0, 0.0, 25.0, p)
        assert g == pytest.approx(0.018 + 0.004 * np.exp(-((w / 2) ** 2)))
        z = laws.bristle_step(0.0, w, g, 10.0, p)
        assert laws.mesh_friction(z, w, g, p) == pytest.approx(np.sign(w) * g, rel=1e-9)


def test_effects_on_the_stribeck_curve(p):
    """As recording.md's table states them, alone and never below zero."""
    w, load = 3.0, 20.0
    plain = laws.stribeck_friction(w, 0.4, load, 5.0, 25.0, p)
    for changes, expected in (
        ({"friction_asymmetry": 0.3}, lambda s: plain * (1 + 0.3 * s)),
        ({"drift_amplitude": 1.2, "drift_time": 8.0}, lambda s: plain * (1 + 1.2 * np.exp(-5 / 8))),
        ({"friction_load": 0.2}, lambda s: plain + 0.2 * load / 100),
        (
            {"friction_amplitude": 0.01, "friction_order": 2.0, "friction_phase": 0.5},
            lambda s: plain + 0.01 * np.sin(1.3),
        ),
        ({"friction_amplitude": 0.1, "friction_order": 1.0, "friction_phase": -2.0}, lambda s: 1e-5),
    ):
        q = p.copy()
        for name, value in changes.items():
            if q[name].ndim:
                q[name][0] = value
            else:
                q[name] = value
        for sign in (1.0, -1.0):
            assert laws.stribeck_friction(sign * w, 0.4, load, 5.0, 25.0, q) == pytest.approx(expected(sign)), changes


def test_back_driven_friction_is_a_share_of_the_load_dependent_friction(p):
    p["friction_load"], p["back_driven_friction"] = 0.2, 0.25
    plain = 0.018 + 0.004 * np.exp(-((3.0 / 2) ** 2))
    assert laws.stribeck_friction(3.0, 0.0, 20.0, 0.0, 25.0, p) == pytest.approx(plain + 0.04)
    assert laws.stribeck_friction(-3.0, 0.0, 20.0, 0.0, 25.0, p) == pytest.approx(plain + 0.01)


@pytest.mark.parametrize("exponent", [0.5, 0.7, 0.9])
def test_viscous_friction_less_than_linear(p, exponent):
    """bw w near rest, |w| to the stated power far above 20 Stribeck velocities; odd, rising, never more than linear."""
    p["viscous_exponent"] = exponent
    w = np.geomspace(1e-3, 1e5, 400)
    got = np.array([laws.viscous_friction(v, 25.0, p) for v in w])
    assert np.all(np.diff(got) > 0) and np.all(got <= 6e-5 * w * (1 + 1e-12))
    np.testing.assert_allclose(got[w < 0.4], 6e-5 * w[w < 0.4], rtol=1e-4)
    slope = np.gradient(np.log(got), np.log(w))
    np.testing.assert_allclose(slope[w > 4e3], exponent, atol=1e-3)
    assert laws.viscous_friction(-50.0, 25.0, p) == -laws.viscous_friction(50.0, 25.0, p)
    at = 20 * 2.0
    assert laws.viscous_friction(at, 25.0, p) == pytest.approx(6e-5 * at * 2 ** ((exponent - 1) / 2))


def test_friction_falls_as_the_gear_warms(p):
    """g(w) and bw × (1 + c (ϑ − ϑ0)), the load's part too; never below a tenth."""
    p["friction_temperature"], p["reference_temperature"], p["friction_load"] = -0.015, 20.0, 0.2
    cold = laws.stribeck_friction(3.0, 0.0, 8.0, 0.0, 20.0, p)
    for temperature in (-10.0, 20.0, 35.0, 60.0):
        factor = 1 - 0.015 * (temperature - 20.0)
        assert laws.stribeck_friction(3.0, 0.0, 8.0, 0.0, temperature, p) == pytest.approx(factor * cold)
        assert laws.viscous_friction(-9.0, temperature, p) == pytest.approx(-factor * 9 * 6e-5)
    assert laws.stribeck_friction(3.0, 0.0, 8.0, 0.0, 500.0, p) == pytest.approx(0.1 * cold)


def test_kinematic_error_of_any_order(p):
    """Order 6 of the wave generator, and once per turn of the link, 1/N."""
    p["amplitude"][2:4], p["order"][2:4], p["phase"][2:4] = [1.5e-5, 2e-5], [6, 0.01], [0.4, -0.9]
    for link in np.linspace(-3, 3, 13):
        w = 100 * link
        expected = 1.2e-4 * np.sin(2 * w + 0.3) + 2e-5 * np.sin(4 * w + 1.1)
        expected += 1.5e-5 * np.sin(6 * w + 0.4) + 2e-5 * np.sin(link - 0.9)
        assert laws.kinematic_error(w, p) == pytest.approx(expected, abs=1e-15)


def test_rotor_and_link_torques(p):
    p["cogging_amplitude"][:2], p["cogging_order"][:2], p["cogging_phase"][:2] = [5e-3, 2e-3], [6, 13], [0.1, 0.2]
    assert laws.cogging_torque(0.7, p) == pytest.approx(5e-3 * np.sin(4.3) + 2e-3 * np.sin(9.3))
    p["cable_stiffness"], p["cable_rest"], p["stop_stiffness"], p["stop_angle"] = 1.2, 0.3, 25.0, 0.8
    assert laws.link_torque(0.5, p) == pytest.approx(-1.2 * 0.2)
    assert laws.link_torque(1.0, p) == pytest.approx(-1.2 * 0.7 - 25 * 0.2)


def test_readings(p):
    p["link_zero"] = 1e-3
    p["link_error_order"][0], p["link_error_amplitude"][0], p["link_error_phase"][0] = 1.0, 4e-4, 0.6
    assert laws.link_reading(0.9, p) == pytest.approx(0.9 + 1e-3 + 4e-4 * (np.sin(1.5) - np.sin(0.6)))
    p["link_error_order"][1], p["link_error_amplitude"][1], p["link_error_phase"][1] = 2.0, 1e-5, -0.3
    more = 1e-5 * (np.sin(1.5) - np.sin(-0.3))
    assert laws.link_reading(0.9, p) == pytest.approx(0.9 + 1e-3 + 4e-4 * (np.sin(1.5) - np.sin(0.6)) + more)
    assert laws.motor_reading(0.9, p) == 0.9
    p["motor_eccentricity"], p["motor_eccentricity_phase"] = 8e-4, 2.0
    assert laws.motor_reading(0.9, p) == pytest.approx(0.9 + 8e-4 * (np.sin(2.9) - np.sin(2.0)))
    p["current_offset"], p["torque_gain"], p["torque_offset"], p["torque_rate"] = 0.1, 1.1, 0.3, -0.02
    assert laws.current_reading(2.0, p) == pytest.approx(2.1)
    assert laws.torque_reading(5.0, 10.0, p) == pytest.approx(5.5 + 0.3 - 0.2)


def test_discrepancy_is_a_cubic_b_spline(p, rng):
    """Uniform grid, clamped outside [low, high]; against SciPy's."""
    coefficients = rng.standard_normal(9)
    low, high = -3.0, 5.0
    p["discrepancy_place"][0], p["discrepancy_variable"][0] = PLACES.index("mesh"), VARIABLES.index("motor_velocity")
    p["discrepancy_low"][0], p["discrepancy_high"][0], p["discrepancy_count"][0] = low, high, 9
    p["discrepancy_coefficient"][0, :9] = coefficients
    assert laws.has_discrepancy(p)
    spacing = (high - low) / (9 - 3)
    spline = BSpline(low + spacing * np.arange(-3, 10), coefficients, 3)
    for x in np.concatenate([np.linspace(low, high - 1e-9, 101), [-10.0, 12.0]]):
        got = laws.discrepancy(PLACES.index("mesh"), 0.0, 0.0, x, 0.0, 0.0, p)
        assert got == pytest.approx(float(spline(np.clip(x, low, high - 1e-12))), abs=1e-10), x
    assert laws.discrepancy(PLACES.index("link"), 0.0, 0.0, 1.0, 0.0, 0.0, p) == 0.0


def test_discrepancy_variables(p):
    """Each variable reaches the spline: a straight line through it gives it back."""
    place = PLACES.index("link")
    state = {"link_position": 0.4, "motor_position": 1.3, "motor_velocity": -0.6, "load": 0.7, "time": 0.2}
    p["discrepancy_place"][0], p["discrepancy_low"][0], p["discrepancy_high"][0], p["discrepancy_count"][0] = (
        place,
        -2.0,
        2.0,
        7,
    )
    p["discrepancy_coefficient"][0, :7] = (
        -2.0 + np.arange(-1, 6) * 1.0
    )  # Greville abscissae: the spline is the identity
    arguments = (state["motor_position"], state["link_position"], state["motor_velocity"], state["load"], state["time"])
    for name, value in state.items():
        p["discrepancy_variable"][0] = VARIABLES.index(name)
        assert laws.discrepancy(place, *arguments, p) == pytest.approx(value), name
    p["discrepancy_variable"][0] = VARIABLES.index("motor_position_two_turns")
    for turns in (-3, 0, 5):
        assert laws.discrepancy(place, 1.3 + 4 * np.pi * turns, *arguments[1:], p) == pytest.approx(1.3)
    p["discrepancy_variable"][0] = VARIABLES.index("direction_link_position")
    assert laws.discrepancy(place, *arguments, p) == pytest.approx(0.4 * np.tanh(-0.6))


def test_stiffness_of_the_wave_generator_is_the_slope_of_its_spring(p):
    for torsion in (1e-4, 5e-3, -2e-2, 0.99 / (p["Cw"] * p["Kw0"])):
        step = 1e-9
        rise = laws.wave_generator_spring(torsion + step, p) - laws.wave_generator_spring(torsion - step, p)
        assert laws.wave_generator_stiffness(torsion, p) == pytest.approx(rise / (2 * step), rel=1e-3)


def test_seen_through_a_smoother_harmonics_are_smaller(p):
    for angle in (0.0, 1.3, -250.0):
        still = laws.smoothed_kinematic_error(angle, 0.0, p)
        assert still == pytest.approx((laws.kinematic_error(angle, p), laws.kinematic_error_slope(angle, p)))
    p["amplitude"][1:] = 0.0
    p["order"][0] = 2.0
    at_cutoff = laws.smoothed_kinematic_error(0.4, 0.5, p)
    assert at_cutoff == pytest.approx((0.5 * laws.kinematic_error(0.4, p), 0.5 * laws.kinematic_error_slope(0.4, p)))
