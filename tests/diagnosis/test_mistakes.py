"""Mistakes in the data: each is named with what mends it, and none where there is none."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from swing import SEED, recording
from typer.testing import CliRunner

import flexspline
from benchmarks.mistakes import Hidden, cuts, examples, hidden_mistakes, hide
from flexspline import commands
from flexspline.diagnosis.data import time_offsets
from flexspline.diagnosis.data.mistakes import find_mistakes, mended
from flexspline.diagnosis.data.samples import jumps, parted
from flexspline.diagnosis.data.time_offsets import SETTINGS, late_columns
from flexspline.diagnosis.diagnose import diagnose
from flexspline.diagnosis.regression import contradictions, regressions
from flexspline.diagnosis.trials.draw import Challenge, draw
from flexspline.diagnosis.validate import validate
from flexspline.models.arm import ArmSpec
from flexspline.models.arm_dynamics import Arm
from flexspline.models.errors import InputError, InputWarning
from flexspline.models.joint import load_joint, shipped
from flexspline.models.joint_parts import LOCKED, Mounting
from flexspline.models.recording import Measurement, Recording, in_arm, read_measurement, write_recording

ALL = {h.label: h for h in hidden_mistakes()}
"""Mistakes by their labels."""


def measurement(*recordings: Recording) -> Measurement:
    return Measurement("m", Path(), recordings or (recording(),))


JOINT = load_joint("test-joint")
SAMPLE = [
    "unit motor_position degrees", "unit link_position counts", "unit motor_current mA",
    "unit motor_current N·m output", "unit link_position motor_position degrees",
    "unit link_position motor_position position_command degrees",
    "unit link_position motor_position position_command turns", "unit joint_torque mN·m", "unit time ms",
    "sign motor_position", "sign motor_current", "sign joint_torque", "gear_ratio 1.01", "gear_ratio 0.5", "swapped",
    "late link_position 50 ms", "late joint_torque 50 ms", "late motor_current 50 ms", "wrapped motor_position 0.0",
    "wrapped link_position", "velocity link_position", "velocity motor_position rpm", "angle_zero 1.57",
    "angle_zero 0.50", "stuck link_position 0.3", "stuck joint_torque 0.3", "stuck motor_current 1",
    "glitch motor_position 6.3 × 1", "glitch joint_torque 1 × 5", "clipped joint_torque 0.6",
]  # fmt: skip


@pytest.mark.parametrize("label", SAMPLE)
def test_a_hidden_mistake_is_named_and_mended(label):
    one: Hidden = ALL[label]
    sound = measurement()
    spoilt = hide(one, sound, JOINT, np.random.default_rng(SEED))
    found = find_mistakes(spoilt, JOINT)
    assert one.found(found), found
    assert one.alone(found), found
    if one.name in ("stuck", "clipped"):
        return
    again = mended(spoilt, JOINT, found)
    assert find_mistakes(again, JOINT) == ()
    if one.name in ("unit", "sign", "swapped", "wrapped"):
        for name, x in sound.recordings[0].columns.items():
            assert np.abs(again.recordings[0][name] - x).max() < 1e-3 * max(np.ptp(x), 1.0), name


def test_nothing_is_claimed_of_sound_data():
    for seed in range(3):
        r = recording(seed=seed)
        for fewer in (
            (),
            ("motor_position",),
            ("link_position",),
            ("joint_torque",),
            ("motor_current",),
            ("position_command",),
        ):
            assert find_mistakes(measurement(r.without(*fewer)), JOINT) == (), (seed, fewer)


@pytest.mark.parametrize("columns", [("motor_position",), ("link_position",), ("motor_position", "link_position")])
@pytest.mark.parametrize("name", ["exact/00", pytest.param("bare/00", marks=pytest.mark.slow)])
@pytest.mark.parametrize("alone", [0, 1, pytest.param(None, marks=pytest.mark.slow)], ids=["free", "push", "all"])
def test_counts_beside_a_current_are_those_of_the_described_encoder(shared, name, columns, alone):
    """Of half as many a turn the motion is twice as large and rests less: of that alone it was told, and sure; of both encoders a
    gear ratio of 256 to 1."""
    sound = read_measurement(shared / "data" / "examples" / name)
    joint = sound.load_joint(None)
    sensors = joint.sensors
    resolution = {"motor_position": sensors.motor_encoder.resolution, "link_position": sensors.link_encoder.resolution}
    recordings = []
    for r in sound.recordings if alone is None else [sound.recordings[alone]]:
        counted = {c: np.round(r[c] / resolution[c]) for c in columns}
        recordings.append(replace(r, columns={**counted, "motor_current": r["motor_current"]}))
    found = find_mistakes(replace(sound, recordings=tuple(recordings)), joint)
    assert {m.column for m in found} == set(columns) and all(m.name == "unit" for m in found), found
    for m in found:
        assert m.factor == pytest.approx(resolution[m.column]) and m.confidence > 0.5, found


@pytest.mark.parametrize(("name", "factor"), [("unit", np.pi / 180), ("sign", None)])
def test_an_angle_in_an_arm_that_moves(name, factor):
    """What the arm puts on the link was taken from the angle as it stood: a velocity at 1.00, by a sign."""
    joint = load_joint("ur3e-shoulder")
    t = 8e-3 * np.arange(4000)
    q, elbow = -1.2 + 0.9 * np.sin(0.7 * t), 0.9 * np.sin(1.1 * t)
    v, a = 0.63 * np.cos(0.7 * t), -0.441 * np.sin(0.7 * t)
    spec = ArmSpec(model="ur3e.xml", joint="shoulder_lift")

    def logged(position, time=t):
        r = Recording("r", time, {"link_position": position, "motor_current": current}, joint="ur3e-shoulder")
        return in_arm(r, spec, {"arm_elbow_position": elbow}, Path("r.yaml"), shipped(), None)

    link, load = Arm(spec, shipped()).of(t, q, {"elbow": elbow}, (slice(0, len(t)),))
    p = joint.record(link)[0]
    torque = link.gravity_moment * np.sin(q + link.gravity_angle) - load.torque + load.inertia * a
    rate = p["N"] * v
    friction = p["Fc"] * np.tanh(rate / p["vs"]) + (p["bw"] + p["bm"]) * rate
    current = (torque / p["N"] + (p["Jm"] + p["Jw"]) * p["N"] * a + friction) / p["Kt"]
    assert find_mistakes(measurement(logged(q)), joint) == ()
    spoilt = measurement(logged(-q if factor is None else q / factor))
    (found,) = find_mistakes(spoilt, joint)
    assert (found.name, found.column, found.factor) == (name, "link_position", factor) and found.confidence > 0.9
    (again,) = mended(spoilt, joint, (found,)).recordings
    np.testing.assert_allclose(again["link_position"], q, atol=1e-12)
    np.testing.assert_allclose(again.load.torque, load.torque, atol=1e-9)
    spoilt = measurement(logged(q, 1000 * t))  # in milliseconds accelerations are next to nothing
    (again,) = mended(spoilt, joint, find_mistakes(spoilt, joint)).recordings
    np.testing.assert_allclose(again.time, t, atol=1e-12)
    np.testing.assert_allclose(again.load.torque, load.torque, atol=1e-9)


@pytest.mark.slow
@pytest.mark.long
@pytest.mark.parametrize("seed", [5, 6])
def test_nothing_is_claimed_of_sound_data_that_are_cut_short(shared, seed):
    """A torque 160 ms late, turns for radians, a zero elsewhere, at up to 1.00: of 6 in 100 cuts out of the examples."""
    known = [(m, m.load_joint(None)) for m in examples(shared / "data" / "examples")]
    count = 90
    claims = [(m.name, found) for m, joint in cuts(known, count, seed) if (found := find_mistakes(m, joint))]
    print(f"seed {seed}", *claims, sep="\n")
    assert len(claims) <= 0.02 * count


def test_motion_in_one_direction_shows_no_time_offset():
    """Of one pass later is another angle; forth and back it is told."""
    r, late = recording(seconds=10.0), 40
    pushed = r["joint_torque"] + 4.0 * np.exp(-0.5 * ((r["link_position"] - 0.2) / 0.08) ** 2)
    r = replace(r, columns={**r.columns, "joint_torque": pushed})
    turn = int(np.argmax(r["link_position"])), int(np.argmin(r["link_position"]))
    one_way = r.at(slice(min(turn), max(turn)))
    assert find_mistakes(measurement(one_way), JOINT) == ()
    shifted = np.concatenate([np.full(late, r["joint_torque"][0]), r["joint_torque"][:-late]])
    (found,) = find_mistakes(measurement(replace(r, columns={**r.columns, "joint_torque": shifted})), JOINT)
    assert (found.name, found.column) == ("late", "joint_torque")
    assert found.seconds == pytest.approx(late * r.interval, rel=0.05)


@pytest.mark.parametrize(
    ("kept", "row"), [((0, 3000, 3400, 7000), 3000), ((0, 3000, 2800, 7000), 3000), ((0, 7000), None)]
)
def test_samples_that_are_missing_under_a_numbered_time_make_a_gap(kept, row):
    """As after a buffer overrun: a block left out, or there twice, was a current 36 ms late at 0.99."""
    r = recording()
    rows = np.concatenate([np.arange(a, b) for a, b in zip(kept[::2], kept[1::2], strict=True)])[: len(r.time)]
    cut = replace(r, time=r.time[: len(rows)], columns={name: x[rows] for name, x in r.columns.items()})
    found, said = parted(measurement(cut), JOINT)
    assert jumps(cut, JOINT).tolist() == ([] if row is None else [row])
    assert len(found.recordings[0].gaps) == len(said) == (row is not None)
    assert find_mistakes(found, JOINT) == ()
    # A sample of both that is far off is a glitch, and comes back.
    glitch = {
        n: np.where(np.arange(len(r.time)) == 2000, r[n] + far, r[n])
        for n, far in (("motor_position", 50.0), ("link_position", 0.5))
    }
    assert not len(jumps(replace(r, columns={**r.columns, **glitch}), JOINT))


@pytest.mark.parametrize("value", [0.0, 1.3])
def test_a_command_that_nobody_follows_is_stuck(value):
    """A drive in torque mode logs a command of 0: the encoders were said to be turned against it."""
    r = recording()
    still = replace(r, columns={**r.columns, "position_command": np.full(len(r.time), value)})
    (found,) = find_mistakes(measurement(still), JOINT)
    assert (found.name, found.column, found.severe) == ("stuck", "position_command", False)
    assert "position_command" not in mended(measurement(still), JOINT, (found,)).recordings[0]


@pytest.mark.parametrize(
    ("celsius", "told", "offset"),
    [(lambda t: t + 273.15, "kelvin", -273.15), (lambda t: 1.8 * t + 32, "Fahrenheit", -160 / 9)],
)
def test_a_temperature_that_is_none_in_celsius(celsius, told, offset):
    """In kelvin a friction that falls with the temperature was a drift, at 0.99."""
    r = recording()
    warm = np.linspace(60.0, 85.0, len(r.time))
    read = replace(r, columns={**r.columns, "temperature": celsius(warm)})
    (found,) = find_mistakes(measurement(read), JOINT)
    assert (found.name, found.column, found.severe) == ("unit", "temperature", True) and told in found.description
    assert found.to_json()["offset"] == pytest.approx(offset, rel=1e-5)
    np.testing.assert_allclose(mended(measurement(read), JOINT, (found,)).recordings[0]["temperature"], warm, atol=1e-9)
    assert find_mistakes(measurement(replace(r, columns={**r.columns, "temperature": warm})), JOINT) == ()


def test_an_encoder_is_late_only_where_the_other_one_says_so(monkeypatch):
    """What a base that shakes makes of both torques looked like the motor encoder 50 ms late, though both encoders agree."""
    shifts = SETTINGS.step * np.arange(-60, 61)

    def least_at(first: str, second: str, best: float) -> SimpleNamespace:
        return SimpleNamespace(
            first=first, second=second, left=20.0 * np.minimum(np.abs(shifts - best) / 0.02, 1.0), fits=shifts < 1
        )

    for between, late in ((0.0, False), (-0.05, True)):
        relations = [
            least_at("motor_position", "motor_current", -0.05), least_at("motor_position", "joint_torque", -0.05),
            least_at("motor_position", "link_position", between),
        ]  # fmt: skip
        monkeypatch.setattr(time_offsets, "_relations", lambda recording, joint, found=relations: found)
        found = [f.column for f, _ in late_columns((recording(),), JOINT)]
        assert found == (["motor_position"] if late else []), between


@pytest.mark.parametrize("share", [0.006, 0.03])
@pytest.mark.parametrize(
    ("column", "size"), [("motor_position", 2 * math.pi), ("link_position", 0.3), ("motor_current", 5.0)]
)
def test_glitches_are_found_however_many_they_are(column, size, share):
    """From one in 200 on no step was exceptional, and none was found."""
    r, rng = recording(), np.random.default_rng(SEED)
    rows = rng.choice(np.arange(20, len(r.time) - 20), round(share * len(r.time)), replace=False)
    x = r[column].copy()
    x[rows] += size * rng.choice((-1.0, 1.0), len(rows))
    (found,) = find_mistakes(measurement(replace(r, columns={**r.columns, column: x})), JOINT)
    assert (found.name, found.column) == ("glitch", column) and found.rows is not None
    assert len(set(found.rows) & set(rows.tolist())) > 0.95 * len(rows) and len(found.rows) < 1.05 * len(rows)


def test_all_angles_in_degrees_where_one_encoder_is_all_there_is():
    """A motion 57 times as large, to which the drive's current does not belong, was another zero of the angle."""
    degrees = ("link_position", "position_command")
    one = recording().without("motor_position").without("joint_torque")
    spoilt = replace(one, columns={**one.columns, **{n: np.rad2deg(one[n]) for n in degrees}})
    (found,) = find_mistakes(measurement(spoilt), JOINT)
    assert (found.name, found.column, found.also) == ("unit", "link_position", ("position_command",)) and found.sure
    assert found.factor == pytest.approx(math.pi / 180)


