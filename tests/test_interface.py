"""The package as a notebook uses it: one line each, tables with names, frozen results, one-line errors."""

from __future__ import annotations

import dataclasses
import inspect
import json
import re
import typing
from pathlib import Path

import mujoco
import numpy as np
import pandas as pd
import pytest

import flexspline as fs
from flexspline.diagnosis.answer import Diagnosis, Finding
from flexspline.diagnosis.planning import Plan, Proposal, Question
from flexspline.diagnosis.validate import ChannelError
from flexspline.estimator import registry
from flexspline.models import causes
from flexspline.models.files import json_text
from flexspline.models.joint_parts import Effect, Estimate
from flexspline.models.recording import read_recording, write_recording
from flexspline.scenarios.run import run_scenario
from flexspline.scenarios.scenario import load_scenario

SHORT = {"duration": 2.0, "transient": 0.5}


@pytest.fixture(scope="module")
def run() -> fs.Run:
    return fs.simulate("link_sweep", seed=3, **SHORT, filters=["RAREKF", "lowpass"], controller__kp=7.0)


def test_everything_that_is_promised_is_there():
    for name in fs.__all__:
        assert getattr(fs, name) is not None and name in dir(fs)
    with pytest.raises(AttributeError, match="no attribute 'estimat'"):
        fs.estimat  # noqa: B018


FUNCTIONS = [name for name in fs.__all__ if name.islower() and not name.startswith("_")]


@pytest.mark.parametrize("name", FUNCTIONS)
def test_functions_are_typed_and_say_what_they_take_and_give(name):
    function = getattr(fs, name)
    text, signature = inspect.getdoc(function), inspect.signature(function)
    assert signature.return_annotation is not signature.empty
    assert all(p.annotation is not p.empty for p in signature.parameters.values())
    if signature.parameters:
        assert "Args:" in text or "Args" in text
    assert "Returns:" in text or name == "load_joint"
    if name not in ("estimators", "causes"):
        assert "Raises:" in text


def test_simulate(run):
    assert dataclasses.is_dataclass(run) and run.__dataclass_params__.frozen
    assert run.scenario.seed == 3 and run.scenario.controller.kp == 7.0
    assert list(run.estimates) == ["RAREKF", "lowpass"] and len(run.time) == 2000
    again = fs.simulate(load_scenario("link_sweep")[0], seed=3, **SHORT, filters=["lowpass"], controller__kp=7.0)
    assert again.estimate("lowpass").tobytes() == run.estimate("lowpass").tobytes()


def test_realistic_sensors_are_those_of_the_command_line():
    """With the drive's lag and the jitter of the time stamps; also from a `Scenario`."""
    few = {**SHORT, "filters": ["current"], "sensors": "realistic"}
    by_set = run_scenario(*load_scenario("link_sweep", [f"{key}={value}" for key, value in few.items()]))
    for source in ("link_sweep", load_scenario("link_sweep")[0]):
        run = fs.simulate(source, **few)
        assert run.scenario.controller.delay == 2e-3 and run.scenario == by_set.scenario
        assert run.estimate("current").tobytes() == by_set.estimate("current").tobytes()


def test_a_joints_file_is_looked_for_where_one_stands(tmp_path, monkeypatch):
    """As by `--set joint=my.yaml`, also for a shipped scenario, which lies elsewhere."""
    joint = fs.load_joint("test-joint")
    joint.model_copy(update={"name": "mine"}).write(tmp_path / "mine.yaml")
    monkeypatch.chdir(tmp_path)
    run = fs.simulate("no_load", joint="mine.yaml", duration=1, transient=0.2, filters=["current"])
    assert run.joint.name == "mine"


@pytest.fixture(scope="module")
def worn() -> fs.Joint:
    """The test joint with another friction forward than backward: a description that stands in no file."""
    asymmetry = Effect(name="friction_asymmetry", parameters={"ratio": Estimate(value=0.35)})
    return fs.load_joint("test-joint").model_copy(update={"name": "worn", "effects": [asymmetry]})


