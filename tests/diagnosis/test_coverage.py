"""What a measurement can show at all: by its channels and its motion, before anything is fitted."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from swing import recording

from flexspline.diagnosis.data.coverage import balances, can_show, missing_columns, summarise, too_little, undetermined
from flexspline.models import causes
from flexspline.models.arm import Load
from flexspline.models.joint import load_joint
from flexspline.models.joint_parts import LOCKED, Mounting
from flexspline.models.recording import Measurement

JOINT = load_joint("test-joint")
TORSION = {"stiffness", "hysteresis", "backlash", "link_encoder_eccentricity", "encoder_delay"}
DRIVE = {"torque_constant", "viscous_friction", "mesh_friction", "cogging", "rotor_inertia"}


def measurement(*without: str, **columns: np.ndarray) -> Measurement:
    r = recording()
    r = replace(r, columns={**r.columns, **columns})
    return Measurement("m", Path(), (r.without(*without),))


@pytest.mark.parametrize("missing", ["motor_position", "link_position"])
def test_one_encoder_does_not_show_the_torsion_and_shows_all_else(missing):
    reasons = undetermined(measurement(missing), JOINT)
    for name in TORSION:
        assert "one encoder" in reasons[name]
        assert not can_show(name, measurement(missing), link_measured=False)
    assert not (DRIVE | {"gravity_moment", "link_inertia"}) & set(reasons)


def test_counts_may_hide_the_inertia_of_a_heavy_rotor():
    inertia = JOINT.numbers["Jm"]
    heavy = JOINT.model_copy(
        update={"numbers": {**JOINT.numbers, "Jm": inertia.model_copy(update={"value": 5 * inertia.value})}}
    )
    assert "rotor_inertia" not in undetermined(measurement(), JOINT)
    assert "3.5 times the current's noise" in undetermined(measurement(), heavy)["rotor_inertia"]


MOTOR = {"torque_constant", "cogging", "rotor_inertia", "current_offset"}
FRICTION = {"viscous_friction", "mesh_friction", "friction_asymmetry", "load_dependent_friction", "back_driving"}


def test_without_current_what_is_the_motors_is_undetermined_and_friction_shows_in_what_it_winds_up():
    reasons = undetermined(measurement("motor_current"), JOINT)
    assert set(reasons) >= MOTOR and not (FRICTION | {"stiffness", "gravity_moment"}) & set(reasons)
    assert "motor current" in reasons["cogging"]


def test_with_one_encoder_and_no_current_friction_shows_nowhere():
    reasons = undetermined(measurement("motor_current", "link_position"), JOINT)
    assert set(reasons) >= MOTOR | FRICTION and "gravity_moment" not in reasons
    assert "motor current" in reasons["viscous_friction"]


def test_without_a_torque_sensor_its_causes_are_undetermined():
    reasons = undetermined(measurement("joint_torque"), JOINT)
    assert {"torque_sensor_gain", "torque_sensor_offset", "torque_sensor_drift"} <= set(reasons)
    assert "joint_torque" in reasons["torque_sensor_gain"]


def test_a_motion_one_way_shows_no_reversal():
    r = recording()
    forward = np.flatnonzero(r.time < 0.9)
    reasons = undetermined(Measurement("m", Path(), (r.at(forward),)), JOINT)
    assert reasons["hysteresis"] == "the motion never reverses"


def test_what_happens_within_a_gap_is_no_motion():
    """Forward strokes with the ways back left out: the jumps between them counted as reversals."""
    r = recording()
    forward = np.flatnonzero(np.gradient(r["motor_position"]) > 0)
    strokes = r.at(forward)
    assert strokes.gaps
    one = summarise(strokes, JOINT)
    assert one.reversals == 0 and one.backward < 0.02 * one.forward
    assert undetermined(Measurement("m", Path(), (strokes,)), JOINT)["hysteresis"] == "the motion never reverses"


def still() -> Measurement:
    """A measurement in which the controller holds the joint: encoders flicker by a count, the rest is noise."""
    rng = np.random.default_rng(7)
    r = recording()
    held = {name: np.full(len(r.time), values[2000]) for name, values in r.columns.items() if name != "time"}
    held["motor_position"] += 1.5e-3 * rng.integers(0, 2, len(r.time))
    held["motor_current"] += 0.01 * rng.standard_normal(len(r.time))
    return Measurement("m", Path(), (replace(r, columns={**r.columns, **held}),))


def test_nothing_shows_where_nothing_moves():
    reasons = undetermined(still(), JOINT)
    assert set(reasons) == set(causes.of(JOINT))
    assert reasons["link_inertia"] == reasons["current_offset"] == "nothing moves"
    both = replace(still(), recordings=(*still().recordings, *measurement().recordings))
    assert undetermined(both, JOINT).keys() <= undetermined(measurement(), JOINT).keys()  # one that moves is enough


def test_a_bolted_joint_that_is_wound_up_slowly_moves():
    r = recording()
    wound = 0.3 * np.sin(0.9 * r.time)
    r = replace(
        r,
        link=Mounting(inertia=LOCKED, gravity_moment=0.0),
        columns={**r.columns, "motor_position": wound, "link_position": 0 * wound},
    )
    assert too_little(Measurement("m", Path(), (r,)), JOINT) is None


def test_nothing_shows_in_fewer_samples_than_a_diagnosis_takes():
    r = recording()
    for samples in (3, 49, 200):  # 200 are 0.4 s
        reasons = undetermined(Measurement("m", Path(), (r.at(slice(1000, 1000 + samples)),)), JOINT)
        assert set(reasons) == set(causes.of(JOINT))
        assert reasons["link_inertia"] == "no part without gaps has 50 samples and 0.5 s"


def test_everything_shows_in_a_full_measurement_but_what_has_no_column():
    reasons = undetermined(measurement(temperature=np.full(7000, 25.0)), JOINT)
    assert set(reasons) <= {"arm_load", "friction_temperature", "hard_stop"}
    assert "no recording is of an arm" in reasons["arm_load"]
    assert "changes by 0 K" in reasons["friction_temperature"]
    assert set(reasons) <= set(causes.of(JOINT))


def test_balances_are_those_of_the_channels():
    assert [b.name for b in balances(measurement())] == ["motor_current", "joint_torque", "link_balance"]
    assert [b.name for b in balances(measurement("link_position"))] == ["motor_current", "joint_torque"]
    assert [b.name for b in balances(measurement("joint_torque", "motor_position"))] == ["motor_current"]
    assert "motor torque" in balances(measurement("motor_current", motor_torque=np.ones(7000)))[0].description
    assert "joint_torque" in missing_columns(measurement("joint_torque"))


def test_the_links_balance_is_not_formed_where_something_unmeasured_acts_on_the_link():
    """A push, or what the arm's other joints do; it is of the other recordings then, or of none."""
    quiet, still = measurement(), np.zeros(7000)
    (r,) = quiet.recordings
    for r2 in (
        replace(r, name="other", external="unmeasured"),
        replace(r, name="other", load=Load(still, still, still)),
    ):
        (link,) = (b for b in balances(replace(quiet, recordings=(r, r2))) if b.name == "link_balance")
        assert link.recordings == (r.name,)
        assert [b.name for b in balances(replace(quiet, recordings=(r2,)))] == ["motor_current", "joint_torque"]


def test_a_summary_is_in_numbers():
    s = summarise(recording(), JOINT)
    assert (s.samples, s.missing, s.gaps, s.late) == (7000, 0, (), 0.0)
    assert s.interval == pytest.approx(2e-3) and s.duration == pytest.approx(13.998)
    assert s.link_speed == pytest.approx(1.365, rel=0.02) and s.motor_speed == pytest.approx(136.5, rel=0.02)
    assert s.reversals >= 5 and s.load_measured and s.load[1] > 5.0
    one = summarise(recording().without("link_position"), JOINT)
    assert one.link_speed == pytest.approx(1.365, rel=0.02)
