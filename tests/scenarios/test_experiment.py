"""A scenario in the closed loop: the same for all filters, to the bit; reproducible; and what feedback buys."""

from __future__ import annotations

import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from flexspline.estimator import FilterDiverged, registry
from flexspline.models.errors import InputError
from flexspline.models.joint import load_joint
from flexspline.models.joint_parts import Effect, Estimate
from flexspline.scenarios.experiment import Experiment, estimate, signals_of
from flexspline.scenarios.filters import PAPER
from flexspline.scenarios.run import run_scenario
from flexspline.scenarios.scenario import Scenario, load_scenario, shipped_scenarios

CAUSAL = [name for name in registry.names() if registry.get(name).causal]


def scenario(**changes) -> Scenario:
    """Three seconds with the link: a motion, two pushes."""
    data = {
        "name": "short",
        "mounting": "link",
        "duration": 3.0,
        "seed": 5,
        "transient": 0.5,
        "trajectory": [{"time": 0.3, "position": 0.0}, {"time": 2.0, "position": 0.3}],
        "disturbances": [
            {"kind": "push", "start": 1.0, "duration": 0.3, "torque": 5.0},
            {"kind": "step", "start": 2.2, "duration": 0.3, "torque": -4.0},
        ],
    } | changes
    return Scenario.model_validate(data)


def signals(run) -> dict[str, bytes]:
    """Everything but the estimates, as bytes."""
    s = run.simulation
    return {name: getattr(s, name).tobytes() for name in ("time", "truth", "readings", "command")}


def said(found) -> dict[str, bytes]:
    """Everything that an estimator says, as bytes."""
    parts = ("mean", "variance", "innovation", "innovation_covariance", "robust", "external")
    values = {name: getattr(found, name) for name in parts} | dict(found.columns)
    return {name: value.tobytes() for name, value in values.items() if value is not None}


def test_same_seed_same_bits():
    a, b = run_scenario(scenario()), run_scenario(scenario(), threads=3)
    assert signals(a) == signals(b)
    assert {name: said(found) for name, found in a.estimates.items()} == {
        name: said(found) for name, found in b.estimates.items()
    }


def test_other_seed_other_noise():
    """The motor encoder has counts and no noise, so the motion is the same; with an estimate fed back it is not."""
    a, b = run_scenario(scenario()), run_scenario(scenario(seed=6))
    assert a.simulation.truth.tobytes() == b.simulation.truth.tobytes()
    for name in ("link_position", "motor_current", "joint_torque", "force_x", "torque_y"):
        assert (a.reading(name) != b.reading(name)).mean() > 0.2, name
    for name in a.estimates:
        assert (a.estimate(name) != b.estimate(name)).mean() > 0.2, name
    a, b = run_scenario(scenario(feedback="RAREKF")), run_scenario(scenario(feedback="RAREKF", seed=6))
    assert 0 < np.abs(a.truth("joint_torque") - b.truth("joint_torque")).max() < 1


def test_filters_see_the_same_signals_whoever_else_is_there():
    """Filters removed, added, in another order: every signal the same to the bit, and so is each filter's estimate."""
    full = run_scenario(scenario())
    for choice in ([0], [2], [3, 1], [2, 1, 0, 3]):
        other = run_scenario(scenario(filters=[PAPER[i] for i in choice] + ["lowpass"]))
        assert signals(other) == signals(full)
        for name in (PAPER[i] for i in choice):
            assert said(other.estimates[name]) == said(full.estimates[name]), name


@pytest.mark.parametrize("name", CAUSAL)
def test_what_feeds_back_says_in_the_loop_what_it_says_afterwards(name):
    """Every causal estimator: what acted in the loop is, to the bit, what the same step says over the signals."""
    chosen = scenario(filters=[name], feedback=name, duration=1.5, disturbances=[])
    experiment = Experiment.of(chosen)
    simulation = experiment.simulate()
    again = estimate({name: registry.get(name)}, signals_of(simulation), experiment.known)[name]
    silent = Experiment.of(chosen.model_copy(update={"feedback": "none"})).simulate()
    assert simulation.command.tobytes() != silent.command.tobytes(), "nothing was fed back"
    # The drive's law with this estimate gives the very commands that were given.
    assert commanded(experiment, simulation, again.mean).tobytes() == simulation.command.tobytes()


