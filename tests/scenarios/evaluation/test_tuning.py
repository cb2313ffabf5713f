"""Tuning: it finds what is known, never loses on training, and gives the same twice and on any number of threads."""

from __future__ import annotations

from dataclasses import dataclass
from types import SimpleNamespace
from typing import ClassVar

import numpy as np
import pytest
import yaml

from flexspline.estimator import registry
from flexspline.estimator.estimator import Estimator, Posterior, TuningParameter
from flexspline.estimator.filters.paper import PaperFilter
from flexspline.models.errors import InputError
from flexspline.models.signals import Signals
from flexspline.scenarios.evaluation import tuning
from flexspline.scenarios.evaluation.draws import varied
from flexspline.scenarios.evaluation.intervals import interval
from flexspline.scenarios.run import Run, simulate_scenario
from flexspline.scenarios.scenario import Scenario, load_scenario


@dataclass(frozen=True)
class OnMeasurement(Estimator):
    """The paper's EKF on a measurement that is given, instead of on encoders."""

    name: str = "given"
    W: float = 1e-4
    V: float = 1e-2
    tuning: ClassVar[tuple[TuningParameter, ...]] = registry.get("EKF").tuning

    def estimate(self, signals: Signals, joint) -> Posterior:
        y = signals["measurement"]
        torque, variance = np.empty(len(y)), PaperFilter().P0
        torque[0] = y[0]
        for k in range(1, len(y)):
            predicted = variance + self.W
            gain = predicted / (predicted + self.V)
            torque[k], variance = torque[k - 1] + gain * (y[k] - torque[k - 1]), (1.0 - gain) * predicted
        return Posterior(self.name, signals.time, torque)


class Walk:
    """What tuning needs of a run: a random walk of variance W per step, seen with noise of variance V."""

    def __init__(self, rng, W: float, V: float, n: int = 20000):
        self.time = np.arange(n) * 1e-3
        self.walk = np.cumsum(np.sqrt(W) * rng.standard_normal(n))
        self.signals = Signals(self.time, {"measurement": self.walk + np.sqrt(V) * rng.standard_normal(n)})
        self.scenario, self.known = SimpleNamespace(transient=1.0), None

    def truth(self, _: str) -> np.ndarray:
        return self.walk


@pytest.fixture(scope="module")
def runs():
    scenarios = [load_scenario("external_push", ["duration=9"])]
    return tuning.simulated(scenarios, [1, 2]), tuning.simulated(scenarios, [101, 102, 103, 104])


def test_recovers_the_ratio_of_a_random_walk(rng):
    """The best W/V of a Kalman filter on a random walk is the walk's own."""
    W, V = 4e-5, 1e-2
    train = [[Walk(rng, W, V) for _ in range(6)]]
    found = tuning.tune(OnMeasurement(), train, train)
    ratio = found.values["W"] / found.tuned.V
    print(f"W/V {ratio:.3e}, {W / V:.3e} is right; {found.evaluations} evaluations")
    # The error is flat about the optimum: log10 of the ratio scatters by some 0.05 over draws of this length.
    assert abs(np.log10(ratio / (W / V))) < 0.2
    assert found.train[1] <= found.train[0]
    steady = 0.5 * (-W + np.sqrt(W * W + 4 * W * V))
    assert found.train[1] == pytest.approx(np.sqrt(steady), rel=0.03)


def test_never_worse_on_training_and_paired_on_test(runs):
    train, test = runs
    for name in ("EKF", "RAREKF", "lowpass", "strong_tracking", "model"):
        estimator = registry.get(name)
        found = tuning.tune(estimator, train, test, evaluations=40)
        assert found.train[1] <= found.train[0]
        assert found.train[0] == pytest.approx(tuning.score(tuning.errors(estimator, train)))
        assert found.train[1] == pytest.approx(tuning.score(tuning.errors(found.tuned, train)))
        assert found.difference.mean == pytest.approx(np.mean(found.test_tuned - found.test_default))
        assert (name == "model") == (found.values == {})
    ekf = tuning.tune(registry.get("EKF"), train, test, evaluations=40)
    assert ekf.difference.high < 0  # a slow default gains under pushes, on seeds it has not seen


def test_deterministic_on_any_number_of_threads(runs):
    train, test = runs
    rarekf = registry.get("RAREKF")
    once, again = (tuning.tune(rarekf, train, test, 25, threads) for threads in (1, 2))
    assert once.values == again.values and once.train == again.train
    assert np.array_equal(once.test_tuned, again.test_tuned)


