"""Tolerances as independent standard normal variables."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from flexspline.models import causes
from flexspline.models.calibration import CUT, Calibration, in_quadratures
from flexspline.models.joint import as_joint, known_joints, load_joint
from flexspline.models.joint_parts import Uncertainty, value_fault
from flexspline.models.parameters import as_floats


@pytest.fixture(scope="module")
def calibration() -> Calibration:
    return Calibration(load_joint("test-joint"))


@pytest.mark.parametrize("name", sorted(known_joints()))
def test_prior_mean_is_nominal(name):
    joint = load_joint(name)
    calibration = Calibration(joint)
    for mounting in joint.mountings.values():
        got = as_floats(calibration.record(np.zeros(calibration.size), mounting))
        np.testing.assert_allclose(got, as_floats(joint.record(mounting)), rtol=1e-15)


@pytest.mark.slow
def test_spread_of_draws_is_the_tolerance(calibration, rng):
    """Relative to a normal distribution cut at 2.5, whose deviation is 0.9546 of the uncut one's."""
    draws = np.array([calibration.draw(rng) for _ in range(4000)])
    assert np.abs(draws).max() <= CUT
    np.testing.assert_allclose(draws.mean(axis=0), 0, atol=5 / np.sqrt(4000))
    np.testing.assert_allclose(draws.std(axis=0), 0.9546, atol=0.04)
    np.testing.assert_allclose(np.corrcoef(draws.T) - np.eye(calibration.size), 0, atol=0.08)
    for slot in calibration.slots:
        values = np.array([calibration.value(slot, x) for x in draws])
        number = slot.number
        shared = calibration.joint.shared_tolerances[number.shared] if number.shared else 0.0
        expected = np.hypot(number.value * np.hypot(number.tolerance, shared), number.deviation)
        assert values.std() == pytest.approx(0.9546 * expected, rel=0.05), slot.name
        assert values.mean() == pytest.approx(number.value, abs=0.08 * expected), slot.name


def test_correlations_of_a_diagnosis_are_in_the_prior(calibration, rng):
    """The torque constant and the gravity moment are known by their quotient, as with one encoder."""
    joint = calibration.joint
    Kt = joint.numbers["Kt"]
    covariance = np.array(
        [[(0.02 * Kt.value) ** 2, 0.999 * 0.02 * Kt.value * 0.03], [0.999 * 0.02 * Kt.value * 0.03, 0.03**2]]
    )
    found = joint.model_copy(
        update={
            "numbers": joint.numbers | {"Kt": Kt.model_copy(update={"std": 0.02 * Kt.value})},
            "link_tolerances": joint.link_tolerances
            | {"gravity_moment": joint.link_tolerances["gravity_moment"].model_copy(update={"std": 0.03})},
            "uncertainty": Uncertainty(
                names=["Kt", "Mg"],
                factor=[row[: i + 1] for i, row in enumerate(np.linalg.cholesky(covariance).tolist())],
            ),
        }
    )
    prior = Calibration(found)
    slots = [next(s for s in prior.slots if s.name == name) for name in ("Kt", "Mg")]
    assert prior.variables(slots[0]) == prior.variables(slots[1])
    draws = np.array([[prior.value(s, x) for s in slots] for x in (prior.draw(rng) for _ in range(4000))])
    np.testing.assert_allclose(draws.std(axis=0), 0.9546 * np.sqrt(np.diag(covariance)), rtol=0.05)
    assert np.corrcoef(draws.T)[0, 1] == pytest.approx(0.999, abs=5e-4)
    others = [s for s in prior.slots if s.name not in ("Kt", "Mg")]
    x = prior.draw(rng)
    assert [prior.value(s, x) for s in others] == [calibration.value(s, x) for s in others]


