"""The closed loop, compiled: plant, sensors, estimators and drive at control rate, with no Python inside.

One call runs a whole scenario and releases the interpreter's lock, so that threads run scenarios side by side.
"""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
from numba import carray, njit

from ..estimator import FilterBank, compliance_torque, update_bank, workspace
from ..estimator.recursion import start, state_size
from ..models import laws
from ..models.parameters import PLACES
from ..sim import native, plant
from ..sim.callbacks import LINK, ROTOR, WAVE_GENERATOR, transmission
from ..sim.drive import control
from ..sim.sensors import NAMES, WRENCH, sample, sample_tick

CONTROL_PERIOD = 0.001
"""Period [s] of sensors, estimators and position controller."""

TRUTH = (
    "motor_position", "wave_generator_position", "link_position",
    "motor_velocity", "wave_generator_velocity", "link_velocity",
    "motor_current", "wave_generator_torque", "flexspline_torque", "joint_torque", "bristle",
)  # fmt: skip
"""Columns of the true state."""
_THETA, _OMEGA, _CURRENT, _TW, _TF, _TS, _BRISTLE = 0, 3, 6, 7, 8, 9, 10

READINGS = (*NAMES, *WRENCH)
"""Columns of what the sensors give."""
_PLACE_TORQUE, _PLACE_LINK, _PLACE_CURRENT, _PLACE_FLEXSPLINE, _PLACE_ON_LINK = (
    PLACES.index(name) for name in ("joint_torque", "link_position", "motor_current", "flexspline", "link")
)
_WRENCH_AXIS = WRENCH.index("torque_y")
"""The wrench's axis that is the joint's; positive torque about it drives the link back."""


@dataclass(frozen=True)
class Layout:
    """Where things lie in a model's state: addresses of activations and sensor data (−1: none)."""

    current: int
    bristle: int
    dahl: int
    force: int
    torque: int
    link_body: int

    @classmethod
    def of(cls, model: mujoco.MjModel) -> Layout:
        motor = model.actuator("motor").id
        has_dahl = any(model.actuator(i).name == "hysteresis" for i in range(model.nactuator))
        return cls(
            current=plant.activation(model, "motor") if model.actuator_actnum[motor] else -1,
            bristle=plant.activation(model, "mesh_friction"),
            dahl=plant.activation(model, "hysteresis") if has_dahl else -1,
            force=int(model.sensor("force").adr[0]),
            torque=int(model.sensor("torque").adr[0]),
            link_body=model.body("link").id,
        )

    def as_array(self) -> np.ndarray:
        """Shape (6,), for compiled code."""
        return np.array(
            [self.current, self.bristle, self.dahl, self.force, self.torque, self.link_body], dtype=np.int64
        )


@dataclass(frozen=True)
class Signals:
    """What a closed-loop run gives; n control ticks.

    Attributes:
      time: shape (n,) [s].
      truth: shape (n, len(TRUTH)), SI.
      readings: shape (n, len(READINGS)), SI.
      command: shape (n,), current command [A].
      model_torque: shape (n,), raw compliance model [N·m].
      filters: shape (n, F, S), the filters' flat states (`estimator.recursion`).
      failed: (filter, status, tick) of the first filter that failed, or (−1, 0, n).
    """

    time: np.ndarray
    truth: np.ndarray
    readings: np.ndarray
    command: np.ndarray
    model_torque: np.ndarray
    filters: np.ndarray
    failed: tuple[int, int, int]


