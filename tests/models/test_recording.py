"""Reading, checking and writing recordings."""

from __future__ import annotations

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from flexspline.models.errors import InputError
from flexspline.models.joint_parts import Mounting
from flexspline.models.recording import Recording, read_measurement, read_recording, write_recording
from flexspline.models.tables import read_table, write_table

SIDECAR = "format: 1\njoint: test-joint\nlink: {inertia: 0.35, gravity_moment: 9.0}\n"


def recording(name="sweep", n=50, **changes) -> Recording:
    t = np.arange(n) * 1e-3
    columns = dict(motor_position=np.sin(t), link_position=np.sin(t) / 100, motor_current=np.cos(t))
    fields = {k: changes.pop(k) for k in ("joint", "description", "link", "external") if k in changes}
    return Recording(name, changes.pop("time", t), {**columns, **changes}, **fields)


def write_csv(folder, text, sidecar=SIDECAR, name="a"):
    (folder / f"{name}.csv").write_text(text)
    (folder / f"{name}.yaml").write_text(sidecar)
    return folder / f"{name}.csv"


HEADER = "time,motor_position,link_position,motor_current\n"


def test_what_is_written_is_read(tmp_path):
    link = Mounting(inertia=0.2, gravity_moment=3.0, gravity_angle=0.1)
    before = recording(
        joint_torque=np.ones(50), external_torque=np.zeros(50), external="measured", link=link, description="ä",
    )  # fmt: skip
    path = write_recording(before, tmp_path)
    after = read_recording(path)
    for name, values in before.columns.items():
        np.testing.assert_array_equal(after[name], values)
    assert (after.link, after.external, after.description, after.joint) == (link, "measured", "ä", "test-joint")
    assert pq.read_schema(path).field("joint_torque").metadata == {b"unit": "N·m".encode()}
    assert sorted(p.name for p in tmp_path.iterdir()) == ["sweep.parquet", "sweep.yaml"]
    assert read_recording(tmp_path / "sweep.yaml").name == "sweep"


def test_csv_is_read_with_the_same_header(tmp_path):
    path = write_csv(tmp_path, HEADER + "0,1,2,3\n0.001,1,2,3\n")
    np.testing.assert_array_equal(read_recording(path)["motor_current"], [3, 3])


@pytest.mark.parametrize("position", ["motor_position", "link_position"])
@pytest.mark.parametrize("torque", ["motor_current", "motor_torque", "joint_torque"])
def test_one_position_and_one_torque_are_a_recording(tmp_path, position, torque):
    t = np.arange(20) * 1e-3
    r = read_recording(write_recording(Recording("a", t, {position: np.sin(t), torque: np.cos(t)}), tmp_path))
    assert sorted(r.columns) == sorted([position, torque])
    assert position in r and "wrench" not in r
    np.testing.assert_array_equal(r.signals[torque], np.cos(t))
    with pytest.raises(InputError, match=r"column 'link_postion': missing"):
        r["link_postion"]
    with pytest.raises(InputError, match="expected a torque"):
        r.without(torque)


def test_a_recording_without_a_sensor():
    pushed = recording(external_torque=np.ones(50), external="measured")
    less = pushed.without("external_torque", "link_position")
    assert (less.external, sorted(less.columns)) == ("unmeasured", ["motor_current", "motor_position"])


def test_the_whole_wrench_and_the_temperature_are_kept(tmp_path):
    names = [f"{kind}_{axis}" for kind in ("force", "torque") for axis in "xyz"] + ["temperature", "motor_torque"]
    before = recording(**{name: np.full(50, float(i)) for i, name in enumerate(names)})
    path = write_recording(before, tmp_path)
    after = read_recording(path)
    for name in names:
        np.testing.assert_array_equal(after[name], before[name])
    units = {name: pq.read_schema(path).field(name).metadata[b"unit"].decode() for name in names}
    assert (units["force_x"], units["torque_z"], units["temperature"], units["motor_torque"]) == (
        "N",
        "N·m",
        "°C",
        "N·m",
    )


def test_gaps_split_into_segments():
    t = np.concatenate([np.arange(10) * 1e-3, 0.5 + np.arange(5) * 1e-3, 2.0 + np.arange(5) * 1e-3])
    r = recording(n=20, time=t)
    assert r.segments == (slice(0, 10), slice(10, 15), slice(15, 20))
    assert r.gaps == ((t[9], t[10]), (t[14], t[15]))
    assert recording().segments == (slice(0, 50),) and recording().gaps == ()


@pytest.mark.parametrize("start", [0.0, 1.7e9])
def test_samples_a_tenth_of_a_second_apart_are_not_gaps(start):
    t = start + 0.1 * np.arange(50)
    assert np.any(np.diff(t) > 0.1)
    assert recording(n=50, time=t).gaps == ()


