"""A servo's rotor and gear are light against stiffness and step: their replay does not ring."""

from __future__ import annotations

import numpy as np
import pytest

from flexspline.diagnosis.validate import validate
from flexspline.models.datasheet import Datasheet, new_joint
from flexspline.models.joint_parts import Effect, Estimate, Mounting
from flexspline.models.recording import Measurement, Recording

HEAVY, LIGHT = {"Jm": 1e-6, "Jw": 1e-6}, {"Jm": 1e-8, "Jw": 1e-9}


@pytest.fixture(scope="module")
def simulated(tmp_path_factory):
    """Current that joints of a heavy and a light rotor with load-dependent friction take to lift a pendulum [A]."""
    time = np.arange(0.0, 6.0, 5e-3)
    angle = 0.6 * (1 - np.cos(2 * np.pi * time / 3.0))
    columns = {"link_position": angle, "motor_current": np.sin(angle)}
    recording = Recording("lift", time, columns, link=Mounting(inertia=0.005, gravity_moment=0.5))
    found = {}
    for name, rotor in (("heavy", HEAVY), ("light", LIGHT)):
        numbers = {
            "Kt": 0.004, "R": 4.0, "L": 5e-4, "Fc": 2e-4, "Fs": 2.5e-4, "bw": 1e-6, "bm": 1e-9, "s0": 0.2, "s1": 2e-4,
            "dw": 1e-4, **rotor,
        }  # fmt: skip
        sheet = Datasheet("CSG", 14, 100, numbers, {"counts": 4096}, {"bits": 16}, name=name)
        joint = new_joint(sheet, tmp_path_factory.mktemp(name) / f"{name}.yaml").joint
        friction = {"coefficient": Estimate(value=0.5, unit="1")}
        effects = [Effect(name="load_dependent_friction", parameters=friction)]
        joint = joint.model_copy(update={"effects": effects, "kinematic_error": []})
        found[name] = validate(Measurement("log", tmp_path_factory.mktemp("log"), (recording,)), joint)
    return {name: one.recordings[0].simulated["motor_current"] for name, one in found.items()}


def test_a_light_rotor_with_friction_that_grows_with_the_load_does_not_ring(simulated):
    """Nor does a heavier one, whose steps are resolved: friction of a moving joint hardly depends on its rotor."""
    light, heavy = simulated["light"], simulated["heavy"]
    kept = np.isfinite(light) & np.isfinite(heavy)
    for current in (light, heavy):
        bent = np.abs(np.diff(current[kept], 2))
        print(np.quantile(bent, (0.5, 0.9, 0.99)), np.ptp(current[kept]))
        assert np.quantile(bent, 0.9) < 0.005 * np.ptp(current[kept])
    assert np.std((light - heavy)[kept]) < 0.1 * np.ptp(heavy[kept])


def test_a_light_gear_of_a_small_ratio_does_not_ring(tmp_path):
    """Its wave generator's velocity alternated from step to step: a torque of 1.5 N·m was off by 0.1, in the current alone."""
    time = np.arange(0.0, 8.0, 5e-3)
    angle = 1.2 * np.sin(2 * np.pi * time / 4.0)
    sheet = Datasheet(
        "CSG", 17, 30, {"N": 6, "Kt": 0.09, "R": 0.2, "L": 2e-4, "Jm": 6e-5, "Jw": 1.3e-6, "Fc": 0.023, "s0": 5.6, "bw": 1e-3},
        {"bits": 14}, {"bits": 14}, name="light",
    )  # fmt: skip
    joint = new_joint(sheet, tmp_path / "light.yaml").joint.model_copy(update={"kinematic_error": []})
    columns = {"motor_position": 6 * angle, "motor_current": 15 * np.sin(angle)}
    recording = Recording("swing", time, columns, link=Mounting(inertia=0.31, gravity_moment=7.95))
    current = validate(Measurement("log", tmp_path, (recording,)), joint).recordings[0].simulated["motor_current"]
    alternating = np.abs(np.diff(current[np.isfinite(current)], 2))
    print(np.quantile(alternating, (0.5, 0.99)), np.nanstd(current))
    assert np.quantile(alternating, 0.99) < 0.01 * np.nanstd(current)
