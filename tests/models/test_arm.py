"""The load of an arm on one of its joints: against MuJoCo's whole inverse dynamics, and a double pendulum in closed
form."""

from __future__ import annotations

import warnings

import mujoco
import numpy as np
import pyarrow.parquet as pq
import pytest
import yaml

from flexspline.models.arm import ArmSpec, column, joint_of
from flexspline.models.arm_dynamics import Arm
from flexspline.models.errors import InputError
from flexspline.models.joint import shipped
from flexspline.models.joint_parts import Mounting
from flexspline.models.recording import Recording, read_measurement, read_recording, write_recording

ARM = """<mujoco><compiler angle="radian"/><option gravity="0 0 -9.80665"/><worldbody>
  <body name="base"><joint name="pan" axis="0 0 1"/><inertial pos="0 0 0.1" mass="2" diaginertia="0.01 0.01 0.01"/>
  <body name="upper" pos="0 0.1 0.15" euler="0 0 0.3"><joint name="lift" axis="0.1 1 0" damping="3" armature="0.1"
    frictionloss="1" stiffness="4" range="-1 1"/><inertial pos="0.12 0.01 0.02" mass="3.4" diaginertia="0.004 0.02 0.02"/>
  <body name="fore" pos="0.244 0 0"><joint name="elbow" axis="0 1 0"/>
    <inertial pos="0.16 -0.02 0.01" mass="1.3" diaginertia="0.002 0.007 0.007"/>
  <body name="hand" pos="0.213 0.1 0" euler="0.3 0 0"><joint name="wrist" axis="0 0 1" ref="0.2"/>
    <inertial pos="0.05 0.02 0" mass="0.8" diaginertia="0.001 0.001 0.001"/>
  <body name="tool"><joint name="slide" type="slide" axis="1 0 0"/>
    <inertial pos="0.05 0 0" mass="0.2" diaginertia="0.0001 0.0001 0.0001"/></body></body></body></body></body></worldbody>
  <actuator><position joint="elbow" kp="100"/></actuator></mujoco>"""
NAMES = ("pan", "lift", "elbow", "wrist", "slide")


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "arm.xml").write_text(ARM, encoding="utf-8")
    return tmp_path


def torque_of(path, q, v, a, joint):
    """Torque of a joint by `mj_inverse` with masses and gravity only."""
    model = mujoco.MjModel.from_xml_path(str(path))
    model.dof_armature[:] = model.dof_damping[:] = model.jnt_stiffness[:] = model.dof_frictionloss[:] = 0.0
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)
    data = mujoco.MjData(model)
    found = []
    for position, velocity, acceleration in zip(q, v, a, strict=True):
        data.qpos[:], data.qvel[:], data.qacc[:] = position, velocity, acceleration
        mujoco.mj_inverse(model, data)
        found.append(data.qfrc_inverse[model.joint(joint).dofadr[0]])
    return np.array(found)


@pytest.mark.parametrize("joint", ["pan", "lift", "elbow", "wrist"])
def test_a_fixed_pose_is_a_mounting_exactly(folder, joint, rng):
    """Torque of inertia and weight at random angles and accelerations: Jl θ'' + Mg sin(θ + gravity angle), to rounding."""
    pose = dict(zip(NAMES, rng.uniform(-2, 2, 5), strict=True))
    own = NAMES.index(joint)
    others = {name: angle for name, angle in pose.items() if name != joint}
    mounting = Arm(ArmSpec(model="arm.xml", joint=joint, positions=others), folder).mounting()
    q, v, a = np.tile(list(pose.values()), (30, 1)), np.zeros((30, 5)), np.zeros((30, 5))
    q[:, own], v[:, own], a[:, own] = rng.uniform(-4, 4, 30), rng.standard_normal(30), 3 * rng.standard_normal(30)
    expected = torque_of(folder / "arm.xml", q, v, a, joint)
    weight = mounting.gravity_moment * np.sin(q[:, own] + mounting.gravity_angle)
    np.testing.assert_allclose(mounting.inertia * a[:, own] + weight, expected, atol=1e-12)
    if joint == "pan":  # upright
        assert mounting.gravity_moment == 0.0


