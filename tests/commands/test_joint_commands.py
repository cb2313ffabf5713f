"""`flexspline joint`: a description from datasheets, all that is wrong with one, what one comes to."""

from __future__ import annotations

import io
import json
import re
import shlex
import sys
from pathlib import Path

import numpy as np
import pytest
import yaml

from flexspline.models.joint import known_joints, load_joint

ROOT = Path(__file__).resolve().parents[2]
TEXT = known_joints()["test-joint"].read_text(encoding="utf-8")
SHEET = {
    "--gear": "CSG-14-100", "--torque-constant": "57 mNm/A", "--resistance": "1.56 ohm", "--inductance": "0.6 mH",
    "--rotor-inertia": "181 gcm²", "--motor-encoder": "4096", "--link-encoder": "20 bit",
}  # fmt: skip


@pytest.fixture(autouse=True)
def elsewhere(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


def words(**changes: str) -> list[str]:
    sheet = SHEET | {f"--{key.replace('_', '-')}": value for key, value in changes.items()}
    return [word for pair in sheet.items() for word in pair]


# --- new ---------------------------------------------------------------------------------------------------------


def test_a_datasheet_becomes_a_joint(flexspline, tmp_path):
    code, out, error = flexspline("joint", "new", *words(motor="maxon EC 45 flat"))
    assert code == 0, error
    joint = load_joint("csg_14_100.yaml")
    n = {symbol: number.value for symbol, number in joint.numbers.items()}
    assert (n["N"], n["Kt"], n["R"], n["L"], n["Jm"]) == (100, 0.057, 1.56, 6e-4, pytest.approx(1.81e-5))
    assert (n["K1"], n["K2"], n["K3"], n["T1"], n["T2"], n["rated_torque"]) == (4700, 6100, 7100, 2, 6.9, 10)
    assert (joint.sensors.motor_encoder.counts, joint.sensors.link_encoder.bits) == (4096, 20)
    for symbol, number in joint.numbers.items():
        assert number.source.startswith("rule: ") != (symbol in ("N", "Kt", "R", "L", "Jm")), symbol
    ruled = [symbol for symbol, number in joint.numbers.items() if number.source.startswith("rule: ")]
    assert all(any(line.startswith(symbol + " ") for line in out.splitlines()) for symbol in ruled)
    assert flexspline("joint", "check", "csg_14_100.yaml")[0] == 0
    assert (tmp_path / "csg_14_100.xml").is_file()


def test_what_is_filled_is_said_to_programs_too(flexspline):
    code, out, error = flexspline("joint", "new", *words(), "--json", "--out", "mine.yaml")
    assert code == 0, error
    found = json.loads(out)
    filled = {one["name"]: one for one in found["filled"]}
    joint = load_joint(found["file"])
    assert Path(found["mjcf"]).name == joint.model == "mine.xml"
    assert filled["Kw0"]["value"] == joint.numbers["Kw0"].value and "K1" in filled["Kw0"]["rule"]
    assert {"A2", "φ2", "gravity of link", "inertia of link"} <= set(filled) and "Kt" not in filled
    assert all(one["tolerance"] >= 0.1 for name, one in filled.items() if name in ("K1", "Fc", "Jw", "df", "Kw0"))


@pytest.mark.parametrize(
    ("option", "same"),
    [
        ("rotor_inertia", ["181 gcm²", "0.181 kg·cm²", "1.81e-5", "1.81e-5 kg m²", "181 g*cm^2", "0,181 kgcm2"]),
        ("torque_constant", ["57 mNm/A", "0.057", "0.057 N·m/A", "5.7 Ncm/A"]),
        ("inductance", ["0.6 mH", "600 µH", "600uH", "6e-4 H"]),
        ("resistance", ["1.56", "1.56 Ω", "1560 mohm"]),
        ("link_encoder", ["20 bit", "20bits", "1048576 counts", "1048576"]),
        ("gear", ["CSG-14-100", "csg-14-100-2A-GR", "CSG 14 100"]),
    ],
)
def test_numbers_are_read_as_datasheets_write_them(flexspline, option, same):
    found = []
    for text in same:
        code, _, error = flexspline("joint", "new", *words(**{option: text}), "--out", "a.yaml", "--force")
        assert code == 0, (text, error)
        joint = load_joint("a.yaml")
        resolution = joint.sensors.link_encoder.resolution
        found.append([*(n.value for n in joint.numbers.values()), resolution])
    np.testing.assert_allclose(found, [found[0]] * len(found), rtol=1e-12)


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"gear": "CSG25"}, "--gear: expected series-size-ratio (CSG-25-100), got 'CSG25'"),
        ({"gear": "XYZ-25-100"}, "--gear: expected one of CSF, CSG"),
        ({"gear": "CSG-200-100"}, "--gear: size: expected 8 to 65, got 200"),
        ({"rotor_inertia": "181 kg"}, "--rotor-inertia: expected one of the units kg·m^2, kg·cm^2, g·cm^2"),
        ({"rotor_inertia": "heavy"}, "--rotor-inertia: expected a number"),
        (
            {"rotor_inertia": "1,240 gcm²"},
            "--rotor-inertia: expected 1.240 or 1240, got '1,240 gcm²', which may be either",
        ),
        ({"rotor_inertia": "3.33"}, "numbers.Jm.value: expected 1e-09 to 0.3 kg·m²"),
        (
            {"motor_encoder": "some"},
            "--motor-encoder: expected counts per revolution (4096) or bits (20 bit), got 'some'",
        ),
        ({"torque_constant": "0"}, "numbers.Kt.value: expected a number > 0, got 0"),
        ({"resistance": "-1 ohm"}, "numbers.R.value: expected a number > 0, got -1"),
        ({"set": "rated_torque=0"}, "numbers.rated_torque.value: expected a number > 0, got 0"),
        ({"inertia": "0"}, "inertia: expected a number > 0 kg·m², got 0"),
        ({"link_encoder": "60 bit"}, "csg_14_100.yaml: sensors.link_encoder.bits: expected less than 40, got 60"),
        ({"set": "K9=3"}, "--set K9=3: expected one of N, Jm"),
        ({"set": "K1"}, "--set K1: expected SYMBOL=…, got no '='"),
        ({"tolerance": "Jm=20"}, "--tolerance Jm=20: expected a share from 0 to 10, got '20'"),
        ({"out": "a.txt"}, "--out a.txt: expected a file .yaml"),
        ({"name": "../a"}, "name: expected a name"),
    ],
)
def test_what_cannot_be_is_one_line(flexspline, tmp_path, changes, expected):
    code, out, error = flexspline("joint", "new", *words(**changes))
    assert code == 2 and out == "" and error.count("\n") == 1
    assert expected in error
    assert list(tmp_path.iterdir()) == []


