"""The plant: a joint as a MuJoCo model, with every number from the joint description."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import mujoco
import numpy as np

from ..models import arm, laws
from ..models.arm import CarriedMass, carrying
from ..models.errors import refusing
from ..models.joint import Joint, shipped
from ..models.joint_parts import Mounting
from . import native, plugin
from .shape import shape

TIMESTEP = 0.0002  # default timestep [s], chosen by the convergence study in docs/convergence.md
_LOCKED = 1e6  # kg·m², of a locked rotor


def build(
    joint: Joint,
    mounting: Mounting | None = None,
    timestep: float = TIMESTEP,
    record: np.ndarray | None = None,
    ideal_current: bool = False,
    locked_rotor: bool = False,
    payloads: Sequence[CarriedMass] = (),
) -> mujoco.MjModel:
    """Build the MuJoCo model of a joint.

    Args:
      joint: the description; its MJCF, which is for looks, must be valid (`shape`).
      mounting: load on the output; by default the joint's.
      timestep: step of the integrator [s].
      record: parameter record, shape (1,), instead of the joint's own in that mounting (a joint within tolerance).
      ideal_current: whether the motor's control is torque, without the winding's dynamics and voltage limit, as in
        the independent reference solutions.
      locked_rotor: whether the rotor is locked.
      payloads: that the link carries, in addition to the record's load.

    Returns:
      The model. Coordinates: rotor, wave generator, link, and the flexible part of the link (if there is one).
        Activation: motor current [A] (unless ideal). The laws' memory is plugin state (`plugin.STATES`).

    Raises:
      InputError: an invalid MJCF; numbers of which MuJoCo cannot make a model.
    """
    shape(joint)
    record = joint.record(mounting) if record is None else record
    with refusing(f"{joint.name}: no plant"), native.quiet():
        return describe(record, timestep, ideal_current, locked_rotor, payloads).compile()


def describe(
    record: np.ndarray,
    timestep: float,
    ideal_current: bool = False,
    locked_rotor: bool = False,
    payloads: Sequence[CarriedMass] = (),
) -> mujoco.MjSpec:
    """Return the spec of a joint with the numbers of a record; its bodies are the test joint's."""
    plugin.register()
    p = record[0]
    with native.quiet():
        spec = mujoco.MjSpec.from_file(str(shipped("test_joint.xml")))
    set_numbers(spec, p, timestep, ideal_current)
    spec.delete(spec.actuator("mesh_friction"))  # the plugin's
    if p["flexible_share"] > 0:
        _add_flexible_part(spec, p)
    if locked_rotor:
        spec.joint("rotor").armature = _LOCKED
    if payloads:
        _add_payloads(spec, p, payloads)
        record = carrying(record, payloads)
    put_laws(spec, record)
    return spec


