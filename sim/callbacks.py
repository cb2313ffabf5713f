"""What MJCF cannot say, as C callbacks into MuJoCo: the laws of `models.laws`, compiled, no Python per step.

The model carries the joint's parameter record in its first custom numeric field, behind a header. The callbacks
act only on models with that header, so any other model in the process is left alone. They are C functions, as
`mujoco.batch` and `mujoco.rollout` ask for.
"""

from __future__ import annotations

import math
from functools import cache

import numpy as np
from numba import carray, cfunc, njit, types

from ..models import laws
from ..models.parameters import PLACES, SIZE, as_floats
from . import native

MAGIC = 1.8446744073e19  # marks the numeric field of a joint's model
HEADER = 8
"""Words before the record: magic; timestep; activations of the bristle, of the three velocities' memory and (or −1) of
the Dahl state; whether the bristle is MuJoCo's own; actuators that hold the memory (the first) and the Dahl state."""
NUMERIC_SIZE = HEADER + SIZE

ROTOR, WAVE_GENERATOR, LINK = 0, 1, 2
"""Indices of the joint's three coordinates."""


PLACE_ROTOR, PLACE_MESH, PLACE_FLEXSPLINE, PLACE_LINK = (
    PLACES.index(name) for name in ("rotor", "mesh", "flexspline", "link")
)


def numeric(record: np.ndarray, timestep: float, header: tuple[float, ...]) -> np.ndarray:
    """The numeric field of a joint's model, shape (NUMERIC_SIZE,); `header` is the rest of the header."""
    return np.concatenate([[MAGIC, timestep, *header], as_floats(record)])


@njit(cache=True)
def transmission(theta, velocity, dahl, p):
    """Torques between the three bodies at a state.

    Args:
      theta, velocity: rotor, wave generator, link; shape (3,), rad and rad/s.
      dahl: Dahl state [rad]; p: parameter record.

    Returns:
      Tw without its damping, Tf with it, Δθf' [rad/s], and 1/N − dθerr/dθw.
    """
    slope = 1.0 / p.N - laws.kinematic_error_slope(theta[1], p)
    torsion = theta[1] / p.N - theta[2] - laws.kinematic_error(theta[1], p)
    rate = velocity[1] * slope - velocity[2]
    Tf = laws.flexspline_spring(torsion, p) + p.df * rate + laws.hysteresis_torque(dahl, p)
    Tw = laws.wave_generator_spring(theta[0] - theta[1], p)
    return Tw, Tf, rate, slope


@njit(cache=True)
def reduced_inertia(p):
    """Inertia [kg·m², output side] that wave generator and link oppose to the flexspline."""
    return 1.0 / (1.0 / p.Jl + 1.0 / (p.N * p.N * p.Jw))


@njit(cache=True)
def bristle_under_load(z, w, g_before, g, h, p):
    """Bristle deflection after a time `h` [s] at constant velocity while sliding friction goes from `g_before` to `g`.

    Exact for a deflection g/s0 that changes evenly and the rate at the mean of both: at speed the bristle follows the load
    within a step, and a friction that is constant over it would lose s1 z'.
    """
    decay = 2.0 * p.s0 * abs(w) / (g_before + g) * h
    if decay < 1e-12:
        return z + w * h
    sign = 1.0 if w > 0.0 else -1.0
    before, after = sign * g_before / p.s0, sign * g / p.s0
    return after + (z - before) * math.exp(-decay) + (after - before) * math.expm1(-decay) / decay


