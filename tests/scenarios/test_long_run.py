"""Runs that are too long to be held: in stretches the same bits as in one piece."""

from __future__ import annotations

import numpy as np
import pytest

from flexspline.estimator.errors import FilterDiverged
from flexspline.models.errors import InputError
from flexspline.models.tables import read_table
from flexspline.scenarios import long_run, run_folder
from flexspline.scenarios.experiment import Experiment
from flexspline.scenarios.long_run import is_long, run_long
from flexspline.scenarios.run import run_scenario
from flexspline.scenarios.run_folder import load_run, save_run
from flexspline.scenarios.scenario import load_scenario

SENSORS = (
    "sensors={joint_torque: {delay: 0.013, rate: 150, vibration: {frequency: 33, amplitude: 0.2}}, "
    "link_encoder: {delay: 0.0042}, motor_current: {bandwidth: 200}}"
)
DISTURBANCES = (
    "disturbances=[{kind: walk, start: 1.2, duration: 1, torque: 3}, "
    "{kind: sine, start: 0.5, duration: 3, torque: 3, cycles: 5}, "
    "{kind: push, start: 2.7, duration: 0.2, torque: 3}, {kind: push, start: 3.1, duration: 0.3, torque: -3}]"
)
CASES = {
    "as shipped": ("external_push", ["duration=9"]),
    "sensors that are late, slow and shake": (
        "external_push",
        ["duration=4", "jitter=1e-4", SENSORS, DISTURBANCES, "feedback=sensor"],
    ),
    "as they are, an estimate fed back": ("external_push", ["duration=9", "sensors=realistic", "feedback=RAREKF"]),
    "filters with more to say": (
        "link_sweep",
        [
            "duration=3",
            "filters=[dynamics_ekf, augmented, momentum, current]",
            "temperature={start: 20, end: 40, time_constant: 5}",
        ],
    ),
}


@pytest.mark.fast_every(2)
@pytest.mark.parametrize("case", CASES)
def test_in_stretches_the_same_bits(case, tmp_path):
    name, changes = CASES[case]
    chosen, folder = load_scenario(name, changes)
    whole = run_scenario(chosen, folder)
    save_run(whole, tmp_path / "whole")
    seed = int(np.random.SeedSequence().generate_state(1)[0])
    print(f"seed {seed}")
    block = int(np.random.default_rng(seed).integers(150, 1500))
    thinned = run_long(chosen, folder, tmp_path / "parts", block=block, threads=2)
    assert {p.name for p in (tmp_path / "parts").iterdir()} == {p.name for p in (tmp_path / "whole").iterdir()}
    for path in sorted((tmp_path / "whole").iterdir()):
        other = tmp_path / "parts" / path.name
        if path.suffix != ".parquet":
            assert path.read_bytes() == other.read_bytes(), path.name
            continue
        (expected, notes), (found, others) = read_table(path), read_table(other)
        assert list(expected) == list(found) and notes == others
        for column in expected:
            assert expected[column].tobytes() == found[column].tobytes(), (block, path.name, column)
    assert thinned.metrics == whole.metrics and thinned.notes == whole.notes


def test_a_thinned_run_has_the_extremes(tmp_path, monkeypatch):
    chosen, folder = load_scenario("external_push", ["duration=9"])
    whole = run_scenario(chosen, folder)
    monkeypatch.setattr(long_run, "BINS", 40)
    thinned = run_long(chosen, folder, tmp_path / "run", block=1000)
    assert len(thinned.time) < 0.3 * len(whole.time)
    assert np.isin(thinned.time, whole.time).all() and (np.diff(thinned.time) > 0).all()
    kept = {float(t): i for i, t in enumerate(whole.time)}
    at = [kept[float(t)] for t in thinned.time]
    for of in (
        lambda run: run.truth("joint_torque"),
        lambda run: run.reading("motor_current"),
        lambda run: run.estimate("EKF") - run.truth("joint_torque"),
        lambda run: run.position_command - run.truth("link_position"),
    ):
        every, some = of(whole), of(thinned)
        assert np.array_equal(every[at], some)
        bins = np.arange(len(every)) // -(-len(every) // 40)
        for k in range(40):
            inside = bins == k
            assert every[inside].min() in some and every[inside].max() in some
    assert thinned.thinned is not None
    for name in ("AREKF", "REKF"):
        share = [np.mean(whole.estimates[name].robust[bins == k]) for k in range(40)]
        assert np.array_equal(thinned.thinned.robust[name], share)
    sizes = thinned.thinned.exceeded("EKF", np.array([50.0, 10.0]))
    errors = np.abs(whole.estimate("EKF") - whole.truth("joint_torque"))[whole.time >= 1.0]
    assert sizes == pytest.approx(np.quantile(errors, [0.5, 0.9]), rel=0.013)


def test_what_needs_all_of_a_run_is_refused_where_that_is_too_long():
    for change, why in (
        ("filters=[EKF, rts_smoother]", "look ahead"),
        ("sensors={motor_current: {flicker: 0.1}}", "flicker noise of motor_current"),
    ):
        chosen, folder = load_scenario("external_push", ["duration=7200", change])
        with pytest.raises(InputError, match=f"duration: expected at most 3600 s with .*{why}.*, got 7200 s"):
            is_long(chosen, folder)
        assert not is_long(chosen.model_copy(update={"duration": 3600.0}), folder)
    chosen, folder = load_scenario("external_push", ["duration=7200"])
    assert is_long(chosen, folder)
    with pytest.raises(InputError, match="duration: expected at most 3600 s where all of it is held"):
        Experiment.of(chosen, folder)
    with pytest.raises(InputError, match="duration"):
        load_scenario("external_push", ["duration=90000"])


def test_a_long_run_is_not_read_as_a_whole(tmp_path, monkeypatch):
    chosen, folder = load_scenario("no_load", ["duration=2"])
    run_long(chosen, folder, tmp_path / "run", block=700)
    assert len(load_run(tmp_path / "run").time) == 2000
    monkeypatch.setattr(run_folder, "LONGEST_HELD", 1.0)
    with pytest.raises(InputError, match="expected a run of at most 1 s, which is held in memory, got one of 2 s"):
        load_run(tmp_path / "run")


def test_a_filter_that_fails_says_when_and_leaves_nothing(tmp_path):
    change = "filters=[EKF, {name: bad, estimator: REKF, gamma: 0.1004}]"
    chosen, folder = load_scenario("no_load", ["duration=4", change])
    with pytest.raises(FilterDiverged) as whole:
        run_scenario(chosen, folder)
    with pytest.raises(FilterDiverged) as found:
        run_long(chosen, folder, tmp_path / "run", block=333)
    assert str(found.value) == str(whole.value)
    assert not (tmp_path / "run").exists() or not list((tmp_path / "run").iterdir())
