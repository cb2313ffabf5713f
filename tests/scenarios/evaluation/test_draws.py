"""Draws: what changes from seed to seed, what does not, and intervals over them."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from benchmarks.draws import draw, geometric
from benchmarks.estimators import geometric_over
from flexspline.scenarios.evaluation.draws import TURNS, drawn_record, known_within, varied
from flexspline.scenarios.experiment import Experiment
from flexspline.scenarios.scenario import load_scenario


@pytest.fixture(scope="module")
def pushed():
    return load_scenario("external_push")


def test_everything_is_drawn(pushed):
    scenario, _ = pushed
    some = [varied(scenario, seed) for seed in range(40)]
    starts = np.array([s.trajectory[0].position for s in some])
    assert np.ptp(starts) > TURNS * 2 * np.pi / 100 and len(set(starts)) == 40
    for i, push in enumerate(scenario.disturbances):
        sizes = np.array([s.disturbances[i].torque / push.torque for s in some])
        assert {-1.0, 1.0} == set(np.sign(sizes)) and np.all((np.abs(sizes) >= 0.5) & (np.abs(sizes) <= 1.5))
        onsets = np.array([s.disturbances[i].start for s in some])
        assert np.std(onsets) > 0.3 and np.all(np.abs(onsets - push.start) <= 0.9)
    for s in some:
        times = [w.time for w in s.trajectory]
        assert times == sorted(times) and times[-1] <= s.duration
        ends = [(d.start, d.start + d.duration) for d in s.disturbances]
        assert all(a[1] < b[0] for a, b in itertools.pairwise(ends)) and ends[-1][1] <= s.duration
    assert varied(scenario, 3) == varied(scenario, 3)


def test_pushes_of_a_scenario_that_is_cut_stay_outside_it(pushed):
    """Disturbances after the end stay after it, and a walk, which depends on the seed already, is unchanged."""
    scenario, _ = pushed
    end = scenario.disturbances[0].start + scenario.disturbances[0].duration
    cut = scenario.model_copy(update={"duration": end + 0.1})
    for seed in range(20):
        first, *others = varied(cut, seed).disturbances
        assert 0.0 <= first.start <= first.start + first.duration <= cut.duration
        assert all(d.start > cut.duration for d in others), (seed, others)
    walk = scenario.disturbances[0].model_copy(update={"kind": "walk", "start": 0.0, "duration": scenario.duration})
    assert varied(scenario.model_copy(update={"disturbances": [walk]}), 1).disturbances == [walk]


def test_joints_grow_with_the_tolerance(pushed):
    """Twice the tolerance is the same joint, twice as far from nominal; a known zero stays."""
    scenario, folder = pushed
    experiment = Experiment.of(scenario, folder)
    nominal = experiment.record[0]
    assert drawn_record(experiment, 5, 0.0, False).tobytes() == experiment.record.tobytes()
    half, whole = (drawn_record(experiment, 5, t, True)[0] for t in (0.5, 1.0))
    for name in ("Kt", "Jm", "Fc", "K2", "Mg"):
        if name in ("Fc", "Kt", "Jm", "Mg"):  # of one variable: linear
            assert whole[name] - nominal[name] == pytest.approx(2 * (half[name] - nominal[name]))
        assert whole[name] != nominal[name]
    assert whole["link_zero"] == 0.0 and drawn_record(experiment, 5, 1.0, False)[0]["link_zero"] != 0.0
    wide, none = known_within(experiment.known, 1.0, False), known_within(experiment.known, 0.0, True)
    assert wide.spread.stiffness == pytest.approx(np.hypot(0.07, 0.02)) and wide.link_zero == 1e-3
    assert wide.spread.gravity == 0.01 and wide.spread.kinematic[0] == pytest.approx(2.4e-5, rel=0.01)
    assert none.spread.stiffness == none.friction == none.link_zero == 0.0


def test_a_draw(pushed):
    scenario, folder = pushed
    short = scenario.model_copy(update={"duration": 1.2, "transient": 0.2, "disturbances": []})
    one, same, other = (draw(short, folder, seed) for seed in (3, 3, 4))
    assert np.array_equal(one.truth, same.truth) and not np.array_equal(one.truth, other.truth)
    assert one.known.record.tobytes() == other.known.record.tobytes() != one.record.tobytes()
    assert one.kept.sum() == 1000 and not one.moving.any()


def test_geometric_means():
    """Ratios of log-normal errors: the interval covers the true ratio in 95 % of the trials."""
    rng = np.random.default_rng(1)
    inside = 0
    for _ in range(400):
        reference = np.exp(rng.normal(0.0, 1.0, 12))
        found = geometric(0.5 * reference * np.exp(rng.normal(0.0, 0.4, 12)), reference)
        inside += found.low < 0.5 < found.high
    assert 0.92 < inside / 400 < 0.98
    a, b = np.array([1.0, 4.0]), np.array([2.0, 2.0])
    assert geometric(a, b).mean == pytest.approx(1.0)
    assert geometric_over([a, 4 * a], [b, b]).mean == pytest.approx(2.0)
