"""The closed loop, compiled: plant, sensors, one estimator and the drive at control rate, without Python.

Joints in series share the plant only: each has its own sensors, estimator and drive. One call runs a whole scenario
without the interpreter's lock, so that threads run scenarios in parallel. Only a fed-back estimator changes the
motion, so only that one is in the loop. It is called by its address, as all estimators have one signature
(`models.step`). The others run over the signals afterwards, with the same results to the bit.
"""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import NamedTuple

import mujoco
import numpy as np

from ..models import dynamics
from ..models.controller import control
from ..models.kernels import kernel
from ..models.parameters import REFERENCE_TEMPERATURE, floats
from ..models.pointers import call_estimator, call_step, floats_at, ints_at, word_at
from ..models.signals import READINGS, SENSED, WRENCH
from ..models.step import SAMPLE, CompiledStep
from . import native, plant
from .plugin import BRISTLE, DAHL, LINK, ROTOR, TEMPERATURE, WAVE_GENERATOR, instance, put_record, state_of
from .sensors import distort, low_pass, sample

CONTROL_PERIOD = 0.001  # period [s] of sensors, estimators and position controller

TRUTH = floats(
    "motor_position", "wave_generator_position", "link_position", "motor_velocity", "wave_generator_velocity", "link_velocity",
    "motor_current", "wave_generator_torque", "flexspline_torque", "joint_torque", "bristle", "dahl",
)  # fmt: skip
"""The true state at one instant, as a record."""

_NO_SENSORS = int(mujoco.mjtDisableBit.mjDSBL_SENSOR)
_READINGS_AT = len(SAMPLE.names or ()) - len(SENSED)  # place of the first reading in a `SAMPLE`
_WRENCH_AT = SENSED.index(WRENCH[0])
_JOINT_AXIS = SENSED.index("torque_y")


_FIELDS = ("qpos", "qvel", "act", "ctrl", "xfrc_applied", "xaxis", "sensordata", "plugin_state", "disableflags")
_PLACES = (
    "current", "memory", "force", "torque", "link_body", "link_joint", "rotor", "wave_generator", "link", "motor",
)  # fmt: skip
_ADDRESSES = np.dtype([(name, np.int64) for name in (*_FIELDS, *_PLACES)])
"""Addresses of a joint's data: fields in MuJoCo's structures (`native.offsets`), the current in `act` (−1: none),
`plant.memory` in the plugin state, sensors in `sensordata`, the numbers of the link's body and joint, the three
coordinates, the motor."""


@dataclass(frozen=True)
class Simulation:
    """Result of a closed-loop run; n control ticks."""

    time: np.ndarray  # shape (n,) [s]
    truth: np.ndarray  # shape (n,), records of `TRUTH`, SI
    readings: np.ndarray  # shape (n,), records of `signals.READINGS`, SI
    command: np.ndarray  # shape (n,), current command [A]
    failed: tuple[int, int]  # tick at which the estimator in the loop failed, and its status; (n, 0) if it did not
    stamps: np.ndarray | None = None  # shape (n,), time stamps of the readings [s]; `time` for an exact clock
    commanded: bool = True  # whether estimators may read the current command; otherwise they use the current sensor
    # readings of sensors of plugins (`models.own_sensors`), shape (n,) each
    further: Mapping[str, np.ndarray] = field(default_factory=dict)
    # torque of known payloads on the link, shape (n,) [N·m] (`models.arm.Load.on`); None without
    carried: np.ndarray | None = None


SENSOR_FEEDBACK = "sensor"  # feedback of the torque sensor's reading instead of an estimate


@dataclass(frozen=True)
class Driven:
    """A joint in the closed loop: its drive and sensors; n control ticks."""

    record: np.ndarray  # the plant's parameter record, shape (1,)
    # command, rate: of the drive, in the unit of the controller's mode (`controller.MODES`), and derivative, shape (n,)
    command: np.ndarray
    rate: np.ndarray
    external_torque: np.ndarray  # on the link [N·m], shape (n,)
    sensors: np.ndarray  # of `sim.sensors`
    noise: np.ndarray  # of `sim.sensors`
    controller: np.ndarray  # `models.controller.CONTROLLER` record, shape (1,)
    # the estimator in the torque feedback loop; `SENSOR_FEEDBACK`: the torque sensor; None: no feedback
    feedback: CompiledStep | str | None = None
    temperature: np.ndarray | None = None  # of the gear [°C], shape (n,); constant by default
    # tangential force on the link [N] that causes the external torque, shape (n,): the wrench shows it. By default the
    # external torque is a pure torque.
    tip_force: np.ndarray | None = None
    # of the wrench, shape (6, 6): shares of an axis' load in the others; none by default
    crosstalk: np.ndarray | None = None
    stamps: np.ndarray | None = None  # time stamps of the readings [s], shape (n,); exact by default
    commanded: bool = True  # whether estimators may read the current command (`models.step.CompiledStep.reads_command`)
    prefix: str = ""  # of its names in a model of several joints
    start: float | None = None  # of the link [rad]; the first command by default