def test_a_joint_at_hand_stands_where_a_name_or_a_path_does(worn, run, tmp_path):
    """In every function that takes one; what it gives is what the same joint gives from its file."""
    worn.write(tmp_path / "worn.yaml")
    few = {**SHORT, "filters": ["RAREKF"]}
    nominal = fs.load_joint("test-joint")
    for key, here, there in (("joint", worn, tmp_path / "worn.yaml"), ("known_joint", nominal, "test-joint")):
        a, b = (fs.simulate("link_sweep", **few, **{key: one}) for one in (here, there))
        assert a.estimate("RAREKF").tobytes() == b.estimate("RAREKF").tobytes()
        assert a.joint.effects == b.joint.effects
    both = fs.simulate("link_sweep", joint=worn, known_joint=nominal, **few)
    assert both.joint.effects and not both.known_joint.effects
    # It stays what it is where only something else changes, and goes where it is replaced.
    again = fs.simulate(both.scenario, seed=5)
    assert again.joint.effects and again.scenario.seed == 5 and not again.known_joint.effects
    assert not fs.simulate(both.scenario, joint="test-joint").joint.effects
    table = fs.compare("link_sweep", joint=worn, known_joint=nominal, **few)
    assert table.loc[("link_sweep", "RAREKF"), "rms"] == both.metrics["filters"]["RAREKF"]["rms"]
    from_object, from_file = (fs.estimate(run, one, "current") for one in (worn, tmp_path / "worn.yaml"))
    pd.testing.assert_frame_equal(from_object, from_file)
    one, other = (fs.validate(run, joint=j).residual for j in (worn, str(tmp_path / "worn.yaml")))
    assert one == other
    arm = fs.simulate_arm("two_joints", duration=2, arm__1__joint=worn, arm__1__known_joint=nominal)
    assert arm["elbow"].joint.effects and not arm["elbow"].known_joint.effects and not arm["shoulder"].joint.effects


def test_a_run_is_a_measurement(run, worn):
    """A run is diagnosed, validated and planned from as its recording is, told what its estimators were."""
    recording = run.as_recording()
    assert fs.validate(run).residual == fs.validate(recording, joint=run.known_joint).residual
    assert fs.validate([run, recording], joint=worn).joint == "worn"
    moving = fs.simulate("link_sweep", seed=3, duration=5, filters=["lowpass"])
    hasty = fs.diagnose(moving, seconds=0)
    assert hasty.to_json() == fs.diagnose(moving.as_recording(), moving.known_joint, seconds=0).to_json()
    assert hasty.verdict == "inconclusive" and "time was up" in hasty.reason


def test_estimate(run, tmp_path):
    table = fs.estimate(run, estimators=["lowpass", "dynamics_ekf"])
    assert list(table.columns) == ["lowpass", "dynamics_ekf"] and table.index.name == "time [s]"
    assert table.attrs["unit"] == "N·m" and len(table) == 2000
    error = table["dynamics_ekf"] - run.truth("joint_torque")
    assert np.sqrt(np.mean(error.iloc[500:] ** 2)) < 0.1
    path = write_recording(run.as_recording(), tmp_path)
    for data in (path, str(path), read_recording(path), fs.load_recording(path)):
        pd.testing.assert_frame_equal(fs.estimate(data, "test-joint", "lowpass"), table[["lowpass"]])
    everything = fs.estimate(path)
    assert set(everything.columns) | set(everything.attrs["left_out"]) == set(registry.names())


def test_compare():
    table = fs.compare("link_sweep", ["RAREKF", "dynamics_ekf"], **SHORT)
    assert table.index.names == ["scenario", "filter"]
    assert list(table.index) == [("link_sweep", "RAREKF"), ("link_sweep", "dynamics_ekf")]
    assert table.loc[("link_sweep", "dynamics_ekf"), "rms"] < table.loc[("link_sweep", "RAREKF"), "rms"]
    run = fs.simulate("link_sweep", **SHORT)
    theirs = fs.compare(["link_sweep"], **SHORT)
    for name, values in run.metrics["filters"].items():
        assert theirs.loc[("link_sweep", name), "rms"] == values["rms"]


def short(result) -> str:
    """The `repr` of a result, which has at most ten lines."""
    text = repr(result)
    assert text.startswith(type(result).__name__) and len(text.splitlines()) <= 10 and len(text) < 800
    return text


