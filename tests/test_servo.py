"""Logs of real drives: a torque without its sign is named, and nothing else is claimed of it or of a joint with an unmeasured
load."""

from __future__ import annotations

import ast
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from benchmarks.real_logs import servo_recordings
from flexspline.diagnosis.data.mistakes import find_mistakes
from flexspline.models.datasheet import Datasheet, new_joint
from flexspline.models.joint import load_joint
from flexspline.models.joint_parts import Mounting
from flexspline.models.recording import Measurement, Recording

NUMBERS = {"Kt": 0.004, "R": 4.0, "L": 5e-4, "Jm": 1e-8, "N": 345.0}


@pytest.mark.parametrize(
    ("motion", "number"), [("friction_gravity", 3), ("friction_gravity", 4), *(("chirp_sweep", n) for n in (1, 3, 4))]
)
def test_a_torque_without_its_sign_is_named_and_judges_nothing_else(motion, number, measured, tmp_path):
    """The position was a velocity at 1.00, and the magnitude's zero a sensor's limit at 0.99."""
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


@pytest.mark.parametrize("file", ["20230629-143339.csv", "20230629-143524.csv"])
@pytest.mark.parametrize("number", [1, 2])
@pytest.mark.parametrize("column", ["motor_torque", "joint_torque"])
def test_an_unmeasured_load_is_no_mistake_in_the_log(file, number, column, measured):
    """The other arm of a double pendulum was a wrong sign, a velocity, a time offset and another zero at 0.98 to 1.00."""
    table = pd.read_csv(measured("robots", "double_pendulum", file))
    torque = table[f"tau_meas{number}"].to_numpy() / (6 if column == "motor_torque" else 1)
    columns = {"link_position": table[f"pos_meas{number}"].to_numpy(), column: torque}
    joint = load_joint(str(measured("cases", "19_quasi_direct_drive_pendulum_DFKI", "ak80_6.yaml")))
    for inertia, moment in ((0.15, 3.0), (0.09, 1.6), (0.05, 1.0), (0.03, 0.0)):
        link = Mounting(inertia=inertia, gravity_moment=moment)
        log = Measurement("log", Path(), (Recording("log", table["time"].to_numpy(), columns, link=link),))
        assert [m for m in find_mistakes(log, joint) if m.confidence > 0.5] == []


@pytest.mark.parametrize("known", [(), ("Jw",), ("Fc",), ("Fc", "Jw")])
@pytest.mark.parametrize("files", [slice(None), slice(0, 1), slice(5, 6)])
def test_a_description_by_rules_of_a_larger_gear_is_no_mistake_in_the_data(known, files, measured, tmp_path):
    """The catalogue's friction is 800 times an XL330's, its rotor 30 times: the position was a velocity at 1.00."""
    guessed = {"Fc": 1e-4, "Jw": 1e-9}
    numbers = {"Kt": 0.00123, "R": 3.4, "L": 5e-4, "Jm": 1.2e-8, "N": 288.4} | {name: guessed[name] for name in known}
    sheet = Datasheet("CSG", 14, 100, numbers, {"counts": 4096}, {"bits": 12})
    joint = new_joint(sheet, tmp_path / "servo.yaml").joint
    recordings = servo_recordings(measured("robots", "xl330", "2026-01-15_10h28m10.json").parents[2])[files]
    found = find_mistakes(Measurement("log", tmp_path, tuple(recordings)), joint)
    assert not [m for m in found if m.confidence > 0.5], found