def test_what_is_given_wins_over_the_catalogue(flexspline):
    """A gear that is driven the other way round has a turn more; a motor that cannot lift a link holds none."""
    options = ("--set", "N=101", "--set", "current_limit=0.01 A", "--out", "a.yaml")
    code, _, error = flexspline("joint", "new", *words(), *options)
    assert code == 0, error
    joint = load_joint("a.yaml")
    assert joint.numbers["N"].value == 101 and joint.numbers["K1"].value == 4700
    assert joint.mountings["link"].gravity_moment == 0.0


def test_everything_that_is_missing_is_named_at_once(flexspline, monkeypatch):
    monkeypatch.setattr(sys, "stdin", io.StringIO(""))
    code, _, error = flexspline("joint", "new", "--gear", "CSG-14-100", "--resistance", "1")
    assert code == 2
    missing = [option for option in SHEET if option not in ("--gear", "--resistance")]
    assert f"expected {', '.join(missing)}, got none" in error


def test_at_a_terminal_it_asks(flexspline, monkeypatch):
    """An answer that cannot be read is asked for again."""

    class Terminal(io.StringIO):
        def isatty(self) -> bool:
            return True

    answers = ["CSG", "CSG-14-100", "57 mNm/A", "1.56", "0.6 mH", "181 gcm²", "4096", "20 bit"]
    monkeypatch.setattr(sys, "stdin", Terminal("\n".join(answers) + "\n"))
    code, out, error = flexspline("joint", "new", "--out", "asked.yaml")
    assert code == 0, error
    assert "expected series-size-ratio" in out + error
    assert flexspline("joint", "new", *words(), "--out", "given.yaml")[0] == 0
    asked, given = (load_joint(name).model_dump() | {"model": ""} for name in ("asked.yaml", "given.yaml"))
    assert asked == given


def test_no_file_is_replaced_unless_it_is_said(flexspline, tmp_path):
    (tmp_path / "csg_14_100.yaml").write_text("mine")
    code, _, error = flexspline("joint", "new", *words())
    assert code == 2 and "--force replaces it" in error
    assert (tmp_path / "csg_14_100.yaml").read_text() == "mine"
    assert flexspline("joint", "new", *words(), "--force")[0] == 0
    assert load_joint("csg_14_100.yaml").name == "csg-14-100"


