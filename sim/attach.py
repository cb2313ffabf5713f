"""A joint's laws on a hinge of any model: adds rotor, wave generator and the plugin to a `mujoco.MjSpec`."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from ..models import laws
from ..models.dynamics import wave_generator_position
from ..models.errors import InputError, InputWarning, refusing
from ..models.joint import Joint, load_joint
from . import native, plant, plugin

_LONGEST = 1.5  # rad: of the gear's fastest oscillation in a step; the scheme is stable below 2
MASSLESS = 1e-9  # kg: MuJoCo needs a mass


@dataclass(frozen=True)
class Attached:
    """Names in the model of the parts that `attach` added or moved: joints of rotor and wave generator, actuators of
    the motor."""

    rotor: str
    wave_generator: str
    actuators: tuple[str, ...]


@dataclass(frozen=True)
class _Hinge:
    """A hinge of a compiled model: `inertia` about it at qpos0 [kg·m²]; its `range` [rad]; `place`, `axis` in the
    frame of the parent's body."""

    inertia: float
    range: np.ndarray
    place: np.ndarray
    axis: np.ndarray


def attach(spec: mujoco.MjSpec, joint_name: str, joint: str | Path | Joint) -> Attached:
    """Add a joint's laws to a hinge of a MuJoCo model: torsion, wave generator, friction, kinematic error, all effects.

    A rotor and a wave generator are added to the body that carries the hinge. An engine plugin acts between them and the link.
    Actuators on the hinge then turn the rotor through 1/N: controls, gains and limits keep their meaning at the output. A hinge
    without actuator gets a motor `<joint_name>_motor` with winding, whose control is the motor's torque [N·m, motor side]. The
    hinge's own damping, armature and friction loss are replaced. Keyframes are extended. The integrator becomes `implicitfast`
    unless it is `implicit`. The joint's mounting is not used: the model has its own bodies.

    Args:
      spec: the model before it is compiled; changed in place.
      joint_name: of the hinge, which must be the only joint of its body.
      joint: name of a shipped joint, path of a description, or a `Joint`.

    Returns:
      Names in the model: `rotor`, `wave_generator` (joints), `actuators` that turn the rotor.

    Raises:
      InputError: no such hinge; a model that does not compile; a timestep that is too long for the gear, with the limit.
    """
    described = joint if isinstance(joint, Joint) else load_joint(joint)
    return attach_record(spec, joint_name, described.record())


def attach_record(spec: mujoco.MjSpec, joint_name: str, record: np.ndarray) -> Attached:
    """Put the laws of a parameter record, shape (1,), on a hinge; otherwise as `attach`."""
    plugin.register()
    record = record.copy()
    p = record[0]
    _check_hinge(spec, joint_name)
    if p["flexible_share"] > 0:
        p["flexible_share"] = 0.0
        text = f"joint {joint_name!r}: the flexible part of its link is left out, as the model has its own bodies"
        warnings.warn(text, InputWarning, stacklevel=3)
    _check_timestep(spec, joint_name, p)
    before = _compiled(spec)
    hinge = _hinge(before, joint_name)
    p["Jl"], p["Mg"] = hinge.inertia, 0.0  # the model's own weight acts
    trial = spec.copy()
    with refusing(f"joint {joint_name!r}: a part cannot be added"):  # by a name that the model has
        attached = _change(trial, joint_name, record, hinge)
    model = _compiled(trial, keys=False)
    rotor = model.joint(attached.rotor)
    if not np.isclose(model.dof_M0[rotor.dofadr[0]], p["Jm"], rtol=1e-3):
        raise InputError(
            f"joint {joint_name!r}: the model's compiler options change the inertia of the rotor added to it"
        )
    keys = list(_keys(before, model, joint_name, attached, record))
    _change(spec, joint_name, record, hinge)
    for key, values in zip(spec.keys, keys, strict=True):
        for name, value in values.items():
            setattr(key, name, value)
    return attached


def _compiled(spec: mujoco.MjSpec, keys: bool = True) -> mujoco.MjModel:
    copy = spec.copy()
    copy.compiler.fusestatic = False
    if not keys:
        for key in list(copy.keys):
            copy.delete(key)
    with refusing("the model does not compile"), native.quiet():
        return copy.compile()


def _check_hinge(spec: mujoco.MjSpec, name: str) -> None:
    joint = spec.joint(name)
    hinges = [one.name for one in spec.joints if one.type == mujoco.mjtJoint.mjJNT_HINGE]
    if joint is None or joint.type != mujoco.mjtJoint.mjJNT_HINGE:
        raise InputError(f"joint {name!r}: expected a hinge of the model, one of {', '.join(hinges)}")
    if spec.joint(f"{name}_rotor") is not None:
        raise InputError(f"joint {name!r}: expected a hinge without a gear, got one that has {name}_rotor")
    if len(joint.parent.joints) > 1:
        raise InputError(f"joint {name!r}: expected a body with one joint, got {len(joint.parent.joints)}")


def _hinge(model: mujoco.MjModel, name: str) -> _Hinge:
    one = model.joint(name)
    dof, body = int(one.dofadr[0]), int(one.bodyid[0])
    place, axis = np.zeros(3), np.zeros(3)
    mujoco.mju_rotVecQuat(place, one.pos, model.body_quat[body])
    mujoco.mju_rotVecQuat(axis, one.axis, model.body_quat[body])
    inertia = float(model.dof_M0[dof] - model.dof_armature[dof])
    return _Hinge(inertia, one.range, model.body_pos[body] + place, axis)


