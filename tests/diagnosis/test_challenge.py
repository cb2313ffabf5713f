"""Hide an effect in a simulated joint, hand over only the recordings and the nominal joint, require that it is found."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import numpy as np
import pytest

from flexspline.diagnosis.answer import Diagnosis
from flexspline.diagnosis.diagnose import diagnose
from flexspline.diagnosis.fit.replay import residual
from flexspline.diagnosis.trials import score
from flexspline.diagnosis.trials.draw import Challenge, Draw, HiddenEffect, _effects, draw, within_tolerance
from flexspline.diagnosis.trials.imperfections import imperfections
from flexspline.diagnosis.trials.motions import bare, motions, record_motion
from flexspline.diagnosis.trials.outside import OUTSIDE
from flexspline.diagnosis.trials.score import Outcome, Rate
from flexspline.models import causes, laws
from flexspline.models.calibration import Calibration
from flexspline.models.errors import InputError
from flexspline.models.joint import load_joint
from flexspline.models.recording import Measurement, read_measurement
from flexspline.scenarios.scenario import Scenario, Waypoint

pytestmark = pytest.mark.long
SEED = 7
NOMINAL = load_joint("test-joint")


@lru_cache(maxsize=1)
def diagnosed(name: str, **options) -> tuple[Draw, Diagnosis]:
    """The first draw of that cause, diagnosed."""
    challenge = Challenge(seed=SEED, only=(name,) if name else (), **options)
    drawn = draw(challenge, 0)
    print(f"{challenge}, draw 0: hidden {[(e.name, e.values) for e in drawn.effects]}")
    return drawn, diagnose(drawn.measurement, drawn.nominal)


def held_out_loss(found: Diagnosis, residuals: list[np.ndarray]) -> float:
    """Sum over channels of the mean square of the residuals on held-out samples in motion, in units of the noise."""
    total = 0.0
    for c, channel in enumerate(("motor_current", "joint_torque", "link_balance")):
        if channel not in found.residual:
            continue
        parts = [r[d.held_out[:, c] & ~d.at_rest, c] for d, r in zip(found.problem.segments, residuals, strict=True)]
        total += float(np.mean(np.concatenate(parts) ** 2)) / found.residual[channel].noise ** 2
    return total


def true_residuals(drawn: Draw, found: Diagnosis) -> list[np.ndarray]:
    """Residuals of the joint as it really is, with what is hidden in it."""
    return [residual(drive, drawn.records[drive.recording]) for drive in found.problem.segments]


def require_found(drawn: Draw, found: Diagnosis) -> None:
    """Verdict, name, parameters within three standard deviations or 15 %, and 80 % of what the true model gains."""
    (effect,) = drawn.effects
    said = [(c.name, round(c.confidence, 2), c.description) for c in found.causes]
    assert found.verdict == "discrepancy", f"{effect.name} {effect.values}: {found.verdict}"
    assert found.causes[0].name == effect.name, f"{effect.name} {effect.values}: named {said}"
    assert found.causes[0].component == effect.component
    for q in causes.get(effect.name).parameters:
        if q.integer:
            assert found.causes[0].parameters[q.name].value == effect.values[q.name]
    errors = score.deviations(drawn, found)
    wrong = {k: v for k, v in errors.items() if not (v[0] <= 3.0 or v[1] <= 0.15)}
    assert not wrong, f"{effect.name}: parameters off by (standard deviations, share): {wrong}"
    before, after = held_out_loss(found, found.before), held_out_loss(found, found.after)
    gained, possible = before - after, before - held_out_loss(found, true_residuals(drawn, found))
    assert gained >= 0.8 * possible, f"{effect.name}: gained {gained:.4g} of {possible:.4g}"


OFF = pytest.mark.xfail(
    strict=True, reason="its coefficients lie 3.2 and 3.0 deviations off, 17 %, along the torque constant"
)


@pytest.mark.slow
@pytest.mark.parametrize("name", [pytest.param(n, marks=OFF) if n == "back_driving" else n for n in Challenge().pool()])
def test_every_cause_is_found(name):
    require_found(*diagnosed(name))


@pytest.mark.slow
@pytest.mark.parametrize("name", ["stiffness", "torque_constant"])
def test_tenth_of_an_effect_is_found_in_a_joint_that_is_known_exactly(name):
    drawn = draw(Challenge(seed=SEED, only=(name,), exact=True), 0, 0.1)
    assert Calibration(drawn.nominal).size == 0
    require_found(drawn, diagnose(drawn.measurement, drawn.nominal))


@pytest.mark.slow
@pytest.mark.parametrize("index", range(3))
def test_nothing_hidden_is_no_alarm(index):
    drawn = draw(Challenge(seed=SEED, hidden="none"), index)
    found = diagnose(drawn.measurement, drawn.nominal)
    assert found.verdict == "consistent", [(c.name, c.confidence) for c in found.causes]
    assert found.causes == ()


@pytest.mark.slow
@pytest.mark.parametrize("index", [14, 29])
def test_a_cause_is_as_general_as_the_data_ask_for(index):
    """Of load-dependent friction, and of one that is another when the load drives, the one that is there. Where the general
    one adds just what it must it may be either: then neither is sure, and both are reported."""
    drawn = draw(Challenge(seed=206, hidden="one"), index)
    found = diagnose(drawn.measurement, drawn.nominal)
    hidden = [e.name for e in drawn.effects]
    assert hidden[0] in ("load_dependent_friction", "back_driving")
    (named,) = found.causes
    undecided = named.confidence < 0.7 and ("back_driving", "load_dependent_friction") in found.confusable
    assert named.name == hidden[0] or undecided, (named.name, named.confidence, found.confusable)


@pytest.mark.slow
def test_a_late_torque_sensor_is_no_damping_of_the_link():
    """1.6 ms at 24 Hz are a quarter of a radian: what swings came out four times as damped, and 1.3 times as large."""
    drawn = draw(Challenge(seed=631, real=True, only=("link_flexibility",)), 2)
    found = diagnose(drawn.measurement, drawn.nominal)
    (true,) = (e.values for e in drawn.effects)
    (reported,) = (c.parameters for c in found.causes if c.name == "link_flexibility")
    assert reported["share"].value == pytest.approx(true["share"], rel=0.08)
    assert reported["damping"].value == pytest.approx(true["damping"], rel=0.25)
    late = found.calibration["torque_sensor_delay"]
    assert late.value == pytest.approx(drawn.imperfections.values["torque_delay"], abs=0.2e-3)
    assert found.extended.sensors.joint_torque.delay == late.value


@pytest.mark.slow
@pytest.mark.parametrize(
    ("sensor", "name", "late"),
    [("joint_torque", "torque_sensor_delay", 4e-3), ("motor_current", "current_delay", 3e-3)],
)
def test_a_late_reading_is_no_cause(sensor, name, late):
    """Too little for a mistake in the data: a link that is not rigid was named at 0.99, or 15 mA were left of a current."""
    drawn = draw(Challenge(seed=655, hidden="none"), 1)
    recordings = tuple(
        replace(r, columns={**r.columns, sensor: np.interp(r.time - late, r.time, r[sensor])})
        for r in drawn.measurement.recordings
    )
    found = diagnose(replace(drawn.measurement, recordings=recordings), drawn.nominal)
    assert found.verdict == "consistent" and found.causes == found.mistakes == ()
    assert found.calibration[name].value == pytest.approx(late, abs=0.4e-3)
    assert "later than described" in found.reason
    residual = found.residual["joint_torque" if sensor == "joint_torque" else "motor_current"]
    assert residual.after < 1.3 * residual.noise


@pytest.mark.slow
def test_what_two_causes_share_is_not_sure():
    """An eccentricity was reported as half of one and a kinematic error once per turn, both at 0.99, 8 deviations off."""
    drawn = draw(Challenge(seed=657), 17)
    found = diagnose(drawn.measurement, drawn.nominal)
    (hidden,) = (e.name for e in drawn.effects)
    assert hidden == "motor_encoder_eccentricity" and hidden in [c.name for c in found.causes]
    if len(found.causes) > 1:
        assert all(c.confidence <= 0.7 for c in found.causes)
        assert ("kinematic_error", hidden) in found.confusable


@pytest.mark.slow
def test_counts_that_shake_a_heavy_rotor_are_no_unknown_effect():
    """0.6 N·m were left, the fit in a place in which the counts' noise is less, and an unknown effect was reported at 0.95."""
    drawn = draw(Challenge(joint="csg-17-80-ec60", seed=801, real=True), 4)
    found = diagnose(drawn.measurement, drawn.nominal)
    require_found(drawn, found)
    assert not [c for c in found.causes if c.name == "unknown"]