def test_what_is_known_takes_the_place_of_a_rule(flexspline):
    more = [
        "--set", "K1=3.4 Nm/arcmin", "--set", "current_limit=5 A", "--source", "K1=measured", "--tolerance", "K1=0.01",
        "--inertia", "0.2", "--gravity-moment", "4",
    ]  # fmt: skip
    code, out, error = flexspline("joint", "new", *words(), *more, "--json")
    assert code == 0, error
    assert not {"K1", "current_limit", "gravity of link", "inertia of link"} & {
        f["name"] for f in json.loads(out)["filled"]
    }
    joint = load_joint("csg_14_100.yaml")
    assert joint.numbers["K1"].value == pytest.approx(3.4 * 60 * 180 / np.pi)
    assert (joint.numbers["K1"].source, joint.numbers["K1"].tolerance) == ("measured", 0.01)
    assert (joint.mountings["link"].inertia, joint.mountings["link"].gravity_moment) == (0.2, 4)


def test_a_slip_of_a_unit_is_said_when_the_joint_is_made(flexspline):
    code, out, error = flexspline("joint", "new", *words(rotor_inertia="0.181"))  # kg·cm², and no unit said
    assert code == 0, error
    assert re.search(r"csg_14_100.yaml:\d+: warning: numbers.Jm: expected", out) and "mechanical time constant" in out
    code, out, _ = flexspline("joint", "new", *words(), "--force", "--json")
    assert json.loads(out)["problems"] == []


def test_a_new_joint_runs(flexspline):
    """Relative to the current folder, as in the command's output."""
    code, out, _ = flexspline("joint", "new", *words())
    typed = next(line for line in out.splitlines() if "flexspline run" in line)
    more = shlex.split(typed.partition("flexspline ")[2])
    code, _, error = flexspline(
        *more, "--set", "duration=1.5", "--set", "filters=[EKF]", "--out", "runs", "--no-figures", "--no-recording"
    )
    assert code == 0, error
    assert Path("runs/link_sweep").is_dir()


def made_joints() -> list[list[str]]:
    text = (ROOT / "docs" / "joints.md").read_text(encoding="utf-8")
    joined = text.replace("\\\n", " ")
    lines = [line.strip() for line in joined.splitlines() if line.startswith("    flexspline joint new --gear")]
    return [shlex.split(line)[1:] for line in lines if "--name" in line]


def test_shipped_joints_are_what_their_commands_make(flexspline, tmp_path):
    """docs/joints.md has the commands: rules and files agree, except for the gains, which shipped joints leave to scenarios."""
    commands = made_joints()
    assert len(commands) == 6
    for command in commands:
        code, out, error = flexspline(*command, "--json")
        assert code == 0, error
        path = Path(json.loads(out)["file"])
        text, gains = re.subn(r"# as fast as .*\ncontroller: .*\n", "", path.read_text(encoding="utf-8"))
        assert gains == 1 and text == (ROOT / "models" / path.name).read_text(encoding="utf-8"), path.name
        mjcf = path.with_suffix(".xml")
        assert mjcf.read_text(encoding="utf-8") == (ROOT / "models" / mjcf.name).read_text(encoding="utf-8"), mjcf.name


# --- check -------------------------------------------------------------------------------------------------------

NONSENSE = {
    "numbers.Jm": ("Jm: {value: 1.38e-5", "Jm: {value: 3.33", "got 3.33"),
    "numbers.N": ("N: {value: 100", "N: {value: 0.01", "got 0.01"),
    "numbers.K3": ("K3: {value: 13000", "K3: {value: 8000", "expected K3 ≥ K1 = 8400 N·m/rad"),
    "numbers.Fs": ("Fs: {value: 0.022", "Fs: {value: 0.012", "expected Fs ≥ Fc = 0.018 N·m"),
    "numbers.bm": ("  bm:", "  #bm:", "missing (viscous friction of the rotor, in N·m·s/rad)"),
    "numbers.T1": ("T1: {value: 3.9", "T1: {value: soft", "expected a valid number"),
    "numbers.R": ("unit: ohm", "unit: mohm", "expected 'ohm', got 'mohm'"),
    "mounting": ("mounting: link\n", "mounting: lnik\n", "got 'lnik'"),
    "sensors.motor_encoder": ("{counts: 4096}", "{counts: 4096, bits: 12}", "expected either counts"),
    "colour": ("format: 1", "format: 1\ncolour: red", "unknown key"),
}


