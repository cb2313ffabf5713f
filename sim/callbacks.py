"""What MJCF cannot say, as C callbacks into MuJoCo: the laws of `models.laws`, compiled, no Python per step.

The model carries the joint's parameter record in its first custom numeric field, behind a header; of joints in series
each has a field of its own, one after the other. The callbacks act only on models with that header, so any other model in
the process is left alone. They are C functions, as `mujoco.batch` and `mujoco.rollout` ask for.
"""

from __future__ import annotations

import math
import threading

import numpy as np
from numba import carray, types

from ..models import dynamics, laws
from ..models.dynamics import State
from ..models.kernels import c_function, kernel
from ..models.parameters import SIZE, as_floats
from ..models.pointers import floats_at, record_at, word_at
from . import native

MAGIC = 1.8446744073e19  # marks the numeric field of a joint's model
HEADER = 11
"""Words before the record: magic; timestep; activations of the bristle, of the velocities' memory and (or −1) of the Dahl
state; whether the bristle is MuJoCo's own; actuators that hold the memory (the first) and the Dahl state; the joint's first
coordinate and first actuator; temperature [°C]."""
BRISTLE, MEMORY, DAHL, NATIVE, REMEMBERING, DAHL_ACTUATOR, COORDINATE, ACTUATOR = range(2, 10)
"""Places in the header."""
TEMPERATURE = HEADER - 1
"""Place of the temperature [°C] in the header: whoever steps the model may change it."""
NUMERIC_SIZE = HEADER + SIZE

ROTOR, WAVE_GENERATOR, LINK, FLEXIBLE = 0, 1, 2, 3
"""Indices of the joint's coordinates, from its first; the fourth, against the link, where part of the link hangs by a spring."""


def numeric(record: np.ndarray, timestep: float, header: tuple[float, ...]) -> np.ndarray:
    """The numeric field of a joint's model, shape (NUMERIC_SIZE,); `header` is the rest of the header."""
    return np.concatenate([[MAGIC, timestep, *header], as_floats(record)])


@kernel
def state_of(theta, velocity, bristle, dahl, current, time, temperature):
    """A `State` from coordinates and velocities, shape (3,) each: rotor, wave generator, link."""
    return State(
        theta[0], velocity[0], theta[1], velocity[1], theta[2], velocity[2], bristle, dahl, current, time, temperature
    )


@kernel
def transmission_at(theta, velocity, dahl, p):
    """`dynamics.transmission` at coordinates and velocities, shape (3,) each: rotor, wave generator, link."""
    return dynamics.transmission(state_of(theta, velocity, 0.0, dahl, 0.0, 0.0, 0.0), p)


@kernel
def reduced_inertia(p):
    """Inertia [kg·m², output side] that wave generator and (what is rigid of) the link oppose to the flexspline."""
    return 1.0 / (1.0 / (p.Jl - laws.flexible_inertia(p)) + 1.0 / (p.N * p.N * p.Jw))


@kernel
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


@kernel
def at_positions(theta, velocity, previous, bristle, dahl, time, h, temperature, p):
    """State, transmission and sliding friction at the instant of the positions; bristle and Dahl state, a step behind, are
    brought up.

    Args:
      theta: positions; velocity: half a step before; previous: one and a half steps before; shape (3,).
      bristle, dahl: at the last instant; time, h: of now, of a step [s]; temperature [°C]; p: parameter record.

    Returns:
      `State` (without current), `Transmission`, g(w).
    """
    dahl_before = dahl
    if p.hysteresis_torque != 0.0:
        rough = dynamics.transmission(state_of(theta, velocity, bristle, 0.0, 0.0, time, temperature), p)
        dahl = laws.dahl_step(dahl, rough.torsion_rate, h, p)
    state = state_of(theta, velocity, bristle, dahl, 0.0, time, temperature)
    t = dynamics.transmission(state, p)
    w = velocity[1]
    if p.friction_load == 0.0:
        g = dynamics.sliding_friction(state, t.load, p)
        up = laws.bristle_step(bristle, w, g, h, p)
    else:
        # The load changes within a step: friction at both its ends, with the flexspline's damping at these instants.
        now, before = 1.5 * velocity - 0.5 * previous, 0.5 * (velocity + previous)
        ahead = dynamics.transmission(state_of(theta, now, bristle, dahl, 0.0, time, temperature), p)
        g = dynamics.sliding_friction(state, ahead.load, p)
        earlier = state_of(theta - h * velocity, before, bristle, dahl_before, 0.0, time - h, temperature)
        behind = dynamics.transmission(earlier, p)
        at_before = state_of(theta - h * velocity, velocity, bristle, dahl_before, 0.0, time - h, temperature)
        g_before = dynamics.sliding_friction(at_before, behind.load, p)
        up = bristle_under_load(bristle, w, g_before, g, h, p)
    return state_of(theta, velocity, up, dahl, 0.0, time, temperature), t, g


