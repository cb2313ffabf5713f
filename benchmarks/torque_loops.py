"""Torque and impedance control with each estimate in the loop: stability margins, bandwidth, error.

The controller is `models.controller.Controller` with a torque loop, the drive of the impedance. All of it is measured on the
simulated joint, with its friction, its sensors' noise and its control period:

* **Gain margin**: factor on the torque loop's gain at which the joint begins to oscillate; **delay margin**: dead time that can
  be added to the drive's. Both with the output bolted to a bench, the stiffest environment, after a step of the wanted torque.
* **Bandwidth** of the torque, likewise bolted: from the wanted torque u to the joint torque Ts, for a sum of sines; where the
  gain falls to 1/√2 of that at the lowest of them.
* **Error**: RMS of Ts − u in a separate experiment [N·m]: the unwanted torque on the environment.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from flexspline.estimator.estimator import Estimator, KnownJoint
from flexspline.models.controller import Controller, control
from flexspline.models.errors import FilterDiverged, InputError
from flexspline.models.joint_parts import LOCKED, Mounting
from flexspline.models.kernels import kernel
from flexspline.scenarios.evaluation.draws import drawn_record, known_within, varied
from flexspline.scenarios.experiment import Experiment
from flexspline.scenarios.scenario import Scenario, Waypoint
from flexspline.sim.loop import CONTROL_PERIOD, Simulation

GAINS = (0.25, 64.0)
"""Smallest and largest torque loop gain that is tried."""
DELAYS = (0.2e-3, 19.6e-3)
"""Smallest and largest dead time [s] that is added."""
FREQUENCIES = (1.0, 150.0)
"""Lowest and highest sine [Hz] of the bandwidth's excitation, twenty of them."""
_STEP, _END = 0.3, 1.8  # s: of the wanted torque; of a run for stability
_LAST = 0.5  # s at its end in which there is an oscillation or not
_OSCILLATES = 0.5  # N·m, standard deviation of the joint torque
_TORQUE = 3.0  # N·m, step and sines
_SECONDS = 4.0  # of the sum of sines
_BENCH = Mounting(inertia=LOCKED, gravity_moment=0.0)


def impedance(stiffness: float, damping: float, gain: float, p: np.void, gravity: float = 1.0) -> Controller:
    """The controller that makes a joint of these parameters a spring and damper [N·m/rad], [N·m·s/rad] on the output side."""
    unit = float(p["N"]) ** 2 * float(p["Kt"])
    return Controller(kp=stiffness / unit, kd=damping / unit, torque_loop=gain, gravity=gravity)


def wanted(
    controller: Controller, position: np.ndarray, velocity: np.ndarray, measured: np.ndarray, p: np.void, dt: float
) -> np.ndarray:
    """The torque u [N·m] that a controller's impedance asks for, shape (n,).

    Args:
      position, velocity: commands [rad], [rad/s], output side, shape (n,).
      measured: motor encoder [rad], shape (n,). p: parameters that the drive knows. dt: control period [s].
    """
    record = controller.model_copy(update={"torque_loop": 0.0}).record(p, dt, feedback=False)
    record["limit"] = np.inf
    out = np.zeros(len(position))
    _wanted(position, velocity, measured, dt, record, float(p["N"] * p["Kt"]), out)
    return out


@kernel
def _wanted(position, velocity, measured, dt, record, unit, out):
    c, state = record[0], np.zeros(3)
    state[0] = c.gear * position[0]
    for k in range(len(position)):
        out[k] = unit * control(position[k], velocity[k], measured[k], 0.0, state, dt, c)


@dataclass(frozen=True)
class Control:
    """A torque loop with one estimate in a draw.

    Attributes:
        gain_margin: factor on the gain [1]; infinite where the largest gain that is tried is stable, 0 where none is.
        delay_margin: dead time that can be added [s]; likewise.
        bandwidth: of the torque [Hz]; NaN where it oscillates.
        error: RMS of Ts − u [N·m]; NaN likewise.
    """

    gain_margin: float
    delay_margin: float
    bandwidth: float
    error: float


@dataclass(frozen=True)
class Loop:
    """An impedance: stiffness [N·m/rad], damping [N·m·s/rad], gain of the torque loop [1]."""

    stiffness: float = 500.0
    damping: float = 20.0
    gain: float = 1.0


DEFAULT = Loop()


def bolted(joint: Experiment, record: np.ndarray, known: KnownJoint) -> tuple[Experiment, np.ndarray]:
    """The experiment's joint with its output bolted to the bench, and the record of a draw of it."""
    for p in (record := record.copy(), knows := known.record.copy()):
        p[0]["Jl"], p[0]["Mg"] = _BENCH.inertia, 0.0
    return replace(joint, mounting=_BENCH, record=record, known=replace(known, record=knows)), record


