"""The library of causes: the specification's requirements, and each cause's effect on the record."""

from __future__ import annotations

import re
import sys

import numpy as np
import pytest

import flexspline as fs
from flexspline.models import causes, laws
from flexspline.models.errors import InputError
from flexspline.models.joint import load_joint
from flexspline.models.parameters import PLACES, as_floats, neutral
from flexspline.models.signals import CHANNELS

JOINT = load_joint("test-joint")


def table(shared) -> dict[str, tuple[str, dict[str, str]]]:
    """Component and parameters (name → unit) of every cause in the specification's table."""
    text = (shared / "spec" / "recording.md").read_text(encoding="utf-8").split("## Causes")[1].split("## Mistakes")[0]
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
            rest = [word for word in match[2].split() if re.search(r"rad|m²|A$|N·m|^s$|Hz|^k?g$|^m$|1/K", word)]
            parameters[match[1]] = rest[0] if rest else "1"
        found[cells[0].strip("`")] = (cells[1], parameters)
    return found


def test_names_components_and_parameters_are_those_of_the_specification(shared):
    specified = table(shared)
    assert len(specified) == 28
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
    # What stays behind of an absent effect is where it would be, not that it is: an order, a phase.
    harmless = JOINT.record()
    for field in ("phase", "order"):
        for column in harmless.dtype.names:
            if field in column:
                harmless[0][column] = record[0][column]
    np.testing.assert_array_equal(as_floats(record), as_floats(harmless), err_msg=f"{name}: {changed.sum()} changed")


def test_absent_values_are_the_joints_own(rng):
    """Where a record has an effect that the cause replaces, the absence of a further one is that effect."""
    for name in causes.names():
        cause, record = causes.get(name), JOINT.record()
        cause.apply(record[0], cause.draw(record[0], rng))
        before = as_floats(record).copy()
        cause.apply(record[0], cause.present(record[0]))
        if not cause.adds:
            np.testing.assert_allclose(as_floats(record), before, rtol=1e-12, err_msg=name)
        elif not any(q.period for q in cause.parameters):
            np.testing.assert_array_equal(as_floats(record), before, err_msg=name)


@pytest.mark.parametrize("name", causes.names())
def test_a_second_one_adds_or_replaces(name, rng):
    cause = causes.get(name)
    once, twice = JOINT.record(), JOINT.record()
    first, second = cause.draw(once[0], rng), cause.draw(once[0], rng)
    if "order" in first:
        first["order"], second["order"] = 3.0, 2.0
    cause.apply(once[0], second)
    for values in (first, second):
        cause.apply(twice[0], values)
    assert np.array_equal(as_floats(once), as_floats(twice)) != cause.adds


@pytest.mark.parametrize("name", causes.names())
def test_causes_change_the_fields_that_they_name(name, rng):
    cause, record = causes.get(name), JOINT.record()
    values = cause.draw(record[0], rng)
    cause.apply(record[0], values)
    nominal = JOINT.record()[0]
    changed = {field for field in nominal.dtype.names if not np.array_equal(record[0][field], nominal[field])}
    assert set(cause.scales) | set(cause.sets.values()) >= changed or not (cause.scales or cause.sets)
    for field in cause.scales:
        assert record[0][field] == nominal[field] * values[cause.parameters[0].name]
    for parameter, field in cause.sets.items():
        assert record[0][field] == values[parameter]


@pytest.mark.parametrize("name", causes.names())
def test_requirements_are_plain_data(name):
    cause = causes.get(name)
    assert set(cause.needs) <= set(CHANNELS)
    assert (cause.sensor in CHANNELS) == (cause.component == "sensor")
    assert isinstance(cause.requires, causes.Requirements)
    moving = cause.component in ("motor", "transmission")
    assert (cause.requires.sliding > 0) == moving
    if cause.requires.gravity:
        assert cause.requires.known_push
    if name == "hard_stop":
        assert cause.requires.link_beyond == cause.parameters[0].ordinary[0][0]


