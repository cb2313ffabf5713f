"""The tables of docs/studies.md (`python -m benchmarks studies`): from a dataset that is whole, and from a part of it."""

from __future__ import annotations

import pytest
from small import column, study

from benchmarks import studies
from flexspline.models.files import write_into_place
from flexspline.scenarios.studies.dataset import Dataset
from flexspline.scenarios.studies.design import Design
from flexspline.scenarios.studies.statistics import interval, read_csv
from flexspline.scenarios.studies.sweep import sweep, versions
from flexspline.views.sweep_tables import with_interval

AXES = [
    {"kind": "set", "name": "k", "key": "filters.RAREKF.k", "values": [0.0, 2.0]},
    {"kind": "load", "values": [3.0, 9.0]},
]


@pytest.fixture
def page(tmp_path):
    text = "".join(f"<!-- begin small{part} -->\n<!-- end small{part} -->\n" for part in (" about", ""))
    path = tmp_path / "page.md"
    with write_into_place(path) as temporary:
        temporary.write_text(text, encoding="utf-8")
    return path


def test_a_table_says_what_its_dataset_has_and_how_much_of_it_there_is(tmp_path, page, monkeypatch):
    asked = study(scenarios=["link_sweep"], axes=AXES, reference="EKF")
    monkeypatch.setitem(studies.SHOWN, "small", ("rms",))
    whole = Design.of(asked)
    part = Design.of(asked.with_seeds(2))
    dataset = Dataset.open(tmp_path / "data", part, versions())
    sweep(part, dataset, jobs=1)
    studies.write("small", dataset, whole, whole, page)
    assert "(2 points, 2 of 3 draws at each)" in page.read_text(encoding="utf-8")

    dataset = Dataset.open(tmp_path / "data", whole, versions())
    sweep(whole, dataset, jobs=1)
    studies.write("small", dataset, whole, whole, page)
    text = page.read_text(encoding="utf-8")
    assert "(whole: 2 points, 3 draws at each)" in text
    lines = [line for line in text.splitlines() if line.startswith("|")]
    assert lines[0].split(" | ")[3:] == ["EKF", "RAREKF, k 0", "RAREKF, k 2", "current |"]
    for line, cell, load in zip(lines[2:], range(2), ("3", "9"), strict=True):
        cells = line.strip("| ").split(" | ")
        assert cells[:2] == ["link_sweep", load]
        assert cells[3].startswith(with_interval(interval(column(dataset, cell, "EKF", "rms"))))

    more = Design.of(study(scenarios=["link_sweep", "external_push"], axes=AXES))
    studies.write("small", dataset, whole, more, page)
    assert "(2 of 4 points, 3 of 3 draws at each)" in page.read_text(encoding="utf-8")

    kept = read_csv(page.with_name("study_small.csv"), asked)
    assert kept[0].values["rms"].mean == pytest.approx(interval(column(dataset, 0, "EKF", "rms")).mean, rel=1e-3)


def test_every_shipped_study_has_its_place_on_the_page():
    from flexspline.scenarios.studies.study import load_study, shipped_studies

    assert {*studies.STUDIES, "tolerance"} == set(shipped_studies())
    assert set(studies.STUDIES) == set(studies.SHOWN)
    text = (studies.ROOT / "docs" / "studies.md").read_text(encoding="utf-8")
    for name in studies.STUDIES:
        for whole in (True, False):
            study, _ = studies.chosen(name, whole)
            assert whole <= (study == load_study(name)[0])
        for part in ("", " about"):
            assert f"<!-- begin {name}{part} -->" in text and f"<!-- end {name}{part} -->" in text, name
