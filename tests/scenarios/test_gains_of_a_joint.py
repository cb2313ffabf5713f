"""`controller:` of a joint: default gains in every scenario, study, trial and arm, where a scenario states none."""

from __future__ import annotations

import numpy as np
import pytest
import yaml

import flexspline as fs
from flexspline.diagnosis.trials.motions import motions, record_motion
from flexspline.models.controller import Controller
from flexspline.scenarios.arms.arm_scenario import load_arm
from flexspline.scenarios.evaluation.draws import varied
from flexspline.scenarios.experiment import Experiment
from flexspline.scenarios.scenario import load_scenario
from flexspline.scenarios.studies.statistics import open_study

OWN = {"kp": 5.0, "kd": 0.06, "ki": 3.0}
SHORT = {"duration": 3.0, "transient": 0.5, "filters": ["current"]}


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    """The test joint's file with a section `controller`."""
    path = tmp_path_factory.mktemp("joint") / "mine.yaml"
    fs.load_joint("test-joint").write(path)
    assert "controller" not in path.read_text(encoding="utf-8")
    with path.open("a", encoding="utf-8") as file:
        file.write(yaml.safe_dump({"controller": OWN}))
    return path


def of(scenario: str, *changes: str) -> Controller:
    """The controller with which a scenario runs."""
    return Experiment.of(*load_scenario(scenario, list(changes))).scenario.controller


def test_the_gains_are_those_of_set(path):
    by_file = fs.simulate("link_sweep", joint=path, **SHORT)
    by_set = fs.simulate("link_sweep", **SHORT, controller__kp=5.0, controller__kd=0.06, controller__ki=3.0)
    other = fs.simulate("link_sweep", **SHORT)
    for channel in ("motor_current", "motor_position", "joint_torque"):
        assert by_file.reading(channel).tobytes() == by_set.reading(channel).tobytes()
        assert by_file.reading(channel).tobytes() != other.reading(channel).tobytes()
    assert by_file.scenario.controller == Controller(**OWN)


def test_what_a_scenario_states_takes_precedence(path):
    assert of("link_sweep", f"joint={path}") == Controller(**OWN)
    assert of("link_sweep", f"joint={path}", "controller.kp=6") == Controller(**OWN | {"kp": 6.0})
    # torque_feedback states a share, and no gains.
    assert of("torque_feedback", f"joint={path}", "controller.torque_feedback=0.5") == Controller(
        **OWN, torque_feedback=0.5
    )
    assert of("link_sweep", f"joint={path}", "controller.kp=8") == Controller(**OWN | {"kp": 8.0})
    assert of("link_sweep", f"known_joint={path}") == Controller()


def test_a_scenario_object_keeps_what_it_states(path):
    plain, _ = load_scenario("link_sweep")
    assert fs.simulate(plain, joint=path, **SHORT).scenario.controller == Controller(**OWN)
    stated, _ = load_scenario("link_sweep", ["controller.kd=0.07"])
    assert fs.simulate(stated, joint=path, **SHORT).scenario.controller == Controller(**OWN | {"kd": 0.07})


def test_realistic_sensors_lower_the_gains(path):
    realistic = (f"joint={path}", "sensors=realistic")
    assert of("link_sweep", *realistic) == Controller(**OWN).lagging(2e-3)
    assert of("link_sweep", *realistic, "controller.delay=0.001") == Controller(**OWN, delay=1e-3)
    scenario, folder = load_scenario("link_sweep", list(realistic))
    lags = [Experiment.of(varied(scenario, seed), folder).scenario.controller for seed in range(5)]
    assert len({one.delay for one in lags}) == 5
    assert all(one == Controller(**OWN).lagging(one.delay) for one in lags)
    own = fs.load_joint(path).model_copy(update={"controller": Controller(kp=2.0, delay=1e-3)})
    assert fs.simulate(scenario.with_joints({"joint": own})).scenario.controller == own.controller


def test_studies_arms_and_trials_use_them(path, tmp_path):
    study = {"name": "own", "seeds": [1], "scenarios": ["link_sweep"], "set": {"joint": str(path), "duration": 1.5}}
    dataset = open_study(study, tmp_path / "sweep")
    assert dataset.design.experiment(dataset.design.cells[0]).scenario.controller == Controller(**OWN)
    arm = fs.simulate_arm("two_joints", duration=1.5, arm__1__joint=path)
    again = fs.simulate_arm(load_arm("two_joints")[0], duration=1.5, arm__1__joint=str(path))
    for runs in (arm, again):
        gains = {name: run.scenario.controller for name, run in runs.items()}
        assert gains == {"shoulder": Controller(), "elbow": Controller(**OWN)}
    joint = fs.load_joint(path)
    scenario = motions(np.random.default_rng(1))[0]
    scenario = scenario.model_copy(update={"duration": 1.0})
    mounting = joint.mount(scenario.mounting)
    current = {
        name: record_motion(one, mounting, joint.record(mounting), chosen, 1)["motor_current"].tobytes()
        for name, one, chosen in (
            ("file", joint, scenario),
            ("stated", joint, scenario.model_copy(update={"controller": Controller(kp=4.0)})),
            ("none", joint.model_copy(update={"controller": None}), scenario),
            ("same", fs.load_joint("test-joint"), scenario.model_copy(update={"controller": Controller(**OWN)})),
        )
    }
    assert current["file"] == current["same"] and len(set(current.values())) == 3


def test_a_diagnosis_and_a_copy_keep_the_section(path, tmp_path):
    fs.load_joint(path).write(tmp_path / "copy.yaml")
    assert fs.load_joint(tmp_path / "copy.yaml").controller == Controller(**OWN)


def test_a_wrong_key_is_one_line(path, tmp_path):
    wrong = tmp_path / "wrong.yaml"
    wrong.write_text(path.read_text(encoding="utf-8").replace("kp: 5.0", "kpp: 5.0"), encoding="utf-8")
    with pytest.raises(fs.InputError, match=r"wrong.yaml.*controller.kpp: unknown key; did you mean 'kp'") as caught:
        fs.load_joint(wrong)
    assert "\n" not in str(caught.value)
