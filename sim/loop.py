"""The closed loop, compiled: plant, sensors, one estimator and the drive at control rate, with no Python inside.

One call runs a whole scenario, or a stretch of it, and releases the interpreter's lock, so that threads run scenarios side by
side. Only an
estimator whose torque is fed back changes what happens, so only that one is in here; it is called by its address, as all
estimators share one signature (`models.step`). Every other one runs over the signals afterwards, and says to the bit what
it would have said in the loop.
"""

from __future__ import annotations

import copy
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import mujoco
import numpy as np
from numba import carray

from ..models import dynamics
from ..models.kernels import kernel
from ..models.parameters import REFERENCE_TEMPERATURE
from ..models.pointers import call_estimator, call_step, floats_at, ints_at, word_at
from ..models.signals import READINGS, SENSED, WRENCH
from ..models.step import SAMPLE, CompiledStep
from . import native, plant
from .callbacks import LINK, ROTOR, TEMPERATURE, WAVE_GENERATOR, state_of
from .drive import control
from .sensors import distort, low_pass, sample

CONTROL_PERIOD = 0.001
"""Period [s] of sensors, estimators and position controller."""

TRUTH = np.dtype(
    [
        (name, np.float64)
        for name in (
            "motor_position", "wave_generator_position", "link_position",
            "motor_velocity", "wave_generator_velocity", "link_velocity",
            "motor_current", "wave_generator_torque", "flexspline_torque", "joint_torque", "bristle", "dahl",
        )
    ]
)  # fmt: skip
"""The true state at one instant, as a record."""

_NO_SENSORS = int(mujoco.mjtDisableBit.mjDSBL_SENSOR)
_READINGS_AT = len(SAMPLE.names or ()) - len(SENSED)  # place of the first reading in a `SAMPLE`
_WRENCH_AT = SENSED.index(WRENCH[0])
_JOINT_AXIS = SENSED.index("torque_y")


_FIELDS = ("qpos", "qvel", "act", "ctrl", "xfrc_applied", "sensordata", "disableflags")
_ADDRESSES = np.dtype(
    [(name, np.int64) for name in (*_FIELDS, "current", "bristle", "dahl", "force", "torque", "link_body")]
)
"""Where things lie: fields in MuJoCo's structures (`native.offsets`), activations in `act`, sensors in `sensordata` (−1: there is
none), the number of the link's body."""


_CARRIED = np.dtype(
    [("drive", np.float64, 3), *((name, np.float64) for name in ("command", "external", "force", "estimate"))]
)
"""What the loop takes from one tick to the next, beside what MuJoCo, the estimator and the sensors remember."""


@dataclass(frozen=True)
class Simulation:
    """What a closed-loop run gives; n control ticks.

    Attributes:
      time: shape (n,) [s].
      truth: shape (n,), records of `TRUTH`, SI.
      readings: shape (n,), records of `signals.READINGS`, SI.
      command: shape (n,), current command [A].
      failed: tick at which the estimator in the loop failed, and its status; (n, 0) where it did not.
      stamps: shape (n,), time stamps of the readings [s]; `time` where the clock is exact.
      commanded: whether estimators that read the current command are told it; otherwise they, too, have the current sensor alone.
      further: what sensors of plugins read (`models.own_sensors`), shape (n,) each.
    """

    time: np.ndarray
    truth: np.ndarray
    readings: np.ndarray
    command: np.ndarray
    failed: tuple[int, int]
    stamps: np.ndarray | None = None
    commanded: bool = True
    further: Mapping[str, np.ndarray] = field(default_factory=dict)


SENSOR_FEEDBACK = "sensor"
"""Stands for an estimator where the torque sensor's own reading is fed back."""