@pytest.mark.parametrize("symbol", ["Kt", "Fc", "K1", "bl"])
def test_a_number_that_alone_is_missing_is_a_line(flexspline, tmp_path, symbol):
    """A traceback, where the joint's MJCF said it, too."""
    lines = [line for line in TEXT.splitlines(keepends=True) if not line.startswith(f"  {symbol}: ")]
    assert len(lines) == len(TEXT.splitlines()) - 1
    path = tmp_path / "mine.yaml"
    path.write_text("".join(lines), encoding="utf-8")
    code, out, err = flexspline("joint", "check", path)
    assert code == 2 and f"numbers.{symbol}" in out + err and "missing" in out + err


def broken(*names: str) -> str:
    text = TEXT
    for name in names or NONSENSE:
        old, new, _ = NONSENSE[name]
        assert old in text
        text = text.replace(old, new, 1)
    return text


def test_all_errors_are_said_at_once(flexspline, tmp_path):
    path = tmp_path / "mine.yaml"
    path.write_text(broken(), encoding="utf-8")
    code, out, error = flexspline("joint", "check", path)
    assert code == 2 and error == ""
    lines = [line for line in out.splitlines() if ": error: " in line]
    for field, (_, _, expected) in NONSENSE.items():
        (line,) = [
            line for line in lines if re.match(rf"{re.escape(str(path))}(:\d+)?: error: {re.escape(field)}", line)
        ]
        assert expected in line
    assert len(lines) == len(NONSENSE)
    assert out.splitlines()[-1].startswith(f"{path}: {len(NONSENSE)} errors, ")


@pytest.mark.parametrize("field", NONSENSE)
def test_one_error_alone_is_one_error(flexspline, tmp_path, field):
    (tmp_path / "mine.yaml").write_text(broken(field), encoding="utf-8")
    code, out, _ = flexspline("joint", "check", "mine.yaml", "--json")
    found = json.loads(out)
    assert code == 2 and found["errors"] == 1
    assert [p["field"].startswith(field) for p in found["problems"] if p["severity"] == "error"] == [True]


def test_empty_or_no_yaml_is_an_error_of_the_file(flexspline, tmp_path):
    for text in ("", "numbers: [\n", "[]"):
        (tmp_path / "mine.yaml").write_text(text)
        code, out, _ = flexspline("joint", "check", "mine.yaml")
        assert code == 2 and ": error: file: " in out and "1 error," in out
    code, out, error = flexspline("joint", "check", "nothing.yaml")
    assert code == 2 and out == "" and "expected a path or one of" in error


def test_numbers_that_no_maker_has_are_warnings(flexspline, tmp_path):
    """A slip of a unit that alone could be: stiffness in N·m/arcmin, inertia in kg·cm²."""
    slips = {"K2: {value: 9400": "K2: {value: 2.7", "Jm: {value: 1.38e-5": "Jm: {value: 0.138"}
    text = TEXT
    for old, new in slips.items():
        text = text.replace(old, new)
    (tmp_path / "mine.yaml").write_text(text, encoding="utf-8")
    code, out, _ = flexspline("joint", "check", "mine.yaml")
    assert code == 0 and "no errors" in out
    warned = [line for line in out.splitlines() if ": warning: " in line]
    assert any("numbers.K2" in line and "torsion of 0.3 to 8 mrad" in line for line in warned)
    assert any("numbers.Jm" in line and "mechanical time constant" in line for line in warned)


def test_fitted_numbers_may_cross(flexspline, tmp_path):
    text = broken("numbers.Fs").replace("Fs: {value: 0.012,", "Fs: {value: 0.012, nominal: 0.022,")
    (tmp_path / "mine.yaml").write_text(text, encoding="utf-8")
    code, out, _ = flexspline("joint", "check", "mine.yaml")
    assert code == 0 and ": warning: numbers.Fs: expected Fs ≥ Fc" in out


@pytest.mark.parametrize("name", sorted(known_joints()))
def test_shipped_joints_have_no_errors(flexspline, name):
    code, out, _ = flexspline("joint", "check", name, "--json")
    found = json.loads(out)
    assert code == 0 and found["errors"] == 0
    if not name.startswith("lara8"):  # whose current is a torque by another name
        assert found["warnings"] == 0


def test_what_check_refuses_for_its_fields_commands_refuse_too(flexspline, tmp_path):
    """N and Jm beyond all that is made are slips: no command takes them."""
    for field in ("numbers.Jm", "numbers.N"):
        (tmp_path / "mine.yaml").write_text(broken(field), encoding="utf-8")
        code, _, error = flexspline("joint", "show", "mine.yaml")
        assert code == 2 and f"{field}.value: expected" in error


