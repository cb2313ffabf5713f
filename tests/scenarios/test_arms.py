"""Joints in series as an experiment: every joint has a run, a recording and a diagnosis."""

from __future__ import annotations

import json

import numpy as np
import pytest
import yaml

import flexspline as fs
from flexspline.models import causes
from flexspline.models.arm_dynamics import Arm
from flexspline.models.controller import control
from flexspline.models.errors import InputError
from flexspline.models.joint import load_joint
from flexspline.models.recording import read_recording, write_recording
from flexspline.scenarios.arms.arm_run import run_arm
from flexspline.scenarios.arms.arm_scenario import ArmScenario, load_any, load_arm
from flexspline.scenarios.scenario import load_scenario
from flexspline.sim.loop import CONTROL_PERIOD

SHORT = {"duration": 6.0, "arm__0__filters": ["model"], "arm__1__filters": ["model", "RAREKF"]}


@pytest.fixture(scope="module")
def runs():
    return fs.simulate_arm("two_joints", **SHORT)


def test_every_joint_has_a_run_of_its_own(runs):
    assert list(runs) == ["shoulder", "elbow"]
    for name, run in runs.items():
        assert run.name == f"two_joints_{name}"
        assert np.std(run.truth("link_position")) > 0.2
    assert list(runs["elbow"].estimates) == ["model", "RAREKF"]
    assert runs["elbow"].metrics["filters"]["RAREKF"]["rms"] < 0.2
    noise = [run.reading("joint_torque") - run.truth("joint_torque") for run in runs.values()]
    assert abs(np.corrcoef(noise)[0, 1]) < 0.1  # different streams


@pytest.mark.parametrize("turn", [0.0, 1.2])
def test_the_load_of_one_comes_from_the_others_motion(runs, turn):
    """The recording's arm and the others' encoders give the torque that the joint holds; the joint's own link alone does not."""
    if turn:
        runs = fs.simulate_arm("two_joints", **SHORT, arm__1__turn=turn)
    for name, run in runs.items():
        r = run.as_recording()
        inside = slice(200, -200)
        a = np.gradient(run.truth("link_velocity"), run.time)
        weight = r.link.gravity_moment * np.sin(run.truth("link_position") + r.link.gravity_angle)
        without = r.link.inertia * a + weight
        smooth = np.hanning(61) / np.hanning(61).sum()
        without, arm, Ts = (
            np.convolve(x, smooth, mode="same") for x in (without, r.torque_of_arm, run.truth("joint_torque"))
        )
        with_arm = without - arm
        error, blind = (np.std((x - Ts)[inside]) for x in (with_arm, without))
        print(f"{name}: {error:.3f} N·m, without the other's motion {blind:.3f} N·m of {np.std(Ts[inside]):.2f}")
        assert error < 0.06 and blind > 10 * error  # the torque sensor's noise is 0.03 N·m


def test_a_recording_of_a_joint_says_what_arm_it_is_in(runs, tmp_path):
    run = runs["elbow"]
    written = run.as_recording()
    again = read_recording(write_recording(written, tmp_path))
    np.testing.assert_array_equal(again.arm.positions["shoulder"], runs["shoulder"].reading("link_position"))
    np.testing.assert_allclose(again.torque_of_arm, written.torque_of_arm, atol=1e-9)
    assert again.link.inertia == pytest.approx(0.1) and again.link.gravity_moment == pytest.approx(2.0)
    sidecar = yaml.safe_load((tmp_path / "two_joints_elbow.yaml").read_text(encoding="utf-8"))
    assert sidecar["arm"]["joint"] == "elbow" and "link" not in sidecar
    # The estimators know the payload with the other joint at the median of its command.
    arm = runs["shoulder"].place.arm
    middle = {"elbow": float(np.median(run.position_command))}
    assert Arm(arm.spec, arm.mjcf).mounting(middle) == runs["shoulder"].scenario.link


def test_a_push_at_the_elbow_is_felt_by_the_shoulder():
    pushed = fs.simulate_arm(
        "two_joints",
        **SHORT,
        arm__1__disturbances=[{"kind": "step", "start": 2.0, "duration": 1.0, "torque": 2.0}],
        arm__0__disturbances=[{"kind": "step", "start": 2.5, "duration": 1.0, "torque": -1.0}],
    )
    recordings = {name: run.as_recording() for name, run in pushed.items()}
    at = {t: int(1000 * t) for t in (2.2, 2.7, 3.2)}
    for name, expected in (("elbow", (2.0, 2.0, 0.0)), ("shoulder", (2.0, 1.0, -1.0))):
        assert recordings[name].external == "measured"
        np.testing.assert_allclose(recordings[name]["external_torque"][list(at.values())], expected)
    # The torques on the shoulder change by what is pushed.
    quiet = fs.simulate_arm("two_joints", **SHORT)["shoulder"]
    late = slice(3100, 3450)
    change = np.mean((pushed["shoulder"].truth("joint_torque") - quiet.truth("joint_torque"))[late])
    assert change == pytest.approx(1.0, abs=0.15)