# Where MuJoCo keeps what the callbacks read, in 8-byte words. Compiled code takes them as constants.
_AT = native.offsets()
_NUMERIC, _COUNT, _TIME, _QPOS, _QVEL, _ACT, _PASSIVE = (
    _AT[name] for name in ("numeric_data", "nnumericdata", "time", "qpos", "qvel", "act", "qfrc_passive")
)


@kernel
def _joints(m):
    """How many joints a model has; 0 where it is none of this package's."""
    count = word_at(m + 8 * _COUNT) // NUMERIC_SIZE
    return count if count > 0 and floats_at(word_at(m + 8 * _NUMERIC))[0] == MAGIC else 0


def _passive(m, d):
    for k in range(_joints(m)):
        _act_on(word_at(m + 8 * _NUMERIC) + 8 * NUMERIC_SIZE * k, d)


@kernel
def _act_on(numeric, d):
    """Add one joint's torques to the passive forces; `numeric`: address of its numeric field."""
    header = floats_at(numeric)
    p = carray(record_at(numeric + 8 * HEADER), 1)[0]
    at = 8 * int(header[COORDINATE])
    theta, velocity = (
        carray(floats_at(word_at(d + 8 * _QPOS) + at), 3),
        carray(floats_at(word_at(d + 8 * _QVEL) + at), 3),
    )
    act = floats_at(word_at(d + 8 * _ACT))
    time, h = floats_at(d + 8 * _TIME)[0], header[1]
    z = act[int(header[BRISTLE])]
    dahl = act[int(header[DAHL])] if header[DAHL] >= 0.0 else 0.0
    memory = int(header[MEMORY])
    previous = carray(floats_at(word_at(d + 8 * _ACT) + 8 * memory), 3)
    state, t, g = at_positions(theta, velocity, previous, z, dahl, time, h, header[TEMPERATURE], p)
    b = dynamics.balance_with(state, t, g, p)
    w = velocity[WAVE_GENERATOR]

    # All that the equations of motion say, less what MuJoCo adds itself: gravity, and half of every linear damping, which it
    # takes implicitly. The other half is explicit. Together that is the trapezoidal rule, second order
    # (docs/convergence.md).
    damper = 0.5 * p.df * (w / p.N - velocity[LINK])
    Tw_damping = 0.5 * p.dw * (velocity[ROTOR] - w)
    on_rotor = b.on_rotor + Tw_damping + 0.5 * p.bm * velocity[ROTOR]
    on_wave_generator = b.on_wave_generator - Tw_damping + damper / p.N + 0.5 * p.bw * w
    on_link = b.on_link - b.gravity - damper + 0.5 * p.bl * velocity[LINK]
    more = h * h / 12.0 * p.K1 / reduced_inertia(p) * p.df * b.torsion_rate  # see plant._correct_to_fourth_order
    on_wave_generator -= more * b.ratio
    on_link += more

    # MuJoCo's own LuGre lags half a step and counts a damping of s1 as implicit, also while sliding; take back its force and
    # half of that damping. What remains implicit, s1/2, is the trapezoidal rule while sticking; while sliding, the last
    # change stands for the next.
    own = 0.5 * p.s1 * w
    if header[NATIVE] > 0.0:
        own = laws.mesh_friction(z, w, g, p) - 0.5 * p.s1 * w
    sliding = p.s0 * state.bristle / g if w > 0.0 else -p.s0 * state.bristle / g
    change = w - act[memory + WAVE_GENERATOR]
    on_wave_generator += own + 0.5 * p.s1 * sliding * change

    # Implicit in MuJoCo is each body's own damping, not what it owes to the other body's change of velocity: bodies
    # of different branches have no common entry in its matrices. The last change stands for the next there, too.
    rotor_change, link_change = velocity[ROTOR] - act[memory + ROTOR], velocity[LINK] - act[memory + LINK]
    on_rotor += 0.5 * p.dw * change
    on_wave_generator += 0.5 * p.dw * rotor_change + 0.5 * p.df / p.N * link_change
    on_link += 0.5 * p.df / p.N * change

    force = carray(floats_at(word_at(d + 8 * _PASSIVE) + at), 3)
    force[ROTOR] += on_rotor
    force[WAVE_GENERATOR] += on_wave_generator
    force[LINK] += on_link
    if p.flexible_share > 0.0:  # the spring and half of the damping are MuJoCo's own; this is the explicit half
        flexible = floats_at(word_at(d + 8 * _QVEL) + at)[FLEXIBLE]
        floats_at(word_at(d + 8 * _PASSIVE) + at)[FLEXIBLE] -= 0.5 * laws.flexible_torque(0.0, flexible, p)