@pytest.mark.slow
def test_a_torque_constant_is_no_gain_and_gravity_moment_for_want_of_inertia():
    """Reported as a torque sensor's gain and a gravity moment at 0.99: the counts' noise in accelerations decided; a cause of no
    size was kept because a fit without it, made elsewhere before, was worse."""
    drawn = draw(Challenge(seed=679, hidden="two"), 20)
    found = diagnose(drawn.measurement, drawn.nominal)
    assert (
        {c.name for c in found.causes} == {e.name for e in drawn.effects} == {"torque_constant", "friction_asymmetry"}
    )
    (reported,) = (c.parameters["value"] for c in found.causes if c.name == "torque_constant")
    (true,) = (e.values["value"] for e in drawn.effects if e.name == "torque_constant")
    assert abs(reported.value - true) < 3 * reported.std < 0.03 * true


@pytest.mark.slow
def test_one_of_many_orders_that_is_hardly_there_is_not_sure():
    """A cogging of 1.1 ± 0.36 mN·m that is not there, 3.1 deviations from absent, was reported at 0.99; with twenty orders
    and more to choose from, one is that far by chance."""
    drawn = draw(Challenge(seed=811, real=True, sensor=False), 16)
    confidence = {c.name: c.confidence for c in diagnose(drawn.measurement, drawn.nominal).causes}
    assert confidence["rotor_inertia"] > 0.9 and confidence.get("cogging", 0.0) < 0.9


@pytest.mark.slow
def test_rows_in_which_alone_the_load_shakes_count():
    """The only recording with a load, a fortieth of all rows, was left out as of extreme leverage: consistent, 0.14 N·m left."""
    drawn = draw(Challenge(seed=621, real=True), 6)
    require_found(drawn, diagnose(drawn.measurement, drawn.nominal))


NO_TELLING = pytest.mark.xfail(
    strict=True, reason="the general one adds 3 to the log evidence: its special case, at 0.83"
)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("challenge", "index"),
    [
        pytest.param(Challenge(seed=353, real=True), 22, marks=NO_TELLING),
        (Challenge(seed=902, only=("load_dependent_friction",)), 4),
    ],
    ids=["general", "special"],
)
def test_neither_a_cause_nor_its_special_case_stands_for_the_other(challenge, index):
    """Fits from places and with weights of their own differ by tens: a back-driving was its special case, at 0.81, as the general
    model, which cannot be less likely, came out 83 worse."""
    drawn = draw(challenge, index)
    found = diagnose(drawn.measurement, drawn.nominal)
    (hidden,) = (e.name for e in drawn.effects)
    assert hidden in ("load_dependent_friction", "back_driving")
    assert found.causes[0].name == hidden, [(c.name, c.confidence) for c in found.causes]


