"""A scenario prepared for simulation with any seed and estimation by any estimator."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..estimator.estimator import Estimator, KnownJoint, Posterior, each
from ..models import own_sensors
from ..models.arm import CarriedMass, carrying, load_of, pickups
from ..models.errors import FilterDiverged, InputError, InputWarning
from ..models.joint import Joint
from ..models.joint_parts import Mounting
from ..models.signals import CHANNELS, SENSED, Signals
from ..models.step import CompiledStep
from ..sim import plant, sensors
from ..sim.loop import CONTROL_PERIOD, SENSOR_FEEDBACK, TRUTH, Change, ClosedLoop, Driven, Simulation
from .scenario import Scenario

if TYPE_CHECKING:
    import mujoco

_FASTEST = 1e5  # rad/s
_SEEN = tuple(name for name in SENSED if not CHANNELS[name].at_step)


@dataclass(frozen=True)
class Experiment:
    """A prepared scenario: everything that does not depend on seed or estimators."""

    scenario: Scenario  # to run
    # joint, known_joint: the plant's joint, and the one that the estimators know
    joint: Joint
    known_joint: Joint
    mounting: Mounting  # payload of the plant
    record: np.ndarray  # parameters of the plant, shape (1,)
    known: KnownJoint  # parameters that the estimators know
    # command, rate: of the drive, in the unit of the scenario's mode, and derivative, shape (n,)
    command: np.ndarray
    rate: np.ndarray
    # external_torque, temperature: torque on the link [N·m], temperature [°C], shape (n,)
    external_torque: np.ndarray
    temperature: np.ndarray
    tip_force: np.ndarray  # tangential force [N] of the external torque, shape (n,)
    fed_back: Estimator | None  # the estimator whose torque is fed back, if any

    @classmethod
    def of(cls, scenario: Scenario, folder: Path | None = None, load: float | None = None) -> Experiment:
        """Load the joint and compute the commands. `folder`: of the scenario's file, to which the joint's path is
        relative; `load`: gravity moment [N·m] of the payload at horizontal, known to the estimators, instead of the
        mounting's; the inertia changes in proportion. Raises `InputError`: an unknown joint or mounting, or a mounting
        without a gravity moment to change."""
        joint, known_joint = scenario.load_joint(folder)
        scenario = scenario.with_gains(joint)
        mounting, known_mounting = (scenario.mount(j) for j in (joint, known_joint))
        if load is not None:
            mounting, known_mounting = _loaded(mounting, load), _loaded(known_mounting, load)
        return cls(
            scenario, joint, known_joint, mounting, joint.record(mounting), KnownJoint.of(known_joint, known_mounting),
            *scenario.commands(), scenario.external_torque(), scenario.temperature.signal(scenario.time),
            scenario.tip_force(), next((f.build() for f in scenario.filters if f.name == scenario.feedback), None),
        )  # fmt: skip

    def build(self, payloads: Sequence[CarriedMass] = ()) -> mujoco.MjModel:
        """Build the MuJoCo model of the plant; `payloads`: that its link carries."""
        return plant.build(
            self.joint,
            self.mounting,
            timestep=self.scenario.timestep,
            record=self.record,
            locked_rotor=self.scenario.locked_rotor,
            payloads=payloads,
        )

    def simulate(self, model: mujoco.MjModel | None = None) -> Simulation:
        """Run the closed loop, with a model of `build` if there is one already; parallel runs do not change a bit of the
        result.

        Raises:
          InputError: torques with which the motion is no longer finite.
          FilterDiverged: the fed-back estimate is no longer finite; names filter and time.
        """
        loop = self.closed_loop(model)
        loop.advance(len(self.command))
        self.check(loop)
        return self.completed(loop.simulation)

    def closed_loop(self, model: mujoco.MjModel | None = None) -> ClosedLoop:
        """Return the closed loop before its first tick; `model`: as of `simulate`."""
        return ClosedLoop(self.build() if model is None else model, (self.driven(),), tuple(self._changes()))

    def _changes(self) -> Iterator[Change]:
        """The plant at each tick at which its link picks up or puts down a payload."""
        payloads = self.scenario.payloads
        for tick, carried in pickups(payloads, self.scenario.time):
            now = [one for one, on in zip(payloads, carried, strict=True) if on]
            yield Change(tick, self.build(now), carrying(self.record, now))

    def driven(self, prefix: str = "") -> Driven:
        """Return drive, sensors and disturbances of the joint for a closed loop; `prefix`: of its names in a model of
        several joints."""
        scenario, record, seed = self.scenario, self.record, self.scenario.seed
        p = record[0]
        feedback: CompiledStep | str | None = SENSOR_FEEDBACK if scenario.feedback == "sensor" else None
        if self.fed_back is not None:
            feedback = self.fed_back.step(self.known, CONTROL_PERIOD)
        # The drive knows ratio and limit of the plant, everything else as the estimators.
        known = self.known.with_numbers(N=p["N"], current_limit=p["current_limit"]).p
        return Driven(
            record,
            self.command,
            self.rate,
            self.external_torque,
            sensors.sensor_records(self.joint, float(p["link_delay"]), CONTROL_PERIOD),
            sensors.noise(self.joint, seed, len(self.command), CONTROL_PERIOD),
            scenario.controller.record(known, CONTROL_PERIOD, scenario.feedback != "none", scenario.mode),
            feedback,
            self.temperature,
            self.tip_force,
            sensors.wrench_crosstalk(self.joint, seed),
            sensors.time_stamps(scenario.time, scenario.jitter, seed),
            scenario.current == "command",
            prefix,
            self.start,
        )

    @property
    def start(self) -> float:
        """Position of the link at the start [rad]."""
        return float(self.command[0]) if self.scenario.mode == "position" else self.scenario.start or 0.0

    def check(self, loop: ClosedLoop, begin: int = 0, place: int = 0) -> None:
        """Check the simulated ticks from `begin` on; `place`: index of the joint in the loop. Raises as `simulate`."""
        simulation = loop.simulations[place]
        tick = simulation.failed[0]
        overloaded = _overload(simulation, begin, loop.done)
        if overloaded is not None:
            raise InputError(
                f"scenario {self.scenario.name}: from {overloaded:.3f} s on the motion is not finite: expected torques that the "
                "joint can bear, got a load beyond the wave generator's compliance, Eq. (5)"
            )
        if tick < len(simulation.time):
            if self.fed_back is not None and tick > 0:  # this raises with the reason
                self.fed_back.estimate(signals_of(simulation).part(slice(0, tick + 1)), self.known)
            raise FilterDiverged(
                self.scenario.feedback, tick, float(simulation.time[tick]), "the estimate is no longer a finite number"
            )

    def completed(self, simulation: Simulation) -> Simulation:
        """Add the torque of known payloads and the readings of plugins' sensors."""
        simulation = with_known_payloads(simulation, self.scenario, self.scenario.mount(self.known_joint))
        if not own_sensors.names():
            return simulation
        truth = {name: np.ascontiguousarray(simulation.truth[name]) for name in simulation.truth.dtype.names or ()}
        own = own_sensors.readings(
            simulation.time,
            truth | {"external_torque": self.external_torque},
            partial(sensors.stream, self.scenario.seed),
        )
        return replace(simulation, further=own)


