"""Arms of a user's MJCF or URDF: any axes, any number of joints, held joints, branches."""

from __future__ import annotations

import json

import mujoco
import numpy as np
import pytest
import yaml

import flexspline as fs
from flexspline.models.arm import ArmSpec
from flexspline.models.arm_dynamics import Arm
from flexspline.models.joint import load_joint
from flexspline.models.recording import read_recording

AXES = ("0 0 1", "0 1 0.2", "0.1 -1 0", "0 1 1", "1 0 0.3", "0.2 0 -1", "1 1 0")
SMOOTH = np.hanning(31) / np.hanning(31).sum()


def mjcf(count: int) -> str:
    """Links in series about axes that are not parallel, then a slide; with actuators, damping, a keyframe and limits."""
    text = ""
    for k in reversed(range(count)):
        mass = 0.9 - 0.1 * k
        text = (
            f'<body name="link{k}" pos="0.14 {0.03 * (-1) ** k} 0.02" euler="{0.2 * k} {0.1 - 0.1 * k} 0">'
            f'<joint name="j{k}" axis="{AXES[k]}" pos="0.01 0 0.02" ref="{0.1 * (k == 1)}" damping="2" armature="0.1" '
            'range="-3 3"/>'
            f'<inertial pos="0.06 0.01 0.02" mass="{mass}" diaginertia="{0.004 * mass} {0.006 * mass} {0.005 * mass}"/>'
            f"{text or SLIDE}</body>"
        )
    return (
        '<mujoco><compiler angle="radian" autolimits="true"/><option gravity="0 0 -9.81"/><worldbody>'
        f'<geom type="plane" size="1 1 1"/>{text}</worldbody><actuator><position joint="j0" kp="100"/>'
        '<position joint="slide" kp="10"/></actuator>'
        f'<keyframe><key qpos="{"0 " * (count + 1)}"/></keyframe></mujoco>'
    )


SLIDE = (
    '<site name="tool" pos="0.02 0 0.1" euler="0.3 0 0"/><body name="finger" pos="0 0 0.08"><joint name="slide" type="slide" '
    'axis="1 0 0" range="0 0.05"/><inertial pos="0 0 0.01" mass="0.2" diaginertia="1e-4 2e-4 2e-4"/></body>'
)


def scenario(count: int, **more) -> dict:
    ways = [
        [
            {"time": 0.2, "position": 0.2 - 0.1 * k},
            {"time": 1.4, "position": 0.7 * (-1) ** k},
            {"time": 2.4, "position": 0.0},
        ]
        for k in range(count)
    ]
    arm = [{"name": f"j{k}", "trajectory": way, "filters": ["model"]} for k, way in enumerate(ways)]
    return {"name": "mine", "duration": 2.6, "model": "arm.xml", "positions": {"slide": 0.03}, "arm": arm} | more


def written(folder, data, model) -> str:
    (folder / data["model"]).write_text(model, encoding="utf-8")
    (folder / "mine.yaml").write_text(yaml.safe_dump(data), encoding="utf-8")
    return str(folder / "mine.yaml")


def bare(text, names=(), **held):
    """The user's own model with masses only, other joints at positions; with rotors and wave generators of joints by `names`."""
    spec, plain = mujoco.MjSpec.from_string(text), mujoco.MjModel.from_xml_string(text)
    for key in list(spec.keys):
        spec.delete(key)
    p = load_joint("test-joint").record()[0]
    for name in names:
        joint, axis = plain.joint(name), np.zeros(3)
        mujoco.mju_rotVecQuat(axis, joint.axis, plain.body_quat[joint.bodyid[0]])
        for part, inertia in (
            ("rotor", p["Jm"]),
            ("wave_generator", p["Jw"]),
        ):  # carried by the body that carries the link
            body = spec.joint(name).parent.parent.add_body(
                pos=plain.body_pos[joint.bodyid[0]], mass=1e-9, inertia=[inertia] * 3
            )
            body.explicitinertial = True
            body.add_joint(name=f"{name} {part}", axis=axis)
    model = spec.compile()
    model.dof_armature[:] = model.dof_damping[:] = 0.0
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT | mujoco.mjtDisableBit.mjDSBL_ACTUATION)
    model.opt.enableflags |= int(mujoco.mjtEnableBit.mjENBL_ENERGY)
    data = mujoco.MjData(model)
    for name, value in held.items():
        data.joint(name).qpos[:] = value
    return model, data