def _act_dyn(m, d, actuator):
    # The rate that takes MuJoCo's Euler step to where the exact solution of the stiff state is.
    joints = _joints(m)
    if joints == 0:
        return 0.0
    numeric = word_at(m + 8 * _NUMERIC)
    for _ in range(joints - 1):  # to the joint whose actuator it is
        if floats_at(numeric + 8 * NUMERIC_SIZE)[ACTUATOR] > actuator:
            break
        numeric += 8 * NUMERIC_SIZE
    header = floats_at(numeric)
    p = carray(record_at(numeric + 8 * HEADER), 1)[0]
    at = 8 * int(header[COORDINATE])
    speed = floats_at(word_at(d + 8 * _QVEL) + at)
    theta, velocity = carray(floats_at(word_at(d + 8 * _QPOS) + at), 3), carray(speed, 3)
    act = floats_at(word_at(d + 8 * _ACT))
    time, h = floats_at(d + 8 * _TIME)[0], header[1]
    z = act[int(header[BRISTLE])]
    dahl = act[int(header[DAHL])] if header[DAHL] >= 0.0 else 0.0
    memory = int(header[MEMORY])
    remembered = actuator - int(header[REMEMBERING])
    if 0 <= remembered < (4 if p.flexible_share > 0.0 else 3):
        return (speed[remembered] - act[memory + remembered]) / h
    previous = carray(floats_at(word_at(d + 8 * _ACT) + 8 * memory), 3)
    state, _, _ = at_positions(theta, velocity, previous, z, dahl, time, h, header[TEMPERATURE], p)
    if actuator == int(header[DAHL_ACTUATOR]):
        return (state.dahl - dahl) / h
    return (state.bristle - z) / h


_installing = threading.Lock()
_installed: dict[str, object] = {}


def install() -> None:
    """Compile and install the callbacks; once per process, by whichever thread comes first.

    Raises:
      RuntimeError: another passive-force or activation callback is installed already.
    """
    if _installed:
        return
    with _installing:
        if _installed:
            return
        for name in ("mjcb_passive", "mjcb_act_dyn"):
            if native.installed(name):
                raise RuntimeError(f"MuJoCo's {name} is in use by another package")
        compiled = {
            "mjcb_passive": c_function(types.void(types.intp, types.intp), _passive),
            "mjcb_act_dyn": c_function(types.float64(types.intp, types.intp, types.int32), _act_dyn),
        }
        for name, function in compiled.items():
            native.install(name, function.address)
        _installed.update(compiled)
