"""Logs at 25 to 1000 Hz, friction and load not as described: no claim in sound ones, and each mistake is named."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow.parquet
import pytest
from swing import recording
from typer.testing import CliRunner

from benchmarks.mistakes import unseen_load, wide, wide_mistakes
from flexspline import commands
from flexspline.diagnosis.data.mistakes import find_mistakes
from flexspline.models.joint import load_joint
from flexspline.models.recording import Measurement, read_measurement, write_recording

JOINT = load_joint("test-joint")
KINDS = {label: (name, spoil) for label, name, spoil in wide_mistakes()}
NAMED = [
    "no gravity", "effort is a current", "angle of 16 bits", "angle of 32 bits", "drive of 16 bits", "whole turns",
    "without sign", "time reversed", "mA", "drive turned round", "half a turn", "degrees",
]  # fmt: skip


def measurement(r) -> Measurement:
    return Measurement("m", Path(), (r,))


@pytest.mark.parametrize("seed", range(3000, 3012))
def test_nothing_is_claimed_of_a_sound_log(seed):
    log, joint = wide(seed)
    print(log.name)
    assert [m for m in find_mistakes(log, joint) if m.confidence > 0.5] == []


@pytest.mark.slow
def test_a_load_that_nothing_measures_is_no_mistake_in_the_log():
    """Nearly a third had one above 0.5: a velocity, another unit of both angles, a drive turned round."""
    claimed = []
    for seed in range(3300, 3330):
        log, joint = wide(seed)
        found = find_mistakes(unseen_load(log, joint, np.random.default_rng(seed)), joint)
        claimed += [(log.name, m) for m in found if m.confidence > 0.5]
    assert len({name for name, _ in claimed}) <= 1, claimed


@pytest.mark.parametrize("label", NAMED)
def test_a_hidden_mistake_is_named_at_any_rate(label):
    name, spoil = KINDS[label]
    rng, tried, named = np.random.default_rng(5), 0, []
    for seed in range(3100, 3160):
        log, joint = wide(seed)
        made = spoil(log.recordings[0], joint, rng)
        if made is None or "slips" in log.name:
            continue
        found = [m for m in find_mistakes(replace(log, recordings=(made[0],)), joint) if m.confidence > 0.5]
        columns = {c for m in found if m.name == name or m.column == "gravity_angle" for c in (m.column, *m.also)}
        named.append(bool(columns) and (not made[1] or made[1] in columns))
        tried += 1
        if not named[-1]:
            print(log.name, found)
        if tried == 5:
            break
    assert tried and sum(named) >= 0.6 * tried, (label, named)


def test_a_torque_of_unknown_scale_is_a_question():
    """Per mille of a rated current, logged as a current, is no known unit: it was "N·m at the output" or "mA" at 1."""
    rng, wrong = np.random.default_rng(17), []
    for seed in range(3400, 3430):
        log, joint = wide(seed)
        (r,) = log.recordings
        if "motor_current" not in r or "joint_torque" in r or "motor_torque" in r:
            continue
        scale = 1000 / (joint.numbers["current_limit"].value * rng.uniform(0.2, 1.0))
        columns = {**r.columns, "motor_current": np.round(scale * r["motor_current"])}
        found = find_mistakes(replace(log, recordings=(replace(r, columns=columns),)), joint)
        units = [m for m in found if m.name == "unit" and m.column == "motor_current" and m.confidence > 0.5]
        found = [(log.name, m.description, m.factor * scale) for m in units]
        wrong += [one for one in found if not 0.4 < one[2] < 2.5]  # a load may be off by 2
    assert len(wrong) <= 1, wrong


@pytest.mark.slow
def test_a_load_of_another_inertia_is_no_claim_of_a_wrong_clock():
    """One encoder does not tell them apart, unless the inertia is less than the rotor's. Both are listed."""
    label = "clock × 0.5"
    rng, listed = np.random.default_rng(5), []
    for seed in range(3200, 3225):
        log, joint = wide(seed)
        (r,) = log.recordings
        heavy = replace(r, link=r.link.model_copy(update={"inertia": r.link.inertia * float(rng.uniform(3, 8))}))
        claimed = [m for m in find_mistakes(replace(log, recordings=(heavy,)), joint) if m.confidence > 0.5]
        print(log.name, claimed)
        assert all(m.name == "load" and m.description.startswith("inertia") for m in claimed)
        made = KINDS[label][1](r, joint, rng)
        if made is not None and "slips" not in log.name:
            found = find_mistakes(replace(log, recordings=(made[0],)), joint)
            listed.append(any((m.name, m.column) == ("unit", "time") for m in found))
    assert len(listed) > 5 and sum(listed) >= 0.6 * len(listed)


