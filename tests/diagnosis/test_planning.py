"""What to measure next: the experiments, what they are expected to tell, and that it is so."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from flexspline.diagnosis.answer import Diagnosis
from flexspline.diagnosis.data.segments import segments
from flexspline.diagnosis.diagnose import diagnose
from flexspline.diagnosis.fit.coordinates import hypotheses
from flexspline.diagnosis.fit.residual import Problem
from flexspline.diagnosis.fit.solver import Fitter
from flexspline.diagnosis.planning import (
    SETTINGS,
    Plan,
    PlannedExperiment,
    Proposal,
    Question,
    _State,
    experiments,
    perform,
    plan,
)
from flexspline.diagnosis.search.identifiability import ALIKE, distance, limits
from flexspline.diagnosis.search.screen import Library
from flexspline.diagnosis.trials.draw import Challenge, drawn_scenarios
from flexspline.diagnosis.trials.motions import waypoints
from flexspline.models import causes
from flexspline.models.joint import Joint, load_joint
from flexspline.models.joint_parts import LOCKED, Effect, Estimate, Mounting
from flexspline.models.recording import Measurement, Recording

BOTH = ("motor_position", "link_position", "motor_current")
ONE = ("motor_position", "motor_current")


@pytest.fixture(scope="module")
def joint() -> Joint:
    return load_joint("test-joint")


def measured(joint: Joint, true: Joint, mounting: str, channels: tuple[str, ...], way: float = 6.0) -> Measurement:
    """There and back, once slower than the other time."""
    points = waypoints([1.3, -1.3, 1.3, 0.0], [0.6 * way, way, 0.7 * way, 0.4 * way], [0.4] * 4, 0.4)
    e = PlannedExperiment("first", "", joint.mount(mounting), tuple(points), frozenset(channels), 1e-3)
    return Measurement("bench", Path(), (perform(e, true, joint, seed=5),))


def hiding(joint: Joint, name: str, **values: float) -> Joint:
    parameters = {q.name: Estimate(value=values[q.name], unit=q.unit) for q in causes.get(name).parameters}
    found = joint.model_copy(update={"effects": [Effect(name=name, parameters=parameters)]})
    found._path = joint._path
    return found


@pytest.fixture(scope="module")
def swing(joint) -> Measurement:
    return measured(joint, joint, "link", BOTH, way=1.6)


def proposed(measurement: Measurement, joint: Joint) -> dict[str, PlannedExperiment]:
    return {e.name: e for e in experiments(measurement, joint, SimpleNamespace(extended=joint))}  # type: ignore[arg-type]


def test_with_one_encoder_load_reversals_lock_and_rest_are_looked_at(joint, swing):
    blind = replace(swing, recordings=(swing.recordings[0].without("link_position"),))
    found = proposed(blind, joint)
    assert {
        "second_payload",
        "slow_reversals",
        "locked_output",
        "rest_poses",
        "fast_sweeps",
        "with_link_position",
    } <= set(found)
    assert all(e.channels == set(ONE) for name, e in found.items() if not name.startswith(("with_", "locked")))
    assert "with_link_position" not in proposed(swing, joint)
    heavy = found["second_payload"].mounting.gravity_moment
    assert blind.recordings[0].link.gravity_moment < heavy <= SETTINGS.heaviest * joint.numbers["rated_torque"].value
    assert all(5 < e.duration < 45 for e in found.values())


def test_a_bolted_link_is_not_asked_to_move(joint, swing):
    """A motion was planned for the bench's inertia, hours of it, where a link without weight stood beside it or nothing did."""
    r = swing.recordings[0]
    bench = replace(r, name="bench", link=Mounting(inertia=LOCKED, gravity_moment=0.0), external="unmeasured")
    free = replace(r, link=joint.mount("no_load"))
    for recordings in ((bench,), (bench, free)):
        found = proposed(replace(swing, recordings=recordings), joint)
        assert all(e.duration < 60 for e in found.values())
        assert all(e.locked or e.mounting.inertia < 10 for e in found.values())


def test_a_bench_in_the_description_is_no_load_to_take_off(joint, swing):
    """Its output is bolted: without weight, and it does not move."""
    bench = Mounting(inertia=LOCKED, gravity_moment=0.0)
    loaded = {name: m for name, m in joint.mountings.items() if m.gravity_moment > 0.0}
    other = joint.model_copy(update={"mountings": {"bench": bench, **loaded}})
    found = proposed(swing, other)
    assert "light_link" not in found and all(e.locked or e.mounting.inertia < 10 for e in found.values())
    for challenge_seed in range(3):
        motions = drawn_scenarios(Challenge(seed=challenge_seed), 0, other)
        assert all(not s.mount(other).locked for s in motions)


