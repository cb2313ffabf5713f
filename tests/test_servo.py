"""A real servo's log with the magnitude of its torque: the missing sign is named, and nothing else is made of it."""

from __future__ import annotations

import ast

import numpy as np
import pandas as pd
import pytest

from flexspline.diagnosis.data.mistakes import find_mistakes
from flexspline.models.datasheet import Datasheet, new_joint
from flexspline.models.joint_parts import Mounting
from flexspline.models.recording import Measurement, Recording

NUMBERS = {"Kt": 0.004, "R": 4.0, "L": 5e-4, "Jm": 1e-8, "N": 345.0}


@pytest.mark.parametrize("motion", ["friction_gravity", "chirp_sweep"])
@pytest.mark.parametrize("number", [3, 4])
def test_a_torque_without_its_sign_is_named_and_judges_nothing_else(motion, number, measured, tmp_path):
    """The position was a velocity at 1.00."""
    table = pd.read_csv(measured("robots", "so101", motion, "state_motor.csv"))
    position, torque = (
        np.array([float(ast.literal_eval(cell)[number]) for cell in table[name]]) for name in ("positions", "torques")
    )
    time = 1e-6 * (table["timestamp"] - table["timestamp"][0]).to_numpy()
    fresh = np.diff(time, prepend=-1.0) > 0.0
    columns = {"link_position": position[fresh], "motor_torque": torque[fresh] / NUMBERS["N"]}
    recording = Recording("log", time[fresh], columns, link=Mounting(inertia=0.02, gravity_moment=0.2))
    sheet = Datasheet("CSG", 14, 100, NUMBERS, {"counts": 4096}, {"bits": 12}, tolerances={"Jm": 1.0, "Kt": 0.5})
    joint = new_joint(sheet, tmp_path / "servo.yaml").joint
    found = find_mistakes(Measurement("log", tmp_path, (recording,)), joint)
    sure = {m.name for m in found if m.confidence > 0.5}
    assert sure == {"sign"} and all(m.lost for m in found if m.name == "sign"), found
