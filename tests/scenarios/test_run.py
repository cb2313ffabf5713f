"""Run folders: what is in them, and that they can be read back."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

import flexspline as fs
from flexspline.models.errors import InputError
from flexspline.models.files import yaml_text
from flexspline.models.joint import shipped
from flexspline.models.recording import read_recording
from flexspline.models.signals import SENSED
from flexspline.scenarios.run import run_scenario
from flexspline.scenarios.run_folder import load_run, save_run
from flexspline.scenarios.scenario import load_scenario


@pytest.fixture(scope="module")
def run():
    """The paper's filters, a filter with two measurements and states, and one without a variance."""
    filters = "filters=[EKF, AREKF, RAREKF, REKF, dynamics_ekf, {name: slow, estimator: lowpass, cutoff: 5}]"
    chosen, folder = load_scenario("external_push", ["duration=10", "plant.K1=9000", filters], seed=3)
    return run_scenario(chosen, folder, threads=2)


@pytest.fixture(scope="module")
def folder(run, tmp_path_factory):
    return save_run(run, tmp_path_factory.mktemp("runs") / "push")


def test_contents(folder):
    names = {path.name for path in folder.iterdir()}
    expected = {
        "signals.parquet", "estimates.parquet", "metrics.json", "scenario.yaml", "joint.yaml", "known_joint.yaml",
        "run.json",
    }  # fmt: skip
    assert expected <= names
    about = json.loads((folder / "run.json").read_text())
    assert about["seed"] == 3
    assert {"flexspline", "mujoco", "numpy", "python"} <= set(about["versions"])


def test_every_column_has_its_unit(folder):
    units = {}
    for name in ("signals", "estimates"):
        for field in pq.read_table(folder / f"{name}.parquet").schema:
            units[field.name] = field.metadata[b"unit"].decode()
    expected = {
        "time": "s", "position_command": "rad", "external_torque": "N·m", "current_command": "A", "motor_position": "rad",
        "motor_current": "A", "joint_torque": "N·m", "force_x": "N", "torque_y": "N·m", "true_link_velocity": "rad/s",
        "true_bristle": "rad", "model_torque": "N·m", "torque_EKF": "N·m", "variance_EKF": "(N·m)²",
        "innovation_AREKF": "N·m", "innovation_variance_AREKF": "(N·m)²", "robust_RAREKF": "1", "alpha_RAREKF": "1",
        "nis_EKF": "1", "f_alpha_EKF": "1", "innovation_1_dynamics_ekf": "rad", "innovation_variance_1_2_dynamics_ekf": "rad²",
        "external_torque_dynamics_ekf": "N·m", "link_velocity_dynamics_ekf": "rad/s", "torque_slow": "N·m",
    }  # fmt: skip
    assert {name: units[name] for name in expected} == expected


def assert_same(ours, theirs):
    """Two posteriors to the bit, all that they say."""
    for name in ("time", "mean", "variance", "innovation", "innovation_covariance", "robust", "external", "nis"):
        a, b = getattr(ours, name), getattr(theirs, name)
        assert (a is None) == (b is None), (ours.estimator, name)
        if a is not None:
            np.testing.assert_array_equal(a, b, err_msg=f"{ours.estimator}: {name}")
    assert list(ours.columns) == list(theirs.columns)
    for name, values in ours.columns.items():
        np.testing.assert_array_equal(values, theirs.columns[name], err_msg=f"{ours.estimator}: {name}")


def test_round_trip(run, folder):
    copy = load_run(folder)
    for name in ("time", "truth", "readings", "command"):
        np.testing.assert_array_equal(getattr(copy.simulation, name), getattr(run.simulation, name), err_msg=name)
    np.testing.assert_array_equal(copy.model_torque, run.model_torque)
    assert list(copy.estimates) == list(run.estimates) == ["EKF", "AREKF", "RAREKF", "REKF", "dynamics_ekf", "slow"]
    for name, found in run.estimates.items():
        assert copy.estimates[name].estimator == name
        assert_same(copy.estimates[name], found)
    assert copy.scenario.estimators() == run.scenario.estimators()
    assert json.dumps(copy.metrics) == json.dumps(run.metrics)
    assert copy.joint.numbers["K1"].value == 9000 and copy.known_joint.numbers["K1"].value == 8400
    np.testing.assert_array_equal(copy.external_torque, run.external_torque)


