"""The joint description: errors in one line, and round trips of valid ones."""

from __future__ import annotations

import os
import re
import warnings
from collections.abc import Iterator
from copy import deepcopy
from pathlib import Path

import mujoco
import numpy as np
import pytest

from flexspline.models import causes
from flexspline.models.calibration import slots
from flexspline.models.errors import InputError, InputWarning
from flexspline.models.joint import as_joint, known_joints, load_joint
from flexspline.models.joint_check import check
from flexspline.models.joint_parts import OPTIONAL_SYMBOLS, SYMBOLS, Discrepancy, Effect, Estimate
from flexspline.models.parameters import as_floats

TEXT = known_joints()["test-joint"].read_text(encoding="utf-8")


def changed(tmp_path: Path, old: str, new: str) -> Path:
    """A copy of the test joint's file with one place changed."""
    assert old in TEXT, old
    path = tmp_path / "joint.yaml"
    path.write_text(TEXT.replace(old, new, 1), encoding="utf-8")
    return path


BAD = {
    "zero of the motor's encoder": (
        "  motor_encoder: {counts: 4096}",
        "  motor_encoder: {zero: {value: 0.5, unit: rad, source: bench}, counts: 4096}",
        "sensors.motor_encoder.zero: expected none, got one: angles count from its zero",
    ),
    "gain of the current": (
        "    offset: {value: 0, unit: A, deviation",
        '    gain: {value: 1.3, unit: "1", source: bench}\n    offset: {value: 0, unit: A, deviation',
        "sensors.motor_current.gain: expected none, got one",
    ),
    "motor read later than the link": (
        "  motor_encoder: {counts: 4096}",
        "  motor_encoder: {delay: 0.002, counts: 4096}",
        "sensors.motor_encoder.delay: expected at most the link encoder's, 0 s",
    ),
    "wrong unit": (
        "Jm: {value: 1.38e-5, unit: kg·m²",
        "Jm: {value: 1.38e-5, unit: g·cm²",
        "numbers.Jm.unit: expected 'kg·m²', got 'g·cm²'",
    ),
    "wrong unit of an optional number": (
        "amplitude: {value: 1.2e-4, unit: rad",
        "amplitude: {value: 1.2e-4, unit: deg",
        "kinematic_error.0.amplitude.unit: expected 'rad', got 'deg'",
    ),
    "negative inertia": (
        "Jm: {value: 1.38e-5",
        "Jm: {value: -1.38e-5",
        "numbers.Jm.value: expected a number > 0, got -1.38e-05",
    ),
    "negative inertia of a mounting": (
        "link: {inertia: 0.35",
        "link: {inertia: -0.35",
        "mountings.link.inertia: expected greater than 0, got -0.35",
    ),
    "zero stiffness": ("K1: {value: 8400", "K1: {value: 0", "numbers.K1.value: expected a number > 0, got 0"),
    "negative damping": ("bm: {value: 2.0e-6", "bm: {value: -2.0e-6", "numbers.bm.value: expected a number ≥ 0"),
    "T2 below T1": ("T2: {value: 12.0", "T2: {value: 2.0", "numbers.T2.value: expected T2 ≥ T1 = 3.9 N·m, got 2"),
    "unknown number": ("  bl: {", "  blx: {", "numbers.blx: unknown key; did you mean 'bl'?"),
    "unknown key": ("mounting: link", "mountng: link", "mountng: unknown key; did you mean 'mounting'?"),
    "unknown key of a sensor": (
        "    noise: 1.5e-6",
        "    nois: 1.5e-6",
        "sensors.link_encoder.nois: unknown key; did you mean 'noise'?",
    ),
    "missing number": ("  Kt: {value: 0.0603", "  #Kt: {value: 0.0603", "numbers.Kt: missing"),
    "missing field": (", source: assumed}\n  bm:", "}\n  bm:", "numbers.Kt.source: missing"),
    "not a number": ("T1: {value: 3.9", "T1: {value: soft", "numbers.T1.value: expected a valid number"),
    "not finite": ("T1: {value: 3.9", "T1: {value: .inf", "numbers.T1.value: expected a finite number"),
    "duplicated key": ("  T1: {value: 3.9", "  T2: {value: 3.9", "duplicate key 'T2'"),
    "bad YAML": ("numbers:\n", "numbers: [\n", "not YAML"),
    "unknown mounting": (
        "mounting: link\n",
        "mounting: lnik\n",
        "mounting: expected one of ['link', 'no_load'], got 'lnik'; did you mean 'link'?",
    ),
    "no such MJCF": (
        "model: test_joint.xml",
        "model: nothing.xml",
        "model: expected an MJCF file, no such file 'nothing.xml'",
    ),
    "two resolutions": (
        "{counts: 4096}",
        "{counts: 4096, bits: 12}",
        "expected either counts (per revolution) or bits, got both",
    ),
    "no resolution": (
        "{counts: 4096}",
        "{noise: 0}",
        "expected either counts (per revolution) or bits, got both or none",
    ),
    "more counts than a float holds": (
        "{counts: 4096}",
        f"{{counts: 1{'0' * 400}}}",
        "with at most 100 digits",
    ),
    "unknown shared tolerance": (
        "shared: friction",
        "shared: fricton",
        "numbers.Fc.shared: expected one of ['friction', 'stiffness'], got 'fricton'",
    ),
    "no inertia of any link": (
        "inertia: {value: 1,",
        "inertia: {value: 0,",
        "link_tolerances.inertia.value: expected a scale > 0, got 0",
    ),
    "negative scale of inertia": (
        "inertia: {value: 1,",
        "inertia: {value: -1,",
        "link_tolerances.inertia.value: expected a scale > 0, got -1",
    ),
    "negative scale of gravity": (
        "gravity_moment: {value: 1,",
        "gravity_moment: {value: -1,",
        "link_tolerances.gravity_moment.value: expected a scale > 0, got -1",
    ),
    "a torque sensor that reads nothing": (
        "gain: {value: 1,",
        "gain: {value: 0,",
        "sensors.joint_torque.gain.value: expected a factor other than 0, got 0",
    ),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_description_is_one_line(tmp_path, case):
    old, new, expected = BAD[case]
    if case == "missing field":  # Kt's own source is a sentence
        old = ', source: "assumed; with the current limit gives the 0.191 N·m of Section V"}'
        new = "}"
    path = changed(tmp_path, old, new)
    with pytest.raises(InputError) as caught:
        load_joint(path)
    message = str(caught.value)
    assert "\n" not in message
    assert message.startswith(str(path))
    assert expected in message


def numbers_of(data: object, field: str = "") -> Iterator[tuple[str, dict]]:
    """Every number of a description as plain data, with its field."""
    if isinstance(data, dict) and {"value", "unit", "source"} <= set(data):
        yield field, data
    elif isinstance(data, dict | list):
        for key, one in data.items() if isinstance(data, dict) else enumerate(data):
            yield from numbers_of(one, f"{field}.{key}".lstrip("."))


def test_an_unknown_shared_tolerance_is_reported_for_every_number():
    """Of all that calibration moves, at any place; `check` names two at once."""
    data = load_joint("test-joint").model_dump(mode="json")
    data["gravity_angle"] = {"value": 0.0, "unit": "rad", "deviation": 0.01, "source": "mounting"}
    fields = [field for field, _ in numbers_of(data)]
    assert len(fields) == len(slots(as_joint(data, Path("a.yaml"))))
    for field in fields:
        changed = deepcopy(data)
        dict(numbers_of(changed))[field]["shared"] = "nope"
        with pytest.raises(InputError) as caught:
            as_joint(changed, Path("a.yaml"))
        message = f"a.yaml: {field}.shared: expected one of ['friction', 'stiffness'], got 'nope'"
        assert str(caught.value) == message


def test_a_sensor_may_be_reversed(tmp_path):
    path = changed(tmp_path, "gain: {value: 1,", "gain: {value: -1,")
    assert load_joint(path).record()[0]["torque_gain"] == -1.0


KNOWN = {
    "effects": [{"name": "friction_asymmetry", "parameters": {"ratio": {"value": 0.3}}}],
    "discrepancies": [
        {
            "place": "mesh",
            "variable": "motor_velocity",
            "low": -100,
            "high": 100,
            "unit": "N·m",
            "coefficients": [0.1] * 4,
        }
    ],
}


@pytest.mark.parametrize(
    ("names", "expected"),
    [
        (["Kt", "A2", "φ4", "Mg", "link_encoder_zero", "effects.0.ratio", "discrepancies.0.3"], None),
        (["Kt", "Fc", "Kt"], "uncertainty: names: expected each once, got 'Kt' twice"),
        (["Kt", "nope"], "uncertainty.names.1: expected a number of the joint (Kt, A2, link_encoder_zero), a parameter of an "
                         "effect (effects.0.ratio) or a coefficient of a discrepancy (discrepancies.0.3), got 'nope'"),
        (["gravity_angle"], "uncertainty.names.0: expected a number of the joint"),
        (["effects.1.ratio"], "got 'effects.1.ratio'; did you mean 'effects.0.ratio'?"),
        (["effects.0.ratoi"], "got 'effects.0.ratoi'; did you mean 'effects.0.ratio'?"),
        (["discrepancies.0.4"], "uncertainty.names.0: expected a number of the joint"),
    ],
)  # fmt: skip
def test_what_is_known_together_is_of_the_joint(names, expected):
    data = load_joint("test-joint").model_dump() | KNOWN
    data["uncertainty"] = {"names": names, "factor": [[0.0] * i + [1e-3] for i in range(len(names))]}
    if expected is None:
        assert as_joint(data, Path("a.yaml")).uncertainty.names == names
        return
    with pytest.raises(InputError) as caught:
        as_joint(data, Path("a.yaml"))
    assert expected in str(caught.value) and "\n" not in str(caught.value)


@pytest.mark.parametrize("field", ["link_position", "link_velocity", "joint_torque"])
def test_a_range_of_validity_goes_upward(field):
    data = load_joint("test-joint").model_dump()
    valid = {"link_position": [-1, 1], "link_velocity": [-1, 1], "joint_torque": [-9, 9]}
    as_joint(data | {"valid": valid | {field: [2, 2]}}, Path("a.yaml"))
    with pytest.raises(InputError) as caught:
        as_joint(data | {"valid": valid | {field: [1, -1]}}, Path("a.yaml"))
    assert str(caught.value) == f"a.yaml: valid.{field}: expected low ≤ high, got [1.0, -1.0]"


def test_unknown_joint_names_the_nearest():
    with pytest.raises(InputError, match=r"joint 'test-jont': .*; did you mean 'test-joint'\?"):
        load_joint("test-jont")


def test_empty_and_binary_files(tmp_path):
    empty = tmp_path / "empty.yaml"
    empty.write_text("")
    with pytest.raises(InputError, match="expected a mapping of keys, got nothing"):
        load_joint(empty)
    binary = tmp_path / "binary.yaml"
    binary.write_bytes(bytes([0xFF, 0xFE, 0x00, 0x81]))
    with pytest.raises(InputError, match=r"binary\.yaml:1: cannot read a joint description: not UTF-8 text"):
        load_joint(binary)


@pytest.mark.parametrize("name", sorted(known_joints()))
def test_round_trip(tmp_path, name):
    joint = load_joint(name)
    joint.write(tmp_path / "copy.yaml")
    copy = load_joint(tmp_path / "copy.yaml")
    assert copy.model_dump() == joint.model_dump()
    for mounting in joint.mountings:
        np.testing.assert_array_equal(
            as_floats(copy.record(copy.mount(mounting))), as_floats(joint.record(joint.mount(mounting)))
        )


def test_round_trip_with_effects_and_discrepancies(tmp_path):
    effect = Effect(name="friction_asymmetry", parameters={"ratio": Estimate(value=0.3, std=0.01)})
    discrepancy = Discrepancy(
        place="mesh", variable="motor_velocity", low=-100, high=100, unit="N·m", coefficients=[0.1, -0.2, 0.3, 0.4, 0.5]
    )
    plain = load_joint("test-joint")
    joint = plain.model_copy(update={"effects": [effect], "discrepancies": [discrepancy]})
    joint.write(tmp_path / "extended.yaml")
    copy = load_joint(tmp_path / "extended.yaml")
    np.testing.assert_array_equal(as_floats(copy.record()), as_floats(joint.record()))
    assert copy.record()[0]["friction_asymmetry"] == 0.3
    assert copy.record()[0]["discrepancy_coefficient"][0, 4] == 0.5
    np.testing.assert_array_equal(as_floats(copy.bare_record()), as_floats(plain.record()))


def test_bad_effects_are_named():
    data = load_joint("test-joint").model_dump()
    path = Path("somewhere.yaml")
    for effect, expected in (
        ({"name": "friction_asymetry", "parameters": {}}, "did you mean 'friction_asymmetry'?"),
        ({"name": "friction_asymmetry", "parameters": {"ratoi": {"value": 1}}}, "did you mean 'ratio'?"),
        ({"name": "friction_asymmetry", "parameters": {}}, "parameters.ratio: missing"),
    ):
        with pytest.raises(InputError) as caught:
            as_joint(data | {"effects": [effect]}, path)
        assert expected in str(caught.value)
        assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("name", "parameter", "value", "expected"),
    [
        (
            "friction_drift",
            "time_constant",
            {"value": 0.0},
            "parameters.time_constant.value: expected 0.5 to 300, got 0",
        ),
        ("encoder_delay", "seconds", {"value": -0.01}, "parameters.seconds.value: expected 0 to 0.09, got -0.01"),
        ("torque_sensor_gain", "gain", {"value": 0.0}, "parameters.gain.value: expected 0.05 to 20, got 0"),
        (
            "gravity_direction",
            "angle",
            {"value": 0.2, "unit": "deg"},
            "parameters.angle.unit: expected 'rad', got 'deg'",
        ),
        ("stiffness", "scale", {"value": float("nan")}, "parameters.scale.value: expected a finite number"),
        ("hysteresis", "torque", {"value": 1.0, "unit": "mNm"}, "parameters.torque.unit: expected 'N·m', got 'mNm'"),
        ("torque_constant", "value", {"value": 0.06, "std": -1.0}, "std: expected greater than or equal to 0"),
    ],
)
def test_invalid_effects_are_one_line(name, parameter, value, expected):
    """Range and unit are those of the cause; a unit that is left out is the cause's."""
    joint = load_joint("test-joint")
    cause = causes.get(name)
    middle = {q.name: {"value": sum(q.ordinary[0]) / 2 * (float(joint.record()[0][q.relative]) if q.relative else 1)}
              for q in cause.parameters}  # fmt: skip
    as_joint(joint.model_dump() | {"effects": [{"name": name, "parameters": middle}]}, Path("a.yaml"))
    with pytest.raises(InputError) as caught:
        as_joint(
            joint.model_dump() | {"effects": [{"name": name, "parameters": middle | {parameter: value}}]},
            Path("a.yaml"),
        )
    assert expected in str(caught.value) and "\n" not in str(caught.value)


