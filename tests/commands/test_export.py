"""`flexspline export … --to`: joints for other simulators."""

from __future__ import annotations

import json
import re
from dataclasses import replace

import mujoco
import numpy as np
import pytest

import flexspline as fs
from flexspline.models.recording import write_recording
from flexspline.scenarios.standard_motion import standard_motion

ROBOT = """<?xml version="1.0"?>
<mujoco model="mine">  <!-- <joint name="elbow"/> in a comment -->
  <compiler angle="degree"/>
  <worldbody>
    <body name="upper"><joint  name = 'shoulder'   axis="0 1 0" damping="3"/><geom size="0.1"/>
      <body name="lower" pos="0.3 0 0"><joint axis="0 1 0" name="elbow" damping="7"
            range="-90 90"/>   <geom size="0.05"/></body></body>
  </worldbody>
  <equality><joint joint1="elbow" joint2="shoulder" active="false"/></equality>
  <sensor><jointpos joint="elbow"/></sensor>
</mujoco>
"""
URDF = """<robot name="mine">
  <link name="a"/> <link name="b">
    <inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <!-- <joint name="elbow" type="fixed"/> -->
  <joint type="revolute" name="elbow">
    <parent link="a"/><child link="b"/>
    <limit lower="-1" upper="1" effort="1" velocity="2"/>  <!-- <dynamics damping="1"/> -->
  </joint>
  <transmission name="t"><joint name="elbow"><hardwareInterface>effort</hardwareInterface></joint></transmission>
  <ros2_control name="r" type="system"><joint name="elbow"/></ros2_control>
</robot>
"""


@pytest.fixture
def export(flexspline):
    """Return a function: arguments → what `flexspline export` prints."""

    def call(*arguments):
        code, out, err = flexspline("export", *arguments)
        assert code == 0, err
        return out

    return call


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A measurement of the test joint with other friction and inertia, the joint that made it, and the description."""
    folder = tmp_path_factory.mktemp("export")
    described = fs.load_joint("test-joint")
    described.write(folder / "described.yaml")
    changed = described.model_copy(
        update={
            "numbers": described.numbers
            | {n: described.numbers[n].model_copy(update={"value": described.numbers[n].value * f})
               for n, f in (("Fc", 1.5), ("Fs", 1.5), ("Jm", 1.3), ("bw", 2.0))}
        }
    )  # fmt: skip
    changed.write(folder / "identified.yaml")
    write_recording(standard_motion(changed).recordings[0], folder / "measurement")
    return folder


def joint_yaml(folder):
    return folder / "identified.yaml"


@pytest.mark.parametrize("more", [[], ["--rigid"]])
def test_a_written_mjcf_moves_as_the_joint(export, folder, more, tmp_path):
    """MuJoCo alone, with the measured current as control, follows the measured motion of the driven joint."""
    out = tmp_path / "joint.xml"
    found = json.loads(export(joint_yaml(folder), "--measurement", folder / "measurement", "--to", "mjcf", "--hinge", "elbow",
                              "--out", out, "--json", *more))  # fmt: skip
    assert found["unit"] == "A" and 0 < found["full"] < found["written"] < found["nominal"]
    assert not found["worse_than_nominal"] and "WORSE" not in out.read_text()
    assert f"{found['written']:.4g} A as written" in out.read_text()[:800]
    model = mujoco.MjModel.from_xml_path(str(out))
    data = mujoco.MjData(model)
    recording = fs.load_recording(folder / "measurement" / "standard_motion.parquet")
    constant = found["parameters"]["Kt" if not more else "torque_constant"]
    t, q, i = recording.time - recording.time[0], recording["link_position"], recording["motor_current"]
    # 0.15 s of prediction at a time, from the measured state.
    ends = {"elbow": q, "elbow_rotor": recording["motor_position"]}
    rates = {name: np.convolve(np.gradient(x, t), np.ones(11) / 11, "same") for name, x in ends.items()}
    errors, moved = [], []
    for begin in range(600, len(t) - 200, 211):
        mujoco.mj_resetData(model, data)
        for name in [model.joint(joint).name for joint in range(model.njnt)]:
            data.joint(name).qpos[0], data.joint(name).qvel[0] = ends[name][begin], rates[name][begin]
        for k in range(150):
            data.ctrl[0] = constant * i[begin + k]
            mujoco.mj_step(model, data)
        errors.append(data.joint("elbow").qpos[0] - q[begin + 150])
        moved.append(q[begin + 150] - q[begin])
    assert np.sqrt(np.mean(np.square(errors))) < 0.1 * np.sqrt(np.mean(np.square(moved)))


def test_the_fit_is_the_joints_own_numbers_where_the_target_has_them(export, folder, tmp_path):
    found = json.loads(export(joint_yaml(folder), "--measurement", folder / "measurement", "--to", "mjcf", "--out",
                              tmp_path / "a.xml", "--json"))["parameters"]  # fmt: skip
    p = fs.load_joint(joint_yaml(folder)).record()[0]
    assert found["inertia"] == pytest.approx(p["Jm"] + p["Jw"], rel=0.1)
    assert found["Fc"] == pytest.approx(p["Fc"], rel=0.05)
    assert found["damping"] == pytest.approx(p["bm"] + p["bw"], rel=0.15)
    x = 1e-4
    series = 1 / (1 / p["K1"] + 1 / (p["N"] ** 2 * p["Kw0"]))
    assert found["stiffness"][0] * x + found["stiffness"][1] * x**2 + found["stiffness"][2] * x**3 == pytest.approx(
        series * x, rel=0.05
    )


def test_one_that_is_worse_than_nominal_is_marked(export, folder, tmp_path):
    """Identified and described change places: the other one's error is larger, and the file says it first."""
    measured = tmp_path / "measurement"
    recording = fs.load_recording(folder / "measurement" / "standard_motion.parquet")
    write_recording(replace(recording, joint=str(joint_yaml(folder))), measured)
    found = json.loads(export(folder / "described.yaml", "--measurement", measured, "--to", "isaac", "--out",
                              tmp_path / "worse.py", "--json"))  # fmt: skip
    assert found["worse_than_nominal"] and found["written"] > found["nominal"]
    assert (tmp_path / "worse.py").read_text().startswith("# WORSE THAN NOMINAL")