def motion(time, rng):
    """Angles, velocities and accelerations of all joints, shape (n, 5): slow sinusoids."""
    amplitude, pulsation, phase = rng.uniform(0.2, 0.5, 5), rng.uniform(2, 6, 5), rng.uniform(0, 6, 5)
    amplitude[4] *= 0.1
    angle = pulsation * time[:, None] + phase
    return (
        amplitude * np.sin(angle),
        amplitude * pulsation * np.cos(angle),
        -amplitude * pulsation**2 * np.sin(angle),
    )


def test_the_load_of_an_arm_in_motion_is_mujocos(folder, rng):
    """All joints move, sampled at 500 Hz: inertia, the mounting's weight and the known torque are the whole torque."""
    time = np.arange(2500) * 2e-3
    q, v, a = motion(time, rng)
    arm = Arm(ArmSpec(model="arm.xml", joint="lift"), folder)
    others = {name: q[:, i] for i, name in enumerate(NAMES) if name != "lift"}
    mounting, load = arm.of(time, q[:, 1], others, (slice(0, 1000), slice(1000, 2500)))
    expected = torque_of(folder / "arm.xml", q, v, a, "lift")
    got = load.inertia * a[:, 1] + mounting.gravity_moment * np.sin(q[:, 1] + mounting.gravity_angle) - load.torque
    inside = np.r_[50:950, 1050:2450]
    error = (got - expected)[inside]
    print(f"rms {np.sqrt(np.mean(error**2)):.4f} N·m of {np.std(expected):.2f}, load {np.std(load.torque):.2f} N·m")
    assert np.sqrt(np.mean(error**2)) < 2e-3 * np.std(expected)
    assert np.std(load.torque) > 0.5 and np.ptp(load.inertia) > 0.02


def test_a_double_pendulum_in_closed_form(tmp_path):
    """Two rods on parallel axes: inertia and torque of the first joint from the textbook's formula."""
    m1, m2, a1, l1, a2, I1, I2 = 1.5, 0.8, 0.2, 0.4, 0.25, 0.01, 0.006
    (tmp_path / "two.xml").write_text(
        f"""<mujoco><option gravity="0 0 -9.80665"/><worldbody><body><joint name="one" axis="0 -1 0"/>
        <inertial pos="0 0 {-a1}" mass="{m1}" diaginertia="{I1} {I1} {I1}"/>
        <body pos="0 0 {-l1}"><joint name="two" axis="0 -1 0"/>
        <inertial pos="0 0 {-a2}" mass="{m2}" diaginertia="{I2} {I2} {I2}"/></body></body>
        </worldbody></mujoco>""",
        encoding="utf-8",
    )
    time = np.arange(4000) * 1e-3
    q1, q2 = 0.5 * np.sin(3 * time), 0.8 * np.sin(4 * time)
    v1, v2 = 1.5 * np.cos(3 * time), 3.2 * np.cos(4 * time)
    c2 = -12.8 * np.sin(4 * time)
    arm = Arm(ArmSpec(model="two.xml", joint="one"), tmp_path)
    mounting, load = arm.of(time, q1, {"two": q2}, (slice(0, 4000),))
    M11 = I1 + I2 + m1 * a1**2 + m2 * (l1**2 + a2**2 + 2 * l1 * a2 * np.cos(q2))
    M12 = I2 + m2 * (a2**2 + l1 * a2 * np.cos(q2))
    h = m2 * l1 * a2 * np.sin(q2)
    coriolis = -h * (2 * v1 * v2 + v2**2)
    weight = 9.80665 * ((m1 * a1 + m2 * l1) * np.sin(q1) + m2 * a2 * np.sin(q1 + q2))
    inside = slice(60, -60)
    np.testing.assert_allclose(load.inertia[inside], M11[inside], atol=1e-4)
    at_mounting = mounting.gravity_moment * np.sin(q1 + mounting.gravity_angle)
    np.testing.assert_allclose((at_mounting - load.torque)[inside], (M12 * c2 + coriolis + weight)[inside], atol=5e-3)
    assert mounting.gravity_moment == pytest.approx(
        9.80665 * (m1 * a1 + m2 * (l1 + a2)), rel=0.01
    )  # the median is straight