def effect(name, **values):
    return {"name": name, "parameters": {k: {"value": v} for k, v in values.items()}}


@pytest.mark.parametrize(
    ("effects", "expected"),
    [
        ([effect("backlash", width=3e-4), effect("stiffness", scale=0.8), effect("backlash", width=2e-4)],
         "effects.2: backlash is there twice"),
        ([effect("cogging", order=n, amplitude=1e-3, phase=0.0) for n in range(2, 11)],
         "expected at most 8 orders of cogging, got one more"),
        ([effect("stiffness", scale=1.1)] * 1000, "effects: expected at most 32 items, not 1000, got"),
        ([effect("link_inertia", scale=20.0)] * 32, None),
    ],
)  # fmt: skip
def test_repeated_effects(effects, expected):
    data = load_joint("test-joint").model_dump() | {"effects": effects}
    if expected is None:
        as_joint(data, Path("a.yaml"))
        return
    with pytest.raises(InputError) as caught:
        as_joint(data, Path("a.yaml"))
    assert expected in str(caught.value) and "\n" not in str(caught.value)


def test_additive_effects_may_repeat():
    data = load_joint("test-joint").model_dump()
    data["effects"] = [effect("gravity_moment", scale=1.1), effect("gravity_moment", scale=1.2)]
    data["effects"] += [effect("cogging", order=n, amplitude=1e-3, phase=0.0) for n in (2, 3, 4)]
    p = as_joint(data, Path("a.yaml")).record()[0]
    assert p["Mg"] == pytest.approx(9.0 * 1.1 * 1.2)
    assert p["cogging_order"].tolist()[:4] == [2, 3, 4, 0]