@pytest.mark.slow
@pytest.mark.parametrize(("seed", "only", "index"), [
    (562, "load_dependent_friction", 0), (562, "load_dependent_friction", 8), (561, "back_driving", 6),
])  # fmt: skip
def test_a_friction_that_is_taken_for_another_is_not_told_as_sure(seed, only, index):
    """Half of what both differ by is a torque constant. Where that ended at its limit one was reported for the other at 0.99."""
    drawn = draw(Challenge(seed=seed, only=(only,), real=True), index)
    found = diagnose(drawn.measurement, drawn.nominal)
    wrong = [c for c in found.causes if c.name in {"load_dependent_friction", "back_driving"} - {only}]
    assert all(c.confidence < 0.9 for c in wrong), [(c.name, c.confidence) for c in found.causes]


@pytest.fixture(scope="module")
def next_to_a_stop():
    """Of a hard stop with a rotor's inertia: variances of what is known next to it were once below zero by rounding."""
    drawn = draw(Challenge(seed=579, hidden="two"), 10)
    return diagnose(drawn.measurement, drawn.nominal)


@pytest.mark.slow
def test_a_variance_of_rounding_alone_is_no_error(next_to_a_stop):
    """The diagnosis ended in one."""
    assert next_to_a_stop.causes[0].name == "hard_stop"
    assert {c.name for c in next_to_a_stop.causes if c.confidence >= 0.9} <= {"hard_stop", "rotor_inertia"}


@pytest.mark.slow
@pytest.mark.xfail(strict=True, reason="an order of the link encoder's error takes its place, at 0.7")
def test_a_rotor_inertia_is_found_next_to_a_stop(next_to_a_stop):
    found = {c.name: c.confidence for c in next_to_a_stop.causes}
    assert {"hard_stop", "rotor_inertia"} <= set(found), found


@pytest.mark.slow
def test_a_reading_that_drifts_is_no_sure_offset():
    """Slow discrepancy holds what an offset leaves of a drift: the simulation's error, which the drift halves, says more."""
    drawn = draw(Challenge(seed=233, hidden="outside", real=True), 8)
    assert "drifts" in drawn.effects[0].description
    found = diagnose(drawn.measurement, drawn.nominal)
    named = [*found.causes, *found.minor]
    assert "unknown" in {c.name for c in named}
    assert all(c.confidence < 0.9 for c in named if c.name == "current_offset")


@pytest.mark.slow
@pytest.mark.parametrize("index", [4, 41])
def test_no_inertia_just_beyond_its_tolerance_next_to_the_cause(index):
    """Noise in the derivatives pulls the wave generator's inertia; the rotor's must not be called another for that."""
    drawn = draw(Challenge(seed=206, hidden="one"), index)
    found = diagnose(drawn.measurement, drawn.nominal)
    assert [c.name for c in found.causes] == [e.name for e in drawn.effects]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("challenge", "index"),
    [
        (Challenge(seed=361, hidden="none", real=True), 2),
        (Challenge(seed=372, only=("backlash",)), 0),
    ],
    ids=["none", "backlash"],
)
def test_without_load_no_backlash_is_sure(challenge, index):
    """A real joint's resonance was mistaken for a backlash of 0.18 ± 0.04 mrad, at 0.99; with one it looks no different."""
    drawn = draw(challenge, index)
    (free,) = (r for r in drawn.measurement.recordings if r.name == "free")
    found = diagnose(replace(drawn.measurement, recordings=(free,)), drawn.nominal)
    confidence = {c.name: c.confidence for c in found.causes}.get("backlash", 0.0)
    assert confidence <= 0.7 and (confidence >= 0.5 or challenge.hidden == "none")


@pytest.mark.slow
def test_orders_next_to_an_unknown_friction_contribute_little():
    """1382 N·m, of a friction of 3.5 mN·m: in rows that no fit counts the unknown effect, put in its place, did anything."""
    drawn = draw(Challenge(seed=920, hidden="outside"), 3)
    found = diagnose(drawn.measurement, drawn.nominal)
    assert found.causes[0].name == "unknown" and found.causes[0].component == "transmission"
    assert all(c.contribution < 2.0 for c in (*found.causes, *found.minor))


@pytest.mark.slow
def test_three_orders_of_a_law_of_the_links_angle_are_any_law():
    """A friction that steps at an angle was reported as three orders, at 0.99 each."""
    drawn = draw(Challenge(seed=920, hidden="outside"), 21)
    found = diagnose(drawn.measurement, drawn.nominal)
    assert found.causes and all(c.component == "transmission" and c.confidence <= 0.7 for c in found.causes)


@pytest.mark.slow
def test_numbers_at_the_end_of_their_tolerances_are_told():
    """A stiffness so much off that tolerances just express it is no cause, and not passed over either."""
    drawn = draw(Challenge(seed=214, hidden="one", real=True), 11)
    assert [e.name for e in drawn.effects] == ["stiffness"]
    found = diagnose(drawn.measurement, drawn.nominal)
    reported = "at the bound of the tolerance: K1 (-2"
    assert "stiffness" in {c.name for c in found.causes} or reported in found.reason, found.reason


