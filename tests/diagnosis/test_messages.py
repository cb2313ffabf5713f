"""MCAP files and ROS 2 bags as logs: topics by name, stamps, interpolation; recordings as MCAP and back."""

from __future__ import annotations

import json
import sqlite3
import struct
import sys
from collections.abc import Iterable
from pathlib import Path

import numpy as np
import pytest
import yaml

import flexspline as fs
from flexspline.models.errors import InputWarning
from flexspline.models.recording import Recording, read_measurement, write_recording

pytest.importorskip("mcap_ros2")

BEGIN = 1_760_000_000_123_456_789  # ns
STEP = 2_000_000
N = 300
MAPPING = {
    "format": 1, "name": "bag", "joint": "test-joint", "link": {"inertia": 0.35, "gravity_moment": 9.0},
    "columns": {
        "time": {"column": "/joint_states/stamp", "unit": "s"},
        "motor_position": {"column": "/joint_states/position/motor", "unit": "rad"},
        "link_position": {"column": "/joint_states/position/link", "unit": "rad"},
        "motor_current": {"column": "/motor_current/data", "unit": "A"},
        "joint_torque": {"column": "/ft/wrench/torque/y", "unit": "N·m", "sign": -1, "optional": True},
    },
}  # fmt: skip


def motor(k: float) -> float:
    return 100 * np.sin(1e-2 * k)


def mapping(tmp_path, **columns) -> Path:
    path = tmp_path / "bag.yaml"
    path.write_text(
        yaml.safe_dump(MAPPING | {"columns": MAPPING["columns"] | columns}, allow_unicode=True), encoding="utf-8"
    )
    return path