def test_the_resolved_scenario_runs_again_to_the_same_bits(run, folder):
    chosen, where = load_scenario(folder / "scenario.yaml")
    again = run_scenario(chosen, where)
    assert again.simulation.truth.tobytes() == run.simulation.truth.tobytes()
    assert again.simulation.readings.tobytes() == run.simulation.readings.tobytes()
    for name, found in run.estimates.items():
        assert_same(again.estimates[name], found)


def test_it_is_a_recording(run, folder):
    recordings = [path for path in folder.glob("*.yaml") if path.with_suffix(".parquet").is_file()]
    assert len(recordings) == 1
    recording = read_recording(recordings[0].with_suffix(".parquet"))
    np.testing.assert_array_equal(recording["joint_torque"], run.reading("joint_torque"))
    np.testing.assert_array_equal(recording["link_position"], run.reading("link_position"))
    assert recording.external == "measured"
    assert list(recording.columns) == [
        "motor_position", "link_position", "motor_current", "joint_torque", "position_command", "external_torque"
    ]  # fmt: skip


def test_a_recording_holds_the_sensors_that_are_asked_for():
    """Every channel that a joint may sense, by the scenario's list; what the joint states by itself; the rest not."""
    short = ["duration=1.5", "transient=0.5", "disturbances=[]", "filters=[model]"]

    def recorded(*changes: str):
        chosen, folder = load_scenario("external_push", [*short, *changes])
        run = run_scenario(chosen, folder)
        return run, run.as_recording()

    run, recording = recorded(f"record=[{', '.join(SENSED)}]", "temperature={start: 20, end: 40, time_constant: 1}")
    assert set(recording.columns) == {*SENSED, "position_command"}
    for name in SENSED:
        np.testing.assert_array_equal(recording[name], run.reading(name))
    np.testing.assert_allclose(recording["temperature"], 40 - 20 * np.exp(-recording.time), atol=1e-9)
    assert recording["force_z"].std() > 0 and np.abs(recording["motor_torque"]).max() > 0
    _, recording = recorded("sensors.motor_torque.noise=0.001", "sensors.temperature.noise=0.1")
    assert {"motor_torque", "temperature"} <= set(recording.columns) and "force_x" not in recording
    _, recording = recorded("record=[motor_position, motor_current]")
    assert set(recording.columns) == {"motor_position", "motor_current", "position_command"}


def test_metrics_are_those_of_the_signals(run):
    kept = run.time >= 1.0
    error = (run.estimate("RAREKF") - run.truth("joint_torque"))[kept]
    assert run.metrics["filters"]["RAREKF"]["rms"] == pytest.approx(np.sqrt(np.mean(error**2)))
    assert run.metrics["filters"]["EKF"]["robust_share"] == 0
    assert run.metrics["filters"]["REKF"]["robust_share"] == pytest.approx(1, abs=0.01)
    assert 0 < run.metrics["filters"]["AREKF"]["robust_share"] < 1
    ekf = run.estimates["EKF"]
    nis = ekf.nis[kept]
    assert run.metrics["filters"]["EKF"]["mean_nis"] == pytest.approx(nis.mean())
    np.testing.assert_allclose(
        nis, (ekf.innovation[:, 0] ** 2 / ekf.innovation_covariance[:, 0, 0])[kept], rtol=1e-9, atol=1e-12
    )


def test_nothing_is_left_behind_when_a_view_fails(run, tmp_path):
    def broken(run, folder: Path):
        (folder / "half.png").write_bytes(b"half")
        raise RuntimeError("no display")

    with pytest.raises(RuntimeError):
        save_run(run, tmp_path / "run", [broken])
    assert list(tmp_path.iterdir()) == []


