"""Mapping files: other programs' logs as recordings; `flexspline import`."""

from __future__ import annotations

import datetime

import mujoco
import numpy as np
import pandas as pd
import pytest
import yaml
from typer.testing import CliRunner

import flexspline as fs
from flexspline import commands
from flexspline.diagnosis.data.importing import import_recording, known_layouts, load_layout
from flexspline.models.errors import InputError
from flexspline.models.recording import read_measurement, write_recording

LAYOUT = {
    "format": 1,
    "name": "mine",
    "joint": "test-joint",
    "link": {"inertia": 0.35, "gravity_moment": 9.0},
    "separator": ";",
    "columns": {
        "time": {"column": "t", "unit": "ms", "zero": "first"},
        "motor_position": {"column": "m", "unit": "counts", "counts": 4096, "sign": -1, "offset": 0.5},
        "link_position": {"column": "l", "unit": "deg", "zero": {"column": "angle", "unit": "rad"}},
        "motor_current": {"column": "i", "unit": "mA"},
        "joint_torque": {"sum": [{"column": "fx", "unit": "N", "scale": 0.5}, {"column": "my", "unit": "N·m"}]},
    },
}
LOG = "t;m;l;i;fx;my;angle;junk\n5000;0;10;100;2;1;0.1;x\n5001;1024;11;200;4;1;0.1;y\n"


def layout(tmp_path, **changes):
    data = {**LAYOUT, **changes}
    path = tmp_path / "mine.yaml"
    path.write_text(yaml.safe_dump(data, allow_unicode=True))
    return load_layout(path)


def columns(**changes):
    return {"columns": {**LAYOUT["columns"], **changes}}


def zero(**keys):
    link = LAYOUT["columns"]["link_position"]
    return columns(link_position={**link, "zero": {"column": "angle", **keys}})


def log(tmp_path, text=LOG):
    path = tmp_path / "log.csv"
    path.write_text(text)
    return path


def test_units_signs_zeros_and_sums(tmp_path):
    r = import_recording(layout(tmp_path), log(tmp_path))
    np.testing.assert_allclose(r.time, [0, 1e-3])
    np.testing.assert_allclose(r["motor_position"], [0.5, 0.5 - np.pi / 2])
    np.testing.assert_allclose(np.diff(r["link_position"]), np.deg2rad(1))
    assert np.mean(r["link_position"]) == pytest.approx(0.1)
    np.testing.assert_allclose(r["motor_current"], [0.1, 0.2])
    np.testing.assert_allclose(r["joint_torque"], [2.0, 3.0])
    assert "external_torque" not in r and r.external == "none" and r.joint == "test-joint"


def test_a_zero_in_counts(tmp_path):
    """One count was taken for a whole turn."""
    r = import_recording(layout(tmp_path, **zero(unit="counts", counts=360)), log(tmp_path))
    assert np.mean(r["link_position"]) == pytest.approx(np.deg2rad(0.1))


@pytest.mark.parametrize("word", ["yes", "on", "TRUE", "True", "'true'", "1"])
def test_only_true_and_false_are_truth_values(tmp_path, word):
    layout(tmp_path)
    path = tmp_path / "mine.yaml"
    text = path.read_text()
    path.write_text(text.replace("sign: -1", "sign: -1\n    wraps: true"))
    assert load_layout(path).columns["motor_position"].wraps is True
    path.write_text(text.replace("sign: -1", f"sign: -1\n    wraps: {word}"))
    with pytest.raises(InputError, match=r"wraps: expected true or false, got") as caught:
        load_layout(path)
    assert "\n" not in str(caught.value)


def test_an_encoder_that_wraps_is_unwrapped(tmp_path):
    wraps = {"column": "m", "unit": "counts", "counts": 4096, "wraps": True}
    text = "t;m;l;i;fx;my;angle\n" + "".join(f"{k};{(k * 1000) % 4096};0;0;0;0;0\n" for k in range(20))
    r = import_recording(layout(tmp_path, **columns(motor_position=wraps)), log(tmp_path, text))
    np.testing.assert_allclose(np.diff(r["motor_position"]), 2 * np.pi * 1000 / 4096)


