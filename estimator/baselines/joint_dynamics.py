"""The joint as a stochastic state-space model, for the estimators that know its dynamics. Compiled.

State x, shape (SIZE,):

    θm, ωm    rotor                          [rad], [rad/s], motor side
    θw, ωw    wave generator                 [rad], [rad/s], motor side
    z         LuGre bristle                  [rad], motor side
    θl, ωl    link                           [rad], [rad/s]
    τext      external torque on the link    [N·m], random walk
    d         what mesh friction and motor torque do beyond the record [N·m, motor side], Ornstein-Uhlenbeck
    x_h       Dahl state of the flexspline's hysteresis [rad]; carried only where the record has hysteresis

The laws are those of `models.laws`. Between samples the current follows its command with the winding's time constant
L/R. One step is Strang's splitting: the stiff bristle and the Dahl state by their exact solutions at constant
velocity for half a substep, the mechanics by the classical Runge-Kutta method for a whole one, the bristle again.
Substeps are chosen so that the fastest spring turns by no more than 0.8 rad in each.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from ...models import laws
from ...models.parameters import PLACES

STATES = (
    "motor_position", "motor_velocity", "wave_generator_position", "wave_generator_velocity", "bristle",
    "link_position", "link_velocity", "external_torque", "mesh_torque", "stiffness", "motor_constant", "hysteresis",
)  # fmt: skip
SIZE = len(STATES)
MOTOR, MOTOR_RATE, WAVE, WAVE_RATE, BRISTLE, LINK, LINK_RATE, EXTERNAL, MESH, STIFFNESS, CONSTANT, DAHL = range(SIZE)
_LONGEST = 0.5e-3  # s: substep
_TURN = 0.8  # rad of the fastest mode per substep
_PLACE_ROTOR, _PLACE_MESH, _PLACE_FLEXSPLINE, _PLACE_LINK, _PLACE_TORQUE, _PLACE_READING = (
    PLACES.index(name) for name in ("rotor", "mesh", "flexspline", "link", "joint_torque", "link_position")
)


@njit(cache=True, nogil=True, error_model="numpy")
def flexspline_torque(x, p):
    """Return Tf [N·m] with damping and hysteresis, without nonparametric terms; and 1/N − θerr'(θw)."""
    slope = 1.0 / p.N - laws.kinematic_error_slope(x[WAVE], p)
    torsion = x[WAVE] / p.N - x[LINK] - laws.kinematic_error(x[WAVE], p)
    rate = x[WAVE_RATE] * slope - x[LINK_RATE]
    return laws.flexspline_spring((1.0 + x[STIFFNESS]) * torsion, p) + p.df * rate + laws.hysteresis_torque(x[DAHL], p), slope


@njit(cache=True, nogil=True, error_model="numpy")
def joint_torque(x, time, p):
    """Return the joint torque as the force/torque sensor reads it [N·m] at a state: gain and offset of Tf − bl·ωl."""
    torque, _ = flexspline_torque(x, p)
    if laws.has_terms(p):
        torque += laws.term(_PLACE_FLEXSPLINE, x[MOTOR], x[LINK], x[WAVE_RATE], torque, time, p)
        return laws.torque_reading(torque - p.bl * x[LINK_RATE], time, p) + laws.term(
            _PLACE_TORQUE, x[MOTOR], x[LINK], x[WAVE_RATE], torque, time, p
        )
    return laws.torque_reading(torque - p.bl * x[LINK_RATE], time, p)


@njit(cache=True, nogil=True, error_model="numpy")
def link_encoder(x, time, p):
    """Return what the link encoder reads [rad] at a state, its delay to first order."""
    reading = laws.link_reading(x[LINK] - p.link_delay * x[LINK_RATE], p)
    if laws.has_terms(p):
        reading += laws.term(_PLACE_READING, x[MOTOR], x[LINK], x[WAVE_RATE], 0.0, time, p)
    return reading


@njit(cache=True, nogil=True, error_model="numpy")
def rates(x, current, time, p, out):
    """Write the rates of the six mechanical states into `out`, shape (SIZE,); the others' are zero here."""
    Tf, slope = flexspline_torque(x, p)
    w = x[WAVE_RATE]
    Tw = laws.wave_generator_spring(x[MOTOR] - x[WAVE], p) + p.dw * (x[MOTOR_RATE] - w)
    g = laws.friction_level(w, x[LINK], Tf, time, p)
    rotor = p.Kt * (1.0 + x[CONSTANT]) * current - p.bm * x[MOTOR_RATE] + laws.rotor_torque(x[MOTOR], p) - Tw
    mesh = Tw - laws.mesh_friction(x[BRISTLE], w, g, p) - p.bw * w + x[MESH]
    link = laws.gravity_torque(x[LINK], p) + laws.link_torque(x[LINK], p) + x[EXTERNAL] - p.bl * x[LINK_RATE]
    if laws.has_terms(p):
        load = Tf
        Tf += laws.term(_PLACE_FLEXSPLINE, x[MOTOR], x[LINK], w, load, time, p)
        rotor += laws.term(_PLACE_ROTOR, x[MOTOR], x[LINK], w, load, time, p)
        mesh -= laws.term(_PLACE_MESH, x[MOTOR], x[LINK], w, load, time, p)
        link += laws.term(_PLACE_LINK, x[MOTOR], x[LINK], w, load, time, p)
    out[MOTOR], out[MOTOR_RATE] = x[MOTOR_RATE], rotor / p.Jm
    out[WAVE], out[WAVE_RATE] = w, (mesh - Tf * slope) / p.Jw
    out[LINK], out[LINK_RATE] = x[LINK_RATE], (Tf + link) / p.Jl


