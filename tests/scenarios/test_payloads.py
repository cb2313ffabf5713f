"""Payloads that the link picks up and puts down: torque, energy, recording, estimators."""

from __future__ import annotations

import numpy as np
import pytest
import yaml

import flexspline as fs
from flexspline.models.arm import CarriedMass, carrying
from flexspline.models.errors import InputError
from flexspline.models.files import parse
from flexspline.models.joint import load_joint
from flexspline.models.laws import flexible_inertia
from flexspline.models.parameters import GRAVITY
from flexspline.models.recording import read_recording, write_recording
from flexspline.scenarios.experiment import Experiment
from flexspline.scenarios.run import run_scenario
from flexspline.scenarios.run_folder import load_run, save_run
from flexspline.scenarios.scenario import Scenario

LINK = load_joint("test-joint").mount("link")
STILL = [{"time": 0, "position": 1.2}]
SWINGS = [{"time": 0.2 + 1.5 * k, "position": 0.8 * (-1) ** k} for k in range(5)]
MASS = {"start": 2.0, "end": 4.0, "mass": 2.0, "distance": 0.25, "angle": 0.3}


def scenario(trajectory=STILL, duration=6, payloads=(MASS,), **more):
    data = {"name": "pick", "duration": duration, "mounting": "link", "trajectory": list(trajectory),
            "filters": ["momentum"], "payloads": list(payloads)}  # fmt: skip
    return parse(data | more, Scenario, "here")


def test_torque_and_force_at_rest():
    """Mg·sin θ + m·g·d·sin(θ + angle) while the payload is carried; the sensor weighs m·g more."""
    run = run_scenario(scenario())
    angle, torque = run.truth("link_position"), run.truth("joint_torque")
    force = np.hypot(run.reading("force_x"), run.reading("force_z"))
    own = LINK.gravity_moment * np.sin(angle)
    payload = 2.0 * GRAVITY * 0.25 * np.sin(angle + 0.3)
    before, during, after = slice(1900, 2000), slice(3900, 4000), slice(5900, 6000)
    for when, expected in ((before, own), (during, own + payload), (after, own)):
        assert torque[when].mean() == pytest.approx(expected[when].mean(), abs=5e-3)
    assert force[during].mean() - force[before].mean() == pytest.approx(2.0 * GRAVITY, abs=0.2)


def test_energy_of_a_link_that_picks_up_in_motion():
    """Work of the joint = change of kinetic energy and height; a payload brings along its own when it is picked up."""
    run = run_scenario(scenario(SWINGS, payloads=[{**MASS, "start": 2.4, "end": None, "inertia": 0.075}]))
    angle, rate, torque = (run.truth(n) for n in ("link_position", "link_velocity", "joint_torque"))
    on = run.time >= 2.4
    assert abs(rate[2400]) > 0.5
    inertia = LINK.inertia + 0.2 * on
    height = -LINK.gravity_moment * np.cos(angle) - on * 2.0 * GRAVITY * 0.25 * np.cos(angle + 0.3)
    energy = 0.5 * inertia * rate**2 + height
    work = np.concatenate([[0.0], np.cumsum(0.5e-3 * (torque * rate)[1:] + 0.5e-3 * (torque * rate)[:-1])])
    balance = energy - work
    for part in (slice(0, 2400), slice(2401, None)):  # between two ticks, the torque jumps
        assert np.ptp(balance[part]) < 2e-3 * np.ptp(energy)
    brought = 0.5 * 0.2 * rate[2400] ** 2 - 2.0 * GRAVITY * 0.25 * np.cos(angle[2400] + 0.3)
    assert balance[2401] - balance[2399] == pytest.approx(brought, rel=2e-3)


def test_result_does_not_depend_on_the_ticks_at_a_time():
    experiment = Experiment.of(scenario(SWINGS, known_payloads=False))
    whole, loop = experiment.simulate(), experiment.closed_loop()
    while loop.done < len(whole.time):
        loop.advance(400)
    assert loop.simulation.truth.tobytes() == whole.truth.tobytes()