def test_the_same_again_to_the_bit_and_by_its_own_folder(runs, flexspline, tmp_path):
    code, text, error = flexspline(
        "run", "two_joints", "--set", "duration=6", "--set", "arm.0.filters=[model]", "--set",
        "arm.1.filters=[model, RAREKF]", "--no-figures", "--no-recording", "--out", tmp_path,
    )  # fmt: skip
    assert code == 0, error
    assert "elbow" in text
    folder = tmp_path / "two_joints"
    code, _, error = flexspline(
        "run", folder / "arm.yaml", "--no-figures", "--no-recording", "--out", tmp_path / "again"
    )
    assert code == 0, error
    for name, run in runs.items():
        once, twice = (
            read_recording(out / "two_joints" / name / f"two_joints_{name}.parquet")
            for out in (tmp_path, tmp_path / "again")
        )
        for channel, values in run.as_recording().columns.items():
            np.testing.assert_array_equal(once[channel], values)
            np.testing.assert_array_equal(twice[channel], values)
    # What takes a run or a recording takes each joint's.
    code, text, error = flexspline("check", folder / "elbow" / "two_joints_elbow.parquet")
    assert code == 0, error
    code, text, error = flexspline("report", folder, "--out", tmp_path / "arm.html")
    assert code == 0, error


def test_who_pushes_is_told_apart_from_who_moves(runs):
    """The estimate of external torque does not take the other joint's motion for a push."""
    from flexspline.estimator.offline import estimate_recording

    recording = runs["elbow"].as_recording()
    found = estimate_recording(recording, load_joint("test-joint"), ["current"]).external_torque["current"]
    blind = found + recording.torque_of_arm
    inside = slice(500, -500)
    error, taken = (np.sqrt(np.nanmean(x[inside] ** 2)) for x in (found, blind))
    print(f"{error:.3f} N·m, the other's motion as a push {taken:.3f} N·m")
    assert taken > 1.3 * error


ARM = {
    "name": "mine", "duration": 3.0,
    "arm": [{"name": "a", "trajectory": [{"time": 0, "position": 0}]}, {"name": "b", "trajectory": [{"time": 0, "position": 0}]}],
}  # fmt: skip


@pytest.mark.parametrize(
    ("key", "value", "words"),
    [
        ("arm.1.name", "a", ["arm.1.name", "'a' again"]),
        ("arm.1.name", "a/b", ["name"]),
        ("arm.0.duration", 4.0, ["arm.0.duration", "next to `arm`"]),
        ("arm.0.locked_rotor", True, ["locked_rotor"]),
        ("arm.0.disturbances", [{"kind": "push", "start": 1, "duration": 1, "torque": 1, "lever": 0.4}], ["lever", "0.4"]),
        ("arm.0.length", 0.0, ["length"]),
        ("arm.0.legnth", 0.4, ["legnth", "length"]),
        ("arm.1.joint", "tets-joint", ["tets-joint", "test-joint"]),
        ("arm", [], ["arm"]),
    ],
)  # fmt: skip
def test_what_is_wrong_with_an_arm_is_one_line(tmp_path, flexspline, key, value, words):
    path = tmp_path / "mine.yaml"
    path.write_text(yaml.safe_dump(ARM), encoding="utf-8")
    change = f"{key}={json.dumps(value)}"
    code, _, error = flexspline("run", path, "--set", change, "--out", tmp_path / "out")
    assert code == 2 and len(error.strip().splitlines()) == 1, error
    for word in words:
        assert word in error
    assert not (tmp_path / "out").exists()


def test_commands_of_one_joint_say_so(flexspline):
    with pytest.raises(InputError, match="flexspline run"):
        load_scenario("two_joints")
    with pytest.raises(InputError, match="got that of a single joint"):
        load_arm("no_load")
    assert isinstance(load_any("two_joints")[0], ArmScenario)
    code, _, error = flexspline("bound", "two_joints")
    assert code == 2 and "two_joints" in error


