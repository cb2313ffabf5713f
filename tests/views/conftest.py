"""Short runs that the views are made of."""

from __future__ import annotations

import pytest

from flexspline.scenarios.run import Run, run_scenario
from flexspline.scenarios.scenario import load_scenario

PUSHES = (
    "disturbances=[{kind: push, start: 1.5, duration: 0.2, torque: 5},"
    " {kind: push, start: 2.5, duration: 0.2, torque: -5}]"
)


def short(name: str, *changes: str) -> Run:
    """A shipped scenario, shortened."""
    return run_scenario(*load_scenario(name, list(changes)))


@pytest.fixture(scope="session")
def pushed() -> Run:
    """External pushes in both directions, 4 s."""
    return short("external_push", "duration=4", PUSHES)


@pytest.fixture(scope="session")
def bare() -> Run:
    """The joint without load, 3 s."""
    return short("no_load", "duration=3")