@pytest.mark.parametrize(
    "changes, words",
    [
        ({"columns": {"motor_position": {"column": "t", "unit": "rad"}}}, ["columns.time: missing"]),
        (
            {"columns": {"time": {"column": "t", "unit": "s"}}},
            ["columns", "a position", "motor_position", "link_position"],
        ),
        (columns(motor_position={"column": "m", "unit": "rpm"}), ["columns.motor_position.unit", "'rad'"]),
        (columns(motor_curent={"column": "i", "unit": "A"}), ["motor_curent", "did you mean 'motor_current'"]),
        (columns(motor_current={"column": "i", "unit": "amp"}), ["unit", "'amp'"]),
        (columns(motor_current={"column": "i", "unit": "rad"}), ["columns.motor_current.unit", "'A'"]),
        (columns(motor_position={"column": "m", "unit": "counts"}), ["counts"]),
        (columns(motor_position={"column": "m", "unit": "counts", "counts": 10**400}), ["at most 100 digits"]),
        (columns(motor_current={"column": "i", "unit": "A", "sum": []}), ["either column or sum"]),
        (columns(external_torque={"column": "my", "unit": "N·m"}), ["external_torque", "'measured'"]),
        (columns(time={"column": "t", "unit": "s", "integrate": True, "scale": 2.0}), ["columns.time.integrate"]),
        (zero(unit="counts"), ["link_position: zero.counts: expected with unit 'counts'"]),
        (zero(unit="A"), ["columns.link_position.zero.unit", "'rad'"]),
        (
            columns(motor_position={"sum": [{"column": "m", "unit": "A"}]}),
            ["columns.motor_position.sum.0.unit", "'rad'", "got 'A'"],
        ),
        (
            columns(joint_torque={"sum": [{"column": "my", "unit": "N·m"}, {"column": "fx", "unit": "N"}]}),
            ["columns.joint_torque.sum.1.unit", "'N·m'", "got 'N'"],
        ),
        (
            columns(link_position={"sum": [{"column": "l", "unit": "deg"}], "integrate": True}),
            ["columns.link_position.sum.0.unit", "'rad/s'", "got 'deg'"],
        ),
        (
            columns(link_position={"column": "l", "unit": "deg", "integrate": True}),
            ["columns.link_position.unit", "'rad/s'", "got 'deg'"],
        ),
    ],
)
def test_a_bad_mapping_is_named(tmp_path, changes, words):
    with pytest.raises(InputError) as error:
        layout(tmp_path, **changes)
    message = str(error.value)
    assert "mine.yaml" in message and "\n" not in message
    for word in words:
        assert word in message


def test_parts_of_a_sum_may_have_a_factor_with_a_unit(tmp_path):
    """A lever, also one of 1 m, and a torque constant; a speed that is the sum of two."""
    lever = [{"column": "fx", "unit": "N", "scale": 1.0}, {"column": "my", "unit": "mN·m"}]
    r = import_recording(layout(tmp_path, **columns(joint_torque={"sum": lever})), log(tmp_path))
    np.testing.assert_allclose(r["joint_torque"], [2.001, 4.001])
    constant = [{"column": "i", "unit": "mA", "scale": 0.1}, {"column": "my", "unit": "N·m"}]
    r = import_recording(layout(tmp_path, **columns(joint_torque={"sum": constant})), log(tmp_path))
    np.testing.assert_allclose(r["joint_torque"], [1.01, 1.02])
    speeds = {"sum": [{"column": "l", "unit": "rad/s"}, {"column": "my", "unit": "rpm"}], "integrate": True}
    r = import_recording(layout(tmp_path, **columns(link_position=speeds)), log(tmp_path))
    np.testing.assert_allclose(r["link_position"], [0.0, 1e-3 * (10.5 + 2 * np.pi / 60)])


@pytest.mark.parametrize(
    "text, words",
    [
        (LOG.replace(";angle", ";winkel"), ["'angle'", "missing", "link_position"]),
        (LOG.replace("5001", "4999"), ["'time'", "row 1"]),
        (LOG.replace(";200;", ";;"), ["'i'", "row 1"]),
        (LOG.replace(";200;", ";inf;"), ["'i'", "row 1"]),
        (LOG.splitlines()[0] + "\n", ["header alone"]),
        ("", ["empty"]),
        (LOG.replace(";junk", ";i"), ["'i'", "found 2 times"]),
    ],
)
def test_a_bad_log_is_named(tmp_path, text, words):
    with pytest.raises(InputError) as error:
        import_recording(layout(tmp_path), log(tmp_path, text))
    for word in ["log.csv", *words]:
        assert word in str(error.value)


