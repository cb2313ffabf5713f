"""Drawn experiments with their signals, and statistics over them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.special import bdtr

from flexspline.estimator.estimator import KnownJoint
from flexspline.models.signals import Signals
from flexspline.scenarios.evaluation.draws import drawn_record, known_within, of_seed
from flexspline.scenarios.evaluation.intervals import LEVEL, Interval, interval
from flexspline.scenarios.experiment import Experiment, signals_of
from flexspline.scenarios.scenario import Scenario
from flexspline.sim.loop import Simulation

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


def draw(
    scenario: Scenario,
    folder: Path | None,
    seed: int,
    tolerance: float = 1.0,
    zero_known: bool = True,
    vary: bool = True,
    load: float | None = None,
) -> DrawnExperiment:
    """Draw an experiment and simulate it.

    Args:
      scenario: without torque feedback. folder: of its file.
      seed: of all random numbers; draws with different tolerances and the same seed are paired.
      tolerance: share of the joint's tolerances for the draw.
      zero_known: whether the link encoder's zero is known.
      vary: whether motion and pushes are drawn, too.
      load: known gravity moment of the payload at horizontal [N·m]; by default the mounting's.

    Raises:
      InputError: a joint that cannot bear the load.
    """
    chosen = of_seed(scenario, seed, vary)
    experiment = Experiment.of(chosen, folder, load)
    record = drawn_record(experiment, seed, tolerance, zero_known)
    simulation = replace(experiment, record=record).simulate()
    return draw_of(experiment, simulation, record, known_within(experiment.known, tolerance, zero_known), seed)


def draw_of(
    experiment: Experiment, simulation: Simulation, record: np.ndarray, known: KnownJoint, seed: int
) -> DrawnExperiment:
    """Return a simulation of an experiment as a `DrawnExperiment`."""
    time = simulation.time
    return DrawnExperiment(
        seed, known, record, signals_of(simulation), np.ascontiguousarray(simulation.truth["joint_torque"]),
        experiment.external_torque, np.abs(experiment.rate) > MOVING, time >= experiment.scenario.transient,
    )  # fmt: skip


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


def median(values: np.ndarray | Sequence[float], level: float = LEVEL) -> Interval:
    """Return the median of independent values, shape (n,), with an interval for any distribution, without NaN.

    Its ends are the order statistics x(j) and x(n + 1 − j) with the largest j for which P(Bin(n, ½) < j) ≤ (1 − level)/2; NaN
    if n is too small.
    """
    x = np.sort(np.asarray(values, dtype=np.float64))
    x = x[~np.isnan(x)]
    n = len(x)
    if n == 0:
        return Interval(math.nan, math.nan, math.nan, 0)
    middle = float(x[(n - 1) // 2]) if x[(n - 1) // 2] == x[n // 2] else float(0.5 * (x[(n - 1) // 2] + x[n // 2]))
    j = 0
    while j < n // 2 and bdtr(j, n, 0.5) <= 0.5 * (1.0 - level):
        j += 1
    return Interval(middle, math.nan, math.nan, n) if j == 0 else Interval(middle, float(x[j - 1]), float(x[n - j]), n)
