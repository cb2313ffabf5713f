"""Values that no command can use: each is one line and exit code 2, for the whole kind, and leaves nothing behind."""

from __future__ import annotations

import json
import os
import re
import struct
import subprocess
import sys
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
import yaml

from flexspline.models import files
from flexspline.models.errors import InputError
from flexspline.models.joint import known_joints
from flexspline.models.recording import read_recording
from flexspline.models.tables import read_table, write_table

SCENARIO = "name: s\nduration: 3\ntrajectory: [{time: 0, position: 0}, {time: 2, position: 1}]\n"
FROZEN = Path(__file__).resolve().parents[1] / "frozen"


def refused(answer: tuple[int, str, str]) -> str:
    """The one line with which a command ended."""
    code, out, err = answer
    assert code == 2 and err.count("\n") == 1 and err.startswith("flexspline: ") and not out, (code, out, err)
    return err


TAGS = ("bool foo", "bool ''", "int x", "int ''", "float ''", "timestamp foo", "timestamp 2001-99-99", "set [1]", "map 3",
        "binary x",
        "omap x", "null x", "str {a: 1}", "python/object x", "bool true", "mine {a: 1}")  # fmt: skip


@pytest.mark.parametrize("tag", TAGS)
def test_a_yaml_tag_is_one_line(flexspline, tmp_path, tag):
    path = tmp_path / "s.yaml"
    path.write_text(f"{SCENARIO}locked_rotor: !!{tag}\n")
    line = refused(flexspline("run", path, "--out", tmp_path / "out"))
    assert f"s.yaml:4: not YAML: expected a value without a tag, got !!{tag.split()[0]}" in line
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    "number", ["1" + 400 * "0", "-1" + 300 * "0" + ".5", "1e-320", "-4.9e-324", "0." + 200 * "0" + "1"]
)
def test_a_number_beyond_arithmetic_is_one_line(flexspline, tmp_path, rng, number):
    """At places drawn from every number of a description, a scenario and a layout; in `--set` too."""
    path = tmp_path / "f.yaml"
    for text, words in (
        (known_joints()["test-joint"].read_text(encoding="utf-8"), ("joint", "show", path)),
        (SCENARIO + "seed: 3\ncontroller: {kp: 4}\nplant: {K1: 9000}\n", ("run", path, "--out", tmp_path / "out")),
    ):
        places = list(re.finditer(r"(?<=[:,] )-?\d[\d.e+-]*(?=[,}\n ])", text))
        for place in rng.choice(len(places), 4, replace=False):
            path.write_text(text[: places[place].start()] + number + text[places[place].end() :], encoding="utf-8")
            line = refused(flexspline(*words))
            assert "f.yaml:" in line and "expected 0 or a number from 1e-100 on" in line
    refused(flexspline("run", "no_load", "--set", f"controller.kp={number}", "--out", tmp_path / "out"))
    assert not (tmp_path / "out").exists()


def test_numbers_as_people_write_them_are_read():
    text = (
        "{a: 1e-6, b: -0.0, c: 1_000, d: .5, e: 1E3, f: .inf, g: -.inf, h: 0e-400, i: 12345678901234567890, j: 1e-90}"
    )
    found = files._loaded(text)
    assert found == {
        "a": 1e-6, "b": 0.0,
        "c": 1000, "d": 0.5, "e": 1e3, "f": np.inf, "g": -np.inf, "h": 0.0, "i": 12345678901234567890,
        "j": 1e-90,
    }  # fmt: skip
    assert type(found["c"]) is int and yaml.safe_load("1.0e-3") == files._loaded("1e-3")


@pytest.mark.parametrize("value", ["nan", "inf", "1e-320", "1e300"])
@pytest.mark.parametrize(
    "words",
    [
        ("contact", "--hours"),
        ("contact", "--tolerance"),
        ("diagnose", "nothing", "--out", "out", "--time"),
        ("view", "nothing", "--speed"),
    ],
    ids=lambda words: " ".join(words),
)
def test_an_option_of_no_usable_number_is_one_line(flexspline, words, value):
    assert "expected" in refused(flexspline(*words, value))


@pytest.mark.parametrize("dots", [30, 3000])
def test_a_key_of_too_many_dots_is_one_line(flexspline, dots):
    for first in ("a", "plant", "sensors"):
        key = f"{first}{'.a' * dots}"
        assert (
            f"at most 20 dots, got {dots}" in refused(flexspline("run", "no_load", "--set", f"{key}=1")) or dots > 300
        )


