"""The laws of `models.laws` as a MuJoCo engine plugin, `flexspline.joint`, compiled, without Python per step.

An instance is a gear on one hinge. The rotor's body names it. A fixed tendon connects the rotor and the wave
generator, and another the wave generator and the hinge, so that no name has to be looked up. Its configuration is the
joint's parameter record: each field of `models.parameters.PARAMETERS` that differs from `neutral()`. Python reads it as
an mjData is made. The laws' memory is plugin state, which MuJoCo resets, copies, saves and restores.
"""

from __future__ import annotations

import ctypes
import math
import threading
from typing import Any

import numpy as np
from llvmlite import binding
from numba import carray, types

from ..models import dynamics, laws
from ..models.dynamics import State
from ..models.kernels import c_function, kernel
from ..models.parameters import PARAMETERS, REFERENCE_TEMPERATURE, SIZE, as_floats, neutral
from ..models.pointers import floats_at, ints_at, record_at, word_at
from . import native

NAME = "flexspline.joint"  # of the plugin
STATES = 14
"""Numbers of an instance's plugin state: bristle, Dahl state, velocities of the gear's coordinates a step before
(four), temperature; then the first six as written by the current step; 1 after a step. Before the first step, whatever the
velocities are, they have not changed."""
BRISTLE, DAHL, MEMORY, TEMPERATURE, _NEXT, STEPPED = 0, 1, 2, 6, 7, 13
"""Indices in the plugin state. Temperature [°C] may be changed at any time."""

ROTOR, WAVE_GENERATOR, LINK, FLEXIBLE = 0, 1, 2, 3
"""Order of a gear's coordinates; the fourth is the flexible part's, against the link."""

_HEADER = 7  # words before an instance's record: places of three positions and four velocities


@kernel
def state_of(theta, velocity, bristle, dahl, current, time, temperature):
    """A `State` from coordinates and velocities, shape (3,) each: rotor, wave generator, link."""
    return State(
        theta[0], velocity[0], theta[1], velocity[1], theta[2], velocity[2], bristle, dahl, current, time, temperature
    )


@kernel
def _mixed(a, x, b, y):
    return a * x[0] + b * y[0], a * x[1] + b * y[1], a * x[2] + b * y[2]


@kernel
def transmission_at(theta, velocity, dahl, p):
    """Return `dynamics.transmission` at coordinates and velocities, shape (3,) each: rotor, wave generator, link."""
    return dynamics.transmission(state_of(theta, velocity, 0.0, dahl, 0.0, 0.0, 0.0), p)


@kernel
def reduced_inertia(p):
    """Return the inertia [kg·m², output side] of wave generator and (rigid part of the) link across the flexspline."""
    return 1.0 / (1.0 / (p.Jl - laws.flexible_inertia(p)) + 1.0 / (p.N * p.N * p.Jw))


@kernel
def bristle_under_load(z, w, g_before, g, h, p):
    """Return the bristle deflection after a time `h` [s] at constant velocity while sliding friction changes from
    `g_before` to `g`.

    Exact for a deflection g/s0 that changes evenly and the rate at the mean of both. At speed the bristle follows the
    load within a step; a constant friction would lose s1 z'.
    """
    decay = 2.0 * p.s0 * abs(w) / (g_before + g) * h
    if decay < 1e-12:
        return z + w * h
    sign = 1.0 if w > 0.0 else -1.0
    before, after = sign * g_before / p.s0, sign * g / p.s0
    return after + (z - before) * math.exp(-decay) + (after - before) * math.expm1(-decay) / decay