def commanded(experiment: Experiment, simulation, torque: np.ndarray) -> np.ndarray:
    """Current commands [A], shape (n,), of the drive's law on recorded readings with a torque estimate, shape (n,)."""
    from flexspline.models.controller import control
    from flexspline.sim.loop import CONTROL_PERIOD

    p = experiment.record[0]
    c = experiment.scenario.controller.record(p, CONTROL_PERIOD, True)[0]
    motor, drive = simulation.readings["motor_position"], np.zeros(3)
    drive[0] = c["gear"] * experiment.command[0]
    dt = round(CONTROL_PERIOD / experiment.scenario.timestep) * experiment.scenario.timestep
    found = np.zeros(len(torque))
    for k in range(len(torque)):
        found[k] = control(experiment.command[k], experiment.rate[k], motor[k], torque[k], drive, dt, c)
    return found


def test_one_that_looks_ahead_is_not_fed_back():
    (smoother,) = [name for name in registry.names() if name == "rts_smoother"]
    with pytest.raises(ValueError, match="feedback: expected a filter that can run in the loop, got 'rts_smoother'"):
        scenario(filters=["EKF", smoother], feedback=smoother)


_TWO_AT_ONCE = """
import sys, threading
from flexspline.scenarios.run import run_scenario
from flexspline.scenarios.scenario import load_scenario

ready, found = threading.Barrier(2), {}

def one(i):
    chosen, folder = load_scenario("link_sweep", ["duration=1.5", "feedback=RAREKF"])
    ready.wait()
    run = run_scenario(chosen, folder)
    found[i] = run.simulation.truth.tobytes() + run.estimate("RAREKF").tobytes()

threads = [threading.Thread(target=one, args=(i,)) for i in range(2)]
for thread in threads: thread.start()
for thread in threads: thread.join()
sys.exit(0 if len(found) == 2 and found[0] == found[1] else 1)
"""


def test_two_threads_may_make_the_first_simulation_at_once():
    """In a fresh process: callbacks are installed once, code is loaded or compiled once, both get the same bits."""
    done = subprocess.run([sys.executable, "-c", _TWO_AT_ONCE], capture_output=True, text=True, timeout=600)
    assert done.returncode == 0, done.stderr


def test_models_are_built_side_by_side():
    """Threads that build and step their own models at once get what one thread gets."""
    chosen = [scenario(duration=1.5, transient=0.5, disturbances=[], seed=seed) for seed in range(6)]
    alone = [signals(run_scenario(one)) for one in chosen]
    with ThreadPoolExecutor(3) as pool:
        assert [signals(run) for run in pool.map(run_scenario, chosen)] == alone


def test_changing_one_sensor_leaves_the_others_noise_to_the_bit():
    """Sensors outside the loop: torque, current and wrench noise differ, encoders and truth do not by a bit."""
    a = run_scenario(scenario())
    changes = {"joint_torque": {"noise": 0.5, "rate": 500}, "wrench": {"force_noise": 2.0}}
    b = run_scenario(scenario(sensors=changes))
    assert a.simulation.truth.tobytes() == b.simulation.truth.tobytes()
    for name in ("motor_position", "link_position", "motor_current", "torque_x", "torque_y"):
        assert a.reading(name).tobytes() == b.reading(name).tobytes(), name
    assert a.reading("joint_torque").tobytes() != b.reading("joint_torque").tobytes()
    ratio = np.std(b.reading("joint_torque") - b.truth("joint_torque")) / np.std(
        a.reading("joint_torque") - a.truth("joint_torque")
    )
    assert ratio == pytest.approx(0.5 / 0.03, rel=0.1)