def rate(v):
    a = np.gradient(v, 1e-3, axis=0)
    a[2:-2] = (v[:-4] - 8 * v[1:-3] + 8 * v[3:-1] - v[4:]) / 12e-3
    return a


def motion(runs, model):
    """True angles, velocities and accelerations of joints, rotors and wave generators, and their places in the model."""
    places, found = [], []
    for name, run in runs.items():
        for own, what in ((name, "link"), (f"{name} rotor", "motor"), (f"{name} wave_generator", "wave_generator")):
            if mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_JOINT, own) >= 0:
                places.append(model.joint(own).dofadr[0])
                v = run.truth(f"{what}_velocity")
                found.append((run.truth(f"{what}_position"), v, rate(v)))
    return (places, *(np.stack(x, 1) for x in zip(*found, strict=True)))


def inverse(text, runs, **held):
    """Torques by `mj_inverse` of the user's model along the true motion, shape (n, joints)."""
    model, data = bare(text, runs, **held)
    at, *moving = motion(runs, model)
    links, found = [model.joint(name).dofadr[0] for name in runs], []
    for position, velocity, acceleration in zip(*moving, strict=True):
        data.qpos[at], data.qvel[at], data.qacc[at] = position, velocity, acceleration
        mujoco.mj_inverse(model, data)
        found.append(data.qfrc_inverse[links].copy())
    return np.array(found)


def close(got, expected, where, slack=5e-4):
    """All joints' torques agree, shape (n, joints) each, but for differences of the kinematic error's ripple at 160 Hz."""
    error, size = (np.std(x[where], axis=0) for x in (got - expected, expected))
    print("of", np.round(size, 3), "N·m:", np.round(error, 5))
    return np.all(error < 1e-3 * size + slack)


def torques(runs):
    return np.stack([run.truth("joint_torque") for run in runs.values()], 1)


INSIDE = slice(60, -60)


@pytest.fixture(scope="module")
def six(tmp_path_factory):
    folder = tmp_path_factory.mktemp("six")
    return fs.simulate_arm(written(folder, scenario(6), mjcf(6))), mjcf(6)


def test_joint_torques_are_those_of_inverse_dynamics(six):
    """All six move at the same time, about axes that are not parallel."""
    runs, text = six
    got = torques(runs)
    assert close(got, inverse(text, runs, slide=0.03), INSIDE)
    for k, run in enumerate(runs.values()):
        assert np.ptp(run.truth("link_position")) > 0.25
        assert np.std((-run.reading("torque_y") - got[:, k])[INSIDE]) < 0.033  # of its noise, 0.03
        assert run.notes == ()


def test_work_is_energy(six):
    """What the joints do on the links is the energy that the links have afterwards."""
    runs, text = six
    model, data = bare(text, slide=0.03)
    at, q, v, _ = motion(runs, model)
    energy = []
    for position, velocity in zip(q, v, strict=True):
        data.qpos[at], data.qvel[at] = position, velocity
        mujoco.mj_forward(model, data)
        energy.append(data.energy.sum())
    power = np.sum(torques(runs) * v, axis=1)
    work = np.concatenate([[0.0], np.cumsum(0.5e-3 * (power[1:] + power[:-1]))])
    error = np.array(energy) - energy[0] - work
    print(f"{np.ptp(error[INSIDE]):.5f} of {np.ptp(energy):.3f} J")
    assert np.ptp(error[INSIDE]) < 3e-3 * np.ptp(energy)


def test_the_recordings_know_the_load(six):
    """Every joint's recording, its arm and the others' encoders give the torque; an estimate finds no push in their motion."""
    from flexspline.estimator.offline import estimate_recording

    runs, _ = six
    for name, run in runs.items():
        r = run.as_recording()
        assert set(r.arm.positions) == set(runs) - {name}
        a = np.gradient(run.truth("link_velocity"), run.time)
        weight = r.link.gravity_moment * np.sin(run.truth("link_position") + r.link.gravity_angle)
        own = r.link.inertia * a + weight
        error, blind = (
            np.std(np.convolve(x - run.truth("joint_torque"), SMOOTH, mode="same")[200:-200])
            for x in (own - r.torque_of_arm, own)
        )
        print(f"{name}: {error:.4f} N·m, without the others' motion {blind:.3f} N·m")
        assert error < 0.03 and error < 0.25 * blind
    r = runs["j2"].as_recording()
    found = estimate_recording(r, load_joint("test-joint"), ["current_smoothed"]).external_torque["current_smoothed"]
    found, mistaken = (np.sqrt(np.nanmean(x[300:-300] ** 2)) for x in (found, found + r.torque_of_arm))
    print(f"external torque {found:.3f}, with the others' motion {mistaken:.3f} N·m")
    assert found < 0.5 * mistaken