def with_known_payloads(simulation: Simulation, scenario: Scenario, link: Mounting) -> Simulation:
    """Add the torque of known payloads to a simulation; `link`: load of the link without them, as the estimators know it."""
    if not scenario.payloads or not scenario.known_payloads:
        return simulation
    time = simulation.time if simulation.stamps is None else simulation.stamps
    position = np.ascontiguousarray(simulation.readings["link_position"])
    load = load_of(scenario.payloads, link, time, position, (slice(0, len(time)),))
    return replace(simulation, carried=load.on(link.inertia))


def signals_of(simulation: Simulation) -> Signals:
    """Return the signals that an estimator may read: sensors before the drive acts, and the current command if it is known; at
    their time stamps."""
    columns = {name: simulation.readings[name] for name in _SEEN} | dict(simulation.further)
    if simulation.commanded:
        columns["current_command"] = simulation.command
    if simulation.carried is not None:
        columns["arm_torque"] = simulation.carried
    return Signals(simulation.time if simulation.stamps is None else simulation.stamps, columns)


def estimate(
    estimators: Mapping[str, Estimator], signals: Signals, known: KnownJoint, threads: int = 1
) -> dict[str, Posterior]:
    """Run estimators, by name, over signals; the number of threads does not change a bit of the result.

    An estimator that diverges has no estimate at any sample (NaN), and a warning gives the reason.

    Raises:
      InputError: a missing channel.
      FilterDiverged: no estimator has a finite estimate; names the first filter and its time.
    """

    found = each(estimators, lambda one: one.estimate(signals, known), threads)
    diverged = [one for one in found.values() if isinstance(one, FilterDiverged)]
    for error in found.values():
        if isinstance(error, InputError) or (isinstance(error, FilterDiverged) and len(diverged) == len(found)):
            raise error
    for error in diverged:
        warnings.warn(f"{error}: it has no estimate", InputWarning, stacklevel=2)
    nothing = np.full(len(signals.time), np.nan)
    return {
        name: one if isinstance(one, Posterior) else Posterior(name, signals.time, nothing)
        for name, one in found.items()
    }


def _loaded(mounting: Mounting, load: float) -> Mounting:
    if mounting.gravity_moment == 0:
        raise InputError("load: expected a mounting with a gravity moment to change, got one without")
    share = load / mounting.gravity_moment
    return mounting.model_copy(update={"gravity_moment": load, "inertia": mounting.inertia * share})


def _overload(simulation: Simulation, begin: int, end: int) -> float | None:
    """Return the time [s] in ticks from `begin` to `end` from which the motion is not finite or impossibly fast; None if none."""
    first = max(begin - 1, 0)
    truth = simulation.truth[first:end]
    broken = np.zeros(min(end + 1, len(simulation.time)) - first, dtype=bool)
    for name in TRUTH.names or ():
        broken[: len(truth)] |= ~np.isfinite(truth[name])
    for name in ("motor_position", "wave_generator_position", "link_position"):
        broken[1 : len(truth)] |= ~(np.abs(np.diff(truth[name])) < _FASTEST * CONTROL_PERIOD)
    for name in _SEEN:  # a fed-back estimate fails with the readings, before the truth of that tick
        broken |= ~np.isfinite(simulation.readings[name][first : first + len(broken)])
    return float(simulation.time[first + np.argmax(broken)]) if np.any(broken) else None
