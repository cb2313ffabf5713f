"""The plant: a joint as a MuJoCo model, with every number from the joint description."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np

from ..models import laws
from ..models.errors import InputError
from ..models.joint import Joint, Mounting
from ..models.parameters import GRAVITY, PARAMETERS, REFERENCE_TEMPERATURE
from . import callbacks, native, structure

TIMESTEP = 0.0002
"""Default timestep [s], chosen by the convergence study in docs/convergence.md."""
_LOCKED = 1e6  # kg·m²: a rotor that no torque turns
_LEVER = 0.25  # m: largest distance of the link's centre of mass from the axis


def build(
    joint: Joint,
    mounting: Mounting | None = None,
    timestep: float = TIMESTEP,
    record: np.ndarray | None = None,
    ideal_current: bool = False,
    locked_rotor: bool = False,
    temperature: float = REFERENCE_TEMPERATURE,
) -> mujoco.MjModel:
    """Build the MuJoCo model of a joint.

    Args:
      joint: the description; its MJCF gives the structure, its numbers replace the MJCF's.
      mounting: what is bolted to the output; the joint's default.
      timestep: step of the integrator [s].
      record: parameter record, shape (1,), instead of the joint's own in that mounting (a joint within tolerance).
      ideal_current: the motor's control is torque without the winding's dynamics and voltage limit, as the
        independent reference solutions assume.
      locked_rotor: the rotor cannot turn.
      temperature: of the gear [°C]; `set_temperature` changes it.

    Returns:
      The model. Coordinates: rotor, wave generator, link, and what hangs on the link by a spring (where the link is not rigid).
      Activations: motor current [A] (unless ideal), bristle, Dahl state (where the joint has hysteresis).

    Raises:
      InputError: an MJCF that cannot be read or is not a joint's.
    """
    callbacks.install()
    record = joint.record(mounting) if record is None else record
    try:
        spec = describe(joint, record, timestep, ideal_current, locked_rotor)
        with native.quiet():
            model = spec.compile()
    except (ValueError, KeyError, AttributeError) as error:
        raise InputError(f"{joint.mjcf}: not the MJCF of a joint: {' '.join(str(error).split())}") from error
    structure.check_tendons(model, joint.mjcf)
    complete(model, record, temperature)
    structure.check_motion(model, record, joint.mjcf, _LOCKED if locked_rotor else 0.0)
    return model


def describe(
    joint: Joint, record: np.ndarray, timestep: float, ideal_current: bool = False, locked_rotor: bool = False
) -> mujoco.MjSpec:
    """A joint's MJCF with the numbers of a record, before it is compiled; `complete` says what is left to do then.

    Raises:
      InputError, ValueError, KeyError, AttributeError: an MJCF that cannot be read or is not a joint's.
    """
    p = record[0]
    spec = structure.read(joint.mjcf)
    set_numbers(spec, p, timestep, ideal_current)
    set_friction(spec, p)
    joints: tuple[str, ...] = structure.JOINTS
    if p["flexible_share"] > 0:
        _hang_flexibly(spec, p)
        joints = (*structure.JOINTS, "flexible")
    for name in joints:
        _add_state(spec, f"{name}_velocity", joint=name)
    if p["hysteresis_torque"] != 0:
        _add_state(spec, "hysteresis")
    if locked_rotor:
        spec.joint("rotor").armature = _LOCKED
    spec.add_numeric(name="joint", size=callbacks.NUMERIC_SIZE, data=[0.0])
    return spec


def complete(
    model: mujoco.MjModel, record: np.ndarray, temperature: float = REFERENCE_TEMPERATURE, prefix: str = ""
) -> None:
    """Put into a compiled model what MJCF cannot say of a joint, in place.

    Args:
      model: of `describe`; record: the joint's, shape (1,); temperature: of its gear [°C].
      prefix: of its names, where the model has several joints.
    """
    p, h = record[0], float(model.opt.timestep)
    flexspline, wave_generator = (model.tendon(prefix + name).id for name in ("flexspline", "wave_generator"))
    _correct_to_fourth_order(model, flexspline, p, h)
    model.wrap_prm[model.tendon_adr[flexspline]] = 1.0 / p["N"]
    model.tendon_stiffness[[flexspline, wave_generator]] = 0.0  # the laws in the callback replace the linear springs
    # Implicit damping of half of s1 (see the callback): MuJoCo's own LuGre has s1 already.
    native_friction = _plain_friction(p)
    model.actuator_damping[model.actuator(prefix + "mesh_friction").id] = 0.5 * (
        p["bw"] + (-p["s1"] if native_friction else p["s1"])
    )
    has_dahl = p["hysteresis_torque"] != 0
    header = (
        activation(model, prefix + "mesh_friction"),
        activation(model, prefix + "rotor_velocity"),
        activation(model, prefix + "hysteresis") if has_dahl else -1,
        native_friction,
        model.actuator(prefix + "rotor_velocity").id,
        model.actuator(prefix + "hysteresis").id if has_dahl else -1,
        model.joint(prefix + "rotor").dofadr[0],
        model.actuator(prefix + "motor").id,
        temperature,
    )
    at = model.numeric_adr[model.numeric(prefix + "joint").id]
    model.numeric_data[at : at + callbacks.NUMERIC_SIZE] = callbacks.numeric(record, h, header)


def _correct_to_fourth_order(model: mujoco.MjModel, tendon: int, p: np.void, h: float) -> None:
    """Cancel the h² error that the trapezoidal leapfrog makes in the flexspline's mode, its fastest at no load.

    For M q'' + D q' + K q = 0 the scheme solves an equation that differs by h²/12 ((K + D²/M) q'' + (D K/M) q'). An
    inertia across the flexspline, here, and a damping, in the callback, give it back (Störmer and Numerov's idea, with
    damping). Both vanish with h²: at the default timestep 1e-4 of a link's inertia (docs/convergence.md).
    """
    reduced = callbacks.reduced_inertia(p)
    model.tendon_armature[tendon] = h**2 / 12 * (p["K1"] + p["df"] ** 2 / reduced)


def set_temperature(model: mujoco.MjModel, temperature: float | np.ndarray) -> None:
    """Change the temperature [°C] of a joint's gear; of several joints, one each or one for all."""
    model.numeric_data[callbacks.TEMPERATURE :: callbacks.NUMERIC_SIZE] = temperature


