"""The controller of a joint's drive: of position, velocity or torque, at control rate, on the measured motor angle.

The current controller, winding and supply are MuJoCo's `dcmotor` (R, L, back-EMF, voltage and current limits).
"""

from __future__ import annotations

import math
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field

from .files import Strict
from .kernels import kernel
from .parameters import floats

CONTROLLER = floats("kp", "kd", "ki", "filter", "limit", "gear", "torque_gain", "gravity", "delay", "mode", "feed")
"""The controller as one record for compiled code; `mode`: index in `MODES`; `feed`: current per commanded torque [A/(N·m)]."""

Mode = Literal["position", "velocity", "torque"]  # what the drive is commanded
MODES: dict[Mode, str] = {"position": "rad", "velocity": "rad/s", "torque": "N·m"}  # units of commands, output side


class Controller(Strict):
    """Controller: PD with optional integral on the measured motor angle, and joint torque feedback.

    `i = kp·e + kd·e' + ki·∫e dt + torque_feedback·T̂/(N·Kt)`, clipped at the motor's current limit, with e = N·q_d −
    θm. The measured velocity is the difference quotient of the encoder through a first-order low-pass. The integral
    stops while the current is clipped. `delay`: dead time of the drive, from the command to the winding.

    With a gain kT = `torque_loop` the estimate closes a torque loop instead, inside an impedance (Albu-Schäffer, Ott
    & Hirzinger, "A unified passivity-based control framework for position, torque and impedance control of flexible
    joint robots", IJRR 2007):

        u = N·Kt·(kp·e + kd·e') + gravity·Mg·sin(θm/N)        i = (u + kT·(u − T̂))/(N·Kt)

    The joint then has the torque u, with 1/(1 + kT) of the rotor's inertia and the friction. N²·Kt·kp is its
    stiffness [N·m/rad], N²·Kt·kd its damping [N·m·s/rad].

    This is position control. In velocity control `kp·∫e' dt + kd·e'` replaces the terms of e: the integral stops while
    the current is clipped, so no distance is caught up. In torque control the command replaces them, in N·m: N·Kt·i, or
    u of the torque loop. There the estimate is fed back through the torque loop only.
    """

    kp: Annotated[float, Field(ge=0, description="A/rad, motor side")] = 8.0
    kd: Annotated[float, Field(ge=0, description="A·s/rad, motor side")] = 0.08
    ki: Annotated[float, Field(ge=0, description="A/(rad·s), motor side")] = 0.0
    velocity_filter: Annotated[float, Field(ge=0, lt=1, description="time constant, s")] = 0.002
    torque_feedback: Annotated[float, Field(ge=0, le=1)] = 0.8
    """Share of the estimated torque that is fed back."""
    delay: Annotated[float, Field(ge=0, le=0.02, description="from the command to the winding, s")] = 0.0

    torque_loop: Annotated[float, Field(ge=0, le=1000, description="gain of the torque loop; 0: none")] = 0.0
    gravity: Annotated[float, Field(ge=0, le=1)] = 0.0
    """Share of the link's weight that the drive compensates."""

    def lagging(self, delay: float) -> Controller:
        """Return the controller for a drive with a delay [s]: lower gains with the same phase margin.

        The dead time, half a control period and the velocity's low-pass lag together. At the crossover, about
        Kt·kd/J, their phase stays the same if kd falls as they grow, and kp with its square.
        """
        own = 0.5e-3 + self.velocity_filter
        share = own / (own + delay)
        return self.model_copy(
            update={"kp": share**2 * self.kp, "kd": share * self.kd, "ki": share**3 * self.ki, "delay": delay}
        )

    def record(self, p: np.void, dt: float, feedback: bool, mode: Mode = "position") -> np.ndarray:
        """Return the controller for a joint's parameters and a control period [s], as a record, shape (1,)."""
        record = np.zeros(1, CONTROLLER)
        c = record[0]
        c["kp"], c["kd"], c["ki"] = self.kp, self.kd, self.ki
        c["filter"] = 1.0 - math.exp(-dt / self.velocity_filter) if self.velocity_filter > 0 else 1.0
        c["limit"], c["gear"] = p["current_limit"], p["N"]
        c["delay"] = self.delay
        unit = p["N"] * p["Kt"]
        c["mode"], c["feed"] = list(MODES).index(mode), 1.0 / unit
        c["torque_gain"] = self.torque_feedback / unit if feedback and mode != "torque" else 0.0
        c["gravity"] = self.gravity * p["Mg"] / unit
        if feedback and self.torque_loop > 0.0:
            for name in ("kp", "kd", "ki", "gravity", "feed"):
                c[name] *= 1.0 + self.torque_loop
            c["torque_gain"] = -self.torque_loop / unit
        return record


_VELOCITY, _TORQUE = (list(MODES).index(mode) for mode in ("velocity", "torque"))


@kernel
def control(command: float, rate: float, measured: float, torque: float, state: np.ndarray, dt: float, c: Any) -> float:
    """Return the current command [A].

    Args:
      command, rate: output side, in the unit of the controller's mode (`MODES`), and its derivative.
      measured: motor encoder [rad].
      torque: estimated joint torque [N·m] for the feedback.
      state: shape (3,), overwritten: last motor angle [rad], its filtered velocity [rad/s], integral [rad·s] (velocity
        control: [rad]).
      dt: control period [s]; c: `CONTROLLER` record.
    """
    state[1] += c.filter * ((measured - state[0]) / dt - state[1])
    state[0] = measured
    if c.mode == _TORQUE:
        integral, wanted = 0.0, c.feed * command
    elif c.mode == _VELOCITY:
        error = c.gear * command - state[1]
        integral = state[2] + error * dt
        wanted = c.kp * integral + c.kd * error
    else:
        error = c.gear * command - measured
        integral = state[2] + error * dt
        wanted = c.kp * error + c.kd * (c.gear * rate - state[1]) + c.ki * integral
    wanted += c.torque_gain * torque
    if c.gravity != 0.0:
        wanted += c.gravity * math.sin(measured / c.gear)
    if abs(wanted) <= c.limit:
        state[2] = integral
        return wanted
    return c.limit if wanted > 0.0 else -c.limit
