"""Estimators over a run that is over: what they say there is what they said in the loop."""

from __future__ import annotations

import numpy as np
import pytest
from flexspline.estimator import baselines, run_batch
from flexspline.estimator.knobs import Knob
from flexspline.models.errors import InputError
from flexspline.scenarios import offline
from flexspline.scenarios.run import run_scenario
from flexspline.scenarios.scenario import FilterChoice, load_scenario


@pytest.fixture(scope="module")
def run():
    scenario, folder = load_scenario("external_push", ["duration=9"], seed=4)
    printed = FilterChoice(name="printed", rule="rarekf", alpha="printed", k=0.3, W=3e-4)
    return run_scenario(scenario.model_copy(update={"filters": [*scenario.filters, printed]}), folder)


def test_offline_is_in_the_loop_to_the_bit(run):
    """Every number of a filter, not only its estimate, from the stored measurement."""
    for settings in run.settings:
        history = run_batch(settings, run.model_torque[None])
        assert np.array_equal(history.torque[0], run.estimate(settings.name))
        assert np.array_equal(history.P[0, :, 0, 0], run._filter(settings.name, "variance"))
        assert np.array_equal(history.innovation[0, :, 0], run.innovation(settings.name))
        assert np.array_equal(history.nis[0], run.nis(settings.name))
        assert np.array_equal(history.robust[0], run.robust(settings.name))
    for contender in offline.contenders(["EKF", "AREKF", "RAREKF", "REKF"]):
        assert np.array_equal(contender.estimate(run).torque, run.estimate(contender.name))


def test_the_raw_model_of_the_baselines_is_the_loops(run):
    ours = offline.contenders(["compliance_model"])[0].estimate(run).torque
    assert np.allclose(ours[1:], run.model_torque[1:], atol=1e-12)


def test_contenders(run):
    everyone = offline.contenders()
    assert {c.name for c in everyone} == {"EKF", "AREKF", "RAREKF", "REKF", *baselines.names()}
    with pytest.raises(InputError, match="did you mean 'RAREKF'"):
        offline.contenders(["RAREK"])
    for contender in everyone:
        for knob in contender.knobs:
            # The default lies inside what tuning may try, and a turned knob stands where it was turned to.
            assert knob.low < contender.value(knob) < knob.high, (contender.name, knob)
            assert contender.turned({knob.field: 1.5 * knob.low}).value(knob) == 1.5 * knob.low
    rarekf = next(c for c in everyone if c.name == "RAREKF").turned({"V": 0.5})
    assert rarekf.settings.P0 == 0.5 and rarekf.settings.name == "RAREKF"


def test_knobs():
    knob = Knob("x", 1e-3, 10.0)
    assert knob.from_unit(0.5) == pytest.approx(0.1) and knob.to_unit(0.1) == pytest.approx(0.5)
    assert knob.from_unit(-1) == 1e-3 and knob.to_unit(1e9) == 1.0
    assert Knob("y", 1.0, 3.0, "linear").from_unit(0.25) == 1.5


def test_true_states(run):
    states = offline.true_states(run)
    assert np.array_equal(states[:, 0], run.truth("motor_position"))
    assert np.array_equal(states[:, 6], run.truth("link_velocity"))
    assert np.array_equal(states[:, 7], run.external_torque)
    assert offline.sensor_noise(run.joint) == baselines.SensorNoise()
