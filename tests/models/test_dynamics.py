"""The equations of motion against a second implementation (tests/sim/independent.py), and their inverses."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from flexspline.models import dynamics, laws
from flexspline.models.dynamics import State
from flexspline.models.joint import load_joint
from flexspline.models.parameters import PLACES, VARIABLES
from flexspline.models.signals import READINGS

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "sim"))
from independent import derivative, numbers

JOINT = load_joint("test-joint")


def with_everything(rng) -> np.ndarray:
    """A record, shape (1,), of a joint near the test joint with all effects, drawn at random."""
    record = JOINT.record()
    p = record[0]
    for name in ("Jm", "Jw", "Kt", "bm", "Kw0", "dw", "Fc", "vs", "s0", "s1", "bw", "df", "bl", "Jl", "Mg"):
        p[name] *= rng.uniform(0.7, 1.4)
    p["Fs"] = p["Fc"] * rng.uniform(1.0, 1.4)
    p["gravity_angle"] = rng.uniform(-3, 3)
    p["amplitude"][:4], p["order"][:4] = rng.uniform(1e-5, 2e-4, 4), [0.01, 2, 4, 6]
    p["phase"][:4] = rng.uniform(-3, 3, 4)
    p["knee_width"], p["viscous_exponent"], p["backlash"] = rng.uniform(2e-5, 1e-4), rng.uniform(0.5, 0.9), 3e-4
    p["hysteresis_torque"], p["hysteresis_extent"] = 1.0, 8e-5
    p["friction_asymmetry"], p["friction_load"], p["back_driven_friction"] = rng.uniform(-0.4, 0.4), 0.2, 0.5
    p["drift_amplitude"], p["drift_time"] = 1.2, 8.0
    p["friction_temperature"], p["reference_temperature"] = rng.uniform(-0.02, 0.02), 22.0
    p["cable_stiffness"], p["cable_rest"], p["stop_angle"], p["stop_stiffness"] = 1.2, 0.3, 0.1, 30.0
    for group, orders, size in (("cogging", [2, 7, 13], 5e-3), ("friction", [1, 2, 3], 1e-3)):
        p[f"{group}_order"][:3] = orders
        p[f"{group}_amplitude"][:3] = rng.uniform(0.1 * size, size, 3)
        p[f"{group}_phase"][:3] = rng.uniform(-3, 3, 3)
    put_discrepancies(p, rng, ("rotor", "mesh", "flexspline", "link"), 0.02)
    return record


def put_discrepancies(p, rng, places, size):
    """One nonparametric discrepancy at each place, of a variable drawn at random."""
    for k, place in enumerate(places):
        count = int(rng.integers(5, 20))
        p["discrepancy_place"][k] = PLACES.index(place)
        p["discrepancy_variable"][k] = rng.integers(len(VARIABLES))
        p["discrepancy_low"][k], p["discrepancy_high"][k], p["discrepancy_count"][k] = -1.5, 6.0, count
        p["discrepancy_coefficient"][k, :count] = size * rng.standard_normal(count)


def random_state(rng) -> tuple[list[float], State, float, float]:
    """The independent equations' state, ours, motor current [A] and torque on the link [N·m]."""
    theta_w, theta_l = rng.uniform(-50, 50), 0.0
    theta_l = theta_w / 100 + rng.uniform(-2e-3, 2e-3)
    theta_m = theta_w + rng.uniform(-0.03, 0.03)
    wm, wl = 100 * rng.standard_normal(), rng.standard_normal()
    ww = wm + 5 * rng.standard_normal()
    z, dahl = 2e-3 * rng.standard_normal(), 5e-5 * rng.standard_normal()
    current, time, temperature = 2 * rng.standard_normal(), rng.uniform(0, 20), rng.uniform(10, 50)
    x = [theta_m, theta_w, theta_l, wm, ww, wl, z, dahl, 0.0, 0.0]
    return x, State(theta_m, wm, theta_w, ww, theta_l, wl, z, dahl, current, time, temperature), current, time


def test_balance_is_the_equations_of_motion(rng):
    """Every effect on, joints and states at random: the torque on each body is its inertia times its acceleration."""
    for _ in range(300):
        record = with_everything(rng)
        p = record[0]
        x, state, current, time = random_state(rng)
        external = rng.standard_normal()
        rates = derivative(time, x, numbers(record), p["Kt"] * current, external, state.temperature)
        b = dynamics.balance(state, p)
        assert b.on_rotor == pytest.approx(p["Jm"] * rates[3], rel=1e-9, abs=1e-12)
        assert b.on_wave_generator == pytest.approx(p["Jw"] * rates[4], rel=1e-9, abs=1e-11)
        assert b.on_link + external == pytest.approx(p["Jl"] * rates[5], rel=1e-9, abs=1e-9)
        # Its parts are the whole: the joint's torque is what the link's balance leaves to it.
        others = dynamics.link_torque(state, b.load, p)
        assert b.joint_torque == pytest.approx(p["Jl"] * rates[5] - others - external, rel=1e-9, abs=1e-9)
        assert b.gravity == pytest.approx(-p["Mg"] * np.sin(x[2] + p["gravity_angle"]))