# --- a diagnosis survives in an arm --------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize(
    ("place", "cause", "values"),
    [
        ("shoulder", "mesh_friction", {"scale": 2.0}),
        ("elbow", "kinematic_error", {"order": 2.0, "amplitude": 2.6e-4, "phase": 0.9}),
        pytest.param("shoulder", "friction_asymmetry", {"ratio": 0.3}, marks=pytest.mark.long),
    ],
)
def test_a_diagnosis_survives_in_an_arm(place, cause, values):
    """Both joints move; what is hidden in one is named there and not of the other, each by its own recording."""
    scenario, _ = load_arm("two_joints", changes={"arm.0.filters": ["model"], "arm.1.filters": ["model"]})
    joint = load_joint("test-joint")
    mounting = next(one for one in scenario.arm if one.name == place).link
    record = joint.record(mounting)
    causes.get(cause).apply(record[0], values)
    for name, run in run_arm(scenario, records={place: record}).items():
        found = fs.diagnose(run.as_recording(), joint)
        named = [one.name for one in found.causes]
        print(name, named)
        assert named[:1] == ([cause] if name == place else [])


def test_a_push_on_a_turned_axis_loads_the_joint_before_by_its_cosine():
    push = [{"kind": "step", "start": 2, "duration": 1, "torque": 1}]
    turned = SHORT | {"arm__1__turn": 0.5}
    quiet, pushed = (
        fs.simulate_arm("two_joints", **turned),
        fs.simulate_arm("two_joints", **turned, arm__1__disturbances=push),
    )
    at, expected = slice(2400, 2900), {"shoulder": np.cos(0.5), "elbow": 1.0}
    for name, run in pushed.items():
        np.testing.assert_allclose(run.as_recording()["external_torque"][at], expected[name], rtol=1e-12)
        change = np.mean((run.truth("joint_torque") - quiet[name].truth("joint_torque"))[at])
        assert change == pytest.approx(-expected[name], abs=0.1)


def test_the_weight_of_a_payload_by_hand():
    """Shoulder at 0.9 rad, elbow at −0.4 rad, 1.2 kg at 0.2 m along the elbow's link and 0.05 m to its front."""
    still = [{"time": 0, "position": 0.9}], [{"time": 0, "position": -0.4}]
    keys = {f"arm__{i}__trajectory": way for i, way in enumerate(still)}
    payload = {"start": 2.0, "end": 4.0, "body": "elbow", "mass": 1.2, "position": [0.05, 0.0, -0.2]}
    runs = fs.simulate_arm("two_joints", **SHORT | keys, payloads=[payload])
    q1, q2 = (runs[name].truth("link_position")[3900:4000].mean() for name in ("shoulder", "elbow"))
    level = 0.2 * np.sin(q1 + q2) + 0.05 * np.cos(q1 + q2)  # of the payload from the elbow's axis
    for name, lever in (("elbow", level), ("shoulder", 0.35 * np.sin(q1) + level)):
        torque, r = runs[name].truth("joint_torque"), runs[name].as_recording()
        before, during, after = (torque[at].mean() for at in (slice(1900, 2000), slice(3900, 4000), slice(5900, 6000)))
        assert during - before == pytest.approx(1.2 * 9.80665 * lever, abs=0.02)
        assert after == pytest.approx(before, abs=0.02)
        assert r.load.torque[3950] - r.load.torque[1950] == pytest.approx(-1.2 * 9.80665 * lever, abs=0.02)
    blind = fs.simulate_arm("two_joints", **SHORT | keys, payloads=[payload], known_payloads=False)
    known_torque = blind["elbow"].as_recording().load.torque
    assert known_torque[3950] == pytest.approx(known_torque[1950], abs=0.02)


def test_a_payload_on_no_joint_is_refused():
    with pytest.raises(
        InputError, match=r"payloads\.0\.body: expected a joint, one of \['shoulder', 'elbow'\], got 'elbo'; did"
    ):
        fs.simulate_arm("two_joints", **SHORT, payloads=[{"start": 1, "mass": 1, "body": "elbo"}])


def test_estimates_of_a_filter_that_is_fed_back_are_those_of_the_loop():
    """The drive's commands follow from them, to the bit. They once had the load of the other joint, which the loop does not."""
    keys = {"arm__1__filters": ["momentum", "augmented"], "arm__1__feedback": "augmented"}
    run = fs.simulate_arm("two_joints", **SHORT | keys)["elbow"]
    p, asked, rate = run.known_joint.record()[0], *run.scenario.commands()
    drive = run.scenario.controller.record(p, CONTROL_PERIOD, True, run.scenario.mode)[0]
    state, torque, measured = (
        np.array([p["N"] * asked[0], 0.0, 0.0]),
        run.estimate("augmented"),
        run.reading("motor_position"),
    )
    replayed = [
        control(asked[k], rate[k], measured[k], torque[k], state, CONTROL_PERIOD, drive) for k in range(len(asked))
    ]
    np.testing.assert_array_equal(replayed, run.simulation.command)
    assert list(run.estimates) == ["momentum", "augmented"]