@pytest.mark.slow
@pytest.mark.parametrize("index", [7, 35])
def test_what_real_joints_have_in_addition_does_not_hide_the_cause(index):
    """Not quite viscous friction is no unknown effect; a resonance without a contribution keeps no cause from being fitted."""
    drawn = draw(Challenge(seed=205, hidden="one", real=True), index)
    found = diagnose(drawn.measurement, drawn.nominal)
    assert found.causes[0].name == drawn.effects[0].name, [(c.name, c.confidence) for c in found.causes]


@pytest.mark.slow
def test_what_was_known_before_is_no_less_sure_for_what_nothing_explains():
    """Of mesh friction the data determine the product with its tolerance: Birge's ratio does not touch what separates the two."""
    drawn = draw(Challenge(seed=214, hidden="one", real=True), 7)
    assert [e.name for e in drawn.effects] == ["mesh_friction"]
    found = diagnose(drawn.measurement, drawn.nominal)
    assert {c.name: c.confidence for c in found.causes}.get("mesh_friction", 0.0) > 0.9


@pytest.mark.slow
def test_a_late_encoder_is_followed_from_far_away():
    """Ten milliseconds are tens of newton metres: derivatives that were taken over from a smaller delay lead astray."""
    drawn = draw(Challenge(seed=231, hidden="one", real=True), 6)
    assert [e.name for e in drawn.effects] == ["encoder_delay"]
    found = diagnose(drawn.measurement, drawn.nominal)
    delay = found.causes[0].parameters["seconds"]
    assert abs(delay.value - drawn.effects[0].values["seconds"]) < 3 * delay.std
    assert "unknown" not in {c.name for c in found.causes}


@pytest.mark.slow
def test_of_what_is_worth_about_the_same_the_likelier_is_taken():
    """A gravity moment 10 % up was reported as a torque sensor's gain at 0.99: a little better in the linear model, and less
    likely by 54, while a third that was likelier than both kept the two from being held against each other. A torque constant and
    a sensor's gain together do nearly what it does: what is not sure for that says so."""
    drawn = draw(Challenge(seed=481, hidden="one", real=True), 42)
    said = diagnose(drawn.measurement, drawn.nominal)
    found = {c.name: c for c in said.causes}
    others = {"torque_constant", "torque_sensor_gain"}
    assert found["gravity_moment"].confidence > 0.5 and not others & {*found}
    reported = {name for pair in said.confusable if "gravity_moment" in pair for name in pair}
    assert found["gravity_moment"].confidence > 0.9 or others <= reported
    assert all(error < 3 for error, _ in score.deviations(drawn, said).values())


@pytest.mark.slow
@pytest.mark.parametrize(
    ("seed", "hidden", "index"), [(571, "one", 34), (573, "two", 1), (611, "one", 36), (603, "two", 36)]
)
def test_a_hysteresis_that_a_ripple_winds_is_found_next_to_the_ripple(seed, hidden, index):
    """Neither shows without the other; taking the largest contribution first ended at 8 and 11 times the sensors' noise, the
    verdict at inconclusive."""
    drawn = draw(Challenge(seed=seed, hidden=hidden, real=True), index)
    confidence = {c.name: c.confidence for c in diagnose(drawn.measurement, drawn.nominal).causes}
    assert all(confidence.get(e.name, 0.0) > 0.9 for e in drawn.effects), confidence


@pytest.mark.slow
def test_effects_that_are_minor_only_for_not_being_well_known_are_not_consistent():
    """A hysteresis and a friction that drifts, next to so much that no description holds that neither is sure."""
    drawn = draw(Challenge(seed=573, hidden="two", real=True), 17)
    found = diagnose(drawn.measurement, drawn.nominal)
    assert {e.name for e in drawn.effects} <= {c.name for c in (*found.causes, *found.minor)}
    assert found.causes or found.verdict == "inconclusive"
    assert found.causes or all(e.name.replace("_", " ") in found.reason for e in drawn.effects)


@pytest.mark.slow
@pytest.mark.parametrize("index", [2, 18, 26, 44, 48])
def test_what_two_causes_together_make_is_not_told_as_another_for_sure(index):
    """Of a torque constant, a sensor's gain and a gravity moment two may make what the third does, and a back-driving is nearly a
    friction with a torque constant: one of them was reported at 0.91 to 0.99 in the others' place."""
    drawn = draw(Challenge(seed=593, hidden="two", real=True), index)
    hidden = {e.name for e in drawn.effects}
    wrong = {
        c.name: c.confidence
        for c in diagnose(drawn.measurement, drawn.nominal).causes
        if c.name not in hidden and not causes.get(c.name).imperfection
    }
    assert all(confidence < 0.9 for confidence in wrong.values()), (hidden, wrong)


@pytest.mark.slow
def test_an_encoder_as_late_as_can_be_is_found_from_the_described_joint():
    """At 10.7 ms the zero of the encoder goes aside with it: no size came close until both moved, and a torque sensor's gain of
    six times its ordinary size was fitted instead."""
    drawn = draw(Challenge(seed=591, hidden="one", real=True), 49)
    first = diagnose(drawn.measurement, drawn.nominal).causes[0]
    assert first.name == "encoder_delay" and first.confidence > 0.9
    assert (
        abs(first.parameters["seconds"].value - drawn.effects[0].values["seconds"])
        < 3 * first.parameters["seconds"].std
    )


@pytest.mark.slow
def test_rivals_are_compared_next_to_all_other_causes():
    """A current offset gains more than asymmetric friction while viscous friction is missing, and much less next to it."""
    drawn = draw(Challenge(seed=213, hidden="two", real=True), 4)
    hidden = {e.name for e in drawn.effects}
    assert hidden == {"viscous_friction", "friction_asymmetry"}
    confidence = {c.name: c.confidence for c in diagnose(drawn.measurement, drawn.nominal).causes}
    assert all(confidence.get(name, 0.0) > 0.9 for name in hidden), confidence
    assert "current_offset" not in confidence


