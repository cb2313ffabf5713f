"""The drive: a current-controlled motor under a position controller at control rate, on the measured motor angle.

The current controller, winding and supply are MuJoCo's `dcmotor` (R, L, back-EMF, voltage and current limits).
"""

from __future__ import annotations

import math

from ..models.kernels import kernel


@kernel
def control(position, velocity, measured, torque, state, dt, c):
    """Return the current command [A].

    Args:
      position, velocity: commands [rad], [rad/s], output side.
      measured: motor encoder [rad].
      torque: estimated joint torque [N·m] for the feedback.
      state: shape (3,), overwritten: last motor angle [rad], its filtered velocity [rad/s], integral [rad·s].
      dt: control period [s]; c: `CONTROLLER` record.
    """
    state[1] += c.filter * ((measured - state[0]) / dt - state[1])
    state[0] = measured
    error = c.gear * position - measured
    integral = state[2] + error * dt
    wanted = c.kp * error + c.kd * (c.gear * velocity - state[1]) + c.ki * integral + c.torque_gain * torque
    if c.gravity != 0.0:
        wanted += c.gravity * math.sin(measured / c.gear)
    if abs(wanted) <= c.limit:
        state[2] = integral
        return wanted
    return c.limit if wanted > 0.0 else -c.limit
