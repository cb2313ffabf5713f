"""An MJCF says how a joint looks. Only its description has dynamics."""

from __future__ import annotations

import re

import mujoco
import numpy as np
import pytest
from driving import JOINT
from equations import check_motion

from flexspline.models import causes
from flexspline.models.errors import InputError
from flexspline.models.joint import known_joints, load_joint
from flexspline.models.mjcf import check_mjcf
from flexspline.sim import plant
from flexspline.sim.shape import shape

MJCF = JOINT.mjcf.read_text(encoding="utf-8")
YAML = known_joints()["test-joint"].read_text(encoding="utf-8")


def joint_with(tmp_path, old, new):
    """The test joint with one place of its MJCF changed."""
    assert old in MJCF, old
    (tmp_path / "own.xml").write_text(MJCF.replace(old, new, 1), encoding="utf-8")
    (tmp_path / "own.yaml").write_text(YAML.replace("model: test_joint.xml", "model: own.xml"), encoding="utf-8")
    return load_joint(tmp_path / "own.yaml")


END = "</mujoco>"
ROTOR = '<joint name="rotor" type="hinge" axis="0 -1 0" damping="2.0e-6"/>'
LINK = '<joint name="link" type="hinge" axis="0 -1 0" damping="0.02"/>'
FLEXSPLINE = 'damping="4.0" springlength="0">'
MOTOR = '<dcmotor name="motor" joint="rotor" input="ff"'
ACTS = {
    "no gravity": ('gravity="0 0 -9.80665"', 'gravity="0 0 0"'),
    "gravity aside": ('gravity="0 0 -9.80665"', 'gravity="-9.80665 0 0"'),
    "gravity of a default": ('gravity="0 0 -9.80665"', ""),
    "springs off": ('gravity="0 0 -9.80665"/>', 'gravity="0 0 -9.80665"><flag spring="disable"/></option>'),
    "actuators off": ('gravity="0 0 -9.80665"/>', 'gravity="0 0 -9.80665"><flag actuation="disable"/></option>'),
    "actuator group off": ('gravity="0 0 -9.80665"', 'gravity="0 0 -9.80665" actuatorgroupdisable="0"'),
    "energy flag": ('gravity="0 0 -9.80665"/>', 'gravity="0 0 -9.80665"><flag energy="enable"/></option>'),
    "air": ('gravity="0 0 -9.80665"', 'gravity="0 0 -9.80665" density="1000" viscosity="1"'),
    "wind": ('gravity="0 0 -9.80665"', 'gravity="0 0 -9.80665" wind="3 0 0"'),
    "masses bounded": ('autolimits="true"', 'autolimits="true" boundmass="3"'),
    "total mass": ('autolimits="true"', 'autolimits="true" settotalmass="3"'),
    "inertia from geoms": ('autolimits="true"', 'autolimits="true" inertiafromgeom="true"'),
    "joint spring": (LINK, LINK.replace("/>", ' stiffness="50"/>')),
    "joint spring elsewhere": (LINK, LINK.replace("/>", ' springref="0.5"/>')),
    "joint friction": (ROTOR, ROTOR.replace("/>", ' frictionloss="0.01"/>')),
    "joint armature": (ROTOR, ROTOR.replace("/>", ' armature="1e-5"/>')),
    "joint zero": (LINK, LINK.replace("/>", ' ref="0.3"/>')),
    "joint limits": (LINK, LINK.replace("/>", ' range="-1 1"/>')),
    "joint axis": (LINK, LINK.replace("0 -1 0", "0 1 0")),
    "joint slides": (LINK, LINK.replace("hinge", "slide")),
    "joint off the axis": (LINK, LINK.replace("/>", ' pos="0.1 0 0"/>')),
    "damping of the wave generator": (
        'name="wave_generator" type="hinge" axis="0 -1 0"',
        'name="wave_generator" type="hinge" axis="0 -1 0" damping="1e-4"',
    ),
    "floating": ('<body name="link" pos="0 0 0">', '<body name="link" pos="0 0 0" gravcomp="1">'),
    "body turned": ('<body name="flange">', '<body name="flange" euler="0 0.4 0">'),
    "body turned about another axis": ('<body name="flange">', '<body name="flange" euler="1.2 0 0">'),
    "a second weight": (
        '<site name="tip"',
        '<body name="weight" pos="0.1 0 -0.3"><inertial pos="0 0 0" mass="0.5" diaginertia="1e-4 1e-4 '
        '1e-4"/></body><site name="tip"',
    ),
    "rotor off its axis": (
        '<body name="rotor" pos="0 0.1 0">',
        '<body name="rotor" pos="0 0.1 0"><body pos="0.02 0 0"><inertial pos="0 0 0" mass="0.1" '
        'diaginertia="1e-9 1e-9 1e-9"/></body>',
    ),
    "coefficient's sign": ('<joint joint="link" coef="-1"/>', '<joint joint="link" coef="1"/>'),
    "coefficient's size": ('<joint joint="rotor" coef="1"/>', '<joint joint="rotor" coef="2"/>'),
    "tendon on another joint": ('<joint joint="rotor" coef="1"/>', '<joint joint="link" coef="1"/>'),
    "tendon friction": (FLEXSPLINE, FLEXSPLINE.replace("0\">", '0" frictionloss="1">')),
    "tendon armature": (FLEXSPLINE, FLEXSPLINE.replace("0\">", '0" armature="1">')),
    "a further tendon": ("</tendon>", '<fixed name="t" stiffness="3"><joint joint="link" coef="1"/></fixed></tendon>'),
    "a further actuator": ("</actuator>", '<position joint="link" kp="9"/></actuator>'),
    "gear": (MOTOR, MOTOR + ' gear="2"'),
    "motor elsewhere": (MOTOR, MOTOR.replace('joint="rotor"', 'joint="link"')),
    "motor's delay": (MOTOR, MOTOR + ' nsample="5" delay="0.005"'),
    "motor's range": (MOTOR, MOTOR + ' ctrlrange="-0.01 0.01"'),
    "equality": (END, '<equality><joint joint1="link"/></equality></mujoco>'),
    "own numbers": (END, '<custom><numeric name="n" data="1"/></custom></mujoco>'),
    "sensor cut off": ('<torque name="torque"', '<torque name="torque" cutoff="1"'),
    "sensor turned": ('<site name="force_torque" pos="0 0 0"', '<site name="force_torque" euler="1 0 0" pos="0 0 0"'),
    "no sensor": ('<torque name="torque"', '<torque name="twist"'),
}  # fmt: skip


