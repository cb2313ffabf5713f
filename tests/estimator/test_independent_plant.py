"""`augmented` and RAREKF on a second plant, whose joints, motions, pushes and imperfections are drawn."""

import math

import independent_plant as plant
import numpy as np
import pytest

import flexspline as fs
from flexspline.estimator import registry
from flexspline.estimator.offline import estimate_recording
from flexspline.models.joint import Mounting, load_joint
from flexspline.models.recording import Recording
from flexspline.scenarios.evaluation.draws import geometric


def errors(seed, imperfect, duration, kinds=("free", "sweep", "push")):
    """RMS error [N·m] over all motions of a drawn joint, by estimator, from the description alone."""
    rng = np.random.default_rng([seed, int(imperfect)])
    joint, total, count = plant.draw_joint(rng, imperfect), {}, 0
    for kind in kinds:
        drawn = plant.draw_motion(rng, joint, kind, duration)
        link = Mounting(inertia=drawn.inertia, gravity_moment=drawn.gravity)
        recording = Recording(kind, drawn.time, drawn.columns, "test-joint", "", link, "unmeasured")
        found = estimate_recording(recording, load_joint("test-joint"), ["RAREKF", "augmented"])
        for name, torque in found.torque.items():
            total[name] = total.get(name, 0.0) + float(np.sum((torque - drawn.torque) ** 2))
        count += len(drawn.time)
    return {name: math.sqrt(square / count) for name, square in total.items()}


def ratios(seeds, imperfect, duration=None):
    found = [errors(seed, imperfect, duration) for seed in seeds]
    print(f"seeds {seeds}, imperfect {imperfect}: {found}")
    mean = geometric([f["augmented"] for f in found], [f["RAREKF"] for f in found]).mean
    return mean, max(f["augmented"] / f["RAREKF"] for f in found)


def test_the_plant_balances():
    """At rest nothing moves, and the joint torque is what the weight asks for."""
    rng = np.random.default_rng(7)
    drawn = plant.draw_motion(rng, plant.draw_joint(rng, tolerance=0.0, tared=True), "sweep", 6.0)
    link, time = drawn.columns["link_position"], drawn.time
    acceleration = np.gradient(np.gradient(link, time), time)
    slow = np.convolve(
        drawn.torque - drawn.gravity * np.sin(link) - drawn.inertia * acceleration, np.ones(200) / 200, "valid"
    )
    assert np.max(np.abs(slow)) < 0.03 * np.max(np.abs(drawn.torque))


def test_a_joint_by_its_description():
    _, worst = ratios([31], imperfect=False, duration=15.0)
    assert worst < 0.5


@pytest.mark.slow
@pytest.mark.parametrize(("imperfect", "mean", "worst"), [(False, 0.15, 0.5), (True, 0.3, 0.9)])
def test_drawn_joints(imperfect, mean, worst):
    found = ratios(range(40, 50), imperfect)
    assert found[0] < mean and found[1] < worst


def test_load_of_an_arm_reaches_augmented():
    for run in fs.simulate_arm("two_joints", duration=4).values():
        torque = run.truth("joint_torque")
        signals = run.signals.with_columns(arm_torque=run.as_recording().torque_of_arm)
        estimator = registry.get("augmented")
        alone, known = (
            float(np.sqrt(np.mean((estimator.estimate(s, run.known).mean - torque)[1000:] ** 2)))
            for s in (run.signals, signals)
        )
        assert known < 0.5 * alone