def test_payload_from_the_start_is_the_mounting_with_it():
    """At angle 0 of the link's mass, moment and inertia add up."""
    carried = run_scenario(scenario(SWINGS, payloads=[{"start": 0, "mass": 1.0, "distance": 0.3}]))
    link = {"inertia": LINK.inertia + 0.09, "gravity_moment": LINK.gravity_moment + 0.3 * GRAVITY}
    mounted = run_scenario(scenario(SWINGS, payloads=[], mounting="", link=link))
    for name in ("link_position", "joint_torque", "motor_current"):
        found, expected = carried.truth(name), mounted.truth(name)
        np.testing.assert_allclose(found, expected, atol=1e-9 * np.abs(expected).max())


def test_estimators_know_the_payload_or_not():
    external = {}
    for known in (True, False):
        run = run_scenario(scenario(SWINGS, known_payloads=known))
        external[known] = run.estimates["momentum"].external
    carried = (run.time >= 2.3) & (run.time < 4.0)
    rest = np.sqrt(np.mean(external[True][run.time < 2.0] ** 2))
    assert np.sqrt(np.mean(external[True][carried] ** 2)) < 1.5 * rest
    assert np.sqrt(np.mean(external[False][carried] ** 2)) > 5 * rest


def test_recording_states_known_payloads(tmp_path):
    run = run_scenario(scenario(SWINGS))
    save_run(run, tmp_path / "run")
    found = read_recording(tmp_path / "run" / "pick.parquet")
    assert found.payloads == (CarriedMass(**MASS),)
    carried = (found.time >= 2.0) & (found.time < 4.0)
    np.testing.assert_allclose(found.relative_inertia, 1 + carried * 2.0 * 0.25**2 / LINK.inertia)
    weight = -2.0 * GRAVITY * 0.25 * np.sin(found["link_position"] + 0.3)
    np.testing.assert_allclose(found.known_torque, carried * weight, atol=1e-12)
    np.testing.assert_array_equal(load_run(tmp_path / "run").signals["arm_torque"], found.torque_of_arm)
    unknown = run_scenario(scenario(SWINGS, known_payloads=False)).as_recording()
    write_recording(unknown, tmp_path)
    assert "payloads" not in yaml.safe_load((tmp_path / "pick.yaml").read_text())
    assert unknown.load is None


def test_validation_needs_the_payload(tmp_path):
    """The current is predicted as well as without a payload if it is known; if not, its weight is missing."""
    off = {}
    way = [*SWINGS, {"time": 9, "position": 0.5}]
    for name, more in (("none", {"payloads": []}), ("known", {}), ("unknown", {"known_payloads": False})):
        run = run_scenario(scenario(way, duration=10, **more))
        write_recording(run.as_recording().without("joint_torque"), tmp_path / name)
        off[name] = fs.validate(tmp_path / name, "test-joint").residual["motor_current"].rms
    assert off["known"] < 1.1 * off["none"]
    assert off["unknown"] > 5 * off["none"]


def test_flexible_part_keeps_its_inertia():
    record = load_joint("test-joint").record()
    record[0]["flexible_share"], record[0]["flexible_frequency"] = 0.3, 20.0
    assert flexible_inertia(carrying(record, [CarriedMass(**MASS)])[0]) == pytest.approx(flexible_inertia(record[0]))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"payloads": [{**MASS, "end": 1.0}]}, "payloads.0: end: expected a time after 2 s, got 1 s"),
        ({"payloads": [{"start": 1, "distance": 1}]}, "payloads.0.mass: missing"),
        ({"feedback": "momentum"}, "known_payloads: expected false, as the filter that is fed back, momentum"),
    ],
)
def test_a_wrong_payload_is_one_line(changes, message):
    with pytest.raises(InputError, match=message) as error:
        scenario(**changes)
    assert "\n" not in str(error.value)


def test_a_payload_after_the_end_is_noted():
    run = run_scenario(scenario(payloads=[{**MASS, "start": 9, "end": None}]))
    assert any("payloads.0 starts at 9 s" in note for note in run.notes)


def test_a_bound_with_payloads_is_refused(flexspline, tmp_path):
    """Its link has a constant load; it once ignored them."""
    data = {"name": "pick", "duration": 6, "trajectory": STILL, "payloads": [MASS]}
    (tmp_path / "pick.yaml").write_text(yaml.safe_dump(data), encoding="utf-8")
    code, _, error = flexspline("bound", tmp_path / "pick.yaml", "--seeds", 1, "--out", tmp_path / "out")
    assert code == 2 and "scenario pick: payloads: expected none" in error and error.count("\n") == 1
