"""Draws of an experiment that are independent: another joint within tolerance, another motion, other pushes, other noise.

Runs that differ in their sensors' noise alone are nearly one run: kinematic error, counts and friction act at the same
angles in all of them, and so the errors of two seeds correlate by more than 0.9. A draw changes whatever an experiment leaves
to chance, so that measures of draws are independent and an interval over them means what it says:

* the joint: every number that has a tolerance, drawn within `tolerance` times it (`models.calibration`);
* the motion: start angle, within one turn of the motor to either side or more, and with it the motor's phase; its duration;
* pushes: onset, duration, size and sign;
* the sensors' noise; with `sensors: realistic` also the drive's lag, unless a controller is stated.

The estimators are told the nominal numbers, and how well those are known.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from ...estimator.estimator import KnownJoint
from ...models.calibration import Calibration
from ...models.signals import Signals
from ...sim.drive import Controller
from ...sim.loop import Simulation
from ...sim.sensors import stream
from ..experiment import Experiment, signals_of
from ..scenario import LAGGING, Disturbance, Scenario
from .intervals import Interval, interval

TURNS = 3.0
"""Turns of the motor by which the start may be off the scenario's, to either side."""
PACE = 0.15
"""Share by which the motion may be slower or faster."""
ONSET = 0.9
"""Time [s] by which a push may come earlier or later."""
SIZE = (0.5, 1.5)
"""Range of a push's size and duration, in the scenario's own."""
LAG = 4e-3
"""Largest time [s] by which a drive lags where `sensors: realistic`."""
MOVING = 0.02
"""Speed [rad/s] of the command from which on the joint counts as moving: the motor at the Stribeck velocity."""


@dataclass(frozen=True)
class DrawnExperiment:
    """An experiment as it was drawn and what became of it; n samples.

    Attributes:
      seed: of the draw.
      known: what the estimators know: the nominal numbers and how well they are known.
      record: the plant's own, shape (1,).
      signals: what the estimators read.
      truth: noise-free joint torque, shape (n,) [N·m].
      external_torque: on the link, shape (n,) [N·m].
      moving: where the command moves, shape (n,); kept: what measures count, after the transient, shape (n,).
    """

    seed: int
    known: KnownJoint
    record: np.ndarray
    signals: Signals
    truth: np.ndarray
    external_torque: np.ndarray
    moving: np.ndarray
    kept: np.ndarray


def varied(scenario: Scenario, seed: int) -> Scenario:
    """The scenario with another start, pace and pushes, and with the seed as its own; no motion and no push ends after the
    scenario that did not before."""
    rng = stream(seed, f"draw {scenario.name}")
    start = rng.uniform(-TURNS, TURNS) * 2 * math.pi / 100.0
    pace = 1.0 + rng.uniform(-PACE, PACE)
    first, last = scenario.trajectory[0].time, scenario.trajectory[-1].time
    if first < last <= scenario.duration:
        pace = min(pace, (scenario.duration - first) / (last - first))
    waypoints = [
        w.model_copy(update={"time": first + pace * (w.time - first), "position": w.position + start})
        for w in scenario.trajectory
    ]
    pushes = [_varied_push(d, rng, scenario.duration) for d in scenario.disturbances]
    found: dict[str, Any] = {"trajectory": waypoints, "disturbances": pushes, "seed": seed}
    if scenario.sensors == "realistic" and scenario.controller == LAGGING:
        found["controller"] = Controller().lagging(rng.uniform(0.0, LAG))
    return scenario.model_copy(update=found)


def of_seed(scenario: Scenario, seed: int, vary: bool = True) -> Scenario:
    """The scenario with a seed; with another start, pace and pushes as well (`varied`), unless all seeds are to have its own."""
    return varied(scenario, seed) if vary else scenario.model_copy(update={"seed": seed})


def _varied_push(push: Disturbance, rng: np.random.Generator, end: float) -> Disturbance:
    if push.kind == "walk":
        return push  # another for every seed as it is
    duration = push.duration * rng.uniform(*SIZE)
    start = max(push.start + rng.uniform(-ONSET, ONSET), 0.0)
    if push.start + push.duration <= end:
        start = max(min(start, end - duration), 0.0)
    torque = push.torque * rng.uniform(*SIZE) * rng.choice((-1.0, 1.0))
    return push.model_copy(update={"start": start, "duration": duration, "torque": torque})


def drawn_record(experiment: Experiment, seed: int, tolerance: float, tared: bool) -> np.ndarray:
    """The plant's record of a draw, shape (1,): its joint within `tolerance` times its tolerances.

    `tared`: the link encoder's zero is known; otherwise it is drawn like everything else.
    """
    calibration = Calibration(experiment.joint)
    x = tolerance * calibration.draw(stream(seed, "tolerance"))
    if tared and "link_encoder_zero" in calibration.names:
        x[calibration.names.index("link_encoder_zero")] = 0.0
    return calibration.record(x, experiment.mounting)


def draw(
    scenario: Scenario,
    folder: Path | None,
    seed: int,
    tolerance: float = 1.0,
    tared: bool = True,
    vary: bool = True,
    load: float | None = None,
) -> DrawnExperiment:
    """Draw an experiment and run it, without estimates.

    Args:
      scenario: without torque feedback. folder: of its file.
      seed: of everything that is drawn; the same for every tolerance, so that those can be compared draw by draw.
      tolerance: share of the joint's tolerances within which it is drawn.
      tared: whether the link encoder's zero is known.
      vary: whether motion and pushes are drawn, too.
      load: gravity moment at horizontal of what is bolted on [N·m], which the estimators know; by default the mounting's.

    Raises:
      InputError: a joint that cannot bear the load.
    """
    chosen = of_seed(scenario, seed, vary)
    experiment = Experiment.of(chosen, folder, load)
    record = drawn_record(experiment, seed, tolerance, tared)
    simulation = experiment.simulate(seed, record, experiment.build(record))
    return draw_of(experiment, simulation, record, told(experiment.known, tolerance, tared), seed)


def draw_of(
    experiment: Experiment, simulation: Simulation, record: np.ndarray, known: KnownJoint, seed: int
) -> DrawnExperiment:
    """A simulation of an experiment as a `DrawnExperiment`."""
    time = simulation.time
    return DrawnExperiment(
        seed, known, record, signals_of(simulation), np.ascontiguousarray(simulation.truth["joint_torque"]),
        experiment.external_torque, np.abs(experiment.velocity) > MOVING, time >= experiment.scenario.transient,
    )  # fmt: skip


def told(known: KnownJoint, tolerance: float, tared: bool) -> KnownJoint:
    """What estimators know of a joint that is within `tolerance` times its stated tolerances."""
    found = known.within(tolerance)
    return replace(found, link_zero=0.0) if tared else found


def rms(error: np.ndarray, where: np.ndarray) -> float:
    """RMS [N·m] of errors, shape (n,), where a condition, shape (n,), holds; NaN where it nowhere does."""
    return float(np.sqrt(np.mean(error[where] ** 2))) if np.any(where) else math.nan


def geometric(values: np.ndarray | Sequence[float], reference: np.ndarray | Sequence[float]) -> Interval:
    """Geometric mean of the ratios values/reference of independent draws, shape (n,), with its 95 % interval.

    Student's t interval of the mean of log ratios; a ratio's distribution is close to log-normal where that of neither
    error is. Draws where either is not a positive number are left out.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        logs = np.log(np.asarray(values, dtype=np.float64) / np.asarray(reference, dtype=np.float64))
    found = interval(logs)
    return Interval(math.exp(found.mean), math.exp(found.low), math.exp(found.high), found.n)