def test_the_shipped_layouts_are_valid():
    assert {"lara8", "ur3e"} <= set(known_layouts())
    for name in known_layouts():
        assert load_layout(name).name == name
    with pytest.raises(InputError, match="did you mean 'lara8'"):
        load_layout("lara9")


def test_decimal_commas_semicolons_latin_1_and_speeds(tmp_path):
    path = tmp_path / "log.csv"
    rows = "".join(f"{k / 100:.2f}".replace(".", ",") + f";6,0;{k % 3},5;25 °C\n" for k in range(50))
    path.write_bytes(("Zeit;Drehzahl;I;Wärme µ\n" + rows).encode("latin-1"))
    data = {
        "format": 1, "name": "german", "joint": "test-joint", "link": LAYOUT["link"], "decimal": ",",
        "columns": {
            "time": {"column": "Zeit", "unit": "s"},
            "motor_position": {"column": "Drehzahl", "unit": "rpm", "integrate": True, "offset": 1.0},
            "motor_current": {"column": "I", "unit": "A"},
            "joint_torque": {"column": "M", "unit": "N·m", "optional": True},
        },
    }  # fmt: skip
    mapping = tmp_path / "german.yaml"
    mapping.write_text(yaml.safe_dump(data, allow_unicode=True))
    r = import_recording(load_layout(mapping), path)
    np.testing.assert_allclose(r["motor_position"], 1.0 + 6.0 * 2 * np.pi / 60 * r.time, atol=1e-12)
    np.testing.assert_allclose(r["motor_current"][:4], [0.5, 1.5, 2.5, 0.5])
    assert "joint_torque" not in r
    path.write_bytes(path.read_bytes().replace(b"0,10;6,0", "0,10;6,0°".encode("latin-1")))
    with pytest.raises(InputError, match=r"'Drehzahl', row 10 .*6,0°"):
        import_recording(load_layout(mapping), path)


def test_a_zero_that_is_known_is_kept(tmp_path):
    zero = {"column": "angle", "unit": "rad", "beyond": 0.05}
    known = {"column": "l", "unit": "rad", "offset": -9.5, "zero": zero}
    text = "t;m;l;i;fx;my;angle\n" + "".join(f"{k};0;{10 + 0.01 * k};0;0;0;{0.5 + 0.01 * k}\n" for k in range(5))
    near = import_recording(layout(tmp_path, **columns(link_position=known)), log(tmp_path, text))
    assert near["link_position"][0] == pytest.approx(0.5)
    off = import_recording(layout(tmp_path, **columns(link_position={**known, "offset": -9.46})), log(tmp_path, text))
    assert off["link_position"][0] == pytest.approx(0.54)
    away = import_recording(layout(tmp_path, **columns(link_position={**known, "offset": -7.0})), log(tmp_path, text))
    assert away["link_position"][0] == pytest.approx(0.5)


def test_an_offset_is_added_beside_a_zero(tmp_path):
    """It was taken off again with the zero."""
    plain = import_recording(layout(tmp_path), log(tmp_path))
    for name, source in LAYOUT["columns"].items():
        if "zero" in source:
            mine = layout(tmp_path, **columns(**{name: {**source, "offset": 0.25}}))
            found = import_recording(mine, log(tmp_path)).signals
            before, after = (x.time if name == "time" else x[name] for x in (plain.signals, found))
            np.testing.assert_allclose(after, before + 0.25, atol=1e-12, err_msg=name)


def run(*arguments):
    return CliRunner().invoke(commands.app, ["import", *map(str, arguments)])


@pytest.fixture
def mapping(tmp_path):
    layout(tmp_path)
    return tmp_path / "mine.yaml"


def test_several_logs_at_once(tmp_path, mapping):
    for stem in ("a", "b"):
        (tmp_path / f"{stem}.csv").write_text(LOG)
    result = run(mapping, tmp_path / "a.csv", tmp_path / "b.csv", "--out", tmp_path / "out")
    assert result.exit_code == 0, result.output
    assert [r.name for r in read_measurement(tmp_path / "out").recordings] == ["a", "b"]


def test_a_mapping_without_a_log_is_told_that_one_is_missing(flexspline, tmp_path, mapping):
    code, _, err = flexspline("import", mapping, "--out", tmp_path / "m")
    assert code == 2 and err.count("\n") == 1 and "expected one log or more after it, got none" in err


