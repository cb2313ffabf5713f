"""Sweeps: the same rows to the bit however they are computed; interrupted and resumed; paired; honest about failures."""

from __future__ import annotations

import errno
import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pyarrow.dataset
import pyarrow.parquet as pq
import pytest
from small import SECONDS, column, rows, run, same, study

from flexspline.estimator import registry
from flexspline.models import causes
from flexspline.models.errors import InputError
from flexspline.scenarios.run import run_scenario
from flexspline.scenarios.scenario import load_scenario
from flexspline.scenarios.studies.dataset import Dataset
from flexspline.scenarios.studies.design import Design
from flexspline.scenarios.studies.sweep import sweep, versions


@pytest.fixture(scope="module")
def done(tmp_path_factory) -> Dataset:
    """The small study, on one thread."""
    return run(tmp_path_factory.mktemp("sweep") / "one", jobs=1)


@pytest.mark.fast_every(3)
@pytest.mark.parametrize(("jobs", "chunk"), [(3, 1), (2, 2), (1, 100)])
def test_threads_and_chunks_change_no_bit(done, tmp_path, jobs, chunk):
    assert same(run(tmp_path / "other", jobs=jobs, chunk=chunk), done)


def test_rows_are_what_a_run_of_the_scenario_measures(done):
    """A row against `run_scenario` with the same seed: the same metrics to the bit."""
    design = done.design
    cell = design.cells[1]  # link_sweep, eight times the noise
    changes = [f"duration={SECONDS}", "transient=0.5", "sensors.link_encoder.noise=8e-6"]
    scenario, folder = load_scenario("link_sweep", changes, seed=design.noise_seed(cell, 5))
    metrics = run_scenario(scenario, folder).metrics
    for name in ("EKF", "RAREKF"):
        row = next(r for r in done.read(1).to_pylist() if r["seed"] == 5 and r["filter"] == name)
        assert {m: row[m] for m in design.study.metrics} == {
            m: metrics["filters"][name].get(m) for m in design.study.metrics
        }


def test_any_parquet_reader_takes_the_rows(done):
    table = pyarrow.dataset.dataset(done.folder / "rows", partitioning="hive").to_table()
    assert table.num_rows == done.design.runs * 3
    assert set(table["scenario"].to_pylist()) == {"link_sweep", "no_load"}
    assert table["failure"].to_pylist() == [""] * table.num_rows


class Stop(Exception):
    """An interruption of a sweep."""


def test_interrupted_and_resumed_is_the_same_to_the_bit(done, tmp_path):
    design, left = Design.of(study()), [3]

    def interrupt(runs: int) -> None:
        left[0] -= runs
        if left[0] <= 0:
            raise Stop

    with pytest.raises(Stop):
        sweep(design, Dataset.open(tmp_path / "a", design, versions()), 2, 1, progress=interrupt)
    begun = Dataset.open(tmp_path / "a", design, versions())
    assert begun.done() == 3
    before = {path: path.read_bytes() for cell in design.cells for _, _, path in begun.parts(cell.index)}
    computed = []
    sweep(design, begun, jobs=1, chunk=2, progress=computed.append)
    assert sum(computed) == design.runs - 3
    assert same(begun, done)
    assert all(path.read_bytes() == data for path, data in before.items()), "what was there was written again"
    computed.clear()
    sweep(design, begun, jobs=1, progress=computed.append)
    assert not computed
    assert not list((tmp_path / "a").rglob(".*")), "temporary files were left"


def test_a_broken_file_is_computed_again(done, tmp_path):
    again = run(tmp_path / "a", jobs=1)
    path = again.parts(2)[0][2]
    path.write_bytes(path.read_bytes()[:100])
    sweep(again.design, again, jobs=1)
    assert same(again, done)


def test_a_file_with_damage_inside_is_computed_again(done, tmp_path):
    again = run(tmp_path / "a", jobs=1)
    path = again.parts(2)[0][2]
    content = bytearray(path.read_bytes())
    content[60:90] = bytes(30)  # within the pages; the file's end, which says what is where, is whole
    path.write_bytes(content)
    assert pq.read_metadata(path).num_rows > 0
    sweep(again.design, Dataset.open(tmp_path / "a", again.design, versions()), jobs=1)
    assert same(again, done)