def test_readings_are_the_truth_within_their_noise():
    run = run_scenario(scenario())
    assert np.abs(run.reading("motor_position") - run.truth("motor_position")).max() <= np.pi / 4096 + 1e-9
    assert np.std(run.reading("link_position") - run.truth("link_position")) == pytest.approx(
        np.hypot(1.5e-6, 2 * np.pi / 2**20 / np.sqrt(12)), rel=0.1
    )
    assert np.std(run.reading("motor_current") - run.truth("motor_current")) == pytest.approx(0.01, rel=0.05)
    assert np.std(run.reading("joint_torque") - run.truth("joint_torque")) == pytest.approx(0.03, rel=0.05)
    assert np.std(-run.reading("torque_y") - run.truth("joint_torque")) == pytest.approx(0.03, rel=0.1)
    assert run.reading("force_x").std() > 0


@pytest.mark.parametrize(
    ("name", "values"),
    [("hard_stop", {"angle": 0.1, "stiffness": 30.0}), ("cable_spring", {"stiffness": 5.0, "rest_angle": 0.5})],
)
def test_wrench_is_the_joint_torque_also_where_something_holds_the_link(tmp_path, name, values):
    """A stop and a cable act on the link, behind the sensor: its torque about the axis stays Ts."""
    effect = Effect(name=name, parameters={k: Estimate(value=v) for k, v in values.items()})
    joint = load_joint("test-joint").model_copy(update={"effects": [effect]})
    joint.write(tmp_path / "joint.yaml")
    run = run_scenario(scenario(joint=str(tmp_path / "joint.yaml"), sensors={"wrench": {"torque_noise": 0.0}}))
    error = -run.reading("torque_y") - run.truth("joint_torque")
    assert np.sqrt(np.mean(error[100:] ** 2)) < 0.01 * run.truth("joint_torque").std()