def test_logs_without_a_format_are_told_that_it_is_missing(flexspline, tmp_path, mapping):
    table = pd.DataFrame({"t": [0.0, 1.0]})
    table.to_csv(tmp_path / "a.csv")
    table.to_csv(tmp_path / "b.csv")
    table.to_parquet(tmp_path / "c.parquet")
    (tmp_path / "bag").mkdir()
    (tmp_path / "bag" / "metadata.yaml").write_text("rosbag2_bagfile_information: {}\n")
    for logs in (
        ["a.csv", "b.csv"],
        ["c.parquet", "a.csv"],
        ["a.csv"],
        ["c.parquet"],
        ["bag", "a.csv"],
        ["a.csv", mapping],
    ):
        code, _, err = flexspline("import", *(tmp_path / name for name in logs), "--out", tmp_path / "m")
        assert code == 2 and err.count("\n") == 1, err
        assert str(tmp_path / logs[0]) in err and "FORMAT" in err and all(name in err for name in known_layouts()), err
    plain = tmp_path / "mapping"  # a mapping by any name is one
    plain.write_text(mapping.read_text())
    assert flexspline("import", plain, log(tmp_path), "--out", tmp_path / "m")[0] == 0


def test_nothing_is_overwritten_or_written_elsewhere(tmp_path, mapping):
    out = tmp_path / "out"
    assert run(mapping, log(tmp_path), "--out", out).exit_code == 0
    before = {p.name: p.read_bytes() for p in out.iterdir()}
    for arguments in (
        (mapping, log(tmp_path), "--out", out),
        (mapping, log(tmp_path), "--out", out, "--name", "../esc"),
        (mapping, log(tmp_path), log(tmp_path), "--out", out, "--force"),
        (mapping, "--out", out),
        (out, "--out", out, "--force"),
    ):
        result = run(*arguments)
        assert isinstance(result.exception, InputError) and "\n" not in str(result.exception)
    assert {p.name: p.read_bytes() for p in out.iterdir()} == before
    assert not (tmp_path / "esc.parquet").exists()
    (out / "own.parquet").write_text("somebody's")
    assert isinstance(run(mapping, log(tmp_path), "--out", out, "--name", "own", "--force").exception, InputError)
    assert (out / "own.parquet").read_text() == "somebody's"
    (tmp_path / "log.csv").write_text(LOG.replace("100", "300"))
    assert run(mapping, tmp_path / "log.csv", "--out", out, "--force").exit_code == 0
    assert read_measurement(out / "log.parquet").recordings[0]["motor_current"][0] == pytest.approx(0.3)


def test_a_joint_beside_the_mapping_is_found_from_the_recording(tmp_path, mapping):
    from flexspline.models.joint import known_joints

    (tmp_path / "j.yaml").write_text(known_joints()["test-joint"].read_text())
    (tmp_path / "test_joint.xml").write_text((known_joints()["test-joint"].parent / "test_joint.xml").read_text())
    layout(tmp_path, joint="j.yaml")
    assert run(mapping, log(tmp_path), "--out", tmp_path / "deep" / "out").exit_code == 0
    assert read_measurement(tmp_path / "deep" / "out").load_joint().name == "test-joint"


def test_the_ur3e_shoulder_hangs_on_its_arm(shared, tmp_path):
    source = shared / "data" / "ur3e" / "shoulder_first_half.csv"
    assert run("ur3e", source, "--out", tmp_path).exit_code == 0
    recording = read_measurement(tmp_path).recordings[0]
    assert set(recording.columns) == {"link_position", "motor_current", "position_command"}
    assert recording.link.inertia == pytest.approx(0.82, rel=0.01)
    assert recording.link.gravity_moment == pytest.approx(18.6, rel=0.01)
    result = CliRunner().invoke(commands.app, ["check", str(tmp_path)])
    assert result.exit_code == 0 and "torsion is not measured" in result.output and "no mistake" in result.output


def test_the_ur3e_shoulder_is_pulled_as_its_arm_says():
    from flexspline.models import laws
    from flexspline.models.joint import load_joint
    from flexspline.sim import plant

    joint = load_joint("ur3e-shoulder")
    record, model = joint.record(), plant.build(joint)
    data = mujoco.MjData(model)
    for q in (-3.0, -1.5, 0.0):
        plant.start(model, data, np.array([101 * q, 101 * q, q]))
        mujoco.mj_forward(model, data)
        assert -data.qfrc_bias[2] == pytest.approx(laws.gravity_torque(q, record[0]), rel=1e-9)
        assert -data.qfrc_bias[2] == pytest.approx(18.61 * np.cos(q), abs=1e-3)