@pytest.mark.slow
def test_a_process_may_end_right_after_it_looked(tmp_path):
    """A dataset is looked through by threads that are gone then: Python ended with SIGABRT in more than every second process
    whose rows have this many columns, and in every tenth with those of a study."""
    again = run(tmp_path / "a", jobs=1)
    path = again.parts(2)[0][2]
    table = pq.read_table(path, partitioning=None)
    for i in range(200):
        table = table.append_column(f"more_{i}", table["run"])
    pq.write_table(table, path, write_page_checksum=True)
    look = (
        "import sys\nfrom pathlib import Path\nsys.path.insert(0, sys.argv[1])\n"
        "from small import study\n"
        "from flexspline.scenarios.studies.dataset import Dataset\n"
        "from flexspline.scenarios.studies.design import Design\n"
        "from flexspline.scenarios.studies.sweep import versions\n"
        "Dataset.open(Path(sys.argv[2]), Design.of(study()), versions()).done()\n"
    )
    words = [sys.executable, "-c", look, str(Path(__file__).parent), str(tmp_path / "a")]
    for _ in range(4):
        done = subprocess.run(words, capture_output=True, text=True, timeout=120)
        assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("number", [errno.EIO, errno.ESTALE, errno.EACCES])
def test_a_file_that_cannot_be_read_now_is_not_taken_away(tmp_path, monkeypatch, number):
    again = run(tmp_path / "a", jobs=1)
    path, opened = again.parts(2)[0][2], Path.open

    def failing(self, *arguments, **options):
        if self == path:
            raise OSError(number, os.strerror(number))
        return opened(self, *arguments, **options)

    monkeypatch.setattr(Path, "open", failing)
    with pytest.raises(InputError, match="cannot be read"):
        Dataset.open(tmp_path / "a", again.design, versions()).done()
    assert path.exists()


@pytest.mark.parametrize(
    "text",
    [
        "", "[]", "[" * 100_000, '{"a":' * 100_000, "1" * 5000,
        *(json.dumps({"digest": "", "versions": {}, "seeds": [], "study": {}} | odd) for odd in (
            {"versions": None}, {"versions": ["numpy"]}, {"seeds": 3}, {"seeds": None}, {"study": "x"}, {"digest": 1},
            {"study": {"description": "x"}}, {"study": {"name": 3}},
        )),
    ],
)  # fmt: skip
def test_a_damaged_note_is_one_line(tmp_path, text):
    (tmp_path / "study.json").write_text(text)
    with pytest.raises(InputError, match=r"study\.json: expected the note of a sweep, got something else"):
        Dataset.open(tmp_path, Design.of(study()), versions())
    assert (tmp_path / "study.json").read_text() == text


def test_a_note_that_cannot_be_read_now_is_not_called_something_else(tmp_path, monkeypatch):
    again = run(tmp_path / "a", study(seeds={"first": 4, "count": 1}), jobs=1)
    monkeypatch.setattr(Path, "read_text", lambda *_, **__: (_ for _ in ()).throw(OSError(errno.EIO, os.strerror(5))))
    with pytest.raises(InputError, match=r"study\.json: cannot read the note of a sweep: Input/output error"):
        Dataset.open(tmp_path / "a", again.design, versions())


def test_rows_are_not_written_through_a_link(tmp_path):
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "a").mkdir()
    design = Design.of(study())
    dataset = Dataset.open(tmp_path / "a", design, versions())
    (tmp_path / "a" / "rows").symlink_to(tmp_path / "elsewhere")
    with pytest.raises(InputError, match="leads elsewhere"):
        sweep(design, dataset, jobs=1)
    assert not list((tmp_path / "elsewhere").rglob("*.parquet"))


def test_more_seeds_go_on_where_it_ended(done, tmp_path):
    run(tmp_path / "a", study(seeds={"first": 4, "count": 1}), jobs=1)
    computed = []
    more = run(tmp_path / "a", jobs=1, progress=computed.append)
    assert sum(computed) == 2 * len(more.design.cells)
    assert same(more, done)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"metrics": ["rms"]}, "metrics"),
        ({"axes": []}, "axes"),
        ({"seeds": [9, 8]}, "seeds"),
    ],
)
def test_a_changed_study_is_refused_in_one_line(done, change, words):
    design = Design.of(study(**change))
    with pytest.raises(InputError) as caught:
        Dataset.open(done.folder, design, versions())
    message = str(caught.value)
    print(message)
    assert "\n" not in message and str(done.folder) in message and words in message