def test_noise_of_the_other_joints_encoders_is_smoothed(folder, rng):
    """Angles with 0.1 mrad of noise at 125 Hz: less than 0.1 N·m, where their plain second difference would be 6 N·m."""
    time = np.arange(1250) * 8e-3
    q, v, a = motion(time, rng)
    arm = Arm(ArmSpec(model="arm.xml", joint="lift"), folder)
    noisy = {name: q[:, i] + 1e-4 * rng.standard_normal(1250) for i, name in enumerate(NAMES) if name != "lift"}
    mounting, load = arm.of(time, q[:, 1], noisy, (slice(0, 1250),))
    expected = torque_of(folder / "arm.xml", q, v, a, "lift")
    got = load.inertia * a[:, 1] + mounting.gravity_moment * np.sin(q[:, 1] + mounting.gravity_angle) - load.torque
    assert np.sqrt(np.mean((got - expected)[20:-20] ** 2)) < 0.1


def test_vibration_of_another_joint_is_in_the_load(folder, rng):
    """A joint that vibrates at 30 Hz, as friction and ripple make it: the load has it, although encoders have noise."""
    time = np.arange(4000) * 1e-3
    q, v, a = motion(time, rng)
    shaken = NAMES.index("elbow")
    w = 2 * np.pi * 30
    q[:, shaken] += 1e-3 * np.sin(w * time)
    v[:, shaken] += 1e-3 * w * np.cos(w * time)
    a[:, shaken] -= 1e-3 * w**2 * np.sin(w * time)
    arm = Arm(ArmSpec(model="arm.xml", joint="lift"), folder)
    noisy = {name: q[:, i] + 2e-6 * rng.standard_normal(4000) for i, name in enumerate(NAMES) if name != "lift"}
    mounting, load = arm.of(time, q[:, 1], noisy, (slice(0, 4000),))
    expected = torque_of(folder / "arm.xml", q, v, a, "lift")
    got = load.inertia * a[:, 1] + mounting.gravity_moment * np.sin(q[:, 1] + mounting.gravity_angle) - load.torque
    error = float(np.std((got - expected)[100:-100]))
    print(f"{error:.4f} N·m of {np.std(expected):.2f}")
    assert error < 0.02 * np.std(expected)


# --- in a recording ----------------------------------------------------------------------------------------------

SIDECAR = "format: 1\njoint: test-joint\narm: {model: arm.xml, joint: lift, positions: {elbow: 0.7, pan: 0.2}}\n"


def write(folder, columns, sidecar=SIDECAR, name="a"):
    names = list(columns)
    rows = np.column_stack([columns[n] for n in names])
    text = ",".join(names) + "\n" + "\n".join(",".join(repr(float(x)) for x in row) for row in rows) + "\n"
    (folder / f"{name}.csv").write_text(text, encoding="utf-8")
    (folder / f"{name}.yaml").write_text(sidecar, encoding="utf-8")
    return folder / f"{name}.csv"


def columns(**more):
    t = np.arange(400) * 5e-3
    q = 0.4 * np.sin(2 * t)
    return {"time": t, "motor_position": 100 * q, "link_position": q, "motor_current": np.cos(t), **more}


def test_an_arm_that_holds_still_is_the_recordings_link(folder):
    r = read_recording(write(folder, columns()))
    expected = Arm(ArmSpec(model="arm.xml", joint="lift", positions={"elbow": 0.7, "pan": 0.2}), folder).mounting()
    assert r.link == expected and isinstance(r.link, Mounting)
    assert r.load is None and np.all(r.relative_inertia == 1.0) and not np.any(r.known_torque)
    still = columns()
    still["arm_elbow_position"] = np.full(400, -0.4) + 2e-4 * np.sin(np.arange(400))
    r = read_recording(write(folder, still, SIDECAR.replace("elbow: 0.7, ", "")))
    elbow = float(np.median(still["arm_elbow_position"]))
    again = Arm(ArmSpec(model="arm.xml", joint="lift", positions={"elbow": elbow, "pan": 0.2}), folder).mounting()
    assert r.link == again and r.load is None