def simulate(
    model: mujoco.MjModel,
    record: np.ndarray,
    position: np.ndarray,
    velocity: np.ndarray,
    external_torque: np.ndarray,
    sensors: np.ndarray,
    noise: np.ndarray,
    controller: np.ndarray,
    feedback: CompiledStep | str | None = None,
    temperature: np.ndarray | None = None,
    tip_force: np.ndarray | None = None,
    crosstalk: np.ndarray | None = None,
    stamps: np.ndarray | None = None,
    commanded: bool = True,
) -> Simulation:
    """Run the closed loop from rest at the first commanded position.

    Args:
      model: of `plant.build`; left as it is.
      record: the plant's parameter record, shape (1,).
      position, velocity, external_torque: commands [rad], [rad/s] and torque on the link [N·m], shape (n,).
      sensors, noise: of `sim.sensors`.
      controller: `drive.CONTROLLER` record, shape (1,).
      feedback: the estimator that closes the torque feedback loop; `SENSOR_FEEDBACK`: the torque sensor; None: none.
      temperature: of the gear [°C], shape (n,); constant by default.
      tip_force: tangential force on the link [N] that the external torque comes from, shape (n,): the wrench shows it. By default
        the external torque is a torque alone.
      crosstalk: of the wrench, shape (6, 6): what of its axes' loads shows in the others; none by default.
      stamps: time stamps of the readings [s], shape (n,); exact by default.
      commanded: whether the current command is told to estimators that read it (`models.step.CompiledStep.reads_command`).
    """
    loop = ClosedLoop(
        model, record, position, velocity, external_torque, sensors, noise, controller, feedback, temperature, tip_force,
        crosstalk, stamps, commanded,
    )  # fmt: skip
    loop.advance(len(position))
    return loop.simulation


