"""A motion that any joint can make: back and forth at three speeds, where there is no measurement of the joint."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ..models.files import parse
from ..models.joint import Joint
from ..models.recording import Measurement
from .run import run_scenario
from .scenario import Scenario

_SPEEDS = (0.25, 0.1, 0.04) * 2  # of the no-load speed
_ANGLE = 0.8  # rad
_SHARE = 0.3  # of the motor's torque for acceleration


def standard_motion(joint: Joint) -> Measurement:
    """Simulate a joint in its default mounting on the standard motion: a measurement of one recording.

    The link moves between ± 0.8 rad, twice each at up to 25, 10 and 4 % of the no-load speed. Acceleration takes at most 30 % of
    the motor's torque.
    """
    p = joint.record()[0]
    top = p["supply_voltage"] / (p["Kt"] * p["N"])
    torque = p["N"] * p["Kt"] * p["current_limit"]
    inertia = p["Jl"] + p["N"] ** 2 * (p["Jm"] + p["Jw"])
    time, points = 0.5, [{"time": 0.5, "position": 0.0}]
    for i, speed in enumerate(_SPEEDS):
        for to in (_ANGLE, -_ANGLE):
            way = abs(to - points[-1]["position"])
            # Of a minimum-jerk motion: largest speed 1.875 way/T, largest acceleration 5.77 way/T².
            time += max(1.875 * way / (speed * top), float(np.sqrt(5.77 * way * inertia / (_SHARE * torque))))
            points.append({"time": round(time, 3), "position": to * (1.0 - 0.1 * i)})
    scenario = parse(
        {"name": "standard_motion", "joint": joint.name, "duration": round(time + 0.5, 3), "trajectory": points}, Scenario,
        "standard motion",
    ).with_joints({"joint": joint})  # fmt: skip
    recording = run_scenario(scenario, None).as_recording()
    return Measurement(recording.name, Path(joint.name), (recording,))