def test_an_arm_that_moves_is_a_load(folder, tmp_path):
    t = columns()["time"]
    moving = columns(arm_elbow_position=0.5 * np.sin(3 * t), external_torque=np.ones(400))
    r = read_recording(write(folder, moving, SIDECAR + "external_torque: measured\n"))
    assert r.load.torque.shape == r.load.inertia.shape == (400,)
    assert "arm_elbow_position" not in r and list(r.arm.positions) == ["elbow"]
    np.testing.assert_allclose(r.known_torque, 1.0 + r.load.torque)
    np.testing.assert_allclose(r.relative_inertia * r.link.inertia, r.load.inertia)
    part = r.at(slice(100, 200))
    np.testing.assert_array_equal(part.load.torque, r.load.torque[100:200])
    np.testing.assert_array_equal(part.arm.positions["elbow"], moving["arm_elbow_position"][100:200])
    # With the motor's encoder alone the same, to the joint's torsion.
    del moving["link_position"]
    motor = read_recording(write(folder, moving, SIDECAR + "external_torque: measured\n", "b"))
    np.testing.assert_allclose(motor.load.torque, r.load.torque, atol=1e-6)


def test_an_arm_survives_a_round_trip(folder, tmp_path):
    t = columns()["time"]
    r = read_recording(write(folder, columns(arm_wrist_position=0.5 * np.sin(3 * t))))
    other = tmp_path / "other"
    path = write_recording(r, other)
    assert sorted(p.name for p in other.iterdir()) == ["a.parquet", "a.yaml", "a_arm.xml"]
    assert pq.read_schema(path).field("arm_wrist_position").metadata == {b"unit": b"rad"}
    again = read_recording(path)
    assert again.link.model_dump() == pytest.approx(r.link.model_dump(), rel=1e-9)
    np.testing.assert_allclose(again.load.torque, r.load.torque, atol=1e-9)
    np.testing.assert_allclose(again.load.inertia, r.load.inertia, rtol=1e-9)
    sidecar = yaml.safe_load((other / "a.yaml").read_text(encoding="utf-8"))
    assert sidecar["arm"] == {"model": "a_arm.xml", "joint": "lift", "positions": {"elbow": 0.7, "pan": 0.2}}
    assert "link" not in sidecar
    assert read_measurement(other).recordings[0].name == "a"
    pickled = read_recording(write_recording(again, other))  # onto itself
    np.testing.assert_array_equal(pickled.load.torque, again.load.torque)


def test_a_measured_recording_states_its_payloads(folder):
    """Weight and inertia of a mass in the hand, between its times in the table, against the MJCF with that mass."""
    sidecar = SIDECAR.replace(
        "}}", "}, payloads: [{start: 0.5, end: 1.2, body: hand, mass: 0.7, position: [0.05, 0, 0.03]}]}"
    )
    (folder / "hand.xml").write_text(
        ARM.replace('<body name="tool">', '<body pos="0.05 0 0.03"><inertial pos="0 0 0" mass="0.7" diaginertia="0 0 0"/></body>'
                    '<body name="tool">'), encoding="utf-8",
    )  # fmt: skip
    r, t = read_recording(write(folder, columns(), sidecar)), columns()["time"]
    positions = {"elbow": 0.7, "pan": 0.2}
    light, heavy = (
        Arm(ArmSpec(model=f"{name}.xml", joint="lift", positions=positions), folder).mounting()
        for name in ("arm", "hand")
    )
    on, q = (t >= 0.5) & (t < 1.2), r["link_position"]
    assert r.link == light
    np.testing.assert_allclose(r.load.inertia, np.where(on, heavy.inertia, light.inertia), rtol=1e-9)
    weight = [m.gravity_moment * np.sin(q + m.gravity_angle) for m in (light, heavy)]
    np.testing.assert_allclose((weight[0] - r.load.torque)[~on], weight[0][~on], atol=1e-9)
    inside = on & (t > 0.52) & (t < 1.18)
    np.testing.assert_allclose((weight[0] - r.load.torque)[inside], weight[1][inside], atol=1e-9)
    again = read_recording(write_recording(r, folder / "other"))
    np.testing.assert_allclose(again.load.torque, r.load.torque, atol=1e-9)


