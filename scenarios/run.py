"""A scenario that has been run: signals, estimates, metrics."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from ..estimator import registry
from ..estimator.estimator import KnownJoint, Posterior
from ..models import laws
from ..models.arm import ArmRecord
from ..models.arm_dynamics import Arm
from ..models.controller import MODES
from ..models.errors import InputError, nearest
from ..models.joint import Joint
from ..models.joint_parts import beyond_sentence
from ..models.kernels import kernel
from ..models.notebook import html_table, paragraph
from ..models.parameters import REFERENCE_TEMPERATURE
from ..models.recording import Recording, with_load
from ..models.signals import Signals, at_samples
from ..sim.loop import CONTROL_PERIOD, Simulation
from .evaluation.metrics import Reference
from .evaluation.tip_force import TipForce, tip_force
from .experiment import Experiment, estimate, signals_of
from .scenario import Scenario

_RECORDED = ("motor_position", "link_position", "motor_current", "joint_torque")
_WHERE_STATED = ("motor_torque", "temperature")


_SATURATED = 0.005  # share of the time at the current limit above which a note says so; in shipped scenarios it is 0
_FAST, _TURNS = 0.1, 20
"""An unstable torque loop changes between opposite current limits within this time [s], at least so many times."""


@dataclass(frozen=True)
class Place:
    """The place of a joint in an arm that moved; n control ticks."""

    arm: ArmRecord  # as in a recording
    external_torque: np.ndarray  # torques on the joint's own link and all links beyond it, shape (n,) [N·m]


@dataclass(frozen=True, repr=False)
class Run:
    """A scenario that has been run, with its results; n control ticks.

    Attributes:
      scenario: resolved.
      joint, known_joint: the plant's joint, and the one that the estimators know.
      known: parameters that the estimators know.
      simulation: truth and readings at the control ticks.
      estimates: results of the scenario's filters, by name.
      command: of the drive, in the unit of the scenario's mode (`controller.MODES`), shape (n,).
      external_torque: torque on the link [N·m], shape (n,).
      place: of the joint in an arm; None for a single joint.
      raw: raw compliance model [N·m], shape (n,), if it is already known.
    """

    scenario: Scenario
    joint: Joint
    known_joint: Joint
    known: KnownJoint
    simulation: Simulation
    estimates: dict[str, Posterior]
    command: np.ndarray
    external_torque: np.ndarray
    place: Place | None = None
    raw: np.ndarray | None = None

    def __repr__(self) -> str:
        errors = ", ".join(f"{name} {m['rms']:.3g}" for name, m in self.metrics["filters"].items())
        return (
            f"Run({self.name!r}: {self.joint.name}, {self.scenario.duration:g} s, seed {self.scenario.seed}, "
            f"{len(self.time)} ticks; RMS error [N·m]: {errors or 'no filters'})"
        )

    def _repr_html_(self) -> str:
        shown = {"rms": "error [N·m RMS]", "noise": "noise [N·m RMS]", "delay_ms": "delay [ms]"}
        rows = [(name, *(m.get(key) for key in shown)) for name, m in self.metrics["filters"].items()]
        text = f"{self.joint.name}, {self.scenario.duration:g} s, seed {self.scenario.seed}"
        notes = "".join(paragraph("Note:", note) for note in self.notes)
        return paragraph(self.name, text) + html_table(("filter", *shown.values()), rows) + notes

    @property
    def name(self) -> str:
        """The scenario's name."""
        return self.scenario.name

    @property
    def time(self) -> np.ndarray:
        """Control ticks [s], shape (n,)."""
        return self.simulation.time

    def part(self, ticks: slice) -> Run:
        """Return two or more successive control ticks of the run, as a run that begins later."""
        simulation = at_samples(self.simulation, ticks)
        estimates = {name: one.part(ticks) for name, one in self.estimates.items()}
        return replace(
            self, simulation=simulation, estimates=estimates, command=self.command[ticks],
            external_torque=self.external_torque[ticks], raw=self.model_torque[ticks],
        )  # fmt: skip

    @cached_property
    def signals(self) -> Signals:
        """Signals that an estimator may read."""
        return signals_of(self.simulation)

    @cached_property
    def model_torque(self) -> np.ndarray:
        """Raw compliance model [N·m], shape (n,): the input of the paper's filters."""
        return registry.get("model").estimate(self.signals, self.known).mean if self.raw is None else self.raw

    @property
    def position_command(self) -> np.ndarray | None:
        """Commanded link position [rad], shape (n,); None without position control."""
        return self.command if self.scenario.mode == "position" else None

    @cached_property
    def command_error(self) -> np.ndarray:
        """Command less the true link position [rad], link velocity [rad/s], or motor torque N·Kt·i [N·m], shape (n,)."""
        if self.scenario.mode == "torque":
            p = self.joint.record()[0]
            return self.command - p["N"] * p["Kt"] * self.truth("motor_current")
        return self.command - self.truth(f"link_{self.scenario.mode}")

    @cached_property
    def kinematic_error(self) -> np.ndarray:
        """Kinematic error of the plant [rad] at the true angle of its wave generator, shape (n,)."""
        record = self.joint.record(self.scenario.mount(self.joint))
        return _kinematic_errors(self.truth("wave_generator_position"), record)

    def truth(self, name: str) -> np.ndarray:
        """Return a true signal, one of `sim.loop.TRUTH`, shape (n,); `InputError` for another name."""
        return _field(self.simulation.truth, name, "true signal")

    def reading(self, name: str) -> np.ndarray:
        """Return a sensor's reading, one of `models.signals.SENSED`, shape (n,); `InputError` for another name."""
        return _field(self.simulation.readings, name, "reading")

    def estimate(self, name: str) -> np.ndarray:
        """Return a filter's estimate of the joint torque [N·m], shape (n,); `InputError` for another name."""
        if name not in self.estimates:
            raise InputError(_unknown("filter", name, self.estimates))
        return self.estimates[name].mean

    @cached_property
    def beyond(self) -> dict[str, float]:
        """Shares of the motion outside the range of validity of either joint, the larger one (`ValidRange.beyond`); empty if
        neither states a range."""
        moving = np.abs(self.truth("motor_velocity")) > 2.5 * self.joint.numbers["vs"].value
        motion = [self.truth(name)[moving] for name in ("link_position", "link_velocity", "joint_torque")]
        found: dict[str, float] = {}
        for joint in (self.joint, self.known_joint):
            for name, share in joint.valid.beyond(*motion).items() if joint.valid is not None else ():
                found[name] = max(share, found.get(name, 0.0))
        return found

    @cached_property
    def reference(self) -> Reference:
        """Reference signals for metrics of joint torque estimates."""
        return Reference(
            self.truth("joint_torque"), self.reading("joint_torque"), self.model_torque, self.external_torque,
            CONTROL_PERIOD, self.scenario.transient,
        )  # fmt: skip

    @cached_property
    def notes(self) -> tuple[str, ...]:
        """Remarks on the metrics: disturbances without effect, a saturated drive, estimates that are not to be trusted."""
        return tuple([*_late(self), *_saturated(self), *_unused(self), *_estimates(self)])

    @cached_property
    def tip_force(self) -> TipForce | None:
        """The force at the link by the wrench and by every filter; None without a wrench or a common lever."""
        return tip_force(self)

    @cached_property
    def metrics(self) -> dict[str, Any]:
        """Metrics of every filter, of the raw compliance model and of the torque sensor (`evaluation.metrics`)."""
        reference = self.reference
        truth, kept = reference.truth, reference.kept
        error = self.command_error
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
            f"{self.scenario.mode}_error": {
                "rms": float(np.sqrt(np.mean(error[kept] ** 2))),
                "max": float(np.max(np.abs(error))),
                "unit": MODES[self.scenario.mode],
            },
            "tip_force": None if tip is None else {"rms": tip.errors(kept), "lever": tip.lever, "unit": "N, m"},
        }

    def as_recording(self) -> Recording:
        """Return a recording of the sensors that the scenario's `record` names.

        By default these are encoders, current and torque sensor; motor torque and temperature if the joint states their noise.
        """
        mounting = self.scenario.mount(self.joint)
        names = self.scenario.record
        if not names:
            stated = [n for n in _WHERE_STATED if getattr(self.joint.sensors, n).noise > 0.0]
            names = [*_RECORDED, *stated]
        columns = {name: self.reading(name) for name in names}
        if self.position_command is not None:
            columns["position_command"] = self.position_command
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
            payloads=tuple(self.scenario.payloads) if self.scenario.known_payloads else (),
        )
        if self.place is None:
            return with_load(recording, self.joint.numbers["N"].value)
        arm = self.place.arm
        link, load = Arm(arm.spec, arm.mjcf).of(
            recording.time, self.reading("link_position"), arm.positions, recording.segments
        )
        return replace(recording, link=link, load=load, arm=arm)


