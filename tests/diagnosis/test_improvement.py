"""What a diagnosis gains for estimation: counted where no fit has been, and nothing where nothing was measured."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest

from flexspline.diagnosis.answer import Diagnosis
from flexspline.diagnosis.data.segments import SETTINGS, segments
from flexspline.diagnosis.data.stretches import LONGEST, most_telling
from flexspline.diagnosis.extension import calibrated
from flexspline.diagnosis.fit.regions import NormalEquations, held_out_regions
from flexspline.diagnosis.fit.residual import Problem
from flexspline.diagnosis.fit.solver import Fitter
from flexspline.diagnosis.improvement import ESTIMATORS, Improvement, held_out, improvement, removed, with_improvement
from flexspline.diagnosis.search.calibrate import calibrate
from flexspline.diagnosis.trials.draw import Challenge, Draw, draw
from flexspline.estimator.conditioning import condition
from flexspline.estimator.offline import estimate_recording
from flexspline.models.joint_parts import Effect, Estimate

SEED = 31


@cache
def diagnosed() -> tuple[Draw, Diagnosis]:
    """A joint within its tolerances on one sweep at 250 Hz, calibrated: what diagnosis says of it where it finds no cause."""
    print(f"seed {SEED}")
    drawn = draw(Challenge(seed=SEED, hidden="none", scenarios=("link_sweep",)), 0)
    (recording,) = drawn.measurement.recordings
    measurement = replace(drawn.measurement, recordings=(recording.at(slice(None, None, 4)),))
    drawn = replace(drawn, measurement=measurement)
    problem = Problem(*segments(list(measurement.recordings), drawn.nominal), drawn.nominal)
    fit = calibrate(Fitter(problem), iterations=3)
    extended = calibrated(problem, fit, drawn.nominal)
    regions = held_out_regions(problem, fit)
    found = Diagnosis("consistent", (), (), {}, (), {}, {}, regions, extended)
    return drawn, replace(found, problem=problem, search=SimpleNamespace(base=fit), final=fit, whole=fit)


def test_harm_that_only_the_linear_model_predicts_does_not_count():
    """Derivatives about a servo's fit predicted 3e4 times the description's error in a recording; its replay had 1.04."""
    _, found = diagnosed()
    system = NormalEquations(found.problem, found.final)
    predicted = []
    for times in (1e4, 1e6):
        wrong = replace(found.final, jacobian=[times * J for J in found.final.jacobian])
        assert any(r.worse for r in held_out_regions(found.problem, wrong, system))
        predicted.append(held_out_regions(found.problem, wrong, system, replayed=True))
    assert predicted[0] == predicted[1] and not any(r.worse for r in predicted[0]), predicted


@cache
def measured() -> Improvement:
    """What it gains."""
    drawn, found = diagnosed()
    gained = improvement(drawn.measurement, found)
    assert gained is not None
    return gained


def test_calibration_gains_where_no_fit_has_been():
    (_, found), gained = diagnosed(), measured()
    assert gained.quantity == "joint_torque" and gained.main == "RAREKF"
    before, after = gained.errors["RAREKF"]
    assert after < 0.5 * before and after > 0
    answer = with_improvement(found, gained).to_json()["estimation"]
    assert answer["filter"] == "RAREKF" and answer["unit"] == "N·m"
    assert (answer["before"], answer["after"]) == (before, after)
    assert gained.regions, "the regions of the measurement, the one where it gains least first"
    shares = [r.after / r.before for r in gained.regions]
    assert shares == sorted(shares, reverse=True)


def test_errors_on_what_was_kept_are_of_a_fit_that_has_not_seen_it():
    """With one encoder the joint that is written is fitted to these blocks, too."""
    drawn, found = diagnosed()
    gained = improvement(drawn.measurement, replace(found, unseen=drawn.nominal))
    assert gained is not None
    before, after = gained.errors["RAREKF"]
    assert before == measured().errors["RAREKF"][0] and after == pytest.approx(before, rel=1e-9)


def test_what_was_not_written_gains_nothing_anywhere():
    """Of a fit that is taken back altogether the description is left; regions had the whole fit's shift without them."""
    drawn, found = diagnosed()
    back = replace(found, share=0.0, extended=drawn.nominal)
    gained = improvement(drawn.measurement, back)
    assert gained is not None and gained.regions
    assert all(r.before == r.after for r in gained.regions)


