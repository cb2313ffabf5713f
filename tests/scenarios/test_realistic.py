"""`sensors: realistic`: one line makes sensors, clock and drive what they are, in the loop, afterwards and on disk."""

from __future__ import annotations

import numpy as np
import pytest

from flexspline.estimator import registry
from flexspline.models.controller import Controller
from flexspline.models.errors import InputError
from flexspline.scenarios.evaluation.draws import varied
from flexspline.scenarios.experiment import Experiment, signals_of
from flexspline.scenarios.run import run_scenario
from flexspline.scenarios.run_folder import load_run, save_run
from flexspline.scenarios.scenario import load_scenario
from flexspline.sim.loop import CONTROL_PERIOD

PUSH = "disturbances=[{kind: push, start: 0.5, duration: 0.3, torque: 5}]"


def realistic(*more: str):
    return load_scenario("link_sweep", ["sensors=realistic", "duration=1.5", PUSH, *more])


def test_one_line_sets_all_of_it():
    chosen, folder = realistic()
    assert (chosen.current, chosen.jitter, chosen.controller.delay) == ("sensor", 1e-4, 2e-3)
    sensors = chosen.load_joint(folder)[0].sensors
    assert (
        sensors.motor_encoder.cyclic_error == 0.2
        and sensors.motor_current.step > 0.0
        and sensors.wrench.crosstalk == 0.01
    )
    assert sensors.motor_current.ripple.amplitude > 0.0 and sensors.motor_current.noise == 0.01
    own, _ = realistic("jitter=0", "current=command", "controller.delay=0.001")
    assert (own.current, own.jitter, own.controller.delay, own.controller.kp) == ("command", 0.0, 1e-3, Controller().kp)
    with pytest.raises(InputError, match="sensors"):
        load_scenario("link_sweep", ["sensors=real"])


@pytest.mark.parametrize("name", ["test-joint", "csg-14-100-ec45"])
def test_a_sensor_can_be_changed_as_well(name):
    """The change, and all that is realistic; a resolution in bits replaces the joint's counts."""
    (plain, folder), (own, _) = (
        realistic(f"joint={name}", *more)
        for more in ((), ("sensors.joint_torque.noise=1", "sensors.motor_encoder.bits=12"))
    )
    before, after = (chosen.load_joint(folder)[0].sensors.model_dump() for chosen in (plain, own))
    assert after["joint_torque"]["noise"] == 1.0 and after["motor_encoder"]["bits"] == 12
    assert after["motor_encoder"]["counts"] is None
    for sensor, key in (("joint_torque", "noise"), ("motor_encoder", "bits"), ("motor_encoder", "counts")):
        del before[sensor][key], after[sensor][key]
    assert before == after
    assert (plain.current, plain.jitter, plain.controller) == (own.current, own.jitter, own.controller)
    assert varied(own, 3).controller == varied(plain, 3).controller != plain.controller
    with pytest.raises(InputError, match="realistic"):
        load_scenario("link_sweep", ["sensors={realistic: 3}"])[0].load_joint(folder)


def test_estimators_read_the_current_sensor_at_the_time_stamps():
    run = run_scenario(*realistic())
    signals = run.signals
    assert "current_command" not in signals and not np.array_equal(signals.time, run.time)
    assert np.abs(signals.time - run.time).max() < 0.5e-3
    step = run.joint.sensors.motor_current.step
    np.testing.assert_allclose(signals["motor_current"] / step, np.round(signals["motor_current"] / step), atol=1e-6)
    # At 0.4 m, a push of 5 N·m is a force of 12.5 N.
    assert np.ptp(run.reading("force_x")) > 12.0


@pytest.mark.parametrize("name", ["RAREKF", "augmented", "momentum"])
def test_what_feeds_back_says_the_same_afterwards(name):
    chosen, folder = realistic(f"filters=[{name}]", f"feedback={name}")
    experiment = Experiment.of(chosen, folder)
    simulation = experiment.simulate()
    found = registry.get(name).estimate(signals_of(simulation), experiment.known)
    from flexspline.models.controller import control

    c = chosen.controller.record(experiment.record[0], CONTROL_PERIOD, True)[0]
    state = np.array([c["gear"] * experiment.command[0], 0.0, 0.0])
    motor = simulation.readings["motor_position"]
    expected = [
        control(experiment.command[k], experiment.rate[k], motor[k], found.mean[k], state, CONTROL_PERIOD, c)
        for k in range(len(motor))
    ]
    assert np.array_equal(expected, simulation.command)


def test_a_run_folder_keeps_it(tmp_path):
    run = run_scenario(*realistic("filters=[RAREKF]"))
    back = load_run(save_run(run, tmp_path / "run"))
    assert back.signals.time.tobytes() == run.signals.time.tobytes() and set(back.signals) == set(run.signals)
    again = registry.get("RAREKF").estimate(back.signals, back.known)
    np.testing.assert_array_equal(again.mean, run.estimate("RAREKF"))


def test_a_draw_has_a_lag_of_its_own():
    chosen, _ = realistic()
    lags = [varied(chosen, seed).controller.delay for seed in range(20)]
    assert len(set(lags)) == 20 and 0 <= min(lags) < 1e-3 and 3e-3 < max(lags) <= 4e-3
    plain, _ = load_scenario("link_sweep")
    assert varied(plain, 1).controller == plain.controller
    for stated in ("controller.kp=0.5", "controller.delay=0.001"):
        own, _ = realistic(stated)
        assert varied(own, 1).controller == own.controller, "what is stated holds"
