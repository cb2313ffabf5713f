"""A scenario that has been run: signals, estimates, measures."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from ..estimator import registry
from ..estimator.compliance import compliance
from ..estimator.estimator import KnownJoint, Posterior
from ..models.arm import ArmRecord
from ..models.arm_dynamics import Arm
from ..models.errors import InputError
from ..models.joint import Joint, beyond_sentence
from ..models.notebook import html_table, paragraph
from ..models.parameters import REFERENCE_TEMPERATURE
from ..models.recording import Recording
from ..models.signals import Signals
from ..sim.loop import CONTROL_PERIOD, Simulation
from ..sim.plant import link_mass
from .evaluation.metrics import Reference
from .evaluation.tip_force import TipForce, tip_force
from .experiment import Experiment, estimate, signals_of
from .scenario import Scenario

_RECORDED = ("motor_position", "link_position", "motor_current", "joint_torque")
_WHERE_STATED = ("motor_torque", "temperature")


_LIMITED = 0.005
"""Share of the time at the current limit from which on it is told: no shipped scenario is there at all."""
_SOON, _TURNS = 0.1, 20
"""Time [s] between opposite limits of the current, and their number, from which on a torque loop is unstable."""


@dataclass(frozen=True)
class Place:
    """The place of a joint in an arm that moved; n control ticks.

    Attributes:
      arm: as a recording says it.
      external_torque: torques on the joint's own link and all beyond it, shape (n,) [N·m].
    """

    arm: ArmRecord
    external_torque: np.ndarray


@dataclass(frozen=True)
class Run:
    """A scenario that has been run: what was asked, what came out. n control ticks.

    Attributes:
      scenario: resolved.
      joint, known_joint: the plant's joint, and the one that the estimators know.
      known: what they know of it.
      simulation: everything that happened at the control ticks: truth and readings as records, by name.
      estimates: what each of the scenario's filters said, by its name.
      position_command: commanded link position [rad], shape (n,).
      external_torque: torque on the link [N·m], shape (n,).
      place: where the joint was in an arm; None where it was alone.
      raw: the raw compliance model [N·m], shape (n,), where it is known already.
    """

    scenario: Scenario
    joint: Joint
    known_joint: Joint
    known: KnownJoint
    simulation: Simulation
    estimates: dict[str, Posterior]
    position_command: np.ndarray
    external_torque: np.ndarray
    place: Place | None = None
    raw: np.ndarray | None = None

    @property
    def name(self) -> str:
        """The scenario's name."""
        return self.scenario.name

    @property
    def time(self) -> np.ndarray:
        """Control ticks [s], shape (n,)."""
        return self.simulation.time

    @cached_property
    def signals(self) -> Signals:
        """What an estimator may read."""
        return signals_of(self.simulation)

    @cached_property
    def model_torque(self) -> np.ndarray:
        """Raw compliance model [N·m], shape (n,): what the paper's filters filter."""
        return registry.get("model").estimate(self.signals, self.known).mean if self.raw is None else self.raw

    @cached_property
    def kinematic_error(self) -> np.ndarray:
        """Kinematic error of the plant [rad] at the true angle of its wave generator, shape (n,)."""
        record = self.joint.record(self.scenario.mount(self.joint))
        # With zero torque the compliance model's kinematic error is the one at the given angle: θw itself.
        return compliance(self.truth("wave_generator_position"), 0.0, 0.0, record).kinematic_error

    def _repr_html_(self) -> str:
        shown = {"rms": "error [N·m RMS]", "noise": "noise [N·m RMS]", "delay_ms": "delay [ms]"}
        rows = [(name, *(m.get(key) for key in shown)) for name, m in self.metrics["filters"].items()]
        text = f"{self.joint.name}, {self.scenario.duration:g} s, seed {self.scenario.seed}"
        notes = "".join(paragraph("Note:", note) for note in self.notes)
        return paragraph(self.name, text) + html_table(("filter", *shown.values()), rows) + notes

    def truth(self, name: str) -> np.ndarray:
        """A true signal, one of `sim.loop.TRUTH`, shape (n,)."""
        return np.ascontiguousarray(self.simulation.truth[name])

    @cached_property
    def beyond(self) -> dict[str, float]:
        """Shares of the motion beyond the range of validity of the plant's joint or of the one that the estimators know, the
        larger (`models.joint.ValidRange.beyond`); empty where neither states one."""
        joints = [joint for joint in (self.joint, self.known_joint) if joint.valid is not None]
        moving = np.abs(self.truth("motor_velocity")) > 2.5 * self.joint.numbers["vs"].value
        motion = [self.truth(name)[moving] for name in ("link_position", "link_velocity", "joint_torque")]
        found: dict[str, float] = {}
        for joint in joints:
            for name, share in joint.valid.beyond(*motion).items() if joint.valid else ():
                found[name] = max(share, found.get(name, 0.0))
        return found

    def reading(self, name: str) -> np.ndarray:
        """What a sensor gave, one of `models.signals.SENSED`, shape (n,)."""
        return np.ascontiguousarray(self.simulation.readings[name])

    def estimate(self, name: str) -> np.ndarray:
        """A filter's estimate of the joint torque [N·m], shape (n,)."""
        return self.estimates[name].mean

    @cached_property
    def reference(self) -> Reference:
        """What estimates of the joint torque are measured against."""
        return reference_of(self.simulation, self.model_torque, self.external_torque, self.scenario.transient)

    @cached_property
    def notes(self) -> tuple[str, ...]:
        """What whoever reads the measures should know: disturbances that do not act, a drive at its limit, no measures."""
        end, samples, late, found = self.scenario.duration, len(self.time), [], []
        for i, d in enumerate(self.scenario.disturbances):
            if d.start >= end:
                late.append((f"disturbances.{i}", f"{d.start:g}"))
            elif d.start + d.duration > end:
                found.append(
                    f"disturbances.{i} lasts until {d.start + d.duration:g} s: the end at {end:g} s cuts it off"
                )
        if late:
            names, starts = (", ".join(words) for words in zip(*late, strict=True))
            start, act = ("starts", "it never acts") if len(late) == 1 else ("start", "they never act")
            found.insert(0, f"{names} {start} at {starts} s, after the end at {end:g} s: {act}")
        limit = self.joint.numbers["current_limit"].value
        limited = np.count_nonzero(np.abs(self.simulation.command) >= (1 - 1e-9) * limit) / samples
        if limited > _LIMITED:
            off = float(np.max(np.abs(self.position_command - self.truth("link_position"))))
            swings = self.scenario.controller.torque_loop > 0.0 and _swings(self)
            cause = "the torque loop is unstable" if swings else "the motion asks for more than it gives"
            found.append(
                f"the drive is at its limit of {limit:g} A for {100 * limited:.2g} % of the time: {cause}, and the link is up to "
                f"{off:.2g} rad off its command"
            )
        found += _idle(self)
        for name, one in self.estimates.items():
            if one.untrusted is not None:
                found.append(f"{name} is not to be trusted: {one.untrusted}")
            count = int(np.sum(~np.isfinite(one.mean)))
            if count:
                found.append(f"{name} gives no estimate for {count} of {samples} samples and is not measured")
        if self.tip_force is not None:
            errors = self.tip_force.errors(self.reference.kept)
            shown = ", ".join(f"{name} {value:.2f}" for name, value in sorted(errors.items(), key=lambda item: item[1]))
            lever = self.tip_force.lever
            where = "" if math.isnan(lever) else f"; it acts at {lever:.3f} m, says the wrench"
            found.append(f"force at the link, RMS error [N]: {shown}{where}")
        if self.beyond:
            found.append(beyond_sentence(self.beyond))
        return tuple(found)

    @cached_property
    def tip_force(self) -> TipForce | None:
        """The force at the link by the wrench and by every filter (`evaluation.tip_force`); None where the scenario records no
        wrench or its pushes have not one lever."""
        lever = self.scenario.lever
        if lever is None:
            return None
        mass, _ = link_mass(self.joint.record(self.scenario.mount(self.joint))[0])
        force = self.scenario.tip_force()
        return tip_force(self.simulation, self.signals, self.known, mass, force, lever, self.estimates)

    @cached_property
    def metrics(self) -> dict[str, Any]:
        """Measures of every filter, of the raw compliance model and of the torque sensor (`evaluation.metrics`)."""
        reference = self.reference
        truth, kept = reference.truth, reference.kept
        error = (self.position_command - self.truth("link_position"))[kept]
        tip = self.tip_force
        return {
            "scenario": self.name,
            "seed": self.scenario.seed,
            "filters": {name: reference.evaluate_posterior(found) for name, found in self.estimates.items()},
            "untrusted": {n: found.untrusted for n, found in self.estimates.items() if found.untrusted is not None},
            "model": reference.evaluate(self.model_torque),
            "sensor": reference.evaluate(reference.reading),
            "notes": list(self.notes),
            "truth": {"joint_torque_range": [float(truth[kept].min()), float(truth[kept].max())]},
            "position_error": {
                "rms": float(np.sqrt(np.mean(error**2))),
                "max": float(np.max(np.abs(self.position_command - self.truth("link_position")))),
                "unit": "rad",
            },
            "tip_force": None if tip is None else {"rms": tip.errors(kept), "lever": tip.lever, "unit": "N, m"},
        }

    def as_recording(self) -> Recording:
        """What a person would have measured: the sensors that the scenario's `record` names.

        Where it names none: encoders, current and torque sensor, and motor torque and temperature where the joint states such a
        sensor's noise.
        """
        mounting = self.scenario.mount(self.joint)
        names = self.scenario.record
        if not names:
            stated = [n for n in _WHERE_STATED if getattr(self.joint.sensors, n).noise > 0.0]
            names = [*_RECORDED, *stated]
        columns = {name: self.reading(name) for name in names} | {"position_command": self.position_command}
        columns |= self.simulation.further
        external = self.external_torque if self.place is None else self.place.external_torque
        pushed = bool(np.any(external))
        if pushed:
            columns["external_torque"] = external
        recording = Recording(
            name=self.name,
            time=self.signals.time,
            columns=columns,
            joint=self.joint.name,
            description=self.scenario.description,
            link=mounting,
            external="measured" if pushed else "none",
        )
        if self.place is None:
            return recording
        arm = self.place.arm
        link, load = Arm.of_text(arm.spec, arm.mjcf).of(
            recording.time, self.reading("link_position"), arm.positions, recording.segments
        )
        return replace(recording, link=link, load=load, arm=arm)