@dataclass(frozen=True)
class Change:
    """Another plant from a tick on, after a payload was picked up or put down."""

    tick: int  # the first one
    model: mujoco.MjModel  # differs from the one before in numbers only
    record: np.ndarray | None = None  # parameters of the only joint, shape (1,); None: all joints' remain


class ClosedLoop:
    """Closed loops of a model's joints in progress: any number of ticks at a time, with the same results to the bit.
    The arrays of `simulations`, a joint each, fill up to `done` ticks."""

    def __init__(self, model: mujoco.MjModel, joints: Sequence[Driven], changes: Sequence[Change] = ()):
        """Start at rest; joints in the model's order, with as many ticks each. The model is not changed; a change of
        the plant at tick 0 is the plant from the start on."""
        self._changes = {change.tick: change for change in changes}
        records = [one.record for one in joints]
        if 0 in self._changes:
            model, record = self._changes[0].model, self._changes[0].record
            records = records if record is None else [record]
        substeps, timestep = round(CONTROL_PERIOD / model.opt.timestep), float(model.opt.timestep)
        model = copy.copy(model)
        given = _Given.of(joints, substeps * timestep)
        data = mujoco.MjData(model)
        for one, temperature in zip(joints, given.temperature, strict=True):
            plant.memory(model, data, one.prefix)[TEMPERATURE] = temperature[0]
        start = np.array([one.command[0] if one.start is None else one.start for one in joints])
        gear = np.array([one.record[0]["N"] for one in joints])
        plant.start(model, data, np.stack([start * gear, start * gear, start], axis=1))
        steps = [
            one.feedback
            if isinstance(one.feedback, CompiledStep)
            else CompiledStep(int(one.feedback == SENSOR_FEEDBACK), 1, one.record)
            for one in joints
        ]
        kept = [step.arrays() for step in steps]
        commanded = np.array([one.commanded and step.reads_command for one, step in zip(joints, steps, strict=True)])
        estimators = np.array([[address, *(x.ctypes.data for x in rest)] for address, *rest in kept], dtype=np.int64)
        sensors = np.stack([one.sensors for one in joints])
        controller = np.concatenate([one.controller for one in joints])
        drive = np.zeros((len(joints), 3))
        drive[:, 0] = controller["gear"] * start
        crosstalk = np.stack([np.zeros((6, 6)) if one.crosstalk is None else one.crosstalk for one in joints])
        self._alive = model, data, steps, kept  # keep alive: compiled code uses their addresses
        self._constant = (
            native.function_address("mj_step"), model._address, data._address,
            np.concatenate([_addresses(model, data, one.prefix) for one in joints]), substeps, timestep,
            np.concatenate(records), sensors, controller, estimators, commanded,
            np.zeros(sensors.shape), drive, given.stamps[:, 0].copy(), crosstalk,
        )  # fmt: skip
        self.done, n = 0, given.stamps.shape[1]
        many = (len(joints), n)
        readings = np.zeros(many, READINGS)
        took = _Took(
            np.zeros(many, TRUTH), readings, _as_floats(readings), np.zeros(many), np.zeros((*sensors.shape, n))
        )
        self._given, self._took = given, took
        self._failed = np.array([[n, 0]] * len(joints), dtype=np.int64)
        time = np.arange(n) * (substeps * timestep)
        self._simulations = tuple(
            Simulation(time, took.truth[i], took.readings[i], took.command[i], (n, 0), one.stamps, one.commanded)
            for i, one in enumerate(joints)
        )

    @property
    def simulations(self) -> tuple[Simulation, ...]:
        return tuple(
            replace(one, failed=(int(tick), int(status)))
            for one, (tick, status) in zip(self._simulations, self._failed, strict=True)
        )

    @property
    def simulation(self) -> Simulation:
        return self.simulations[0]

    def advance(self, ticks: int) -> slice:
        """Simulate up to `ticks` more ticks, and return them; none after an estimator in the loop has failed."""
        begin, n = self.done, len(self._simulations[0].time)
        if self._failed[:, 0].min() < n:
            return slice(begin, begin)
        end = min(begin + ticks, n)
        with native.quiet(), native.untimed():
            for first, last in pairwise([begin, *(k for k in sorted(self._changes) if begin < k < end), end]):
                if first in self._changes and first > 0:
                    self._change(self._changes[first])
                _loop(self._constant, self._given, self._took, self._failed, first, last)
                if self._failed[:, 0].min() < n:
                    break
        self.done = min(end, int(self._failed[:, 0].min()))
        return slice(begin, self.done)

    def _change(self, change: Change) -> None:
        """Go on with another model and the same state."""
        step, _, *others = self._constant
        self._constant = (step, change.model._address, *others)
        if change.record is not None:
            self._constant[6][:] = change.record
            put_record(self._alive[1], 0, change.record)