class ClosedLoop:
    """A closed loop under way: as many ticks at a time as one likes, to the bit the same in any pieces.

    Attributes:
      simulation: its arrays fill up as the loop goes on.
      done: ticks that have been simulated.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        record: np.ndarray,
        position: np.ndarray,
        velocity: np.ndarray,
        external_torque: np.ndarray,
        sensors: np.ndarray,
        noise: np.ndarray,
        controller: np.ndarray,
        feedback: CompiledStep | str | None = None,
        temperature: np.ndarray | None = None,
        tip_force: np.ndarray | None = None,
        crosstalk: np.ndarray | None = None,
        stamps: np.ndarray | None = None,
        commanded: bool = True,
    ):
        """Stand at rest at the first commanded position; arguments as of `simulate`."""
        n = len(position)
        if temperature is None:
            temperature = np.full(n, REFERENCE_TEMPERATURE)
        model = copy.copy(model)
        plant.set_temperature(model, float(temperature[0]))
        data = mujoco.MjData(model)
        begin = position[0]
        p = record[0]
        plant.start(model, data, np.array([begin * p["N"], begin * p["N"], begin]))
        tip_force = np.zeros(n) if tip_force is None else tip_force
        crosstalk = np.zeros((6, 6)) if crosstalk is None else crosstalk
        substeps = round(CONTROL_PERIOD / model.opt.timestep)
        timestep = float(model.opt.timestep)
        time = np.arange(n) * (substeps * timestep)
        told = np.ascontiguousarray(time if stamps is None else stamps, dtype=np.float64)
        truth, readings, command = np.zeros(n, TRUTH), np.zeros(n, READINGS), np.zeros(n)
        self._failed = np.array([n, 0], dtype=np.int64)
        if not isinstance(feedback, CompiledStep):
            feedback = CompiledStep(int(feedback == SENSOR_FEEDBACK), 1, record)
        address, memory, known, settings, out = feedback.arrays()
        carried = np.zeros(1, _CARRIED)
        carried[0]["drive"][0] = float(controller[0]["gear"]) * begin
        # What the sensors see before delay, noise and quantisation, as histories; before their low-pass, a tick ago.
        seen, raw = np.zeros((len(sensors), n)), np.zeros(len(sensors))
        self._alive = model, data, feedback  # whose memory compiled code reads by address
        self._arguments = (
            native.function_address("mj_step"), model._address, data._address, _addresses(model),
            model.numeric_data, substeps, timestep, record, position, velocity, external_torque,
            temperature, sensors, noise, _as_floats(noise), controller, address, memory, known, settings, out, truth,
            readings, _as_floats(readings), command, self._failed, tip_force, crosstalk, told,
            commanded and feedback.reads_command, seen, raw, carried,
        )  # fmt: skip
        self.done = 0
        self._simulation = Simulation(time, truth, readings, command, (n, 0), stamps, commanded)

    @property
    def simulation(self) -> Simulation:
        return replace(self._simulation, failed=(int(self._failed[0]), int(self._failed[1])))

    def advance(self, ticks: int) -> slice:
        """Simulate so many more ticks, or those that are left; nothing more once the estimator in the loop has failed.

        Returns:
          The ticks that are new.
        """
        begin, n = self.done, len(self._simulation.time)
        if self._failed[0] < n:
            return slice(begin, begin)
        end = min(begin + ticks, n)
        with native.quiet(), native.untimed():
            _loop(*self._arguments, begin, end)
        self.done = min(end, int(self._failed[0]))
        return slice(begin, self.done)


def _addresses(model: mujoco.MjModel) -> np.ndarray:
    """A record of `_ADDRESSES`, shape (1,)."""
    at = np.zeros(1, _ADDRESSES)
    for name in _FIELDS:
        at[name] = native.offsets()[name]
    has_current = model.actuator_actnum[model.actuator("motor").id]
    has_dahl = any(model.actuator(i).name == "hysteresis" for i in range(model.nactuator))
    at["current"] = plant.activation(model, "motor") if has_current else -1
    at["bristle"] = plant.activation(model, "mesh_friction")
    at["dahl"] = plant.activation(model, "hysteresis") if has_dahl else -1
    at["force"], at["torque"] = (model.sensor(name).adr[0] for name in ("force", "torque"))
    at["link_body"] = model.body("link").id
    return at


def _as_floats(records: np.ndarray) -> np.ndarray:
    """Records of float64 fields as a matrix, shape (n, fields); a view."""
    return records.view(np.float64).reshape(len(records), -1)


@kernel
def _read(s, k, dt, value, theta, raw, seen, noise_of, sensors):
    """What sensor s gives at tick k of an ideal value; keeps what it needs for the next tick in `raw` and `seen`."""
    distorted = distort(value, theta[ROTOR], theta[LINK], sensors[s])
    seen[s, k] = low_pass(distorted, raw[s], seen[s, k - 1], sensors[s]) if k > 0 else distorted
    raw[s] = distorted
    return sample(seen[s], k, dt, noise_of[:, s], sensors[s])


@kernel
def _in_force(command, step, delay, substeps):
    """The current command [A] in force in a plant step, counted from the start; `delay`: of the drive, in plant steps."""
    k = (step - delay) // substeps
    return command[k] if k >= 0 else 0.0


@kernel
def _loop(
    step, model, data, addresses, numeric, substeps, h, record, position, velocity, external, temperature,
    sensors, noise, noise_of, controller, estimator, memory, known, settings, out, truth, readings, reading_of,
    command, failed, tip_force, crosstalk, stamps, commanded, seen, raw, carried, begin, end,
):  # fmt: skip
    p, c, at = record[0], controller[0], addresses[0]
    delay = round(c.delay / h)
    q = carray(floats_at(word_at(data + 8 * at.qpos)), 3)
    v = carray(floats_at(word_at(data + 8 * at.qvel)), 3)
    act = floats_at(word_at(data + 8 * at.act))
    ctrl = floats_at(word_at(data + 8 * at.ctrl))
    link_force = carray(floats_at(word_at(data + 8 * at.xfrc_applied) + 48 * at.link_body), 6)
    sensordata = floats_at(word_at(data + 8 * at.sensordata))
    disabled = ints_at(model + 4 * at.disableflags)

    channels = len(sensors)
    dt = substeps * h
    ideal = np.zeros(1, READINGS)
    ideal_of = ideal.view(np.float64)
    given = np.zeros(1, SAMPLE)
    given_of = given.view(np.float64)
    given_of[:] = np.nan
    drive = carried[0].drive
    theta, before, omega = np.zeros(3), np.zeros(3), np.zeros(3)
    last_command, last_external = carried[0].command, carried[0].external
    last_force, estimate = carried[0].force, carried[0].estimate
    wrench = np.zeros(6)

    for k in range(begin, end):
        time = k * dt
        theta[:] = q
        before[:] = v
        numeric[TEMPERATURE] = temperature[k]
        current = act[at.current] if at.current >= 0 else _in_force(command, k * substeps - 1, delay, substeps)
        dahl = act[at.dahl] if at.dahl >= 0 else 0.0

        # The sensors that read the state itself, at this instant.
        state = state_of(theta, before, act[at.bristle], dahl, current, time, temperature[k])
        dynamics.readings(state, dynamics.balance(state, p), p, ideal[0])
        for s in range(channels):
            if sensors[s].at_step == 0.0:
                reading_of[k, s] = _read(s, k, dt, ideal_of[s], theta, raw, seen, noise_of, sensors)

        # The estimator and the drive.
        if estimator == 1:
            estimate = readings[k - 1].joint_torque if k > 0 else 0.0
        elif estimator != 0:
            # As differences of the time stamps, which is what whoever reads the signals afterwards has.
            given[0].time = stamps[k] - stamps[0]
            given[0].interval = stamps[k] - stamps[k - 1] if k > 0 else 0.0
            given[0].current_command = last_command if commanded else np.nan
            for s in range(channels):
                if sensors[s].at_step == 0.0:
                    given_of[_READINGS_AT + s] = reading_of[k, s]
            status = call_estimator(
                estimator,
                memory.ctypes.data,
                given.ctypes.data,
                known.ctypes.data,
                settings.ctypes.data,
                out.ctypes.data,
            )
            if status != 0:
                failed[0], failed[1] = k, status
                return
            estimate = out[0]
        command[k] = control(position[k], velocity[k], readings[k].motor_position, estimate, drive, dt, c)

        # The plant. The step that begins here spans the instant: half of it under the old input (plant.start).
        first = k * substeps
        in_force = _in_force(command, first, delay, substeps)
        ctrl[0] = p.Kt * 0.5 * (in_force + _in_force(command, first - 1, delay, substeps))
        link_force[4] = -0.5 * (external[k] + last_external)
        call_step(step, model, data)
        for s in range(3):
            omega[s] = 0.5 * (before[s] + v[s])
        dahl = act[at.dahl] if at.dahl >= 0 else 0.0
        state = state_of(theta, omega, act[at.bristle], dahl, current, time, temperature[k])
        b = dynamics.balance(state, p)
        t = truth[k]
        t.motor_position, t.wave_generator_position, t.link_position = theta[ROTOR], theta[WAVE_GENERATOR], theta[LINK]
        t.motor_velocity, t.wave_generator_velocity, t.link_velocity = omega[ROTOR], omega[WAVE_GENERATOR], omega[LINK]
        t.motor_current, t.bristle, t.dahl = current, state.bristle, dahl
        t.wave_generator_torque, t.flexspline_torque, t.joint_torque = (
            b.wave_generator_torque,
            b.flexspline_torque,
            b.joint_torque,
        )

        # The torque sensor and its wrench, which MuJoCo evaluates within the step.
        dynamics.readings(state, b, p, ideal[0])
        for axis in range(3):
            ideal_of[_WRENCH_AT + axis] = sensordata[at.force + axis]
            ideal_of[_WRENCH_AT + 3 + axis] = sensordata[at.torque + axis]
        # MuJoCo takes all that acts on the link's coordinate for the joint's; cable and stop act on the link.
        ideal_of[_JOINT_AXIS] += dynamics.link_torque(state, b.load, p) - b.gravity
        # Its torque acts already; a force at a point in the sensor's plane is what the joint must hold against, along x.
        ideal_of[_WRENCH_AT] -= 0.5 * (tip_force[k] + last_force)
        wrench[:] = ideal_of[_WRENCH_AT : _WRENCH_AT + 6]
        for axis in range(6):
            for other in range(6):
                ideal_of[_WRENCH_AT + axis] += crosstalk[axis, other] * wrench[other]
        for s in range(channels):
            if sensors[s].at_step != 0.0:
                reading_of[k, s] = _read(s, k, dt, ideal_of[s], theta, raw, seen, noise_of, sensors)

        # The other steps of the tick, whose sensors nobody reads: they are a tenth of a step.
        link_force[4] = -external[k]
        flags = disabled[0]
        disabled[0] = flags | _NO_SENSORS
        for s in range(1, substeps):
            before_it, in_force = in_force, _in_force(command, first + s, delay, substeps)
            ctrl[0] = p.Kt * 0.5 * (in_force + before_it)
            call_step(step, model, data)
        disabled[0] = flags
        last_command, last_external, last_force = command[k], external[k], tip_force[k]
    carried[0].command, carried[0].external = last_command, last_external
    carried[0].force, carried[0].estimate = last_force, estimate
