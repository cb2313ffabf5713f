"""A payload that nobody stated, with one encoder: a wrong torque constant looks alike, and an earlier diagnosis decides."""

from __future__ import annotations

from dataclasses import replace

import pytest
import yaml

import flexspline as fs
from flexspline.models.joint_parts import Mounting
from flexspline.models.recording import Recording

WAY = [(0.5, 0.0), (3.5, 1.2), (9.0, -1.2), (13.0, 1.0), (16.0, -0.6), (19.0, 0.8), (22.0, 0.0)]  # s, rad
MASS, LIGHT, DISTANCE = 0.84, 0.3, 0.3  # kg, kg, m
SEED = 1


@pytest.fixture(scope="module")
def joints(tmp_path_factory):
    """The description, and the true joint: a weaker motor, more friction, a stiffer gear."""
    described = fs.load_joint("test-joint")
    factors = {"Kt": 0.93, "Fc": 1.3, "Fs": 1.3, "bw": 1.2, "K1": 1.1}
    numbers = {
        name: n.model_copy(update={"value": factors.get(name, 1.0) * n.value}) for name, n in described.numbers.items()
    }
    path = tmp_path_factory.mktemp("joint") / "true.yaml"
    described.model_copy(update={"numbers": numbers}).write(path)
    return described, path


def measured(joints, folder, seed: int, reach: float, mass: float) -> Recording:
    """Motor encoder and current of a motion; the recording states the link without the payload."""
    described, path = joints
    link = described.mount("link")
    loaded = Mounting(
        inertia=link.inertia + mass * DISTANCE**2, gravity_moment=link.gravity_moment + 9.80665 * mass * DISTANCE
    )
    scenario = folder / f"motion_{seed}.yaml"
    scenario.write_text(
        yaml.safe_dump(
            {
                "format": 1, "name": "motion", "joint": str(path), "known_joint": "test-joint", "duration": 23.0, "seed": seed,
                "link": loaded.model_dump(exclude_defaults=True), "filters": ["model"], "description": "back and forth",
                "controller": {"kp": 8.0, "kd": 0.08, "ki": 20.0},
                "trajectory": [{"time": t, "position": reach * x} for t, x in WAY],
            }
        ),
        encoding="utf-8",
    )  # fmt: skip
    run = fs.simulate(scenario).as_recording()
    kept = {name: run.columns[name] for name in ("motor_position", "motor_current")}
    return replace(run, columns=kept, link=link)


@pytest.mark.slow
def test_an_earlier_diagnosis_separates_payload_and_torque_constant(joints, tmp_path):
    before = measured(joints, tmp_path, SEED, 1.0, 0.0)
    loaded = measured(joints, tmp_path, SEED + 1, 0.8, MASS)
    alone = fs.diagnose(loaded, joints[0])
    print(f"seed {SEED}:", alone.verdict, alone.causes)
    # Each of the two explains what the other one does: one of them is there, and neither is sure.
    assert alone.verdict == "discrepancy"
    assert {c.name for c in alone.causes} <= {"payload", "torque_constant", "gravity_moment"}
    assert all(c.confidence < 0.9 for c in alone.causes)
    known = fs.diagnose(before, joints[0]).extended
    assert known.numbers["Kt"].std < 0.02 * known.numbers["Kt"].value
    # The lighter one is separated by the correlation of the known numbers: each alone leaves room for it.
    lighter = measured(joints, tmp_path, SEED + 1, 0.8, LIGHT)
    for recording, mass in ((loaded, MASS), (lighter, LIGHT)):
        (found,) = fs.diagnose(recording, known).causes
        print(found)
        assert found.name == "payload" and found.confidence > 0.9
        assert found.parameters["mass"].value * found.parameters["distance"].value == pytest.approx(
            mass * DISTANCE, rel=0.1
        )