def test_a_current_of_one_direction_in_a_small_unit_has_not_lost_its_sign():
    """All of it was within the noise that is described in ampere."""
    r = recording()
    t = r.time - r.time[0]
    driven = replace(r, columns={**r.columns, "motor_current": 1e-3 * (1.5 - np.cos(2 * math.pi * t / t[-1]))})
    assert all(m.name != "sign" or not m.lost for m in find_mistakes(measurement(driven), JOINT))


def test_a_current_without_its_sign_is_lost():
    """An effect on the rotor that depends on load, at 0.95, of a sound joint."""
    r = recording()
    spoilt = measurement(replace(r, columns={**r.columns, "motor_current": np.abs(r["motor_current"])}))
    (found,) = find_mistakes(spoilt, JOINT)
    assert (found.name, found.column, found.severe, found.sure) == ("sign", "motor_current", True, False)
    np.testing.assert_array_equal(
        mended(spoilt, JOINT, (found,)).recordings[0]["motor_current"], np.abs(r["motor_current"])
    )
    answer = diagnose(spoilt, JOINT)
    assert answer.verdict == "inconclusive" and "the file cannot be corrected" in answer.reason
    # One that drives one way only is none.
    lifted = measurement(replace(r, columns={**r.columns, "motor_current": r["motor_current"] + 10.0}))
    assert all(m.description != found.description for m in find_mistakes(lifted, JOINT))


