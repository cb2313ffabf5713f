"""Characteristics of a description, against the specification, textbook formulas and the test joint's reference."""

from __future__ import annotations

import numpy as np
import pytest

from flexspline.models.characteristics import characteristics, drive_gains
from flexspline.models.files import parse
from flexspline.models.joint import Joint, known_joints, load_joint
from flexspline.models.laws import stribeck_friction
from flexspline.scenarios.run import run_scenario
from flexspline.scenarios.scenario import Scenario

JOINT = load_joint("test-joint")


@pytest.fixture(scope="module")
def found():
    return characteristics(JOINT)


def test_half_width_is_that_of_the_independent_solution(found):
    """joint.md: half the width of the locked rotor's loop at Tf = 0 is 0.157 mrad."""
    assert found.half_width == pytest.approx(0.157e-3, abs=1e-6)
    assert 0 < found.half_width_deviation < found.half_width


def test_the_loop_is_that_of_the_reference(found, reference):
    """The reference's slow loop up and down, an independent integrator's."""
    columns = reference("locked_rotor")
    torque, link = columns["flexspline_torque"], columns["link_position"]
    after = slice(len(torque) // 3, None)
    reach = np.abs(torque[after]).max()
    zero = np.flatnonzero(np.diff(np.signbit(torque[after])))
    width = np.ptp(link[after][zero]) / 2
    assert found.half_width == pytest.approx(width, rel=0.03)
    assert np.abs(found.loop_torque).max() == pytest.approx(JOINT.numbers["rated_torque"].value) and reach > 0


def test_torsion_is_both_springs(found):
    n = {symbol: number.value for symbol, number in JOINT.numbers.items()}
    for torque in (1.0, 10.0, 20.0):
        parts = [
            min(torque, n["T1"]) / n["K1"],
            max(min(torque, n["T2"]) - n["T1"], 0) / n["K2"],
            max(torque - n["T2"], 0) / n["K3"],
        ]
        wound = (1 - np.exp(-n["Cw"] * torque / n["N"])) / (n["Cw"] * n["Kw0"]) / n["N"]
        assert np.interp(torque, found.torque, found.torsion) == pytest.approx(sum(parts) + wound, rel=2e-3)


def test_friction_is_the_stribeck_curve_at_the_output(found):
    p = JOINT.record()[0]
    k = len(found.speed) // 2
    w = found.speed[k]
    own = stribeck_friction(w, 0.0, 0.0, 0.0, 25.0, p) + (p["bw"] + p["bm"]) * w
    assert found.friction[k] == pytest.approx(p["N"] * own + p["bl"] * w / p["N"])
    assert found.output_speed[k] == pytest.approx(w / 100)


def test_resonances_are_those_of_two_masses(found):
    """Link on both springs in series, rotor held; the wave generator's own inertia is small against the link's."""
    n = {symbol: number.value for symbol, number in JOINT.numbers.items()}
    for name in ("link",):
        stiffness = 1 / (1 / n["K1"] + 1 / (n["N"] ** 2 * n["Kw0"]))
        expected = np.sqrt(stiffness / JOINT.mountings[name].inertia) / (2 * np.pi)
        (held,) = [r for r in found.resonances if (r.mounting, r.rotor, r.torque) == (name, "held", 0.0)]
        assert held.frequency == pytest.approx(expected, rel=0.03)
        assert 0 < held.deviation < 0.2 * held.frequency


def test_resolution_is_the_counts_torsion(found):
    motor, link = 2 * np.pi / 4096 / 100, 2 * np.pi / 2**20
    assert found.counts == pytest.approx((motor, link))
    assert found.noise == pytest.approx(np.sqrt(motor**2 / 12 + link**2 / 12 + 1.5e-6**2))
    assert found.torque_resolution == pytest.approx(found.noise * found.stiffness)


def test_gains_are_the_test_joints_in_proportion():
    assert drive_gains(JOINT) == pytest.approx((8.0, 0.08))


@pytest.mark.parametrize("name", sorted(known_joints()))
def test_every_shipped_joint_has_them(name):
    found = characteristics(load_joint(name))
    for values in (
        found.torsion,
        found.torsion_deviation,
        found.friction,
        found.friction_deviation,
        found.loop_torsion,
    ):
        assert np.isfinite(values).all()
    assert (np.diff(found.torsion) > 0).all() and (found.torsion_deviation[1:] > 0).all()
    assert all(0 < r.frequency < 2000 and np.isfinite(r.deviation) for r in found.resonances)


def test_without_tolerances_there_is_no_deviation():
    data = {
        name: n.model_copy(update={"tolerance": 0.0, "deviation": 0.0, "shared": None})
        for name, n in JOINT.numbers.items()
    }
    copy = JOINT.model_copy(
        update={"numbers": data, "shared_tolerances": {}, "kinematic_error": [], "link_tolerances": {}}
    )
    copy._path = JOINT.path
    found = characteristics(copy)
    assert not found.torsion_deviation.any() and not found.friction_deviation.any()


def test_hysteresis_and_backlash_widen_the_loop():
    from flexspline.models.joint_parts import Effect, Estimate

    plain = characteristics(JOINT)
    effect = Effect(name="hysteresis", parameters={"torque": Estimate(value=1.0), "extent": Estimate(value=8e-5)})
    copy = JOINT.model_copy(update={"effects": [effect]})
    copy._path = JOINT.path
    wider = characteristics(copy)
    # Dahl friction F across the flexspline: at zero torque the spring holds F (1 − what has not turned round yet).
    assert wider.half_width - plain.half_width == pytest.approx(1.0 / JOINT.numbers["K1"].value, rel=0.2)


@pytest.mark.parametrize("torque", [-8.0, 8.0], ids=["driving", "back-driving"])
def test_efficiency_is_that_of_the_simulated_joint(torque):
    """Power at the link over power at the motor, or the reverse, at a constant speed against a constant torque."""
    described = load_joint("test-joint")
    data = described.model_dump(exclude_none=True)
    parameters = {"coefficient": {"value": 0.1}}
    data["effects"] = [{"name": "load_dependent_friction", "parameters": parameters}]
    joint = parse(data, Joint, "here")
    found = characteristics(joint)
    k = 1
    scenario = parse(
        {"name": "steady", "duration": 5, "mounting": "no_load", "filters": ["current"],
         "trajectory": [{"time": 0, "velocity": 0}, {"time": 1, "velocity": found.efficiency_speed[k]}],
         "disturbances": [{"kind": "step", "start": 1, "duration": 4, "torque": torque}]}, Scenario, "here",
    ).with_joints({"joint": joint})  # fmt: skip
    run = run_scenario(scenario)
    p = joint.record()[0]
    rest = slice(2000, None)
    motor = (p["Kt"] * run.truth("motor_current") * run.truth("motor_velocity"))[rest].mean()
    link = (run.truth("joint_torque") * run.truth("link_velocity"))[rest].mean()
    predicted = found.driving if torque < 0 else found.back_driving
    expected = link / motor if torque < 0 else motor / link
    assert np.interp(8.0, found.torque, predicted[k]) == pytest.approx(expected, abs=0.01)
    assert 0.3 < expected < 0.95