class Cdr:
    """Messages as ROS 2 sends them: little-endian, every number at a multiple of its size."""

    def __init__(self):
        self.data = b""

    def put(self, kind: str, *values: float) -> Cdr:
        size = struct.calcsize(kind)
        for value in values:
            self.data += b"\0" * (-len(self.data) % size) + struct.pack(f"<{kind}", value)
        return self

    def text(self, *texts: str) -> Cdr:
        for text in texts:
            self.put("I", len(text) + 1)
            self.data += text.encode() + b"\0"
        return self

    def header(self, stamp: int) -> Cdr:
        return self.put("i", stamp // 10**9).put("I", stamp % 10**9).text("")

    def bytes(self) -> bytes:
        return b"\0\1\0\0" + self.data


def joint_state(stamp: int, positions: dict[str, float]) -> bytes:
    message = Cdr().header(stamp).put("I", len(positions)).text(*positions)
    return message.put("I", len(positions)).put("d", *positions.values()).put("I", 0, 0).bytes()


def wrench(stamp: int, torque: float) -> bytes:
    return Cdr().header(stamp).put("d", 1.0, 2.0, 3.0, 0.0, torque, 0.0).bytes()


KINDS = {
    "/joint_states": "sensor_msgs/msg/JointState",
    "/ft": "geometry_msgs/msg/WrenchStamped",
    "/motor_current": "std_msgs/msg/Float64",
}


def messages() -> Iterable[tuple[str, int, bytes]]:
    """Topic, time of logging, bytes: a joint whose names change places and a gripper on the same topic; a wrench between its
    samples; a current without a stamp."""
    found = []
    for k in range(N):
        stamp = BEGIN + k * STEP
        both = {"motor": motor(k), "link": 0.01 * motor(k)}
        found.append(
            ("/joint_states", stamp + 50_000, joint_state(stamp, dict(reversed(both.items())) if k % 3 else both))
        )
        if k % 7 == 0:
            found.append(("/joint_states", stamp + 60_000, joint_state(stamp + 500_000, {"gripper": 0.02})))
        found.append(("/ft", stamp + 900_000, wrench(stamp + STEP // 2, -0.05 * motor(k + 0.5))))
        found.append(("/motor_current", stamp, Cdr().put("d", 0.02 * motor(k)).bytes()))
    return found


def bag(folder: Path) -> Path:
    """A ROS 2 bag as a database."""
    folder.mkdir()
    with sqlite3.connect(folder / "bag_0.db3") as file:
        file.execute(
            "CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT, type TEXT, serialization_format TEXT, qos TEXT)"
        )
        file.execute("CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER, data BLOB)")
        number = {topic: i for i, topic in enumerate([*KINDS, "/rosout"], 1)}
        for topic, i in number.items():
            file.execute(
                "INSERT INTO topics VALUES (?, ?, ?, 'cdr', '')", (i, topic, KINDS.get(topic, "rcl_interfaces/msg/Log"))
            )
        rows = [(number[topic], logged, data) for topic, logged, data in messages()]
        file.executemany("INSERT INTO messages(topic_id, timestamp, data) VALUES (?, ?, ?)", rows)
    about = {
        "version": 5,
        "storage_identifier": "sqlite3",
        "relative_file_paths": ["bag_0.db3"],
        "compression_mode": "",
        "compression_format": "",
        "starting_time": {"nanoseconds_since_epoch": BEGIN},
        "duration": {"nanoseconds": N * STEP},
        "message_count": len(rows),
        "topics_with_message_count": [
            {
                "topic_metadata": {
                    "name": topic,
                    "type": KINDS.get(topic, "rcl_interfaces/msg/Log"),
                    "serialization_format": "cdr",
                    "offered_qos_profiles": "",
                },
                "message_count": sum(row[0] == i for row in rows),
            }
            for topic, i in number.items()
        ],
    }
    (folder / "metadata.yaml").write_text(yaml.safe_dump({"rosbag2_bagfile_information": about}))
    return folder


def mcap(path: Path, encoding: str = "cdr") -> Path:
    """The same as an MCAP file; of ROS 2 or of JSON."""
    from mcap.writer import Writer

    from flexspline.diagnosis.data.messages import DEFINITIONS

    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        channels = {}
        for topic, kind in KINDS.items():
            kinds = {
                "cdr": ("ros2msg", DEFINITIONS[kind].encode()),
                "json": ("jsonschema", b"{}"),
                "protobuf": ("protobuf", b""),
            }
            schema = writer.register_schema(kind, *kinds[encoding])
            channels[topic] = writer.register_channel(topic, encoding, schema)
        for topic, logged, data in messages():
            if encoding == "json":
                data = json.dumps(
                    {"data": struct.unpack("<d", data[4:])[0]} if topic == "/motor_current" else {}
                ).encode()
            writer.add_message(channels[topic], logged, data, logged)
        writer.finish()
    return path


@pytest.mark.parametrize("kind", ["folder", "database", "mcap"])
def test_topics_are_columns(flexspline, tmp_path, kind):
    """The samples are those of the time's topic; what other topics say is interpolated, and nothing beyond their ends."""
    source = mcap(tmp_path / "log.mcap") if kind == "mcap" else bag(tmp_path / "log")
    source = source / "bag_0.db3" if kind == "database" else source
    code, _, error = flexspline("import", mapping(tmp_path), source, "--out", tmp_path / "out")
    assert code == 0, error
    (recording,) = read_measurement(tmp_path / "out").recordings
    k = np.arange(1, N)  # the wrench begins half a sample later
    np.testing.assert_allclose(recording.time, 1e-9 * STEP * (k - 1), rtol=0, atol=1e-12)
    np.testing.assert_allclose(recording["motor_position"], motor(k), rtol=0, atol=1e-12)
    np.testing.assert_allclose(recording["link_position"], 0.01 * motor(k), rtol=0, atol=1e-14)
    np.testing.assert_allclose(recording["motor_current"], 0.02 * motor(k), rtol=0, atol=1e-9)
    np.testing.assert_allclose(recording["joint_torque"], 0.05 * motor(k), rtol=0, atol=1e-4)
    again = fs.import_log(tmp_path / "bag.yaml", source)
    assert again["joint_torque"].tobytes() == recording["joint_torque"].tobytes()


def ros1(path: Path) -> Path:
    """The same joint states and wrench as a ROS 1 bag."""
    from rosbags.rosbag1 import Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC)
    kind = store.types
    with Writer(path) as writer:
        states = writer.add_connection("/joint_states", "sensor_msgs/msg/JointState", typestore=store)
        wrenches = writer.add_connection("/ft", "geometry_msgs/msg/WrenchStamped", typestore=store)
        currents = writer.add_connection("/motor_current", "std_msgs/msg/Float32", typestore=store)

        def header(at: int) -> object:
            stamp = kind["builtin_interfaces/msg/Time"](sec=at // 10**9, nanosec=at % 10**9)
            return kind["std_msgs/msg/Header"](seq=0, stamp=stamp, frame_id="")

        def write(connection: object, at: int, message: object) -> None:
            writer.write(connection, at, store.serialize_ros1(message, message.__msgtype__))

        vector = kind["geometry_msgs/msg/Vector3"]
        for k in range(N):
            at, empty = BEGIN + k * STEP, np.zeros(0)
            angles = np.array([motor(k), 0.01 * motor(k)])
            state = kind["sensor_msgs/msg/JointState"](header(at), ["motor", "link"], angles, empty, empty)
            write(states, at + 50_000, state)
            write(currents, at, kind["std_msgs/msg/Float32"](data=np.float32(0.02 * motor(k))))
            torque = kind["geometry_msgs/msg/Wrench"](vector(1.0, 2.0, 3.0), vector(0.0, -0.05 * motor(k + 0.5), 0.0))
            write(wrenches, at + 900_000, kind["geometry_msgs/msg/WrenchStamped"](header(at + STEP // 2), torque))
    return path


def test_a_bag_of_ros_1(tmp_path):
    recording = fs.import_log(mapping(tmp_path), ros1(tmp_path / "log.bag"))
    k = np.arange(1, N)
    np.testing.assert_allclose(recording.time, 1e-9 * STEP * (k - 1), rtol=0, atol=1e-12)
    np.testing.assert_allclose(recording["link_position"], 0.01 * motor(k), rtol=0, atol=1e-14)
    np.testing.assert_allclose(recording["motor_current"], 0.02 * motor(k), rtol=0, atol=1e-6)
    np.testing.assert_allclose(recording["joint_torque"], 0.05 * motor(k), rtol=0, atol=1e-4)


@pytest.mark.parametrize(("period", "most"), [(5, True), (N, True), (2, False)])
def test_stamps_that_were_there_before_are_counted(tmp_path, monkeypatch, period, most):
    """A coarse clock, or none, stamps messages alike: some are left out; where most would be, the time of logging is used."""

    def coarse() -> Iterable[tuple[str, int, bytes]]:
        for k in range(N):
            at = BEGIN + k * STEP
            stamp = BEGIN + (k // period * period if most or k < N // 2 else k) * STEP
            yield "/joint_states", at, joint_state(stamp, {"motor": motor(k), "link": 0.01 * motor(k)})
            yield "/motor_current", at, Cdr().put("d", 0.02 * motor(k)).bytes()

    monkeypatch.setattr(sys.modules[__name__], "messages", lambda: list(coarse()))
    with pytest.warns(InputWarning) as caught:
        recording = fs.import_log(mapping(tmp_path), mcap(tmp_path / "log.mcap"))
    said = " ".join(str(one.message) for one in caught)
    if most:
        assert f"{N - N // period} of {N} of /joint_states" in said and "when" not in said and "were logged" in said
        np.testing.assert_allclose(recording["link_position"], 0.01 * motor(np.arange(N)), rtol=0, atol=1e-12)
    else:
        assert f"{N // 4} of {N} messages of /joint_states are left out" in said
        assert len(recording.time) == N - N // 4


def test_who_else_publishes_may_be_the_first(flexspline, tmp_path, monkeypatch):
    """Sixty messages of a gripper before the first of the arm: its joints were "missing"."""
    stamps = [BEGIN - (61 - k) * STEP for k in range(60)]
    first = [("/joint_states", stamp, joint_state(stamp, {"gripper": 0.02})) for stamp in stamps]
    logged = list(messages())
    monkeypatch.setattr(sys.modules[__name__], "messages", lambda: [*first, *logged])
    code, _, error = flexspline("import", mapping(tmp_path), bag(tmp_path / "log"), "--out", tmp_path / "out")
    assert code == 0, error
    (recording,) = read_measurement(tmp_path / "out").recordings
    np.testing.assert_allclose(recording["motor_position"], motor(np.arange(1, N)), rtol=0, atol=1e-12)


def test_samples_in_a_gap_of_another_topic_are_left_out(tmp_path):
    whole = bag(tmp_path / "log")
    with sqlite3.connect(whole / "bag_0.db3") as file:
        file.execute(
            "DELETE FROM messages WHERE topic_id = 2 AND timestamp BETWEEN ? AND ?",
            (BEGIN + 100 * STEP, BEGIN + 200 * STEP),
        )
    recording = fs.import_log(mapping(tmp_path), whole)
    assert len(recording.gaps) == 1 and np.diff(recording.gaps[0])[0] == pytest.approx(0.2, abs=0.01)
    np.testing.assert_allclose(recording["joint_torque"], 0.05 * recording["motor_position"], rtol=0, atol=1e-4)


def test_json_and_the_time_of_logging(tmp_path):
    columns = {
        "time": {"column": "/motor_current/stamp", "unit": "s"},
        "motor_position": {"column": "/motor_current/data", "unit": "rad"},
        "link_position": {"column": "/nothing/data", "unit": "rad", "optional": True},
        "motor_current": {"column": "/motor_current/data", "unit": "A"},
    }
    recording = fs.import_log(mapping(tmp_path, **columns), mcap(tmp_path / "log.mcap", "json"))
    np.testing.assert_allclose(recording["motor_current"], 0.02 * motor(np.arange(N)), rtol=0, atol=1e-12)
    np.testing.assert_allclose(recording.time, 1e-9 * STEP * np.arange(N), rtol=0, atol=1e-12)


def one_line(found: tuple[int, str, str]) -> str:
    code, _, err = found
    lines = [line for line in err.splitlines() if line.strip()]
    assert code == 2 and len(lines) == 1, err
    return lines[0]


def test_what_is_wrong_is_one_line(flexspline, tmp_path):
    def told(source: Path, **columns) -> str:
        return one_line(flexspline("import", mapping(tmp_path, **columns), source, "--out", tmp_path / "out"))

    good, file = bag(tmp_path / "log"), mcap(tmp_path / "log.mcap")
    misspelt = {"column": "/joint_states/position/moter", "unit": "rad"}
    for source in (good, file):
        line = told(source, motor_position=misspelt)
        assert (
            "'/joint_states/position/moter': missing" in line and "did you mean '/joint_states/position/motor'" in line
        )
    elsewhere = {
        name: {"column": "/states/data", "unit": unit} for name, unit in (("time", "s"), ("motor_position", "rad"))
    }
    line = told(good, **elsewhere, link_position=elsewhere["motor_position"])
    assert "'/states/data': missing" in line
    assert "got protobuf, defined in protobuf" in told(mcap(tmp_path / "proto.mcap", "protobuf"))
    (tmp_path / "short.mcap").write_bytes(file.read_bytes()[:5000])
    assert "short.mcap" in told(tmp_path / "short.mcap")
    (tmp_path / "none.mcap").write_bytes(b"no such file at all")
    assert "not a readable MCAP file" in told(tmp_path / "none.mcap")
    (tmp_path / "none.db3").write_bytes(b"no database" * 100)
    assert "not a readable ROS 2 bag" in told(tmp_path / "none.db3")
    (tmp_path / "empty").mkdir()
    assert "metadata.yaml, found none" in told(tmp_path / "empty")
    (good / "metadata.yaml").write_text("- 1\n")
    assert "not a readable ROS 2 bag" in told(good)


@pytest.mark.parametrize(
    "stamp", ['{"sec": "x", "nanosec": 1}', '{"sec": [1], "nanosec": 1}', '{"sec": 1.5, "nanosec": 1}',
              '{"sec": 1e300, "nanosec": 1}', '{"sec": 99999999999999999999, "nanosec": 1}']
)  # fmt: skip
def test_a_stamp_that_is_none_is_one_line(flexspline, tmp_path, stamp):
    from mcap.writer import Writer

    with (tmp_path / "log.mcap").open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        schema = writer.register_schema("any", "jsonschema", b"{}")
        channel = writer.register_channel("/joint_states", "json", schema)
        for k in range(3):
            writer.add_message(channel, k, f'{{"header": {{"stamp": {stamp}}}, "position": [1, 2]}}'.encode(), k)
        writer.finish()
    line = one_line(flexspline("import", mapping(tmp_path), tmp_path / "log.mcap", "--out", tmp_path / "out"))
    assert "log.mcap: topic /joint_states, message 1: expected a stamp in whole seconds and nanoseconds, got" in line


def test_what_is_odd_in_a_bag_is_one_line_and_nothing_beside_it_is_read(flexspline, tmp_path):
    good = bag(tmp_path / "log")
    words = ("import", mapping(tmp_path), good, "--out", tmp_path / "out")
    told = (good / "metadata.yaml").read_text()
    for change, expected in (
        (told.replace("bag_0.db3", "../other/bag_0.db3"), None),
        (told.replace("bag_0.db3", "../other.db3"), "some database files are missing"),
        (told.replace("bag_0.db3", "/etc/passwd"), "some database files are missing"),
        ("[" * 100_000, "not a readable ROS 2 bag"),
    ):
        (good / "metadata.yaml").write_text(change)
        if expected is not None:
            assert expected.lower() in one_line(flexspline(*words)).lower()
    (good / "metadata.yaml").write_text(told)
    for change in ("UPDATE messages SET timestamp = 'x'", "UPDATE topics SET serialization_format = x'00ff'"):
        with sqlite3.connect(good / "bag_0.db3") as file:
            file.execute(change)
        assert f"{good}: not a readable ROS 2 bag" in one_line(flexspline(*words))


def test_a_message_that_was_neither_stamped_nor_logged_is_one_line(flexspline, tmp_path):
    good = bag(tmp_path / "log")
    with sqlite3.connect(good / "bag_0.db3") as file:
        unset = joint_state(0, {"motor": 1.0, "link": 0.01})
        file.execute("UPDATE messages SET timestamp = NULL, data = ? WHERE topic_id = 1", (unset,))
    line = one_line(flexspline("import", mapping(tmp_path), good, "--out", tmp_path / "out"))
    assert "topic /joint_states, message 1: expected a stamp in whole seconds and nanoseconds, got" in line


def test_without_the_packages_it_is_one_line(flexspline, tmp_path, monkeypatch):
    source = bag(tmp_path / "log")
    for name in ("mcap_ros2.decoder", "mcap_ros2.writer", "rosbags.highlevel"):
        monkeypatch.setitem(sys.modules, name, None)
    for log, extra in ((source, "logs"), (mcap(tmp_path / "log.mcap"), "mcap")):
        line = one_line(flexspline("import", mapping(tmp_path), log, "--out", tmp_path / "out"))
        assert line.endswith(f"install flexspline[{extra}]")
    path = write_recording(made(), tmp_path / "m")
    assert one_line(flexspline("export", path, "--out", tmp_path / "out")).endswith("install flexspline[mcap]")


def made() -> Recording:
    n = 400
    time = np.concatenate([np.arange(200), 300 + np.arange(200)]) * 2e-3 + 0.1
    rng = np.random.default_rng(4)
    names = [
        "motor_position",
        "link_position",
        "motor_current",
        "joint_torque",
        "temperature",
        "position_command",
        "force_x",
        "torque_y",
    ]
    return Recording("made", time, {name: rng.normal(size=n) for name in names}, description="it is made")


def test_a_recording_as_mcap_and_back(flexspline, tmp_path):
    given = made()
    path = write_recording(given, tmp_path / "m")
    code, out, error = flexspline("export", path, "--out", tmp_path / "out")
    assert code == 0 and "made.mcap" in out, error
    columns = {
        "temperature": {"column": "/temperature/temperature", "unit": "°C"},
        "joint_torque": {"column": "/joint_torque/data", "unit": "N·m"},
        "position_command": {"column": "/position_command/data", "unit": "rad"},
        "force_x": {"column": "/wrench/wrench/force/x", "unit": "N"},
        "torque_y": {"column": "/wrench/wrench/torque/y", "unit": "N·m"},
    }
    back = fs.import_log(mapping(tmp_path, **columns), tmp_path / "out" / "made.mcap")
    assert set(back.columns) == set(given.columns)
    np.testing.assert_allclose(back.time, given.time - given.time[0], rtol=0, atol=1e-9)
    for name, values in given.columns.items():
        np.testing.assert_array_equal(back[name], values)

    from mcap.reader import make_reader

    with (tmp_path / "out" / "made.mcap").open("rb") as stream:
        (told,) = make_reader(stream).iter_metadata()
    assert (
        told.name == "flexspline"
        and told.metadata["joint"] == "test-joint"
        and told.metadata["description"] == "it is made"
    )


def test_a_run_as_mcap(flexspline, tmp_path):
    out = tmp_path / "runs"
    words = ["--set", "duration=1.5", "--set", "filters=[lowpass]", "--no-figures", "--no-recording", "--out", out]
    assert flexspline("run", "no_load", *words)[0] == 0
    code, _, error = flexspline("export", out / "no_load", "--out", tmp_path / "mcap")
    assert code == 0, error
    recording = fs.import_log(
        mapping(tmp_path, joint_torque={"column": "/joint_torque/data", "unit": "N·m"}),
        tmp_path / "mcap" / "no_load.mcap",
    )
    assert len(recording.time) == 1500


@pytest.mark.parametrize("start", [-1.0, 3e9])
def test_times_that_no_stamp_can_say_are_one_line(flexspline, tmp_path, start):
    t = start + np.arange(50) * 1e-2
    columns = {"motor_position": 100 * np.sin(t), "link_position": np.sin(t), "motor_current": np.cos(t)}
    write_recording(Recording("m", t, columns), tmp_path / "in")
    code, _, err = flexspline("export", tmp_path / "in", "--out", tmp_path / "out")
    assert code == 2 and err.count("\n") == 1 and "time: expected 0 s to" in err and not (tmp_path / "out").exists()
