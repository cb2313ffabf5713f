"""Torque control: margins against the eigenvalues of the linear loop, bandwidth and bisection in closed form."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.linalg import expm

from benchmarks import torque_loops as torque_control
from benchmarks.draws import median
from flexspline.models import laws
from flexspline.models.errors import InputError
from flexspline.scenarios.scenario import load_scenario
from flexspline.sim.loop import CONTROL_PERIOD

FREE = ["Fc=1e-6", "Fs=1e-6", "s0=1e-3", "s1=0", "bw=0", "bm=0"]
"""A joint without friction: its bolted torque loop is linear but for the springs."""


def frictionless(*more: str):
    changes = [f"plant.{one}" for one in FREE] + [
        "sensors.joint_torque.noise=0",
        "sensors.motor_encoder.counts=1000000",
    ]
    return load_scenario("external_push", [*changes, "duration=3", "trajectory=[{time: 0, position: 0}]", *more])


def critical_gain(p, loop: torque_control.Loop, torque: float) -> float:
    """Gain at which the sampled linear loop has an eigenvalue on the unit circle.

    Rotor, wave generator, winding; the output fixed; springs with their slopes at a torque [N·m]; the command held over each
    control period, of the encoder at its start and the torque sensor a period before, through the velocity's low-pass.
    """
    N, h = p["N"], 1e-6
    spring_f = (laws.flexspline_spring(laws.flexspline_torsion(torque, p) + h, p) - torque) / h
    Tw = torque / N
    delta = laws.wave_generator_torsion(Tw, p)
    spring_w = (laws.wave_generator_spring(delta + h, p) - laws.wave_generator_spring(delta, p)) / h
    slope = 1.0 / N
    A = np.zeros((6, 6))  # θm, ωm, θw, ωw, i, command
    A[0, 1] = A[2, 3] = 1.0
    A[1, :4] = np.array([-spring_w, -p["dw"], spring_w, p["dw"]]) / p["Jm"]
    A[1, 4] = p["Kt"] / p["Jm"]
    A[3, :4] = np.array([spring_w, p["dw"], -spring_w - spring_f * slope**2, -p["dw"] - p["df"] * slope**2]) / p["Jw"]
    A[4, 4], A[4, 5] = -p["R"] / p["L"], p["R"] / p["L"]
    step = expm(A * CONTROL_PERIOD)
    controller = torque_control.impedance(loop.stiffness, loop.damping, 0.0, p)
    share = 1.0 - math.exp(-CONTROL_PERIOD / controller.velocity_filter)
    unit = N * p["Kt"]

    def radius(gain: float) -> float:
        # State: plant (5), velocity filter, last angle, torque a period before.
        M = np.zeros((8, 8))
        velocity = np.zeros(8)
        velocity[0], velocity[6], velocity[5] = share / CONTROL_PERIOD, -share / CONTROL_PERIOD, 1.0 - share
        command = -(1.0 + gain) * controller.kd * velocity
        command[0] -= (1.0 + gain) * controller.kp
        command[7] -= gain / unit
        M[:5, :5] = step[:5, :5]
        M[:5] += np.outer(step[:5, 5], command)
        M[5], M[6, 0] = velocity, 1.0
        M[7, 2], M[7, 3] = spring_f * slope, p["df"] * slope
        return float(np.abs(np.linalg.eigvals(M)).max())

    return torque_control.largest(lambda g: radius(g) < 1.0, 0.05, 100.0, 1.001)


def test_the_gain_margin_is_that_of_the_linear_loop():
    """Without friction and noise, with the torque sensor fed back."""
    scenario, folder = frictionless()
    loop = torque_control.Loop(gain=0.5)
    found = torque_control.assess(scenario, folder, None, 1, 0.0, loop)
    joint, _ = scenario.load_joint(folder)
    exact = critical_gain(joint.record()[0], loop, 1.0) / loop.gain
    print(f"gain margin {found.gain_margin:.2f}, linear loop {exact:.2f}")
    assert found.gain_margin == pytest.approx(exact, rel=0.15)


def test_bisection_and_crossing():
    assert torque_control.largest(lambda x: x < 3.0, 0.1, 50.0, 1.01) == pytest.approx(3.0, rel=0.01)
    assert torque_control.largest(lambda x: False, 0.1, 50.0) == 0.0
    assert torque_control.largest(lambda x: True, 0.1, 50.0) == math.inf
    f = np.geomspace(1.0, 200.0, 40)
    first_order = 1.0 / np.sqrt(1.0 + (f / 30.0) ** 2)
    assert torque_control.crossing(f, first_order, 1 / math.sqrt(2)) == pytest.approx(30.0, rel=0.01)
    assert torque_control.crossing(f, first_order, 0.01) == math.inf


def test_a_torque_loop_takes_friction_off():
    """Friction and the rotor's inertia, which are all of the error, are at most 1/(1 + kT) of what they are without: sliding
    exactly, at rest anything below: pushes make it slide."""
    scenario, folder = load_scenario("external_push")
    errors = [
        torque_control.assess(scenario, folder, None, 3, 0.0, torque_control.Loop(gain=g)).error for g in (0.0, 1.0)
    ]
    print(f"error {errors[0]:.2f} N·m without, {errors[1]:.2f} N·m with the loop")
    assert 0.0 < errors[1] < 0.55 * errors[0]


def test_the_impedance_of_a_controller():
    """Stiffness, damping and weight come out as torques; with the loop the drive asks for 1 + kT times as much."""
    p = load_scenario("external_push")[0].load_joint()[0].record()[0]
    controller = torque_control.impedance(600.0, 30.0, 3.0, p)
    n = 4000
    position, velocity = np.full(n, 0.1), np.zeros(n)
    measured = 100.0 * (0.05 + 0.2 * np.arange(n) * CONTROL_PERIOD)
    u = torque_control.wanted(controller, position, velocity, measured, p, CONTROL_PERIOD)
    expected = 600.0 * (0.1 - measured / 100.0) - 30.0 * 0.2 + p["Mg"] * np.sin(measured / 100.0)
    np.testing.assert_allclose(u[200:], expected[200:], rtol=1e-9, atol=1e-9)
    closed, opened = (controller.record(p, CONTROL_PERIOD, feedback)[0] for feedback in (True, False))
    assert closed["kp"] == pytest.approx(4.0 * opened["kp"]) and opened["torque_gain"] == 0.0
    assert closed["torque_gain"] == pytest.approx(-3.0 / (p["N"] * p["Kt"]))


def test_medians_hold_for_any_distribution():
    """n = 30: the tenth from either end (P(Bin(30, ½) ≤ 9) = 2.1 %), Hollander & Wolfe's table; infinite values are values."""
    x = np.r_[np.arange(25.0), np.full(5, np.inf)]
    found = median(x)
    assert (found.mean, found.low, found.high, found.n) == (14.5, 9.0, 20.0, 30)
    assert median(np.full(7, np.inf)).mean == math.inf and math.isnan(median([1.0, 2.0, 3.0]).low)


def test_one_that_looks_ahead_is_refused():
    from flexspline.estimator import registry

    scenario, folder = load_scenario("external_push", ["duration=3"])
    with pytest.raises(InputError, match="looks ahead"):
        torque_control.assess(scenario, folder, registry.get("rts_smoother"), 1, 0.0)
