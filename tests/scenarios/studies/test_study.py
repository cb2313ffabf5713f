"""STUDY.yaml: what is wrong is said in one line; what is shipped can run; the grid is what was asked."""

from __future__ import annotations

import pytest
from small import study

from flexspline.models.errors import InputError
from flexspline.scenarios.studies.design import Design
from flexspline.scenarios.studies.study import Study, load_study, shipped_studies

HEAD = "name: mine\nseeds: {count: 2}\nscenarios: [link_sweep]\n"


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("name: mine\nseeds: {count: 2}\n", ["scenarios", "missing"]),
        (HEAD + "axis: []\n", ["axis", "unknown key", "axes"]),
        (HEAD + "seed: -1\n", ["seed", "-1"]),
        ("name: mine\nseeds: [3, 3]\nscenarios: [link_sweep]\n", ["seeds", "twice"]),
        (HEAD + "metrics: [rmse]\n", ["metrics.0", "rms", "rmse"]),
        (HEAD + "filters: [EKF, curent]\n", ["filters.1", "curent", "did you mean 'current'"]),
        (
            HEAD + "filters: [{name: a, estimator: lowpass, cutof: 3}]\n",
            ["filters.0", "cutof", "did you mean 'cutoff'"],
        ),
        (HEAD + "estimators: [current]\n", ["estimators", "unknown key"]),
        (HEAD + "reference: RARKF\n", ["reference", "RARKF", "did you mean 'RAREKF'"]),
        (HEAD + "axes: [{kind: cause, causes: [stifness], sizes: [1]}]\n", ["stifness", "did you mean 'stiffness'"]),
        (HEAD + "axes: [{kind: set, name: k, key: filters.RAREKF.kk, values: [1]}]\n", ["axes.0.key", "RAREKF", "kk"]),
        (HEAD + "axes: [{kind: set, name: k, key: filters.REKFF.k, values: [1]}]\n", ["REKFF", "did you mean 'REKF'"]),
        (HEAD + "axes: [{kind: set, name: rms, key: plant.K2, values: [1]}]\n", ["axes.0.name", "rms"]),
        (HEAD + "axes: [{kind: set, name: K, key: plant.K2, values: [9000, 9000]}]\n", ["axes.0", "once"]),
        (HEAD + "axes: [{kind: load, values: [0]}]\n", ["axes.0", "values.0", "0"]),
        ("name: ../../mine\nseeds: {count: 2}\nscenarios: [link_sweep]\n", ["name", "pattern", "../../mine"]),
        (
            "name: mine\nseeds: {count: 2}\nscenarios: [{scenario: link_sweep, name: a/../../../esc}]\n",
            ["scenarios.0", "name", "pattern", "esc"],
        ),
    ],
)
def test_a_wrong_study_is_one_line(tmp_path, text, words):
    path = tmp_path / "study.yaml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(InputError) as caught:
        load_study(path)
    message = str(caught.value)
    print(message)
    assert "\n" not in message and message.startswith(str(path))
    for word in words:
        assert word in message, word


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"scenarios": ["link_sweep", "link_sweep"]}, ["scenarios", "link_sweep", "twice"]),
        ({"scenarios": ["link_swep"]}, ["link_swep", "did you mean 'link_sweep'"]),
        (
            {"set": {"sensors.link_encodr.noise": 1.0}},
            ["scenario link_sweep", "link_encodr", "did you mean 'link_encoder'"],
        ),
        ({"axes": [{"kind": "set", "name": "K", "key": "plant.K9", "values": [1.0]}]}, ["plant.K9"]),
        ({"axes": [{"kind": "set", "name": "m", "key": "mounting", "values": ["lnk"]}]}, ["mounting", "lnk"]),
        ({"axes": [{"kind": "load", "values": [3.0]}], "scenarios": ["no_load"]}, ["load", "gravity moment"]),
        (
            {
                "axes": [{"kind": "set", "name": "k", "key": "filters.*.k", "values": [0.0]}],
                "scenarios": ["torque_feedback"],
                "filters": ["RAREKF"],
            },
            ["feedback", "RAREKF"],
        ),
    ],
)
def test_what_cannot_run_is_said_before_anything_runs(changes, words):
    with pytest.raises(InputError) as caught:
        Design.of(study(**({"set": {}} | changes)))
    message = str(caught.value)
    print(message)
    assert "\n" not in message
    for word in words:
        assert word in message, word


def test_an_unknown_study_names_those_that_there_are():
    with pytest.raises(InputError, match="noise_and_load"):
        load_study("noise_and_lod")


def test_the_grid_is_the_product_of_its_axes():
    design = Design.of(
        study(
            axes=[
                {"kind": "cause", "causes": ["stiffness", "encoder_delay"], "sizes": [0, 0.5, 1]},
                {"kind": "set", "name": "kp", "key": "controller.kp", "values": [6, 8]},
                {"kind": "set", "name": "k", "key": "filters.RAREKF.k", "values": [0, 0.1]},
                {"kind": "set", "name": "cutoff", "key": "filters.current.cutoff", "values": [20, 40]},
            ],
            scenarios=["link_sweep"],
        )
    )
    points = [(c.columns["cause"], c.columns["size"], c.columns["kp"]) for c in design.cells]
    assert points[:4] == [("none", 0.0, 6.0), ("none", 0.0, 8.0), ("stiffness", 0.5, 6.0), ("stiffness", 0.5, 8.0)]
    assert len(points) == len(set(points)) == (1 + 2 * 2) * 2
    assert design.runs == 10 * 3
    assert [(v.name, v.columns) for v in design.variants] == [
        ("EKF", {}),
        ("RAREKF", {"k": 0.0}),
        ("RAREKF", {"k": 0.1}),
        ("current", {"cutoff": 20.0}),
        ("current", {"cutoff": 40.0}),
    ]
    assert [v.estimator.k for v in design.variants[1:3]] == [0.0, 0.1]
    assert design.variants[3].estimator.cutoff == 20.0
    keys = {design.key(cell, seed) for cell in design.cells for seed in design.study.seed_list}
    assert len(keys) == design.runs


def test_the_digest_changes_with_what_changes_rows_and_with_nothing_else(tmp_path):
    one = Design.of(study()).digest
    assert Design.of(study(description="other words", reference="EKF", seeds=[1, 2])).digest == one
    for change in (
        {"seed": 2},
        {"metrics": ["rms"]},
        {"set": {"duration": 1.6, "transient": 0.5}},
        {"filters": ["EKF", "RAREKF"]},
    ):
        assert Design.of(study(**change)).digest != one, change


@pytest.mark.parametrize("name", sorted(shipped_studies()))
def test_shipped_studies_can_run(name):
    asked, folder = load_study(name)
    assert isinstance(asked, Study) and asked.name == name
    design = Design.of(asked, folder)
    assert design.runs == len(design.cells) * len(asked.seed_list)


def test_the_shipped_studies_are_the_full_ones():
    assert len(load_study("noise_and_load")[0].seed_list) == 500
    model_error, _ = load_study("model_error")
    assert {"current", "momentum_torsion", "augmented"} <= set(model_error.names)  # what the docs recommend
    assert len(model_error.axes[0].causes) == 19


def test_more_seeds_than_there_may_be_are_one_line():
    with pytest.raises(InputError, match="--seeds: expected at most 10000000, got 10000001"):
        Study.model_validate(study().model_dump()).with_seeds(10_000_001)