def put_laws(spec: mujoco.MjSpec, record: np.ndarray, prefix: str = "", link: str = "link") -> None:
    """Put the laws of a joint's record on its rotor, wave generator, link and the two tendons between them. The spec is
    not compiled yet, with its final timestep and integrator. `prefix`: of all names; `link`: the link's joint."""
    p, h = record[0], float(spec.option.timestep)
    # Half of every linear damping is MuJoCo's, implicit; half the plugin's.
    spec.joint(prefix + "rotor").damping = [0.5 * p["bm"], 0, 0]
    spec.joint(prefix + "wave_generator").damping = [0.5 * (p["bw"] + p["s1"]), 0, 0]
    # The laws replace the linear springs.
    for name, joints, damping in (
        ("flexspline", {prefix + "wave_generator": 1.0 / p["N"], link: -1.0}, p["df"]),
        ("wave_generator", {prefix + "rotor": 1.0, prefix + "wave_generator": -1.0}, p["dw"]),
    ):
        if spec.tendon(prefix + name) is not None:
            spec.delete(spec.tendon(prefix + name))
        tendon = spec.add_tendon(name=prefix + name)
        tendon.damping, tendon.stiffness, tendon.frictionloss = [0.5 * damping, 0, 0], [0.0] * 3, 0.0
        tendon.limited = tendon.actfrclimited = mujoco.mjtLimited.mjLIMITED_FALSE
        for one, coefficient in joints.items():
            tendon.wrap_joint(one, float(coefficient))
    # Cancels the h² error that the trapezoidal leapfrog makes in the flexspline's mode, its fastest at no load. For
    # M q'' + D q' + K q = 0 the scheme solves an equation that differs by h²/12 ((K + D²/M) q'' + (D K/M) q'). An inertia
    # across the flexspline, here, and a damping, in the plugin, give it back (Störmer and Numerov's idea, with damping). Both
    # vanish with h²: at the default timestep 1e-4 of a link's inertia (docs/convergence.md).
    spec.tendon(prefix + "flexspline").armature = h**2 / 12 * (p["K1"] + p["df"] ** 2 / plugin.reduced_inertia(p))
    spec.activate_plugin(plugin.NAME)
    instance = spec.add_plugin(name=prefix + "joint", plugin_name=plugin.NAME, active=True)
    instance.config = plugin.config(record)
    spec.body(prefix + "rotor").plugin = instance
    if spec.body(prefix + "flexible") is not None:
        spec.body(prefix + "flexible").plugin = instance


def instance(model: mujoco.MjModel, prefix: str = "") -> int:
    """Return the number of a joint's plugin instance."""
    return int(mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_PLUGIN, prefix + "joint"))


def memory(model: mujoco.MjModel, data: mujoco.MjData, prefix: str = "") -> np.ndarray:
    """Return a view of the memory of a joint's laws: its plugin state, shape (plugin.STATES,)."""
    at = model.plugin_stateadr[instance(model, prefix)]
    return data.plugin_state[at : at + plugin.STATES]


def start(model: mujoco.MjModel, data: mujoco.MjData, position: np.ndarray | None = None) -> None:
    """Put a model's joints at rest at time 0, at positions of rotor, wave generator and link [rad], shape (joints, 3),
    zero by default.

    Velocities in the model's state belong to the middle of a step (leapfrog), so the state starts half a step early.
    """
    h = model.opt.timestep
    joints = model.nplugin
    given = np.zeros((joints, 3)) if position is None else np.reshape(position, (joints, 3))
    held = [plugin.instance(data, i) for i in range(joints)]
    for (at, _), angles in zip(held, given, strict=True):
        data.qpos[at[0]] = angles
    data.qvel[:] = 0.0
    data.act[:] = 0.0
    with native.quiet():
        mujoco.mj_forward(model, data)
    data.qvel[:] = -0.5 * h * data.qacc
    for i, ((at, _), record) in enumerate(held):
        state = data.plugin_state[model.plugin_stateadr[i] :][: plugin.STATES]
        state[plugin.MEMORY : plugin.MEMORY + 3] = -1.5 * h * data.qacc[at]
        state[plugin.STEPPED] = 1.0
        velocity, p = data.qvel[at], record[0]
        state[plugin.BRISTLE] = -h * velocity[plugin.WAVE_GENERATOR]
        if p["hysteresis_torque"] != 0:  # zero after the first step (laws.dahl_step)
            rate = plugin.transmission_at(data.qpos[at], velocity, 0.0, p).torsion_rate
            x = p["hysteresis_extent"]
            state[plugin.DAHL] = -np.sign(rate) * x * np.expm1(abs(rate) * h / x)


def set_options(spec: mujoco.MjSpec, timestep: float) -> None:
    spec.option.timestep = timestep
    # No contacts, and no joint limits.
    spec.option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT | mujoco.mjtDisableBit.mjDSBL_CONTACT)
    # A diverged motion stays visible instead of restarting at zero.
    spec.option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST


def set_numbers(spec: mujoco.MjSpec, p: np.void, timestep: float, ideal_current: bool) -> None:
    set_options(spec, timestep)
    for name, inertia in (("rotor", p["Jm"]), ("wave_generator", p["Jw"])):
        body = spec.body(name)
        body.explicitinertial = True
        body.ipos, body.inertia = [0.0] * 3, [inertia] * 3
    spec.joint("link").damping = [0.5 * p["bl"], 0, 0]
    _set_link(spec, p)
    motor = spec.actuator("motor")
    if ideal_current:
        motor.set_to_motor()
        motor.forcelimited = False
    else:
        set_motor(motor, p)


def set_motor(actuator: Any, p: np.void) -> None:
    """Make an actuator the motor with its winding: its control is the commanded torque of the current controller
    [N·m]."""
    Kt = float(p["Kt"])
    error = actuator.set_to_dcmotor(
        motorconst=[Kt, Kt],
        resistance=float(p["R"]),
        inductance=[float(p["L"]), 0.0],
        saturation=[0.0, float(p["current_limit"]), 0.0],
        controller=[0, 0, 0, 0, 0, float(p["supply_voltage"])],
        ctrlspec=int(mujoco.mjtCtrlInput.mjINPUT_FF),
    )
    if error:
        raise ValueError(error)


def link_mass(p: np.void) -> tuple[float, float]:
    """Return the mass of the rigid part of a record's link [kg] and the distance of its centre from the axis [m]."""
    return arm.link_mass(float(p["Jl"] - laws.flexible_inertia(p)), float(p["Mg"]))


def _set_link(spec: mujoco.MjSpec, p: np.void) -> None:
    """Set a mass with the gravity moment, at the gravity angle from the link's axis, and the remaining inertia as its
    shape."""
    body = spec.body("link")
    inertia = float(p["Jl"] - laws.flexible_inertia(p))
    mass, position = link_mass(p)
    about_mass = inertia - mass * position**2
    body.explicitinertial = True
    body.mass = mass
    body.ipos = [position * np.sin(p["gravity_angle"]), 0, -position * np.cos(p["gravity_angle"])]
    body.inertia = [about_mass, about_mass, about_mass]
    flange = spec.body("flange")
    flange.explicitinertial = True
    flange.mass, flange.ipos, flange.inertia = 1e-6, [0.0] * 3, [1e-9] * 3


def _add_payloads(spec: mujoco.MjSpec, p: np.void, payloads: Sequence[CarriedMass]) -> None:
    """Add the masses of payloads to the link of a record without them."""
    masses = [(*link_mass(p), 0.0), *((one.mass, one.distance, one.angle) for one in payloads)]
    mass = sum(m for m, _, _ in masses)
    x, z = (sum(m * r * of(p["gravity_angle"] + a) for m, r, a in masses) / mass for of in (np.sin, np.cos))
    inertia = float(p["Jl"] - laws.flexible_inertia(p)) + sum(one.joint_inertia for one in payloads)
    body = spec.body("link")
    body.mass, body.ipos, body.inertia = mass, [x, 0, -z], [inertia - mass * (x * x + z * z)] * 3


def _add_flexible_part(spec: mujoco.MjSpec, p: np.void) -> None:
    """Put a share of the link's inertia on a spring, `laws.flexible_torque`, with half of its damping, as everywhere."""
    inertia = float(laws.flexible_inertia(p))
    body = spec.body("link").add_body(name="flexible")
    body.explicitinertial = True
    body.mass, body.inertia = 1e-6, [inertia] * 3
    joint = body.add_joint(name="flexible", type=mujoco.mjtJoint.mjJNT_HINGE, axis=spec.joint("link").axis)
    joint.stiffness = [laws.flexible_torque(1.0, 0.0, p), 0, 0]
    joint.damping = [0.5 * laws.flexible_torque(0.0, 1.0, p), 0, 0]
