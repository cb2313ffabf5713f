"""`fs.attach`: a joint's laws on hinges of somebody else's model."""

from __future__ import annotations

import copy
import subprocess
import sys

import mujoco
import numpy as np
import pytest
from driving import JOINT, record_of
from energy import energy_of

import flexspline as fs
from flexspline.models.errors import InputError, InputWarning
from flexspline.sim import native, plant, plugin

STEP = plant.TIMESTEP
AXES = ["0 0 1", "0 1 0", "0.6 0 0.8", "0 -1 0", "1 0 0", "0 0.28 0.96"]

SOMEBODYS = """<mujoco model="somebody's"><compiler angle="degree"/><option timestep="0.0002" integrator="RK4"/>
  <custom><numeric name="mine" data="1 2 3"/><numeric name="long" size="900" data="5"/></custom>
  <default><joint damping="3" armature="0.2" frictionloss="0.5"/></default>
  <worldbody><geom type="plane" size="3 3 0.1"/>
    <body name="box" pos="0.5 0 0.06"><freejoint/><geom type="box" size="0.05 0.05 0.05" mass="0.3"/></body>
    <body name="upper" pos="0 0 0.8" euler="10 20 30"><joint name="shoulder" axis="0 1 0" range="-90 90" ref="10"/>
      <geom type="capsule" size="0.04" fromto="0 0 0 0.3 0 0" mass="1"/>
      <body name="lower" pos="0.3 0 0"><joint name="elbow" axis="0 1 0"/>
        <geom type="capsule" size="0.03" fromto="0 0 0 0.25 0 0" mass="0.6"/>
        <body pos="0.25 0 0"><joint name="finger" axis="0 0 1"/><geom size="0.03" mass="0.1"/></body></body></body></worldbody>
  <tendon><fixed name="strap" stiffness="3" range="-1 1" limited="true"><joint joint="elbow" coef="1"/>
    <joint joint="finger" coef="-0.5"/></fixed></tendon>
  <actuator><position joint="shoulder" kp="400" kv="20" inheritrange="1"/><motor name="pull" tendon="strap"/></actuator>
  <keyframe><key name="home" qpos="0.5 0 0.06 1 0 0 0 0.2 -0.3 0.1" qvel="0 0 0 0 0 0 0.5 0 0" ctrl="0.2 0"/></keyframe>
</mujoco>"""


def arm(joints=6, moving=None, geared="motor", timestep=STEP) -> str:
    """A serial arm; all hinges but `moving` are held by an inertia that no torque turns."""
    text = f'<mujoco><option timestep="{timestep}" integrator="implicitfast"/><worldbody>'
    for k in range(joints):
        held = 'armature="1e15"' if moving is not None and k != moving else 'damping="0.02" armature="0.1"'
        text += (
            f'<body name="b{k}" pos="0.02 0.01 0.2"><joint name="j{k}" axis="{AXES[k % 6]}" {held}/>'
            f'<inertial pos="0.01 0.02 0.1" mass="{1.5 - 0.2 * k}" diaginertia="0.02 0.03 0.015"/>'
        )
    return text + "</body>" * joints + "</worldbody></mujoco>"


def attached(text: str, *names: str, joint=JOINT):
    spec = mujoco.MjSpec.from_string(text)
    for name in names:
        fs.attach(spec, name, joint)
    model = spec.compile()
    return model, mujoco.MjData(model)


def motions(model, data, control, steps, which=()):
    """Positions after each step under a control of time."""
    found = np.zeros((steps, model.nq))
    for k in range(steps):
        data.ctrl[:] = control(k)
        mujoco.mj_step(model, data)
        found[k] = data.qpos
    return found


@pytest.mark.parametrize("moving", [0, 2, 5])
@pytest.mark.parametrize(
    "effects",
    [{}, {"hysteresis_torque": 0.8, "hysteresis_extent": 8e-5, "friction_load": 0.1, "friction_asymmetry": 0.2,
          "backlash": 1e-5, "cogging_order": 4, "cogging_amplitude": 2e-3, "friction_temperature": -0.01}],
    ids=["plain", "effects"],
)  # fmt: skip
def test_one_joint_of_a_locked_arm_is_the_plant(moving, effects, monkeypatch):
    """The same gear on a six-axis arm whose other hinges are held, and as a separate plant with that inertia."""
    text = arm(moving=moving).replace("<option ", '<option gravity="0 0 0" ')
    record = record_of("link", **effects)
    monkeypatch.setattr(type(JOINT), "record", lambda self, mounting=None: record.copy())
    model, data = attached(text, f"j{moving}")
    record[0]["Jl"], record[0]["Mg"] = plugin.instance(data, 0)[1][0]["Jl"] - 1e-9, 0.0  # the plant's flange has 1e-9
    alone = plant.build(JOINT, record=record)
    reference = mujoco.MjData(alone)
    (places, _), _ = plugin.instance(data, 0)

    def control(k):
        return 0.15 * np.sin(2 * np.pi * 1.7 * k * STEP) + 0.03 * (k * STEP > 0.3)

    ours, theirs = motions(model, data, control, 2500)[:, places], motions(alone, reference, control, 2500)
    assert np.ptp(theirs[:, 2]) > 0.01  # it moves
    np.testing.assert_allclose(ours[:, :2], theirs[:, :2], rtol=0, atol=1e-9 * 100)
    np.testing.assert_allclose(ours[:, 2], theirs[:, 2], rtol=0, atol=1e-9)