def test_a_link_encoder_late_by_an_ordinary_delay_is_a_cause_and_no_mistake():
    r = recording()
    for seconds in (4e-3, 11e-3):
        late = np.interp(r.time - seconds, r.time, r["link_position"])
        one = measurement(replace(r, columns={**r.columns, "link_position": late}))
        assert find_mistakes(one, JOINT) == ()


@pytest.mark.fast_every(3)
@pytest.mark.parametrize("joint", ["test-joint", "csg-17-80-ec60"])
@pytest.mark.parametrize("scenario", ["no_load", "link_sweep", "external_push"])
def test_nothing_is_claimed_of_a_shipped_experiment(scenario, joint):
    """A slow sweep one way, whose wind-up any shift explains nearly as well, and pushes that were measured."""
    run = flexspline.simulate(scenario, joint=joint)
    assert find_mistakes(measurement(run.as_recording()), load_joint(joint)) == ()


@pytest.mark.parametrize("column", ["motor_position", "link_position"])
def test_a_column_in_degrees_and_turned_round_is_both(column):
    """Neither alone mends anything: three other units were offered."""
    r = recording()
    (found,) = find_mistakes(measurement(replace(r, columns={**r.columns, column: -np.degrees(r[column])})), JOINT)
    assert (found.name, found.column, found.sure) == ("unit", column, True)
    assert found.factor == pytest.approx(-math.pi / 180)