@kernel
def at_positions(theta, velocity, previous, bristle, dahl, time, h, temperature, p):
    """Return `State` (without current), `Transmission` and g(w) at the instant of the positions; bristle and Dahl state
    are advanced by a step.

    `velocity`: half a step before; `previous`: one and a half steps before; `bristle`, `dahl`: at the last instant;
    `h`: of a step [s].
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
        now, before = _mixed(1.5, velocity, -0.5, previous), _mixed(0.5, velocity, 0.5, previous)
        back = _mixed(1.0, theta, -h, velocity)
        ahead = dynamics.transmission(state_of(theta, now, bristle, dahl, 0.0, time, temperature), p)
        g = dynamics.sliding_friction(state, ahead.load, p)
        earlier = state_of(back, before, bristle, dahl_before, 0.0, time - h, temperature)
        behind = dynamics.transmission(earlier, p)
        at_before = state_of(back, velocity, bristle, dahl_before, 0.0, time - h, temperature)
        g_before = dynamics.sliding_friction(at_before, behind.load, p)
        up = bristle_under_load(bristle, w, g_before, g, h, p)
    return state_of(theta, velocity, up, dahl, 0.0, time, temperature), t, g


# Offsets of the plugin's inputs in MuJoCo's structures, in 8-byte words: constants of compiled code.
_AT = native.offsets()
_TIMESTEP, _STATE_AT = _AT["timestep"], _AT["plugin_stateadr"]
_TIME, _QPOS, _QVEL, _PASSIVE, _STATE, _DATA = (
    _AT[name] for name in ("time", "qpos", "qvel", "qfrc_passive", "plugin_state", "plugin_data")
)
_JOINT = 1  # mjWRAP_JOINT
_free: Any = types.ExternalFunction("flexspline_free", types.void(types.intp))
_allocate: Any = ctypes.CFUNCTYPE(ctypes.c_void_p, ctypes.c_size_t)(("mju_malloc", native.library()))
_attribute: Any = ctypes.CFUNCTYPE(ctypes.c_char_p, ctypes.c_void_p, ctypes.c_int, ctypes.c_char_p)(
    ("mj_getPluginConfig", native.library())
)


def _word(address: int, field: str) -> int:
    """Return a word of a structure of MuJoCo: a size, or the address of an array."""
    return ctypes.c_int64.from_address(address + 8 * _AT[field]).value


def _array(m: int, field: str) -> Any:
    return ctypes.cast(_word(m, field), ctypes.POINTER(ctypes.c_int32))


def _configured(m: int, instance: int) -> np.ndarray:
    """Return the parameter record of an instance's configuration, shape (1,). Raises `ValueError`: a field that is not its
    numbers, or no gear."""
    record = neutral()
    p = record[0]
    for name in PARAMETERS.names or ():
        if numbers := [float(x) for x in _attribute(m, instance, name.encode()).split()]:
            p[name] = np.reshape(numbers, PARAMETERS[name].shape)
    if not (np.isfinite(as_floats(record)).all() and min(p["N"], p["Jw"], p["Jl"], p["vs"]) > 0.0):
        raise ValueError("expected finite numbers of a gear, got others")
    return record


def _places(m: int, instance: int) -> np.ndarray:
    """Return the header of an instance's block. Raises `ValueError`: bodies that are not one gear."""
    kind, joints, begin, length = (_array(m, f) for f in ("wrap_type", "wrap_objid", "tendon_adr", "tendon_num"))
    # The fixed tendons of two joints, by their first one.
    pairs = [begin[k] for k in range(_word(m, "ntendon")) if length[k] == 2 and kind[begin[k]] == _JOINT]
    following = {joints[at]: joints[at + 1] for at in reversed(pairs)}
    first, of = _array(m, "body_jntadr"), _array(m, "body_plugin")
    mine = [first[i] for i in range(_word(m, "nbody")) if of[i] == instance and first[i] >= 0]
    (rotor,) = [joint for joint in mine if joint in following]
    flexible = [joint for joint in mine if joint != rotor]
    gear = [rotor, following[rotor], following.get(following[rotor], -1)]
    if gear[LINK] < 0:
        raise ValueError("expected a tendon from the wave generator to the hinge, got none")
    qpos, dof = _array(m, "jnt_qposadr"), _array(m, "jnt_dofadr")
    return np.array([*(qpos[j] for j in gear), *(dof[j] for j in gear), dof[flexible[-1]] if flexible else -1], float)


