"""Independent draws of an experiment: another joint within tolerance, another motion, other pushes, other noise.

Runs that differ only in their sensors' noise are nearly the same run: kinematic error, counts and friction act at the same
angles, and the errors of two seeds correlate by more than 0.9. A draw changes everything that is random in an experiment:

* the joint: every number with a tolerance, drawn within `tolerance` times it (`models.calibration`);
* the motion: the start angle, by some turns of the motor, and with it the motor's phase; the duration;
* pushes: onset, duration, size and sign;
* the sensors' noise; with `sensors: realistic` also the drive's lag, unless a controller is stated.

The estimators know the nominal numbers and their tolerances. A *tared* joint has a known link encoder zero.
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
"""Largest change of the start, in turns of the motor."""
PACE = 0.15
"""Largest relative change of the motion's duration."""
ONSET = 0.9
"""Largest change of a push's onset [s]."""
SIZE = (0.5, 1.5)
"""Range of factors on a push's size and duration."""
LAG = 4e-3
"""Largest lag of a drive with `sensors: realistic` [s]."""
MOVING = 0.02
"""Speed [rad/s] of the command above which the joint moves: the motor at the Stribeck velocity."""


@dataclass(frozen=True)
class DrawnExperiment:
    """A drawn experiment and its signals; n samples.

    Attributes:
      seed: of the draw.
      known: nominal numbers and their tolerances, for the estimators.
      record: of the plant, shape (1,).
      signals: for the estimators.
      truth: noise-free joint torque, shape (n,) [N·m].
      external_torque: on the link, shape (n,) [N·m].
      moving: where the command moves, shape (n,); kept: samples for metrics, after the transient, shape (n,).
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
    """Return the scenario with drawn start, pace and pushes, and with this seed; motions and pushes that ended within the
    scenario still do."""
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


def drawn_record(experiment: Experiment, seed: int, tolerance: float, tared: bool) -> np.ndarray:
    """Return the plant's record of a draw, shape (1,), within `tolerance` times the tolerances; `tared`: with the nominal zero of
    the link encoder."""
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
    """Draw an experiment and simulate it.

    Args:
      scenario: without torque feedback. folder: of its file.
      seed: of all random numbers; draws with different tolerances and the same seed are paired.
      tolerance: share of the joint's tolerances for the draw.
      tared: whether the link encoder's zero is known.
      vary: whether motion and pushes are drawn, too.
      load: known gravity moment of the payload at horizontal [N·m]; by default the mounting's.

    Raises:
      InputError: a joint that cannot bear the load.
    """
    chosen = of_seed(scenario, seed, vary)
    experiment = Experiment.of(chosen, folder, load)
    record = drawn_record(experiment, seed, tolerance, tared)
    simulation = experiment.simulate(seed, record, experiment.build(record))
    return draw_of(experiment, simulation, record, known_within(experiment.known, tolerance, tared), seed)


def draw_of(
    experiment: Experiment, simulation: Simulation, record: np.ndarray, known: KnownJoint, seed: int
) -> DrawnExperiment:
    """Return a simulation of an experiment as a `DrawnExperiment`."""
    time = simulation.time
    return DrawnExperiment(
        seed, known, record, signals_of(simulation), np.ascontiguousarray(simulation.truth["joint_torque"]),
        experiment.external_torque, np.abs(experiment.velocity) > MOVING, time >= experiment.scenario.transient,
    )  # fmt: skip


def known_within(known: KnownJoint, tolerance: float, tared: bool) -> KnownJoint:
    """Return the knowledge of estimators of a joint within `tolerance` times its tolerances."""
    found = known.within(tolerance)
    return replace(found, link_zero=0.0) if tared else found


def rms(error: np.ndarray, where: np.ndarray) -> float:
    """Return the RMS [N·m] of errors, shape (n,), at some samples, shape (n,), bool; NaN without samples."""
    return float(np.sqrt(np.mean(error[where] ** 2))) if np.any(where) else math.nan


def geometric(values: np.ndarray | Sequence[float], reference: np.ndarray | Sequence[float]) -> Interval:
    """Return the geometric mean of the ratios values/reference of independent draws, shape (n,), with its 95 % interval.

    It is Student's t interval of the log ratios, which are nearly normal. Draws without positive numbers are left out.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        logs = np.log(np.asarray(values, dtype=np.float64) / np.asarray(reference, dtype=np.float64))
    found = interval(logs)
    return Interval(math.exp(found.mean), math.exp(found.low), math.exp(found.high), found.n)