def test_another_version_and_another_folder_are_refused(done, tmp_path):
    with pytest.raises(InputError, match=r"mujoco 4.*got 9"):
        Dataset.open(done.folder, done.design, versions() | {"mujoco": "9"})
    (tmp_path / "letter.txt").write_text("not a sweep")
    with pytest.raises(InputError, match="something else"):
        Dataset.open(tmp_path, done.design, versions())


def test_two_sweeps_into_one_folder_at_once_are_refused(done):
    with done.locked(), pytest.raises(InputError, match="no other sweep"):
        sweep(done.design, Dataset.open(done.folder, done.design, versions()))
    sweep(done.design, done)


def test_points_of_an_axis_see_the_same_noise(tmp_path):
    """An axis that reaches no estimator (the wrench's noise): the same measures to the bit at all its points."""
    axis = {"kind": "set", "name": "force_noise", "key": "sensors.wrench.force_noise", "values": [0.1, 5.0]}
    found = run(tmp_path / "a", study(axes=[axis], scenarios=["link_sweep"]), jobs=1)
    for name in found.design.study.names:
        assert column(found, 0, name, "rms") == column(found, 1, name, "rms")
    assert len(set(column(found, 0, "EKF", "rms"))) == 3, "seeds differ"


def test_variants_of_a_filter_share_a_simulation_and_are_what_they_would_be_alone(tmp_path):
    axes = [
        {"kind": "set", "name": "k", "key": "filters.RAREKF.k", "values": [0.0, 2.0]},
        {"kind": "set", "name": "cutoff", "key": "filters.current.cutoff", "values": [10.0, 40.0]},
    ]
    together = run(tmp_path / "a", study(axes=axes, scenarios=["link_sweep"]), jobs=1)
    assert together.design.runs == 3
    alone = study(
        axes=[], scenarios=["link_sweep"], filters=[{"name": "RAREKF", "rule": "rarekf", "k": 2.0}, "current"]
    )
    alone = run(tmp_path / "b", alone, jobs=1)
    table = together.read(0).to_pylist()
    assert [r["rms"] for r in table if r["k"] == 2.0] == column(alone, 0, "RAREKF", "rms")
    assert [r["rms"] for r in table if r["cutoff"] == 40.0] == column(alone, 0, "current", "rms")
    assert registry.get("current").cutoff == 40.0
    assert [r["k"] for r in table if r["filter"] == "EKF"] == [None] * 3


def test_causes_are_drawn_per_seed_and_grow_with_size():
    design = Design.of(
        study(
            scenarios=["link_sweep"],
            axes=[{"kind": "cause", "causes": ["stiffness"], "sizes": [0, 0.5, 1]}],
            filters=["EKF"],
        )
    )
    record = design.experiment(design.cells[0]).record
    assert design.hidden(design.cells[0], 4, record) is None
    half, whole = (
        [design.hidden(cell, s, record)[0]["K2"] / record[0]["K2"] - 1 for s in range(6)] for cell in design.cells[1:]
    )
    np.testing.assert_allclose(2 * np.array(half), whole, rtol=1e-12)
    assert len(set(whole)) == 6
    low, high = zip(*causes.get("stiffness").parameters[0].ordinary, strict=True)
    assert all(min(low) <= 1 + x <= max(high) for x in whole)


def test_what_is_hidden_costs_and_the_estimators_do_not_know_it(tmp_path):
    axes = [{"kind": "cause", "causes": ["stiffness"], "sizes": [0, 1]}, {"kind": "load", "values": [9.0]}]
    asked = study(scenarios=["link_sweep"], axes=axes, set={"duration": 3.0, "trajectory.0.position": 1.2})
    asked = asked.model_copy(update={"set": asked.set | {"trajectory.1.position": 1.3}})
    found = run(tmp_path / "a", asked, jobs=2)
    design = found.design
    exact, hidden = (design.experiment(cell).known.record.tobytes() for cell in design.cells)
    assert exact == hidden
    right, wrong = (np.array(column(found, c, "EKF", "rms")) for c in (0, 1))
    assert np.all(wrong > 5 * right)


