"""Velocity and torque control: what the drive is commanded, from waypoints, motions and files."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
import yaml

import flexspline as fs
from flexspline.models.errors import InputError
from flexspline.models.files import parse
from flexspline.models.joint import load_joint
from flexspline.scenarios.arms.arm_run import run_arm
from flexspline.scenarios.arms.arm_scenario import ArmScenario
from flexspline.scenarios.evaluation.draws import varied
from flexspline.scenarios.run import run_scenario
from flexspline.scenarios.run_folder import load_run, save_run
from flexspline.scenarios.scenario import Scenario
from flexspline.views.figures.run import overview

P = load_joint("test-joint").record()[0]
BENCH = {"mounting": "", "link": {"inertia": 1e9, "gravity_moment": 0.0}}


def scenario(trajectory, duration=4, **more):
    data = {"name": "controlled", "duration": duration, "mounting": "no_load", "trajectory": trajectory,
            "filters": ["current"]}  # fmt: skip
    return parse(data | more, Scenario, "here")


def motor_torque(run):
    """N·Kt·i at the output [N·m], shape (n,)."""
    return P["N"] * P["Kt"] * run.truth("motor_current")


def test_velocity_control_tracks_a_constant_velocity():
    """The integral removes the steady error, with a payload, too; ripple of the kinematic error remains."""
    payload = {"start": 2.5, "mass": 1.0, "distance": 0.2}
    run = run_scenario(scenario([{"time": 0.2, "velocity": 0.0}, {"time": 1.0, "velocity": 0.6}], 8, start=-1.0,
                                payloads=[payload], known_payloads=False))  # fmt: skip
    assert run.truth("link_position")[0] == pytest.approx(-1.0, abs=1e-3)
    for part in (slice(1500, 2500), slice(5000, 8000)):
        assert run.truth("link_velocity")[part].mean() == pytest.approx(0.6, rel=2e-3)
    assert run.metrics["velocity_error"]["unit"] == "rad/s" and run.metrics["velocity_error"]["rms"] < 0.05
    assert "position_command" not in run.as_recording() and run.position_command is None


def test_velocity_control_does_not_catch_up():
    """While a step of torque holds the link, way is lost; afterwards the velocity is not above its command for long."""
    way = [{"time": 0.2, "velocity": 0.0}, {"time": 1.0, "velocity": 0.6}]
    held = {"kind": "step", "start": 2, "duration": 1, "torque": -60.0}
    run = run_scenario(scenario(way, 6, disturbances=[held]))
    lost = 0.6 * 1.0 - (run.truth("link_position")[3000] - run.truth("link_position")[2000])
    assert lost > 0.6  # pushed back
    gained = np.ptp(run.truth("link_position")[4000:]) - 0.6 * 2.0
    assert abs(gained) < 0.02 * lost


@pytest.mark.parametrize("kind", ["waypoints", "file"])
def test_torque_control_gives_the_commanded_torque(kind, tmp_path):
    """N·Kt·i follows the command by the winding's time constant and half a control period; a held output keeps it slow."""
    if kind == "waypoints":
        way = [{"time": 0.5, "torque": 0.0}, {"time": 1.5, "torque": 12.0}, {"time": 3.0, "torque": -8.0}]
        run = run_scenario(scenario(way, **BENCH))
    else:
        time = np.arange(0, 3.5, 0.01)
        asked = 4.0 * (1 - np.cos(2 * np.pi * time / time[-1]))
        pd.DataFrame({"time": time, "torque": asked}).to_csv(tmp_path / "asked.csv", index=False)
        data = {"name": "filed", "duration": 4, "trajectory": [{"time": 0, "torque": 1.0}],
                "motions": [{"kind": "file", "file": "asked.csv", "start": 0.3}]}  # fmt: skip
        (tmp_path / "filed.yaml").write_text(yaml.safe_dump(data | BENCH))
        run = fs.simulate(str(tmp_path / "filed.yaml"), filters=["current"])
        np.testing.assert_allclose(run.command[300:3700:10], 1.0 + asked[:340], atol=1e-9)
    slope = np.gradient(run.command, run.time)
    late = run.command - (0.5e-3 + P["L"] / P["R"]) * slope
    kept = run.time > 0.02  # the file's first command is a step
    assert np.abs(motor_torque(run) - late)[kept].max() < 0.3e-3 * np.abs(slope).max()
    np.testing.assert_allclose(run.command_error, run.command - motor_torque(run), atol=1e-9)