def test_a_gap_is_not_a_jump_of_the_arm(folder):
    """Positions on both sides of a gap do not give a velocity."""
    t = np.concatenate([np.arange(200) * 5e-3, 10 + np.arange(200) * 5e-3])
    elbow = np.concatenate([np.full(200, 0.2) + 0.01 * t[:200], np.full(200, 1.4)])
    r = read_recording(write(folder, columns(time=t, arm_elbow_position=elbow)))
    assert len(r.segments) == 2
    assert np.abs(np.diff(r.load.torque[:199])).max() < 0.3 and np.abs(np.diff(r.load.torque[201:])).max() < 0.3


def test_a_sample_between_gaps_has_no_velocity(folder):
    """A single sample once made every command fail with NaN, and a short recording printed a warning of NumPy's."""
    t = np.concatenate([np.arange(200) * 5e-3, [5.0], 10 + np.arange(199) * 5e-3])
    with warnings.catch_warnings():
        warnings.simplefilter("error", RuntimeWarning)
        r = read_recording(write(folder, columns(time=t, arm_elbow_position=0.5 * np.sin(t))))
    assert len(r.segments) == 3 and np.isfinite(r.load.torque).all()


@pytest.mark.parametrize(
    ("sidecar", "change", "words"),
    [
        (SIDECAR.replace("lift", "lfit"), {}, ["arm.joint", "did you mean 'lift'"]),
        (SIDECAR.replace("elbow: 0.7", "elow: 0.7"), {}, ["arm.positions", "did you mean 'elbow'"]),
        (SIDECAR.replace("elbow: 0.7", "lift: 0.7"), {}, ["expected another joint of the arm"]),
        (SIDECAR.replace("joint: lift", "joint: slide"), {}, ["expected a hinge"]),
        (SIDECAR.replace("}}", "}, payloads: [{start: 1, body: hnd, mass: 1}]}"), {},
         ["arm.payloads.0.body", "did you mean 'hand'"]),
        (SIDECAR.replace("arm.xml", "amr.xml"), {}, ["arm.model", "no such file 'amr.xml'"]),
        (SIDECAR.replace("arm.xml", "../arm.xml"), {}, ["arm.model"]),
        (SIDECAR + "link: {inertia: 1, gravity_moment: 1}\n", {}, ["expected either link or arm, got both"]),
        ("format: 1\njoint: test-joint\n", {}, ["expected either link or arm, got none"]),
        (SIDECAR, {"arm_elbw_position": np.zeros(400)}, ["column", "did you mean 'elbow'"]),
        (SIDECAR, {"arm_elbow_position": np.full(400, np.nan)}, ["'arm_elbow_position', row 0", "finite"]),
        ("format: 1\njoint: test-joint\nlink: {inertia: 1, gravity_moment: 1}\n", {"arm_elbow_position": np.zeros(400)},
         ["'arm_elbow_position'", "to have `arm:`"]),
    ],
)  # fmt: skip
def test_faults_of_an_arm_are_one_line(folder, sidecar, change, words):
    inner = folder / "inner"
    inner.mkdir()
    (inner / "arm.xml").write_text(ARM, encoding="utf-8")
    with pytest.raises(InputError) as caught:
        read_recording(write(inner, columns(**change), sidecar))
    message = str(caught.value)
    assert "\n" not in message and ("a.yaml" in message or "a.csv" in message)
    for word in words:
        assert word in message


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('gravity="0 0 -9.80665"', 'gravity="0 0 0"', "option.gravity: expected 9.80665 m/s² in some direction, got 0"),
        ('gravity="0 0 -9.80665"/>', '><flag gravity="disable"/></option>', "which is disabled"),
        ('<body name="base">', '<body name="ball"><joint type="ball"/><geom size="0.1"/></body><body name="base">',
         "expected an arm of hinges and slides"),
        ("<worldbody>", '<worldbody><geom type="mesh" mesh="m"/>', "not a readable MJCF"),
        ("</mujoco>", '<include file="../x.xml"/></mujoco>', "expected a file inside the MJCF's folder"),
    ],
)  # fmt: skip
def test_an_mjcf_without_an_arm_is_one_line(tmp_path, old, new, words):
    (tmp_path / "arm.xml").write_text(ARM.replace(old, new), encoding="utf-8")
    with pytest.raises(InputError) as caught:
        Arm(ArmSpec(model="arm.xml", joint="lift"), tmp_path)
    assert words in str(caught.value) and "\n" not in str(caught.value)