def test_a_measurement_is_a_folder_of_tables_with_yaml(tmp_path):
    write_recording(recording("b"), tmp_path)
    write_csv(tmp_path, HEADER + "0,1,2,3\n0.001,1,2,3\n")
    (tmp_path / "notes.csv").write_text("not,a,recording\n")
    m = read_measurement(tmp_path)
    assert [r.name for r in m.recordings] == ["a", "b"]
    assert m.load_joint().name == "test-joint"
    assert read_measurement(tmp_path / "b.parquet").recordings[0].name == "b"
    assert m.passed_over == {tmp_path / "notes.csv": "notes.yaml is missing"}


def test_of_two_tables_of_a_name_one_is_read_and_the_other_is_named(tmp_path):
    """Also for the path of their YAML file; the path of a table selects that table."""
    write_recording(recording("a"), tmp_path)
    write_csv(tmp_path, HEADER + "0,1,2,3\n0.001,1,2,3\n")
    other = {tmp_path / "a.csv": "a.parquet was read"}
    for path in (tmp_path, tmp_path / "a.yaml"):
        m = read_measurement(path)
        assert [r.source for r in m.recordings] == [str(tmp_path / "a.parquet")]
        assert m.passed_over == other
    m = read_measurement(tmp_path / "a.csv")
    assert [r.source for r in m.recordings] == [str(tmp_path / "a.csv")] and not m.passed_over


@pytest.mark.parametrize(
    "rows, words",
    [
        ("0,1,2,3\n0.002,1,2,3\n0.001,1,2,3\n", ["'time'", "row 2", "line 4", "increase"]),
        ("0,1,2,3\n0,1,2,3\n", ["'time'", "row 1"]),
        ("0,1,2,3\n0.001,1,nan,3\n", ["'link_position'", "row 1", "nan"]),
        ("0,1,2,3\n0.001,1,,3\n", ["'link_position'", "row 1", "line 3"]),
        ("0,1,2,3\n0.001,1,2,many\n", ["'motor_current'", "row 1", "'many'"]),
        ("0,1,2,3\n0.001,1,2\n", ["row 1", "expected 4 columns, got 3"]),
        ("0,1,2,3\n\n0.001,1,2,many\n", ["row 1 (line 4)", "'many'"]),
        ("0,1,2,3\n", ["at least 2 rows"]),
        ("", ["at least 2 rows"]),
    ],
)
def test_a_bad_row_is_named(tmp_path, rows, words):
    with pytest.raises(InputError) as error:
        read_recording(write_csv(tmp_path, HEADER + rows))
    message = str(error.value)
    assert "a.csv" in message and "\n" not in message
    for word in words:
        assert word in message


@pytest.mark.parametrize(
    "header, words",
    [
        (
            "time,motor_position,link_position\n0,1,2\n1,1,2\n",
            ["a torque", "motor_current, motor_torque, joint_torque"],
        ),
        ("time,motor_current\n0,1\n1,1\n", ["a position", "motor_position, link_position"]),
        ("motor_position,motor_current\n0,1\n1,1\n", ["'time'", "missing"]),
        (
            "time,motor_position,link_position,motor_current,joint_torqe\n0,1,2,3,4\n1,1,2,3,4\n",
            ["'joint_torqe'", "unknown", "did you mean 'joint_torque'"],
        ),
        ("time,time,motor_position,link_position,motor_current\n0,1,2,3,4\n", ["'time'", "duplicate"]),
    ],
)
def test_a_bad_header_is_named(tmp_path, header, words):
    with pytest.raises(InputError) as error:
        read_recording(write_csv(tmp_path, header))
    for word in words:
        assert word in str(error.value)


def test_parquet_of_wrong_type_unit_or_with_nulls(tmp_path):
    good = {name: np.arange(3.0) for name in ("time", "motor_position", "link_position", "motor_current")}
    (tmp_path / "a.yaml").write_text(SIDECAR)
    path = tmp_path / "a.parquet"
    for column, words in (
        (pa.array(["x", "y", "z"]), ["'motor_current'", "expected numbers", "string"]),
        (pa.array([1.0, None, 2.0]), ["'motor_current'", "row 1"]),
        (pa.array([1.0, np.nan, 2.0]), ["'motor_current'", "row 1", "nan"]),
    ):
        pq.write_table(pa.table({**good, "motor_current": column}), path)
        with pytest.raises(InputError) as error:
            read_recording(path)
        assert all(word in str(error.value) for word in words)
    field = pa.field("motor_current", pa.float64(), metadata={"unit": "mA"})
    table = pa.table({**good}).drop_columns("motor_current").append_column(field, pa.array(np.arange(3.0)))
    pq.write_table(table, path)
    with pytest.raises(InputError, match="expected unit 'A', got 'mA'"):
        read_recording(path)
    spelt = pa.field("joint_torque", pa.float64(), metadata={"unit": "Nm"})
    pq.write_table(pa.table(good).append_column(spelt, pa.array(np.arange(3.0))), path)
    np.testing.assert_array_equal(read_recording(path)["joint_torque"], np.arange(3.0))
    path.write_bytes(b"no parquet")
    with pytest.raises(InputError, match=r"a\.parquet: not a readable Parquet file"):
        read_recording(path)


