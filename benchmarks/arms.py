"""Diagnosis of joints that move in an arm: `python -m benchmarks arms` prints the table of docs/arms.md.

Per draw the arm of the scenario `two_joints`, each joint within its tolerances, its motions drawn, and one effect of
ordinary size beyond them hidden in the shoulder (even draws) or in the elbow (odd ones). Both are diagnosed, each by its own
recording of 30 s with the torque sensor, with its description.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from functools import partial
from pathlib import Path

import numpy as np

from flexspline.diagnosis.diagnose import diagnose
from flexspline.diagnosis.trials.draw import HiddenEffect, within_tolerance
from flexspline.models import causes
from flexspline.models.calibration import Calibration
from flexspline.models.joint import load_joint
from flexspline.models.recording import Measurement
from flexspline.scenarios.arms.arm_run import run_arm
from flexspline.scenarios.arms.arm_scenario import ArmScenario, load_arm

CAUSES = (
    "mesh_friction", "kinematic_error", "friction_asymmetry", "cogging", "stiffness", "viscous_friction", "backlash",
    "load_dependent_friction", "torque_constant", "rotor_inertia", "link_encoder_eccentricity", "hysteresis",
)  # fmt: skip
"""Hidden, one after the other: causes in motor, transmission and sensors, which an arm does not hide."""


def drawn(index: int, seed: int) -> tuple[ArmScenario, dict[str, np.ndarray], str, str]:
    """A draw: the arm's scenario, its joints' true parameters, in which of them what is hidden."""
    rng = np.random.default_rng([seed, index])
    base, _ = load_arm("two_joints", seed=int(rng.integers(2**31)))
    data = base.written()
    for joint in data["arm"]:
        side, size = rng.choice([-1.0, 1.0]), rng.uniform(0.8, 1.05)
        for point in joint["trajectory"]:
            point["position"] *= side * size
        joint["filters"] = ["model"]
        joint["controller"] = {"ki": 20.0}
    scenario = ArmScenario.model_validate(data)
    calibration = Calibration(load_joint("test-joint"))
    name, place = CAUSES[index % len(CAUSES)], scenario.arm[index % 2].name
    cause = causes.get(name)
    records = {}
    for joint in scenario.arm:
        assert joint.link is not None
        x = calibration.draw(rng)
        if joint.name == place:
            while True:
                values = cause.draw(calibration.joint.record()[0], rng)
                effect = HiddenEffect(name, cause.component, values, "", partial(cause.apply, values=values))
                if not within_tolerance(calibration, x, effect):
                    break
                x = calibration.draw(rng)
        record = calibration.record(x, joint.link)
        if joint.name == place:
            effect.apply(record[0])
        records[joint.name] = record
    return scenario, records, place, name


def measured(index: int, seed: int) -> dict[str, list[str]]:
    """What is named of each joint in a draw, the first first; prints it."""
    scenario, records, place, name = drawn(index, seed)
    found = {}
    for joint, run in run_arm(scenario, records=records).items():
        recording = run.as_recording()
        diagnosis = diagnose(Measurement(joint, Path(), (recording,)), load_joint("test-joint"))
        found[joint] = [cause.name for cause in diagnosis.causes]
        hidden = name if joint == place else "nothing"
        print(f"draw {index}, {joint}: hidden {hidden}, named {', '.join(found[joint]) or 'nothing'}", flush=True)
    return found


def main(arguments: Sequence[str] = ()) -> None:
    """Diagnose the draws and print the rates."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks arms", description=__doc__)
    parser.add_argument("--draws", type=int, default=12)
    parser.add_argument("--seed", type=int, default=1)
    asked = parser.parse_args(arguments)
    first = named = quiet = 0
    print(f"seed {asked.seed}")
    for index in range(asked.draws):
        _, _, place, name = drawn(index, asked.seed)
        found = measured(index, asked.seed)
        first += found[place][:1] == [name]
        named += name in found[place]
        quiet += not any(found[other] for other in found if other != place)
    print("| hidden in one joint: named first | named | nothing named of the other |\n|---|---|---|")
    print(f"| {first} of {asked.draws} | {named} of {asked.draws} | {quiet} of {asked.draws} |")