@ctypes.CFUNCTYPE(ctypes.c_int, ctypes.c_void_p, ctypes.c_void_p, ctypes.c_int)
def _init(m: int, d: int, instance: int) -> int:
    try:
        block = np.concatenate([_places(m, instance), as_floats(_configured(m, instance))])
    except Exception:  # none may pass through MuJoCo, which names the plugin
        return -1
    at = _allocate(block.nbytes)
    ctypes.memmove(at, block.ctypes.data, block.nbytes)
    ctypes.c_int64.from_address(_word(d, "plugin_data") + 8 * instance).value = at
    return 0


@kernel
def _ints(m, field):
    return ints_at(word_at(m + 8 * field))


@kernel
def _block(d, instance):
    return word_at(word_at(d + 8 * _DATA) + 8 * instance)


def _destroy(d, instance):
    _free(_block(d, instance))


def _copy(to, m, d, instance):
    new = floats_at(_block(to, instance))
    old = floats_at(_block(d, instance))
    for k in range(_HEADER + SIZE):
        new[k] = old[k]


def _reset(m, state, block, instance):
    numbers = floats_at(state)
    for k in range(STATES):
        numbers[k] = 0.0
    numbers[TEMPERATURE] = REFERENCE_TEMPERATURE


def _states(m, instance):
    return STATES


def _advance(m, d, instance):
    state = floats_at(word_at(d + 8 * _STATE) + 8 * _ints(m, _STATE_AT)[instance])
    for k in range(TEMPERATURE):
        state[k] = state[_NEXT + k]
    state[STEPPED] = 1.0


def _compute(m, d, instance, capability):
    block = _block(d, instance)
    header = floats_at(block)
    p = carray(record_at(block + 8 * _HEADER), 1)[0]
    memory = floats_at(word_at(d + 8 * _STATE) + 8 * _ints(m, _STATE_AT)[instance])
    qpos, qvel = floats_at(word_at(d + 8 * _QPOS)), floats_at(word_at(d + 8 * _QVEL))
    rotor, wave_generator, link = int(header[3 + ROTOR]), int(header[3 + WAVE_GENERATOR]), int(header[3 + LINK])
    theta = qpos[int(header[ROTOR])], qpos[int(header[WAVE_GENERATOR])], qpos[int(header[LINK])]
    velocity = qvel[rotor], qvel[wave_generator], qvel[link]
    previous = velocity
    if memory[STEPPED] != 0.0:
        previous = memory[MEMORY + ROTOR], memory[MEMORY + WAVE_GENERATOR], memory[MEMORY + LINK]
    time, h = floats_at(d + 8 * _TIME)[0], floats_at(m + 8 * _TIMESTEP)[0]
    state, t, g = at_positions(
        theta, velocity, previous, memory[BRISTLE], memory[DAHL], time, h, memory[TEMPERATURE], p
    )
    b = dynamics.balance_with(state, t, g, p)
    memory[_NEXT + BRISTLE], memory[_NEXT + DAHL] = state.bristle, state.dahl
    for k in range(3):
        memory[_NEXT + MEMORY + k] = velocity[k]
    w = velocity[WAVE_GENERATOR]

    # The equations of motion without MuJoCo's own part: gravity, and half of every linear damping, which it
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

    # Half of s1 is implicit, which is the trapezoidal rule while sticking; while sliding, the last change is used for the next.
    sliding = p.s0 * state.bristle / g if w > 0.0 else -p.s0 * state.bristle / g
    change = w - previous[WAVE_GENERATOR]
    on_wave_generator += 0.5 * p.s1 * (w + sliding * change)

    # Implicit in MuJoCo is each body's own damping, without the coupling to the other body: bodies
    # of different branches have no common entry in its matrices. The last change is used for the next there, too.
    rotor_change, link_change = velocity[ROTOR] - previous[ROTOR], velocity[LINK] - previous[LINK]
    on_rotor += 0.5 * p.dw * change
    on_wave_generator += 0.5 * p.dw * rotor_change + 0.5 * p.df / p.N * link_change
    on_link += 0.5 * p.df / p.N * change

    force = floats_at(word_at(d + 8 * _PASSIVE))
    force[rotor] += on_rotor
    force[wave_generator] += on_wave_generator
    force[link] += on_link
    flexible = int(header[3 + FLEXIBLE])
    if flexible >= 0:
        memory[_NEXT + MEMORY + FLEXIBLE] = qvel[flexible]
        # The spring and half of the damping are MuJoCo's own; this is the explicit half.
        force[flexible] -= 0.5 * laws.flexible_torque(0.0, qvel[flexible], p)