def test_lara8_takes_a_file_of_another_power_up(shared, tmp_path):
    source = shared / "data" / "lara8" / "joint3_outbound.csv"
    one = import_recording(load_layout("lara8"), source)
    lines = source.read_text().splitlines()
    names = lines[0].split(",")
    motor, target = names.index("encoder_motorinc_3"), names.index("target_joint_angles_3")
    rows = [line.split(",") for line in lines]
    for row in rows[1:]:
        row[motor] = str(int(row[motor]) + 123456789)
    text = "\n".join(",".join(cell for i, cell in enumerate(row) if i != target) for row in rows)
    (tmp_path / "other.csv").write_text(text + "\n")
    other = import_recording(load_layout("lara8"), tmp_path / "other.csv")
    assert "position_command" not in other
    torsion = [r["motor_position"] / 101 - r["link_position"] for r in (one, other)]
    assert np.abs(np.mean(torsion[1])) < 5e-3 and np.ptp(torsion[0] - torsion[1]) < 1e-9


def parquet(tmp_path, **changes) -> dict[str, np.ndarray]:
    """A log of a machine that samples at 500 Hz, as Parquet, and its columns."""
    n = 400
    begin = datetime.datetime(2026, 3, 1, 12, 0, 0)
    table = {
        "t": [begin + datetime.timedelta(milliseconds=2 * k) for k in range(n)],
        "m": np.arange(n) * 7, "l": np.linspace(0, 3, n), "i": np.linspace(-900, 900, n).astype(np.float32),
        "fx": np.ones(n), "my": np.zeros(n), "angle": np.linspace(0, 0.1, n), "speed": np.full(n, 12.0), "junk": ["x"] * n,
    } | changes  # fmt: skip
    pd.DataFrame(table).to_parquet(tmp_path / "log.parquet")
    return table


STAMPS = columns(time={"column": "t", "unit": "s"})


def test_parquet_with_stamps_integers_and_single_precision(tmp_path):
    table = parquet(tmp_path)
    r = import_recording(layout(tmp_path, **STAMPS), tmp_path / "log.parquet")
    np.testing.assert_allclose(r.time, 2e-3 * np.arange(400), rtol=0, atol=1e-12)
    np.testing.assert_allclose(np.diff(r["motor_position"]), -7 * 2 * np.pi / 4096)
    np.testing.assert_allclose(r["motor_current"], 1e-3 * table["i"].astype(float))
    again = fs.import_log(tmp_path / "mine.yaml", tmp_path / "log.parquet", name="other")
    assert again.name == "other" and again["link_position"].tobytes() == r["link_position"].tobytes()


def test_nanoseconds_of_today_are_whole_numbers_that_no_float_holds(tmp_path):
    parquet(tmp_path, t=1_700_000_000_123_456_789 + 2_000_000 * np.arange(400))
    nanoseconds = columns(time={"column": "t", "unit": "ns"})
    r = import_recording(layout(tmp_path, **nanoseconds), tmp_path / "log.parquet")
    np.testing.assert_allclose(r.time - r.time[0], 2e-3 * np.arange(400), rtol=0, atol=3e-7)


@pytest.mark.parametrize(
    "changes, words",
    [
        ({"i": ["a"] * 400}, ["column 'i', row 0: expected a finite number, got 'a'", "400 of 400 rows"]),
        ({"i": [1.0] * 399 + [None]}, ["column 'i', row 399: expected a finite number"]),
        ({"t": [0.0] * 400}, ["'time', row 1"]),
    ],
)
def test_a_bad_parquet_log_is_named(tmp_path, changes, words):
    parquet(tmp_path, **changes)
    with pytest.raises(InputError) as error:
        import_recording(layout(tmp_path, **STAMPS), tmp_path / "log.parquet")
    for word in ["log.parquet", *words]:
        assert word in str(error.value)
    (tmp_path / "log.parquet").write_bytes(b"no table")
    with pytest.raises(InputError, match="not a readable Parquet file"):
        import_recording(layout(tmp_path), tmp_path / "log.parquet")