@njit(cache=True)
def state_forces(theta, velocity, previous, bristle, dahl, time, h, p):
    """Torques and friction at the instant of the positions; bristle and Dahl state, a step behind, are brought up.

    Args:
      theta: positions; velocity: half a step before; previous: one and a half steps before; shape (3,).
      bristle, dahl: at the last instant; time, h: of now, of a step [s]; p: parameter record.

    Returns:
      Tw without its damping, Tf with it, 1/N − dθerr/dθw, sliding friction g, bristle and Dahl state at the instant, Δθf'.
    """
    dahl_before = dahl
    if p.hysteresis_torque != 0.0:
        _, _, rate, _ = transmission(theta, velocity, 0.0, p)
        dahl = laws.dahl_step(dahl, rate, h, p)
    Tw, Tf, rate, slope = transmission(theta, velocity, dahl, p)
    w = velocity[1]
    if p.friction_load == 0.0:
        g = laws.friction_level(w, theta[2], Tf, time, p)
        return Tw, Tf, slope, g, laws.bristle_step(bristle, w, g, h, p), dahl, rate
    # The load changes within a step: friction at both its ends, with the flexspline's damping at these instants.
    now, before = 1.5 * velocity - 0.5 * previous, 0.5 * (velocity + previous)
    _, load, _, _ = transmission(theta, now, dahl, p)
    _, load_before, _, _ = transmission(theta - h * velocity, before, dahl_before, p)
    g = laws.friction_level(w, theta[2], load, time, p)
    g_before = laws.friction_level(w, theta[2] - h * velocity[2], load_before, time - h, p)
    return Tw, Tf, slope, g, bristle_under_load(bristle, w, g_before, g, h, p), dahl, rate