@pytest.mark.parametrize("count", [1, 3, 7])
def test_any_number_of_joints(tmp_path, count):
    data = scenario(count)
    if count == 1:
        data["positions"] = {}
    runs = fs.simulate_arm(written(tmp_path, data, mjcf(count)))
    expected = inverse(mjcf(count), runs, slide=0.0 if count == 1 else 0.03)
    assert list(runs) == [f"j{k}" for k in range(count)]
    assert close(torques(runs), expected, INSIDE)
    if count == 1:
        assert runs["j0"].as_recording().load is None


def test_one_hinge_is_a_joint_alone(tmp_path):
    """A pendulum about the test joint's axis: its motion is that of the joint with the same link."""
    text = (
        '<mujoco><option gravity="0 0 -9.80665"/><worldbody><body><joint name="j0" axis="0 -1 0"/>'
        '<inertial pos="0 0 -0.25" mass="1.5" diaginertia="0.02 0.02 0.02"/></body></worldbody></mujoco>'
    )
    data = scenario(1, positions={})
    way = data["arm"][0]["trajectory"]
    ours = fs.simulate_arm(written(tmp_path, data, text), seed=5)["j0"]
    link = {"inertia": 0.02 + 1.5 * 0.25**2, "gravity_moment": 1.5 * 9.80665 * 0.25}
    theirs = fs.simulate(
        "no_load", duration=2.6, link=link, trajectory=way, filters=["model"], seed=ours.scenario.seed, mounting=""
    )
    for name in ("motor_position", "link_position", "joint_torque", "motor_current"):
        a, b = ours.truth(name), theirs.truth(name)
        assert np.max(np.abs(a - b)) < 2e-5 * np.ptp(b), name


def test_joints_without_an_entry_are_held(tmp_path):
    """A wrist that is held is part of the link before it, at its position; entries may be in any order."""
    data = scenario(3)
    data["arm"] = [data["arm"][2], data["arm"][0]]
    data["positions"] = {"j1": 0.7}
    runs = fs.simulate_arm(written(tmp_path, data, mjcf(3)))
    assert close(torques(runs), inverse(mjcf(3), runs, j1=0.7), INSIDE)
    assert set(runs["j0"].as_recording().arm.positions) == {"j2"}


def test_what_the_model_has_on_driven_hinges_is_named(tmp_path, flexspline):
    """Its actuators and dampings do not act, and the command says so; those of other joints are not named."""
    data = scenario(2, duration=0.2) | {"positions": {}}
    for one in data["arm"]:
        one |= {"trajectory": [{"time": 0, "position": 0.0}], "transient": 0}
    code, _, err = flexspline("run", written(tmp_path, data, mjcf(2)), "--out", tmp_path / "out")
    assert code == 0
    (line,) = [line for line in err.splitlines() if "not used" in line]
    assert (
        "arm.xml: actuator 0, damping of joint j0, damping of joint j1: not used, as the joints of `arm` have" in line
    )


def link(name, mass, x, z, inertia, looks=""):
    inertia = " ".join(f'i{axes}="{value}"' for axes, value in inertia.items())
    return (
        f'<link name="{name}">{looks}<inertial><origin xyz="{x} 0 {z}"/><mass value="{mass}"/><inertia ixy="0" iyz="0" '
        f"{inertia}/></inertial></link>"
    )


def turning(name, parent, child, axis, place="", more='type="continuous"', limit=""):
    return (
        f'<joint name="{name}" {more}>{place}<parent link="{parent}"/><child link="{child}"/><axis xyz="{axis}"/>{limit}'
        '<dynamics damping="1" friction="2"/></joint>'
    )