@pytest.mark.parametrize(
    "model", ["/etc/passwd", "../test_joint.xml", "a/../../x.xml", "C:\\x.xml", "passwd", "http://x/y.xml"]
)
def test_a_model_elsewhere_is_refused(tmp_path, model):
    with pytest.raises(InputError, match=r"model: expected an MJCF file \(\.xml\) in the joint file's folder, got"):
        load_joint(changed(tmp_path, "model: test_joint.xml", f"model: {model!r}"))


def test_an_mjcf_that_contradicts_the_description_is_reported(tmp_path):
    """The description's numbers count; a tolerance's width is no contradiction, and a fit keeps what it was."""
    text = load_joint("test-joint").mjcf.read_text()
    path = changed(tmp_path, "model: test_joint.xml", "model: own.xml")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for same in (text, text.replace('stiffness="8400"', 'stiffness="8900"')):
            (tmp_path / "own.xml").write_text(same)
            load_joint(path)
    other = text.replace('stiffness="8400"', 'stiffness="840"').replace("1.38e-5 1.38e-5 1.38e-5", "1e-3 1e-3 1e-3")
    (tmp_path / "own.xml").write_text(other)
    with pytest.warns(
        InputWarning, match=r"model: Jm = 0.001 for 1.38e-05 kg·m², K1 = 840 for 8400 N·m/rad in the MJCF"
    ):
        load_joint(path)
    assert [(p.severity, p.field) for p in check(path).problems] == [("warning", "model")]