BYTES = "\udcff\udcfe"
WORDS = (
    ("run", BYTES), ("run", "no_load", "--set", f"joint={BYTES}.yaml"), ("run", "no_load", "--set", f"{BYTES}=1"),
    ("run", "no_load", "--out", BYTES), ("run", "no_load", "--plugin", BYTES), ("check", BYTES),
    ("check", "MEASUREMENT", "--joint", BYTES),
    ("validate", "MEASUREMENT", "--joint", BYTES, "--out", "x"),
    ("diagnose", "MEASUREMENT", "--joint", BYTES, "--out", "x"),
    ("estimate", "MEASUREMENT", "--joint", BYTES, "--out", "x"),
    ("estimate", "MEASUREMENT", "--filter", BYTES, "--out", "x"), ("joint", "show", BYTES), ("joint", "check", BYTES),
    ("sweep", BYTES, "--out", "x"), ("import", BYTES, "log.csv", "--out", "x"), ("report", BYTES), ("contact", BYTES),
)  # fmt: skip


@pytest.mark.parametrize("words", WORDS, ids=lambda words: ascii(" ".join(words)))
def test_bytes_that_are_no_utf8_are_one_line(flexspline, words, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path(BYTES).write_text("x")  # a name that the file system takes
    given = [str(FROZEN / "measurement" / "short.parquet") if word == "MEASUREMENT" else word for word in words]
    assert "UTF-8" in refused(flexspline(*given))
    assert os.listdir(os.fsencode(tmp_path)) == [b"\xff\xfe"]


def test_yaml_of_other_bytes_is_one_line(flexspline, tmp_path, rng):
    """In a scenario, a description and a study."""
    path = tmp_path / "f.yaml"
    for words, text in (
        (("run", path), SCENARIO),
        (("joint", "show", path), known_joints()["test-joint"].read_text(encoding="utf-8")),
        (("sweep", path, "--out", tmp_path / "out"), (FROZEN / "study.yaml").read_text(encoding="utf-8")),
    ):
        raw = bytearray(text.encode())
        at = int(rng.integers(len(raw)))
        raw[at:at] = b"\xff"
        path.write_bytes(raw)
        assert f":{raw[:at].count(10) + 1}: cannot read" in refused(flexspline(*words))


def test_a_damaged_footer_of_parquet_is_one_line(tmp_path, rng):
    """Bytes of the footer changed at random, units and counts of rows among them, and read by every reader."""
    raw = (FROZEN / "measurement" / "short.parquet").read_bytes()
    (tmp_path / "short.yaml").write_bytes((FROZEN / "measurement" / "short.yaml").read_bytes())
    path, size = tmp_path / "short.parquet", struct.unpack("<I", raw[-8:-4])[0]
    readers = (read_recording, read_table)
    refusals = 0
    for _ in range(150):
        damaged = bytearray(raw)
        for at in rng.integers(len(raw) - 8 - size, len(raw) - 8, rng.integers(1, 3)):
            damaged[at] = rng.choice([0, 1, 127, 128, 255, damaged[at] ^ 1, rng.integers(256)])
        path.write_bytes(damaged)
        for read in readers:
            try:
                read(path)
            except InputError as error:
                refusals += 1
                assert "\n" not in str(error) and str(path) in str(error)
    assert refusals > 50


@pytest.mark.parametrize("rows", [-1, 10**6])
def test_another_count_of_rows_in_a_footer_is_one_line(tmp_path, rows):
    """The count of a Parquet file is a Thrift integer: zigzag, seven bits a byte."""

    def varint(n: int) -> bytes:
        n, found = (n << 1) ^ (n >> 63), b""
        while True:
            n, low = n >> 7, n & 127
            found += bytes([low | (128 if n else 0)])
            if not n:
                return found

    raw = (FROZEN / "measurement" / "short.parquet").read_bytes()
    count = pq.read_metadata(FROZEN / "measurement" / "short.parquet").num_rows
    size = struct.unpack("<I", raw[-8:-4])[0]
    footer = raw[-8 - size : -8]
    at = footer.rindex(b"\x16" + varint(count) + b"\x19")  # field num_rows before the list of row groups
    footer = footer[: at + 1] + varint(rows) + footer[at + 1 + len(varint(count)) :]
    path = tmp_path / "short.parquet"
    path.write_bytes(raw[: -8 - size] + footer + struct.pack("<I", len(footer)) + b"PAR1")
    (tmp_path / "short.yaml").write_bytes((FROZEN / "measurement" / "short.yaml").read_bytes())
    assert pq.read_metadata(path).num_rows == rows
    with pytest.raises(InputError, match=r"short.parquet: not a readable Parquet file"):
        read_recording(path)


def test_a_change_that_would_lose_another_is_refused(flexspline, tmp_path):
    """In whichever order: the wider key first, or it says so."""
    for lost, wider in (
        ("sensors.joint_torque.noise=1", "sensors=realistic"), ("controller.kp=6", "controller={kd: 0.1}"),
        ("filters.0.k=0.1", "filters=[RAREKF]"), ("disturbances.0.torque=4", "disturbances=[]"),
    ):  # fmt: skip
        line = refused(flexspline("run", "external_push", "--set", lost, "--set", wider, "--out", tmp_path / "out"))
        assert f"--set {wider}: it would discard --set {lost}" in line


SHORT = ("--set", "duration=2", "--no-figures", "--no-recording")


def test_a_key_that_acts_on_nothing_is_told(flexspline, tmp_path):
    code, out, err = flexspline(
        "run", "link_sweep", *SHORT, "--set", "filters=[model]", "--set", "temperature=60",
        "--set", "sensors.wrench.force_noise=1",
        "--set", "locked_rotor=true", "--out", tmp_path,
    )  # fmt: skip
    assert code == 0, err
    assert "temperature acts on nothing: test-joint states no friction that depends on it" in out
    assert "trajectory acts on nothing: the rotor is locked" in out and "sensors.wrench acts on nothing" in out
    notes = json.loads((tmp_path / "link_sweep" / "metrics.json").read_text())["notes"]
    assert sum("acts on nothing" in note for note in notes) == 3
    code, out, err = flexspline("run", "link_sweep", *SHORT, "--set", "filters=[model]", "--out", tmp_path / "b")
    assert code == 0 and "acts on nothing" not in out


def test_an_estimator_that_diverges_leaves_the_others(flexspline, tmp_path):
    bad = "filters=[RAREKF, {name: bad, estimator: REKF, gamma: 0.1004}, current]"
    code, out, err = flexspline("run", "no_load", "--set", "duration=3", "--set", bad, "--out", tmp_path)
    assert code == 0 and "filter 'bad' diverged at step" in err and err.count("\n") == 1, err
    assert "bad gives no estimate for 3000 of 3000 samples" in out
    found = json.loads((tmp_path / "no_load" / "metrics.json").read_text())["filters"]
    assert found["bad"]["rms"] is None and 0 < found["RAREKF"]["rms"] < 1 and found["current"]["rms"] > 0
    assert (tmp_path / "no_load" / "run.rrd").is_file()
    code, _, err = flexspline("report", tmp_path / "no_load", "--out", tmp_path / "page.html")
    assert code == 0 and "bad gives no estimate" in (tmp_path / "page.html").read_text(), err
    alone = bad.replace("RAREKF, ", "").replace(", current", "")
    assert "diverged" in refused(flexspline("run", "no_load", *SHORT, "--set", alone, "--out", tmp_path / "alone"))
    assert not (tmp_path / "alone").exists()


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="another ulimit")
@pytest.mark.parametrize("words", [("report", "."), ("joints",), ("run", "no_load"), ("check", ".")])
@pytest.mark.parametrize("kilobytes", [300_000, 400_000, 1_000_000])
def test_little_memory_is_one_line_at_once(words, kilobytes, tmp_path):
    limited = f'ulimit -v {kilobytes}; exec "$0" -m flexspline {" ".join(words)}'
    done = subprocess.run(
        ["sh", "-c", limited, sys.executable], capture_output=True, text=True, timeout=120, cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(Path(__file__).resolve().parents[2])},
    )  # fmt: skip
    assert done.returncode == 2 and done.stderr.count("\n") == 1 and "out of memory: expected" in done.stderr, (
        done.stderr
    )


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full")
@pytest.mark.parametrize("words", ["-h", "--version", "joints", "causes --json", "check tests/frozen/measurement"])
@pytest.mark.parametrize("both", [False, True])
def test_a_full_output_is_one_line_and_exit_code_2(words, both):
    root = Path(__file__).resolve().parents[2]
    with open("/dev/full", "w") as full:
        done = subprocess.run(
            [sys.executable, "-m", "flexspline", *words.split()], stdout=full, stderr=full if both else subprocess.PIPE,
            text=True, timeout=300, cwd=root, env={**os.environ, "PYTHONPATH": str(root)},
        )  # fmt: skip
    assert done.returncode == 2 and (both or done.stderr == "flexspline: No space left on device\n"), done.stderr


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full")
def test_a_full_disk_names_the_file(tmp_path):
    path = tmp_path / "full.parquet"
    path.symlink_to("/dev/full")
    rows = {"a": np.random.default_rng(1).standard_normal(200_000)}
    with pytest.raises(OSError, match="No space left on device") as refusal:
        write_table(path, rows, {"a": "1"})
    assert refusal.value.filename == str(path)