REFUSED = {
    "a fourth joint": ('<body name="link" pos="0 0 0">',
                       '<body name="link" pos="0 0 0"><joint name="wobble" type="hinge" axis="0 0 1"/>',
                       "expected the joints rotor, wave_generator, link in this order"),
    "a joint of another name": ('<joint name="rotor"', '<joint name="spindle"', "rotor"),
    "no site": ('<site name="force_torque"', '<site name="elsewhere"', ""),
    "not XML": ("<worldbody>", "<worldbody", "not a readable MJCF"),
}  # fmt: skip


@pytest.mark.parametrize("case", REFUSED)
def test_an_mjcf_without_a_joint_is_one_line(tmp_path, monkeypatch, case):
    old, new, expected = REFUSED[case]
    joint = joint_with(tmp_path, old, new)
    monkeypatch.chdir(tmp_path)
    before = sorted(tmp_path.iterdir())
    with pytest.raises(InputError) as caught:
        plant.build(joint)
    message = str(caught.value)
    print(message)
    assert message.startswith(str(tmp_path / "own.xml")) and "\n" not in message
    assert expected in message
    assert sorted(tmp_path.iterdir()) == before  # no log of MuJoCo's


LOOKS = {
    "colours": ('rgba="0.22 0.44 0.72 1"', 'rgba="1 0 0 1"'),
    "another shape": ('<geom type="sphere" pos="0 -0.02 -0.4" size="0.03" material="steel"/>',
                      '<geom type="box" pos="0 -0.02 -0.4" size="0.03 0.05 0.07" material="steel"/>'),
    "a lamp and a camera": ("<worldbody>", '<worldbody><camera name="c" pos="1 1 1"/><light pos="0 0 3"/>'),
    "a wall": ("<worldbody>", '<worldbody><body name="wall" pos="0 0.3 0"><geom type="box" size="1 0.01 1"/></body>'),
    "the housing turned": (
        '<body name="housing">',
        '<body name="housing"><geom type="sphere" size="0.01" euler="1 2 3"/>',
    ),
    "its own timestep": ('timestep="0.0005"', 'timestep="0.002"'),
    "numbers that the YAML states": ('damping="0.02"', 'damping="7"'),
    "inertia that the YAML states": ('mass="3.6709783"', 'mass="99"'),
    "a motor that the YAML states": ('motorconst="0.0603 0.0603"', 'motorconst="6 6"'),
    "a view": (
        'size="0.008" rgba="0.9 0.2 0.2 1"/>\n          <site name="tip"',
        'size="0.001"/>\n          <site name="tip"',
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", [*LOOKS, *ACTS])
@pytest.mark.filterwarnings("ignore:.*in the MJCF:flexspline.models.errors.InputWarning")
def test_the_mjcfs_dynamics_do_not_change_the_motion(tmp_path, case):
    """Geometry and colours are the MJCF's; what acts is the YAML's alone: the same motion to the bit."""

    def moved(joint):
        model = plant.build(joint)
        data = mujoco.MjData(model)
        plant.start(model, data)
        data.ctrl[0] = 0.05
        mujoco.mj_step(model, data, nstep=200)
        return np.r_[data.qpos, data.qvel]

    np.testing.assert_array_equal(moved(joint_with(tmp_path, *(LOOKS | ACTS)[case])), moved(JOINT))


@pytest.mark.parametrize("name", sorted(known_joints()))
def test_built_models_move_as_the_equations_say(name):
    """Every shipped joint and mounting, at several steps, with and without the motor's winding; the error said in figures."""
    joint = load_joint(name)
    for mounting in joint.mountings:
        for timestep in (1e-5, 2e-4, 1e-3):
            for ideal in (False, True):
                record = joint.record(joint.mount(mounting))
                check_motion(plant.build(joint, timestep=timestep, record=record, ideal_current=ideal), record)
        record = joint.record(joint.mount(mounting))
        model = plant.build(joint, joint.mount(mounting), record=record)
        for field, factor in (("Jl", 1.001), ("Kw0", 1.001), ("bm", 2.0), ("Fc", 1.01)):
            other = record.copy()
            other[0][field] *= factor
            with pytest.raises(AssertionError, match=r"accelerates by .* rad/s², expected"):
                check_motion(model, other)


@pytest.mark.parametrize("name", causes.names())
def test_built_models_have_their_effects(name, rng):
    record = JOINT.record()
    for _ in range(3):
        causes.get(name).apply(record[0], causes.get(name).draw(record[0], rng))
        check_motion(plant.build(JOINT, record=record), record)


# --- files -------------------------------------------------------------------------------------------------------

REACHES = {
    "include of a folder above": '<include file="../secret.xml"/>',
    "include of an absolute path": '<include file="/etc/passwd"/>',
    "mesh above": '<asset><mesh name="m" file="../m.stl"/></asset>',
    "texture elsewhere": '<asset><texture name="t" type="2d" file="/usr/t.png"/></asset>',
    "cube of textures": '<asset><texture name="t" type="cube" fileright="../a.png"/></asset>',
    "folder of meshes": '<compiler meshdir="/usr/share"/>',
    "folder of textures": '<compiler texturedir="a/../../b"/>',
    "height field": '<asset><hfield name="h" file="..\\\\h.png" size="1 1 1 1"/></asset>',
    "a drive": '<asset><mesh name="m" file="C:/m.stl"/></asset>',
    "a scheme": '<asset><mesh name="m" file="http://x/m.stl"/></asset>',
    "a model": '<asset><model name="m" file="../m.xml"/></asset>',
}


@pytest.mark.parametrize("case", REACHES)
def test_files_elsewhere_are_refused(tmp_path, case):
    (tmp_path / "secret.xml").write_text("<mujoco/>", encoding="utf-8")
    folder = tmp_path / "joint"
    folder.mkdir()
    joint = joint_with(folder, END, REACHES[case] + END)
    with pytest.raises(InputError) as caught:
        plant.build(joint)
    assert "expected a file inside the MJCF's folder" in str(caught.value) and "\n" not in str(caught.value)


def test_a_link_to_a_file_elsewhere_is_refused(tmp_path):
    (tmp_path / "secret.xml").write_text("<mujocoinclude/>", encoding="utf-8")
    folder = tmp_path / "joint"
    folder.mkdir()
    (folder / "near.xml").symlink_to(tmp_path / "secret.xml")
    with pytest.raises(InputError, match=r"expected a file inside the MJCF's folder, got 'near\.xml'"):
        plant.build(joint_with(folder, END, '<include file="near.xml"/>' + END))


def test_an_include_that_includes_itself_ends(tmp_path):
    (tmp_path / "loop.xml").write_text('<mujocoinclude><include file="loop.xml"/></mujocoinclude>', encoding="utf-8")
    with pytest.raises(InputError, match="no more than 10 deep"):
        plant.build(joint_with(tmp_path, END, '<include file="loop.xml"/>' + END))


def test_files_in_the_folder_are_accepted(tmp_path):
    (tmp_path / "parts").mkdir()
    (tmp_path / "parts" / "lamp.xml").write_text(
        '<mujocoinclude><worldbody><light pos="0 0 2"/></worldbody></mujocoinclude>', encoding="utf-8"
    )
    assert shape(joint_with(tmp_path, END, '<include file="parts/lamp.xml"/>' + END)).nlight == 2


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ('<!DOCTYPE x [<!ENTITY a "b">]><mujoco/>', "without document type declarations"),
        ('<mujoco><extension><plugin plugin="mujoco.pid"/></extension></mujoco>', "without plugins"),
        ("nothing", "not a readable MJCF"),
        ("", "not a readable MJCF"),
    ],
)
def test_no_declarations_and_no_plugins(tmp_path, text, words):
    path = tmp_path / "a.xml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=re.escape(words)):
        check_mjcf(path)
    with pytest.raises(InputError, match="no such file"):
        check_mjcf(tmp_path / "b.xml")