def test_a_link_out_of_the_folder_is_refused(tmp_path):
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "elsewhere" / "own.xml").write_text(load_joint("test-joint").mjcf.read_text())
    (tmp_path / "here").mkdir()
    (tmp_path / "here" / "own.xml").symlink_to(tmp_path / "elsewhere" / "own.xml")
    with pytest.raises(InputError, match="expected an MJCF file in the joint file's folder"):
        load_joint(changed(tmp_path / "here", "model: test_joint.xml", "model: own.xml"))


def test_a_path_in_a_file_is_relative_to_that_file(tmp_path, monkeypatch):
    """A joint of the same name in the working directory is another joint."""
    for folder, name in (("beside", "the right one"), ("work", "a wrong one")):
        (tmp_path / folder).mkdir()
        changed(tmp_path / folder, "name: test-joint", f"name: {name}")
    monkeypatch.chdir(tmp_path / "work")
    assert load_joint("joint.yaml", beside=tmp_path / "beside").name == "the right one"
    assert load_joint("joint.yaml").name == "a wrong one"
    with pytest.raises(InputError, match="expected a path or one of"):
        load_joint("joint.yaml", beside=tmp_path)


def test_a_pipe_is_refused(tmp_path):
    os.mkfifo(tmp_path / "joint.yaml")
    with pytest.raises(InputError, match="cannot read a joint description: not a file"):
        load_joint(tmp_path / "joint.yaml")


