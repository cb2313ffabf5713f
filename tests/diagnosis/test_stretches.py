"""Of a long measurement a diagnosis takes what tells most, and no more than it has memory and time for."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from swing import recording

from flexspline.diagnosis.data.stretches import LONGEST, most_telling
from flexspline.diagnosis.diagnose import diagnose
from flexspline.models.joint import load_joint
from flexspline.models.recording import Measurement


def measurement(*recordings) -> Measurement:
    return Measurement("log", Path(), recordings)


def test_an_ordinary_measurement_is_taken_whole():
    data = measurement(recording("a"), recording("b"))
    assert most_telling(data) is data


def test_of_a_long_one_the_stretches_that_differ_are_taken():
    """Ten minutes at rest, but for one swing and a stretch under another load."""
    long = recording(rate=100.0, seconds=600.0)
    t, rest = long.time, {name: np.full(len(long.time), x[0]) for name, x in long.columns.items()}
    swings, loaded = (t > 200.0) & (t < 220.0), (t > 480.0) & (t < 490.0)
    columns = {name: np.where(swings, x, rest[name]) for name, x in long.columns.items()}
    columns["motor_current"] = columns["motor_current"] + 3.0 * loaded
    columns["joint_torque"] = columns["joint_torque"] + 30.0 * loaded
    (kept,) = most_telling(measurement(replace(long, columns=columns))).recordings
    lasts = sum(float(np.ptp(kept.time[part])) for part in kept.segments)
    assert LONGEST - 6.0 < lasts < LONGEST + 6.0
    for begin, end in ((200.0, 220.0), (480.0, 490.0)):
        assert np.sum((kept.time > begin) & (kept.time < end)) > 0.9 * 100.0 * (end - begin)
    assert kept.time[0] == 0.0  # its time counts from the recording's begin
    assert {name: len(x) for name, x in kept.columns.items()} == dict.fromkeys(kept.columns, len(kept.time))


def test_of_many_recordings_those_that_add_something_are_taken():
    same = [recording(f"swing{i}", rate=100.0, seconds=60.0, seed=i) for i in range(8)]
    warm = recording("warm", rate=100.0, seconds=60.0)
    warm = replace(warm, columns={**warm.columns, "temperature": np.full(len(warm.time), 60.0)})
    kept = most_telling(measurement(*same, warm)).recordings
    assert "warm" in {r.name for r in kept}
    assert sum(len(r.time) for r in kept) / 100.0 < LONGEST + 6.0


def test_a_segment_with_fewer_samples_than_pieces_is_used():
    long = recording(rate=100.0, seconds=5.0)
    slow = replace(long, time=long.time * 1000.0)
    (kept,) = most_telling(measurement(slow)).recordings
    assert 2 <= len(kept.time) < len(slow.time)


@pytest.mark.slow
def test_a_diagnosis_says_which_part_it_used():
    long = measurement(recording(rate=100.0, seconds=130.0))
    found = diagnose(long, load_joint("test-joint"), seconds=0.1)
    (said,) = [reason for reason in found.reasons if "with the most information" in reason]
    print(said)
    part, whole = map(float, re.findall(r"(\d+) s", said))
    assert LONGEST - 6.0 < part < LONGEST + 6.0 and whole == 130.0