def test_tolerances_are_those_of_the_specification(calibration):
    """joint.md, "Tolerances": deviation of each number relative to its value, or absolute."""
    relative = {
        "Kt": 0.02, "Jm": 0.05, "Jw": 0.10, "bm": 0.3, "bw": 0.3, "bl": 0.3, "dw": 0.3, "df": 0.3, "s0": 0.3, "s1": 0.3,
        "vs": 0.3, "A4": 0.3, "K1": 0.02, "K2": 0.02, "K3": 0.02, "Kw0": 0.15, "Cw": 0.10, "A2": 0.2, "Mg": 0.01,
        "Jl": 0.03, "torque_sensor_gain": 0.01, "Fc": 0.0, "Fs": 0.0,
    }  # fmt: skip
    absolute = {"φ2": 0.2, "φ4": 0.2, "link_encoder_zero": 1e-3, "current_offset": 0.01, "torque_sensor_offset": 0.05}
    got = {slot.name: slot.number for slot in calibration.slots}
    assert set(got) == set(relative) | set(absolute)
    assert {name: got[name].tolerance for name in relative} == relative
    assert {name: got[name].deviation for name in absolute} == absolute
    assert calibration.joint.shared_tolerances == {"stiffness": 0.07, "friction": 0.15}
    assert {name for name, number in got.items() if number.shared == "stiffness"} == {"K1", "K2", "K3"}
    assert {name for name, number in got.items() if number.shared == "friction"} == {"Fc", "Fs"}


def test_shared_tolerance_moves_its_numbers_together(calibration):
    x = np.zeros(calibration.size)
    x[calibration.names.index("shared stiffness")] = 1.5
    got, nominal = calibration.record(x)[0], calibration.joint.record()[0]
    for symbol in ("K1", "K2", "K3"):
        assert got[symbol] / nominal[symbol] == pytest.approx(1 + 1.5 * 0.07)
    others = [name for name in nominal.dtype.names if name not in ("K1", "K2", "K3")]
    for name in others:
        np.testing.assert_array_equal(got[name], nominal[name])


def test_each_variable_moves_something(calibration):
    nominal = as_floats(calibration.record(np.zeros(calibration.size))).copy()
    for i, name in enumerate(calibration.names):
        x = np.zeros(calibration.size)
        x[i] = 1.0
        assert np.any(as_floats(calibration.record(x)) != nominal), name


def test_no_tolerance_makes_a_number_negative():
    joint = load_joint("lara8-joint3")
    calibration = Calibration(joint)
    low, high = (calibration.record(np.full(calibration.size, x))[0] for x in (-3.0, 3.0))
    nominal = calibration.record(np.zeros(calibration.size))[0]
    for name in ("Jm", "Jw", "Kw0", "dw", "s0", "K1", "Jl"):
        assert 0 < low[name] < nominal[name] < high[name]
    slot = next(s for s in calibration.slots if s.name == "Jm")
    x = np.zeros(calibration.size)
    x[calibration.names.index("Jm")] = -1.2
    assert calibration.value(slot, x) == pytest.approx(nominal["Jm"] * (1 - 1.2 * 0.5))  # a tolerance as it says


def test_wide_tolerance_is_a_factor():
    """As likely half as double: one standard deviation up and one down are inverse factors."""
    data = load_joint("test-joint").model_dump()
    data["numbers"]["bw"]["tolerance"] = 2.0
    data["shared_tolerances"]["friction"] = 1.0
    calibration = Calibration(as_joint(data, Path("joint.yaml")))
    for name, variable, factor in (("bw", "bw", 3.0), ("Fc", "shared friction", 2.0)):
        slot = next(s for s in calibration.slots if s.name == name)
        for x in (-2.0, -1.0, 1.0, 2.5):
            at = np.zeros(calibration.size)
            at[calibration.names.index(variable)] = x
            assert calibration.value(slot, at) == pytest.approx(slot.number.value * factor**x), (name, x)
        assert calibration.reach(slot, 2.0) == pytest.approx((factor**2 - 1) * slot.number.value, rel=0.35)


def test_no_number_becomes_negative_however_wide_its_deviation():
    """A diagnosis must write a valid joint: a share of friction of 0.5 ± 0.7 is never negative."""
    joint = load_joint("ur3e-shoulder")
    assert joint.numbers["back_driven_friction"].deviation > 0.5 * joint.numbers["back_driven_friction"].value
    calibration = Calibration(joint)
    for side in (-2.6, 2.6):
        record = calibration.record(np.full(calibration.size, side))[0]
        assert all(record[name] >= 0 for name in joint.numbers if name in record.dtype.names)