@pytest.mark.parametrize("text", ["kg*m^2", "kg.m²", "kgm²", "kgm2", "kg m²".replace(" ", "·")])
def test_units_may_be_spelt_differently(tmp_path, text):
    assert (
        load_joint(changed(tmp_path, "1.38e-5, unit: kg·m²", f"1.38e-5, unit: {text}")).numbers["Jm"].value == 1.38e-5
    )


def test_newton_metres_may_be_spelt_together(tmp_path):
    """`Nm` wherever it is `N·m`: of numbers, of products with them, of effects."""
    text = (
        TEXT.replace("N·m·s/rad", "Nms/rad")
        .replace("N·m/rad", "Nm/rad")
        .replace("1/(N·m)", "1/(Nm)")
        .replace("N·m", "Nm")
    )
    assert "N·m," not in text and "Nm," in text
    text += "effects: [{name: hysteresis, parameters: {torque: {value: 1, unit: Nm}, extent: {value: 8.0e-5, unit: rad}}}]\n"
    (tmp_path / "joint.yaml").write_text(text, encoding="utf-8")
    joint = load_joint(tmp_path / "joint.yaml")
    assert joint.record()[0]["hysteresis_torque"] == 1.0
    np.testing.assert_array_equal(as_floats(joint.bare_record()), as_floats(load_joint("test-joint").record()))