def start(model: mujoco.MjModel, data: mujoco.MjData, position: np.ndarray | None = None) -> None:
    """Put a model's joints at rest at a position (of each: rotor, wave generator, link [rad]; zero by default) at time 0.

    Velocities in the model's state belong to the middle of a step (leapfrog), so the state starts half a step early.

    Args:
      position: shape (3,), or (joints, 3).
    """
    h = model.opt.timestep
    blocks = model.numeric_data.reshape(-1, callbacks.NUMERIC_SIZE)
    given = np.zeros((len(blocks), 3)) if position is None else np.reshape(position, (len(blocks), 3))
    first = [int(block[callbacks.COORDINATE]) for block in blocks]
    for at, angles in zip(first, given, strict=True):
        data.qpos[at : at + 3] = angles
    data.qvel[:] = 0.0
    data.act[:] = 0.0
    with native.quiet():
        mujoco.mj_forward(model, data)
    data.qvel[:] = -0.5 * h * data.qacc
    for block, at, end in zip(blocks, first, [*first[1:], model.nv], strict=True):
        memory = int(block[callbacks.MEMORY])
        data.act[memory : memory + end - at] = -1.5 * h * data.qacc[at:end]
        velocity = data.qvel[at : at + 3].copy()
        data.act[int(block[callbacks.BRISTLE])] = -h * velocity[callbacks.WAVE_GENERATOR]
        p = block[callbacks.HEADER :].copy().view(PARAMETERS)[0]
        if p["hysteresis_torque"] != 0:  # what the first step takes to zero (laws.dahl_step)
            rate = callbacks.transmission_at(data.qpos[at : at + 3].copy(), velocity, 0.0, p).torsion_rate
            x = p["hysteresis_extent"]
            data.act[int(block[callbacks.DAHL])] = -np.sign(rate) * x * np.expm1(abs(rate) * h / x)


def activation(model: mujoco.MjModel, actuator: str) -> int:
    """Address of an actuator's activation (its last one: MuJoCo's bristle stands behind the current)."""
    i = model.actuator(actuator).id
    return int(model.actuator_actadr[i] + model.actuator_actnum[i] - 1)