@pytest.mark.parametrize("ratio", [0.5, 0.8, 1.2])
def test_another_gear_ratio_is_a_whole_number(ratio):
    """Torsion under gravity goes with the angle: 80.04 turns were told, and the mended data had an eccentricity at 0.97."""
    r = recording()
    columns = {**r.columns, "motor_position": ratio * r["motor_position"]}
    (found,) = find_mistakes(measurement(replace(r, columns=columns)), JOINT)
    assert (found.name, found.factor) == ("gear_ratio", pytest.approx(ratio, rel=1e-12))


def test_milliseconds_are_found_whatever_else_is_wrong():
    """With degrees beside them they were taken for seconds, and every interval for a gap."""
    r = recording()
    columns = {**r.columns, "link_position": np.degrees(r["link_position"])}
    found = find_mistakes(measurement(replace(r, time=1e3 * r.time, columns=columns)), JOINT)
    assert [(m.name, m.column) for m in found] == [("unit", "time"), ("unit", "link_position")]


def test_a_slow_log_is_no_log_in_milliseconds():
    r = recording()
    assert not [m for m in find_mistakes(measurement(r.at(slice(None, None, 1000))), JOINT) if m.column == "time"]


def test_a_link_that_is_described_wrongly_is_no_unit_of_the_angles():
    """In degrees a motion of 1.3 rad asks for next to no torque, which suits any log; only the link's balance is at odds."""
    hidden = draw(Challenge(seed=971, hidden="none", without=("joint_torque",)), 0)
    free = min(hidden.measurement.recordings, key=lambda r: r.link.gravity_moment)
    heavy = replace(free, link=Mounting(inertia=0.35, gravity_moment=9.0))
    for recordings in ((heavy,), tuple(heavy if r is free else r for r in hidden.measurement.recordings)):
        found = find_mistakes(measurement(*recordings), hidden.nominal)
        assert not [m for m in found if m.name == "unit" and m.sure], found