@kernel
def _kinematic_errors(theta_w: np.ndarray, record: np.ndarray) -> np.ndarray:
    return np.array([laws.kinematic_error(x, record[0]) for x in theta_w])


def _field(records: np.ndarray, name: str, kind: str) -> np.ndarray:
    names = records.dtype.names or ()
    if name not in names:
        raise InputError(_unknown(kind, name, names))
    return np.ascontiguousarray(records[name])


def _unknown(kind: str, name: str, known: Iterable[str]) -> str:
    return f"{kind} {name!r}: expected one of {', '.join(known)}{nearest(name, known)}"


def _late(run: Run) -> Iterator[str]:
    """Disturbances and payloads that start or end after the scenario's end."""
    end, disturbances = run.scenario.duration, list(enumerate(run.scenario.disturbances))
    late = [(f"disturbances.{i}", f"{d.start:g}") for i, d in disturbances if d.start >= end]
    if late:
        names, starts = (", ".join(words) for words in zip(*late, strict=True))
        start, act = ("starts", "it never acts") if len(late) == 1 else ("start", "they never act")
        yield f"{names} {start} at {starts} s, after the end at {end:g} s: {act}"
    for i, one in enumerate(run.scenario.payloads):
        if one.start >= end:
            yield f"payloads.{i} starts at {one.start:g} s, after the end at {end:g} s: it is never carried"
    for i, d in disturbances:
        if d.start < end < d.start + d.duration:
            yield f"disturbances.{i} lasts until {d.start + d.duration:g} s: the end at {end:g} s cuts it off"