def test_causes_that_show_in_torsion_only():
    alone = {name for name in causes.names() if causes.get(name).torsion}
    assert alone == {
        "stiffness", "hysteresis", "backlash", "link_encoder_eccentricity", "link_encoder_error", "encoder_delay",
        "motor_encoder_eccentricity",
    }  # fmt: skip


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
            assert parameter.relative is None or parameter.neutral == 1.0
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


def test_kinematic_error_replaces_an_order_in_quadratures():
    """As on a joint whose phase nobody knows (ur3e-shoulder)."""
    record = neutral()
    p = record[0]
    p["order"][:2], p["amplitude"][:2], p["phase"][:2] = 2.0, [3e-5, 4e-5], [0.0, np.pi / 2]
    cause = causes.get("kinematic_error")
    before = cause.centre(p, {"order": 2.0})
    assert before["amplitude"] == pytest.approx(5e-5)
    cause.apply(p, {"order": 2.0, "amplitude": 1e-4, "phase": 0.3})
    assert cause.centre(p, {"order": 2.0}) == pytest.approx({"order": 2.0, "amplitude": 1e-4, "phase": 0.3})


def test_two_orders_are_kept():
    record = JOINT.record()
    for order in (3.0, 5.0):
        causes.get("cogging").apply(record[0], {"order": order, "amplitude": 5e-3, "phase": 0.1})
    assert record[0]["cogging_order"].tolist()[:3] == [3.0, 5.0, 0.0]
    causes.get("cogging").apply(record[0], {"order": 3.0, "amplitude": 5e-3, "phase": 0.1 + np.pi / 2})
    assert record[0]["cogging_order"].tolist()[:3] == [3.0, 5.0, 0.0]  # the same order, as a vector
    assert record[0]["cogging_amplitude"][0] == pytest.approx(5e-3 * np.sqrt(2))
    assert record[0]["cogging_phase"][0] == pytest.approx(0.1 + np.pi / 4)


@pytest.mark.parametrize("name", ["cogging", "position_dependent_friction", "kinematic_error", "link_encoder_error"])
def test_more_orders_than_a_joint_may_have_are_one_line(name):
    record = JOINT.record()
    with pytest.raises(InputError, match=r"expected at most 8 orders of .*, got one more"):
        for order in range(5, 20):
            causes.get(name).apply(record[0], {"order": float(order), "amplitude": 1e-4, "phase": 0.1})


# --- what they do, against the specification's sentence ------------------------------------------------------------


def test_payload_is_a_mass_on_the_link(rng):
    """Weight and inertia of a mass at a distance: m g d at its own angle against the link's, m d² more."""
    for gravity_angle in (0.0, 3.1, -0.7):
        record = JOINT.record()
        record[0]["gravity_angle"] = gravity_angle
        before = record.copy()[0]
        values = {"mass": 0.8, "distance": 0.35, "angle": rng.uniform(-3, 3)}
        causes.get("payload").apply(record[0], values)
        p = record[0]
        assert p["Jl"] == pytest.approx(before["Jl"] + 0.8 * 0.35**2)
        for q in rng.uniform(-4, 4, 20):
            own = -0.8 * 9.80665 * 0.35 * np.sin(q + gravity_angle + values["angle"])
            assert laws.gravity_torque(q, p) == pytest.approx(laws.gravity_torque(q, before) + own, abs=1e-12)


def test_a_payload_turns_with_the_link_where_gravitys_direction_differs():
    """Whichever is found first: the payload is at the link's own weight."""
    steps = [("payload", {"mass": 0.5, "distance": 0.3, "angle": 0.4}), ("gravity_direction", {"angle": 0.2})]
    found = []
    for order in (steps, steps[::-1]):
        record = JOINT.record()
        for name, values in order:
            causes.get(name).apply(record[0], values)
        found.append([record[0][name] for name in ("Mg", "gravity_angle", "Jl")])
    np.testing.assert_allclose(found[0], found[1], rtol=1e-12)