@pytest.mark.slow
def test_of_places_that_look_the_same_the_usual_one_is_named():
    drawn = draw(Challenge(seed=212, hidden="outside", real=True), 1)
    found = diagnose(drawn.measurement, drawn.nominal)
    assert (found.causes[0].name, found.causes[0].component) == ("unknown", "motor")


@pytest.mark.slow
def test_slow_discrepancy_does_not_hold_an_unknown_effect():
    """Friction that grows with the square of velocity is not plainly viscous, though a slow discrepancy takes the rest."""
    drawn = draw(Challenge(seed=204, hidden="outside", real=True), 1)
    found = diagnose(drawn.measurement, drawn.nominal)
    assert "unknown" in {c.name for c in found.causes}
    assert all(c.confidence < 0.9 for c in found.causes if c.name == "viscous_friction")


@pytest.mark.slow
@pytest.mark.parametrize("pair", [("cogging", "cable_spring"), ("friction_asymmetry", "torque_sensor_offset")])
def test_two_causes_at_once(pair):
    drawn = draw(Challenge(seed=SEED, hidden="two", only=pair), 0)
    found = diagnose(drawn.measurement, drawn.nominal)
    assert found.verdict == "discrepancy"
    assert {c.name for c in found.causes} == {e.name for e in drawn.effects}


@pytest.mark.slow
@pytest.mark.parametrize("name", list(OUTSIDE))
def test_effect_outside_the_library_is_unknown(name):
    drawn, found = diagnosed(name, hidden="outside")
    assert found.verdict == "discrepancy"
    assert found.causes[0].name == "unknown", [(c.name, c.confidence) for c in found.causes]
    assert found.causes[0].component == drawn.effects[0].component, found.causes[0].description
    assert found.causes[0].depends_on
    (written,) = found.extended.discrepancies
    spline = found.final.model[-1]
    assert written == spline.as_discrepancy(found.final.theta[-spline.count :]), (
        "as the fit has it that the joint is made of"
    )


@pytest.mark.slow
@pytest.mark.parametrize("name", ["friction_asymmetry", "hard_stop"])
def test_found_without_torque_sensor(name):
    drawn, found = diagnosed(name, sensor=False)
    assert found.causes[0].name == drawn.effects[0].name, [(c.name, c.confidence) for c in found.causes]
    assert "torque_sensor_gain" in found.undetermined
    assert "joint_torque" not in found.residual


@pytest.mark.parametrize("position", [0.0, 0.5])
def test_standing_still_cannot_tell(position):
    scenario = Scenario(name="still", mounting="link", duration=5, trajectory=[Waypoint(time=0, position=position)])
    mounting = NOMINAL.mount("link")
    recording = record_motion(NOMINAL, mounting, NOMINAL.record(mounting), scenario, SEED)
    found = diagnose(Measurement("still", Path(), (recording,)), NOMINAL)
    assert found.verdict == "inconclusive", [(c.name, c.description) for c in found.causes]
    assert found.causes == ()
    assert len(found.undetermined) >= 2 / 3 * len(causes.of(NOMINAL))


@pytest.mark.slow
def test_extended_joint_makes_a_fresh_measurement_consistent():
    drawn, found = diagnosed("hysteresis")
    # The same joint, measured again: other motions, other noise.
    rng = np.random.default_rng(SEED + 1)
    known = {r.link.inertia: record for r, record in zip(drawn.measurement.recordings, drawn.records, strict=True)}
    recordings = []
    for scenario in motions(rng):
        mounting = drawn.nominal.mount(scenario.mounting)
        record = known[mounting.inertia]
        recordings.append(record_motion(drawn.nominal, mounting, record, scenario, SEED + len(recordings)))
    again = diagnose(Measurement("again", Path(), tuple(recordings)), found.extended)
    assert again.verdict == "consistent", [(c.name, c.confidence, c.explains) for c in again.causes]


@pytest.mark.slow
def test_of_two_causes_worth_the_same_the_one_that_is_larger_for_its_kind_stands_first():
    """A link's inertia 1.8 times as large, on a joint whose link is not quite rigid: both contribute 0.13 N·m."""
    drawn = draw(Challenge(hidden="one", seed=1010, real=True), 27)
    first, second = diagnose(drawn.measurement, drawn.nominal).causes
    assert (first.name, second.name) == ("link_inertia", "link_flexibility")
    assert second.contribution == pytest.approx(first.contribution, rel=0.15)


EXAMPLES = [
    f"{kind}/{number:02d}" for kind, count in (("exact", 6), ("toleranced", 7), ("bare", 3)) for number in range(count)
]


@pytest.mark.slow
@pytest.mark.parametrize("example", EXAMPLES)
def test_examples_of_an_independent_simulator(shared, example):
    kind, number = example.split("/")
    folder = shared / "data" / "examples" / kind
    if not (folder / "truth.json").is_file():
        pytest.skip(f"no examples at {folder}")
    truth = json.loads((folder / "truth.json").read_text(encoding="utf-8"))[number]
    measurement = read_measurement(folder / number)
    found = diagnose(measurement, measurement.load_joint("test-joint"))
    named = [c.name for c in found.causes]
    if not truth:
        assert found.verdict == "consistent" and not named, named
        return
    assert found.verdict == "discrepancy"
    assert named[0] in truth, f"hidden {list(truth)}, named {named}"
    if named[0] == "unknown":
        assert found.causes[0].component == truth["unknown"]["component"]
    assert set(named) >= set(truth), f"hidden {list(truth)}, named {named}"