@pytest.mark.parametrize(
    ("separator", "decimal"), [(";", ","), (";", "."), (",", "."), ("\t", ","), ("\t", "."), (" ", "."), (" ", ",")]
)
def test_separator_and_decimal_mark_are_found(tmp_path, separator, decimal):
    """One mapping for logs of machines in different countries; speeds in rpm."""
    rows = [[0.002 * k, 30.0, -1.5e-1 * k, 3] for k in range(100)]
    text = "\n".join(
        [separator.join(["t", "n", "i", "l"]), *(separator.join(map(str, row)).replace(".", decimal) for row in rows)]
    )
    path = log(tmp_path, text + "\n")
    mapping = layout(
        tmp_path,
        separator=None,
        columns={
            "time": {"column": "t", "unit": "s"},
            "motor_position": {"column": "n", "unit": "rpm", "integrate": True},
            "motor_current": {"column": "i", "unit": "A"},
        },
    )
    r = import_recording(mapping, path)
    np.testing.assert_allclose(r["motor_position"], np.pi * r.time, atol=1e-12)
    np.testing.assert_allclose(r["motor_current"], -0.15 * np.arange(100))


def test_thousands_are_not_guessed(tmp_path):
    path = log(tmp_path, "t;m;l;i;fx;my;angle\n0;1;2;3;4;5;1.234,5\n1;1;2;3;4;5;1,5\n")
    with pytest.raises(InputError, match=r"column 'angle', row 0 \(line 2\): expected a finite number, got '1.234,5'"):
        import_recording(layout(tmp_path), path)


def test_a_recording_of_ones_own_may_be_written_so_too(tmp_path):
    (tmp_path / "a.csv").write_text("time;link_position;motor_current\n0,0;0,1;0,2\n0,5;0,2;0,4\n")
    (tmp_path / "a.yaml").write_text("format: 1\njoint: test-joint\nlink: {inertia: 1, gravity_moment: 0}\n")
    recording = fs.load_recording(tmp_path / "a.csv")
    assert recording["motor_current"].tolist() == [0.2, 0.4] and recording.time.tolist() == [0.0, 0.5]


PAYLOADS = {
    "empty*": {},
    "tool*": {"payload": {"mass": 2.0, "distance": 0.3, "inertia": 0.01}},
    "side*": {"payload": {"mass": 1.0, "distance": 0.5, "angle": np.pi / 2}},
    "locked*": {"link": {"inertia": 1e9, "gravity_moment": 0.0}},
}


def test_every_log_with_its_own_payload(tmp_path, mapping):
    """One command; what hung there adds as masses do, and fits what the cause `payload` makes of them."""
    from flexspline.models import causes
    from flexspline.models.joint import load_joint

    layout(tmp_path, logs=PAYLOADS)
    logs = [tmp_path / f"{name}_1.csv" for name in ("empty", "tool", "side", "locked", "other")]
    for path in logs:
        path.write_text(LOG)
    result = run(mapping, *logs, "--out", tmp_path / "out")
    assert result.exit_code == 0, result.output
    found = {r.name: r.link for r in read_measurement(tmp_path / "out").recordings}
    assert found["empty_1"] == found["other_1"] == load_layout(mapping).link
    assert found["tool_1"].inertia == pytest.approx(0.35 + 2.0 * 0.09 + 0.01)
    assert found["tool_1"].gravity_moment == pytest.approx(9.0 + 2.0 * 9.80665 * 0.3)
    assert found["locked_1"].locked
    record = load_joint("test-joint").record(load_layout(mapping).link)
    causes.get("payload").apply(record[0], {"mass": 1.0, "distance": 0.5, "angle": np.pi / 2})
    p, side = record[0], found["side_1"]
    assert (side.inertia, side.gravity_moment, side.gravity_angle) == pytest.approx(
        (p["Jl"], p["Mg"], p["gravity_angle"])
    )
    layout(tmp_path, logs={**PAYLOADS, "*_1.csv": {}})
    result = run(mapping, logs[0], "--out", tmp_path / "again")
    assert "got '*_1.csv', 'empty*'" in str(result.exception)


