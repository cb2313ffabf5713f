"""How well an extended joint is known: what a fit states, how it is written, and the bands that come of it."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from hidden_joint import measure

from benchmarks import band_draws as bands
from flexspline.diagnosis.data.segments import segments
from flexspline.diagnosis.extension import calibrated
from flexspline.diagnosis.fit.regions import Region, held_out_regions, region_masks, shrunk, valid_range
from flexspline.diagnosis.fit.residual import Problem
from flexspline.diagnosis.fit.solver import Fit, Fitter, covariances, evaluate_point, with_dispersion
from flexspline.diagnosis.search.calibrate import calibrate
from flexspline.diagnosis.trials.draw import Challenge, Draw, draw
from flexspline.diagnosis.uncertainty import growth, larger, of_description, stated
from flexspline.diagnosis.validate import validate
from flexspline.estimator.offline import beyond_range, estimate_recording, write_estimates
from flexspline.models.calibration import independent_changes, principal
from flexspline.models.joint import Joint, load_joint
from flexspline.models.joint_parts import ValidRange, beyond_sentence
from flexspline.models.recording import Measurement
from flexspline.models.tables import read_table

SEED = 23


@cache
def fitted() -> tuple[Draw, Problem, Fit]:
    """A joint within its tolerances, calibrated on one sweep that goes to one side."""
    print(f"seed {SEED}")
    drawn = draw(Challenge(seed=SEED, hidden="none", scenarios=("link_sweep",)), 0)
    problem = Problem(*segments(list(drawn.measurement.recordings), drawn.nominal), drawn.nominal)
    return (
        drawn,
        problem,
        with_dispersion(problem, calibrate(Fitter(problem), iterations=4)),
    )


def test_what_is_drawn_back_is_known_no_better_than_that():
    """A number that is left as described is off by what the data say of it, and what it leaves cannot be held."""
    drawn, problem, fit = fitted()
    pulled = shrunk(problem, fit, lambda f: abs(f.theta).sum() < 0.6 * abs(fit.theta).sum())
    assert 0.0 < pulled.share < 0.5
    reported = {}
    for share, f in ((1.0, fit), (pulled.share, pulled.fit)):
        joint = calibrated(problem, f, drawn.nominal)
        reported[share] = joint, stated(problem, f, joint, pulled.regions)
    (_, whole), (joint, part) = reported[1.0], reported[pulled.share]
    deviations = dict(zip(part.names, np.sqrt(np.sum(part.matrix**2, axis=1)), strict=True))
    for name in ("Kt", "bw", "Fc"):
        slot = next(s for s in problem.calibration.slots if s.name == name)
        away = abs(joint.numbers[name].value - problem.calibration.value(slot, fit.theta[: problem.calibration.size]))
        print(name, deviations[name], away)
        assert deviations[name] >= 0.99 * away
    for balance in ("motor_current", "joint_torque"):
        assert part.discrepancy[balance] > whole.discrepancy[balance]


def test_bands_hold_what_was_learned_to_be_left():
    """A constant error is nothing that a slow process has: it was in no band, and half of a link's readings lay outside."""
    drawn, problem, fit = fitted()
    off = [r + np.array([0.0, 0.5, 0.0]) for r in fit.point.residual]
    shifted = replace(fit, point=replace(fit.point, residual=off))
    reported = stated(problem, shifted, calibrated(problem, shifted, drawn.nominal), held_out_regions(problem, fit))
    assert reported.discrepancy["joint_torque"] > 0.45


def test_a_description_that_is_left_says_what_it_leaves():
    """Its tolerances do not hold a joint that is beyond them: of a current that nothing explained 68 % lay inside the band."""
    joint = load_joint("test-joint")
    numbers = {k: x.model_copy(update={"tolerance": min(x.tolerance, 0.02)}) for k, x in joint.numbers.items()}
    shared = dict.fromkeys(joint.shared_tolerances, 0.02)
    described = joint.model_copy(update={"numbers": numbers, "shared_tolerances": shared})
    for name, factor in (("Fc", 2.0), ("Fs", 2.0), ("Kt", 0.8)):
        numbers = {**numbers, name: numbers[name].model_copy(update={"value": factor * numbers[name].value})}
    unseen, _, seen = measure(described.model_copy(update={"numbers": numbers}), SEED, exact=True)[0].recordings
    problem = Problem(*segments([seen], described), described)
    reported = of_description(problem, evaluate_point(problem, problem.start(None, ()), ()))
    known = described.model_copy(update={"uncertainty": reported})
    inside = [
        validate(Measurement("m", Path(), (unseen,)), joint).residual["motor_current"].inside
        for joint in (described, known)
    ]
    print(f"seed {SEED}: {inside}")
    assert inside[0] < 0.8 and inside[1] > 0.95
    again = Problem(*segments([seen], known), known)
    assert of_description(again, evaluate_point(again, again.start(None, ()), ())) == reported