LOOKS = '<visual><geometry><mesh filename="package://nowhere/torso.dae"/></geometry></visual>'
LIMIT = '<limit lower="-2" upper="2" effort="1" velocity="1"/>'
ROD = {"xx": 0.002, "yy": 0.004, "zz": 0.004, "xz": 0.0}
URDF = "".join(
    [
        '<?xml version="1.0"?><!-- two arms on a waist --><robot name="two_arms"><link name="base"/><link name="tool"/>',
        link("torso", 1.5, 0, 0.2, {"xx": 0.02, "yy": 0.02, "zz": 0.01, "xz": 0.001}, LOOKS),
        link("left", 0.6, 0.1, 0, ROD),
        link("right", 0.5, 0.12, 0, ROD),
        turning("waist", "base", "torso", "0 0.2 1", more='type="revolute"', limit=LIMIT),
        turning("left_arm", "torso", "left", "0 1 0", '<origin xyz="0 0.2 0.3" rpy="0.3 0 0"/>'),
        turning("right_arm", "torso", "right", "0 1 1", '<origin xyz="0 -0.2 0.3" rpy="0 0 0.2"/>'),
        '<joint name="flange" type="fixed"><parent link="right"/><child link="tool"/></joint></robot>',
    ]
)


def test_a_urdf_with_branches(tmp_path):
    """Its meshes need not exist. One arm's motion loads the waist, and through it the other arm."""
    names = ("waist", "left_arm", "right_arm")
    data = scenario(3, model="robot.urdf", positions={})
    for one, name in zip(data["arm"], names, strict=True):
        one["name"] = name
    data["arm"][1]["disturbances"] = [{"kind": "step", "start": 1.0, "duration": 0.5, "torque": 1.0}]
    runs = fs.simulate_arm(written(tmp_path, data, URDF))
    plain = URDF.replace(LOOKS, "")
    pushed = np.stack([run.place.external_torque for run in runs.values()], 1)
    assert close(torques(runs) + pushed, inverse(plain, runs), np.r_[60:960, 1040:1460, 1540:2540])
    # The push is about the left arm's axis (cos 0.3 y + sin 0.3 z of the torso); the waist feels its part about (0, 0.2, 1).
    waist = np.array([0, 0.2, 1]) / np.linalg.norm([0, 0.2, 1]) @ [0, np.cos(0.3), np.sin(0.3)]
    np.testing.assert_allclose(pushed[1200], [waist, 1.0, 0.0], atol=1e-12)


def test_an_external_torque_of_a_link_turned_away(six, tmp_path):
    """A push on the last link loads the joints before it by the angle between their axes, which changes with the motion."""
    _, text = six
    data = scenario(6)
    data["arm"][5]["disturbances"] = [{"kind": "step", "start": 0.8, "duration": 1.0, "torque": 1.5}]
    pushed = fs.simulate_arm(written(tmp_path, data, text))
    model, d = bare(text, slide=0.03)
    at, q, *_ = motion(pushed, model)
    for k in (900, 1400, 1700):
        d.qpos[at] = q[k]
        mujoco.mj_kinematics(model, d)
        expected = 1.5 * d.xaxis[at] @ d.xaxis[at[5]]
        got = [run.as_recording()["external_torque"][k] for run in pushed.values()]
        np.testing.assert_allclose(got, expected, atol=1e-12)
    whole = torques(pushed) + np.stack([run.place.external_torque for run in pushed.values()], 1)
    assert close(
        whole, inverse(text, pushed, slide=0.03), slice(850, 1750), slack=1e-3
    )  # its direction is held for 1 ms


PAYLOAD = {"start": 0.7, "end": 1.9, "mass": 0.5, "body": "tool", "position": [0.02, 0.01, 0.05], "inertia": 0.001}
HELD = (
    '<body pos="0.02 0 0.1" euler="0.3 0 0"><body pos="0.02 0.01 0.05"><inertial pos="0 0 0" mass="0.5" '
    'diaginertia="0.001 0.001 0.001"/></body></body><site name="tool"'
)
APART = (slice(60, 690), slice(760, 1890), slice(1960, 2540))


@pytest.fixture(scope="module")
def carrying(tmp_path_factory):
    folder = tmp_path_factory.mktemp("carrying")
    return fs.simulate_arm(written(folder, scenario(6, payloads=[PAYLOAD]), mjcf(6)))


def test_a_payload_at_a_site(carrying):
    """All joints' torques are `mj_inverse`'s of the user's model, with a body of that mass while it is carried."""
    with_it = mjcf(6).replace('<site name="tool"', HELD)
    got, light, heavy = torques(carrying), *(inverse(text, carrying, slide=0.03) for text in (mjcf(6), with_it))
    assert np.all(np.std((heavy - light)[760:1890], axis=0) > 0.01)
    for part, expected in zip(APART, (light, heavy, light), strict=True):
        assert close(got, expected, part)


