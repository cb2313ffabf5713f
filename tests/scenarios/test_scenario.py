"""Scenario files: trajectories, disturbances, overrides, and what is wrong in them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import flexspline as fs
from flexspline.models.errors import InputError
from flexspline.models.joint import load_joint
from flexspline.models.joint_parts import Mounting
from flexspline.scenarios.arms.arm_scenario import load_any
from flexspline.scenarios.experiment import Experiment
from flexspline.scenarios.scenario import Disturbance, Scenario, load_scenario, shipped_scenarios

PAPER = ("no_load", "link_sweep", "external_push", "hysteresis_loop")


def test_the_papers_experiments_are_shipped():
    assert set(PAPER) <= set(shipped_scenarios())
    position, velocity = load_scenario("no_load")[0].commands()
    assert position[-1] == pytest.approx(np.pi)
    assert position[80_000] == pytest.approx(np.pi) and velocity[80_000] == 0  # 180° in 80 s
    position, _ = load_scenario("link_sweep")[0].commands()
    assert position[-1] == pytest.approx(np.pi / 2)
    chosen, _ = load_scenario("external_push")
    torque, (_, velocity) = chosen.external_torque(), chosen.commands()
    for moving in (True, False):
        pushed = torque[(velocity != 0) == moving]
        assert pushed.max() > 1 and pushed.min() < -1


@pytest.mark.parametrize("profile", ["minimum_jerk", "linear"])
def test_velocity_is_the_derivative_of_position(profile):
    s = Scenario(
        name="x",
        duration=6,
        trajectory=[
            {"time": 0.5, "position": 0.1},
            {"time": 2.0, "position": 1.3, "profile": profile},
            {"time": 3.0, "position": -0.4, "profile": profile},
            {"time": 4.0, "position": -0.4, "profile": profile},
        ],
    )
    position, velocity = s.commands()
    assert np.abs(np.diff(position)).max() < 4e-3  # no jumps
    middle = 0.5 * (velocity[1:] + velocity[:-1])
    smooth = np.abs(np.diff(velocity)) < 0.05  # not across a linear motion's ends
    np.testing.assert_allclose((np.diff(position) / 1e-3)[smooth], middle[smooth], atol=1e-4)
    np.testing.assert_allclose(np.cumsum(velocity)[-1] * 1e-3, position[-1] - position[0], atol=3e-3)
    assert position[0] == position[400] == 0.1 and (velocity[:500] == 0).all()
    assert position[-1] == -0.4 and velocity[-1] == 0


def test_disturbances():
    t = np.arange(0, 3, 1e-3)
    push, step, triangle, sine = (
        Disturbance(kind=kind, start=1.0, duration=1.0, torque=4.0).signal(t)
        for kind in ("push", "step", "triangle", "sine")
    )
    for signal in (push, step, triangle, sine):
        assert (signal[:1000] == 0).all() and (signal[2000:] == 0).all()
    assert push[1500] == triangle[1500] == 4.0
    assert (step[1000:2000] == 4.0).all()
    assert triangle[1250] == pytest.approx(2.0)
    assert sine[1250] == pytest.approx(4.0) and sine[1750] == pytest.approx(-4.0)
    assert push.sum() * 1e-3 == pytest.approx(8 / np.pi, rel=1e-5)


def test_overrides_reach_everything():
    chosen, _ = load_scenario(
        "external_push",
        [
            "duration=2.5", "controller.kp=6", "filters.2.k=0.1", "plant.K1=9000", "sensors.joint_torque.noise=5e-2",
            "trajectory.1.position=1.0", "disturbances.0.torque=1e-1", "feedback=none",
            "description=another one", "temperature=40",
        ],
        seed=9,
    )  # fmt: skip
    assert chosen.duration == 2.5 and chosen.controller.kp == 6 and chosen.estimators()["RAREKF"].k == 0.1
    assert chosen.trajectory[1].position == 1.0 and chosen.disturbances[0].torque == 0.1 and chosen.seed == 9
    assert chosen.description == "another one"
    joint, known = chosen.load_joint()
    assert joint.numbers["K1"].value == 9000 and known.numbers["K1"].value == 8400
    assert joint.sensors.joint_torque.noise == 0.05


def test_resolution_given_otherwise_replaces_the_joints():
    chosen, _ = load_scenario("no_load", ["sensors.motor_encoder.bits=16"])
    joint, _ = chosen.load_joint()
    assert joint.sensors.motor_encoder.bits == 16 and joint.sensors.motor_encoder.counts is None


BAD = {
    ("duration=0",): "duration: expected greater than 0",
    ("duration=0.001",): "duration: expected at least two control periods",
    ("duration=-1",): "duration: expected greater than 0",
    ("duration=long",): "duration: expected a valid number",
    ("duration=0.5",): "transient: expected less than the duration 0.5 s",
    ("duration=3", "transient=2.9999"): "transient: expected less than the duration 3 s by two control periods",
    ("duration=3", "transient=2.9985"): "transient: expected less than the duration 3 s by two control periods",
    ("timestep=0.0003",): "timestep: expected a whole fraction of 0.001 s",
    ("timestep=2e-3",): "timestep: expected less than or equal to 0.001",
    ("timestep=1e-320",): "timestep: expected a valid number",
    ("durations=3",): "durations: unknown key; did you mean 'duration'?",
    ("controller.kpp=3",): "controller.kpp: unknown key; did you mean 'kp'?",
    ("filters.0.estimator=kalmann",): "filters.0: estimator: expected one of",
    ("filters.0.kk=1",): "filters.0: kk: unknown key; did you mean 'k'?",
    ("filters.0.V=0",): "filters.0: filter 'EKF': V [(N·m)²]: expected a finite number > 0, got 0",
    ("temperature=warm",): "temperature.start: expected a valid number",
    ("temperature={start: 20, end: 40}",): "temperature: time_constant: missing",
    ("temperature={start: 20, end: 40, time_constant: 0}",): "temperature.time_constant: expected greater than 0",
    ("record=[motor_position, motor_curent]",): "record.1: expected one of",
    ("record=[motor_position]",): "record: expected a torque, one of the columns motor_current",
    ("filters.7.k=1",): "expected a number from 0 to 3, got '7'",
    ("filters.0.name=AREKF",): "filters.1.name: expected another name, got 'AREKF'",
    ("feedback=RAREK",): "feedback: expected none, sensor or one of",
    ("plant.K9=3",): "plant.K9: unknown key",
    ("trajectory.1.time=1",): "trajectory.1.time: expected a time after 2 s, got 1 s",
    ("seed=-1",): "seed: expected greater than or equal to 0",
    ("seed=1e30",): "seed: expected a smaller integer, got 1e+30",
    ("duration",): "--set duration: expected key=value, got no '='",
    ("=3",): "--set =3: no key",
    ("duration.x=3",): "duration is a value, expected something with keys",
}


@pytest.mark.parametrize("changes", BAD, ids=" ".join)
def test_bad_scenario_is_one_line(changes):
    with pytest.raises(InputError) as caught:
        load_scenario("external_push", list(changes))
    message = str(caught.value)
    print(message)
    assert "\n" not in message
    assert BAD[changes] in message


def test_a_bad_change_is_not_blamed_on_the_file():
    for changes, expected in (
        (("controller.kp=fast",), "--set controller.kp: expected a valid number, got 'fast'"),
        (("sensors=ideal",), "--set sensors: expected a mapping of keys or 'realistic', got 'ideal'"),
        (("seed=2", "controller=5", "jitter=0"), "--set controller: expected a mapping of keys ("),
        (("temperature=warm",), "--set temperature: temperature.start: expected a valid number"),
        (("duration=0.5",), "external_push.yaml with --set duration: transient: expected less than the duration 0.5 s"),
    ):
        with pytest.raises(InputError) as caught:
            load_scenario("external_push", list(changes))
        assert expected in str(caught.value) and ("yaml" in expected or "yaml" not in str(caught.value))


def test_bad_joint_numbers_and_sensors_are_one_line():
    for change, expected in (
        ("plant.Jm=-1", "numbers.Jm.value: expected a number > 0, got -1"),
        ("plant.T2=1", "numbers.T2.value: expected T2 ≥ T1"),
        ("sensors.link_encoder.nois=1", "link_encoder.nois: unknown key; did you mean 'noise'?"),
        ("sensors.link_encodr.noise=1", "link_encodr: unknown key; did you mean 'link_encoder'?"),
        ("sensors.joint_torque.noise=-1", "joint_torque.noise: expected greater than or equal to 0"),
        ("joint=test-jont", "did you mean 'test-joint'?"),
    ):
        chosen, folder = load_scenario("external_push", [change])
        with pytest.raises(InputError) as caught:
            chosen.load_joint(folder)
        assert expected in str(caught.value), str(caught.value)
        assert "\n" not in str(caught.value)


def test_joint_beside_the_scenario(tmp_path):
    from flexspline.models.joint import load_joint

    load_joint("test-joint").write(tmp_path / "mine.yaml")
    (tmp_path / "s.yaml").write_text(
        "name: s\njoint: mine.yaml\nduration: 2\ntrajectory: [{time: 0, position: 0}]\n", encoding="utf-8"
    )
    chosen, folder = load_scenario(tmp_path / "s.yaml")
    assert chosen.load_joint(folder)[0].name == "test-joint"


def test_temperature():
    constant, warming = (
        load_scenario("no_load", [f"temperature={t}"])[0].temperature
        for t in ("31.5", "{start: 20, end: 45, time_constant: 600}")
    )
    t = np.array([0.0, 600.0, 1e9])
    np.testing.assert_array_equal(constant.signal(t), 31.5)
    np.testing.assert_allclose(warming.signal(t), [20, 45 - 25 / np.e, 45])
    assert (
        Scenario.model_validate(load_scenario("no_load", ["temperature=31.5"])[0].model_dump()).temperature == constant
    )


def test_temperature_reaches_the_plant_of_a_run_again():
    """Friction that falls with temperature: what the joint needs to turn falls as it warms; a second run begins as the first."""
    current = {}
    for temperature in ("25", "65", "{start: 25, end: 65, time_constant: 0.01}"):
        chosen, folder = load_scenario("no_load", [f"temperature={temperature}", "duration=12"])
        experiment = Experiment.of(chosen, folder)
        record = experiment.record.copy()
        record[0]["friction_temperature"] = -0.01
        experiment = replace(experiment, record=record)
        model = experiment.build()
        first, second = (experiment.simulate(model) for _ in range(2))
        assert first.truth.tobytes() == second.truth.tobytes()
        current[temperature] = np.mean(first.truth["motor_current"][8000:])
    cold, warm, warmed = current.values()
    assert warm == pytest.approx(0.6 * cold, rel=0.1)  # 40 K less 1 % each; the rest turns without friction
    assert warmed == pytest.approx(warm, rel=1e-3)


@pytest.mark.parametrize("name", ["link_sweep", "two_joints"])
def test_a_link_replaces_the_mounting_and_a_mounting_the_link(name, tmp_path):
    """A change once was refused, as the file has the other one."""
    link = {"inertia": 0.5, "gravity_moment": 3.0}
    key = "arm.1." if name == "two_joints" else ""
    load = load_any if key else load_scenario
    for change, expected in ((f"{key}link={link}", link), (f"{key}mounting=no_load", None)):
        found, _ = load(name, [change])
        one = found.arm[1] if key else found
        assert one.link == (None if expected is None else Mounting(**link))
        assert one.mounting == ("" if expected else "no_load")
        if key:
            assert found.arm[0].link is not None
    with pytest.raises(InputError, match="expected either mounting or link, got both"):
        load(name, [f"{key}link={link}", f"{key}mounting=link"])


def test_simulate_takes_a_link():
    run = fs.simulate("external_push", duration=1.5, link={"inertia": 0.5, "gravity_moment": 3.0}, filters=["model"])
    assert run.as_recording().link.gravity_moment == 3.0
    again = fs.simulate(run.scenario, mounting="no_load", duration=1.5, filters=["model"])
    assert again.as_recording().link == load_joint("test-joint").mount("no_load")