# --- the challenge itself ----------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.long
def test_a_viscous_friction_is_no_better_known_than_its_law():
    """A real one grows less than linearly: 18 % low, 4.0 of the deviations that were stated."""
    drawn = draw(Challenge(hidden="two", seed=1203, real=True), 23)
    found = diagnose(drawn.measurement, drawn.nominal)
    assert {"viscous_friction", "stiffness"} <= {c.name for c in found.causes}
    error, relative = score.deviations(drawn, found)["viscous_friction.coefficient"]
    assert error < 3 and relative > 0.1


@pytest.mark.slow
@pytest.mark.parametrize("missing", ["joint_torque", pytest.param("link_position", marks=pytest.mark.long)])
def test_a_special_case_is_fitted_as_long_as_what_is_more_general(shared, missing):
    """A back-driving with two coefficients alike replaced a friction that grows with load, which was fitted less long."""
    measurement = read_measurement(shared / "data" / "examples" / "toleranced" / "02")
    less = replace(measurement, recordings=tuple(r.without(missing) for r in measurement.recordings))
    found = diagnose(less, measurement.load_joint(None))
    assert [c.name for c in found.causes] == ["load_dependent_friction"]
    coefficient = found.causes[0].parameters["coefficient"]
    assert abs(coefficient.value - 0.2817) < 3 * coefficient.std < 0.01


@pytest.mark.slow
def test_draws_are_reproducible_and_paired_over_sizes():
    challenge = Challenge(seed=3, only=("hysteresis",))
    one, again, small = (draw(challenge, 0, size) for size in (1.0, 1.0, 0.1))
    for a, b in zip(one.measurement.recordings, again.measurement.recordings, strict=True):
        for name, values in a.columns.items():
            np.testing.assert_array_equal(values, b.columns[name], err_msg=name)
    assert small.effects[0].values["torque"] == pytest.approx(0.1 * one.effects[0].values["torque"])
    assert small.effects[0].values["extent"] == one.effects[0].values["extent"]
    for a, b in zip(one.records, small.records, strict=True):
        assert a[0]["K1"] == b[0]["K1"]
    for a, b in zip(one.measurement.recordings, small.measurement.recordings, strict=True):
        np.testing.assert_array_equal(a["position_command"], b["position_command"])
    durations = [r.time[-1] for r in one.measurement.recordings]
    assert 70 < sum(durations) < 95
    assert [r.external for r in one.measurement.recordings] == ["none", "unmeasured", "none"]
    assert not any("external_torque" in r for r in one.measurement.recordings)
    largest = max(np.abs(r["motor_current"]).max() for r in one.measurement.recordings)
    assert largest < NOMINAL.numbers["current_limit"].value


def test_every_cause_is_drawn_before_any_comes_twice():
    challenge = Challenge(seed=5)
    count = len(challenge.pool())
    rng = np.random.default_rng(0)
    drawn = [_effects(challenge, i, 1.0, NOMINAL, rng)[0].name for i in range(count)]
    assert sorted(drawn) == sorted(challenge.pool()) and count >= 23
    assert "torque_sensor_gain" not in Challenge(sensor=False).pool()
    with pytest.raises(InputError, match="--cause: expected one of"):
        Challenge(only=("gremlins",)).pool()


def test_channels_that_are_not_recorded_hide_nothing_that_they_alone_show():
    one_encoder = Challenge(without=("motor_position", "joint_torque"), hidden="none", scenarios=("no_load",))
    (recording,) = draw(one_encoder, 0).measurement.recordings
    assert set(recording.columns) == {"link_position", "motor_current", "position_command"}
    pool = replace(one_encoder, hidden="one").pool()
    assert {"cogging", "gravity_moment"} <= set(pool)
    assert not {"stiffness", "backlash", "torque_sensor_gain"} & set(pool)
    no_current = Challenge(without=("motor_current",))
    pool = no_current.pool()  # friction winds the wave generator up, which both encoders see
    assert {"stiffness", "mesh_friction"} <= set(pool) and not {"cogging", "torque_constant"} & set(pool)
    assert "rotor_pulse" not in replace(no_current, hidden="outside").pool()


@pytest.mark.parametrize(
    ("without", "expected"),
    [
        (("link_postion",), "--without: expected one of motor_position, link_position, .*, got 'link_postion'"),
        (("motor_position", "link_position"), "got motor_current, joint_torque"),
        (("motor_current", "joint_torque"), "got motor_position, link_position"),
    ],
)
def test_channels_without_which_there_is_nothing_to_hold_against_anything(without, expected):
    with pytest.raises(InputError, match=expected):
        Challenge(without=without).pool()


def test_bare_recordings_are_irregular_and_without_sensor(rng):
    scenario = Scenario(name="s", mounting="link", duration=2, trajectory=[Waypoint(time=0, position=0)])
    mounting = NOMINAL.mount("link")
    full = record_motion(NOMINAL, mounting, NOMINAL.record(mounting), scenario, 1)
    logged = bare(full, rng)
    assert "joint_torque" not in logged
    steps = np.unique(np.round(np.diff(logged.time) * 1000).astype(int))
    assert set(steps) == {3, 4, 5, 9}
    assert len(logged.gaps) == 0


@pytest.mark.parametrize("name", causes.names())
def test_coordinates_invert_values(name, rng):
    for size in (0.1, 1.0):
        values = causes.get(name).draw(NOMINAL.record()[0], rng, size)
        effect = HiddenEffect(name, "", values, "", lambda p: None)
        h = score.matching(NOMINAL, effect)
        back = h.values(score.coordinates(h, values))
        for q in causes.get(name).parameters:
            difference = back[q.name] - values[q.name]
            if q.period:
                difference = (difference + 0.5 * q.period) % q.period - 0.5 * q.period
            assert difference == pytest.approx(0.0, abs=1e-9 + 1e-9 * abs(values[q.name])), q.name