def test_a_folder_that_is_not_ours_is_kept(run, tmp_path):
    (tmp_path / "thesis.tex").write_text("years of work")
    with pytest.raises(InputError, match="expected an empty or new folder"):
        save_run(run, tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["thesis.tex"]
    save_run(run, tmp_path / "run")
    save_run(run, tmp_path / "run")  # ours, again


def test_no_run_folder(tmp_path):
    with pytest.raises(InputError, match=r"expected a run folder, found no scenario\.yaml"):
        load_run(tmp_path)


def in_words(table, name):
    return table.set_column(table.column_names.index(name), name, pa.array(["a"] * len(table)))


@pytest.mark.parametrize(
    ("table", "change", "said"),
    [
        ("estimates", lambda t: t.slice(0, 2), "'time': expected that of signals"),
        ("estimates", lambda t: t.slice(1), "'time': expected that of signals"),
        ("estimates", lambda t: in_words(t, "torque_EKF"), "'torque_EKF': expected numbers"),
        ("estimates", lambda t: t.drop_columns("innovation_variance_EKF"), "'innovation_variance_EKF': missing"),
        ("signals", lambda t: in_words(t, "motor_current"), "'motor_current': expected numbers"),
    ],
)
def test_a_damaged_table_is_one_line(folder, tmp_path, table, change, said):
    path = Path(shutil.copytree(folder, tmp_path / "copy")) / f"{table}.parquet"
    pq.write_table(change(pq.read_table(path)), path)
    with pytest.raises(InputError, match=said):
        load_run(path.parent)


def test_what_the_measures_do_not_say_is_told():
    """Pushes that never act or are cut off, a motion that asks for more than the drive gives; nothing for what is well."""
    scenario, folder = load_scenario("link_sweep", ["duration=2", "filters=[RAREKF]"])
    assert run_scenario(scenario, folder).notes == ()
    changes = [
        "duration=2", "filters=[RAREKF]", "trajectory=[{time: 0.2, position: 0}, {time: 0.3, position: 2.5}]",
        "disturbances=[{kind: push, start: 5, duration: 0.3, torque: 1}, {kind: push, start: 1.9, duration: 0.3, torque: 1}]",
    ]  # fmt: skip
    odd = run_scenario(*load_scenario("link_sweep", changes))
    never, cut, limit = odd.notes
    assert "disturbances.0" in never and "never acts" in never
    assert "disturbances.1" in cut and "cuts it off" in cut
    assert "limit of 3.3 A" in limit and "off its command" in limit
    assert odd.metrics["notes"] == list(odd.notes)
    shortened = run_scenario(*load_scenario("external_push", ["duration=20", "filters=[RAREKF]"]))
    assert shortened.notes == (
        "disturbances.3, disturbances.4, disturbances.5, disturbances.6 start at 22, 29, 32, 35 s, after the end at 20 s: they "
        "never act",
    )


def test_a_run_folder_has_the_mjcf_of_a_joint_of_ones_own(tmp_path):
    """With what it includes: the folder alone is enough to load the run, and to run it again."""
    (tmp_path / "in" / "parts").mkdir(parents=True)
    text = shipped("test_joint.xml").read_text(encoding="utf-8")
    head, rest = text.split("<worldbody>", 1)
    (tmp_path / "in" / "own.xml").write_text(
        f'{head}<include file="parts/looks.xml"/><worldbody>{rest}', encoding="utf-8"
    )
    looks = '<mujoco><asset><material name="of_ones_own" rgba="1 0 0 1"/></asset></mujoco>'
    (tmp_path / "in" / "parts" / "looks.xml").write_text(looks)
    text = shipped("test_joint.yaml").read_text(encoding="utf-8").replace("model: test_joint.xml", "model: own.xml")
    (tmp_path / "in" / "j.yaml").write_text(text, encoding="utf-8")
    data = {"name": "s", "joint": "j.yaml", "duration": 1.5, "transient": 0.5, "filters": ["EKF"]}
    data["trajectory"] = [{"time": 0.0, "position": 0.0}, {"time": 1.0, "position": 0.2}]
    (tmp_path / "in" / "s.yaml").write_text(yaml_text(data))
    chosen, folder = load_scenario(tmp_path / "in" / "s.yaml")
    save_run(run_scenario(chosen, folder), tmp_path / "out")
    shutil.rmtree(tmp_path / "in")
    assert (tmp_path / "out" / "parts" / "looks.xml").read_text() == looks
    before = load_run(tmp_path / "out")
    again = run_scenario(*load_scenario(tmp_path / "out" / "scenario.yaml"))
    assert again.metrics == before.metrics


def test_two_samples_after_the_transient_are_enough():
    run = fs.simulate("no_load", filters=["EKF"], duration=1.5, transient=1.498)
    assert np.isfinite(run.metrics["filters"]["EKF"]["rms"])
