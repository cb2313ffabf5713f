"""Force at the tip: the wrench's, with ideal sensors, is the force that acted; an external torque means it at its lever."""

from __future__ import annotations

import json

import numpy as np
import pytest

from flexspline.scenarios.run import run_scenario
from flexspline.scenarios.run_folder import save_run
from flexspline.scenarios.scenario import load_scenario


def test_the_wrench_tells_force_and_lever(tmp_path):
    """Newton's law with MuJoCo's own force sensor: the rest is the low-pass's lag at the pushes' edges."""
    run = run_scenario(*load_scenario("tip_force"))
    found = run.tip_force
    assert found is not None and np.ptp(found.truth) == pytest.approx(15.0 + 12.5, abs=0.1)
    held = (run.time > 8.4) & (run.time < 9.4)  # a step of 4 N·m at 0.4 m
    assert found.forces["wrench"][held].mean() == pytest.approx(-10.0, abs=0.05)
    assert found.forces["RAREKF"][held].mean() == pytest.approx(-10.0, abs=0.3)
    assert found.lever == pytest.approx(0.4, abs=0.01)
    errors = found.errors(run.reference.kept)
    assert errors["wrench"] < 0.5 and set(errors) == {"wrench", *run.estimates}
    assert any("force at the link" in note for note in run.notes)
    saved = json.loads((save_run(run, tmp_path / "run") / "metrics.json").read_text())
    assert saved["tip_force"]["rms"]["wrench"] == pytest.approx(errors["wrench"])


def test_a_torque_alone_is_no_force_and_levers_must_agree():
    quick = ["duration=3", "filters=[RAREKF]"]
    push = "{kind: push, start: 1.5, duration: 0.3, torque: 5, lever: %s}"
    for several in (["0"], ["0.4", "0.2"]):
        changed = f"disturbances=[{', '.join(push % lever for lever in several)}]"
        assert run_scenario(*load_scenario("tip_force", [*quick, changed])).tip_force is None
    assert run_scenario(*load_scenario("external_push", quick)).metrics["tip_force"] is None


def test_no_push_no_lever(tmp_path):
    """A run that ends before the first push has no lever, not one from noise."""
    run = run_scenario(*load_scenario("tip_force", ["duration=3", "filters=[RAREKF]"]))
    assert run.tip_force is not None and np.isnan(run.tip_force.lever)
    assert any("force at the link" in note for note in run.notes) and not any("acts at" in note for note in run.notes)
    saved = json.loads((save_run(run, tmp_path / "run") / "metrics.json").read_text())
    assert saved["tip_force"]["lever"] is None
