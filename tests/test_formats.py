"""Files as version 0.1 wrote them (`tests/frozen`): every later version reads them, and they mean the same.

A format that changes gets another number and files of its own beside these; nothing here is written anew.
"""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path

import numpy as np
import pytest

from flexspline.diagnosis.data.importing import import_recording, load_layout
from flexspline.models.errors import InputError
from flexspline.models.files import parse
from flexspline.models.joint import load_joint
from flexspline.models.output import manifest
from flexspline.models.recording import read_measurement
from flexspline.models.tables import read_table
from flexspline.scenarios.run_folder import load_run
from flexspline.scenarios.scenario import load_scenario
from flexspline.scenarios.studies.dataset import read_note
from flexspline.scenarios.studies.study import Study, load_study
from flexspline.views.pages.two_diagnoses import read_diagnosis

FROZEN = Path(__file__).parent / "frozen"


@pytest.fixture
def frozen(tmp_path) -> Path:
    """A copy: whoever reads a folder may complete what was interrupted in it."""
    return Path(shutil.copytree(FROZEN, tmp_path / "frozen"))


def test_recordings_as_parquet_and_as_csv(frozen):
    short, text = read_measurement(frozen / "measurement").recordings
    assert short.joint == text.joint == "test-joint" and short.external == "measured"
    assert len(short.time) == 200 and short.link.gravity_moment == 9.0
    for name, values in short.columns.items():
        np.testing.assert_allclose(text[name], values[:30], rtol=1e-12, atol=1e-15, err_msg=name)
    assert short["link_position"][-1] == pytest.approx(0.1, abs=0.02)


def test_a_log_and_its_layout(frozen):
    recording = import_recording(load_layout(frozen / "layout.yaml"), frozen / "log.csv")
    np.testing.assert_allclose(recording.time, 4e-3 * np.arange(20))
    np.testing.assert_allclose(recording["motor_position"], np.radians(0.5) * np.arange(20))
    np.testing.assert_allclose(recording["link_position"], 1e-4 * np.arange(20), atol=1e-9)
    np.testing.assert_allclose(recording["motor_current"], 2e-3 * (100 + np.arange(20)))


def test_scenarios_and_studies(frozen):
    scenario, _ = load_scenario(str(frozen / "scenario.yaml"))
    assert (scenario.duration, scenario.seed, [f.name for f in scenario.filters]) == (0.2, 3, ["EKF", "kalman"])
    assert scenario.external_torque().max() == pytest.approx(3.0, rel=1e-3)
    study, _ = load_study(str(frozen / "study.yaml"))
    assert study.seed_list == [1, 2] or tuple(study.seed_list) == (1, 2)


def test_a_run_is_read_and_its_measures_are_the_same(frozen):
    run = load_run(frozen / "run")
    written = json.loads((frozen / "run" / "metrics.json").read_text())
    found = json.loads(json.dumps(run.metrics))
    assert found["filters"].keys() == written["filters"].keys() == {"EKF", "kalman"}
    for name, measures in written["filters"].items():
        assert found["filters"][name]["rms"] == pytest.approx(measures["rms"], rel=1e-9)
    assert set(manifest(frozen / "run").values()) == {"run"}


def test_a_sweep_says_what_it_is_and_has_its_rows(frozen):
    note = read_note(frozen / "sweep" / "study.json")
    assert parse(note["study"], Study, "study.json").name == "small" and note["seeds"] == [1, 2]
    rows = [read_table(path)[0] for path in sorted((frozen / "sweep" / "rows").rglob("*.parquet"))]
    assert [int(row["seed"][0]) for row in rows] == [1, 2] and all(0 < row["rms"][0] < 1 for row in rows)


def test_a_diagnosis_and_the_joint_that_it_extended(frozen):
    found = read_diagnosis(frozen / "diagnosis")
    assert found.answer["verdict"] == "discrepancy" and found.answer["causes"][0]["name"] == "friction_asymmetry"
    joint = load_joint(frozen / "diagnosis" / "joint.yaml")
    assert joint.valid is not None and joint.uncertainty is not None
    ratio = found.answer["causes"][0]["parameters"]["ratio"]["value"]
    assert joint.record()[0]["friction_asymmetry"] == pytest.approx(ratio, rel=1e-6)


@pytest.mark.parametrize(
    ("name", "read"),
    [
        ("run/joint.yaml", load_joint),
        ("scenario.yaml", lambda path: load_scenario(str(path))),
        ("study.yaml", lambda path: load_study(str(path))),
        ("layout.yaml", load_layout),
        ("measurement/short.yaml", lambda path: read_measurement(path.with_suffix(".parquet"))),
        ("sweep/study.json", read_note),
        ("diagnosis/diagnosis.json", lambda path: read_diagnosis(path.parent)),
    ],
)
def test_a_later_format_is_refused_by_name(frozen, name, read):
    path = frozen / name
    text, count = re.subn(r'("?format"?): 1', r"\1: 2", path.read_text(encoding="utf-8"), count=1)
    assert count == 1
    path.write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=r"format: expected 1, got 2") as refused:
        read(path)
    assert path.name in str(refused.value)
