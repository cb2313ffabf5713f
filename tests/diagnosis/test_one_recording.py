"""One recording alone, 24 s and less: little of a joint shows, and what does not show is not claimed."""

import importlib
import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from swing import recording

from flexspline.diagnosis import improvement
from flexspline.diagnosis.data.segments import segments
from flexspline.diagnosis.diagnose import diagnose
from flexspline.diagnosis.fit.regions import shrunk
from flexspline.diagnosis.fit.residual import Problem
from flexspline.diagnosis.fit.solver import Fitter
from flexspline.diagnosis.search import explore
from flexspline.diagnosis.search.calibrate import calibrate
from flexspline.estimator.conditioning import condition
from flexspline.models.joint import load_joint
from flexspline.models.recording import Measurement, read_measurement

of_diagnosis = importlib.import_module("flexspline.diagnosis.diagnose")

EXAMPLES = [("bare", 3), ("exact", 6), ("toleranced", 7)]
RECORDINGS = ("free", "push", "sweep")


def one(shared, group, number, name):
    """What is found in one recording of an example, and what is hidden there."""
    folder = shared / "data" / "examples" / group
    measurement = read_measurement(folder / f"{number:02d}" / f"{name}.yaml")
    joint = measurement.load_joint(None)
    return diagnose(measurement, joint), json.loads((folder / "truth.json").read_text())[f"{number:02d}"]


@pytest.mark.fast_every(2)
@pytest.mark.parametrize(
    ("group", "number", "name", "named"),
    [
        # At rest, friction may be anything: what a model leaves there once decided for a torque sensor's offset, by 45 in the log
        # evidence, at 0.99.
        ("exact", 2, "push", {"friction_asymmetry"}),
        # The link turns without a load: torques can be of any scale, and what two models leave differs by chance.
        ("exact", 1, "free", set()),
        # One scale of all torques: a torque constant, with the sensor's gain at the end of its tolerance.
        pytest.param("exact", 5, "push", {"viscous_friction", "torque_sensor_gain"}, marks=pytest.mark.slow),
    ],
)
def test_what_one_recording_shows(shared, group, number, name, named):
    found, truth = one(shared, group, number, name)
    assert {c.name for c in found.causes} == named
    for cause in found.causes:
        for key, p in cause.parameters.items():
            assert abs(p.value - truth[cause.name][key]) < 3 * p.std, f"{key}: {p} for {truth[cause.name][key]}"


@pytest.mark.slow
@pytest.mark.long
@pytest.mark.parametrize("name", RECORDINGS)
@pytest.mark.parametrize(("group", "number"), [(group, i) for group, count in EXAMPLES for i in range(count)])
def test_nothing_is_sure_that_is_not_there(shared, group, number, name):
    found, truth = one(shared, group, number, name)
    assert not [c for c in found.causes if c.confidence >= 0.9 and c.name not in truth]
    assert found.verdict != "consistent" or not found.causes


def test_a_fit_that_does_not_serve_is_shrunk(shared):
    """A fit is shrunk where torque estimates are worse with it, and the result says so."""
    measurement = read_measurement(shared / "data" / "examples" / "exact" / "00" / "free.yaml")
    joint = measurement.load_joint(None)
    problem = Problem(*segments(list(measurement.recordings), joint), joint)
    fit = calibrate(Fitter(problem))
    asked = []

    def refuse(f):
        asked.append(f)
        return len(asked) > 1

    drawn = shrunk(problem, fit, refuse)
    assert drawn.refused and 0 < drawn.share < 1
    assert len(asked) == 2 and drawn.fit is asked[-1]

    no_worse = improvement.serves(measurement, joint, [condition(r, joint) for r in measurement.recordings])
    assert no_worse(joint)
    numbers = dict(joint.numbers)
    for name in ("K1", "K2", "K3", "Kt"):
        numbers[name] = numbers[name].model_copy(update={"value": 2 * numbers[name].value})
    assert not no_worse(joint.model_copy(update={"numbers": numbers}))


def test_a_joint_that_holds_its_pose_says_nothing():
    """No residual counts where nothing moves: that ended in a division by zero."""
    one, rng = recording(seconds=4.0), np.random.default_rng(1)
    columns = {
        "motor_position": np.full(len(one.time), 30.0), "link_position": 0.3 + 1.5e-6 * rng.standard_normal(len(one.time)),
        "motor_current": 0.5 + 0.01 * rng.standard_normal(len(one.time)),
    }  # fmt: skip
    found = diagnose(Measurement("swing", Path("swing"), (replace(one, columns=columns),)), load_joint("test-joint"))
    assert found.verdict == "inconclusive" and not found.causes and found.undetermined


def test_a_recording_too_short_to_keep_a_part_from_the_fit_shows_what_is_left_of_all():
    """It had no residual, which left nothing to doubt, and said that blocks had been kept."""
    one = recording(seconds=2.4)
    columns = one.columns | {"joint_torque": one.columns["joint_torque"] + 0.8}
    measurement = Measurement("swing", Path("swing"), (replace(one, columns=columns),))
    found = diagnose(measurement, load_joint("test-joint"), seconds=0.0)
    assert found.residual["joint_torque"].after > 10 * found.residual["joint_torque"].noise
    assert "N·m RMS is left" in found.reason
    assert "too short" in found.held_out and "was kept from every fit" not in found.held_out


@pytest.mark.slow
def test_a_stage_for_which_there_was_no_time_is_told(monkeypatch):
    """Where time ran out after the first causes, the answer did not say that others were not looked for."""
    one, now = recording(seconds=8.0), [0.0]
    columns = one.columns | {"motor_current": one.columns["motor_current"] + 0.2}
    for module in (explore, of_diagnosis):
        monkeypatch.setattr(module, "time", SimpleNamespace(monotonic=lambda: now[0]))

    def progress(stage: str, share: float) -> None:
        if stage == "searching for causes" and share > 0.1:
            now[0] = 1e3

    measurement = Measurement("swing", Path("swing"), (replace(one, columns=columns),))
    found = diagnose(measurement, load_joint("test-joint"), progress=progress, seconds=100.0)
    assert now[0] and not found.complete