def test_into_a_users_mjcf(export, folder, tmp_path):
    """The named joint's numbers change, a comment is put before; all else is the same to the letter."""
    mine, out = tmp_path / "robot.xml", tmp_path / "new.xml"
    mine.write_text(ROBOT)
    found = json.loads(export(joint_yaml(folder), "--measurement", folder / "measurement", "--to", "mjcf", "--into", mine,
                              "--hinge", "elbow", "--out", out, "--json"))["parameters"]  # fmt: skip
    model = mujoco.MjModel.from_xml_path(str(out))
    dof = model.joint("elbow").dofadr[0]
    assert model.dof_armature[dof] == pytest.approx(found["armature"])
    assert np.ravel(model.dof_damping)[np.size(model.dof_damping) // model.nv * dof] == pytest.approx(found["damping"])
    assert model.dof_frictionloss[dof] == pytest.approx(found["frictionloss"])
    assert model.joint("elbow").range[1] == pytest.approx(np.pi / 2)
    assert model.jnt_actfrcrange[model.joint("elbow").id][1] == pytest.approx(found["torque_limit"])
    other = model.joint("shoulder").dofadr[0]
    assert model.dof_armature[other] == 0.0 and model.jnt_actfrclimited[model.joint("shoulder").id] == 0
    text = out.read_text()
    without = re.sub(r"<!-- test-joint as hinge.*?-->\n", "", text, flags=re.DOTALL)
    tag = re.search(r"<joint axis=\"0 1 0\" name=\"elbow\".*?/>", ROBOT, re.DOTALL).group()
    begin = ROBOT.index(tag)
    assert without[:begin] == ROBOT[:begin] and without.endswith(ROBOT[begin + len(tag) :])
    assert mine.read_text() == ROBOT


TORTURE = """<?xml version="1.0"?>
<!-- <compiler angle="radian"/> é -->
<mujoco>
  <default><default class="drive"><joint armature="0.3" damping="4 5 6" frictionloss="0.7" stiffness="11 2 3"
    springref="20" actuatorfrcrange="-1 1"/></default></default>
  <include file="more.xml"/>
  <worldbody>
    <body name="a" childclass="drive"><joint name="left/shoulder" axis="0 1 0"/><geom size="0.1"/>
      <frame pos="0 0 1"><body name="b"> <!-- keep > this -->
        <joint
           name="left/elbow"   axis='0 1 0'
           user="1 2"/><geom size="0.1"/></body></frame></body>
  </worldbody>
  <equality><joint name="left/elbow" joint1="left/elbow" joint2="left/shoulder" active="false"/></equality>
  <actuator><position name="left/elbow" joint="left/elbow" kp="30"/></actuator>
  <keyframe><key name="home" qpos="0 0.1 0.2"/></keyframe>
</mujoco>
"""
INCLUDED = '<mujoco><worldbody><body><joint name="far"/><geom size="0.1"/></body></worldbody></mujoco>'


def test_into_a_mjcf_with_classes_includes_and_names_used_twice(export, flexspline, folder, tmp_path):
    """The joint is what the file says, whatever its class has; line ends and all else are unchanged."""
    mine, out = tmp_path / "robot.xml", tmp_path / "new.xml"
    mine.write_bytes(TORTURE.replace("\n", "\r\n").encode())
    (tmp_path / "more.xml").write_text(INCLUDED)
    arguments = (
        joint_yaml(folder),
        "--measurement",
        folder / "measurement",
        "--to",
        "mjcf",
        "--into",
        mine,
        "--out",
        out,
    )
    found = json.loads(export(*arguments, "--hinge", "left/elbow", "--json"))["parameters"]
    model = mujoco.MjModel.from_xml_path(str(out))
    joint = model.joint("left/elbow")
    dof = joint.dofadr[0]
    assert joint.damping[0] == pytest.approx(found["damping"]) and joint.stiffness[0] == 0.0
    assert not np.any(model.dof_dampingpoly[dof]) and not np.any(model.jnt_stiffnesspoly[joint.id])
    assert joint.armature[0] == pytest.approx(found["armature"]) and model.key_qpos[0, 1] == 0.1
    assert model.dof_damping[model.joint("left/shoulder").dofadr[0]] == 4.0
    before, after = mine.read_bytes(), out.read_bytes()
    assert after.count(b"\r\n") == before.count(b"\r\n")
    begin = before.index(b'user="1 2"') + len(b'user="1 2"')
    assert before[:begin].split(b"<mujoco>")[1] in after and after.endswith(before[begin:])
    code, _, err = flexspline("export", *arguments, "--hinge", "far")
    assert code == 2 and "its joints are left/shoulder, left/elbow; --into takes the file that has the joint" in err
    assert "more.xml" in err and len(err.strip().splitlines()) == 1


def test_armature_is_the_drives_inertia(export, folder, tmp_path):
    """At the output, as a rigid model needs it for motions outside those that were fitted."""
    found = json.loads(export(joint_yaml(folder), "--measurement", folder / "measurement", "--to", "mjcf", "--rigid", "--out",
                              tmp_path / "rigid.xml", "--json"))["parameters"]  # fmt: skip
    p = fs.load_joint(joint_yaml(folder)).record()[0]
    assert found["armature"] == pytest.approx(p["N"] ** 2 * (p["Jm"] + p["Jw"]), rel=0.03)


def test_into_a_users_urdf(export, folder, tmp_path):
    import xml.etree.ElementTree as ElementTree

    mine, out = tmp_path / "robot.urdf", tmp_path / "new.urdf"
    mine.write_text(URDF)
    export(joint_yaml(folder), "--measurement", folder / "measurement", "--to", "urdf", "--into", mine, "--hinge", "elbow",
           "--out", out)  # fmt: skip
    joint = ElementTree.parse(out).find("joint")
    assert out.read_text().endswith(URDF[URDF.index("  </joint>\n  <transmission") :])
    assert float(joint.find("limit").get("effort")) > 10 and joint.find("limit").get("lower") == "-1"
    assert float(joint.find("dynamics").get("friction")) > 1
    assert (
        '<!-- <dynamics damping="1"/> -->' in out.read_text()
        and '<!-- <joint name="elbow" type="fixed"/> -->' in out.read_text()
    )
    assert mujoco.MjModel.from_xml_path(str(out)).njnt == 1


@pytest.mark.slow
def test_draws_are_around_the_fit(export, folder, tmp_path):
    """Their spread is that of what they are drawn from: friction's common 15 % and the torque constant's 2 %."""
    out = tmp_path / "joint.py"
    found = json.loads(export("test-joint", "--measurement", folder / "measurement", "--to", "mjlab", "--draws", 60, "--out", out,
                              "--json"))  # fmt: skip
    drawn = json.loads((tmp_path / "joint.py.draws.json").read_text())["draws"]
    assert len(drawn) == 60
    friction = np.array([one["frictionloss"] for one in drawn]) / found["parameters"]["frictionloss"]
    constant = np.array([one["torque_constant"] for one in drawn]) / found["parameters"]["torque_constant"]
    assert abs(friction.mean() - 1) < 0.08 and 0.09 < friction.std() < 0.25
    assert abs(constant.mean() - 1) < 0.01 and 0.013 < constant.std() < 0.028


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["test-joint", "--to", "gazebo"], "--to: expected one of mjcf, urdf, mjlab, isaac, got 'gazebo'"),
        (["test-joint", "--to", "mjlab", "--into", "{mine}"], "--into: expected --to mjcf or urdf, got mjlab"),
        (["test-joint", "--to", "mjcf", "--into", "{mine}", "--hinge", "wrist"],
         "expected one joint 'wrist', got 0; its joints are shoulder, elbow"),
        (["test-joint", "--to", "urdf", "--into", "{mine}"], "expected a file with root robot for --to urdf, got mujoco"),
        (["test-joint", "--to", "mjcf", "--into", "{broken}"], "broken.xml: not readable XML"),
        (["test-joint", "--to", "urdf", "--into", "{fixed}", "--hinge", "e"], "expected type revolute or continuous, got fixed"),
        (["test-joint", "--to", "mjcf", "--into", "{slide}", "--hinge", "e"], "expected a hinge, got another kind by its class"),
        (["test-joint", "--to", "isaac", "--hinge", 'a"b'], "--hinge: expected letters, digits, spaces"),
        (["{folder}", "--rigid"], "--measurement: expected it with --to, got it alone"),
        (["nobody", "--to", "mjcf"], "nobody"),
        (["test-joint", "--to", "mjcf", "--into", "missing.xml"], "missing.xml: cannot read a file of a simulator"),
    ],
)  # fmt: skip
def test_what_cannot_be_exported(flexspline, folder, tmp_path, arguments, message):
    mine = tmp_path / "robot.xml"
    mine.write_text(ROBOT)
    names = {"mine": mine, "folder": folder / "measurement"} | {
        n: tmp_path / f"{n}.xml" for n in ("broken", "fixed", "slide")
    }
    names["broken"].write_text('<mujoco><worldbody><body><joint name="test-joint"/></bdy></worldbody></mujoco>')
    names["fixed"].write_text(
        '<robot name="r"><link name="a"/><link name="b"/>'
        '<joint name="e" type="fixed"><parent link="a"/><child link="b"/></joint></robot>'
    )
    names["slide"].write_text(
        '<mujoco><default><joint type="slide"/></default><worldbody><body><joint name="e"/><geom size="1"/></body></worldbody>'
        "</mujoco>"
    )
    given = [a.format(**names) for a in arguments]
    code, _, err = flexspline("export", *given, "--measurement", folder / "measurement", "--out", tmp_path / "out.xml")
    assert code == 2 and message in err and len(err.strip().splitlines()) == 1, err
    assert not (tmp_path / "out.xml").exists()