@pytest.mark.slow
def test_energy_of_a_six_axis_arm_is_kept():
    """Undamped and without friction, wound up and let go: MuJoCo's energy of the bodies and the springs' of the gears."""
    changes = dict.fromkeys(("bm", "bw", "bl", "df", "dw", "s1", "Fc", "Fs", "s0"), 0.0)
    joint = copy.deepcopy(JOINT)
    record = record_of("link", **changes)
    record[0]["amplitude"] = 0.0
    object.__setattr__(joint, "record", lambda mounting=None: record.copy())
    model, data = attached(arm().replace("<worldbody>", '<option><flag energy="enable"/></option><worldbody>', 1),
                           *(f"j{k}" for k in range(6)), joint=joint)  # fmt: skip
    for actuator in range(model.nu):
        model.actuator_gear[actuator] = 0.0
    data.qpos[:6] = [0.3, -0.5, 0.8, 0.2, -1.0, 0.4]
    fs.align(model, data)
    totals = []
    for _ in range(5000):
        before, speed = data.qpos.copy(), data.qvel.copy()
        mujoco.mj_step(model, data)
        # Positions belong to the beginning of the step, velocities to the middle of the steps around it.
        at = mujoco.MjData(model)
        at.qpos[:], at.qvel[:] = before, 0.5 * (speed + data.qvel)
        mujoco.mj_forward(model, at)
        springs = 0.0
        for i in range(model.nplugin):
            (places, velocities), own = plugin.instance(data, i)
            held = own.copy()
            held[0]["Jm"] = held[0]["Jw"] = held[0]["Jl"] = 0.0
            e = energy_of(held, before[places], at.qvel[velocities])
            springs += e.flexspline + e.wave_generator
        totals.append(at.energy.sum() + springs)
    totals = np.array(totals)
    kinetic = np.ptp(totals - totals[0])
    assert kinetic < 5e-3 * 20.0  # J, of about 20 J that are exchanged
    assert abs(totals[-500:].mean() - totals[:500].mean()) < 2e-2


def test_a_users_model():
    """Keyframes, numerics, a limited tendon, contacts, an actuator with an inherited range: all as before, with gears."""
    plain = mujoco.MjModel.from_xml_string(SOMEBODYS)
    model, data = attached(SOMEBODYS, "shoulder", "elbow")
    np.testing.assert_array_equal(model.numeric("mine").data, [1, 2, 3])
    assert model.nu == plain.nu + 1  # the shoulder's own servo turns the rotor; the elbow had none
    np.testing.assert_allclose(model.actuator_ctrlrange[0], plain.actuator_ctrlrange[0])
    mujoco.mj_resetDataKeyframe(model, data, 0)
    assert data.joint("shoulder").qpos[0] == 0.2 and data.joint("shoulder").qvel[0] == 0.5
    assert data.joint("finger").qpos[0] == 0.1 and data.joint("elbow").qpos[0] == -0.3
    assert data.joint("shoulder_rotor").qpos[0] == pytest.approx(20.0, abs=0.03)
    assert data.joint("elbow_wave_generator").qpos[0] == pytest.approx(-30.0, abs=0.03)
    for _ in range(10000):
        mujoco.mj_step(model, data)
    assert np.isfinite(data.qpos).all() and not any(w.number for w in data.warning)
    assert data.joint("shoulder").qpos[0] == pytest.approx(0.2, abs=0.15)  # its servo, against the weight
    assert abs(data.joint("shoulder_rotor").qpos[0] / 100 - data.joint("shoulder").qpos[0]) < 5e-3
    mujoco.mj_resetData(model, data)
    assert data.joint("shoulder_rotor").qpos[0] == pytest.approx(100 * np.deg2rad(10))