def _check_timestep(spec: mujoco.MjSpec, name: str, p: np.void) -> None:
    # The fastest oscillation is the wave generator's where the motor gives all it has.
    peak = laws.wave_generator_torsion(p["Kt"] * p["current_limit"], p)
    between = laws.wave_generator_stiffness(peak, p)
    to_link = max(p["K1"], p["K2"], p["K3"]) / p["N"] ** 2
    root = 1.0 / np.sqrt([p["Jm"], p["Jw"]])
    stiffness = np.array([[between, -between], [-between, between + to_link]])
    fastest = float(np.sqrt(np.linalg.eigvalsh(stiffness * np.outer(root, root))[-1]))
    if spec.option.timestep * fastest > _LONGEST:
        raise InputError(
            f"joint {name!r}: option.timestep: expected at most {_LONGEST / fastest:.2g} s, as its gear oscillates with "
            f"{fastest / (2 * np.pi):.0f} Hz at the motor's peak torque, got {spec.option.timestep:g} s"
        )


def _change(spec: mujoco.MjSpec, name: str, record: np.ndarray, hinge: _Hinge) -> Attached:
    p, prefix = record[0], f"{name}_"
    if spec.option.integrator not in (mujoco.mjtIntegrator.mjINT_IMPLICIT, mujoco.mjtIntegrator.mjINT_IMPLICITFAST):
        spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    link = spec.joint(name)
    carrier = link.parent.parent
    blank = mujoco.MjSpec()
    for part, inertia in (("rotor", p["Jm"]), ("wave_generator", p["Jw"])):
        body = carrier.add_body(name=prefix + part, pos=hinge.place, mass=MASSLESS)
        body.explicitinertial = True
        body.ipos, body.inertia = [0.0] * 3, [float(inertia)] * 3
        turn = body.add_joint(name=prefix + part, type=mujoco.mjtJoint.mjJNT_HINGE, axis=hinge.axis)
        _without_defaults(turn, blank.worldbody.add_body().add_joint(), "axis", "type")
        turn.ref = p["N"] * link.ref
    link.damping, link.armature, link.frictionloss = [0.5 * float(p["bl"]), 0, 0], 0.0, 0.0
    plant.put_laws(spec, record, prefix, name)
    moved = [one for one in spec.actuators if one.target == name and one.trntype in _AT_JOINT]
    for one in moved:
        if one.inheritrange > 0:  # it still commands the hinge's angle
            one.ctrlrange = np.mean(hinge.range) + 0.5 * one.inheritrange * np.ptp(hinge.range) * np.array([-1.0, 1.0])
            one.inheritrange = 0.0
        one.target, one.gear = prefix + "rotor", one.gear / p["N"]
    if not moved:
        moved = [spec.add_actuator(name=prefix + "motor", target=prefix + "rotor", trntype=mujoco.mjtTrn.mjTRN_JOINT)]
        _without_defaults(moved[0], blank.add_actuator(), "target", "trntype")
        plant.set_motor(moved[0], p)
    return Attached(prefix + "rotor", prefix + "wave_generator", tuple(one.name for one in moved))


def _without_defaults(element: Any, blank: Any, *kept: str) -> None:
    own = {"classname", "compiler", "frame", "id", "info", "name", "parent", "plugin", "signature", "userdata", *kept}
    for name in dir(element):
        if not name.startswith("_") and name not in own and not callable(getattr(element, name)):
            setattr(element, name, getattr(blank, name))


_AT_JOINT = (mujoco.mjtTrn.mjTRN_JOINT, mujoco.mjtTrn.mjTRN_JOINTINPARENT)


def _keys(
    before: mujoco.MjModel, after: mujoco.MjModel, name: str, attached: Attached, record: np.ndarray
) -> Iterator[dict[str, np.ndarray]]:
    """Yield the keyframes of a model with another gear, with its motor side at the hinge's angle."""
    added = [after.joint(one) for one in (attached.rotor, attached.wave_generator)]
    hinge = before.joint(name)
    for k in range(before.nkey):
        values = {"act": np.zeros(after.na), "ctrl": np.zeros(after.nu)}
        for field, old in (("act", before.key_act[k]), ("ctrl", before.key_ctrl[k])):
            values[field][: len(old)] = old  # an actuator that was added is the last
        for field, address, size, old in (
            ("qpos", "qposadr", after.nq, before.key_qpos[k]),
            ("qvel", "dofadr", after.nv, before.key_qvel[k]),
        ):
            new = np.array([int(getattr(one, address)[0]) for one in added])
            values[field] = np.zeros(size)
            values[field][np.setdiff1d(np.arange(size), new)] = old
            value = old[getattr(hinge, address)[0]]
            values[field][new] = (
                wave_generator_position(value, record[0]) if field == "qpos" else record[0]["N"] * value
            )
        yield values


def align(model: mujoco.MjModel, data: mujoco.MjData) -> mujoco.MjData:
    """Turn the rotors and wave generators of attached joints to their links' positions, after a change of `data.qpos`.

    Args:
      model: with attached joints.
      data: of that model; changed in place.

    Returns:
      The same data: positions [rad] and velocities [rad/s] of the motor sides are N times the links', without torsion.

    Raises:
      InputError: a model without attached joints.
    """
    plugin.register()
    gears = [i for i in range(model.nplugin) if model.plugin[i] == plugin.slot()]
    if not gears:
        raise InputError("model: expected one with attached joints, got one without")
    for i in gears:
        (positions, velocities), record = plugin.instance(data, i)
        p, link = record[0], plugin.LINK
        data.qpos[positions[:link]] = wave_generator_position(data.qpos[positions[link]], p)
        data.qvel[velocities[:link]] = p["N"] * data.qvel[velocities[link]]
        memory = data.plugin_state[model.plugin_stateadr[i] :]
        memory[plugin.MEMORY : plugin.MEMORY + 3] = data.qvel[velocities]
    return data