def _idle(run: Run) -> Iterator[str]:
    """What a scenario states and nothing in its run depends on."""
    scenario, at = run.scenario, run.scenario.temperature
    coefficients = (joint.record()["friction_temperature"][0] for joint in (run.joint, run.known_joint))
    if (at.start, at.end) != (REFERENCE_TEMPERATURE,) * 2 and not any(coefficients):
        yield f"temperature acts on nothing: {run.joint.name} states no friction that depends on it"
    if scenario.locked_rotor and len({way.position for way in scenario.trajectory}) > 1:
        yield "trajectory acts on nothing: the rotor is locked"
    if isinstance(scenario.sensors, dict) and not any(name.startswith("force") for name in scenario.record):
        for name in {"wrench", "force"} & scenario.sensors.keys():
            yield f"sensors.{name} acts on nothing: the scenario records no force"


def _swings(run: Run) -> bool:
    """Whether the drive's current goes from limit to limit as an unstable loop's does, most times within a tenth of a second."""
    limit, command = run.joint.numbers["current_limit"].value, run.simulation.command
    at = np.flatnonzero(np.abs(command) >= (1 - 1e-9) * limit)
    turns = np.flatnonzero(np.diff(np.sign(command[at])))
    soon = np.diff(run.time[at])[turns] < _SOON
    return bool(np.count_nonzero(soon) >= _TURNS)