def test_the_bodies_of_the_model_move_without_gears_as_before():
    """Contacts of what has no gear: the box falls and rests exactly as in the plain model."""
    plain = mujoco.MjSpec.from_string(SOMEBODYS)
    plain.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    one = plain.compile()
    other, data = attached(SOMEBODYS, "shoulder", "elbow")
    before = mujoco.MjData(one)
    for model, d in ((one, before), (other, data)):
        d.qpos[:3] = 0.6, 0.0, 0.3
        mujoco.mj_step(model, d, nstep=3000)
    np.testing.assert_allclose(data.qpos[:3], before.qpos[:3], atol=1e-6)


def test_states_are_saved_copied_reset_and_rolled_out():
    from mujoco import rollout

    model, data = attached(arm(3), "j0", "j1", "j2")
    kind = mujoco.mjtState.mjSTATE_FULLPHYSICS
    mujoco.mj_step(model, data, nstep=200)
    state = np.empty(mujoco.mj_stateSize(model, kind))
    mujoco.mj_getState(model, data, state, kind)
    twin = copy.copy(data)
    control = 0.05 * np.ones((300, model.nu))
    states, _ = rollout.rollout(
        model, [mujoco.MjData(model) for _ in range(2)], np.stack([state, state]), control[None]
    )
    motions(model, data, lambda k: 0.05, 300)
    motions(model, twin, lambda k: 0.05, 300)
    np.testing.assert_array_equal(data.qpos, twin.qpos)
    np.testing.assert_array_equal(states[0], states[1])
    np.testing.assert_array_equal(states[0, -1, 1 : 1 + model.nq], data.qpos)
    mujoco.mj_resetData(model, data)
    np.testing.assert_array_equal(data.plugin_state, mujoco.MjData(model).plugin_state)


def test_a_state_with_velocities_begins_without_a_kick():
    """A keyframe, velocities that were set, and a saved physics state have no memory of a step before."""
    key = "<keyframe><key qpos='0.3' qvel='1.0'/></keyframe></mujoco>"
    model, data = attached(arm(1).replace("</mujoco>", key), "j0")
    kind, after = mujoco.mjtState.mjSTATE_PHYSICS, []
    for begin in ("key", "aligned", "state"):
        mujoco.mj_resetDataKeyframe(model, data, 0)
        if begin == "aligned":
            fs.align(model, data)
        if begin == "state":
            state = np.empty(mujoco.mj_stateSize(model, kind))
            mujoco.mj_getState(model, data, state, kind)
            data = mujoco.MjData(model)
            mujoco.mj_setState(model, data, state, kind)
        mujoco.mj_step(model, data, nstep=3)
        after.append(data.qvel.copy())
    np.testing.assert_allclose(after[0], after[1], rtol=1e-3)
    np.testing.assert_array_equal(after[0], after[2])
    assert after[0][0] == pytest.approx(1.0, abs=0.02)


def test_global_callbacks_are_unchanged():
    """Others' callbacks act next to the gear, and none is set for it."""
    import ctypes

    model, data = attached(arm(2), "j0", "j1")
    for name in ("mjcb_passive", "mjcb_control", "mjcb_act_dyn", "mjcb_act_gain", "mjcb_act_bias", "mjcb_sensor"):
        assert ctypes.c_void_p.in_dll(native.library(), name).value is None, name
    calls = []
    mujoco.set_mjcb_control(lambda m, d: calls.append(d.time))
    try:
        mujoco.mj_step(model, data, nstep=3)
    finally:
        mujoco.set_mjcb_control(None)
    assert len(calls) == 3


def test_the_written_model_runs_in_a_fresh_process(tmp_path):
    """`import flexspline` alone makes an MJCF with the plugin run, whichever is imported first."""
    spec = mujoco.MjSpec.from_string(arm(2))
    fs.attach(spec, "j1", "test-joint")
    spec.compile()
    (tmp_path / "arm.xml").write_text(spec.to_xml())
    for order in ("import flexspline, mujoco", "import mujoco, flexspline"):
        code = (
            f"{order}; m = mujoco.MjModel.from_xml_path({str(tmp_path / 'arm.xml')!r}); d = mujoco.MjData(m); "
            "mujoco.mj_step(m, d, nstep=50); print(m.nplugin, abs(d.qvel).max() > 0)"
        )
        out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
        assert out.split() == ["1", "True"]