def test_check_has_the_contents_of_the_command(flexspline, tmp_path):
    run = fs.simulate("link_sweep", duration=8, filters=["current"])
    found = fs.check(run)
    assert found.can_show and not found.mistakes and found.recordings[0].samples == 8000
    assert set(found.can_show).isdisjoint(found.undetermined) and "mistakes: none" in short(found)
    path = write_recording(run.as_recording(), tmp_path)
    code, out, error = flexspline("check", path, "--json")
    assert code == 0, error
    assert json.loads(out) == json.loads(json_text(fs.check(path).to_json()))


def test_tune():
    found = fs.tune("external_push", "EKF", train=[1], test=[11, 12], evaluations=8, fronts=True, duration=9)
    one = found.tuned["EKF"]
    assert one.test_tuned.shape == (1, 2) and one.train[1] <= one.train[0] and found.pushed == "external_push"
    assert "EKF" in short(found) and len(found.fronts) == 1
    tuned = fs.simulate("external_push", seed=1, **SHORT, filters=found.filters)
    assert tuned.scenario.estimators()["EKF"].V == pytest.approx(one.tuned.V, rel=1e-5)


def test_contact():
    found = fs.contact(estimators="current", hours=0.05, tolerances=[0.0], rate=400, duration=20)
    rows = {row["estimator"]: row for row in found.detectors}
    assert set(rows) == {"torque sensor", "current"} and found.scenario == "collision"
    assert rows["current"]["threshold"] > 0 and {row["estimator"] for row in found.curves} == set(rows)
    assert "torque sensor" in short(found)


def test_sweep_and_report(tmp_path):
    study = {"name": "tiny", "seeds": [1, 2, 3], "scenarios": ["link_sweep"], "set": SHORT, "metrics": ["rms"]}
    study |= {"filters": ["EKF", "lowpass"]}
    found = fs.sweep(study, tmp_path / "sweep", seeds=2, figures=False)
    table = found.table()
    assert list(table["filter"]) == ["EKF", "lowpass"] and list(table["runs"]) == [2, 2]
    (worst,) = found.worst
    run = fs.simulate(worst.again)
    assert run.metrics["filters"][worst.filter]["rms"] == worst.value > table["rms_mean"].max() and "tiny" in short(
        found
    )
    again = fs.sweep(study, tmp_path / "sweep", seeds=2, figures=False)
    pd.testing.assert_frame_equal(again.table(), table)
    page = fs.report(tmp_path / "sweep", tmp_path / "page.html")
    assert "tiny" in page.read_text(encoding="utf-8")
    (tmp_path / "own.html").write_text("mine", encoding="utf-8")
    with pytest.raises(fs.InputError, match="a page of this program, got another file"):
        fs.report(tmp_path / "sweep", tmp_path / "own.html")


def test_tables_of_what_there_is():
    assert tuple(fs.estimators().index) == registry.names() and fs.estimators().loc["rts_smoother", "causal"] == False  # noqa: E712
    assert list(fs.causes().index) == causes.names()
    assert fs.joints().loc["test-joint", "ratio"] == 100 and fs.joints().loc["test-joint", "rated_torque"] == 16
    for table in (fs.estimators(), fs.causes()):
        assert table["description"].str.len().min() > 10
    assert fs.load_joint("test-joint").name == "test-joint"


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: fs.simulate("no_laod"), "did you mean 'no_load'"),
        (lambda: fs.simulate("no_load", durtion=3), "durtion: unknown key; did you mean 'duration'"),
        (lambda: fs.simulate("no_load", filters=["lowpas"]), "did you mean 'lowpass'"),
        (lambda: fs.compare("no_load", "RAREK"), "did you mean 'RAREKF'"),
        (lambda: fs.compare(["no_load", "no_load"], duration=2), "expected each once"),
        (lambda: fs.load_joint("test-jont"), "did you mean 'test-joint'"),
        (lambda: fs.load_recording("nothing.parquet"), "no such file"),
        (
            lambda: fs.simulate("no_load", filters=["zz"]),
            "got 'zz'; one of a file of yours is known by --plugin FILE.py",
        ),
        (lambda: fs.estimate("nothing.parquet", estimators="zz"), "is known by --plugin FILE.py"),
        (lambda: fs.simulate("no_load", joint=3), "joint: expected a valid string, got 3"),
        (
            lambda: fs.simulate_arm("two_joints", arm__7__joint=fs.load_joint("test-joint")),
            "expected a number from 0 to 1",
        ),
        (lambda: fs.tune("no_load", "EKF", train=[1, 2], test=[2]), "got 2 in both"),
        (lambda: fs.tune("torque_feedback", "EKF", train=[1], test=[2]), "feedback: expected none or sensor"),
        (lambda: fs.contact(estimators="rts_smoother"), "expected a causal estimator"),
        (lambda: fs.contact(tolerances=[1, 1]), "tolerance: expected shares from 0 to 100, each once, got [1, 1]"),
        (lambda: fs.sweep("noise_and_laod", "x"), "did you mean 'noise_and_load'"),
        (lambda: fs.sweep({"name": "one"}, "x"), "study: seeds: missing"),
        (lambda: fs.report("nothing"), "nothing: expected a folder of a run"),
        (lambda: fs.check("nothing.parquet"), "nothing.parquet: expected a recording"),
        (lambda: fs.diagnose([]), "expected recordings or runs, got none"),
        (lambda: fs.validate([3]), "expected a path, recordings or runs, got int"),
        (lambda: fs.estimate("nothing.parquet"), "no such file"),
    ],
)
def test_wrong_input_is_one_line(call, message):
    with pytest.raises(fs.InputError) as caught:
        call()
    assert message in str(caught.value) and "\n" not in str(caught.value)