@cache
def known() -> tuple[Draw, Joint]:
    """The same joint, stating how well it is known."""
    drawn, problem, fit = fitted()
    found = calibrated(problem, fit, drawn.nominal)
    regions = held_out_regions(problem, fit)
    update = {"valid": valid_range(problem), "uncertainty": stated(problem, fit, found, regions)}
    return drawn, found.model_copy(update=update)


def test_covariance_agrees_with_the_deviations_next_to_the_numbers():
    _, joint = known()
    assert joint.uncertainty is not None
    deviation = dict(zip(joint.uncertainty.names, np.sqrt(np.sum(joint.uncertainty.matrix**2, axis=1)), strict=True))
    for name in ("Kt", "K2", "Fc", "bw", "Kw0"):
        assert deviation[name] == pytest.approx(joint.numbers[name].std, rel=0.5), name
    assert set(joint.uncertainty.discrepancy) == {"motor_current", "joint_torque", "link_balance"}
    assert joint.uncertainty.beyond >= 1


def test_covariance_of_the_numbers_is_the_fits_by_their_derivatives():
    """S C Sᵀ with derivatives S of the numbers by other differences; its root is a triangle with a diagonal above zero."""
    _, problem, fit = fitted()
    _, joint = known()
    slots = problem.calibration.slots
    assert joint.uncertainty.names == [slot.name for slot in slots]

    def numbers(theta: np.ndarray) -> np.ndarray:
        return np.array([problem.calibration.value(slot, theta[: problem.calibration.size]) for slot in slots])

    step = 0.02 * np.eye(len(fit.theta))
    S = np.stack([(numbers(fit.theta + d) - numbers(fit.theta - d)) / 0.04 for d in step], axis=1)
    C = larger(*covariances(problem, fit))
    root = joint.uncertainty.matrix
    scale = np.sqrt(np.diag(S @ C @ S.T))
    np.testing.assert_allclose(root @ root.T / scale[:, None] / scale, S @ C @ S.T / scale[:, None] / scale, atol=5e-3)
    assert np.all(np.diag(root) >= 0) and np.all(root == np.tril(root))
    assert [len(row) for row in joint.uncertainty.factor] == list(range(1, len(slots) + 1))


def test_what_no_description_holds_adds_up_in_power():
    """Processes of four correlation times, independent of each other: 3, 4 and 12 are 13 together; and the torque sensor's
    crosstalk, what was found of it and what is not known, which no number of a description is."""
    drawn, problem, fit = fitted()
    levels = np.zeros_like(fit.noise.discrepancy)
    levels[0, :2], levels[1, 1:4], levels[2, 3] = (3e-3, 4e-3), (0.3, 0.4, 1.2), 0.05
    other = replace(fit, noise=replace(fit.noise, discrepancy=levels))
    found = stated(problem, other, calibrated(problem, fit, drawn.nominal), ()).discrepancy
    at, covariance = problem.size - 1, larger(*covariances(problem, other))
    weight = 0.01 * drawn.nominal.mount("link").gravity_moment
    crosstalk = weight * np.hypot(fit.theta[at], np.sqrt(covariance[at, at]))
    assert 0.1 * weight < crosstalk < 3 * weight
    expected = {
        "motor_current": 5e-3,
        "joint_torque": np.hypot(1.3, crosstalk),
        "link_balance": np.hypot(0.05, crosstalk),
    }
    assert found == pytest.approx(expected, rel=5e-4)  # four digits are written


