"""What a plain regression says, of motions whose torque is written down here."""

from __future__ import annotations

import numpy as np
import pytest

from flexspline.diagnosis.diagnose import diagnose
from flexspline.diagnosis.regression import contradictions, regressions
from flexspline.diagnosis.validate import validate
from flexspline.models.datasheet import Datasheet, new_joint
from flexspline.models.joint import load_joint
from flexspline.models.joint_parts import Mounting
from flexspline.models.recording import Measurement, Recording

LINK = Mounting(inertia=0.35, gravity_moment=9.0)
RATE = 200.0


def motion(rng: np.random.Generator, seconds: float) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Time [s] and a sum of sines with its two derivatives [rad], [rad/s], [rad/s²]."""
    time = np.arange(0.0, seconds, 1 / RATE)
    theta, v, a = (np.zeros_like(time) for _ in range(3))
    for omega in rng.uniform(0.5, 5.0, 4):
        size, phase = rng.uniform(0.1, 0.4), rng.uniform(0, 2 * np.pi)
        theta += size * np.sin(omega * time + phase)
        v += size * omega * np.cos(omega * time + phase)
        a -= size * omega**2 * np.sin(omega * time + phase)
    return time, theta, v, a


def measurement(tmp_path, **columns: np.ndarray) -> Measurement:
    time = columns.pop("time")
    return Measurement("made", tmp_path, (Recording("made", time, columns, link=LINK),))


@pytest.mark.parametrize("draw", range(6))
def test_numbers_of_a_rigid_joint(draw, rng, tmp_path):
    """Gravity, inertia, friction, load friction and offset of a current that these equations make."""
    joint = load_joint("test-joint")
    N, Kt = joint.numbers["N"].value, joint.numbers["Kt"].value
    time, theta, v, a = motion(rng, 40.0)
    moment, inertia, Fc, viscous, mu, offset = (
        rng.uniform(4, 14), rng.uniform(0.4, 1.2), rng.uniform(0.005, 0.1), rng.uniform(2e-5, 5e-4), rng.uniform(0, 0.3),
        rng.uniform(-0.1, 0.1),
    )  # fmt: skip
    load = 9.0 * np.sin(theta) + 0.35 * a
    torque = moment * np.sin(theta) + inertia * a + np.sign(v) * (N * Fc + mu * np.abs(load)) + N * N * viscous * v
    current = torque / (N * Kt) + offset + 0.01 * rng.standard_normal(len(time))
    (found,) = regressions(measurement(tmp_path, time=time, link_position=theta, motor_current=current), joint)
    got = {c.means: c for c in found.coefficients if c.means}
    wanted = {
        "gravity_moment": moment, "inertia": inertia, "Fc": Fc, "viscous": viscous, "load_dependent_friction": mu,
        "offset": offset,
    }  # fmt: skip
    assert set(got) == set(wanted)
    for name, value in wanted.items():
        assert got[name].number == pytest.approx(value, rel=0.05, abs=0.02 if name != "viscous" else 1e-5), name
    assert found.rms < 0.03
    assert found.held_out == pytest.approx(found.rms, rel=0.2)


def test_torque_constant_where_a_sensor_was_read(rng, tmp_path):
    joint = load_joint("test-joint")
    time, theta, v, a = motion(rng, 30.0)
    torque = 9.0 * np.sin(theta) + 0.35 * a
    current = (torque / 100.0 + 0.018 * np.sign(v)) / 0.046 + 0.01 * rng.standard_normal(len(time))
    columns = {
        "link_position": theta,
        "motor_current": current,
        "joint_torque": torque + 0.03 * rng.standard_normal(len(time)),
    }
    found = regressions(measurement(tmp_path, time=time, **columns), joint)
    (constant,) = [c for one in found for c in one.coefficients if c.means == "Kt"]
    assert constant.number == pytest.approx(0.046, rel=0.02)
    assert constant.beyond > 5


def test_recordings_with_different_loads(rng, tmp_path):
    """A bare output and a link: their gravity is in proportion to the described one, and rotor and link inertia part."""
    joint = load_joint("test-joint")
    recordings, rotor = [], 0.25
    for name, link in (("bare", Mounting(inertia=0.02, gravity_moment=0.0)), ("link", LINK)):
        time, theta, v, a = motion(rng, 40.0)
        torque = 1.2 * link.gravity_moment * np.sin(theta) + (rotor + 1.8 * link.inertia) * a + 2.0 * np.sign(v)
        current = torque / 6.03 + 0.01 * rng.standard_normal(len(time))
        recordings.append(Recording(name, time, {"link_position": theta, "motor_current": current}, link=link))
    (found,) = regressions(Measurement("made", tmp_path, tuple(recordings)), joint)
    got = {c.means: c for c in found.coefficients if c.means}
    wanted = {"gravity_moment": (10.8, 9.0), "link_inertia": (0.63, 0.35), "Fc": (0.02, 0.018)}
    for name, (value, described) in wanted.items():
        assert got[name].number == pytest.approx(value, rel=0.03), name
        assert got[name].described == pytest.approx(described)
    assert got["rotor_inertia"].number == pytest.approx(rotor, rel=0.05)


def test_one_stroke_does_not_tell_friction_from_an_offset(tmp_path):
    """In one direction friction is a constant: one of the two shapes is left out, and it is said which."""
    joint = load_joint("test-joint")
    time = np.arange(0.0, 8.0, 1 / RATE)
    theta = -1.0 + 0.25 * time + 0.02 * np.sin(time)
    current = (9.0 * np.sin(theta) + 2.0) / 6.03
    (found,) = regressions(measurement(tmp_path, time=time, link_position=theta, motor_current=current), joint)
    assert "offset" in found.left_out
    assert np.isfinite([c.std for c in found.coefficients]).all()


def test_prediction_is_what_it_was_fitted_to(rng, tmp_path):
    joint = load_joint("test-joint")
    time, theta, _, a = motion(rng, 20.0)
    current = (9.0 * np.sin(theta) + 0.6 * a) / 6.03
    made = measurement(tmp_path, time=time, link_position=theta, motor_current=current)
    (found,) = regressions(made, joint)
    predicted = found.predict(made.recordings[0], joint)
    inside = np.isfinite(predicted)
    assert inside.mean() > 0.95
    assert np.sqrt(np.mean((predicted - current)[inside] ** 2)) < 0.02


def test_too_little_motion_says_nothing(tmp_path):
    time = np.arange(0.0, 0.3, 1 / RATE)
    rest = np.zeros_like(time)
    assert (
        regressions(measurement(tmp_path, time=time, link_position=rest, motor_current=rest), load_joint("test-joint"))
        == ()
    )


@pytest.mark.parametrize(("scale", "said"), [(1.0, ""), (1.12, "time in seconds"), (0.9, "time in seconds")])
def test_a_torque_sensor_contradicts_a_load_and_a_clock(scale, said, rng, tmp_path):
    joint = load_joint("test-joint")
    time, theta, _, a = motion(rng, 20.0)
    torque = 9.0 * np.sin(theta) + 0.35 * a + 0.02 * rng.standard_normal(len(time))
    data = measurement(tmp_path, time=scale * time, link_position=theta, joint_torque=torque)
    found = contradictions(regressions(data, joint), joint)
    assert len(found) == bool(said) and said in "".join(found), found


def test_measured_pushes_next_to_a_recording_without_any(rng, tmp_path):
    """They were part of the residual, and the inertia was wrong."""
    recordings = []
    for name, size in (("free", 0.0), ("pushed", 3.0)):
        time, theta, _, a = motion(rng, 20.0)
        push = size * (np.sin(2.0 * time) > 0.5)
        torque = 9.0 * np.sin(theta) + 0.35 * a - push + 0.02 * rng.standard_normal(len(time))
        columns = {"link_position": theta, "joint_torque": torque} | ({"external_torque": push} if size else {})
        external = "measured" if size else "none"
        recordings.append(Recording(name, time, columns, link=LINK, external=external))
    joint = load_joint("test-joint")
    (both,) = regressions(Measurement("made", tmp_path, tuple(recordings)), joint)
    (inertia,) = [c.number for c in both.coefficients if c.means == "inertia"]
    assert inertia == pytest.approx(0.35, rel=0.02) and both.rms < 0.3
    (free,) = regressions(Measurement("made", tmp_path, tuple(recordings[:1])), joint)
    assert free.left_out == ("link inertia",) and np.isfinite(both.predict(recordings[0], joint)).any()


@pytest.mark.slow
def test_a_centre_of_mass_that_is_a_few_degrees_off_is_calibrated(rng, tmp_path):
    """A regression has gravity in two directions; a diagnosis that had one named a payload at 0.99."""
    sheet = Datasheet("CSG", 17, 80, {"Kt": 0.1, "R": 0.5, "L": 5e-4, "Jm": 5e-5}, {"counts": 4096}, {"bits": 16})
    joint = new_joint(sheet).joint
    N, Kt, Fc, bw = (joint.numbers[name].value for name in ("N", "Kt", "Fc", "bw"))
    rotor = N * N * (joint.numbers["Jm"].value + joint.numbers["Jw"].value)

    def log(angle: float) -> Measurement:
        time, theta, v, a = motion(rng, 40.0)
        torque = 9.0 * np.sin(theta + angle) + (0.35 + rotor) * a + N * Fc * np.tanh(N * v / 0.1) + N * N * bw * v
        current = torque / (N * Kt) + 0.01 * rng.standard_normal(len(time))
        return measurement(tmp_path, time=time, link_position=theta, motor_current=current)

    before, after = log(0.12), log(0.12)
    found = diagnose(before, joint)
    assert not [c for c in found.causes if c.confidence > 0.5 and c.name != "gravity_direction"], found
    assert found.extended.record(LINK)[0]["gravity_angle"] == pytest.approx(0.12, abs=0.02)
    (plain,) = regressions(before, joint)
    (r,) = after.recordings
    moving = np.abs(np.gradient(r["link_position"], r.time)) > 0.1
    simulated = validate(after, found.extended).recordings[0].simulated["motor_current"]
    left = [(r["motor_current"] - x)[moving] for x in (simulated, plain.predict(r, joint))]
    ours, regression = (np.sqrt(np.nanmean(x**2)) for x in left)
    print(f"{ours:.4f} A, regression {regression:.4f} A")
    assert ours < 1.05 * regression