class _Plugin(ctypes.Structure):
    """`mjpPlugin`."""

    _fields_ = (
        ("name", ctypes.c_char_p), ("nattribute", ctypes.c_int), ("attributes", ctypes.POINTER(ctypes.c_char_p)),
        ("capabilities", ctypes.c_int), ("needstage", ctypes.c_int),
        *((name, ctypes.c_void_p) for name in (
            "nstate", "nsensordata", "init", "destroy", "copy", "reset", "compute", "advance", "visualize",
            "actuator_act_dot", "sdf_distance", "sdf_gradient", "sdf_staticdistance", "sdf_attribute", "sdf_aabb",
        )),
    )  # fmt: skip


_PASSIVE_FORCES = 1 << 2  # mjPLUGIN_PASSIVE
_registering = threading.Lock()
_registered: list[Any] = []


def register() -> None:
    """Compile the plugin's functions and register them with MuJoCo; once per process."""
    with _registering:
        if _registered:
            return
        binding.add_symbol("flexspline_free", native.function_address("mju_free"))
        at, i = types.intp, types.int32
        functions = {
            "nstate": c_function(i(at, i), _states),
            "destroy": c_function(types.void(at, i), _destroy),
            "copy": c_function(types.void(at, at, at, i), _copy),
            "reset": c_function(types.void(at, at, at, i), _reset),
            "compute": c_function(types.void(at, at, i, i), _compute),
            "advance": c_function(types.void(at, at, i), _advance),
        }
        names = [name.encode() for name in PARAMETERS.names or ()]
        attributes = (ctypes.c_char_p * len(names))(*names)
        plugin = _Plugin(NAME.encode(), len(names), attributes, _PASSIVE_FORCES, 0)
        for name, function in functions.items():
            setattr(plugin, name, function.address)
        plugin.init = ctypes.cast(_init, ctypes.c_void_p)
        _registered.extend((native.library().mjp_registerPlugin(ctypes.byref(plugin)), functions, attributes))


def config(record: np.ndarray) -> dict[str, str]:
    """An instance's configuration of a parameter record, shape (1,): the fields that are not neutral, as text."""
    blank = neutral()[0]
    return {
        name: " ".join(repr(float(x)) for x in np.ravel(record[0][name]))
        for name in PARAMETERS.names or ()
        if not np.array_equal(record[0][name], blank[name])
    }


def put_record(data: Any, i: int, record: np.ndarray) -> None:
    """Give instance i of a model other parameters, of a record of shape (1,)."""
    numbers = (ctypes.c_double * SIZE).from_address(int(data.plugin_data[i]) + 8 * _HEADER)
    numbers[:] = as_floats(record).tolist()


def slot() -> int:
    """Number under which MuJoCo knows the plugin: of an instance, `mjModel.plugin` says it."""
    return int(_registered[0])


def instance(data: Any, i: int) -> tuple[np.ndarray, np.ndarray]:
    """What instance i of a model holds: places in qpos and in qvel of rotor, wave generator and link, shape (2, 3), and its
    parameter record, shape (1,); copies."""
    block = np.array((ctypes.c_double * (_HEADER + SIZE)).from_address(int(data.plugin_data[i])))
    return block[:6].astype(int).reshape(2, 3), block[_HEADER:].view(PARAMETERS)