class _Given(NamedTuple):
    """Inputs of joints, by joint and tick, shape (joints, n), as in `Driven`; noise shape (joints, n, channels)."""

    command: np.ndarray
    rate: np.ndarray
    external: np.ndarray
    temperature: np.ndarray
    noise: np.ndarray
    tip_force: np.ndarray
    stamps: np.ndarray

    @classmethod
    def of(cls, joints: Sequence[Driven], step: float) -> _Given:
        """Collect the inputs; `step`: between ticks [s]."""
        n = len(joints[0].command)

        def stacked(name: str, default: float | np.ndarray = 0.0) -> np.ndarray:
            given = [default if (x := getattr(one, name)) is None else x for one in joints]
            return np.stack([np.broadcast_to(np.asarray(x, float), n) for x in given])

        return cls(
            stacked("command"), stacked("rate"), stacked("external_torque"), stacked("temperature", REFERENCE_TEMPERATURE),
            _as_floats(np.stack([np.ascontiguousarray(one.noise) for one in joints])), stacked("tip_force"),
            stacked("stamps", np.arange(n) * step),
        )  # fmt: skip


class _Took(NamedTuple):
    """Results of joints, by joint and tick, shape (joints, n). `seen`, shape (joints, channels, n): sensor inputs
    before delay, noise and quantisation; `reading_of`: `readings` as floats, shape (joints, n, channels)."""

    truth: np.ndarray
    readings: np.ndarray
    reading_of: np.ndarray
    command: np.ndarray
    seen: np.ndarray


def _addresses(model: mujoco.MjModel, data: mujoco.MjData, prefix: str) -> np.ndarray:
    at = np.zeros(1, _ADDRESSES)
    for name in _FIELDS:
        at[name] = native.offsets()[name]
    motor = model.actuator(prefix + "motor").id
    at["current"] = model.actuator_actadr[motor] if model.actuator_actnum[motor] else -1
    at["memory"] = model.plugin_stateadr[plant.instance(model, prefix)]
    at["force"], at["torque"] = (model.sensor(prefix + name).adr[0] for name in ("force", "torque"))
    at["link_body"] = model.site(prefix + "force_torque").bodyid[0]
    _, places = instance(data, plant.instance(model, prefix))[0]
    at["rotor"], at["wave_generator"], at["link"] = places  # in qpos and qvel: all joints are hinges
    at["link_joint"] = model.dof_jntid[places[LINK]]
    at["motor"] = model.actuator_ctrladr[motor]
    return at


def _as_floats(records: np.ndarray) -> np.ndarray:
    """Return a view of records of float64 fields, shape (joints, n), as shape (joints, n, fields)."""
    return records.view(np.float64).reshape(*records.shape, -1)


@kernel
def _read(s, k, dt, value, theta, raw, seen, noise_of, sensors):
    """Return the reading of sensor s at tick k of an ideal value; keep data for the next tick in `raw` and `seen`."""
    distorted = distort(value, theta[ROTOR], theta[LINK], sensors[s])
    seen[s, k] = low_pass(distorted, raw[s], seen[s, k - 1], sensors[s]) if k > 0 else distorted
    raw[s] = distorted
    return sample(seen[s], k, dt, noise_of[:, s], sensors[s])