def test_gravity_may_point_anywhere(tmp_path):
    """An arm under the ceiling: its weight is reversed."""
    (tmp_path / "arm.xml").write_text(ARM, encoding="utf-8")
    (tmp_path / "ceiling.xml").write_text(ARM.replace("0 0 -9.80665", "0 0 9.80665"), encoding="utf-8")
    up, down = (Arm(ArmSpec(model=name, joint="lift"), tmp_path).mounting() for name in ("arm.xml", "ceiling.xml"))
    assert up.gravity_moment == pytest.approx(down.gravity_moment)
    assert np.cos(up.gravity_angle - down.gravity_angle) == pytest.approx(-1.0)


def test_names_of_columns():
    assert joint_of(column("wrist_1")) == "wrist_1"
    assert joint_of("arm__position") is None and joint_of("motor_position") is None and joint_of("arm_x") is None


def test_a_recording_of_an_arm_travels_between_processes(folder):
    import pickle

    t = columns()["time"]
    r = read_recording(write(folder, columns(arm_elbow_position=0.5 * np.sin(3 * t))))
    again = pickle.loads(pickle.dumps(r))
    assert isinstance(again, Recording)
    np.testing.assert_array_equal(again.load.torque, r.load.torque)


# --- the arm that is shipped -------------------------------------------------------------------------------------


def test_ur3e_shoulder_has_the_public_numbers():
    """About 18.5 N·m and 0.8 kg·m² stretched out with joint 4 at −π/2; at zero the arm is horizontal and falls forward."""
    mounting = Arm(
        ArmSpec(model="ur3e.xml", joint="shoulder_lift", positions={"wrist_1": -np.pi / 2}), shipped()
    ).mounting()
    print(mounting)
    assert mounting.gravity_moment == pytest.approx(18.5, rel=0.01)
    assert mounting.inertia == pytest.approx(0.8, rel=0.05)
    assert mounting.gravity_angle == pytest.approx(-np.pi / 2, abs=0.02)


def test_ur3e_weight_is_that_of_the_measured_current(shared):
    """The measured shoulder current, regressed on the weight of the MJCF: same sign and direction."""
    path = shared / "data" / "ur3e" / "shoulder_first_half.csv"
    data = np.genfromtxt(path, delimiter=",", names=True)
    q, v, a, i = (data[name] for name in ("q_rad", "qd_rad_s", "qdd_target_rad_s2", "i_motor_A"))
    moving = np.abs(v) > 0.02
    regressors = np.column_stack([np.sin(q), np.cos(q), a, v, np.sign(v), np.ones_like(q)])[moving]
    sin, cos, *_ = np.linalg.lstsq(regressors, i[moving], rcond=None)[0]
    mounting = Arm(
        ArmSpec(model="ur3e.xml", joint="shoulder_lift", positions={"wrist_1": -np.pi / 2}), shipped()
    ).mounting()
    measured = np.arctan2(cos, sin)  # i ∝ sin(q + angle)
    print(
        f"angle {measured:.4f} of {mounting.gravity_angle:.4f} rad, N·Kt {mounting.gravity_moment / np.hypot(sin, cos):.2f} N·m/A"
    )
    assert measured == pytest.approx(mounting.gravity_angle, abs=0.05)
    assert mounting.gravity_moment / np.hypot(sin, cos) == pytest.approx(10.0, rel=0.15)
