"""Data of another joint than the description: no list of sure causes."""

from __future__ import annotations

from pathlib import Path

import pytest

import flexspline
from flexspline.diagnosis.diagnose import diagnose
from flexspline.models.joint import load_joint
from flexspline.models.recording import Measurement

TURNS = ((0.3, 0.0), (1.3, 0.9), (2.4, -0.9), (3.2, 0.6), (4.2, -0.4), (5.0, 0.8), (6.2, -0.8), (7.5, 0.3))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("factors", "said"),
    [
        ({"Kt": 2.0, "K1": 2.2, "K2": 2.2, "K3": 2.2, "Jm": 2.5, "bw": 12.0}, "outside the tolerances at once"),
        ({"Kt": 3.3, "K1": 2.2, "K2": 2.2, "K3": 2.2}, "far from the description (torque constant 0.3"),
    ],
)
def test_many_wrong_numbers_are_another_joint(factors, said):
    """Rotor inertia and stiffness were causes at 0.99 each, next to a torque constant that no description has."""
    moves = [{"time": t, "position": q} for t, q in TURNS]
    run = flexspline.simulate("no_load", duration=8.0, trajectory=moves, mounting="link", filters=["model"])
    joint = load_joint("test-joint")
    numbers = {k: x.model_copy(update={"value": factors.get(k, 1.0) * x.value}) for k, x in joint.numbers.items()}
    data = Measurement("log", Path(), (run.as_recording(),))
    found = diagnose(data, joint.model_copy(update={"numbers": numbers}))
    assert found.verdict == "inconclusive" and all(c.confidence <= 0.5 for c in found.causes), found
    assert "these data are not of this joint" in found.reason and said in found.reason, found