def simulate(
    model: mujoco.MjModel,
    record: np.ndarray,
    calibration: np.ndarray,
    position: np.ndarray,
    velocity: np.ndarray,
    external_torque: np.ndarray,
    sensors: np.ndarray,
    noise: np.ndarray,
    controller: np.ndarray,
    bank: FilterBank,
    start_variance: np.ndarray,
    feedback: int = -1,
) -> Signals:
    """Run the closed loop from rest at the first commanded position.

    Args:
      model: of `sim.plant.build`.
      record: the plant's parameter record, shape (1,).
      calibration: the record that the estimators know, shape (1,).
      position, velocity, external_torque: commands [rad], [rad/s] and torque on the link [N·m], shape (n,).
      sensors, noise: of `sim.sensors`.
      controller: `sim.drive.CONTROLLER` record, shape (1,).
      bank: filters of one state and one measurement.
      start_variance: shape (F,), P(0) [(N·m)²].
      feedback: which filter's estimate closes the torque feedback loop; −1: none, −2: the torque sensor.
    """
    n = len(position)
    data = mujoco.MjData(model)
    begin = position[0]
    p = record[0]
    plant.start(model, data, np.array([begin * p["N"], begin * p["N"], begin]))
    layout = Layout.of(model)
    filters = np.zeros((n, bank.F.shape[0], state_size(1, 1)))
    truth = np.zeros((n, len(TRUTH)))
    readings = np.zeros((n, len(READINGS)))
    command, model_torque = np.zeros(n), np.zeros(n)
    failed = np.array([-1, 0, n], dtype=np.int64)
    substeps = round(CONTROL_PERIOD / model.opt.timestep)
    at = native.offsets()
    offsets = np.array([at[k] for k in ("qpos", "qvel", "act", "ctrl", "xfrc_applied", "sensordata")], dtype=np.int64)
    with native.quiet():
        _loop(
            native.function_address("mj_step"), model._address, data._address, offsets, layout.as_array(), substeps,
            float(model.opt.timestep), record, calibration, position, velocity, external_torque, sensors, noise,
            controller, bank, start_variance, feedback, truth, readings, command, model_torque, filters, failed,
        )  # fmt: skip
    time = np.arange(n) * CONTROL_PERIOD
    return Signals(time, truth, readings, command, model_torque, filters, tuple(int(x) for x in failed))