@pytest.mark.parametrize("joint", ["csg-14-100-ec45", "csg-32-160-ilm70"])
def test_a_load_that_is_described_wrongly_is_named(joint):
    """The best change was all angles in degrees."""
    turns = ((0.3, 0.0), (1.6, 0.9), (3.2, -0.9), (4.5, 0.6), (5.6, -0.4), (7.0, 0.3))
    moves = [{"time": t, "position": q} for t, q in turns]
    run = flexspline.simulate(
        "no_load", joint=joint, duration=7.5, trajectory=moves, mounting="link", filters=["model"]
    )
    r = run.as_recording().without("joint_torque")
    described = load_joint(joint)

    def said(inertia: float, moment: float) -> tuple[set[str], set[str]]:
        """Names of the mistakes, and the numbers of the load in their texts and in those of the regression."""
        link = {"inertia": inertia * r.link.inertia, "gravity_moment": moment * r.link.gravity_moment}
        one = measurement(replace(r, link=r.link.model_copy(update=link)))
        found = find_mistakes(one, described)
        text = " ".join([*(m.description for m in found), *contradictions(regressions(one, described), described)])
        return {m.name for m in found}, {number for number in ("inertia", "gravity") if number in text}

    assert said(1.0, 1.0) == (set(), set())
    assert said(100.0, 1.0) == ({"load"}, {"inertia"})
    assert said(100.0, 0.0) == ({"load"}, {"inertia", "gravity"})
    names, numbers = said(1.0, 0.0)
    assert names <= {"load"} and numbers == {"gravity"}


def test_a_stop_that_the_link_leans_on_is_no_zero_of_the_angle_elsewhere():
    """It pulls the best direction of gravity aside, by less than any mistake would."""
    hidden = draw(Challenge(seed=203, hidden="two", real=True), 5)
    assert "hard_stop" in [e.name for e in hidden.effects]
    assert find_mistakes(hidden.measurement, hidden.nominal) == ()


def test_a_mistake_in_one_recording_is_named_there():
    sound = measurement(recording("a"), recording("b", seed=1), recording("c", seed=2))
    spoilt = hide(ALL["sign motor_current"], sound, JOINT, np.random.default_rng(SEED), only=1)
    (found,) = find_mistakes(spoilt, JOINT)
    assert (found.name, found.column, found.recording) == ("sign", "motor_current", "b")
    assert find_mistakes(mended(spoilt, JOINT, [found]), JOINT) == ()


@pytest.mark.slow
def test_a_unit_is_that_of_every_recording_whose_channels_do_not_go_together():
    """In a slow one smaller torques look like nothing: two of three were mended, and the third was diagnosed at 0.95."""
    label = "unit motor_current N·m output"
    slow = draw(Challenge(seed=SEED, hidden="none"), 0)
    spoilt = hide(ALL[label], slow.measurement, slow.nominal, np.random.default_rng(SEED))
    found = find_mistakes(spoilt, slow.nominal)
    assert ALL[label].everywhere(found, spoilt) and ALL[label].alone(found), found
    one = hide(ALL[label], slow.measurement, slow.nominal, np.random.default_rng(SEED), only=2)
    found = find_mistakes(one, slow.nominal)
    assert [m.recording for m in found] == [one.recordings[2].name]


