"""The test joint in a swing, without a simulation: what sensors read by the equations of steady motion."""

from __future__ import annotations

import numpy as np

from flexspline.models.joint import load_joint
from flexspline.models.recording import Recording

SEED = 7


def recording(name: str = "swing", rate: float = 500.0, seconds: float = 14.0, seed: int = SEED) -> Recording:
    """The test joint in a swing, by its equations of motion without dynamics of its springs."""
    rng = np.random.default_rng(seed)
    joint = load_joint("test-joint")
    p = joint.record()[0]
    t = np.arange(0.0, seconds, 1 / rate)
    theta = 0.9 * np.sin(0.7 * t) + 0.35 * np.sin(2.1 * t)
    v = 0.63 * np.cos(0.7 * t) + 0.735 * np.cos(2.1 * t)
    a = -0.441 * np.sin(0.7 * t) - 1.5435 * np.sin(2.1 * t)
    torque = 9.0 * np.sin(theta) + 0.35 * a
    motor = 100 * (theta + torque / p["K2"])
    w = 100 * v
    friction = p["Fc"] * np.tanh(w / p["vs"]) + (p["bw"] + p["bm"]) * w
    current = (torque / 100 + friction + (p["Jm"] + p["Jw"]) * 100 * a) / p["Kt"]
    count = 2 * np.pi / 4096
    columns = {
        "motor_position": count * np.round(motor / count),
        "link_position": theta + 1.5e-6 * rng.standard_normal(len(t)),
        "motor_current": current + 0.01 * rng.standard_normal(len(t)),
        "joint_torque": torque + 0.03 * rng.standard_normal(len(t)),
        "position_command": theta,
    }
    return Recording(name, t, columns)