def test_delay_and_rate_in_the_loop():
    """A link encoder 5 ms late at 250 Hz: the reading is the truth 5 ms before its last sample."""
    run = run_scenario(
        scenario(sensors={"link_encoder": {"noise": 0.0, "bits": 30, "delay": 0.005, "rate": 250}}, feedback="none")
    )
    truth, k = run.truth("link_position"), np.arange(len(run.time))
    expected = truth[np.maximum(k // 4 * 4 - 5, 0)]
    np.testing.assert_allclose(run.reading("link_position"), expected, atol=2 * np.pi / 2**30)


def test_motion_that_is_not_finite_is_an_error(tmp_path, monkeypatch):
    """4000 N·m at once drive the wave generator beyond its compliance, Eq. (5): one line with the time, no other litter."""
    monkeypatch.chdir(tmp_path)
    with pytest.raises(InputError) as caught:
        run_scenario(scenario(disturbances=[{"kind": "step", "start": 1.0, "duration": 1.0, "torque": 4000.0}]))
    message = str(caught.value)
    print(message)
    assert "scenario short" in message and "1.0" in message and "finite" in message
    assert "\n" not in message
    assert list(tmp_path.iterdir()) == []  # MuJoCo would write MUJOCO_LOG.TXT


def test_current_stays_within_its_limit():
    far = [{"time": 0.3, "position": 0.0}, {"time": 0.5, "position": 1.5}]
    run = run_scenario(scenario(mounting="no_load", trajectory=far, disturbances=[]))
    assert np.abs(run.simulation.command).max() == pytest.approx(3.3)
    assert np.abs(run.truth("motor_current")).max() <= 3.3 + 1e-9


@pytest.mark.parametrize("timestep", [0.001, 0.0005, 0.0001])
def test_timestep_is_a_detail(timestep):
    """Without the encoders' counts in the loop the torque hardly depends on the step."""
    fine = {"motor_encoder": {"bits": 32}}
    a = run_scenario(scenario(sensors=fine))
    b = run_scenario(scenario(sensors=fine, timestep=timestep))
    difference = np.sqrt(np.mean((a.truth("joint_torque") - b.truth("joint_torque")) ** 2))
    assert difference < (0.3 if timestep == 0.001 else 0.05) * a.truth("joint_torque").std()


def test_printed_equation_23_ends_in_a_clear_error(tmp_path):
    """Eq. (23) as printed: α = kω² is zero at zero load, f_α infinite. Filter, time and reason, not NaN."""
    printed = [{"name": "printed", "rule": "rarekf", "alpha": "printed"}]
    # Without noise, and without a kinematic error that winds the joint at rest, the first estimates are exactly zero.
    joint = load_joint("test-joint").model_copy(update={"kinematic_error": []})
    joint.write(tmp_path / "joint.yaml")
    with pytest.raises(FilterDiverged) as caught:
        run_scenario(
            scenario(filters=printed, joint=str(tmp_path / "joint.yaml"), sensors={"link_encoder": {"noise": 0.0}})
        )
    message = str(caught.value)
    print(message)
    assert "\n" not in message
    assert "printed" in message
    assert 0 < caught.value.time < 1.0


def test_printed_equation_23_with_noise():
    """With the encoder's noise no estimate is exactly zero: f_α is huge near zero load, the gain one: no filter."""
    printed = {"name": "printed", "rule": "rarekf", "alpha": "printed"}
    filters = [printed, {"name": "RAREKF", "rule": "rarekf"}]
    run = run_scenario(scenario(mounting="no_load", disturbances=[], filters=filters))
    assert np.isfinite(run.estimate("printed")).all()
    assert run.estimates["printed"].robust[500:].mean() > 0.9 > 0.2 > run.estimates["RAREKF"].robust[500:].mean()
    raw = np.std(np.diff(run.model_torque))
    assert np.std(np.diff(run.estimate("printed"))) > 0.9 * raw
    assert np.std(np.diff(run.estimate("RAREKF"))) < 0.5 * raw


def test_feedback_buys_position_during_pushes():
    """Joint torque feedback by the RAREKF: at least 20 % less RMS position error while something pushes."""
    errors = {}
    for feedback in ("none", "RAREKF", "sensor"):
        chosen, folder = load_scenario("torque_feedback", [f"feedback={feedback}"])
        run = run_scenario(chosen, folder)
        pushed = np.convolve(run.external_torque != 0, np.ones(300), mode="full")[: len(run.time)] > 0
        error = (run.position_command - run.truth("link_position"))[pushed]
        errors[feedback] = float(np.sqrt(np.mean(error**2)))
    print(
        {name: f"{1e3 * value:.3f} mrad" for name, value in errors.items()},
        f"{1 - errors['RAREKF'] / errors['none']:.0%} less",
    )
    assert errors["RAREKF"] < 0.8 * errors["none"]
    assert errors["RAREKF"] == pytest.approx(errors["sensor"], rel=0.3)


@pytest.mark.parametrize("name", sorted(shipped_scenarios()))
def test_shipped_scenarios_begin(name):
    """Each shipped scenario, its first 3 s."""
    chosen, folder = load_scenario(name, ["duration=3"])
    run = run_scenario(chosen, folder)
    assert len(run.time) == 3000
    assert all(np.isfinite(run.truth(name)).all() for name in run.simulation.truth.dtype.names)
    assert all(np.isfinite(found.mean).all() for found in run.estimates.values())
    assert run.metrics["scenario"] == name


def test_hysteresis_loop_is_drawn():
    """The locked rotor: a torsion of 1.5 mrad at 15 N·m, and a loop."""
    chosen, folder = load_scenario("hysteresis_loop")
    run = run_scenario(chosen, folder)
    assert np.ptp(run.truth("motor_position")) < 1e-3
    load, link = run.truth("joint_torque"), run.truth("link_position")
    assert np.abs(load).max() == pytest.approx(15, rel=0.02)
    # torsion at 15 N·m: flexspline, and the wave generator which gives way by Eq. (5) at what friction lets through
    assert 1.4e-3 < np.abs(link).max() < 2.5e-3
    near = (np.abs(load) < 0.3) & (run.time > 15)
    rising = np.gradient(load) > 0
    assert abs(link[near & ~rising].mean() - link[near & rising].mean()) > 1e-4
