"""A torque sensor in an arm whose other joint moves: one encoder, a load from the arm's mass model, friction at the output."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from flexspline.diagnosis.diagnose import diagnose
from flexspline.diagnosis.regression import regressions
from flexspline.diagnosis.validate import validate
from flexspline.models.arm import ArmSpec
from flexspline.models.datasheet import Datasheet, new_joint
from flexspline.models.recording import Measurement, Recording, in_arm

ARM = """<mujoco><worldbody>
<body name="upper"><joint name="shoulder" axis="0 1 0"/>
<inertial pos="0 0 -0.2" mass="{mass}" diaginertia="0.05 0.05 0.01"/>
<body name="lower" pos="0 0 -0.4"><joint name="elbow" axis="0 1 0"/>
<inertial pos="0 0 -0.15" mass="1.5" diaginertia="0.02 0.02 0.005"/></body></body>
</worldbody></mujoco>"""
FRICTION = 0.9


def recorded(folder, scale: float, seed: int):
    """Make a recording of the shoulder, with masses `scale` times those of the description."""
    rng = np.random.default_rng(seed)
    print("seed", seed)
    time = np.arange(0.0, 25.0, 1e-3)
    phases = rng.uniform(0, 2 * np.pi, (2, 3))
    angles, rates, bends = np.zeros((3, 2, len(time)))
    for i, waves in enumerate((((0.5, 1.1), (0.25, 2.3), (0.1, 4.7)), ((0.6, 0.9), (0.2, 3.1), (0.1, 5.3)))):
        for (size, w), phase in zip(waves, phases[i], strict=True):
            angles[i] += size * np.sin(w * time + phase)
            rates[i] += size * w * np.cos(w * time + phase)
            bends[i] -= size * w * w * np.sin(w * time + phase)
    model = mujoco.MjModel.from_xml_string(ARM.format(mass=3.0))
    data = mujoco.MjData(model)
    torque = np.empty(len(time))
    for k in range(len(time)):
        data.qpos[:], data.qvel[:], data.qacc[:] = angles[:, k], rates[:, k], bends[:, k]
        mujoco.mj_inverse(model, data)
        torque[k] = data.qfrc_inverse[0]
    reading = scale * torque + FRICTION * np.tanh(rates[0] / 0.01) + 0.05 * rng.standard_normal(len(time))
    (folder / "arm.xml").write_text(ARM.format(mass=3.0), encoding="utf-8")
    sheet = Datasheet(
        "CSG", 25, 100, {"Kt": 0.1, "R": 0.5, "L": 5e-4, "Jm": 1e-4}, {"counts": 1 << 14}, {"bits": 19}, name="shoulder"
    )
    joint = new_joint(sheet, folder / "shoulder.yaml").joint
    columns = {"link_position": angles[0] + 1e-5 * rng.standard_normal(len(time)), "joint_torque": reading}
    bare = Recording("swing", time, columns)
    arm = ArmSpec(model="arm.xml", joint="shoulder")
    recording = in_arm(bare, arm, {"arm_elbow_position": angles[1]}, folder / "arm.xml", folder, folder)
    return joint, Measurement("swing", folder, (recording,)), recording


def test_the_reading_is_compared_with_the_load_of_the_arm(tmp_path):
    """Against a torsion that nobody measured, the description was several N·m off."""
    joint, measurement, _ = recorded(tmp_path, 1.0, 1)
    assert validate(measurement, joint).residual["joint_torque"].rms == pytest.approx(FRICTION, rel=0.2)


@pytest.mark.slow
def test_friction_at_the_output_is_found(tmp_path):
    joint, measurement, _ = recorded(tmp_path, 1.0, 2)
    found = diagnose(measurement, joint)
    (friction,) = [c for c in (*found.causes, *found.minor) if c.name == "link_friction"]
    assert friction.confidence >= 0.9
    assert friction.parameters["torque"].value == pytest.approx(FRICTION, rel=0.1)
    assert not [c.name for c in found.causes if c.name != "link_friction" and c.confidence > 0.5]
    assert validate(measurement, found.extended).residual["joint_torque"].rms < 0.2 * FRICTION


@pytest.mark.slow
def test_masses_that_are_wrong_are_the_load_of_the_arm_and_no_gain_of_the_sensor(tmp_path):
    joint, measurement, recording = recorded(tmp_path, 1.4, 3)
    found = diagnose(measurement, joint)
    sure = {c.name for c in found.causes if c.confidence > 0.7}
    assert "torque_sensor_gain" not in sure
    left = validate(measurement, found.extended).residual["joint_torque"].rms
    (plain,) = regressions(measurement, joint)
    by_hand = recording["joint_torque"] - plain.predict(recording, joint)
    assert left <= 1.05 * np.sqrt(np.nanmean(by_hand**2))