def reference_of(
    simulation: Simulation, model_torque: np.ndarray, external_torque: np.ndarray, transient: float
) -> Reference:
    """What estimates over a simulation are measured against; `transient`: left out at the start [s]."""
    return Reference(
        np.ascontiguousarray(simulation.truth["joint_torque"]),
        np.ascontiguousarray(simulation.readings["joint_torque"]),
        model_torque,
        external_torque,
        CONTROL_PERIOD,
        transient,
    )


def run_scenario(scenario: Scenario, folder: Path | None = None, threads: int = 1) -> Run:
    """Run a scenario: the closed loop, then every filter over its signals.

    Args:
      scenario: what to run.
      folder: of the scenario's file, where a joint that it names by a relative path lies.
      threads: filters at a time; the result does not depend on it.

    Raises:
      InputError: a joint or mounting that does not exist; torques under which the motion is no longer finite; a filter that
        reads a sensor that there is not.
      FilterDiverged: an estimate is no longer finite; names filter and time.
    """
    experiment = Experiment.of(scenario, folder)
    simulation = experiment.simulate()
    estimates = estimate(scenario.estimators(), signals_of(simulation), experiment.known, threads)
    return run_of(experiment, simulation, estimates)


def run_of(
    experiment: Experiment, simulation: Simulation, estimates: dict[str, Posterior], place: Place | None = None
) -> Run:
    """What came of an experiment, as a run."""
    return Run(
        experiment.scenario, experiment.joint, experiment.known_joint, experiment.known, simulation, estimates,
        experiment.position, experiment.external_torque, place,
    )  # fmt: skip


def simulate_scenario(scenario: Scenario, folder: Path | None, seed: int) -> Run:
    """Run a scenario with a seed and without its filters: the signals are those of any filters.

    Raises:
      InputError: an estimate fed back: the signals would depend on the filter.
    """
    if scenario.feedback not in ("none", "sensor"):
        raise InputError(
            f"scenario {scenario.name}: feedback: expected none or sensor, got {scenario.feedback!r}: the signals would "
            "depend on the filter"
        )
    scenario = scenario.model_copy(update={"seed": int(seed)})
    experiment = Experiment.of(scenario, folder)
    return run_of(experiment, experiment.simulate(), {})