def test_numbers_that_contradict_each_other_are_said_where_the_joint_is_used(flexspline, tmp_path):
    (tmp_path / "mine.yaml").write_text(broken("numbers.Fs"), encoding="utf-8")
    code, _, error = flexspline("joint", "show", "mine.yaml")
    assert code == 0
    lines = (tmp_path / "mine.yaml").read_text(encoding="utf-8").splitlines()
    (number,) = [i for i, line in enumerate(lines, 1) if line.strip().startswith("Fs:")]
    assert error.startswith(f"flexspline: mine.yaml:{number}: numbers.Fs: expected Fs ≥ Fc") and error.count("\n") == 1


# --- show --------------------------------------------------------------------------------------------------------


@pytest.mark.fast_every(3)
@pytest.mark.parametrize("name", ["test-joint", "csg-40-120-ilm115", "lara8-joint3-extended"])
def test_a_joint_is_shown_in_80_columns(flexspline, tmp_path, name):
    code, out, error = flexspline("joint", "show", name, "--out", "a.png")
    assert code == 0, error
    assert max(map(len, out.splitlines())) <= 80
    for words in (
        "torsion [mrad]",
        "Resonances [Hz]",
        "a count of the motor's",
        "cogging",
    ):
        assert words in out
    assert (tmp_path / "a.png").read_bytes().startswith(b"\x89PNG")


def test_a_joint_is_shown_to_programs(flexspline):
    code, out, error = flexspline("joint", "show", "test-joint", "--json")
    assert code == 0, error
    found = json.loads(out)
    assert found["joint"] == "test-joint" and found["half_width"] == pytest.approx(0.157e-3, rel=0.02)
    assert len(found["torque"]) == len(found["torsion"]) == len(found["torsion_deviation"])
    assert "stiffness" in found["diagnosis"]["with both encoders and the motor current"]


def test_show_refuses_what_it_cannot_draw(flexspline):
    code, out, error = flexspline("joint", "show", "test-joint", "--out", "a.pdf")
    assert code == 2 and out == "" and "expected a file .png" in error
    code, _, error = flexspline("joint", "show", "test-jont")
    assert code == 2 and "did you mean 'test-joint'?" in error


def test_the_group_says_what_it_has(flexspline):
    code, out, _ = flexspline("joint", "--help")
    assert code == 0 and all(name in out for name in ("new", "check", "show"))
    code, _, error = flexspline("joint", "chek", "test-joint")
    assert code == 2 and "check" in error
    assert flexspline("joint", "new", "--help")[0] == 0


def test_the_yaml_is_as_people_write_it(flexspline, tmp_path):
    flexspline("joint", "new", *words())
    text = (tmp_path / "csg_14_100.yaml").read_text(encoding="utf-8")
    rows = [line for line in text.splitlines() if line.startswith("  K1: ")]
    assert len(rows) == 1 and yaml.safe_load(rows[0])["K1"]["unit"] == "N·m/rad"


ODD = [None, [], {}, "x", -1.0, 0, 1e300, True, [1, 2], {"a": 1}, "Nm", 10**400]


def test_what_has_no_errors_loads_and_what_does_not_load_has(tmp_path, rng):
    """Files with places replaced at random."""
    from flexspline.models.errors import InputError
    from flexspline.models.joint_check import check

    for _ in range(15):
        data = yaml.safe_load(TEXT)
        for _ in range(int(rng.integers(1, 4))):
            place = data
            while True:
                keys = list(place) if isinstance(place, dict) else list(range(len(place)))
                key = keys[int(rng.integers(len(keys)))]
                deeper = isinstance(place[key], (dict, list)) and len(place[key]) and rng.random() < 0.8
                if not deeper:
                    place[key] = ODD[int(rng.integers(len(ODD)))]
                    break
                place = place[key]
        (tmp_path / "mine.yaml").write_text(yaml.safe_dump(data, allow_unicode=True), encoding="utf-8")
        checked = check(tmp_path / "mine.yaml")
        assert all("\n" not in problem.message and problem.field for problem in checked.problems)
        try:
            load_joint(tmp_path / "mine.yaml")
        except InputError:
            assert checked.errors, data
        else:
            contradicting = [p for p in checked.problems if p.severity == "error" and " ≥ " in p.message]
            assert checked.errors == len(contradicting), checked.problems