def assess(
    scenario: Scenario,
    folder: Path | None,
    estimator: Estimator | None,
    seed: int,
    tolerance: float,
    loop: Loop = DEFAULT,
) -> Control:
    """Close the torque loop with an estimate on a drawn joint; with a gain of 0 there is none, and no margins.

    Args:
        scenario: its experiment is that of the error; joint, sensors and mounting are those of all. folder: of its file.
        estimator: None: the torque sensor.
        seed: of the draw. tolerance: share of the joint's tolerances; estimator and drive know the nominal numbers.
        loop: impedance and gain.

    Raises:
        InputError: an estimator that looks ahead.
    """
    if estimator is not None and not estimator.causal:
        raise InputError(
            f"torque control: {estimator.name}: expected an estimator for the loop, got one that looks ahead"
        )
    chosen = varied(scenario, seed)
    free = Experiment.of(chosen.model_copy(update={"feedback": "none"}), folder)
    record = drawn_record(free, seed, tolerance, zero_known=True)
    known = known_within(free.known, tolerance, zero_known=True)
    free = replace(free, known=known, fed_back=estimator)
    bench, fixed = bolted(free, record, known)

    def controlled(gain: float, delay: float = 0.0) -> Controller:
        controller = impedance(loop.stiffness, loop.damping, gain, known.p)
        return controller.model_copy(update={"delay": chosen.controller.delay + delay})

    def stable(gain: float, delay: float) -> bool:
        found = _stepped(bench, fixed, controlled(gain, delay), loop, seed)
        return (
            found is not None
            and float(np.std(found.truth["joint_torque"][-round(_LAST / CONTROL_PERIOD) :])) < _OSCILLATES
        )

    gain, delay = math.inf, math.inf
    if loop.gain > 0.0:
        gain = largest(lambda g: stable(g, 0.0), *GAINS) / loop.gain
        if gain < 1.0:
            return Control(gain, 0.0, math.nan, math.nan)
        delay = largest(lambda d: stable(loop.gain, d), *DELAYS)
    controller = controlled(loop.gain)
    return Control(
        gain, delay, _bandwidth(bench, fixed, controller, loop, seed), _error(free, record, controller, seed)
    )


def largest(holds: Callable[[float], bool], low: float, high: float, ratio: float = 1.1) -> float:
    """The largest value for which something holds, within a factor: by bisection of logarithms; 0 where it does not at `low`,
    infinite where it still does at `high`."""
    if not holds(low):
        return 0.0
    if holds(high):
        return math.inf
    while high > ratio * low:
        middle = math.sqrt(low * high)
        low, high = (middle, high) if holds(middle) else (low, middle)
    return math.sqrt(low * high)


def _run(experiment: Experiment, record: np.ndarray, controller: Controller, seed: int) -> Simulation | None:
    """A simulation with the torque loop closed; None where it runs away."""
    feedback = "sensor" if experiment.fed_back is None else "estimate"
    scenario = experiment.scenario.model_copy(update={"controller": controller, "feedback": feedback})
    try:
        return replace(experiment, scenario=scenario, record=record).simulate()
    except (InputError, FilterDiverged):
        return None


def _commanded(experiment: Experiment, position: np.ndarray) -> Experiment:
    """The experiment with another commanded position, shape (n,) [rad], at no commanded velocity, and nothing else."""
    time = len(position) * CONTROL_PERIOD
    scenario = experiment.scenario.model_copy(
        update={
            "duration": time,
            "trajectory": [Waypoint(time=0.0, position=0.0)],
            "disturbances": [],
            "transient": 0.0,
        }
    )
    still = np.zeros(len(position))
    return replace(
        experiment, scenario=scenario, command=position, rate=still, external_torque=still, tip_force=still,
        temperature=np.full(len(position), experiment.temperature[0]),
    )  # fmt: skip


def _stepped(bench: Experiment, record: np.ndarray, controller: Controller, loop: Loop, seed: int) -> Simulation | None:
    time = np.arange(round(_END / CONTROL_PERIOD)) * CONTROL_PERIOD
    return _run(_commanded(bench, np.where(time >= _STEP, _TORQUE / loop.stiffness, 0.0)), record, controller, seed)


def _bandwidth(bench: Experiment, record: np.ndarray, controller: Controller, loop: Loop, seed: int) -> float:
    n = round(_SECONDS / CONTROL_PERIOD)
    bins = np.unique(np.round(np.geomspace(*FREQUENCIES, 20) * _SECONDS)).astype(int)
    time = np.arange(2 * n) * CONTROL_PERIOD
    phases = np.pi * np.arange(len(bins)) ** 2 / len(bins)  # Schroeder's: no high peak
    sines = np.sin(2 * np.pi * bins[:, None] / _SECONDS * time + phases[:, None]).sum(axis=0)
    position = _TORQUE * math.sqrt(2.0 / len(bins)) * sines / loop.stiffness
    experiment = _commanded(bench, position - position[0])
    found = _run(experiment, record, controller, seed)
    if found is None:
        return math.nan
    u = wanted(
        controller,
        experiment.command,
        experiment.rate,
        found.readings["motor_position"],
        experiment.known.p,
        CONTROL_PERIOD,
    )
    asked, given = (np.fft.rfft(x[n:])[bins] for x in (u, found.truth["joint_torque"]))
    gain = np.abs(given / asked)
    return crossing(bins / _SECONDS, gain / gain[0], 1.0 / math.sqrt(2.0))


def crossing(frequency: np.ndarray, gain: np.ndarray, level: float) -> float:
    """Where a gain, shape (n,), first falls below a level: between frequencies, shape (n,), straight in both logarithms; infinite
    where it does not."""
    below = np.flatnonzero(gain < level)
    if not len(below):
        return math.inf
    k = max(int(below[0]), 1)
    share = math.log(gain[k - 1] / level) / math.log(gain[k - 1] / gain[k])
    return float(frequency[k - 1] * (frequency[k] / frequency[k - 1]) ** share)


def _error(free: Experiment, record: np.ndarray, controller: Controller, seed: int) -> float:
    found = _run(free, record, controller, seed)
    if found is None:
        return math.nan
    u = wanted(controller, free.command, free.rate, found.readings["motor_position"], free.known.p, CONTROL_PERIOD)
    kept = found.time >= free.scenario.transient
    return float(np.sqrt(np.mean((found.truth["joint_torque"] - u)[kept] ** 2)))