def test_a_pattern_that_fits_no_log_is_told(flexspline, tmp_path, mapping):
    layout(tmp_path, logs={"tool*": {"payload": {"mass": 1.0, "distance": 0.3}}, "lo?.csv": {}, "b*.csv": {}})
    code, _, err = flexspline("import", mapping, log(tmp_path), "--out", tmp_path / "m")
    assert code == 0 and err.count("\n") == 1 and "mine.yaml: logs: " in err
    assert "'b*.csv', 'tool*'" in err and "lo?" not in err and "log.csv" in err
    (tmp_path / "tool.csv").write_text(LOG)
    (tmp_path / "b1.csv").write_text(LOG)
    logs = [tmp_path / name for name in ("log.csv", "tool.csv", "b1.csv")]
    assert flexspline("import", mapping, *logs, "--out", tmp_path / "n")[2] == ""


def test_what_hung_there_by_its_name_in_the_description(tmp_path):
    """The joint's file may be one of somebody's own, beside the mapping; one log has another mounting, one a payload as well."""
    joint = fs.load_joint("test-joint")
    tilted = joint.mount().model_copy(update={"gravity_moment": 6.0, "gravity_angle": 0.4})
    joint.model_copy(update={"mountings": {**joint.mountings, "tilted": tilted}}).write(tmp_path / "bench.yaml")
    mass = {"payload": {"mass": 1.0, "distance": 0.5}}
    mine = layout(
        tmp_path,
        link=None,
        mounting="tilted",
        joint="bench.yaml",
        logs={"bare*": {"mounting": "no_load"}, "held*": mass},
    )
    for name in ("log", "bare", "held"):
        (tmp_path / f"{name}.csv").write_text(LOG)
    links = {name: import_recording(mine, tmp_path / f"{name}.csv").link for name in ("log", "bare", "held")}
    assert links["log"] == tilted and links["bare"] == joint.mount("no_load")
    assert links["held"].gravity_moment == pytest.approx(6.0 + 0.5 * 9.80665) and links["held"].gravity_angle == 0.4
    with pytest.raises(InputError, match=r"mounting: expected one of .*, got 'tilted'"):
        import_recording(mine, tmp_path / "log.csv", joint="test-joint")
    with pytest.raises(InputError, match="expected one of link, mounting and arm, got link and mounting"):
        layout(tmp_path, mounting="tilted")


def test_a_mapping_may_be_called_as_the_log_beside_it(tmp_path, mapping):
    layout(tmp_path)
    log(tmp_path).rename(tmp_path / "mine.csv")
    result = run(tmp_path / "mine.yaml", tmp_path / "mine.csv", "--out", tmp_path / "out")
    assert result.exit_code == 0, result.output
    assert (tmp_path / "out" / "mine.parquet").is_file()


def test_a_joint_that_is_named_is_not_looked_for_beside_the_mapping(tmp_path, monkeypatch):
    """Where the motor alone was measured its gear ratio says how far the arm was."""
    from flexspline.models.joint import load_joint, shipped

    (tmp_path / "mapping").mkdir()
    (tmp_path / "mapping" / "my_arm.xml").write_text(shipped("ur3e.xml").read_text())
    monkeypatch.chdir(tmp_path)
    load_joint("ur3e-shoulder").write("mine.yaml")
    motor = {name: LAYOUT["columns"][name] for name in ("time", "motor_position", "motor_current")}
    arm = {"model": "my_arm.xml", "joint": "shoulder_lift"}
    angle = {"arm_elbow_position": {"column": "angle", "unit": "rad"}}
    mine = layout(tmp_path / "mapping", link=None, arm=arm, columns=motor | angle)
    found = import_recording(mine, log(tmp_path), joint="mine.yaml")
    assert found.joint == "mine.yaml" and found.link.gravity_moment > 5.0


def test_measurements_of_two_joints_are_not_one(tmp_path):
    """The second was written with the first one's joint."""
    from flexspline.models.joint import load_joint

    for name in ("a", "b"):
        folder = tmp_path / name
        folder.mkdir()
        load_joint("test-joint").write(folder / "joint.yaml")
        r = import_recording(layout(tmp_path), log(tmp_path), name, joint="joint.yaml")
        write_recording(r, folder)
    both = (tmp_path / "a", tmp_path / "b", "--fix", "--out", tmp_path / "both")
    result = run(*both)
    assert isinstance(result.exception, InputError) and "of one joint" in str(result.exception)
    assert not (tmp_path / "both").exists()
    result = run(*both, "--joint", tmp_path / "b" / "joint.yaml")
    assert result.exit_code == 0, result.output
    assert all(r.joint == "../b/joint.yaml" for r in read_measurement(tmp_path / "both").recordings)


