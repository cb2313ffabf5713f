"""Estimators and the bounds."""

from __future__ import annotations

import numpy as np
import pytest

from flexspline.estimator import bound
from flexspline.estimator.joint_model import STATES
from flexspline.models.errors import InputError
from flexspline.scenarios.evaluation import limits
from flexspline.scenarios.evaluation.draws import varied
from flexspline.scenarios.filters import estimators
from flexspline.scenarios.run import run_scenario, simulate_scenario
from flexspline.scenarios.scenario import load_scenario

NAMES = ("EKF", "RAREKF", "model", "dynamics_ekf", "rts_smoother")


def scenario(*changes: str):
    return load_scenario("external_push", ["duration=5", *changes])


@pytest.fixture(scope="module")
def drawn():
    """Draws of the bound's own external torque: one limit for all that is causal."""
    chosen, folder = scenario()
    return limits.assess(limits.matched(chosen, 1.0), folder, range(1, 5), estimators(NAMES), 1.0)


@pytest.mark.slow
def test_no_filter_is_below_the_bound_on_its_own_model(drawn):
    for one in drawn.estimators:
        print(f"{one.name}: {drawn.ratio(one.name):.2f} of the bound")
        if one.causal:
            assert drawn.ratio(one.name) > 1.0
    assert drawn.ratio("dynamics_ekf") < 3.0  # and it is no idle bound
    assert drawn.bound_rms < drawn.torsion_bound_rms < drawn.ratio("model") * drawn.bound_rms


def test_what_is_reported(drawn):
    bins = round(5 / limits.BIN)
    by_name = {one.name: one for one in drawn.estimators}
    assert drawn.time.shape == drawn.bound.shape == drawn.torsion_bound.shape == (bins,)
    for one in drawn.estimators:
        assert one.rms.shape == (4,) and one.error.shape == (bins,)
        after = drawn.time > drawn.transient
        assert np.sqrt(np.mean(one.error[after] ** 2)) == pytest.approx(one.mean_rms, rel=1e-9)
    assert by_name["model"].nis is None and by_name["model"].nees is not None
    assert by_name["rts_smoother"].nis is None and not by_name["rts_smoother"].causal
    assert by_name["EKF"].autocorrelation.shape == (limits.LAGS,)
    assert by_name["EKF"].nis.samples == 4 * 4000


def test_measures_are_those_of_the_runs():
    """One seed: RMS error and mean NIS as the run itself reports them."""
    chosen, folder = scenario("duration=3")
    found = limits.assess(chosen, folder, [7], estimators(["EKF", "RAREKF"]))
    assert found.fitted == pytest.approx(limits.fitted_intensity(varied(chosen, 7)))
    run = run_scenario(varied(chosen, 7), folder)
    for one in found.estimators:
        assert one.rms[0] == pytest.approx(run.metrics["filters"][one.name]["rms"], rel=1e-12)
        assert one.nis.value == pytest.approx(run.metrics["filters"][one.name]["mean_nis"], rel=1e-9)


def test_intensity_is_fitted_and_never_silent():
    chosen, folder = scenario("duration=3", "disturbances=[{kind: step, start: 1, duration: 1, torque: 2}]")
    expected = np.sqrt(2 * 2.0**2 / 2.999)
    assert limits.fitted_intensity(chosen) == pytest.approx(expected)
    quiet, _ = scenario("duration=3", "disturbances=[]")
    found = limits.assess(quiet, folder, [1], {})
    assert found.fitted == 0.0 and found.intensity == pytest.approx(0.012)


def test_the_bound_has_the_temperature_of_the_run():
    chosen, folder = scenario("duration=2", "temperature=65")
    run = simulate_scenario(chosen, folder, 1)
    record = run.known.record.copy()
    record["friction_temperature"] = -0.01
    found = limits.joint_variance(run, record, 1.0)
    command, current, warm = run.simulation.command, run.truth("motor_current"), np.full(len(run.time), 65.0)
    given = run.time, limits.true_states(run), current, command, record, run.known.noise, 1.0
    assert np.array_equal(found, bound.joint_bound(*given, warm))
    assert not np.array_equal(found, bound.joint_bound(*given))


@pytest.mark.slow
def test_seeds_are_independent_runs_unless_one_motion_is_asked_for():
    """Errors of seeds with one motion go together; with drawn ones they do not."""
    chosen, folder = load_scenario("link_sweep", ["duration=8"])
    seeds = [1, 2]

    def likeness(vary: bool) -> float:
        runs = [simulate_scenario(varied(chosen, s) if vary else chosen, folder, s) for s in seeds]
        one = estimators(["model"])["model"]
        errors = [one.estimate(run.signals, run.known).mean - run.truth("joint_torque") for run in runs]
        found = limits.assess(chosen, folder, seeds, {"model": one}, vary=vary)
        own = [np.sqrt(np.mean(e[run.time >= chosen.transient] ** 2)) for e, run in zip(errors, runs, strict=True)]
        assert found.estimators[0].rms == pytest.approx(own)
        return float(np.corrcoef(*errors)[0, 1])

    same, drawn = likeness(False), likeness(True)
    print(f"correlation of the errors of two seeds: {same:.2f} with one motion, {drawn:.2f} with drawn ones")
    assert same > 0.8 and abs(drawn) < 0.3


def test_a_walk_is_another_for_each_seed_and_has_its_size():
    chosen, _ = scenario()
    walks = [limits.matched(chosen.model_copy(update={"seed": s}), 2.0).external_torque() for s in range(1, 201)]
    ends = np.array([w[-1] for w in walks])
    assert all(w[0] == 0.0 for w in walks) and len(set(ends)) == 200
    assert np.std(ends) == pytest.approx(2.0 * np.sqrt(5.0), rel=0.2)  # four standard deviations of 200 draws
    assert np.array_equal(walks[3], limits.matched(chosen.model_copy(update={"seed": 4}), 2.0).external_torque())


def test_bad_input():
    chosen, folder = scenario()
    fed_back = chosen.model_copy(update={"feedback": "EKF"})
    with pytest.raises(InputError, match="feedback: expected none or sensor"):
        limits.assess(fed_back, folder, [1], {})
    with pytest.raises(InputError, match="at least one seed"):
        limits.assess(chosen, folder, [], {})


def test_true_states_are_the_truth_by_name():
    chosen, folder = scenario("duration=2")
    run = run_scenario(chosen, folder)
    column = dict(zip(STATES, limits.true_states(run).T, strict=True))
    for name in ("motor_position", "wave_generator_velocity", "link_velocity", "bristle"):
        assert np.array_equal(column[name], run.truth(name)), name
    assert np.array_equal(column["external_torque"], run.external_torque)
    assert not column["hysteresis"].any()