def test_numbers_of_a_configuration_can_be_edited():
    """Text is what acts; what is no number is refused."""
    spec = mujoco.MjSpec.from_string(arm(1))
    fs.attach(spec, "j0", "test-joint")
    spec.compile()
    text = spec.to_xml()
    for written, value in (
        ("12.5e3", 12500.0),
        ("  +8400 ", 8400.0),
        ("1e-3", 1e-3),
        ("0.1234567890123456789", 0.12345678901234568),
    ):
        edited = text.replace('<config key="K1" value="8400.0"/>', f'<config key="K1" value="{written}"/>')
        data = mujoco.MjData(mujoco.MjModel.from_xml_string(edited))
        assert plugin.instance(data, 0)[1][0]["K1"] == pytest.approx(value, rel=1e-15)
    for written in ("8400 1", "eight", "--1", "1e", "0x10", "1.2.3"):
        with pytest.raises(Exception, match="plugin->init failed"):
            mujoco.MjModel.from_xml_string(
                text.replace('<config key="K1" value="8400.0"/>', f'<config key="K1" value="{written}"/>')
            )
    with pytest.raises(ValueError, match="unrecognized attribute"):
        mujoco.MjModel.from_xml_string(text.replace('key="K1"', 'key="K9"'))


@pytest.mark.parametrize(
    ("text", "name", "message"),
    [
        (arm(2), "nobody", r"joint 'nobody': expected a hinge of the model, one of j0, j1"),
        (arm(2).replace("<worldbody>", '<worldbody><body name="j1_rotor"/>'), "j1", "a part cannot be added: .*j1_rotor"),
        (SOMEBODYS.replace('name="finger"', 'name="finger" type="slide"'), "finger", "expected a hinge"),
        (arm(2, timestep=0.002), "j0", r"option.timestep: expected at most 0.00043 s, .* got 0.002 s"),
        (arm(1).replace("<inertial", '<joint name="second" axis="1 0 0"/><inertial'), "j0", "a body with one joint, got 2"),
        (arm(1).replace("<worldbody>", '<compiler settotalmass="3"/><worldbody>'), "j0", "change the inertia of the rotor"),
    ],
)  # fmt: skip
def test_an_impossible_attachment_is_one_line_and_changes_nothing(text, name, message):
    spec = mujoco.MjSpec.from_string(text)
    before = [one.name for one in spec.bodies]
    with pytest.raises(InputError, match=message) as error:
        fs.attach(spec, name, "test-joint")
    assert "\n" not in str(error.value)
    assert [one.name for one in spec.bodies] == before


def test_urdf_and_a_flexible_link():
    """Any axis; of a joint with a flexible link the link's own part is left out, and that is said."""
    text = """<robot name="r"><link name="base"/><link name="a"><inertial><origin xyz="0 0 0.2"/><mass value="2"/>
      <inertia ixx="0.02" iyy="0.02" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>
      <joint name="j1" type="revolute"><parent link="base"/><child link="a"/><axis xyz="0 0.6 0.8"/>
      <limit lower="-1" upper="1" effort="10" velocity="1"/><dynamics damping="1" friction="2"/></joint></robot>"""
    spec = mujoco.MjSpec.from_string(text)
    spec.option.timestep = 1e-4
    with pytest.warns(InputWarning, match="joint 'j1': the flexible part of its link is left out"):
        fs.attach(spec, "j1", "ur3e-shoulder")
    model = spec.compile()
    data = mujoco.MjData(model)
    data.joint("j1").qpos[0] = 0.3
    fs.align(model, data)
    mujoco.mj_step(model, data, nstep=2000)
    ratio = fs.load_joint("ur3e-shoulder").numbers["N"].value
    assert np.isfinite(data.qpos).all()
    assert data.joint("j1_rotor").qpos[0] / ratio == pytest.approx(data.joint("j1").qpos[0], abs=2e-3)


def test_a_second_gear_on_a_hinge_is_refused():
    spec = mujoco.MjSpec.from_string(arm(1))
    fs.attach(spec, "j0", "test-joint")
    with pytest.raises(InputError, match="expected a hinge without a gear"):
        fs.attach(spec, "j0", "test-joint")


def test_prefixes_of_models_in_models():
    """A model with a gear, attached to another one twice, by MuJoCo's own means."""
    parent = mujoco.MjSpec.from_string(f'<mujoco><option timestep="{STEP}" integrator="implicitfast"/></mujoco>')
    for prefix in ("left_", "right_"):
        child = mujoco.MjSpec.from_string(arm(1))
        fs.attach(child, "j0", "test-joint")
        parent.attach(child, prefix=prefix, frame=parent.worldbody.add_frame(pos=[0, len(prefix), 0]))
    model = parent.compile()
    data = mujoco.MjData(model)
    data.ctrl[1] = 0.1
    mujoco.mj_step(model, data, nstep=500)
    left, right = (plugin.instance(data, i)[0][0] for i in range(2))
    assert sorted([*left, *right]) == list(range(6))
    assert abs(data.qpos[right[0]] / 100 - data.qpos[right[2]]) < 0.01
    assert abs(data.qpos[right[2]] - data.qpos[left[2]]) > 0.01