@pytest.mark.parametrize(
    "sidecar, words",
    [
        (SIDECAR + "external_torque: measured\n", ["'external_torque'", "missing"]),
        (SIDECAR + "external_torque: some\n", ["external_torque", "'none', 'measured' or 'unmeasured'"]),
        (SIDECAR.replace("joint:", "jiont:"), ["jiont", "did you mean 'joint'"]),
        (SIDECAR.replace("inertia: 0.35", "inertia: -1"), ["link.inertia", "greater than 0"]),
        (SIDECAR.replace("format: 1", "format: 2"), ["format"]),
        ("[1, 2]", ["expected a mapping"]),
    ],
)
def test_a_bad_sidecar_is_named(tmp_path, sidecar, words):
    with pytest.raises(InputError) as error:
        read_recording(write_csv(tmp_path, HEADER + "0,1,2,3\n1,1,2,3\n", sidecar))
    assert "a.yaml" in str(error.value) or "a.csv" in str(error.value)
    for word in words:
        assert word in str(error.value)


def test_nothing_there(tmp_path):
    with pytest.raises(InputError, match="not found"):
        read_measurement(tmp_path / "none")
    with pytest.raises(InputError, match="got none"):
        read_measurement(tmp_path)
    (tmp_path / "a.csv").write_text(HEADER)
    with pytest.raises(InputError, match=r"YAML file a\.yaml next to it"):
        read_recording(tmp_path / "a.csv")
    with pytest.raises(InputError, match="expected a table"):
        read_recording(tmp_path / "a.txt")


def test_recordings_of_one_measurement_are_of_one_joint(tmp_path):
    write_recording(recording("a"), tmp_path)
    write_recording(recording("b", joint="lara8-joint3"), tmp_path)
    with pytest.raises(InputError, match=r"b\.yaml: joint: expected 'test-joint'"):
        read_measurement(tmp_path)


def test_external_torque_must_be_declared(tmp_path):
    with pytest.raises(InputError, match="expected 'measured'"):
        recording(external_torque=np.ones(50))
    assert recording(external_torque=np.zeros(50)).external == "none"


def test_the_examples_are_read(shared):
    for folder in sorted((shared / "data" / "examples").glob("*/00")):
        m = read_measurement(folder)
        assert [r.name for r in m.recordings] == ["free", "push", "sweep"]
        assert m.recordings[1].external == "unmeasured"


@pytest.mark.parametrize("value", [1e308, -1e31])
def test_a_number_that_no_sensor_reads_is_refused(value):
    with pytest.raises(
        InputError, match=r"column 'motor_current', row 2: expected a number of at most 1e\+30, got -?1e"
    ):
        recording(motor_current=np.where(np.arange(50) == 2, value, 0.0))


def test_a_table_in_several_groups_of_rows_is_read_as_one(tmp_path):
    path = write_recording(recording(n=100), tmp_path)
    table = pq.read_table(path)
    with pq.ParquetWriter(path, table.schema) as writer:
        for part in (table.slice(0, 0), table.slice(0, 30), table.slice(0, 0), table.slice(30)):
            writer.write_table(part)
    np.testing.assert_array_equal(read_recording(path)["motor_position"], table["motor_position"])


def test_utf_16_is_read(tmp_path):
    path = tmp_path / "log.csv"
    path.write_text(HEADER + "0,1,2,3\n0.001,1,2,3\n", encoding="utf-16")
    path.with_suffix(".yaml").write_text("format: 1\njoint: test-joint\nlink: {inertia: 0.35, gravity_moment: 9.0}\n")
    np.testing.assert_array_equal(read_measurement(path).recordings[0]["motor_current"], [3.0, 3.0])


def test_an_unknown_column_suggests_import(tmp_path):
    path = tmp_path / "log.csv"
    path.write_text("time,motor_position,motor_current,status\n0,1,2,3\n")
    path.with_suffix(".yaml").write_text("format: 1\njoint: test-joint\nlink: {inertia: 0.35, gravity_moment: 9.0}\n")
    with pytest.raises(InputError, match=r"'status': unknown column.*flexspline import"):
        read_measurement(path)


def test_a_column_with_an_undecodable_name_is_one_line(tmp_path):
    """A damaged byte in a name was a UnicodeDecodeError: names are decoded when they are asked for."""
    path, n = tmp_path / "log.parquet", np.arange(100.0)
    units = {"time": "s", "motor_position": "rad", "motor_current": "A"}
    write_table(path, {"time": n, "motor_position": n, "motor_current": n}, units)
    path.write_bytes(path.read_bytes().replace(b"motor_current", b"mot\xb2r_current"))
    path.with_suffix(".yaml").write_text("format: 1\njoint: test-joint\nlink: {inertia: 0.1, gravity_moment: 0}\n")
    for read in (read_table, read_recording):
        with pytest.raises(InputError, match=r"log\.parquet: not a readable Parquet file: .* 0xb2"):
            read(path)