def test_effort_without_gravity_is_a_question_and_no_angle():
    r = recording()
    p = JOINT.record(r.link)[0]
    held = p["Mg"] * np.sin(r["link_position"]) / (p["N"] * p["Kt"])
    columns = {"link_position": r["link_position"], "motor_current": r["motor_current"] - held}
    (found,) = find_mistakes(measurement(replace(r, columns=columns)), JOINT)
    assert (found.name, found.column) == ("no_gravity", "motor_current") and found.severe and not found.sure
    assert found.confidence > 0.9 and "?" in found.description


def test_an_effort_that_is_a_current_becomes_one():
    r = recording()
    columns = {"link_position": r["link_position"], "joint_torque": r["motor_current"]}
    (found,) = find_mistakes(measurement(replace(r, columns=columns)), JOINT)
    assert (found.name, found.column, found.becomes) == ("unit", "joint_torque", "motor_current") and found.sure
    assert found.factor == pytest.approx(6.03)


def test_a_signed_register_of_motor_counts_alone_is_unwrapped():
    """16 bits of 4096 counts a turn, ± 8 turns: "no mistakes" before."""
    rng, tried = np.random.default_rng(23), 0
    for seed in range(3500, 3560):
        log, joint = wide(seed)
        (r,) = log.recordings
        if "motor_position" not in r or np.ptp(r["motor_position"]) < 120.0:
            continue
        count = 2 * np.pi / 4096
        counts = np.round(r["motor_position"] / count) + rng.integers(-(2**15), 2**15)
        columns = {name: x for name, x in r.columns.items() if name not in ("link_position", "position_command")}
        columns["motor_position"] = count * ((counts + 2**15) % 2**16 - 2**15)
        if np.max(np.abs(np.diff(counts))) > 2**13 or np.ptp(columns["motor_position"]) < 0.95 * 2**16 * count:
            continue
        found = find_mistakes(replace(log, recordings=(replace(r, columns=columns),)), joint)
        wrapped = [m for m in found if m.name == "wrapped"]
        print(log.name, found)
        assert [m.column for m in wrapped] == ["motor_position"] and wrapped[0].factor == pytest.approx(2**16 * count)
        tried += 1
    assert tried > 3


def test_a_register_of_16_bits_is_signed_again(tmp_path):
    r = recording()
    count = 0.00269
    read = np.round(r["motor_current"] / count) % 65536 * count
    columns = {"link_position": r["link_position"], "motor_current": read}
    write_recording(replace(r, columns=columns), tmp_path / "in")
    result = CliRunner().invoke(commands.app, ["import", str(tmp_path / "in"), "--fix", "--out", str(tmp_path / "out")])
    assert result.exit_code == 0, result.output
    again = read_measurement(tmp_path / "out").recordings[0]
    np.testing.assert_allclose(again["motor_current"], r["motor_current"], atol=count)


def test_what_was_mended_is_in_yaml_table_and_reports(tmp_path):
    r = recording(seconds=6.0)
    columns = r.columns | {"motor_current": 1e3 * r["motor_current"]}
    write_recording(replace(r, columns=columns), tmp_path / "in")
    run = CliRunner().invoke
    assert run(commands.app, ["import", str(tmp_path / "in"), "--fix", "--out", str(tmp_path / "out")]).exit_code == 0
    assert "mA, logged as A" in (tmp_path / "out" / "swing.yaml").read_text(encoding="utf-8")
    assert (
        b"mA, logged as A"
        in pyarrow.parquet.read_schema(tmp_path / "out" / "swing.parquet").metadata[b"flexspline.fixed"]
    )
    (said,) = json.loads(run(commands.app, ["check", str(tmp_path / "out"), "--json"]).stdout)["fixed"]
    assert "motor_current" in said and "× 0.001" in said
    assert run(commands.app, ["validate", str(tmp_path / "out"), "--out", str(tmp_path / "v")]).exit_code == 0
    assert json.loads((tmp_path / "v" / "validation.json").read_text(encoding="utf-8"))["fixed"] == [said]
    # Twice is once.
    assert run(commands.app, ["import", str(tmp_path / "out"), "--fix", "--out", str(tmp_path / "more")]).exit_code == 0
    assert read_measurement(tmp_path / "more").fixed == read_measurement(tmp_path / "out").fixed


@pytest.mark.parametrize("rate", [30.0, 100.0])
def test_a_smooth_command_in_single_precision_has_no_glitch(rate):
    t = np.arange(0.0, 20.0, 1 / rate)
    s = np.clip((t % 5.0) / 1.2, 0.0, 1.0)
    command = 0.8 * np.where(t % 10 < 5, 1, -1) * (s**3 * (10 - 15 * s + 6 * s * s) - 0.5)
    r = recording(rate=rate, seconds=20.0)
    n = min(len(t), len(r.time))
    columns = {name: x[:n] for name, x in r.columns.items()} | {"position_command": np.float64(np.float32(command[:n]))}
    found = find_mistakes(measurement(replace(r, time=r.time[:n], columns=columns)), JOINT)
    assert not [m for m in found if m.name == "glitch"], found
