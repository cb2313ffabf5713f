"""Recordings of one measurement that do not belong together: nothing is sure, and the reason is reported."""

from __future__ import annotations

import re
from dataclasses import replace

import pytest

from flexspline.diagnosis.diagnose import diagnose
from flexspline.diagnosis.trials.draw import Challenge, draw

SEED = 7
ENOUGH = 5.0
"""Seconds of search after which what is reported here is known."""


@pytest.mark.slow
@pytest.mark.long
def test_a_recording_of_another_joint_is_named():
    own, other = (draw(Challenge(hidden="none", seed=SEED, real=True), i) for i in (0, 1))
    recordings = list(own.measurement.recordings)
    recordings[1] = replace(other.measurement.recordings[1], name=recordings[1].name)
    found = diagnose(replace(own.measurement, recordings=tuple(recordings)), own.nominal, seconds=ENOUGH)
    assert f"by the description recording {recordings[1].name} is off by" in found.reason, found.reason
    assert all(c.confidence <= 0.5 for c in found.causes), [(c.name, c.confidence) for c in found.causes]


@pytest.mark.slow
def test_a_push_that_no_yaml_file_mentions_is_no_cause():
    drawn = draw(Challenge(hidden="none", seed=SEED, exact=True), 0)
    recordings = tuple(replace(r, external="none") for r in drawn.measurement.recordings)
    found = diagnose(replace(drawn.measurement, recordings=recordings), drawn.nominal, seconds=ENOUGH)
    assert "by the description recording push is off by" in found.reason, found.reason
    assert found.verdict == "inconclusive" and not found.causes


@pytest.mark.slow
@pytest.mark.parametrize("shift", [pytest.param(0.0, marks=pytest.mark.long), 1.5e-3])
def test_an_encoder_that_was_zeroed_between_recordings_is_told(shift):
    drawn = draw(Challenge(hidden="none", seed=SEED, real=True), 0)
    *others, last = drawn.measurement.recordings
    last = replace(last, columns=last.columns | {"link_position": last.columns["link_position"] + shift})
    found = diagnose(replace(drawn.measurement, recordings=(*others, last)), drawn.nominal, seconds=ENOUGH)
    reported = re.search(rf"zero differs between recordings \(.*{last.name} \+([\d.]+).*mrad\)", found.reason)
    assert (reported is not None) == (shift > 0.0), found.reason
    if reported is not None:
        assert float(reported[1]) == pytest.approx(1e3 * shift, abs=0.3)
        assert all(c.confidence <= 0.5 for c in found.causes), [(c.name, c.confidence) for c in found.causes]