def test_numbers_that_may_be_left_out(tmp_path):
    assert [load_joint("test-joint").record()[0][name] for name in OPTIONAL_SYMBOLS] == [1, 0, 1, 25]
    more = "numbers:\n" + "".join(
        f"  {name}: {{value: {value}, unit: {unit!r}, source: measured}}\n"
        for (name, (unit, _)), value in zip(OPTIONAL_SYMBOLS.items(), (0.5, 1e-4, 0.8, 32), strict=True)
    )
    p = load_joint(changed(tmp_path, "numbers:\n", more)).record()[0]
    assert [p[name] for name in OPTIONAL_SYMBOLS] == [0.5, 1e-4, 0.8, 32]


def test_an_unknown_sensor_is_named(tmp_path):
    with pytest.raises(InputError, match=r"sensors: joint_torqe: unknown key; did you mean 'joint_torque'\?"):
        load_joint(changed(tmp_path, "  joint_torque:\n", "  joint_torqe: {noise: 1}\n  joint_torque:\n"))


def test_every_number_has_a_unit_and_a_source():
    for name in known_joints():
        joint = load_joint(name)
        for symbol, number in joint.numbers.items():
            assert number.unit and number.source, symbol
        assert set(SYMBOLS) <= set(joint.numbers)


def test_numbers_are_those_of_the_specification(shared):
    """Every number in joint.md's table is in the YAML."""
    text = (shared / "spec" / "joint.md").read_text(encoding="utf-8")
    numbers = {symbol: number.value for symbol, number in load_joint("test-joint").numbers.items()}
    rows = [[cell.strip() for cell in line.strip("| \n").split("|")] for line in text.splitlines() if line[:2] == "| "]
    found: dict[str, float] = {}
    for cells in rows:
        for symbols, values in zip(cells[::2], cells[1::2], strict=False):
            names = [re.sub(r"\s*\(.*\)", "", s).strip() for s in symbols.split(",")]
            numbers_in = [re.sub(r"[^0-9eE.+-].*", "", v.strip()) for v in values.split(",")]
            found |= {n: float(v) for n, v in zip(names, numbers_in, strict=False) if re.match(r"^[-+0-9.]", v)}
    compared = [symbol for symbol in found if symbol in numbers]
    assert len(compared) == 20, found
    for symbol in compared:
        assert numbers[symbol] == found[symbol], symbol
    orders = {o.order: (o.amplitude.value, o.phase.value) for o in load_joint("test-joint").kinematic_error}
    assert orders == {2.0: (found["A2"], found["φ2"]), 4.0: (found["A4"], found["φ4"])}