def set_numbers(spec: mujoco.MjSpec, p: np.void, timestep: float, ideal_current: bool) -> None:
    spec.option.timestep = timestep
    # Nothing touches anything, and no joint has limits.
    spec.option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT | mujoco.mjtDisableBit.mjDSBL_CONTACT)
    # A motion that is not finite stays so, and is seen, instead of beginning again at zero.
    spec.option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    for name, inertia in (("rotor", p["Jm"]), ("wave_generator", p["Jw"])):
        body = spec.body(name)
        body.explicitinertial = True
        body.ipos, body.inertia = [0.0] * 3, [inertia] * 3
    spec.joint("rotor").damping = [0.5 * p["bm"], 0, 0]
    spec.joint("link").damping = [0.5 * p["bl"], 0, 0]
    spec.tendon("flexspline").damping = [0.5 * p["df"], 0, 0]
    spec.tendon("wave_generator").damping = [0.5 * p["dw"], 0, 0]
    _set_link(spec, p)
    motor = spec.actuator("motor")
    Kt = float(p["Kt"])
    if ideal_current:
        motor.set_to_motor()
        motor.forcelimited = False
    else:
        error = motor.set_to_dcmotor(
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
    """Mass of the link [kg] and how far its centre is from the axis [m]: a description states neither, only Mg and Jl."""
    moment, inertia = float(p["Mg"]) / GRAVITY, float(p["Jl"] - laws.flexible_inertia(p))
    if moment <= 0.0:
        return 0.1, 0.0
    # It sits close enough for its own m r² to leave 40 % of the inertia to its shape.
    lever = min(_LEVER, 0.6 * inertia / moment)
    return moment / lever, lever


def _set_link(spec: mujoco.MjSpec, p: np.void) -> None:
    """A mass with the gravity moment, off the link's axis by the gravity angle, and the rest of the inertia as its shape."""
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


def _hang_flexibly(spec: mujoco.MjSpec, p: np.void) -> None:
    """Hang a share of the link's inertia on a spring, `laws.flexible_torque`; half of its damping, as everywhere."""
    inertia = float(laws.flexible_inertia(p))
    body = spec.body("link").add_body(name="flexible")
    body.explicitinertial = True
    body.mass, body.inertia = 1e-6, [inertia] * 3
    joint = body.add_joint(name="flexible", type=mujoco.mjtJoint.mjJNT_HINGE, axis=spec.joint("link").axis)
    joint.stiffness = [laws.flexible_torque(1.0, 0.0, p), 0, 0]
    joint.damping = [0.5 * laws.flexible_torque(0.0, 1.0, p), 0, 0]


def _plain_friction(p: np.void) -> bool:
    """Whether the sliding friction is a function of velocity alone, which MuJoCo's own LuGre can be."""
    return bool(
        p["friction_asymmetry"] == 0
        and p["friction_load"] == 0
        and p["drift_amplitude"] == 0
        and p["friction_temperature"] == 0
        and not np.any(p["friction_amplitude"])
    )


def set_friction(spec: mujoco.MjSpec, p: np.void) -> None:
    """MuJoCo's own LuGre where the sliding friction is a function of velocity alone; the callback's otherwise."""
    friction = spec.actuator("mesh_friction")
    if _plain_friction(p):
        error = friction.set_to_dcmotor(
            motorconst=[0.0, 0.0],
            resistance=1.0,
            lugre=[float(p[name]) for name in ("s0", "s1", "Fc", "Fs", "vs")],
            ctrlspec=int(mujoco.mjtCtrlInput.mjINPUT_NONE),
        )
        if error:
            raise ValueError(error)
    else:
        spec.delete(friction)
        friction = _add_state(spec, "mesh_friction", joint="wave_generator")
    friction.damping = [
        1.0,
        0,
        0,
    ]  # set by `complete`, where it may be negative; zero here would leave it out altogether


def _add_state(spec: mujoco.MjSpec, name: str, joint: str = "link") -> Any:
    """An actuator that exerts nothing and holds one activation, whose rate the callback gives."""
    actuator = spec.add_actuator(name=name, target=joint, trntype=mujoco.mjtTrn.mjTRN_JOINT)
    actuator.dyntype = mujoco.mjtDyn.mjDYN_USER
    actuator.actdim = 1
    actuator.gaintype = mujoco.mjtGain.mjGAIN_FIXED
    actuator.gainprm[0] = 0.0
    actuator.biastype = mujoco.mjtBias.mjBIAS_NONE
    return actuator