@pytest.mark.fast_every(2)
@pytest.mark.parametrize(("group", "number"), [("exact", 5), ("bare", 1)])
def test_a_unit_of_all_recordings_is_mended_in_all(shared, group, number):
    """One of three was mended, as friction explains a small current elsewhere, and what was written was called sound."""
    sound = read_measurement(shared / "data" / "examples" / group / f"{number:02d}")
    joint, label = sound.load_joint(None), "unit motor_current N·m"
    spoilt = hide(ALL[label], sound, joint, np.random.default_rng(SEED))
    found = find_mistakes(spoilt, joint)
    assert ALL[label].everywhere(found, spoilt) and ALL[label].alone(found), found
    one = hide(ALL[label], sound, joint, np.random.default_rng(SEED), only=2)
    assert [m.recording for m in find_mistakes(one, joint)] == [sound.recordings[2].name]


@pytest.mark.parametrize(("label", "number"), [("unit motor_current mA", 2), ("sign motor_current", 2)])
def test_a_command_that_a_stop_keeps_from_being_followed_leaves_no_doubt(shared, label, number):
    """The link leans on a hard stop: "no change makes the channels fit this joint", at 0.5, though its current's did."""
    sound = read_measurement(shared / "data" / "examples" / "bare" / f"{number:02d}")
    joint = sound.load_joint(None)
    found = find_mistakes(hide(ALL[label], sound, joint, np.random.default_rng(SEED)), joint)
    assert ALL[label].everywhere(found, sound) and ALL[label].alone(found) and all(m.sure for m in found), found


def test_a_velocity_in_an_encoders_place_does_not_make_the_other_one_stuck(shared):
    """At rest it has noise, by which the other encoder "should have moved": good rows were left out for it."""
    sound = read_measurement(shared / "data" / "examples" / "exact" / "00")
    spoilt = tuple(
        replace(r, columns={**r.columns, "link_position": np.gradient(r["link_position"], r.time)})
        for r in sound.recordings
    )
    found = find_mistakes(replace(sound, recordings=spoilt), sound.load_joint(None))
    assert [m.name for m in found] == ["velocity"], found


@pytest.mark.parametrize(("group", "number"), [("exact", 0), ("toleranced", 3)])
def test_what_clipped_samples_leave_is_no_reason_for_another_unit(shared, group, number):
    """Next to nothing but rest was left of one recording, where an angle in turns fits as well as one in radians."""
    sound = read_measurement(shared / "data" / "examples" / group / f"{number:02d}")
    joint, clipped = sound.load_joint(None), ALL["clipped motor_current 0.6"]
    found = find_mistakes(hide(clipped, sound, joint, np.random.default_rng(SEED)), joint)
    assert clipped.everywhere(found, sound) and clipped.alone(found), found


def bolted(seconds: float = 2.0) -> Recording:
    """The same joint on the bench, its output held."""
    r = recording("bench", seconds=seconds)
    columns = r.columns | {"link_position": np.full(len(r.time), 0.2)}
    return replace(r, columns=columns, link=Mounting(inertia=LOCKED, gravity_moment=0.0), external="unmeasured")


@pytest.mark.parametrize("label", ["unit motor_current mA", "glitch motor_position 6.3 × 1"])
def test_what_the_moving_recordings_have_is_not_mended_in_a_bolted_one(label):
    """Of which nothing was looked at: its current was made a thousandth, and rows that it does not have were bridged."""
    spoilt = hide(ALL[label], measurement(), JOINT, np.random.default_rng(SEED)).recordings[0]
    both = measurement(spoilt, bolted())
    found = find_mistakes(both, JOINT)
    assert [m.recording for m in found] == ["swing"]
    moving, bench = mended(both, JOINT, found).recordings
    assert find_mistakes(measurement(moving), JOINT) == ()
    for name, x in bolted().columns.items():
        np.testing.assert_array_equal(bench[name], x, err_msg=name)