@pytest.mark.parametrize("name", sorted(known_joints()))
def test_mjcf_opens_in_plain_mujoco_and_agrees_with_the_yaml(name):
    """A MuJoCo user who opens the XML sees the joint of the YAML, except for laws that MJCF does not have."""
    joint = load_joint(name)
    p = joint.bare_record()[0]
    model = mujoco.MjModel.from_xml_path(str(joint.mjcf))
    values = {symbol: number.value for symbol, number in joint.numbers.items()}

    def close(got, expected, what, rtol=1e-5):
        assert got == pytest.approx(expected, rel=rtol), what

    assert [model.joint(i).name for i in range(model.njnt)] == ["rotor", "wave_generator", "link"]
    np.testing.assert_allclose(model.body("rotor").inertia, values["Jm"], rtol=1e-6)
    np.testing.assert_allclose(model.body("wave_generator").inertia, values["Jw"], rtol=1e-6)
    close(model.joint("rotor").damping[0], values["bm"], "bm")
    close(model.joint("link").damping[0], values["bl"], "bl")
    flexspline, wave_generator = model.tendon("flexspline").id, model.tendon("wave_generator").id
    close(model.tendon_stiffness[flexspline, ...].flat[0], values["K1"], "K1")
    close(model.tendon_damping[flexspline, ...].flat[0], values["df"], "df")
    close(model.tendon_stiffness[wave_generator, ...].flat[0], values["Kw0"], "Kw0")
    close(model.tendon_damping[wave_generator, ...].flat[0], values["dw"], "dw")
    close(model.wrap_prm[model.tendon_adr[flexspline]], 1 / values["N"], "N", 1e-9)
    close(model.wrap_prm[model.tendon_adr[flexspline] + 1], -1, "link's coefficient")
    # Inertia and gravity of the default mounting about the joint's axis (y).
    link = model.body("link")
    lever = float(np.hypot(link.ipos[0], link.ipos[2]))
    close(link.inertia[1] + link.mass[0] * lever**2, p["Jl"], "Jl", 1e-3)
    close(link.mass[0] * lever * -model.opt.gravity[2], p["Mg"], "Mg", 1e-4)
    data = mujoco.MjData(model)
    for angle in (-1.0, 0.0, 0.7):
        data.qpos[2] = angle
        mujoco.mj_forward(model, data)
        weight = -p["Mg"] * np.sin(angle + p["gravity_angle"])
        assert -data.qfrc_bias[2] == pytest.approx(weight, abs=1e-3 * p["Mg"]), angle
    # Motor and mesh friction.
    text = joint.mjcf.read_text(encoding="utf-8")
    motor = re.search(r"<dcmotor name=\"motor\".*?/>", text, re.S)[0]
    friction = re.search(r"<dcmotor name=\"mesh_friction\".*?/>", text, re.S)[0]

    def numbers(element: str, attribute: str) -> list[float]:
        return [float(x) for x in re.search(rf'{attribute}="([^"]*)"', element)[1].split()]

    np.testing.assert_allclose(numbers(motor, "motorconst"), values["Kt"], rtol=1e-5)
    close(numbers(motor, "resistance")[0], values["R"], "R")
    close(numbers(motor, "inductance")[0], values["L"], "L")
    close(numbers(motor, "saturation")[1], values["current_limit"], "current limit")
    close(numbers(motor, "controller")[5], values["supply_voltage"], "supply voltage")
    lugre = [values[symbol] for symbol in ("s0", "s1", "Fc", "Fs", "vs")]
    np.testing.assert_allclose(numbers(friction, "lugre"), lugre, rtol=1e-3)
    close(numbers(friction, "damping")[0], values["bw"], "bw")
    # And it moves: a step in the viewer is finite.
    mujoco.mj_resetData(model, data)
    data.ctrl[model.actuator("motor").id] = 0.1 * values["Kt"]
    mujoco.mj_step(model, data, nstep=200)
    assert np.isfinite(data.qpos).all()
    assert data.warning.number.sum() == 0


@pytest.mark.parametrize(
    "text",
    [
        "root:x:0:0:secret:/root:/bin/bash\ndaemon:x:1:1:secret\n",
        "secret",
        "- secret\n",
        "root:*:secret:0:99999:7:::\n",
    ],
)
def test_a_file_that_is_no_description_is_not_quoted(tmp_path, text):
    """A recording may name /etc/passwd as its joint: the message does not show its content."""
    path = tmp_path / "passwd"
    path.write_text(text)
    with pytest.raises(InputError, match=r"passwd: ") as caught:
        load_joint(path)
    assert "secret" not in str(caught.value)
    assert all("secret" not in str(problem) for problem in check(path).problems)


def test_a_folder_for_a_description_is_one_message(tmp_path):
    with pytest.raises(InputError) as caught:
        load_joint(tmp_path)
    assert str(caught.value) == f"{tmp_path}: cannot read a joint description: not a file"