def test_a_held_output_has_the_commanded_torque_less_friction():
    run = run_scenario(scenario([{"time": 0.5, "torque": 0.0}, {"time": 3.0, "torque": 12.0}], **BENCH))
    friction = motor_torque(run)[-500:] - run.truth("joint_torque")[-500:]
    assert np.abs(friction).max() < 1.2 * P["N"] * P["Fs"] and run.truth("joint_torque")[-1] > 5.0


def test_torque_loop_gives_the_commanded_joint_torque():
    """At rest, N·Kt·i = u + kT·(u − T̂): the difference of motor and joint torque is 1 + kT times the error."""
    way = [{"time": 0.5, "torque": 0.0}, {"time": 3.0, "torque": 12.0}]
    run = run_scenario(scenario(way, controller={"torque_loop": 4}, feedback="sensor", **BENCH))
    error = (12.0 - run.reading("joint_torque")[-500:]).mean()
    assert abs(error) < 0.5
    assert motor_torque(run)[-500:].mean() == pytest.approx(12.0 + 4 * error, abs=0.02)


def test_run_folder_and_figure_of_a_torque_controlled_run(tmp_path):
    run = run_scenario(scenario([{"time": 0.5, "torque": 0.0}, {"time": 1.5, "torque": 6.0}]))
    save_run(run, tmp_path / "run", [lambda run, folder: overview(run).savefig(folder / "overview.png")])
    again = load_run(tmp_path / "run")
    np.testing.assert_array_equal(again.command, run.command)
    assert again.metrics["torque_error"] == run.metrics["torque_error"]


def test_drawn_runs_start_elsewhere():
    given = scenario([{"time": 0.5, "torque": 0.0}, {"time": 1.5, "torque": 6.0}], start=0.3)
    drawn = [varied(given, seed) for seed in (1, 2)]
    assert drawn[0].start != drawn[1].start and [w.torque for w in drawn[0].trajectory] == [0.0, 6.0]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"trajectory": [{"time": 0, "position": 1, "torque": 1}]}, "one of position, velocity, torque, got position and"),
        ({"trajectory": [{"time": 0}]}, "expected one of position, velocity, torque, got none"),
        ({"trajectory": [{"time": 0, "torque": 1}, {"time": 1, "velocity": 1}]}, "trajectory.1: expected a torque"),
        ({"trajectory": [{"time": 0, "position": 1}], "start": 1}, "start: expected none in position control"),
    ],
)  # fmt: skip
def test_a_wrong_command_is_one_line(changes, message):
    with pytest.raises(InputError, match=message) as error:
        scenario(**changes)
    assert "\n" not in str(error.value)


def arm(elbow):
    """An arm whose shoulder holds its position, and its elbow."""
    shoulder = {"name": "shoulder", "mounting": "link", "trajectory": [{"time": 0, "position": 0.3}]}
    joints = [shoulder, {"name": "elbow", "link": {"inertia": 0.1, "gravity_moment": 2.0}} | elbow]
    return parse({"name": "two", "duration": 4, "arm": joints}, ArmScenario, "here")


def test_a_joint_of_an_arm_is_velocity_controlled():
    way = [{"time": 0.2, "velocity": 0.0}, {"time": 1.0, "velocity": 0.5}]
    runs = run_arm(arm({"trajectory": way, "start": -0.7, "filters": ["current"]}))
    assert runs["elbow"].truth("link_position")[0] == pytest.approx(-0.7, abs=1e-3)
    assert runs["elbow"].truth("link_velocity")[2000:].mean() == pytest.approx(0.5, rel=5e-3)
    assert np.abs(runs["shoulder"].command_error).max() < 0.02


def test_a_joint_of_an_arm_has_no_payloads():
    with pytest.raises(InputError, match=r"arm\.1: payloads: expected them next to `arm`"):
        arm({"trajectory": [{"time": 0, "position": 0}], "payloads": [{"start": 1, "mass": 1, "distance": 0.1}]})
