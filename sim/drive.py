"""The drive: a current-controlled motor under a controller at control rate, on the measured motor angle.

The current controller, winding and supply are MuJoCo's `dcmotor` (R, L, back-EMF, voltage and current limits).
"""

from __future__ import annotations

import math

from ..models.controller import MODES
from ..models.kernels import kernel

_VELOCITY, _TORQUE = (list(MODES).index(mode) for mode in ("velocity", "torque"))


@kernel
def control(command, rate, measured, torque, state, dt, c):
    """Return the current command [A].

    Args:
      command, rate: output side, in the unit of the controller's mode (`controller.MODES`), and its derivative.
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