def _saturated(run: Run) -> Iterator[str]:
    """Whether the drive is at its current limit, and why."""
    limit, command = run.joint.numbers["current_limit"].value, run.simulation.command
    at_limit = np.flatnonzero(np.abs(command) >= (1 - 1e-9) * limit)
    share = len(at_limit) / len(run.time)
    if share <= _SATURATED:
        return
    turns = np.flatnonzero(np.diff(np.sign(command[at_limit])))  # an unstable loop goes from limit to limit
    fast = np.diff(run.time[at_limit])[turns] < _FAST
    unstable = run.scenario.controller.torque_loop > 0.0 and np.count_nonzero(fast) >= _TURNS
    cause = "the torque loop is unstable" if unstable else "the motion asks for more than it gives"
    off, unit = float(np.max(np.abs(run.command_error))), MODES[run.scenario.mode]
    what = "motor" if run.scenario.mode == "torque" else "link"
    yield (
        f"the drive is at its limit of {limit:g} A for {100 * share:.2g} % of the time: {cause}, and the {what} is up to "
        f"{off:.2g} {unit} off its command"
    )


def _unused(run: Run) -> Iterator[str]:
    """Keys of the scenario that have no effect."""
    scenario, at = run.scenario, run.scenario.temperature
    coefficients = (joint.record()["friction_temperature"][0] for joint in (run.joint, run.known_joint))
    if (at.start, at.end) != (REFERENCE_TEMPERATURE,) * 2 and not any(coefficients):
        yield f"temperature acts on nothing: {run.joint.name} states no friction that depends on it"
    if scenario.locked_rotor and len({way.command for way in scenario.trajectory}) > 1:
        yield "trajectory acts on nothing: the rotor is locked"
    if isinstance(scenario.sensors, dict) and not any(name.startswith("force") for name in scenario.record):
        for name in {"wrench", "force"} & scenario.sensors.keys():
            yield f"sensors.{name} acts on nothing: the scenario records no force"


def _estimates(run: Run) -> Iterator[str]:
    """Estimates without metrics or trust, forces at the link, motion outside the range of validity."""
    for name, one in run.estimates.items():
        if one.untrusted is not None:
            yield f"{name} is not to be trusted: {one.untrusted}"
        count = int(np.sum(~np.isfinite(one.mean)))
        if count:
            yield f"{name} gives no estimate for {count} of {len(run.time)} samples and is not measured"
    if run.tip_force is not None:
        errors = sorted(run.tip_force.errors(run.reference.kept).items(), key=lambda item: item[1])
        lever = run.tip_force.lever
        where = "" if math.isnan(lever) else f"; by the wrench, it acts at {lever:.3f} m"
        yield f"force at the link, RMS error [N]: {', '.join(f'{name} {value:.2f}' for name, value in errors)}{where}"
    if run.beyond:
        yield beyond_sentence(run.beyond)


def run_scenario(scenario: Scenario, folder: Path | None = None, threads: int = 1) -> Run:
    """Run a scenario: the closed loop, then every filter over its signals. `folder`: of the scenario's file, to which
    the joint's path is relative; `threads`: filters at a time, the result does not depend on it.

    Raises:
      InputError: an unknown joint or mounting; torques with which the motion is no longer finite; a filter without its sensor.
      FilterDiverged: an estimate is no longer finite; names filter and time.
    """
    experiment = Experiment.of(scenario, folder)
    simulation = experiment.simulate()
    estimates = estimate(scenario.estimators(), signals_of(simulation), experiment.known, threads)
    return run_of(experiment, simulation, estimates)


def run_of(
    experiment: Experiment,
    simulation: Simulation,
    estimates: dict[str, Posterior] | None = None,
    place: Place | None = None,
) -> Run:
    """Return an experiment with its results as a run, by default without estimates."""
    return Run(
        experiment.scenario, experiment.joint, experiment.known_joint, experiment.known, simulation, estimates or {},
        experiment.command, experiment.external_torque, place,
    )  # fmt: skip


def simulate_scenario(scenario: Scenario, folder: Path | None, seed: int) -> Run:
    """Run a scenario with a seed and without its filters. Raises `InputError`: an estimate is fed back: the signals
    would depend on the filter."""
    if scenario.feedback not in ("none", "sensor"):
        raise InputError(
            f"scenario {scenario.name}: feedback: expected none or sensor, got {scenario.feedback!r}: the signals would "
            "depend on the filter"
        )
    scenario = scenario.model_copy(update={"seed": int(seed)})
    experiment = Experiment.of(scenario, folder)
    return run_of(experiment, experiment.simulate())
