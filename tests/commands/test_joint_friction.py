"""`flexspline joint friction`: a friction map, efficiencies and a C function."""

from __future__ import annotations

import ctypes
import json
import re
import shutil
import subprocess

import numpy as np
import pandas as pd
import pytest
import yaml

import flexspline as fs
from flexspline.models.characteristics import friction, steady


@pytest.fixture(params=["test-joint", "csg-32-160-ilm70", "with effects"])
def joint(request, tmp_path):
    if request.param != "with effects":
        return request.param
    described = fs.load_joint("test-joint")
    path = tmp_path / "worn.yaml"
    described.write(path)
    text = yaml.safe_load(path.read_text())
    text["effects"] = [
        {"name": "friction_asymmetry", "parameters": {"ratio": {"value": 0.2}}},
        {"name": "load_dependent_friction", "parameters": {"coefficient": {"value": 0.05}}},
    ]
    path.write_text(yaml.safe_dump(text, allow_unicode=True))
    return str(path)


def table_of(folder):
    table = pd.read_csv(folder / "friction.csv")
    return table.rename(columns={c: re.sub(r" ?[\[(].*", "", c) for c in table.columns})


def test_the_c_function_is_the_map(flexspline, joint, tmp_path):
    compiler = shutil.which("cc")
    if compiler is None:
        pytest.skip("no C compiler")
    code, _, err = flexspline("joint", "friction", joint, "--out", tmp_path / "map", "--json")
    assert code == 0, err
    table = table_of(tmp_path / "map")
    source, library = tmp_path / "map/friction.c", tmp_path / "f.so"
    subprocess.run([compiler, "-Wall", "-Werror", "-shared", "-fPIC", "-o", library, source, "-lm"], check=True)
    name = re.search(r"double (\w+)\(", (tmp_path / "map/friction.c").read_text()).group(1)
    function = getattr(ctypes.CDLL(str(tmp_path / "f.so")), name)
    function.restype, function.argtypes = ctypes.c_double, [ctypes.c_double] * 3
    p = steady(fs.load_joint(joint).record())[0]
    fast = np.abs(table["speed"]) * p["N"] > 0.1 * p["vs"]
    assert fast.sum() > 0.7 * len(table)
    ours = [function(*row) for row in table.loc[fast, ["speed", "load", "temperature"]].to_numpy()]
    np.testing.assert_allclose(ours, table.loc[fast, "friction"], rtol=1e-12)
    rng = np.random.default_rng(3)
    for _ in range(200):
        point = rng.uniform(0.05, 1) * rng.choice([-1, 1]), rng.uniform(-30, 30), rng.uniform(0, 60)
        assert function(*point) == pytest.approx(friction(*point, p), rel=1e-12)
    assert function(0.0, 5.0, 20.0) == 0.0


def test_friction_is_what_steady_motion_takes(flexspline, joint, tmp_path):
    """The joint's equations at constant speed, with the motor torque that the map says: no acceleration of the drive."""
    from flexspline.models import dynamics

    code, _, err = flexspline("joint", "friction", joint, "--out", tmp_path / "map")
    assert code == 0, err
    table = table_of(tmp_path / "map")
    record = steady(fs.load_joint(joint).record())
    record[0]["amplitude"], record[0]["cogging_amplitude"] = 0.0, 0.0
    p = record[0]
    for row in table.sample(40, random_state=1).itertuples():
        w = row.speed * p["N"]
        state = dynamics.drive_state(0.0, w, 0.0, row.speed, 0.0, 0.0, 0.0, row.temperature)
        g = dynamics.sliding_friction(state, row.load, p)
        bristle = np.sign(w) * g / p["s0"]
        state = dynamics.drive_state(0.0, w, 0.0, row.speed, bristle, 0.0, 0.0, row.temperature)
        asked = row.load / p["N"] + dynamics.mesh_torque(state, row.load, g, p) + p["bm"] * w
        assert asked - row.load / p["N"] == pytest.approx(row.friction, rel=1e-9)
        if row.load:
            share = row.load / p["N"] / asked
            expected = share if row.back_driving == 0 else max(1 / share, 0.0)
            assert row.efficiency == pytest.approx(expected, rel=1e-9)
    assert (table["efficiency"].dropna() <= 1).all() and (table["friction_std"] > 0).all()


def test_its_error_on_a_measurement(flexspline, tmp_path):
    from flexspline.models.recording import write_recording
    from flexspline.scenarios.standard_motion import standard_motion

    write_recording(standard_motion(fs.load_joint("test-joint")).recordings[0], tmp_path / "measurement")
    code, out, err = flexspline("joint", "friction", "test-joint", "--measurement", tmp_path / "measurement", "--out",
                                tmp_path / "map", "--json")  # fmt: skip
    assert code == 0, err
    found = json.loads(out)["current"]
    assert found["with"] < 0.15 * found["without"] and found["unit"] == "A"
    assert f"{found['with']:.4g} A with it" in (tmp_path / "map/friction.c").read_text()