def test_effects_outside_the_library_reach_the_record(rng):
    for name, outside in OUTSIDE.items():
        values = outside.draw(rng, 1.0)
        record = NOMINAL.record()
        outside.put(record[0], values)
        assert record.tobytes() != NOMINAL.record().tobytes(), name
        assert outside.component in causes.COMPONENTS
        assert values and outside.description


def test_effect_that_tolerances_can_express_is_not_hidden():
    calibration = Calibration(NOMINAL)
    x = np.zeros(calibration.size)

    def effect(name, values):
        return HiddenEffect(name, "", values, "", lambda p: causes.get(name).apply(p, values))

    assert within_tolerance(calibration, x, effect("stiffness", {"scale": 1.1}))
    assert not within_tolerance(calibration, x, effect("stiffness", {"scale": 1.4}))
    assert not within_tolerance(calibration, x, effect("backlash", {"width": 1e-5}))
    assert within_tolerance(calibration, x, effect("link_inertia", {"scale": 1.02}))


def outcome(index, hidden, named, size=1.0, confidence=0.95, real=False):
    kind = ("none", "one", "two")[len(hidden)]
    found = tuple({"name": n, "component": causes.get(n).component, "confidence": confidence} for n in named)
    verdict = "discrepancy" if named else "consistent"
    return Outcome(kind, index, size, real, hidden, "", "", verdict, found, deviations={}, core_time=1.0, seconds=1.0)


def test_effect_that_no_joint_can_hide_is_not_drawn():
    wide = Challenge(joint="lara8-joint3", seed=1)
    assert "torque_constant" not in wide.pool() and "hysteresis" in wide.pool()
    assert "torque_constant" in Challenge(joint="lara8-joint3", seed=1, exact=True).pool()
    with pytest.raises(InputError, match="beyond the tolerances of lara8-joint3"):
        Challenge(joint="lara8-joint3", only=("torque_constant",)).pool()
    # Twice the rotor inertia is within tolerance of most joints: the draw ends all the same.
    assert draw(replace(wide, seed=31), 0).effects


def test_rates_and_tables_count():
    right = [outcome(i, {"cogging": {}}, ["cogging"]) for i in range(9)]
    wrong = outcome(9, {"cogging": {}}, ["rotor_inertia"])
    all_ = [*right, wrong]
    rate = score.summary(all_)["first cause right"]
    assert (rate.right, rate.of) == (9, 10)
    low, high = rate.interval
    assert low < 0.9 < high and low == pytest.approx(0.596, abs=0.01)
    assert score.summary(all_)["component right"].right == 10
    assert score.confusion(all_) == {"cogging": {"cogging": 9, "rotor_inertia": 1}}
    assert score.summary([outcome(0, {}, []), outcome(1, {}, ["cogging"])])["false alarms"].share == 0.5
    ((_, _, mean, share),) = score.reliability(all_)
    assert mean == pytest.approx(0.95) and share == Rate(9, 10)
    two = outcome(0, {"cogging": {}, "backlash": {}}, ["backlash"])
    assert two.first_right and not two.all_named


def test_size_found_nine_times_in_ten():
    def scan(shares):
        return [
            outcome(i, {"cogging": {}}, ["cogging"] if i < share * 10 else [], size)
            for size, share in shares.items()
            for i in range(10)
        ]

    assert score.found_nine_in_ten(scan({1.0: 0.8})) is None
    assert score.found_nine_in_ten(scan({1.0: 1.0, 0.1: 1.0})) == 0.1
    assert score.found_nine_in_ten(scan({1.0: 1.0, 0.1: 0.8})) == pytest.approx(10**-0.5)
    # What is found again at a smaller size was luck.
    assert score.found_nine_in_ten(scan({1.0: 1.0, 0.3: 0.4, 0.1: 1.0})) > 0.3


@pytest.mark.slow
def test_results_do_not_depend_on_the_number_of_jobs():
    challenge = Challenge(seed=11, only=("backlash", "cogging"))
    runs = [sorted(score.run(challenge, 2, (1.0,), jobs), key=lambda o: o.index) for jobs in (1, 2)]
    for one, two in zip(*runs, strict=True):
        assert replace(one, seconds=0.0, core_time=0.0) == replace(two, seconds=0.0, core_time=0.0)


def test_rows_are_those_that_are_asked_for():
    found = [
        *(outcome(i, {"cogging": {}}, ["cogging"]) for i in range(3)),
        outcome(0, {}, ["backlash"], real=True), outcome(1, {}, ["backlash"], confidence=0.4, real=True),
        outcome(2, {}, ["motor_encoder_eccentricity"], real=True),
        outcome(0, {"cogging": {}, "backlash": {}}, ["backlash"]),
    ]  # fmt: skip
    rows = {row.name: row for row in score.rows(found)}
    assert rows["one effect: first cause right"].met
    alarms = rows["nothing hidden: a cause named that is not there"]
    assert alarms.value == Rate(1, 3) and not alarms.met, (
        "an imperfection, and a cause of low confidence, are no alarms"
    )
    assert rows["two effects: both named"].value == Rate(0, 1)
    assert rows["causes named at ≥ 0.9: are there"].value == Rate(5, 6)
    assert "outside the library: right component" not in rows
    assert not replace(found[0], failure="broke", causes=()).first_right
    assert Rate(0, 24).interval[0] == pytest.approx(0.0, abs=1e-12) and 0.1 < Rate(0, 24).interval[1] < 0.2