@njit(cache=True, nogil=True, error_model="numpy")
def _relax(x, h, time, p):
    """Bristle and Dahl state over `h` [s] at constant velocity: exact."""
    Tf, slope = 0.0, 0.0
    if p.friction_load != 0.0 or p.hysteresis_torque != 0.0:
        Tf, slope = flexspline_torque(x, p)
    if p.hysteresis_torque != 0.0:
        x[DAHL] = laws.dahl_step(x[DAHL], x[WAVE_RATE] * slope - x[LINK_RATE], h, p)
    g = laws.friction_level(x[WAVE_RATE], x[LINK], Tf, time, p)
    x[BRISTLE] = laws.bristle_step(x[BRISTLE], x[WAVE_RATE], g, h, p)


@njit(cache=True, nogil=True, error_model="numpy")
def substeps(x, dt, p):
    """Return how many substeps a time `dt` [s] takes: the fastest mode of the springs at their present stiffness."""
    Tw = abs(laws.wave_generator_spring(x[MOTOR] - x[WAVE], p))
    stiffness = p.Kw0 * math.exp(min(p.Cw * Tw, 12.0))  # dTw/dδ of Eq. (3)
    fastest = max(stiffness * (1.0 / p.Jm + 1.0 / p.Jw), p.K3 * (1.0 / p.Jl + 1.0 / (p.N * p.N * p.Jw)))
    return max(1, int(math.ceil(dt * max(1.0 / _LONGEST, math.sqrt(fastest) / _TURN) - 1e-9)))


@njit(cache=True, nogil=True, error_model="numpy")
def advance(x, current, command, time, dt, steps, forget, p, work):
    """Advance a state by `dt` [s], in place.

    Args:
        x: Shape (SIZE,).
        current, command: motor current at the start, and the command in force [A].
        time: at the start [s].
        steps: substeps.
        forget: factor by which d decays in `dt`.
        work: Shape (5, SIZE), scratch; zero in columns EXTERNAL, MESH, BRISTLE, DAHL of the rates.
    """
    h = dt / steps
    decay = math.exp(-0.5 * h * p.R / p.L) if p.L > 0.0 else 0.0
    i0 = current
    for s in range(steps):
        t = time + s * h
        _relax(x, 0.5 * h, t, p)
        i1 = command + (i0 - command) * decay
        i2 = command + (i1 - command) * decay
        y = work[4]
        rates(x, i0, t, p, work[0])
        for j in range(7):
            y[j] = x[j] + 0.5 * h * work[0, j]
        for j in range(7, SIZE):
            y[j] = x[j]
        y[BRISTLE] = x[BRISTLE]
        rates(y, i1, t + 0.5 * h, p, work[1])
        for j in range(7):
            y[j] = x[j] + 0.5 * h * work[1, j]
        rates(y, i1, t + 0.5 * h, p, work[2])
        for j in range(7):
            y[j] = x[j] + h * work[2, j]
        rates(y, i2, t + h, p, work[3])
        for j in range(7):
            x[j] += h / 6.0 * (work[0, j] + 2.0 * (work[1, j] + work[2, j]) + work[3, j])
        _relax(x, 0.5 * h, t + h, p)
        i0 = i2
    x[MESH] *= forget


@njit(cache=True, nogil=True, error_model="numpy")
def next_current(current, command, dt, p):
    """Return the motor current [A] after `dt` [s] under a command."""
    return command + (current - command) * (math.exp(-dt * p.R / p.L) if p.L > 0.0 else 0.0)


@njit(cache=True, nogil=True, error_model="numpy")
def start(motor_position, link_position, p, x):
    """Write the state at rest at the first encoder readings, under the link's weight, into `x`."""
    x[:] = 0.0
    x[MOTOR] = motor_position
    x[LINK] = link_position - p.link_zero
    load = -laws.gravity_torque(x[LINK], p) - laws.link_torque(x[LINK], p)
    x[WAVE] = motor_position - laws.wave_generator_torsion(load / p.N, p)
