"""Effects hidden in joints drawn within tolerance, and what diagnosis makes of them. Seeds are in the test ids."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hidden_joint import measure

from flexspline.diagnosis.diagnose import diagnose
from flexspline.diagnosis.fit import regions
from flexspline.models import causes
from flexspline.models.joint import load_joint
from flexspline.models.recording import Measurement, Recording

pytestmark = pytest.mark.long


@pytest.fixture(scope="module")
def joint():
    return load_joint("test-joint")


def check(joint, seed, name, **options):
    measurement, truth = measure(joint, seed, (name,), **options)
    d = diagnose(measurement, joint)
    found = [(c.name, c.parameters, c.confidence) for c in d.causes]
    assert d.verdict == "discrepancy", f"seed {seed}: {truth}, found {found}"
    assert d.causes[0].name == name, f"seed {seed}: {truth}, found {found}"
    return d, truth[name]


@pytest.mark.slow
def test_one_hidden_effect_is_found_and_the_joint_extended(joint, tmp_path):
    d, truth = check(joint, 207, "friction_asymmetry")
    ratio = d.causes[0].parameters["ratio"]
    assert abs(ratio.value - truth["ratio"]) < 0.15 * abs(truth["ratio"])
    answer = json.loads(json.dumps(d.to_json()))
    assert answer["residual"]["motor_current"]["after"] < answer["residual"]["motor_current"]["before"]
    d.extended.write(tmp_path / "joint.yaml")
    assert "friction_asymmetry" in {e.name for e in load_joint(tmp_path / "joint.yaml").effects}


@pytest.mark.slow
@pytest.mark.parametrize("name", [n for n in causes.names() if n != "gravity_direction"])
def test_every_cause_is_found_within_tolerance(joint, name):
    d, truth = check(joint, 500 + causes.names().index(name), name)
    magnitudes = {q.name for q in causes.get(name).parameters if q.magnitude}
    for key, p in d.causes[0].parameters.items():
        if key in magnitudes:
            error = abs(p.value - truth[key])
            assert error < max(3 * p.std, 0.15 * abs(truth[key])), f"{key}: {p} for {truth[key]}"


@pytest.mark.slow
@pytest.mark.parametrize("share", [-0.012, 0.012])
def test_crosstalk_of_the_torque_sensor_is_not_the_payloads_angle(joint, share):
    """What the weight makes a torque sensor read across its axis goes with the cosine of the angle, as a payload next to the link
    would: it is no noise that longer data average out."""
    measurement, truth = measure(joint, 700, ("payload",))
    amplitude = share * joint.mount("link").gravity_moment
    crossed = []
    for r in measurement.recordings:
        read = r.columns["joint_torque"] + amplitude * np.cos(r.columns["link_position"])
        crossed.append(replace(r, columns={**r.columns, "joint_torque": read}))
    d = diagnose(replace(measurement, recordings=tuple(crossed)), joint)
    assert [c.name for c in d.causes] == ["payload"]
    for name, p in d.causes[0].parameters.items():
        assert abs(p.value - truth["payload"][name]) < 3 * p.std, f"{name}: {p} for {truth['payload'][name]}"


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(600, 606))
def test_nothing_hidden_is_consistent(joint, seed):
    measurement, _ = measure(joint, seed)
    d = diagnose(measurement, joint)
    assert d.verdict == "consistent", [(c.name, c.parameters) for c in d.causes]


def test_a_joint_at_rest_keeps_its_description():
    joint = load_joint("csg-14-100-ec45")  # orders of unknown phase
    rng, n = np.random.default_rng(1), 3000
    noise = {"motor_position": 1e-3, "link_position": 1e-5, "motor_current": 0.02}
    columns = {name: rms * rng.standard_normal(n) for name, rms in noise.items()}
    d = diagnose(
        Measurement("m", Path(), (Recording("r", 1e-3 * np.arange(n), columns, link=joint.mount("no_load")),)), joint
    )
    assert d.verdict == "inconclusive" and d.reason == "nothing moves"
    assert d.extended.kinematic_error == joint.kinematic_error


def test_a_log_that_is_too_slow_is_inconclusive_for_that_reason(joint):
    """It was searched for causes, and ended with "nearly all causes are undetectable"."""
    time = np.arange(0.0, 30.0, 1 / 8)
    angle = np.sin(0.4 * time)
    columns = {"link_position": angle, "motor_current": 1.5 * angle}
    d = diagnose(Measurement("m", Path(), (Recording("slow", time, columns, link=joint.mount()),)), joint)
    assert d.verdict == "inconclusive" and d.reasons[0].startswith("the log is slower than 10 Hz (8 samples a second)")
    assert d.regressions and not d.causes


@pytest.mark.slow
def test_what_is_taken_back_is_not_called_consistent(joint, monkeypatch):
    """Calibration explains a joint within tolerance; where it is not believed the description is left, and that is off."""
    first, *others = joint.kinematic_error
    phase = first.phase.model_copy(update={"deviation": 1.8})  # not known: the fit has quadratures
    joint = joint.model_copy(update={"kinematic_error": [first.model_copy(update={"phase": phase}), *others]})
    measurement, _ = measure(joint, 600)
    for name in ("WORSE", "MOST"):  # worse wherever it has not been
        monkeypatch.setattr(regions, name, 0.0)
    d = diagnose(measurement, joint)
    current = d.residual["motor_current"]
    assert current.after > 2 * current.noise
    assert d.verdict == "inconclusive" and "motor current" in d.reason
    assert "joint.yaml is the description, with the link encoder's zero found" in d.reason
    zeros = [j.sensors.link_encoder.zero.value for j in (joint, d.extended)]
    apart = {"sensors", "uncertainty"}
    assert zeros[1] != zeros[0] and d.extended.model_dump(exclude=apart) == joint.model_dump(exclude=apart)
    left = d.extended.uncertainty.discrepancy["motor_current"]
    assert left**2 > 0.5 * (current.after**2 - current.noise**2) and not d.extended.uncertainty.names


@pytest.mark.slow
@pytest.mark.parametrize("torque", [False, True])
@pytest.mark.parametrize("factor", [0.84, 1.3])
def test_another_stribeck_friction_is_no_friction_of_the_angle(joint, factor, torque):
    """Orders 1 to 3 of the link's angle, which together are a constant where the link went, had been reported at 0.7 and more."""
    number = joint.numbers["Fs"]
    there = {**joint.numbers, "Fs": number.model_copy(update={"value": factor * number.value})}
    measurement, _ = measure(joint.model_copy(update={"numbers": there}), 3, exact=True)
    if not torque:
        measurement = replace(measurement, recordings=tuple(r.without("joint_torque") for r in measurement.recordings))
    d = diagnose(measurement, joint)
    assert not [c for c in d.causes if c.confidence >= 0.5], [(c.name, c.confidence) for c in d.causes]
    if factor > 1 and torque:
        found = d.calibration["Fs"]
        assert abs(found.value - factor * number.value) < 3 * found.std < 0.5 * number.value


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(700, 703))
def test_a_bump_of_torque_on_the_link_is_unknown(joint, seed):
    rng = np.random.default_rng(seed)
    bump = (rng.choice([-1, 1]) * rng.uniform(2, 4), rng.uniform(-0.9, 0.9), rng.uniform(0.06, 0.12))
    measurement, _ = measure(joint, seed, bump=bump)
    found = [c for c in diagnose(measurement, joint).causes if c.name == "unknown"]
    assert found and found[0].component == "link", f"seed {seed}: {bump}"
    assert "link_position" in found[0].depends_on
