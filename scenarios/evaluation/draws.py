"""Independent draws of an experiment: another joint within tolerance, another motion, other pushes, other noise.

Runs that differ only in their sensors' noise are nearly the same run: kinematic error, counts and friction act at the same
angles, and the errors of two seeds correlate by more than 0.9. A draw changes everything that is random in an experiment:

* the joint: every number with a tolerance, drawn within `tolerance` times it (`models.calibration`);
* the motion: the start angle, by some turns of the motor, and with it the motor's phase; the duration;
* pushes: onset, duration, size and sign;
* the sensors' noise; with `sensors: realistic` also the drive's lag, unless a controller is stated.

The estimators know the nominal numbers and their tolerances. With `zero_known` they also know the link encoder's zero.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np

from ...estimator.estimator import KnownJoint
from ...models.calibration import Calibration
from ...models.controller import Controller
from ...sim.sensors import stream
from ..experiment import Experiment
from ..scenario import LAGGING, Disturbance, Scenario

TURNS = 3.0  # largest change of the start, in turns of the motor
PACE = 0.15  # largest relative change of the motion's duration
ONSET = 0.9  # largest change of a push's onset [s]
SIZE = (0.5, 1.5)  # range of factors on a push's size and duration
LAG = 4e-3  # largest lag of a drive with `sensors: realistic` [s]


def varied(scenario: Scenario, seed: int) -> Scenario:
    """Return the scenario with drawn start, pace and pushes, and with this seed; motions and pushes that ended within the
    scenario still do."""
    rng = stream(seed, f"draw {scenario.name}")
    start = rng.uniform(-TURNS, TURNS) * 2 * math.pi / 100.0
    pace = 1.0 + rng.uniform(-PACE, PACE)
    first, last = scenario.trajectory[0].time, scenario.trajectory[-1].time
    if first < last <= scenario.duration:
        pace = min(pace, (scenario.duration - first) / (last - first))
    waypoints = []
    for way in scenario.trajectory:
        moved = {} if way.position is None else {"position": way.position + start}
        waypoints.append(way.model_copy(update={"time": first + pace * (way.time - first)} | moved))
    pushes = [_varied_push(d, rng, scenario.duration) for d in scenario.disturbances]
    found: dict[str, Any] = {"trajectory": waypoints, "disturbances": pushes, "seed": seed}
    if scenario.mode != "position":
        found["start"] = (scenario.start or 0.0) + start
    if scenario.sensors_are_realistic and scenario.controller == LAGGING:
        found["controller"] = Controller().lagging(rng.uniform(0.0, LAG))
    return scenario.model_copy(update=found)


def of_seed(scenario: Scenario, seed: int, vary: bool = True) -> Scenario:
    """Return the scenario with a seed, and with drawn start, pace and pushes if `vary` (`varied`)."""
    return varied(scenario, seed) if vary else scenario.model_copy(update={"seed": seed})


def _varied_push(push: Disturbance, rng: np.random.Generator, end: float) -> Disturbance:
    if push.kind == "walk":
        return push  # it depends on the seed already
    duration = push.duration * rng.uniform(*SIZE)
    start = max(push.start + rng.uniform(-ONSET, ONSET), 0.0)
    if push.start + push.duration <= end:
        start = max(min(start, end - duration), 0.0)
    torque = push.torque * rng.uniform(*SIZE) * rng.choice((-1.0, 1.0))
    return push.model_copy(update={"start": start, "duration": duration, "torque": torque})


def drawn_record(experiment: Experiment, seed: int, tolerance: float, zero_known: bool) -> np.ndarray:
    """Return the plant's record of a draw, shape (1,), within `tolerance` times the tolerances.

    With `zero_known` the link encoder keeps its nominal zero.
    """
    calibration = Calibration(experiment.joint)
    x = tolerance * calibration.draw(stream(seed, "tolerance"))
    if zero_known and "link_encoder_zero" in calibration.names:
        x[calibration.names.index("link_encoder_zero")] = 0.0
    return calibration.record(x, experiment.mounting)


def known_within(known: KnownJoint, tolerance: float, zero_known: bool) -> KnownJoint:
    """Return the knowledge of estimators of a joint within `tolerance` times its tolerances."""
    found = known.within(tolerance)
    return replace(found, link_zero=0.0) if zero_known else found