def test_balance_of_the_plain_joint(rng):
    for mounting in ("no_load", "link"):
        record = JOINT.record(JOINT.mount(mounting))
        p = record[0]
        for _ in range(50):
            x, state, current, time = random_state(rng)
            rates = derivative(time, x, numbers(record), p["Kt"] * current, 0.0)
            b = dynamics.balance(state, p)
            got = [b.on_rotor / p["Jm"], b.on_wave_generator / p["Jw"], b.on_link / p["Jl"]]
            np.testing.assert_allclose(got, rates[3:6], rtol=1e-9, atol=1e-8)


def test_the_drive_transmits_the_flexsplines_torque(rng):
    """Rotor and wave generator as one body: from current and motion to Tf, the way `balance` goes back."""
    for _ in range(50):
        record = with_everything(rng)
        p = record[0]
        p["discrepancy_place"] = 0.0
        x, _, current, time = random_state(rng)
        state = dynamics.drive_state(x[0], x[3], x[2], x[5], x[6], current, time, 30.0)
        b = dynamics.balance(state, p)
        acceleration = (b.on_rotor + b.on_wave_generator) / (p["Jm"] + p["Jw"])
        Tf = dynamics.transmitted_torque(state, acceleration, b.sliding_friction, b.load, p)
        assert Tf == pytest.approx(b.flexspline_torque, rel=1e-9, abs=1e-9)


def test_measured_torsion_is_the_torsion(rng):
    """From the angles and the true Tw: Eqs. (1), (5), (6)."""
    record = JOINT.record()
    p = record[0]
    for _ in range(50):
        x, state, _, _ = random_state(rng)
        Tw = laws.wave_generator_spring(x[0] - x[1], p)
        torsion, theta_w = dynamics.measured_torsion(x[0], x[2], Tw, p)
        assert theta_w == pytest.approx(x[1], abs=1e-9)
        assert torsion == pytest.approx(dynamics.transmission(state, p).torsion, abs=1e-11)


def test_transmission_seen_through_a_smoother(rng):
    """At rest the smoother shows the whole kinematic error; at a speed at which its order is at the cut-off, half of it."""
    p = JOINT.record()[0]
    p["amplitude"], p["amplitude"][0], p["order"][0] = 0.0, 1e-4, 2.0
    x, state, _, _ = random_state(rng)
    plain = dynamics.transmission(state, p)
    error, slope = laws.kinematic_error(x[1], p), laws.kinematic_error_slope(x[1], p)
    passband = 0.5 / abs(x[4])
    half = dynamics.transmission(state, p, passband)
    assert half.torsion - plain.torsion == pytest.approx(0.5 * error, abs=1e-15)
    assert half.ratio - plain.ratio == pytest.approx(0.5 * slope, abs=1e-15)


@pytest.mark.parametrize("case", ["sliding", "at rest"])
def test_steady_motion_is_the_inverse_of_balance(rng, case):
    """A motion of the link, the current that it takes, and back: the same accelerations, the same joint torque.

    While sliding without a kinematic error, whose part of the drive's velocity `steady_motion` leaves out; at rest with it.
    """
    for _ in range(200):
        record = with_everything(rng)
        p = record[0]
        p["discrepancy_place"] = 0.0
        p["hysteresis_torque"] = 0.0  # follows no position
        q, external, time, temperature = rng.uniform(-1.5, 1.5), 2 * rng.standard_normal(), 3.0, 35.0
        v = rng.choice([-1, 1]) * rng.uniform(0.4, 1.5) if case == "sliding" else 0.0
        a = rng.standard_normal() if case == "sliding" else 0.0
        if case == "sliding":
            p["amplitude"] = 0.0
        theta_m, current, Ts = dynamics.steady_motion(q, v, a, external, time, temperature, p)
        w = p["N"] * v
        wound = laws.flexspline_torsion(Ts + p["bl"] * v, p)
        theta_w = p["N"] * (q + wound)
        for _ in range(30):
            theta_w = p["N"] * (q + wound + laws.kinematic_error(theta_w, p))
        blank = State(theta_m, w, theta_w, w, q, v, 0.0, 0.0, current, time, temperature)
        g = dynamics.sliding_friction(blank, Ts + p["bl"] * v, p)
        b = dynamics.balance(blank._replace(bristle=np.sign(v) * g / p["s0"]), p)
        assert b.joint_torque == pytest.approx(Ts, abs=1e-6)
        assert b.on_link + external == pytest.approx(p["Jl"] * a, abs=1e-6)
        assert b.on_wave_generator == pytest.approx(p["Jw"] * p["N"] * a, abs=1e-8)
        assert b.on_rotor == pytest.approx(p["Jm"] * p["N"] * a, abs=1e-9)


