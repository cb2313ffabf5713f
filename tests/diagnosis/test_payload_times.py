"""Mappings that state when a measured joint carried which mass."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
import yaml

import flexspline as fs
from flexspline.diagnosis.data.importing import import_recording, load_layout
from flexspline.models.errors import InputError, InputWarning
from flexspline.models.recording import read_recording

PAYLOAD = {"start": 2.0, "end": 6.0, "mass": 2.0, "distance": 0.25, "angle": 0.2}
COLUMNS = ("motor_position", "link_position", "motor_current")
ARM = (
    '<mujoco><worldbody><body name="shoulder"><joint name="lift" axis="0 -1 0"/><inertial pos="0 0 -0.2" mass="2" '
    'diaginertia="0.02 0.02 0.02"/></body></worldbody></mujoco>'
)


@pytest.fixture(scope="module")
def carrying():
    ways = [{"time": 0.2 + 1.5 * k, "position": 0.8 * (-1) ** k} for k in range(6)]
    return fs.simulate("no_load", duration=8.0, mounting="link", trajectory=ways, payloads=[PAYLOAD], filters=["model"])


def layout(folder, **changes):
    data = {
        "format": 1, "name": "mine", "joint": "test-joint", "link": {"inertia": 0.35, "gravity_moment": 9.0},
        "columns": {"time": {"column": "time", "unit": "s"}} | {
            name: {"column": name, "unit": "A" if "current" in name else "rad"} for name in COLUMNS
        },
    }  # fmt: skip
    (folder / "mine.yaml").write_text(yaml.safe_dump(data | changes), encoding="utf-8")
    return load_layout(folder / "mine.yaml")


def logged(folder, run, name="log.csv"):
    table = {"time": run.signals.time} | {name: run.reading(name) for name in COLUMNS}
    pd.DataFrame(table).to_csv(folder / name, index=False)
    return folder / name


def test_an_imported_log_knows_its_payloads(tmp_path, carrying, flexspline):
    """Load and residuals are those of the simulation's own recording; without the payload the current is unexplained."""
    path, payloads = logged(tmp_path, carrying), {"payloads": [PAYLOAD]}
    layout(tmp_path, **payloads)
    code, _, error = flexspline("import", tmp_path / "mine.yaml", path, "--out", tmp_path / "out")
    assert code == 0, error
    recording, own = read_recording(tmp_path / "out" / "log.parquet"), carrying.as_recording()
    assert recording.payloads == own.payloads
    np.testing.assert_allclose(recording.known_torque, own.known_torque, atol=1e-6)
    blind = import_recording(layout(tmp_path), path)
    errors = []
    for one in (recording, own, blind):
        residual = fs.validate(one, "test-joint").residual["motor_current"]
        errors.append(residual.rms / residual.noise)
    print("RMS over noise: imported {:.2f}, own {:.2f}, without the payload {:.2f}".format(*errors))
    assert errors[0] < 1.05 * errors[1]  # which also has the torque sensor
    assert errors[2] > 3 * errors[0]


def test_one_log_has_other_payloads(tmp_path, carrying):
    """`logs` replaces them, or says that there are none; a `payload` of the whole log is part of the link."""
    logs = {
        "a*": {"payloads": []},
        "b*": {"payloads": [{**PAYLOAD, "mass": 1.0}]},
        "c*": {"payload": {"mass": 1, "distance": 0.2}},
    }
    mine = layout(tmp_path, payloads=[PAYLOAD], logs=logs)
    found = {name: import_recording(mine, logged(tmp_path, carrying, f"{name}.csv")) for name in "abcd"}
    masses = {name: [one.mass for one in r.payloads] for name, r in found.items()}
    assert masses == {"a": [], "b": [1.0], "c": [2.0], "d": [2.0]}
    assert found["a"].load is None and found["c"].link.gravity_moment > found["d"].link.gravity_moment


def test_a_payload_on_a_joint_of_an_arm(tmp_path, carrying):
    (tmp_path / "arm.xml").write_text(ARM, encoding="utf-8")
    payload = {"start": 2.0, "end": 6.0, "body": "shoulder", "mass": 1.5, "position": [0, 0, -0.3]}
    arm = {"model": "arm.xml", "joint": "lift", "payloads": [payload]}
    recording = import_recording(layout(tmp_path, link=None, arm=arm), logged(tmp_path, carrying))
    q, on = recording["link_position"], (recording.time >= 2.0) & (recording.time < 6.0)
    np.testing.assert_allclose(recording.load.torque, np.where(on, -1.5 * 9.81 * 0.3 * np.sin(q), 0.0), atol=1e-6)
    np.testing.assert_allclose(recording.load.inertia, np.where(on, 0.1 + 1.5 * 0.09, 0.1), rtol=1e-9)


def test_times_outside_the_log_are_marked(tmp_path, carrying):
    mine = layout(tmp_path, payloads=[{**PAYLOAD, "start": 20.0, "end": 30.0}])
    with pytest.warns(InputWarning, match=r"log\.csv: payloads\.0: it is carried at no time of the log, 0 to 7\.999 s"):
        import_recording(mine, logged(tmp_path, carrying))


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"payloads": [{"start": 1, "mass": 1}]}, "payloads.0.distance: missing"),
        ({"payloads": [{**PAYLOAD, "end": 1}]}, "payloads.0: end: expected a time after 2 s"),
        ({"link": None, "arm": {"model": "a.xml", "joint": "j"}, "payloads": [PAYLOAD]}, "payloads: expected them in arm"),
        ({"link": None, "arm": {"model": "a.xml", "joint": "j"}, "logs": {"a": {"payloads": [PAYLOAD]}}}, "logs.a: expected arm"),
    ],
)  # fmt: skip
def test_wrong_payloads_are_named(tmp_path, changes, words):
    with pytest.raises(InputError) as error:
        layout(tmp_path, **changes)
    assert words in str(error.value)