def test_errors_are_those_of_the_blocks_that_no_fit_saw():
    (drawn, found), gained = diagnosed(), measured()
    (recording,) = drawn.measurement.recordings
    kept = held_out(recording, 0)
    assert 0.1 < kept.mean() < 0.25, f"every {SETTINGS.held_out_every}th block"
    for segment in found.problem.segments:
        nearest = np.searchsorted(recording.time - recording.time[0], segment.at).clip(0, len(kept) - 1)
        inside = segment.usable.any(axis=1)
        assert np.mean(kept[nearest][inside]) < 0.02, "what was fitted is not counted"
    torque = estimate_recording(recording, found.extended, ("RAREKF",)).torque["RAREKF"]
    rms = float(np.sqrt(np.mean((torque - recording["joint_torque"])[kept] ** 2)))
    assert gained.errors["RAREKF"][1] == pytest.approx(rms, rel=1e-9)


def test_estimates_do_not_read_the_sensor_they_are_held_against():
    drawn, found = diagnosed()
    (recording,) = drawn.measurement.recordings
    lying = {**recording.columns, "joint_torque": recording["joint_torque"] + 5.0}
    one, other = (
        estimate_recording(r, found.extended, ESTIMATORS) for r in (recording, replace(recording, columns=lying))
    )
    for name, values in one.torque.items():
        np.testing.assert_array_equal(values, other.torque[name], err_msg=name)


def test_nothing_is_gained_without_a_sensor():
    drawn, found = diagnosed()
    bare = tuple(r.without("joint_torque") for r in drawn.measurement.recordings)
    gained = improvement(replace(drawn.measurement, recordings=bare), found)
    assert gained is None
    assert with_improvement(found, gained).to_json()["estimation"] is None


def test_a_long_measurement_is_estimated_in_the_parts_of_its_diagnosis():
    """Of five recordings a diagnosis uses three; these are numbered as in its fit."""
    drawn, found = diagnosed()
    (one,) = drawn.measurement.recordings
    still = {name: np.full(len(x), x[0]) for name, x in one.columns.items()}
    recordings = tuple(replace(one, name=f"still{i}", columns=still) for i in range(3))
    long = replace(drawn.measurement, recordings=(*recordings, one, replace(one, name="again")))
    used = most_telling(long)
    places = [r.name for r in used.recordings]
    assert places.index(one.name) < 3
    problem = Problem(*segments(list(used.recordings), drawn.nominal), drawn.nominal)
    fit = calibrate(Fitter(problem), iterations=1)
    gained = improvement(long, replace(found, problem=problem, search=SimpleNamespace(base=fit), final=fit, whole=fit))
    assert gained is not None and [t.name for t in gained.traces] == places
    assert sum(len(t.time) for t in gained.traces) < (LONGEST + 6.0) / one.interval


def test_nothing_is_gained_where_nothing_was_computed():
    drawn, found = diagnosed()
    empty = replace(found, problem=None, search=None, final=None)
    assert improvement(drawn.measurement, empty) is None


def test_what_an_effect_is_worth_to_estimators():
    """Mesh friction twice as large is nothing to a simulation that friction's tolerance follows, and much to an estimate from
    current."""
    drawn, found = diagnosed()
    twice = Effect(name="mesh_friction", parameters={"scale": Estimate(value=2.0, unit="1")})
    other = found.extended.model_copy(update={"effects": [twice]})
    other._path = found.extended._path
    conditioned = [condition(r, drawn.nominal) for r in drawn.measurement.recordings]
    same, more = removed(drawn.measurement, found.extended, [found.extended, other], conditioned)
    assert same == 0.0 and more > 0.1**2
    bare = tuple(r.without("joint_torque") for r in drawn.measurement.recordings)
    assert removed(replace(drawn.measurement, recordings=bare), found.extended, [other], conditioned) == []