def test_no_number_becomes_impossible_however_wide_its_tolerance():
    """A joint whose rotor is as light as possible: what a diagnosis writes is a valid joint, too."""
    data = load_joint("test-joint").model_dump()
    for symbol, value in (("Jw", 1.1e-9), ("Kt", 90.0)):
        data["numbers"][symbol].update(value=value, tolerance=1.0)
    calibration = Calibration(as_joint(data, Path("light.yaml")))
    for side in (-2.6, 2.6):
        for slot in calibration.slots:
            if slot.name in data["numbers"]:
                fault = value_fault(slot.name, calibration.value(slot, np.full(calibration.size, side)))
                assert fault is None


def test_no_scale_of_the_link_becomes_negative_however_wide_its_deviation():
    data = load_joint("test-joint").model_dump()
    for number in data["link_tolerances"].values():
        number["deviation"] = 0.6
    calibration = Calibration(as_joint(data, Path("wide.yaml")))
    low, nominal = (calibration.record(np.full(calibration.size, x))[0] for x in (-2.0, 0.0))
    for name in ("Jl", "Mg"):
        assert 0 < low[name] < 0.1 * nominal[name]


def test_an_order_of_unknown_phase_has_two_quadratures():
    """Each has its own variable: together they are any amplitude at any phase."""
    calibration = Calibration(load_joint("ur3e-shoulder"))
    pairs = [name for name in calibration.names if name.startswith("A")]
    assert pairs == ["A1.9901", "A1.9901′", "A1.9802", "A1.9802′"]
    x = np.zeros(calibration.size)
    x[calibration.names.index("A1.9802")], x[calibration.names.index("A1.9802′")] = 0.3, -0.4
    p = calibration.record(x)[0]
    whole = p["amplitude"] * np.exp(1j * p["phase"]) * (np.abs(p["order"] - 200 / 101) < 1e-5)
    assert np.sum(whole) == pytest.approx(1e-4 * (0.3 - 0.4j), abs=3e-6)


def test_any_phase_is_as_likely_where_it_is_unknown_and_none_may_be_there(rng):
    """The mean square amplitude is that of the description."""
    joint = load_joint("csg-25-100-tbm2g")
    calibration = Calibration(in_quadratures(joint))
    assert not calibration.record(np.zeros(calibration.size))["amplitude"].any()
    draws = np.array([calibration.record(calibration.draw(rng))[0] for _ in range(2000)])
    for order in joint.kinematic_error:
        of = np.isclose(draws["order"][0], order.order)
        whole = np.sum((draws["amplitude"] * np.exp(1j * draws["phase"]))[:, of], axis=1)
        expected = order.amplitude.value**2 * (1 + order.amplitude.tolerance**2)
        assert np.mean(np.abs(whole) ** 2) == pytest.approx(expected, rel=0.15)  # draws are cut
        assert abs(np.mean(np.exp(1j * np.angle(whole)))) < 0.1
    known = load_joint("test-joint")
    assert in_quadratures(known).kinematic_error == known.kinematic_error


@pytest.mark.parametrize("phase", [0.3, 3.0, 3.5, 4.0, -4.0])
def test_tolerances_express_a_larger_amplitude_at_any_turn_of_its_phase(phase):
    """A cause has its phase within half a turn: where the description did not, a change within tolerance was a cause."""
    path = known_joints()["test-joint"]
    data = load_joint("test-joint").model_dump()
    data["kinematic_error"][0]["phase"]["value"] = phase
    calibration = Calibration(as_joint(data, path))
    before = calibration.record(np.zeros(calibration.size))
    for factor, within in ((1.02, True), (2.5, False)):
        after, cause = before.copy(), causes.get("kinematic_error")
        at = cause.centre(before[0], {"order": 2.0})
        cause.apply(
            after[0], {**at, "amplitude": factor * at["amplitude"], "phase": np.angle(np.exp(1j * at["phase"]))}
        )
        assert calibration.expresses(after, before) == within, factor
