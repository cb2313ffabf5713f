"""A scenario's `filters`: every estimator of the registry by its name, with tuning parameters, and what is wrong in an entry."""

from __future__ import annotations

import pytest
import yaml

from flexspline.estimator import registry
from flexspline.estimator.estimator import value_of, with_values
from flexspline.models.errors import InputError
from flexspline.scenarios.experiment import Experiment, estimate, signals_of
from flexspline.scenarios.filters import PAPER, FilterEntry, estimators, parameters_of
from flexspline.scenarios.run import run_scenario
from flexspline.scenarios.scenario import load_scenario

ALL = registry.names()


def entry(given) -> FilterEntry:
    return FilterEntry.model_validate(given)


@pytest.mark.parametrize("name", ALL)
def test_every_estimator_is_an_entry_by_its_name_alone(name):
    found = entry(name)
    assert found.build() == registry.get(name)
    assert found.model_dump() == name


@pytest.mark.parametrize("name", ALL)
def test_every_tuning_parameter_is_a_key(name):
    """The default is one of those that tuning may try, and an entry's value is the estimator's."""
    default = registry.get(name)
    for parameter in default.tuning:
        assert parameter.low <= value_of(default, parameter.field) <= parameter.high, parameter
        value = parameter.from_unit(0.37)
        built = entry({"name": "mine", "estimator": name, parameter.field: value}).build()
        assert built.name == "mine" and value_of(built, parameter.field) == value
        assert built == with_values(default, {"name": "mine", parameter.field: value})


def test_the_papers_by_their_rule():
    mine = entry({"name": "mine", "rule": "rarekf", "k": 0.1, "W": 2e-4, "alpha": "printed"}).build()
    assert (mine.name, mine.rule, mine.k, mine.W, mine.alpha) == ("mine", "rarekf", 0.1, 2e-4, "printed")
    assert [entry({"name": n, "rule": registry.get(n).rule}).build() for n in PAPER] == [registry.get(n) for n in PAPER]


def test_dotted_and_nested_are_the_same():
    dotted = entry({"name": "quick", "estimator": "dynamics_ekf", "process.push": 8})
    nested = entry({"name": "quick", "estimator": "dynamics_ekf", "process": {"push": 8}})
    assert dotted == nested and value_of(dotted.build(), "process.push") == 8.0


def test_what_is_written_is_read_back():
    for given in ("lowpass", {"name": "mine", "rule": "arekf", "W": 3e-4}, {"name": "q", "estimator": "dynamics_ekf"}):
        written = yaml.safe_load(yaml.safe_dump(entry(given).model_dump()))
        assert entry(written) == entry(given)


BAD = {
    "dynamics_efk": "expected one of",
    ("name=mine", "estimator=lowpas"): "did you mean 'lowpass'",
    ("name=mine", "rule=kalman"): "rule: expected one of ['ekf', 'arekf', 'rarekf', 'robust'], got 'kalman'",
    ("name=mine", "rule=rarekf", "kk=1"): "kk: unknown key; did you mean 'k'?",
    ("name=q", "estimator=dynamics_ekf", "process.pusch=8"): "process.pusch: unknown key; did you mean 'process.push'?",
    ("name=mine", "rule=rarekf", "k=many"): "k: expected a finite number, got 'many'",
    ("name=mine", "rule=rarekf", "alpha=3"): "alpha: expected text, got 3",
    ("name=mine", "rule=rarekf", "V=0"): "V [(N·m)²]: expected a finite number > 0, got 0",
    ("name=mine", "k=1"): "expected `estimator` (a name of the registry) or `rule`",
    ("name=mine", "estimater=lowpass"): "did you mean 'estimator'?",
    ("estimator=lowpass",): "name: missing",
    ("name=mine", "rule=[ekf]"): "rule: expected one of",
    ("name=mine", "rule={a: 1}"): "rule: expected one of",
    ("name=mine", "rule="): "rule: expected one of",
    ("name=mine", "estimator=[ekf]"): "estimator: expected one of",
    ("name=1st", "rule=ekf"): "name: expected",
}


@pytest.mark.parametrize("given", BAD, ids=str)
def test_a_wrong_entry_is_one_line(tmp_path, given):
    written = (
        given if isinstance(given, str) else {k: yaml.safe_load(v) for k, _, v in (g.partition("=") for g in given)}
    )
    data = {"name": "s", "duration": 2, "trajectory": [{"time": 0, "position": 0}], "filters": ["EKF", written]}
    (tmp_path / "s.yaml").write_text(yaml.safe_dump(data), encoding="utf-8")
    with pytest.raises(InputError) as caught:
        load_scenario(tmp_path / "s.yaml")
    message = str(caught.value)
    print(message)
    assert "\n" not in message and message.startswith(f"{tmp_path / 's.yaml'}:4: filters.1") and BAD[given] in message


def test_estimators_by_name():
    assert list(estimators()) == list(ALL) and list(estimators(["lowpass", "EKF"])) == ["lowpass", "EKF"]
    with pytest.raises(InputError, match="did you mean 'RAREKF'"):
        estimators(["RAREK"])
    assert "process.push" in parameters_of(registry.get("dynamics_ekf")) and "name" not in parameters_of(
        registry.get("EKF")
    )


def test_every_estimator_runs_in_a_scenario():
    """All at once on threads: each is the same as without the others, under its own name."""
    changes = ["duration=1.5", "transient=0.5", f"filters=[{', '.join(ALL)}, {{name: mine, rule: ekf, W: 1e-3}}]"]
    chosen, folder = load_scenario("external_push", changes)
    run = run_scenario(chosen, folder, threads=3)
    assert tuple(run.estimates) == (*ALL, "mine") and run.estimates["mine"].estimator == "mine"
    experiment = Experiment.of(chosen, folder)
    alone = estimate(estimators(), signals_of(experiment.simulate()), experiment.known)
    for name in ALL:
        assert run.estimate(name).tobytes() == alone[name].mean.tobytes(), name
        assert run.metrics["filters"][name]["rms"] < 5, name
    assert run.metrics["filters"]["lowpass"]["robust_share"] is None
    assert run.model_torque.tobytes() == run.estimate("model").tobytes()