def test_a_late_column_is_not_made_up_where_nothing_was_measured():
    """The last of a tenth of a second before a gap was a straight line through it."""
    sound = recording()
    spoilt = hide(ALL["late joint_torque 50 ms"], measurement(sound), JOINT, np.random.default_rng(SEED)).recordings[0]
    n = len(sound.time)
    kept = np.r_[0 : n // 2, n // 2 + 2000 : n]
    both = measurement(spoilt.at(kept))
    (found,) = find_mistakes(both, JOINT)
    assert found.name == "late" and found.column == "joint_torque"
    (again,) = mended(both, JOINT, [found]).recordings
    true = np.interp(again.time, sound.time, sound["joint_torque"])
    assert np.max(np.abs(again["joint_torque"] - true)) < 0.3
    assert len(again.segments) == 2 and len(kept) - len(again.time) < 70


@pytest.mark.fast_every(3)
@pytest.mark.parametrize(
    "label", ["late motor_position 20 ms", "late motor_position 50 ms", "late link_position 100 ms"]
)
@pytest.mark.parametrize("only", [None, 2])
def test_an_encoder_that_lags_behind_the_other_is_late_and_not_in_other_units(label, only):
    """Both in degrees are small, and so is what one lags behind: units were named before anything was known of time."""
    sound = draw(Challenge(seed=SEED, hidden="none", sensor=False), 0)
    spoilt = hide(ALL[label], sound.measurement, sound.nominal, np.random.default_rng(SEED), only=only)
    found = find_mistakes(spoilt, sound.nominal)
    assert found and all(m.name == "late" for m in found), found
    assert ALL[label].found(found), found


def test_rows_of_a_glitch_are_told():
    r = recording()
    x = r["link_position"].copy()
    x[[1000, 3000]] += 0.5
    (found,) = find_mistakes(measurement(replace(r, columns={**r.columns, "link_position": x})), JOINT)
    assert found.name == "glitch" and found.rows == (1000, 3000) and found.severe
    assert found.to_json()["rows"] == [1000, 3000]


@pytest.mark.parametrize(("column", "height"), [("motor_current", 1e5), ("joint_torque", 1.0)])
def test_of_a_column_that_is_nothing_of_the_joint_no_unit_is_sure(column, height):
    r = recording()
    square = height * np.sign(np.sin(np.pi * r.time + 0.1))
    found = find_mistakes(measurement(replace(r, columns={**r.columns, column: square})), JOINT)
    assert all(m.confidence <= 0.5 for m in found if m.name not in ("stuck", "glitch", "clipped")), found


def test_what_no_change_mends_is_not_mended(tmp_path):
    """A square wave where the motor's angle belongs: nobody is told to write it with another unit."""
    r = recording()
    square = 1e5 * np.sign(np.sin(np.pi * r.time + 0.1))
    write_recording(replace(r, columns={**r.columns, "motor_current": square}), tmp_path / "in")
    spoilt = str(tmp_path / "in")
    assert any(not m.sure and m.severe for m in find_mistakes(read_measurement(spoilt), JOINT))
    told = CliRunner().invoke(commands.app, ["estimate", spoilt, "--out", str(tmp_path / "estimates")])
    assert isinstance(told.exception, InputError)
    assert "the channels do not fit this joint" in str(told.exception) and "--fix" not in str(told.exception)
    told = CliRunner().invoke(commands.app, ["diagnose", spoilt, "--out", str(tmp_path / "diagnosis")])
    assert "the channels do not fit this joint" in " ".join(told.stdout.split()) and "--fix" not in told.stdout
    with pytest.warns(InputWarning, match="not corrected: the channels do not fit this joint"):
        told = CliRunner().invoke(commands.app, ["import", spoilt, "--fix", "--out", str(tmp_path / "mended")])
    assert "no mistake" not in told.stdout
    (written,) = read_measurement(tmp_path / "mended").recordings
    assert np.array_equal(written["motor_current"], square)


def test_check_says_it_and_import_mends_it(tmp_path):
    r = recording()
    write_recording(
        replace(r, columns={**r.columns, "motor_position": np.rad2deg(r["motor_position"])}), tmp_path / "in"
    )
    result = CliRunner().invoke(commands.app, ["check", str(tmp_path / "in"), "--json"])
    assert result.exit_code == 0, result.output
    report = json.loads(result.output)
    (told,) = report["mistakes"]
    assert told["name"] == "unit" and told["column"] == "motor_position"
    assert told["factor"] == pytest.approx(math.pi / 180, rel=1e-5)
    assert "stiffness" in report["can_show"] and "friction_temperature" in report["undetermined"]
    shown = CliRunner().invoke(commands.app, ["check", str(tmp_path / "in")])
    assert "degrees, logged as rad" in shown.output and "0.0174533" in shown.output
    arguments = ["import", str(tmp_path / "in"), "--fix", "--out", str(tmp_path / "out")]
    result = CliRunner().invoke(commands.app, arguments)
    assert result.exit_code == 0, result.output
    again = read_measurement(tmp_path / "out").recordings[0]
    np.testing.assert_allclose(again["motor_position"], r["motor_position"], rtol=1e-9, atol=1e-9)


def odd(r: Recording) -> dict[str, Recording]:
    """Recordings that people make, and that hold little."""

    def of(**columns: np.ndarray) -> Recording:
        return replace(r, columns={**r.columns, **columns})

    zero = np.zeros_like(r.time)
    slow = {f"{rate:g} Hz": r.at(slice(None, None, int(500 / rate))) for rate in (1, 2, 5, 10, 20)}
    return {
        "2 samples": r.at(slice(0, 2)), "5 samples": r.at(slice(0, 5)), "40 samples": r.at(slice(0, 40)), **slow,
        "all zero": of(**dict.fromkeys(r.columns, zero)), "motor zero": of(motor_position=zero),
        "current alone": of(link_position=zero, motor_position=zero), "constant": of(**dict.fromkeys(r.columns, zero + 3)),
        "huge": of(joint_torque=1e5 * np.sign(r["joint_torque"])), "vast": of(link_position=1e29 * r["link_position"]),
        "one encoder, zero": r.without("link_position", "position_command", "joint_torque").at(slice(0, 100)),
        "gaps": r.at(np.arange(len(r.time)) % 500 < 30),
    }  # fmt: skip


@pytest.mark.filterwarnings("error::RuntimeWarning")  # nothing but lines of ours is printed
@pytest.mark.parametrize("name", odd(recording()))
def test_odd_recordings_are_no_reason_to_break(name, tmp_path):
    r = odd(recording())[name]
    found = find_mistakes(measurement(r), JOINT)
    if name in ("all zero", "motor zero"):
        assert "stuck" in {m.name for m in found}
    write_recording(r, tmp_path / "in")
    result = CliRunner().invoke(commands.app, ["check", str(tmp_path / "in")])
    assert result.exception is None or (isinstance(result.exception, InputError) and "\n" not in str(result.exception))


@pytest.mark.parametrize(
    "label", ["unit motor_position turns", "late motor_current 50 ms", "sign of gravity", "gear_ratio 1.01"]
)
def test_mistakes_in_shared_examples(shared, label):
    sound = read_measurement(shared / "data" / "examples" / "bare" / "01")
    assert find_mistakes(sound, JOINT) == ()
    assert ALL[label].found(find_mistakes(hide(ALL[label], sound, JOINT, np.random.default_rng(SEED)), JOINT))


@pytest.mark.parametrize("column", ["motor_current", "joint_torque"])
def test_samples_at_a_limit_are_left_out(column):
    """A drive that saturates, or a sensor's range: it costs these samples, and not the recording."""
    r = recording()
    limit = 0.85 * np.abs(r[column]).max()
    spoilt = replace(r, columns={**r.columns, column: np.clip(r[column], -limit, limit)})
    before, after = (validate(measurement(one), JOINT) for one in (r, spoilt))
    assert [(m.name, m.severe) for m in after.mistakes] == [("clipped", False)]
    left = 1 - len(after.recordings[0].time) / len(r.time)
    print(
        f"seed {SEED}: {100 * left:.1f} % left out; {before.residual[column].rms:.4g}, {after.residual[column].rms:.4g}"
    )
    assert 0.05 < left < 0.5
    assert after.residual[column].rms == pytest.approx(before.residual[column].rms, rel=0.2)
    with pytest.warns(InputWarning, match="beyond which nothing is read"):
        estimated = flexspline.estimate(spoilt, JOINT, estimators=["current"])
    assert len(estimated) == len(after.recordings[0].time)


def test_bursts_far_apart_are_looked_at():
    """A log of short bursts: the time between them is no part of its motion."""
    r = recording()
    rows = np.flatnonzero(r.time % 2.0 < 1.0)
    bursts = r.at(rows, r.time[rows] + 600.0 * np.floor(r.time[rows] / 2.0))
    assert find_mistakes(measurement(bursts), JOINT) == ()
    milli = replace(bursts, columns={**bursts.columns, "motor_current": 1e3 * bursts["motor_current"]})
    assert [(m.name, m.column) for m in find_mistakes(measurement(milli), JOINT)] == [("unit", "motor_current")]