def _compile(NUMERIC: int, COUNT: int, TIME: int, QPOS: int, QVEL: int, ACT: int, PASSIVE: int):
    """Compile the callbacks for MuJoCo's layout.

    The offsets are closure variables, which the compiler's cache takes into account: another MuJoCo is compiled anew.
    """
    floats_at, record_at, word_at = native.floats_at, native.record_at, native.word_at
    void, number, int32 = types.void, types.float64, types.int32

    @njit
    def is_joint(m):
        return word_at(m + 8 * COUNT) >= NUMERIC_SIZE and floats_at(word_at(m + 8 * NUMERIC))[0] == MAGIC

    @cfunc(void(types.intp, types.intp), cache=True)
    def passive(m, d):
        if not is_joint(m):
            return
        numeric = word_at(m + 8 * NUMERIC)
        header = floats_at(numeric)
        p = carray(record_at(numeric + 8 * HEADER), 1)[0]
        theta, velocity = carray(floats_at(word_at(d + 8 * QPOS)), 3), carray(floats_at(word_at(d + 8 * QVEL)), 3)
        act = floats_at(word_at(d + 8 * ACT))
        time, h = floats_at(d + 8 * TIME)[0], header[1]
        z = act[int(header[2])]
        previous_dahl = act[int(header[4])] if header[4] >= 0.0 else 0.0
        memory = int(header[3])
        previous = carray(floats_at(word_at(d + 8 * ACT) + 8 * memory), 3)
        Tw, Tf, slope, g, bristle, _, rate = state_forces(theta, velocity, previous, z, previous_dahl, time, h, p)
        force = carray(floats_at(word_at(d + 8 * PASSIVE)), 3)
        w, load_angle = velocity[WAVE_GENERATOR], theta[LINK]

        # MuJoCo holds half of every linear damping and takes it implicitly; the other half is explicit, here. Together
        # that is the trapezoidal rule, and second order (docs/convergence.md).
        damper = 0.5 * p.df * (w / p.N - velocity[LINK])
        Tw_damping = 0.5 * p.dw * (velocity[ROTOR] - w)
        on_rotor = laws.rotor_torque(theta[ROTOR], p) - Tw - Tw_damping - 0.5 * p.bm * velocity[ROTOR]
        on_wave_generator = Tw + Tw_damping - 0.5 * p.bw * w
        on_link = laws.link_torque(load_angle, p) - damper - 0.5 * p.bl * velocity[LINK]
        if laws.has_terms(p):
            load = Tf
            Tf += laws.term(PLACE_FLEXSPLINE, theta[ROTOR], load_angle, w, load, time, p)
            on_rotor += laws.term(PLACE_ROTOR, theta[ROTOR], load_angle, w, load, time, p)
            on_wave_generator -= laws.term(PLACE_MESH, theta[ROTOR], load_angle, w, load, time, p)
            on_link += laws.term(PLACE_LINK, theta[ROTOR], load_angle, w, load, time, p)
        Tf += h * h / 12.0 * p.K1 / reduced_inertia(p) * p.df * rate  # see plant._correct_to_fourth_order
        on_wave_generator += damper / p.N - Tf * slope

        # Friction at the instant of the positions, with the bristle brought up to it. MuJoCo's own LuGre lags half a step
        # and counts a damping of s1 as implicit, also while sliding; take back its force and half of that damping. What
        # remains implicit, s1/2, is the trapezoidal rule while sticking; while sliding, the last change stands for the next.
        own = 0.5 * p.s1 * w
        if header[5] > 0.0:
            own = laws.mesh_friction(z, w, g, p) - 0.5 * p.s1 * w
        sliding = p.s0 * bristle / g if w > 0.0 else -p.s0 * bristle / g
        change = w - act[memory + WAVE_GENERATOR]
        on_wave_generator += own - laws.mesh_friction(bristle, w, g, p) + 0.5 * p.s1 * sliding * change

        # Implicit in MuJoCo is each body's own damping, not what it owes to the other body's change of velocity: bodies
        # of different branches have no common entry in its matrices. The last change stands for the next there, too.
        rotor_change, link_change = velocity[ROTOR] - act[memory + ROTOR], velocity[LINK] - act[memory + LINK]
        on_rotor += 0.5 * p.dw * change
        on_wave_generator += 0.5 * p.dw * rotor_change + 0.5 * p.df / p.N * link_change
        on_link += 0.5 * p.df / p.N * change

        force[ROTOR] += on_rotor
        force[WAVE_GENERATOR] += on_wave_generator
        force[LINK] += Tf + on_link

    @cfunc(number(types.intp, types.intp, int32), cache=True)
    def act_dyn(m, d, actuator):
        # The rate that takes MuJoCo's Euler step to where the exact solution of the stiff state is.
        if not is_joint(m):
            return 0.0
        numeric = word_at(m + 8 * NUMERIC)
        header = floats_at(numeric)
        p = carray(record_at(numeric + 8 * HEADER), 1)[0]
        theta, velocity = carray(floats_at(word_at(d + 8 * QPOS)), 3), carray(floats_at(word_at(d + 8 * QVEL)), 3)
        act = floats_at(word_at(d + 8 * ACT))
        time, h = floats_at(d + 8 * TIME)[0], header[1]
        z = act[int(header[2])]
        previous_dahl = act[int(header[4])] if header[4] >= 0.0 else 0.0
        memory = int(header[3])
        remembered = actuator - int(header[6])
        if 0 <= remembered < 3:
            return (velocity[remembered] - act[memory + remembered]) / h
        previous = carray(floats_at(word_at(d + 8 * ACT) + 8 * memory), 3)
        _, _, _, _, bristle, dahl, _ = state_forces(theta, velocity, previous, z, previous_dahl, time, h, p)
        if actuator == int(header[7]):
            return (dahl - previous_dahl) / h
        return (bristle - z) / h

    return passive, act_dyn


@cache
def install() -> None:
    """Compile and install the callbacks; once per process.

    Raises:
      RuntimeError: another passive-force or activation callback is installed already.
    """
    at = native.offsets()
    names = ("numeric_data", "nnumericdata", "time", "qpos", "qvel", "act", "qfrc_passive")
    compiled = _compile(*(at[name] for name in names))
    for name, function in zip(("mjcb_passive", "mjcb_act_dyn"), compiled, strict=True):
        if native.installed(name):
            raise RuntimeError(f"MuJoCo's {name} is in use by another package")
        native.install(name, function.address)