@kernel
def _in_force(command, j, step, delay, substeps):
    """Return the current command [A] of joint j in force in a plant step, counted from the start; `delay`: of the
    drive, in steps."""
    k = (step - delay) // substeps
    return command[j, k] if k >= 0 else 0.0


@kernel
def _input(command, j, step, delay, substeps, Kt):
    """Return the commanded motor torque [N·m, motor side] of joint j in a plant step: of the mean command in it and
    the one before."""
    in_force = _in_force(command, j, step, delay, substeps)
    return Kt * 0.5 * (in_force + _in_force(command, j, step - 1, delay, substeps))


@kernel
def _loop(constant, drives, took, failed, begin, end):
    (
        step, model, data, addresses, substeps, h, record, sensors, controller, estimators, commanded, raw, drive, began,
        crosstalk,
    ) = constant  # fmt: skip
    asked, rate, external, temperature, noise_of, tip_force, stamps = drives
    truth, readings, reading_of, command, seen = took
    at = addresses[0]
    act = floats_at(word_at(data + 8 * at.act))
    ctrl = floats_at(word_at(data + 8 * at.ctrl))
    sensordata = floats_at(word_at(data + 8 * at.sensordata))
    qpos, qvel = floats_at(word_at(data + 8 * at.qpos)), floats_at(word_at(data + 8 * at.qvel))
    applied, axes = floats_at(word_at(data + 8 * at.xfrc_applied)), floats_at(word_at(data + 8 * at.xaxis))
    memory = floats_at(word_at(data + 8 * at.plugin_state))
    disabled = ints_at(model + 4 * at.disableflags)

    joints = len(asked)
    channels = sensors.shape[1]
    dt = substeps * h
    ideal = np.zeros(1, READINGS)
    ideal_of = ideal.view(np.float64)
    given = np.zeros(1, SAMPLE)
    given_of = given.view(np.float64)
    given_of[:] = np.nan
    # For the steps within a tick.
    delay, motor, Kt = np.zeros(joints, np.int64), np.zeros(joints, np.int64), np.zeros(joints)
    for j in range(joints):
        delay[j], motor[j], Kt[j] = round(controller[j].delay / h), addresses[j].motor, record[j].Kt
    theta, before, omega, current = np.zeros((joints, 3)), np.zeros((joints, 3)), np.zeros(3), np.zeros(joints)
    wrench = np.zeros(6)

    for k in range(begin, end):
        time = k * dt
        first = k * substeps
        for j in range(joints):
            p, at = record[j], addresses[j]
            # Views of arrays cost more than the arithmetic: make each once.
            angle, speed, raw_of = theta[j], before[j], raw[j]
            seen_of, sensor, its_noise = seen[j], sensors[j], noise_of[j]
            angle[ROTOR], angle[WAVE_GENERATOR], angle[LINK] = qpos[at.rotor], qpos[at.wave_generator], qpos[at.link]
            speed[ROTOR], speed[WAVE_GENERATOR], speed[LINK] = qvel[at.rotor], qvel[at.wave_generator], qvel[at.link]
            memory[at.memory + TEMPERATURE] = temperature[j, k]
            if at.current >= 0:
                current[j] = act[at.current]
            else:
                current[j] = _in_force(command, j, first - 1, delay[j], substeps)

            # The sensors that read the state itself, at this instant.
            bristle, dahl = memory[at.memory + BRISTLE], memory[at.memory + DAHL]
            state = state_of(angle, speed, bristle, dahl, current[j], time, temperature[j, k])
            dynamics.readings(state, dynamics.balance(state, p), p, ideal[0])
            for s in range(channels):
                if sensor[s].at_step == 0.0:
                    reading_of[j, k, s] = _read(s, k, dt, ideal_of[s], angle, raw_of, seen_of, its_noise, sensor)

            # The estimator and the drive.
            estimate = 0.0
            if estimators[j, 0] == 1:
                estimate = readings[j, k - 1].joint_torque if k > 0 else 0.0
            elif estimators[j, 0] != 0:
                # Differences of the time stamps, as in the signals afterwards.
                given[0].time = stamps[j, k] - began[j]
                given[0].interval = stamps[j, k] - stamps[j, k - 1] if k > 0 else 0.0
                given[0].current_command = np.nan
                if commanded[j]:
                    given[0].current_command = command[j, k - 1] if k > 0 else 0.0
                for s in range(channels):
                    if sensor[s].at_step == 0.0:
                        given_of[_READINGS_AT + s] = reading_of[j, k, s]
                step_at, memory_at, record_at, settings_at, out_at = estimators[j]
                status = call_estimator(step_at, memory_at, given.ctypes.data, record_at, settings_at, out_at)
                if status != 0:
                    failed[j, 0], failed[j, 1] = k, status
                    return
                estimate = floats_at(out_at)[0]
            command[j, k] = control(
                asked[j, k], rate[j, k], readings[j, k].motor_position, estimate, drive[j], dt, controller[j]
            )

            # The plant. The step that begins here spans the instant: half of it under the old input (plant.start).
            ctrl[motor[j]] = _input(command, j, first, delay[j], substeps, Kt[j])
            pushed = 0.5 * (external[j, k] + (external[j, k - 1] if k > 0 else 0.0))
            for s in range(3):
                applied[6 * at.link_body + 3 + s] = pushed * axes[3 * at.link_joint + s]
        call_step(step, model, data)
        for j in range(joints):
            p, at = record[j], addresses[j]
            angle, raw_of, seen_of, sensor, its_noise = theta[j], raw[j], seen[j], sensors[j], noise_of[j]
            omega[ROTOR] = 0.5 * (before[j, ROTOR] + qvel[at.rotor])
            omega[WAVE_GENERATOR] = 0.5 * (before[j, WAVE_GENERATOR] + qvel[at.wave_generator])
            omega[LINK] = 0.5 * (before[j, LINK] + qvel[at.link])
            bristle, dahl = memory[at.memory + BRISTLE], memory[at.memory + DAHL]
            state = state_of(angle, omega, bristle, dahl, current[j], time, temperature[j, k])
            b = dynamics.balance(state, p)
            t = truth[j, k]
            t.motor_position, t.motor_velocity = angle[ROTOR], omega[ROTOR]
            t.wave_generator_position, t.wave_generator_velocity = angle[WAVE_GENERATOR], omega[WAVE_GENERATOR]
            t.link_position, t.link_velocity = angle[LINK], omega[LINK]
            t.motor_current, t.bristle, t.dahl = current[j], state.bristle, dahl
            t.wave_generator_torque, t.flexspline_torque = b.wave_generator_torque, b.flexspline_torque
            t.joint_torque = b.joint_torque

            # The torque sensor and its wrench, which MuJoCo evaluates within the step.
            dynamics.readings(state, b, p, ideal[0])
            for axis in range(3):
                ideal_of[_WRENCH_AT + axis] = sensordata[at.force + axis]
                ideal_of[_WRENCH_AT + 3 + axis] = sensordata[at.torque + axis]
            # MuJoCo counts all torques on the link's coordinate as the joint's; cable and stop act on the link.
            ideal_of[_JOINT_AXIS] += dynamics.link_torque(state, b.load, p) - b.gravity
            # The external torque acts already; the joint also holds the tip force, in the sensor's plane along x.
            ideal_of[_WRENCH_AT] -= 0.5 * (tip_force[j, k] + (tip_force[j, k - 1] if k > 0 else 0.0))
            wrench[:] = ideal_of[_WRENCH_AT : _WRENCH_AT + 6]
            for axis in range(6):
                for other in range(6):
                    ideal_of[_WRENCH_AT + axis] += crosstalk[j, axis, other] * wrench[other]
            for s in range(channels):
                if sensor[s].at_step != 0.0:
                    reading_of[j, k, s] = _read(s, k, dt, ideal_of[s], angle, raw_of, seen_of, its_noise, sensor)
            for s in range(3):
                applied[6 * at.link_body + 3 + s] = external[j, k] * axes[3 * at.link_joint + s]

        # The other steps of the tick, without MuJoCo's sensors, which cost a tenth of a step.
        flags = disabled[0]
        disabled[0] = flags | _NO_SENSORS
        for s in range(1, substeps):
            for j in range(joints):
                ctrl[motor[j]] = _input(command, j, first + s, delay[j], substeps, Kt[j])
            call_step(step, model, data)
        disabled[0] = flags