def test_an_imperfection_that_is_worth_more_is_set_aside():
    named = ["motor_encoder_eccentricity", "cogging"]
    rows = {row.name: row.value for row in score.rows([outcome(0, {"cogging": {}}, named, real=True)])}
    assert rows["one effect: first cause right"] == Rate(0, 1)
    assert rows["… imperfections that are there set aside"] == Rate(1, 1)
    false = outcome(0, {"cogging": {}}, ["backlash", "cogging"], real=True)
    assert not false.first_beside_imperfections


def test_an_encoders_own_imperfection_is_part_of_a_hidden_error():
    """The record adds them as vectors: what a perfect diagnosis finds is their sum."""
    seed = 3
    print("seed", seed)
    nominal = load_joint("test-joint")
    flaws = imperfections(nominal, np.random.default_rng(seed))
    for name in ("motor_encoder_eccentricity", "link_encoder_error"):
        record = nominal.record()
        flaws.apply(record)
        values = causes.get(name).draw(record[0], np.random.default_rng(seed)) | (
            {"order": 2.0} if name == "link_encoder_error" else {}
        )
        causes.get(name).apply(record[0], values)
        whole = flaws.whole(name, values)
        alone = nominal.record()
        causes.get(name).apply(alone[0], whole)
        angle = np.linspace(-1.5, 1.5, 50)
        law = laws.link_reading if name == "link_encoder_error" else laws.motor_reading
        read = [[law(x, r[0]) for x in angle] for r in (record, alone)]
        np.testing.assert_allclose(read[0], read[1], atol=1e-12)
    third = {"order": 3.0, "amplitude": 1e-4, "phase": 0.3}
    assert flaws.whole("link_encoder_error", third) == third


@pytest.mark.slow
def test_command_on_two_draws(tmp_path, flexspline):
    options = (
        "--draws",
        2,
        "--hidden",
        "none",
        "--hidden",
        "one",
        "--cause",
        "cable_spring",
        "--jobs",
        2,
        "--seed",
        SEED,
    )
    code, out, err = flexspline("challenge", *options, "--out", tmp_path / "draws.json")
    assert code == 0, err
    assert "one effect: first cause right" in out and "core time, worst" in out
    found = json.loads((tmp_path / "draws.json").read_text())
    assert len(found["draws"]) == 4 and {d["kind"] for d in found["draws"]} == {"none", "one"}
    assert all(0 <= row["interval"][0] <= row["interval"][1] <= 1 for row in found["rows"] if "interval" in row)


def test_a_measurement_with_a_hidden_effect_is_written(flexspline, tmp_path):
    from flexspline.models.recording import read_measurement

    words = ("challenge", "--hidden", "one", "--seed", 3, "--scenario", "no_load", "--measurement", tmp_path / "hidden")
    code, out, error = flexspline(*words)
    assert code == 0 and "hidden" in out, error
    (hidden,) = json.loads((tmp_path / "hidden" / "hidden.json").read_text(encoding="utf-8"))
    drawn = draw(Challenge(seed=3, hidden="one", scenarios=("no_load",)), 0)
    assert hidden["name"] == drawn.effects[0].name and hidden["parameters"] == drawn.effects[0].values
    read = read_measurement(tmp_path / "hidden")
    for own, other in zip(read.recordings, drawn.measurement.recordings, strict=True):
        assert own.joint == "test-joint"
        for name in other.columns:
            np.testing.assert_array_equal(own[name], other[name])
    assert flexspline(*words)[0] == 0  # its own output is replaced


def test_causes_where_nothing_is_hidden_are_refused(flexspline):
    code, out, err = flexspline("challenge", "--cause", "backlash", "--hidden", "none")
    assert (code, out) == (2, "") and err.count("\n") == 1 and "--cause" in err and "--hidden none" in err


def test_output_that_cannot_be_written_is_refused_before_the_work(tmp_path, flexspline):
    (tmp_path / "file").write_text("mine")
    for out in (tmp_path / "draws.txt", tmp_path / "file" / "draws.json"):
        code, _, err = flexspline("challenge", "--draws", 500, "--out", out)
        assert code == 2 and err.count("\n") == 1, err


@pytest.mark.slow
@pytest.mark.long
def test_causes_are_told_by_what_they_are_worth_to_estimators_too():
    """A friction nearly twice as large, which in a simulation tolerances can do instead, next to a link that is not rigid."""
    one = draw(Challenge(seed=331, hidden="one", real=True), 1)
    found = diagnose(one.measurement, one.nominal)
    assert [e.name for e in one.effects] == ["mesh_friction"]
    assert found.causes[0].name == "mesh_friction" and found.causes[0].confidence > 0.9
    assert [c.contribution for c in found.causes] == sorted((c.contribution for c in found.causes), reverse=True)
    assert all(0.0 <= c.estimation <= c.contribution for c in found.causes)
    assert sum(c.explains for c in found.causes) <= 1.0 + 1e-9


@pytest.mark.slow
@pytest.mark.parametrize(("seed", "index", "name"), [(601, 31, "mesh_friction"), (591, 25, "stiffness")])
def test_without_an_effect_that_multiplies_a_number_its_tolerance_does_less(seed, index, name):
    """Tolerances of a friction 2.3 times as large, mistaken for those of the friction without it, explained nearly all of it."""
    drawn = draw(Challenge(seed=seed, hidden="one", real=True), index)
    assert [e.name for e in drawn.effects] == [name]
    assert diagnose(drawn.measurement, drawn.nominal).causes[0].name == name