def test_actual_values_invert_readings(rng):
    """What the sensors read of a state, with every sensor effect and a discrepancy of each reading, and back."""
    for _ in range(100):
        record = JOINT.record()
        p = record[0]
        p["motor_eccentricity"], p["motor_eccentricity_phase"] = 1e-3, rng.uniform(-3, 3)
        p["link_zero"] = 1e-3 * rng.standard_normal()
        p["link_error_order"][:3], p["link_error_amplitude"][:3] = [1, 2, 3], [4e-4, 2e-4, 1e-4]
        p["link_error_phase"][:3] = rng.uniform(-3, 3, 3)
        p["current_offset"], p["Kt_drive"] = 0.1, 0.055
        p["torque_gain"], p["torque_offset"], p["torque_rate"] = 1.15, 0.3, -0.03
        put_discrepancies(p, rng, ("joint_torque", "link_position", "motor_current"), 1e-4)
        for k in range(3):  # a discrepancy of known variables
            p["discrepancy_variable"][k] = VARIABLES.index(("link_position", "motor_position", "time")[k])
        _, state, _, _ = random_state(rng)
        b = dynamics.balance(state, p)
        out = np.zeros(1, READINGS)
        dynamics.readings(state, b, p, out[0])
        read = out[0]
        where = (state.motor_position, state.link_position, state.wave_generator_velocity, b.load, state.time)
        link = dynamics.actual_link_position(read["link_position"], *where[:1], where[2], state.time, p)
        assert link == pytest.approx(state.link_position, abs=2e-6)  # first order in an error of 1e-3
        motor = dynamics.actual_motor_position(read["motor_position"], p)
        assert motor == pytest.approx(state.motor_position, abs=2.1e-6)
        assert dynamics.actual_motor_current(read["motor_current"], *where, p) == pytest.approx(state.motor_current)
        beyond = laws.discrepancy(PLACES.index("joint_torque"), *where, p)
        assert read["joint_torque"] == pytest.approx(1.15 * b.joint_torque + 0.3 - 0.03 * state.time + beyond)
        assert read["motor_torque"] == pytest.approx(0.055 * read["motor_current"])
        assert read["temperature"] == state.temperature


# --- a flexible part of the link -------------------------------------------------------------------


def flexible(share=0.25, frequency=18.0, damping=0.03):
    p = JOINT.record()[0]
    p["flexible_share"], p["flexible_frequency"], p["flexible_damping"] = share, frequency, damping
    return p


def test_flexible_step_is_exact_where_the_links_acceleration_is_straight():
    p = flexible()
    w, zeta = 2 * np.pi * 18.0, 0.03
    for h in (1e-4, 1e-3, 4e-3, 0.03):
        for a0, a1 in ((0.0, 0.0), (30.0, 30.0), (-5.0, 40.0)):
            solved = solve_ivp(
                lambda t, y, a0=a0, a1=a1, h=h: [
                    y[1], -w**2 * y[0] - 2 * zeta * w * y[1] - a0 - (a1 - a0) * t / h
                ],
                (0, h), [1e-3, -0.2], "DOP853", rtol=1e-12, atol=1e-15,
            )  # fmt: skip
            got = laws.flexible_step(1e-3, -0.2, a0, a1, h, p)
            np.testing.assert_allclose(got, solved.y[:, -1], rtol=1e-9, atol=1e-12)


def test_flexible_torque_balances_the_parts_acceleration():
    p = flexible(0.3, 12.0, 0.05)
    rates = derivative(0.0, [0.0] * 8 + [1e-3, 0.4], numbers(np.array([p])), 0.0, 0.0)
    inertia = 0.3 * p["Jl"]
    assert laws.flexible_inertia(p) == pytest.approx(inertia)
    assert laws.flexible_torque(1e-3, 0.4, p) == pytest.approx(-inertia * (rates[9] + rates[5]))