def test_experiments_can_be_carried_out(joint, swing):
    N, rated = joint.numbers["N"].value, joint.numbers["rated_torque"].value
    limit = joint.numbers["current_limit"].value
    found = proposed(swing, joint)
    for name in ("fast_sweeps", "slow_reversals", "second_payload", "with_joint_torque"):
        e = found[name]
        recording = perform(e, joint, joint)
        assert set(recording.columns) == set(e.channels), name
        asked = np.interp(recording.time, [w.time for w in e.motion], [w.position for w in e.motion])
        ends = max(abs(w.position) for w in e.motion)
        assert np.max(np.abs(recording["motor_position"])) == pytest.approx(N * ends, rel=0.05), name
        assert abs(recording["motor_position"][-1] / N - asked[-1]) < 0.02, name
        assert np.mean(np.abs(recording["motor_current"]) > 0.98 * limit) < 0.01, name
    locked = replace(found["locked_output"], channels=frozenset({*BOTH, "joint_torque"}))
    recording = perform(locked, joint, joint)
    assert recording.link.locked and recording.external == "unmeasured" and np.ptp(recording["link_position"]) == 0
    assert np.max(np.abs(recording["joint_torque"])) == pytest.approx(SETTINGS.load * rated, rel=0.25)


@pytest.mark.parametrize(("low", "high"), [(-3.14, 0.0), (-1.2, 1.3), (0.2, 2.0), (-0.1, 0.15)])
def test_motions_stay_where_the_joint_has_been_or_ask(joint, swing, low, high):
    """A shoulder that was measured from −3.1 to 0 rad was to be moved through ±1.3 rad, which may be into the table."""
    (one,) = swing.recordings
    angle = low + (high - low) * (one["link_position"] - one["link_position"].min()) / np.ptp(one["link_position"])
    columns = {**one.columns, "link_position": angle, "motor_position": 100.0 * angle}
    moved = replace(swing, recordings=(replace(one, columns=columns),))
    planned = [e for e in proposed(moved, joint).values() if not e.locked]
    assert planned
    for e in planned:
        far = any(not low - 0.1 <= w.position <= high + 0.1 for w in e.motion)
        assert far == ("check for collisions beyond" in e.description), e.description
        assert not far or e.name == "larger_range" or high - low < 0.8


def test_slow_logs_give_slow_experiments(joint, swing):
    slow = replace(swing, recordings=(swing.recordings[0].at(slice(None, None, 4)),))
    assert perform(proposed(slow, joint)["rest_poses"], joint, joint).interval == pytest.approx(4e-3)


def test_a_drives_torque_is_read_where_the_measurement_has_it(joint, swing):
    r = swing.recordings[0]
    columns = {"motor_position": r["motor_position"], "motor_torque": 0.11 * r["motor_current"]}
    other = Measurement("bench", Path(), (Recording("first", r.time, columns, joint=r.joint, link=r.link),))
    found = perform(proposed(other, joint)["sweeps"], joint, joint)
    assert set(found.columns) == set(columns)
    assert np.max(found["motor_torque"]) > 0.05


def test_what_a_measurement_says_is_what_its_limits_say(joint, swing):
    problem = Problem(*segments(list(swing.recordings), joint), joint)
    at = Fitter(problem).fit((), problem.start(None, ()), iterations=2)
    record = problem.calibration.record(np.zeros(problem.calibration.size))
    names = ["torque_constant", "gravity_moment", "payload", "stiffness", "hysteresis", "link_inertia", "cable_spring"]
    tried = [h for name in names for h in hypotheses(causes.get(name), record)]
    weak, alike = limits(problem, at, Library.at(problem, at, tried))
    state = _State(problem, at, tried)
    known = state.information(problem, at.noise, at.jacobian, set(names))
    for name in names:
        z = state.strength(Question((name,), 0.0, SETTINGS.shows), known, known)
        assert (z < SETTINGS.shows) == (name in weak), (name, z)
        twice = state.strength(Question((name,), 0.0, SETTINGS.shows), 2 * known, known)
        assert z <= twice <= np.sqrt(2) * z * (1 + 1e-6) or twice == pytest.approx(z, abs=1e-3), name
    for pair in alike:
        assert state.strength(Question(pair, 0.0, SETTINGS.apart), known, known) < SETTINGS.apart, pair
    assert state.strength(Question(("K1",), 20.0, 40.0, "value"), known, known) == pytest.approx(20.0)
    assert 20.0 < state.strength(Question(("K1",), 20.0, 40.0, "value"), 4 * known, known) <= 40.0


def test_what_does_not_show_is_not_like_everything():
    """A stop beyond the motion, one of three that are tried, and a mass straight below the axis were like every other cause."""
    information = np.diag([400.0, 1e-9, 900.0, 0.5, 100.0])
    information[0, 4] = information[4, 0] = 199.0
    stops, mass, spring = [slice(0, 1), slice(1, 2)], [slice(2, 4)], [slice(4, 5)]
    assert distance(information, stops, mass) == pytest.approx(400.0)
    assert distance(information, mass, spring) == pytest.approx(100.0)
    assert distance(information, stops, spring) < ALIKE
    assert distance(information, [slice(1, 2)], mass) == 0.0