def test_growth_beyond_the_data_is_what_regions_lost_by_depth():
    """Error gained by not having been seen, over the error, over how far a region's mean lies beyond the rest of the data."""
    _, problem, fit = fitted()
    (segment,), (mask,) = problem.segments, region_masks(problem)["the largest angles"]
    use = segment.usable.any(axis=1) & ~segment.at_rest
    rest = segment.link_position[segment.usable.any(axis=1) & ~mask]
    depth = np.mean(segment.link_position[use & mask] - rest.max()) / np.ptp(rest)

    def region(name: str, gained: float) -> Region:
        return Region(name, False, 500, 10.0, 2.0, 2.0 * np.hypot(1.0, gained), 1.0)

    for gained in (0.1, 0.5):
        assert growth(problem, fit, [region("the largest angles", gained)]) == pytest.approx(
            1 + gained / depth, rel=0.05
        )
    assert growth(problem, fit, [region("the largest angles", 100.0)]) == 31.0, "at most"
    assert growth(problem, fit, [region("the largest angles", 0.0)]) == 1.0
    assert growth(problem, fit, []) == 11.0, "where no region says"
    three = [region(name, 0.2) for name in ("the largest angles", "the smallest angles", "the largest loads")]
    alone = sorted(growth(problem, fit, [one]) for one in three)
    assert growth(problem, fit, three) == alone[1]
    better = Region("the largest angles", False, 500, 10.0, 2.0, 1.0, 1.0)
    assert growth(problem, fit, [better]) == 1.0, "by chance an error is smaller"


def test_written_and_read_again(tmp_path):
    _, joint = known()
    joint.write(tmp_path / "joint.yaml")
    again = load_joint(tmp_path / "joint.yaml")
    assert again.uncertainty == joint.uncertainty and again.valid == joint.valid
    assert len(independent_changes(again)) == len(independent_changes(joint))


def test_independent_changes_have_the_stated_covariance():
    _, joint = known()
    changes = independent_changes(joint)
    for name in ("Kt", "K1", "link_encoder_zero"):
        i = joint.uncertainty.names.index(name)
        together = np.sqrt(sum(c.get(name, 0.0) ** 2 for c in changes))
        assert together == pytest.approx(np.sqrt(np.sum(joint.uncertainty.matrix[i] ** 2)), rel=1e-9)


def test_a_description_of_a_person_is_as_open_as_its_tolerances():
    joint = load_joint("test-joint")
    changes = independent_changes(joint)
    number = joint.numbers["Kt"]
    assert np.sqrt(sum(c.get("Kt", 0.0) ** 2 for c in changes)) == pytest.approx(number.tolerance * number.value)


def test_few_directions_keep_what_matters(rng):
    changes = [{f"x{i}": 1.0} for i in range(6)]
    responses = np.outer(rng.standard_normal(50), [3.0, 4.0, 0, 0, 0, 0]) + 1e-3 * rng.standard_normal((50, 6))
    (one,) = principal(changes, responses, left=0.01, most=4)
    assert abs(one["x0"]) == pytest.approx(0.6, abs=0.01) and abs(one["x1"]) == pytest.approx(0.8, abs=0.01)
    assert principal([], np.empty((50, 0)), 0.01, 4) == []


def test_larger_covariance_of_one_that_rounding_left_not_positive(rng):
    """As one of unknowns that the data determine only together: a Cholesky factor of it ended a diagnosis in a traceback."""
    direction = rng.normal(size=(3, 1))
    singular = direction @ direction.T
    singular[0, 0] *= 1 - 1e-9
    assert np.linalg.eigvalsh(singular).min() < 0
    both = larger(singular, np.eye(3))
    assert np.linalg.eigvalsh(both - singular).min() > -1e-8 and np.linalg.eigvalsh(both - np.eye(3)).min() > -1e-8


def test_larger_covariance_is_at_least_both(rng):
    A, B = (x @ x.T + 0.1 * np.eye(5) for x in rng.standard_normal((2, 5, 5)))
    both = larger(A, B)
    for one in (A, B):
        assert np.linalg.eigvalsh(both - one).min() > -1e-9
    assert np.linalg.eigvalsh(A + B - both).min() > -1e-9, "no larger than need be"
    a, b = np.diag([1.0, 4.0, 9.0]), np.diag([2.0, 3.0, 9.0])
    np.testing.assert_allclose(larger(a, b), np.diag([2.0, 4.0, 9.0]), rtol=1e-9, atol=1e-9)
    units = np.diag([1e-9, 1.0, 1e6])
    np.testing.assert_allclose(larger(units @ a @ units, units @ b @ units), units @ larger(a, b) @ units, rtol=1e-9)
    np.testing.assert_allclose(larger(A, 0.5 * A), A, rtol=1e-9)