def test_settings_without_a_solution_cost_but_do_not_stop(runs):
    train, _ = runs
    impossible = tuning.with_parameters(registry.get("REKF"), {"W": 1.0})
    assert (tuning.errors(impossible, train) > 1e5).all()
    assert tuning.tune(impossible, train, train, 30).train[1] < 1.0


@pytest.mark.long
@pytest.mark.slow
def test_the_joints_dynamics_halve_the_error_of_a_tuned_rarekf():
    """Against one tuning for the three experiments, on starts, paces and pushes that it has not seen: where a count happens to
    lie at rest is worth a factor of three to either, so that one start says nothing."""

    def runs_of(seeds: range) -> list[list[Run]]:
        scenarios = [load_scenario(name) for name in ("no_load", "link_sweep", "external_push")]
        return [[simulate_scenario(varied(s, seed), folder, seed) for seed in seeds] for s, folder in scenarios]

    train, test = runs_of(range(1, 4)), runs_of(range(101, 105))
    rarekf = tuning.tune(registry.get("RAREKF"), train, test, 150)
    ratios = tuning.errors(registry.get("dynamics_ekf"), test, threads=2) / rarekf.test_tuned
    print(f"EKF on the joint's dynamics / tuned RAREKF, seeds 101 to 104: {ratios}; {rarekf.values}")
    assert (np.exp(np.mean(np.log(ratios), axis=1)) <= 0.5).all()


def test_front_of_noise_against_delay(runs):
    _, test = runs
    ekf = registry.get("EKF")
    front = tuning.pareto(ekf, test[0], count=12)
    delay, noise = front.points.T
    assert len(delay) > 6 and (np.diff(delay) > 0).all() and (np.diff(noise) < 0).all()
    # Each point is what its settings give; the default is on the curve of a filter with one tuning parameter, or between
    # its points.
    middle = len(delay) // 2
    again = tuning.noise_and_delay(tuning.with_parameters(ekf, front.settings[middle]), test[0])
    assert again == pytest.approx(front.points[middle])
    assert np.interp(front.default[0], delay, noise) == pytest.approx(front.default[1], rel=0.05)


def test_undominated():
    points = np.array([[1, 5], [2, 4], [2, 6], [3, 4], [0.5, 9], [np.nan, 0], [1, 5]], dtype=float)
    kept = {tuple(points[i]) for i in tuning.undominated(points)}
    assert kept == {(1, 5), (2, 4), (0.5, 9)}


def test_interval():
    """Student's t for three values: t(0.975, 2) = 4.3027."""
    i = interval([1.0, 2.0, 3.0])
    assert (i.mean, i.high - i.mean) == pytest.approx((2.0, 4.302653 / np.sqrt(3)), rel=1e-6)
    assert np.isnan(interval([1.0]).low)


def test_the_file_is_a_scenarios_filters(runs, tmp_path):
    """Every tuned estimator is an entry that a scenario takes, and is then what was tuned, to six digits."""
    train, test = runs
    found = [tuning.tune(registry.get(n), train, test, 20) for n in ("EKF", "RAREKF", "lowpass", "model")]
    tuning.Tuning(("external_push",), (1, 2), (101, 102), {one.name: one for one in found}).write(
        tmp_path / "tuned.yaml"
    )
    data = yaml.safe_load((tmp_path / "tuned.yaml").read_text())
    base, _ = load_scenario("external_push")
    used = Scenario.model_validate({**base.model_dump(), "filters": data["filters"]}).estimators()
    for one in found:
        for field in one.values:
            ours, theirs = getattr(one.tuned, field), getattr(used[one.name], field)
            assert theirs == pytest.approx(ours, rel=1e-5), (one.name, field)
    assert used["RAREKF"].P0 == used["RAREKF"].V
    assert data["rms"]["EKF"]["train"][1] <= data["rms"]["EKF"]["train"][0]


def test_the_papers_start_at_the_measurement():
    assert tuning.with_parameters(registry.get("RAREKF"), {"V": 0.5}).P0 == 0.5


def test_tuning_parameters_in_their_scale():
    parameter = TuningParameter("x", 1e-3, 10.0)
    assert parameter.from_unit(0.5) == pytest.approx(0.1) and parameter.to_unit(0.1) == pytest.approx(0.5)
    assert parameter.from_unit(-1) == 1e-3 and parameter.to_unit(1e9) == 1.0
    assert TuningParameter("y", 1.0, 3.0, "linear").from_unit(0.25) == 1.5


def test_bad_input():
    scenario, folder = load_scenario("torque_feedback", ["duration=2"])
    with pytest.raises(InputError, match="feedback: expected none or sensor"):
        tuning.simulated([(scenario, folder)], [1])
    with pytest.raises(InputError, match="at least one seed"):
        tuning.simulated([load_scenario("no_load")], [])