def test_how_large_a_cause_is_whose_parameter_is_called_value(joint, swing):
    """As those of rotor inertia and torque constant are: it is no number of the joint."""
    problem = Problem(*segments(list(swing.recordings), joint), joint)
    record = problem.calibration.record(np.zeros(problem.calibration.size))
    found = hypotheses(causes.get("rotor_inertia"), record)[:1]
    at = Fitter(problem).fit(found, problem.start(None, found), iterations=2)
    state = _State(problem, at, [])
    known = state.information(problem, at.noise, at.jacobian, set())
    question = Question(("rotor_inertia",), 5.0, 10.0, "value")
    assert state.strength(question, known, known) == pytest.approx(5.0)
    assert 5.0 < state.strength(question, 4 * known, known) <= 10.0
    assert SETTINGS.weight(question) == SETTINGS.size != SETTINGS.weight(Question(("K1",), 5.0, 10.0, "value"))


def test_proposals_in_plain_words():
    questions = (
        Question(("backlash",), 0.0, 3.7), Question(("hysteresis",), 1.24, 3.7),
        Question(("torque_constant", "payload"), 1.0, 3.0),
        Question(("friction_asymmetry",), 8.0, 10.0, "ratio"), Question(("K1",), 20.0, 40.0, "value"),
    )  # fmt: skip
    best = Proposal("sweeps", "Move the link", 21.5, (250.0, 9.0, 1.0, 20.0, 50.0))
    found = Plan(questions, (best,))
    assert found.sentences() == [
        "Move the link (22 s): would show backlash by more than 100 standard deviations (now 0), hysteresis by 9.0 (now 1.2); "
        "would know K1 to ±2 % (now ±5 %), friction asymmetry's ratio to ±5 % (now ±12 %)."
    ]
    assert [q.text for q in found.answered(best)] == [
        "backlash", "hysteresis", "how large friction asymmetry's ratio is", "how large K1 is"
    ]  # fmt: skip
    (one,) = found.to_json()
    assert one["experiment"] == "sweeps" and len(one["expected"]) == 5
    assert one["expected"][2] == {
        "about": ["torque_constant", "payload"], "now": 1.0, "expected": 1.0, "needed": 3.0, "unit": "standard deviations",
    }  # fmt: skip


@pytest.mark.slow
def test_a_stub_of_a_recording_is_no_hindrance(joint, swing):
    """Thinned to one sample it was none, at the end of a diagnosis."""
    stub = replace(swing.recordings[0].at(slice(0, 8)), name="stub")
    both = replace(swing, recordings=(swing.recordings[0], stub))
    found = plan(both, diagnose(both, joint, seconds=0.0))
    assert found.proposals


@pytest.mark.slow
def test_experiments_are_weighed_with_sensors_as_they_were_logged(joint, swing):
    """A log of 16 bits of an encoder that is described with 20: what the finer one would say is not promised."""
    told = joint.sensors.link_encoder.model_copy(update={"bits": 16})
    coarse = joint.model_copy(update={"sensors": joint.sensors.model_copy(update={"link_encoder": told})})
    coarse._path = joint._path
    logged = measured(coarse, coarse, "link", BOTH, way=1.6)
    plans = [plan(logged, diagnose(logged, j, seconds=0.0)) for j in (joint, coarse)]
    found, right = ({p.name: p.expected for p in one.proposals} for one in plans)
    assert found.keys() == right.keys()
    for name, each in found.items():
        np.testing.assert_allclose(each, right[name], rtol=0.05, err_msg=name)


def test_nothing_is_planned_where_nothing_was_computed(joint, swing):
    empty = Diagnosis("inconclusive", ("mistakes",), (), {}, (), {}, {}, (), joint)
    assert plan(swing, empty) == Plan()


@pytest.mark.long
@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "values", "mounting", "channels", "experiments_named"),
    [
        ("gravity_moment", {"scale": 1.15}, "no_load", BOTH, ("second_payload",)),
        ("backlash", {"width": 4e-4}, "link", ONE, ("with_link_position", "locked_output")),
    ],
)
def test_what_was_open_is_answered_once_the_plan_is_followed(
    joint, name, values, mounting, channels, experiments_named
):
    true = hiding(joint, name, **values)
    first = measured(joint, true, mounting, channels)
    before = diagnose(first, joint)
    assert name in before.undetermined
    found = plan(first, before)
    assert {p.name for p in found.proposals[: len(experiments_named)]} == set(experiments_named)
    carried_out = {e.name: e for e in experiments(first, joint, before)}
    for proposal in found.proposals[: len(experiments_named)]:
        assert name in [q.names[0] for q in found.answered(proposal)]
        more = perform(carried_out[proposal.name], true, joint, seed=9)
        after = diagnose(replace(first, recordings=(*first.recordings, more)), joint)
        assert name not in after.undetermined
        assert [c.name for c in after.causes] == [name], proposal.name