@njit(cache=True, nogil=True)
def _loop(
    step, model, data, offsets, layout, substeps, h, record, calibration, position, velocity, external, sensors, noise,
    controller, bank, start_variance, feedback, truth, readings, command, model_torque, filters, failed,
):  # fmt: skip
    p, known, c = record[0], calibration[0], controller[0]
    floats_at, word_at = native.floats_at, native.word_at
    q = carray(floats_at(word_at(data + 8 * offsets[0])), 3)
    v = carray(floats_at(word_at(data + 8 * offsets[1])), 3)
    act = floats_at(word_at(data + 8 * offsets[2]))
    ctrl = floats_at(word_at(data + 8 * offsets[3]))
    link_force = carray(floats_at(word_at(data + 8 * offsets[4]) + 48 * layout[5]), 6)
    sensordata = floats_at(word_at(data + 8 * offsets[5]))
    at_current, at_bristle, at_dahl, at_force, at_torque = layout[0], layout[1], layout[2], layout[3], layout[4]

    n, count = position.size, filters.shape[1]
    dt = substeps * h
    terms = laws.has_terms(p)
    # What the sensors see before delay, noise and quantisation, as histories.
    seen = np.zeros((4 + 6, n))
    states = np.zeros((count, filters.shape[2]))
    y = np.zeros((count, 1))
    work = workspace(1, 1)
    drive = np.zeros(3)
    drive[0] = c.gear * position[0]
    theta, before, omega = np.zeros(3), np.zeros(3), np.zeros(3)
    current_command, last_command, last_external, estimate = 0.0, 0.0, 0.0, 0.0

    for k in range(n):
        time = k * dt
        theta[:] = q
        before[:] = v
        current = act[at_current] if at_current >= 0 else last_command
        truth[k, _THETA : _THETA + 3] = theta
        truth[k, _CURRENT] = current

        # The encoders and the current, at this instant.
        seen[0, k] = theta[ROTOR]
        seen[1, k] = laws.link_reading(theta[LINK], p)
        seen[2, k] = laws.current_reading(current, p)
        if terms:
            load = truth[k - 1, _TF] if k > 0 else 0.0
            seen[1, k] += laws.term(_PLACE_LINK, theta[ROTOR], theta[LINK], before[1], load, time, p)
            seen[2, k] += laws.term(_PLACE_CURRENT, theta[ROTOR], theta[LINK], before[1], load, time, p)
        for s in range(3):
            readings[k, s] = sample(seen[s], k, dt, noise[s], sensors[s])

        # The estimators: measurement, Eq. (7), with the torque command in force until now for Tw.
        y_now = compliance_torque(readings[k, 0], readings[k, 1], known.Kt * last_command, known)
        model_torque[k] = y_now
        for f in range(count):
            y[f, 0] = y_now
            if k == 0:
                start(states[f], y[f], start_variance[f] * np.eye(1), bank.H[f], bank.V[f])
        if k > 0 and count > 0 and failed[0] < 0:
            which, why = update_bank(states, y, bank, work)
            if which >= 0:
                failed[0], failed[1], failed[2] = which, why, k
        filters[k] = states
        if failed[0] >= 0:
            return

        # The drive.
        if feedback >= 0:
            estimate = states[feedback, 0]
        elif feedback == -2 and k > 0:
            estimate = readings[k - 1, 3]
        current_command = control(position[k], velocity[k], readings[k, 0], estimate, drive, dt, c)
        command[k] = current_command

        # The plant. The step that begins here spans the instant: half of it under the old input (plant.start).
        ctrl[0] = p.Kt * 0.5 * (current_command + last_command)
        link_force[4] = -0.5 * (external[k] + last_external)
        native.call_step(step, model, data)
        for s in range(3):
            omega[s] = 0.5 * (before[s] + v[s])
        bristle = act[at_bristle]
        dahl = act[at_dahl] if at_dahl >= 0 else 0.0
        Tw, Tf, _, _ = transmission(theta, omega, dahl, p)
        Tw += p.dw * (omega[ROTOR] - omega[WAVE_GENERATOR])
        if terms:
            Tf += laws.term(_PLACE_FLEXSPLINE, theta[ROTOR], theta[LINK], omega[1], Tf, time, p)
        Ts = Tf - p.bl * omega[LINK]
        truth[k, _OMEGA : _OMEGA + 3] = omega
        truth[k, _TW], truth[k, _TF], truth[k, _TS], truth[k, _BRISTLE] = Tw, Tf, Ts, bristle

        # The torque sensor and its wrench, which MuJoCo evaluates within the step.
        seen[3, k] = laws.torque_reading(Ts, time, p)
        if terms:
            seen[3, k] += laws.term(_PLACE_TORQUE, theta[ROTOR], theta[LINK], omega[1], Tf, time, p)
        readings[k, 3] = sample(seen[3], k, dt, noise[3], sensors[3])
        for axis in range(6):
            value = sensordata[at_force + axis] if axis < 3 else sensordata[at_torque + axis - 3]
            if axis == _WRENCH_AXIS:
                # MuJoCo takes all that acts on the link's coordinate for the joint's; cable and stop act on the link.
                value += laws.link_torque(theta[LINK], p)
                if terms:
                    value += laws.term(_PLACE_ON_LINK, theta[ROTOR], theta[LINK], omega[1], Tf, time, p)
            seen[4 + axis, k] = value
            readings[k, 4 + axis] = _wrench(seen[4 + axis], k, dt, noise[4 + axis], sensors[4], axis)

        ctrl[0] = p.Kt * current_command
        link_force[4] = -external[k]
        for _ in range(1, substeps):
            native.call_step(step, model, data)
        last_command, last_external = current_command, external[k]


@njit(cache=True, nogil=True)
def _wrench(history, k, dt, noise, sensor, axis):
    """A wrench axis: the record holds the noise of forces in `noise`, of torques in `step`; nothing is quantised."""
    rms = sensor.noise if axis < 3 else sensor.step
    t = sample_tick(k, dt, sensor)
    back = max(t - round(sensor.delay / dt), 0)
    return history[back] + rms * noise[t]