def test_annotations_are_real():
    """Types stand for something: every annotation of the interface can be resolved."""
    import flexspline.diagnosis  # noqa: F401

    names = {name: getattr(fs, name) for name in fs.__all__ if isinstance(getattr(fs, name), type)}
    for name in FUNCTIONS:
        typing.get_type_hints(getattr(fs, name), {**vars(fs), **names, "pd": pd, "mujoco": mujoco})


def test_results_show_themselves_in_a_notebook(run):
    """Small tables that hold the numbers, every text in them escaped."""
    recording = run.as_recording()
    error = ChannelError(0.031, 0.0, 0.012, "A", 0.94, 800)
    shown = {
        "run": run._repr_html_(),
        "joint": run.joint.model_copy(update={"description": "<script>"})._repr_html_(),
        "recording": recording._repr_html_(),
        "measurement": fs.Measurement("<b>", Path(), (recording,))._repr_html_(),
        "posterior": run.estimates["RAREKF"]._repr_html_(),
        "validation": fs.Validation("joint", {"motor_current": error}, (), {"angle": 0.1})._repr_html_(),
    }
    for name, text in shown.items():
        assert text.count("<table>") == text.count("</table>") >= 1, name
        assert "<script" not in text and "<b><b>" not in text, name
        assert "nan" not in re.sub(r"<[^>]*>", " ", text).split(), name
    assert f"{run.metrics['filters']['lowpass']['rms']:.4g}" in shown["run"]
    assert "motor_current" in shown["recording"] and "robust in" in shown["posterior"]
    finding = Finding("unknown", "link", 0.6, {}, 0.4, 1.2, "a torque that <depends>", ("link_position",))
    plan = Plan((Question(("backlash",), 0.0, 3.7),), (Proposal("sweeps", "Move <it>", 20.0, (9.0,)),))
    alike, open_ = (("payload", "gravity_moment"),), {"backlash": "no reversal"}
    diagnosis = Diagnosis("discrepancy", (), (finding,), {}, alike, open_, {}, (), run.joint, plan=plan)
    text = diagnosis._repr_html_()
    for one in (run, recording, diagnosis, plan, fs.Validation("joint", {"motor_current": error}, (), {})):
        assert repr(one).startswith(type(one).__name__) and len(repr(one).splitlines()) == 1 and len(repr(one)) < 400
    assert "a torque that &lt;depends&gt;" in text and "Move &lt;it&gt; (20 s): would show backlash" in text
    assert plan._repr_html_().count("<li>") == 1


def test_a_wrong_name_of_a_signal_is_answered_with_the_nearest(run):
    for wrong, call, right in (("torque", run.truth, "joint_torque"), ("motor_curent", run.reading, "motor_current")):
        with pytest.raises(fs.InputError, match=rf"{wrong}.*expected one of .*{right}"):
            call(wrong)
    with pytest.raises(fs.InputError, match=r"filter 'lowpas'.*did you mean 'lowpass'"):
        run.estimate("lowpas")
    with pytest.raises(AttributeError, match="did you mean 'estimate'"):
        fs.estimat  # noqa: B018