def test_bands_widen_beyond_the_data():
    drawn, joint = known()
    wide = joint.uncertainty.model_copy(update={"beyond": 20.0, "discrepancy": {"motor_current": 0.02}})
    low, high = joint.valid.link_position
    narrow = joint.valid.model_copy(update={"link_position": [low, 0.5 * (low + high)]})
    there = joint.model_copy(update={"uncertainty": wide, "valid": narrow})
    one, other = (validate(drawn.measurement, j).recordings[0] for j in (joint, there))
    beyond = one.moving & (one.angle > 0.6 * high)
    ratio = np.median(other.deviation["motor_current"][beyond]) / np.median(one.deviation["motor_current"][beyond])
    assert ratio > 2


def test_estimates_carry_bands_that_hold_the_torque(tmp_path):
    drawn, joint = known()
    recording = drawn.measurement.recordings[0].at(slice(None, None, 4))
    found = estimate_recording(recording, joint, ("RAREKF", "current"), bands=True)
    plain = estimate_recording(recording, joint, ("RAREKF", "current"))
    assert plain.deviation == {}
    for name in ("RAREKF", "current"):
        np.testing.assert_array_equal(found.torque[name], plain.torque[name])
        error = np.abs(found.torque[name] - recording["joint_torque"])
        noise = joint.sensors.joint_torque.noise
        inside = np.mean(error <= 1.96 * np.hypot(found.deviation[name], noise))
        assert inside > 0.9, name
        assert np.median(found.deviation[name]) < 0.05 * joint.numbers["rated_torque"].value, name
    columns, notes = read_table(write_estimates(found, tmp_path))
    assert notes["torque_RAREKF_low"]["unit"] == "N·m"
    assert np.all(columns["external_torque_current_low"] <= columns["external_torque_current_high"])


def test_what_is_beyond_is_told_by_estimates():
    drawn, joint = known()
    recording = drawn.measurement.recordings[0]
    assert beyond_range(recording, drawn.nominal) == {}
    assert set(beyond_range(recording, joint)) <= {"joint_torque", "link_velocity"}, "it is the range of these data"
    narrow = ValidRange(link_position=[-0.3, 0.3], link_velocity=[-3, 3], joint_torque=[-30, 30])
    found = beyond_range(recording, joint.model_copy(update={"valid": narrow}))
    assert set(found) == {"link_position"} and "link angle" in beyond_sentence(found)


def test_a_run_tells_that_it_leaves_the_range(tmp_path, flexspline):
    import flexspline as fs

    _, joint = known()
    valid = joint.valid.model_copy(update={"link_position": [-0.05, 0.05]})
    joint.model_copy(update={"valid": valid}).write(tmp_path / "joint.yaml")
    run = fs.simulate("link_sweep", duration=8, joint=str(tmp_path / "joint.yaml"))
    assert run.beyond["link_position"] > 0.05
    assert any("extrapolated" in note for note in run.notes)


@pytest.mark.long
@pytest.mark.slow
@pytest.mark.parametrize("real", [False, True])
def test_bands_hold_where_the_fit_has_not_been(real):
    """One draw each way; `bands` is how the numbers in the documentation were measured over many."""
    part = bands.diagnosed_part(Challenge(seed=5, hidden="none", real=real), 0)
    for name, held in bands.channels_held(part).items():
        assert held.samples > 5000 and 0.8 < held.inside, (name, held)
    for name, held in bands.estimates_held(part, ("RAREKF", "current")).items():
        assert 0.8 < held.inside, (name, held)


def test_one_encoder_has_bands_too():
    drawn, joint = known()
    recordings = tuple(r.without("link_position") for r in drawn.measurement.recordings)
    found = validate(Measurement("one encoder", Path(), recordings), joint)
    assert found.residual["motor_current"].inside > 0.9