def test_back_driving_is_another_share_where_the_load_drives():
    for mu, driven in ((0.2, 0.06), (0.2, 0.5), (0.0, 0.3), (0.2, 0.0)):
        record = JOINT.record()
        causes.get("back_driving").apply(record[0], {"coefficient": mu, "back_driven": driven})
        p, plain = record[0], JOINT.record()[0]
        for w, load in ((5.0, 8.0), (-5.0, -8.0), (5.0, -8.0), (-5.0, 8.0)):
            more = (mu if w * load > 0 else driven) * 8.0 / 100
            expected = laws.stribeck_friction(w, 0.0, 0.0, 0.0, 25.0, plain) + more
            assert laws.stribeck_friction(w, 0.0, load, 0.0, 25.0, p) == pytest.approx(expected, abs=1e-9)


def test_back_driving_of_ordinary_size_is_well_off_its_coefficient(rng):
    ratios = []
    for _ in range(200):
        values = causes.get("back_driving").draw(JOINT.record()[0], rng)
        ratios.append(values["back_driven"] / values["coefficient"])
    ratios = np.array(ratios)
    assert np.all(((ratios >= 0.3) & (ratios <= 0.7)) | ((ratios >= 1.5) & (ratios <= 2.5)))
    assert 0.3 < np.mean(ratios > 1) < 0.7


def test_encoder_errors_are_those_of_the_specification(rng):
    record = JOINT.record()
    p = record[0]
    causes.get("link_encoder_eccentricity").apply(p, {"amplitude": 4e-4, "phase": 0.3})
    causes.get("link_encoder_error").apply(p, {"order": 2.0, "amplitude": 2e-4, "phase": -1.0})
    causes.get("motor_encoder_eccentricity").apply(p, {"amplitude": 8e-3, "phase": 2.0})
    for x in rng.uniform(-6, 6, 20):
        first = 4e-4 * (np.sin(x + 0.3) - np.sin(0.3))
        second = 2e-4 * (np.sin(2 * x - 1.0) - np.sin(-1.0))
        assert laws.link_reading(x, p) == pytest.approx(x + first + second, abs=1e-15)
        assert laws.motor_reading(x, p) == pytest.approx(x + 8e-3 * (np.sin(x + 2.0) - np.sin(2.0)), abs=1e-14)


def test_temperature_and_flexibility_reach_their_laws():
    p = JOINT.record()[0]
    causes.get("friction_temperature").apply(p, {"coefficient": -0.01})
    causes.get("link_flexibility").apply(p, {"share": 0.3, "frequency": 14.0, "damping": 0.02})
    plain = JOINT.record()[0]
    assert laws.viscous_friction(30.0, 45.0, p) == pytest.approx(0.8 * laws.viscous_friction(30.0, 45.0, plain))
    w = 2 * np.pi * 14.0
    assert laws.flexible_torque(1e-3, 0.0, p) == pytest.approx(0.3 * 0.35 * w**2 * 1e-3)
    assert laws.flexible_torque(0.0, 1.0, p) == pytest.approx(0.3 * 0.35 * 2 * 0.02 * w)


def test_a_cause_is_one_file(tmp_path, monkeypatch):
    """A new file in the folder is a new cause: known by name, drawn, applied, without other changes."""
    (tmp_path / "loose_bolt.py").write_text(
        "from flexspline.models.causes.base import Cause, CauseParameter, Requirements\n"
        "class LooseBolt(Cause):\n"
        "    name, component, description = 'loose_bolt', 'link', 'the flange gives way'\n"
        "    parameters = (CauseParameter('width', 'rad', (0, 1), ((1e-4, 2e-4),), magnitude=True),)\n"
        "    sets = {'width': 'backlash'}\n"
        "    requires = Requirements(reversal=True)\n",
        encoding="utf-8",
    )
    monkeypatch.setattr(causes, "__path__", [*causes.__path__, str(tmp_path)])
    causes._own.cache_clear()
    try:
        assert "loose_bolt" in causes.names()
        record = JOINT.record()
        values = causes.get("loose_bolt").draw(record[0], np.random.default_rng(1))
        causes.get("loose_bolt").apply(record[0], values)
        assert record[0]["backlash"] == values["width"] > 0
    finally:
        causes._own.cache_clear()
        sys.modules.pop("flexspline.models.causes.loose_bolt", None)