def test_energy_of_an_arm_that_picks_up_in_motion(carrying):
    """Work of the joints = change of energy while a payload is carried, and while none is."""
    for part, text in zip(APART, (mjcf(6), mjcf(6).replace('<site name="tool"', HELD), mjcf(6)), strict=True):
        model, data = bare(text, slide=0.03)
        at, q, v, _ = motion(carrying, model)
        energy = []
        for position, velocity in zip(q, v, strict=True):
            data.qpos[at], data.qvel[at] = position, velocity
            mujoco.mj_forward(model, data)
            energy.append(data.energy.sum())
        power = np.sum(torques(carrying) * v, axis=1)[part]
        work = np.concatenate([[0.0], np.cumsum(0.5e-3 * (power[1:] + power[:-1]))])
        error = np.array(energy)[part] - work
        print(f"{np.ptp(error):.5f} of {np.ptp(energy):.3f} J")
        assert np.ptp(error) < 3e-3 * np.ptp(energy)


@pytest.mark.fast_every(2)
@pytest.mark.parametrize("known", [True, False])
def test_the_recordings_know_a_payload_or_not(tmp_path, flexspline, carrying, known):
    """A recording's own load is what the joint holds if it knows the payload; written, read, and run again."""
    data = scenario(6, payloads=[PAYLOAD], known_payloads=known)
    path = written(tmp_path, data, mjcf(6))
    code, _, error = flexspline("run", path, "--no-figures", "--no-recording", "--out", tmp_path / "runs")
    assert code == 0, error
    again = tmp_path / "runs" / "mine" / "arm.yaml"
    code, _, error = flexspline("run", again, "--no-figures", "--no-recording", "--out", tmp_path / "again")
    assert code == 0, error
    for name in ("j0", "j2", "j4"):
        table = f"mine/{name}/mine_{name}.parquet"
        assert (tmp_path / "runs" / table).read_bytes() == (tmp_path / "again" / table).read_bytes()
        r, run = read_recording(tmp_path / "runs" / table), carrying[name]
        np.testing.assert_array_equal(r["joint_torque"], run.reading("joint_torque"))
        sidecar = yaml.safe_load((tmp_path / "runs" / table).with_suffix(".yaml").read_text(encoding="utf-8"))
        assert ("payloads" in sidecar["arm"]) == known
        own = r.link.inertia * rate(run.truth("link_velocity"))
        own += r.link.gravity_moment * np.sin(run.truth("link_position") + r.link.gravity_angle) - r.torque_of_arm
        error = np.std(np.convolve(own - run.truth("joint_torque"), SMOOTH, mode="same")[APART[1]])
        print(f"{name}: {error:.4f} N·m")
        assert error < 0.02 if known else error > 0.05
    code, _, error = flexspline("report", tmp_path / "runs" / "mine", "--out", tmp_path / "page.html")
    assert code == 0, error
    sentence = "The estimators do not know the simulated joint exactly."
    assert (sentence in (tmp_path / "page.html").read_text(encoding="utf-8")) != known


def test_a_folder_of_runs_can_be_run_again(tmp_path, flexspline):
    data = scenario(3)
    for one in data["arm"]:
        one["filters"] = ["model", "RAREKF"]
    path = written(tmp_path, data, mjcf(3))
    code, _, error = flexspline("run", path, "--out", tmp_path / "runs")
    assert code == 0, error
    folder = tmp_path / "runs" / "mine"
    code, _, error = flexspline(
        "run", folder / "arm.yaml", "--no-figures", "--no-recording", "--out", tmp_path / "again"
    )
    assert code == 0, error
    for name in ("j0", "j1", "j2"):
        table = f"{name}/mine_{name}.parquet"
        assert (folder / table).read_bytes() == (tmp_path / "again" / "mine" / table).read_bytes()
        assert (folder / name / "run.rrd").is_file()
    assert read_recording(folder / "j1" / "mine_j1.parquet").load is not None
    for words in (
        ("report", folder, "--out", tmp_path / "arm.html"),
        ("check", folder / "j1" / "mine_j1.parquet"),
        ("estimate", folder / "j1" / "mine_j1.parquet", "--out", tmp_path / "estimates"),
        ("validate", folder / "j1" / "mine_j1.parquet", "--out", tmp_path / "validation"),
    ):
        code, _, error = flexspline(*words)
        assert code == 0, error
    validation = json.loads((tmp_path / "validation" / "validation.json").read_text())
    residual = validation["residual"]["motor_current"]
    assert residual["rms"] < 1.5 * residual["noise"]