def test_an_arm_may_lie_beside_the_mapping(tmp_path):
    from flexspline.models.joint import shipped

    (tmp_path / "my_arm.xml").write_text(shipped("ur3e.xml").read_text())
    (tmp_path / "logs").mkdir()
    mine = layout(tmp_path, link=None, arm={"model": "my_arm.xml", "joint": "shoulder_lift"})
    assert import_recording(mine, log(tmp_path / "logs")).link.gravity_moment > 5.0


@pytest.mark.parametrize(
    ("logs", "words"),
    [
        ({"a": {"payload": {"mass": 1}}}, "logs.a.payload.distance: missing"),
        ({"a": {"arm": {"model": "ur3e.xml", "joint": "elbow"}}}, "logs.a: expected link, mounting or payload"),
        ({"a": {"external_torque": "measured"}}, "logs.a.external_torque: expected 'measured' where"),
    ],
)
def test_a_bad_payload_is_named(tmp_path, logs, words):
    with pytest.raises(InputError) as caught:
        layout(tmp_path, logs=logs)
    assert words in str(caught.value)


def test_what_was_edited_is_kept(tmp_path, mapping):
    """A YAML file that somebody edited stays when its log is imported again, and must fit the new table."""
    out, path = tmp_path / "out", log(tmp_path)
    assert run(mapping, path, "--out", out).exit_code == 0
    sidecar = out / "log.yaml"
    written = sidecar.read_text()
    sidecar.write_text("# weighed on Monday\n" + written.replace("gravity_moment: 9.0", "gravity_moment: 8.7"))
    mine = sidecar.read_bytes()
    path.write_text(LOG.replace("100", "300"))
    for _ in range(2):
        result = run(mapping, path, "--out", out, "--force")
        assert result.exit_code == 0 and f"{sidecar}: kept, as it was edited" in result.output
        assert sidecar.read_bytes() == mine
        found = read_measurement(out / "log.parquet").recordings[0]
        assert found["motor_current"][0] == pytest.approx(0.3) and found.link.gravity_moment == 8.7
    sidecar.write_text(written.replace("external_torque: none", "external_torque: measured"))
    before = {p.name: p.read_bytes() for p in out.iterdir()}
    error = run(mapping, path, "--out", out, "--force").exception
    assert isinstance(error, InputError) and str(error).startswith(
        f"{sidecar}: expected the edited file to match the new table"
    )
    assert {p.name: p.read_bytes() for p in out.iterdir()} == before
    sidecar.write_text(written)
    layout(tmp_path, link={"inertia": 0.4, "gravity_moment": 9.5})
    assert run(mapping, path, "--out", out, "--force").exit_code == 0
    assert read_measurement(out / "log.parquet").recordings[0].link.gravity_moment == 9.5


@pytest.mark.parametrize("separator", [" ", ","])
def test_an_rtde_log_by_the_names_of_its_outputs(shared, tmp_path, separator):
    """As the maker's client and ur_rtde write it: the same as the shipped log, also with the other joints as columns."""
    source = shared / "data" / "ur3e" / "shoulder_first_half.csv"
    theirs = import_recording(load_layout("ur3e"), source)
    given, still = pd.read_csv(source), (0.0, None, 0.0, -1.5707963, 0.0, 0.0)
    table = {"timestamp": given["t_s"] + 81234.5}
    for what, own in (("target_q", "q_target_rad"), ("actual_q", "q_rad"), ("actual_current", "i_motor_A")):
        for k, value in enumerate(still):
            table[f"{what}_{k}"] = given[own] if value is None else np.full(len(given), value)
    table["joint_temperatures_1"] = np.full(len(given), 31.5)
    pd.DataFrame(table).to_csv(tmp_path / "log.csv", sep=separator, index=False)
    assert run("ur3e_rtde", tmp_path / "log.csv", "--out", tmp_path / "out").exit_code == 0
    (found,) = read_measurement(tmp_path / "out").recordings
    assert set(found.columns) == {*theirs.columns, "temperature"} and found.joint == "ur3e-shoulder"
    for name, values in theirs.columns.items():
        np.testing.assert_array_equal(found[name], values)
    np.testing.assert_allclose(found.time, theirs.time - theirs.time[0], atol=1e-9)
    np.testing.assert_allclose(found.known_torque, theirs.known_torque, atol=1e-9)
    assert found.link.gravity_moment == pytest.approx(theirs.link.gravity_moment)