def test_load_is_known_to_the_estimators():
    design = Design.of(study(scenarios=["link_sweep"], axes=[{"kind": "load", "values": [4.5, 9.0]}]))
    light, nominal = (design.experiment(cell) for cell in design.cells)
    for record in (light.record, light.known.record):
        assert record[0]["Mg"] == 4.5
        assert record[0]["Jl"] == pytest.approx(0.5 * nominal.record[0]["Jl"], rel=1e-12)


def test_a_filter_that_diverges_leaves_the_others_as_they_are(done, tmp_path):
    """γ below √P: Eq. (18) has no solution. The other filters' rows are those of a study without it."""
    filters = [f.model_dump() for f in study().filters]
    filters.insert(1, {"name": "tight", "rule": "robust", "gamma": 0.01})
    found = run(tmp_path / "a", study(filters=filters), jobs=1)
    table = found.read(0).to_pylist()
    bad = [r for r in table if r["filter"] == "tight"]
    assert len(bad) == 3 and all(r["rms"] is None and "tight" in r["failure"] for r in bad)
    for name in ("EKF", "RAREKF", "current"):
        assert column(found, 0, name, "rms") == column(done, 0, name, "rms")


def test_a_load_that_the_joint_cannot_bear_is_a_row_that_says_so(tmp_path):
    asked = study(
        scenarios=["external_push"],
        axes=[{"kind": "set", "name": "push", "key": "disturbances.0.torque", "values": [5, 4000]}],
        set={"duration": 1.5, "disturbances.0.start": 0.6, "disturbances.0.kind": "step", "transient": 0.5},
    )
    found = run(tmp_path / "a", asked, jobs=1)
    assert {r["failure"] for r in found.read(0).to_pylist()} == {""}
    assert all("finite" in r["failure"] and r["rms"] is None for r in found.read(1).to_pylist())


def test_a_fed_back_filter_that_the_study_does_not_list_still_feeds_back(tmp_path):
    """`torque_feedback` feeds back its RAREKF; a study of the EKF alone has the same plant."""
    one = {"scenarios": ["torque_feedback"], "axes": [], "set": {"duration": 1.5}}
    both = run(tmp_path / "a", study(**one), jobs=1)
    ekf = run(tmp_path / "b", study(**one, filters=["EKF"]), jobs=1)
    assert column(both, 0, "EKF", "rms") == column(ekf, 0, "EKF", "rms")
    assert "RAREKF" not in {r["filter"] for r in ekf.read(0).to_pylist()}


def test_files_say_which_versions_made_them(done):
    assert b"mujoco" in pq.read_schema(done.parts(0)[0][2]).metadata[b"versions"]
    assert rows(done).num_rows == done.design.runs * 3


def test_joints_within_tolerance(tmp_path):
    """Per seed another joint and another motion; the same joint in every scenario, and at every tolerance in its direction."""
    axis = {"kind": "tolerance", "values": [0, 0.2, 1]}
    design = Design.of(study(axes=[axis], vary=True))
    cells = [c for c in design.cells if c.columns["tolerance"] == 1]
    drawn = {(c.scenario, s): design.drawn(c, s, design.experiment(c)) for c in cells for s in (4, 5)}
    stiffness = {key: record[0]["K2"] for key, (_, record) in drawn.items()}
    assert stiffness["link_sweep", 4] == stiffness["no_load", 4] != stiffness["link_sweep", 5]
    starts = {key: experiment.command[0] for key, (experiment, _) in drawn.items()}
    assert len(set(starts.values())) == 4
    exact = design.drawn(design.cells[0], 4, design.experiment(design.cells[0]))
    assert exact[1].tobytes() == design.experiment(design.cells[0]).record.tobytes()
    assert exact[0].known.spread.stiffness == 0.0 and drawn["link_sweep", 4][0].known.spread.stiffness > 0.07
    found = rows(run(tmp_path / "data", study(axes=[axis], vary=True, seeds=[4], scenarios=["link_sweep"])))
    rms = dict(zip(zip(found["tolerance"].to_pylist(), found["filter"].to_pylist(), strict=True), found["rms"].to_pylist(),
                   strict=True))  # fmt: skip
    assert rms[1.0, "RAREKF"] > 2 * rms[0.0, "RAREKF"]
