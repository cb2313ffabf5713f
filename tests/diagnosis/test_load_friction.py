"""Friction that grows with the load, in a log of a link's encoder and a current.

How much it grows is determined. Whether it differs where the load drives is not: that looks like another torque constant.
"""

from __future__ import annotations

import numpy as np
import pytest

from flexspline.diagnosis.diagnose import diagnose
from flexspline.models.datasheet import Datasheet, new_joint
from flexspline.models.joint_parts import Mounting
from flexspline.models.recording import Measurement, Recording

SHARES = (0.1, 0.18)
INERTIA, GRAVITY = 0.3, 9.0


def pendulum(folder, share: float):
    """A pendulum's log at 200 Hz, 20 s, with 1 % of noise, and the joint's description, which has no such friction."""
    sheet = Datasheet(
        "CSG", 17, 100, {"Kt": 0.07, "R": 0.6, "L": 5e-4, "Jm": 3e-5}, {"counts": 4096}, {"bits": 18}, name="swing"
    )
    joint = new_joint(sheet, folder / "swing.yaml").joint
    n = {name: q.value for name, q in joint.numbers.items()}
    time = np.arange(0.0, 20.0, 5e-3)
    size, turns, phase = np.array([[0.8, 0.11, 0.3], [0.4, 0.27, 1.1], [0.15, 0.53, 2.0]]).T
    angle = np.sin(2 * np.pi * np.outer(time, turns) + phase) @ size
    speed = np.gradient(angle, time)
    load = INERTIA * np.gradient(speed, time) + GRAVITY * np.sin(angle)
    friction = (n["Fc"] + share * np.abs(load) / n["N"]) * np.tanh(n["N"] * speed / 0.5) + n["bw"] * n["N"] * speed
    torque = load / n["N"] + friction + (n["Jm"] + n["Jw"]) * n["N"] * np.gradient(speed, time)
    current = torque / n["Kt"]
    current += 0.01 * np.std(current) * np.random.default_rng(5).standard_normal(len(time))
    columns = {"link_position": angle, "motor_current": current}
    link = Mounting(inertia=INERTIA, gravity_moment=GRAVITY)
    return Measurement("log", folder, (Recording("swing", time, columns, link=link),)), joint


@pytest.mark.slow
@pytest.mark.parametrize("share", SHARES)
def test_it_is_named_though_back_driving_would_explain_as_much(tmp_path, share):
    """Load-dependent friction is a special case of back-driving: each had about half of the probability."""
    measurement, joint = pendulum(tmp_path, share)
    found = diagnose(measurement, joint)
    print([(c.name, c.confidence, c.parameters) for c in found.causes], found.confusable)
    assert found.verdict == "discrepancy"
    (cause,) = (c for c in found.causes if c.name == "load_dependent_friction")
    assert cause.confidence > 0.9
    assert cause.parameters["coefficient"].value == pytest.approx(share, rel=0.15)
    assert ("back_driving", "load_dependent_friction") in found.confusable
