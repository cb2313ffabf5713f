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


def test_into_a_users_urdf(export, folder, tmp_path):
    import xml.etree.ElementTree as ElementTree

    mine, out = tmp_path / "robot.urdf", tmp_path / "new.urdf"
    mine.write_text(URDF)
    export(joint_yaml(folder), "--measurement", folder / "measurement", "--to", "urdf", "--into", mine, "--hinge", "elbow",
           "--out", out)  # fmt: skip
    joint = ElementTree.parse(out).find("joint")
    assert float(joint.find("limit").get("effort")) > 10 and joint.find("limit").get("lower") == "-1"
    assert float(joint.find("dynamics").get("friction")) > 1
    assert (
        '<!-- <dynamics damping="1"/> -->' in out.read_text()
        and '<!-- <joint name="elbow" type="fixed"/> -->' in out.read_text()
    )
    assert mujoco.MjModel.from_xml_path(str(out)).njnt == 1


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
        (["nobody", "--to", "mjcf"], "nobody"),
        (["test-joint", "--to", "mjcf", "--into", "missing.xml"], "missing.xml: cannot read a file of a simulator"),
    ],
)  # fmt: skip
def test_what_cannot_be_exported(flexspline, folder, tmp_path, arguments, message):
    mine = tmp_path / "robot.xml"
    mine.write_text(ROBOT)
    given = [a.format(mine=mine) for a in arguments]
    code, _, err = flexspline("export", *given, "--measurement", folder / "measurement", "--out", tmp_path / "out.xml")
    assert code == 2 and message in err and len(err.strip().splitlines()) == 1, err
    assert not (tmp_path / "out.xml").exists()