def field(cause: dict, plugin: str) -> str:
    """Text of a plugin file with one cause."""
    body = "".join(f"    {name} = {value}\n" for name, value in cause.items())
    head = "from flexspline.models.causes import Cause, CauseParameter\n"
    return f"{head}class Mine(Cause):\n{body}{plugin}\nCAUSES = (Mine,)\n"


MINE = {
    "name": "'mine'",
    "component": "'link'",
    "description": "'it is mine'",
    "parameters": "(CauseParameter('value', 'rad', (0, 1), ((1e-4, 2e-4),), magnitude=True),)",
    "sets": "{'value': 'backlash'}",
}


@pytest.mark.parametrize(
    ("changes", "plugin", "message"),
    [
        ({"component": "'flange'"}, "", "component: expected one of .*'flange'"),
        ({"sets": "{'value': 'baklash'}"}, "", "got 'baklash'; did you mean 'backlash'"),
        ({"sets": "{'width': 'backlash'}"}, "", "sets: expected a parameter of the cause, got 'width'"),
        ({"sets": "{}"}, "", "expected a change of the parameter record at ordinary size, got none at value"),
        ({"parameters": "()"}, "", "parameters: expected a tuple of CauseParameter"),
        ({"parameters": "(CauseParameter('value', 'rad', (0, 1), ((1, 2),), magnitude=True),)"}, "", "within the bounds"),
        ({"parameters": "(CauseParameter('value', 'rad', (0, 1), ((1e-4, 2e-4),)),)"}, "", "magnitude=True"),
        (
            {
                "parameters": "(CauseParameter('value', '1', (0, 2), ((1.2, 1.5),), magnitude=True),)",
                "sets": "{}", "scales": "('K1',)",
            },
            "", "no change of K1 where the effect is absent .value 0.; check `neutral`",
        ),
        ({"needs": "('temprature',)"}, "", "needs: expected a channel, got 'temprature'; did you mean 'temperature'"),
        ({"sensor": "'encoder'"}, "", "sensor: expected a channel, got 'encoder'"),
        ({}, "    def apply(self, p, values): 1 / 0", "ZeroDivisionError: division by zero"),
        ({}, "    def apply(self, p, values): p['backlash'] = float('nan')", "expected finite numbers"),
    ],
)  # fmt: skip
def test_a_plugins_cause_is_checked(tmp_path, changes, plugin, message):
    """A fault is one line with its name and its file."""
    path = tmp_path / "mine.py"
    path.write_text(field(MINE | changes, plugin), encoding="utf-8")
    with pytest.raises(fs.InputError, match=message) as caught:
        fs.load_plugin(path)
    assert str(caught.value).startswith(f"cause 'mine' of {path}: ") and "\n" not in str(caught.value)
    assert "mine" not in causes.names()


def test_a_function_of_a_variable_is_a_cause(rng):
    """The spline goes through the values, evenly from end to end, and the effects of two causes add up."""
    record, angles = JOINT.record(), np.linspace(-0.5, 1.5, 21)
    values = rng.normal(size=21)
    for share in (0.25, 0.75):
        causes.put_discrepancy(record[0], "link", "link_position", -0.5, 1.5, causes.spline_through(share * values))
    place = PLACES.index("link")
    found = [laws.discrepancy(place, 0.0, angle, 0.0, 0.0, 0.0, record[0]) for angle in (*angles, -3.0, 2.0)]
    np.testing.assert_allclose(found, [*values, values[0], values[-1]], atol=1e-12)
    for _ in range(2):
        causes.put_discrepancy(record[0], "rotor", "time", 0.0, 1.0, causes.spline_through(np.ones(2)))
    with pytest.raises(fs.InputError, match="at most 4 model discrepancies"):
        causes.put_discrepancy(record[0], "rotor", "time", 0.0, 1.0, causes.spline_through(np.ones(2)))
    with pytest.raises(fs.InputError, match="expected 2 to 30 values, got 31"):
        causes.spline_through(np.ones(31))