def test_a_recording_may_name_a_urdf(tmp_path):
    (tmp_path / "robot.urdf").write_text(URDF, encoding="utf-8")
    arm = Arm(ArmSpec(model="robot.urdf", joint="left_arm", positions={"waist": 0.4}), tmp_path)
    mounting = arm.mounting()
    assert mounting.inertia == pytest.approx(0.004 + 0.6 * 0.1**2)
    assert 0.5 < mounting.gravity_moment / (0.6 * 9.81 * 0.1) < 1.0  # its axis is not horizontal


LOOP = '<equality><connect body1="link0" body2="link2" anchor="0 0 0"/></equality></mujoco>'


@pytest.mark.parametrize(
    ("change", "model", "words"),
    [
        ({"model": "amr.xml"}, None, ["model: expected an MJCF or URDF file, no such file", "amr.xml"]),
        ({"arm.1.name": "j11"}, None, ["arm.1.name: expected a hinge of", "['j0', 'j1', 'j2']", "did you mean 'j1'"]),
        ({"arm.1.name": "slide", "positions": {}}, None, ["'slide', which is another kind of joint"]),
        ({}, ("<inertial", '<joint name="second" axis="1 0 0"/><inertial'), ["arm.0.name", "only joint of its body", "has 2"]),
        ({}, ('damping="2"', 'damping="2" stiffness="3"'), ["arm.0.name", "without a spring", "stiffness 3"]),
        ({}, ("</mujoco>", LOOP), ["equality 0: expected a tree of joints"]),
        ({}, ('name="finger"', 'name="j0_rotor"'), ["joint 'j0': a part cannot be added", "'j0_rotor'"]),
        ({}, ("<mujoco>", "<mujoco"), ["not a readable MJCF"]),
        ({}, ("-9.81", "0"), ["option.gravity: expected 9.80665"]),
        ({"positions": {"sldie": 0.1}}, None, ["positions.sldie", "did you mean 'slide'"]),
        ({"positions": {"j1": 0.1}}, None, ["positions.j1", "without an entry in `arm`", "['slide']"]),
        ({"positions": {"slide": 0.1}}, None, ["positions.slide: expected 0 to 0.05", "got 0.1"]),
        ({"arm.2.trajectory.1.position": 3.2}, None, ["arm.2.trajectory", "from -3 to 3 rad", "to 3.2 rad"]),
        ({"arm.0.length": 0.3}, None, ["arm.0.length: expected none with model"]),
        ({"arm.2.link": {"inertia": 1, "gravity_moment": 1}}, None, ["arm.2.link: expected none with model"]),
        ({"timestep": 0.001}, None, ["joint 'j0': option.timestep: expected at most"]),
        ({"arm.2.name": "j1"}, None, ["arm.2.name: expected another name"]),
        ({"payloads": [{**PAYLOAD, "body": "tol"}]}, None, ["payloads.0.body: expected a body or site", "did you mean 'tool'"]),
        ({"payloads": [{**PAYLOAD, "end": 0.5}]}, None, ["payloads.0", "end: expected a time after 0.7 s"]),
        ({"payloads": [{**PAYLOAD, "start": 3, "end": 4}]}, None, ["payloads.0.start", "before the end at 2.6 s"]),
        ({"arm.0.payloads": [{"start": 1, "mass": 1, "distance": 1}]}, None, ["payloads: expected them next to `arm`"]),
        ({"payloads": [PAYLOAD], "arm.1.feedback": "model"}, None, ["known_payloads: expected false", "model of arm.1"]),
    ],
)  # fmt: skip
def test_what_is_wrong_with_a_model_is_one_line(tmp_path, flexspline, change, model, words):
    text = mjcf(3) if model is None else mjcf(3).replace(*model, 1)
    path = written(tmp_path, scenario(3), text)
    changes = [word for key, value in change.items() for word in ("--set", f"{key}={json.dumps(value)}")]
    code, _, error = flexspline("run", path, *changes, "--out", tmp_path / "out")
    assert code == 2 and len(error.strip().splitlines()) == 1, error
    for word in words:
        assert word in error
    assert not (tmp_path / "out").exists()


def test_positions_without_a_model_are_refused(flexspline, tmp_path):
    code, _, error = flexspline("run", "two_joints", "--set", "positions={elbow: 1}", "--out", tmp_path / "out")
    assert code == 2 and "positions: expected them with model" in error
