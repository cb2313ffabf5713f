"""The library of causes: what the specification fixes, and that each does what it says to the record."""

from __future__ import annotations

import re

import numpy as np
import pytest

from flexspline.models import causes
from flexspline.models.joint import load_joint
from flexspline.models.parameters import as_floats

JOINT = load_joint("test-joint")


def table(shared) -> dict[str, tuple[str, dict[str, str]]]:
    """Component and parameters (name → unit) of every cause in the specification's table."""
    text = (
        (shared / "spec" / "recording.md").read_text(encoding="utf-8").split("## Causes")[1].split("## The answer")[0]
    )
    found = {}
    for line in text.splitlines():
        cells = [cell.strip() for cell in line.replace("\\|", "¦").strip("|").split("|")]
        if not cells[0].startswith("`") or cells[0] == "`unknown`":
            continue
        parameters: dict[str, str] = {}
        for part in cells[3].split(","):
            match = re.match(r"\s*`(\w+)`\s*(.*)$", part)
            if match is None:
                continue  # a remark behind the unit: "output side"
            rest = [word for word in match[2].split() if re.search(r"rad|m²|A$|N·m|^s$|Hz", word)]
            parameters[match[1]] = rest[0] if rest else "1"
        found[cells[0].strip("`")] = (cells[1], parameters)
    return found


def test_names_components_and_parameters_are_those_of_the_specification(shared):
    specified = table(shared)
    assert len(specified) == 23
    for name, (component, parameters) in specified.items():
        cause = causes.get(name)
        assert cause.component == component, name
        assert [p.name for p in cause.parameters] == list(parameters), name
        units = {p.name: p.unit for p in cause.parameters}
        if name == "position_dependent_friction" or name == "cogging":
            parameters["phase"] = "rad"  # the table leaves the unit of an angle out
        if name == "encoder_delay":
            parameters["seconds"] = "s"  # there the name is the unit
        assert {k: v or "1" for k, v in units.items()} == parameters, name


def test_names_are_known_by_component():
    names = causes.names()
    assert len(names) == len(set(names)) >= 23
    order = [causes.COMPONENTS.index(causes.get(name).component) for name in names]
    assert order == sorted(order)
    with pytest.raises(KeyError):
        causes.get("gremlins")


@pytest.mark.parametrize("name", causes.names())
def test_present_is_neutral(name):
    record = JOINT.record()
    before = as_floats(record).copy()
    cause = causes.get(name)
    cause.apply(record[0], cause.present(record[0]))
    changed = as_floats(record) != before
    # What stays behind of an absent effect is where it would be, not that it is: an order, a phase, an angle.
    harmless = JOINT.record()
    for field in ("extent", "phase", "order", "angle", "rest", "time"):
        for column in harmless.dtype.names:
            if field in column:
                harmless[0][column] = record[0][column]
    np.testing.assert_array_equal(as_floats(record), as_floats(harmless), err_msg=f"{name}: {changed.sum()} changed")


@pytest.mark.parametrize("name", causes.names())
def test_draw_is_ordinary_and_applies(name, rng):
    cause = causes.get(name)
    for _ in range(50):
        record = JOINT.record()
        values = cause.draw(record[0], rng)
        assert list(values) == [p.name for p in cause.parameters]
        for parameter in cause.parameters:
            value = values[parameter.name]
            low, high = parameter.bounds
            assert low <= value <= high, parameter.name
            if parameter.integer:
                assert value == round(value)
            if name == "kinematic_error":  # what is ordinary there is what is added to an order's vector
                continue
            scale = float(record[0][parameter.relative]) if parameter.relative else 1.0
            assert any(a * scale - 1e-12 <= value <= b * scale + 1e-12 for a, b in parameter.ordinary), parameter.name
        before = as_floats(record).copy()
        cause.apply(record[0], values)
        assert np.any(as_floats(record) != before)
        assert np.isfinite(as_floats(record)).all()


@pytest.mark.parametrize("name", causes.names())
def test_size_scales_what_grows_with_the_effect(name):
    cause = causes.get(name)
    if name == "kinematic_error":
        pytest.skip("its value is the new whole, not what was added")
    p = JOINT.record()[0]
    full, half = (cause.draw(p, np.random.default_rng(7), size) for size in (1.0, 0.5))
    assert any(q.magnitude for q in cause.parameters)
    for q in cause.parameters:
        neutral = q.neutral * (float(p[q.relative]) if q.relative else 1.0)
        if q.magnitude:
            assert half[q.name] - neutral == pytest.approx(0.5 * (full[q.name] - neutral))
        else:
            assert half[q.name] == full[q.name]


def test_kinematic_error_names_the_full_new_value(rng):
    """Order 2 has an amplitude already: the cause's parameters replace it, they do not add to it."""
    record = JOINT.record()
    cause = causes.get("kinematic_error")
    cause.apply(record[0], {"order": 2.0, "amplitude": 3e-4, "phase": -0.7})
    same = record[0]["order"] == 2
    assert (record[0]["amplitude"][same], record[0]["phase"][same]) == ([3e-4], [-0.7])
    cause.apply(record[0], {"order": 3.0, "amplitude": 1e-4, "phase": 0.1})
    assert np.count_nonzero(record[0]["amplitude"]) == 3
    assert causes.get("kinematic_error").centre(JOINT.record()[0], {"order": 2.0}) == pytest.approx(
        {"order": 2.0, "amplitude": 1.2e-4, "phase": 0.3}
    )


def test_two_of_a_kind_stand_beside_each_other():
    record = JOINT.record()
    for order in (3.0, 5.0):
        causes.get("cogging").apply(record[0], {"order": order, "amplitude": 5e-3, "phase": 0.1})
    assert record[0]["cogging_order"].tolist() == [3.0, 5.0, 0.0]
