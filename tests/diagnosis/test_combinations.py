"""Sets of causes that may stand in each other's place."""

from __future__ import annotations

import pytest

from flexspline.diagnosis.search.combinations import combinations
from flexspline.models import causes

SCALES = frozenset({"torque_constant", "torque_sensor_gain", "gravity_moment"})
FRICTION = frozenset({"back_driving", "load_dependent_friction"})
ALL = SCALES | FRICTION


def sets(*names: str) -> set[frozenset[str]]:
    return {frozenset(n.split()) for n in names}


@pytest.mark.parametrize("name", sorted(SCALES))
def test_one_scale_against_the_two_others_together_and_each_alone(name):
    a, b = sorted(SCALES - {name})
    assert set(combinations(frozenset({name}), SCALES)) == sets(a, b, f"{a} {b}")


def test_of_two_scales_any_other_two_or_one_but_never_more():
    found = set(combinations(frozenset({"torque_constant", "gravity_moment"}), SCALES))
    one = sets("torque_sensor_gain", "torque_constant", "gravity_moment")
    assert found == one | sets("torque_constant torque_sensor_gain", "gravity_moment torque_sensor_gain")


def test_back_driving_against_friction_with_a_torque_constant_and_back():
    here = frozenset({"back_driving"})
    assert combinations(here, FRICTION | {"torque_constant"}) == [
        frozenset({"load_dependent_friction", "torque_constant"})
    ]
    here = frozenset({"load_dependent_friction", "torque_constant"})
    assert combinations(here, FRICTION | {"torque_constant"}) == [frozenset({"back_driving"})]


def test_offsets_are_exchanged_beside_a_cable_alone():
    offsets = {"friction_asymmetry", "current_offset", "torque_sensor_offset"}
    here = frozenset({"torque_sensor_offset", "cable_spring"})
    assert set(combinations(here, offsets)) == sets("friction_asymmetry cable_spring", "current_offset cable_spring")
    here = frozenset({"friction_asymmetry", "cable_spring"})
    assert combinations(here, offsets) == [frozenset({"torque_sensor_offset", "cable_spring"})]
    assert all(combinations(frozenset({name}), offsets) == [] for name in offsets)


def test_what_a_measurement_cannot_show_is_in_none():
    """Without a torque sensor a torque constant and a gravity moment look alike."""
    available = {"torque_constant", "gravity_moment"}
    assert combinations(frozenset({"torque_constant"}), available) == [frozenset({"gravity_moment"})]
    assert combinations(frozenset({"gravity_moment"}), available) == [frozenset({"torque_constant"})]
    assert combinations(frozenset({"load_dependent_friction"}), FRICTION) == []
    assert combinations(frozenset(), ALL) == []


def test_imitation_is_told_of_causes_that_there_are():
    named = {
        n
        for name in causes.names()
        for others in (*causes.get(name).imitated_by, *causes.get(name).imitated_beside)
        for n in others
    }
    assert named and named <= set(causes.names())
