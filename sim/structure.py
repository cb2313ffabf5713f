"""What a joint's MJCF may say: how it looks, and where its bodies are. Everything that acts is the description's.

The MJCF is a file of its own, which opens in any MuJoCo viewer and may be anybody's. Numbers that the joint's description
states too (inertias, dampings, stiffnesses, the motor) are replaced by the description's. Whatever else would act on the
joint, such as a spring at a joint, another actuator, another gravity, is refused, by name; and so that nothing is
overlooked, the built model's accelerations are compared with the equations of motion (`check_motion`).
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from ..models import dynamics, laws
from ..models.errors import InputError
from ..models.mjcf import check_mjcf
from ..models.parameters import GRAVITY
from . import native
from .plugin import (
    BRISTLE,
    DAHL,
    FLEXIBLE,
    LINK,
    MEMORY,
    TEMPERATURE,
    WAVE_GENERATOR,
    at_positions,
    reduced_inertia,
)  # fmt: skip

JOINTS = ("rotor", "wave_generator", "link")
"""The joints of every joint's MJCF, in this order."""
_AXIS = (0.0, -1.0, 0.0)

# What may differ from MuJoCo's defaults: names, looks, and the numbers that the description replaces.
_BOOKKEEPING = {"name", "classname", "compiler", "frame", "id", "info", "parent", "signature", "userdata", "group"}
_JOINT = _BOOKKEEPING | {"axis", "align", "damping"}
_TENDON = _BOOKKEEPING | {"stiffness", "damping", "springlength", "path", "material", "rgba", "width"}
_ACTUATOR = _BOOKKEEPING | {
    "actdim", "actearly", "actlimited", "biasprm", "biastype", "ctrlspec", "damping", "dynprm", "dyntype", "forcelimited",
    "forcerange", "gainprm", "gaintype", "plugin", "target", "trntype", "type",
}  # fmt: skip
_SENSOR = _BOOKKEEPING | {"plugin", "objname", "objtype", "type", "datatype", "needstage", "dim"}
_OPTIONS = ("wind", "density", "viscosity", "disableflags", "enableflags", "disableactuator")
_COMPILER = ("inertiafromgeom", "inertiagrouprange", "boundmass", "boundinertia", "balanceinertia", "settotalmass")


def read(path: Path) -> mujoco.MjSpec:
    """Read a joint's MJCF.

    Raises:
      InputError: a file that cannot be read, names files outside its folder, is not a joint's, or acts; one line.
    """
    check_mjcf(path)
    try:
        with native.quiet():
            spec = mujoco.MjSpec.from_file(str(path))
    except ValueError as error:
        raise InputError(f"{path}: not a readable MJCF: {' '.join(str(error).split())}") from error
    _check_structure(spec, path)
    _check_nothing_acts(spec, path)
    return spec


def _check_structure(spec: mujoco.MjSpec, path: Path) -> None:
    names = [joint.name for joint in spec.joints]
    if tuple(names) != JOINTS:
        raise InputError(
            f"{path}: expected the joints {', '.join(JOINTS)} in this order, got {', '.join(names) or 'none'}"
        )
    for what, found, expected in (
        ("tendon", [t.name for t in spec.tendons], ["flexspline", "wave_generator"]),
        ("actuator", [a.name for a in spec.actuators], ["motor", "mesh_friction"]),
    ):
        if found != expected:
            raise InputError(
                f"{path}: expected the {what}s {' and '.join(expected)} alone, in this order, got {', '.join(found) or 'none'}"
            )
    _check_tendons(spec, path)
    for name in ("rotor", "wave_generator", "flange", "link"):
        if spec.body(name) is None:
            raise InputError(f"{path}: expected a body {name!r}, got none")
    for name in ("force", "torque"):
        sensor = spec.sensor(name)
        if sensor is None or sensor.objname != "force_torque":
            raise InputError(f"{path}: expected a {name} sensor {name!r} at the site 'force_torque', got none")
    for name, joint in (("motor", "rotor"), ("mesh_friction", "wave_generator")):
        actuator = spec.actuator(name)
        if actuator.trntype != mujoco.mjtTrn.mjTRN_JOINT or actuator.target != joint:
            raise InputError(f"{path}: actuator {name}: expected one at the joint {joint!r}, got {actuator.target!r}")


def _check_nothing_acts(spec: mujoco.MjSpec, path: Path) -> None:
    """Raise for the first thing in a joint's MJCF that acts and that its description does not state."""
    if not np.allclose(spec.option.gravity, [0, 0, -GRAVITY]):
        raise InputError(f"{path}: option.gravity: expected 0 0 -{GRAVITY}, got {_shown(spec.option.gravity)}")
    plain = mujoco.MjSpec()
    body = plain.worldbody.add_body(name="plain")
    _compare(path, "option", spec.option, plain.option, _OPTIONS)
    _compare(path, "compiler", spec.compiler, plain.compiler, _COMPILER)
    for what in ("equalities", "flexes", "plugins", "numerics"):
        if len(getattr(spec, what)):
            raise InputError(f"{path}: expected no {what}, got {len(getattr(spec, what))}")
    joint = body.add_joint(name="plain")
    for one in spec.joints:
        _compare(path, f"joint {one.name}", one, joint, _others(joint, _JOINT))
        if not np.allclose(one.axis, _AXIS):
            raise InputError(f"{path}: joint {one.name}.axis: expected 0 -1 0, got {_shown(one.axis)}")
    if np.any(spec.joint("wave_generator").damping):  # the others' is replaced
        raise InputError(f"{path}: joint wave_generator.damping: expected 0 (bw is the friction's), got another")
    for one in spec.bodies[1:]:
        _compare(path, f"body {one.name}", one, body, ("gravcomp", "mocap"))
    tendon = plain.add_tendon(name="plain")
    for one in spec.tendons:
        _compare(path, f"tendon {one.name}", one, tendon, _others(tendon, _TENDON))
    actuator = plain.add_actuator(name="plain")
    for one in spec.actuators:
        _compare(path, f"actuator {one.name}", one, actuator, _others(actuator, _ACTUATOR))
    sensor = plain.add_sensor(name="plain")
    for name in ("force", "torque"):
        _compare(path, f"sensor {name}", spec.sensor(name), sensor, _others(sensor, _SENSOR))


def _others(element: Any, known: set[str]) -> list[str]:
    """Names of an element's fields but for those that are known to do no harm."""
    found = []
    for name in dir(element):
        if not name.startswith("_") and name not in known and not callable(getattr(element, name)):
            found.append(name)
    return found


def _compare(path: Path, what: str, element: Any, plain: Any, names: Iterable[str]) -> None:
    for name in names:
        got, expected = getattr(element, name), getattr(plain, name)
        a, b = np.asarray(got), np.asarray(expected)
        same = np.array_equal(a, b, equal_nan=True) if a.dtype.kind == "f" else np.array_equal(a, b)
        if not same:
            raise InputError(f"{path}: {what}.{name}: expected {_shown(expected)}, as it would act, got {_shown(got)}")


def _shown(value: Any) -> str:
    if isinstance(value, np.ndarray):
        return " ".join(f"{x:g}" for x in value)
    return f"{value:g}" if isinstance(value, float) else str(value)


def _check_tendons(spec: mujoco.MjSpec, path: Path) -> None:
    """Raise where the tendons are not the torsions of flexspline and wave generator, Eq. (1)."""
    for name, joints, coefficients in (
        ("flexspline", ("wave_generator", "link"), (None, -1.0)),
        ("wave_generator", ("rotor", "wave_generator"), (1.0, -1.0)),
    ):
        wraps = list(spec.tendon(name).path)
        found = tuple(one.target.name if one.type == mujoco.mjtWrap.mjWRAP_JOINT else "" for one in wraps)
        if found != joints:
            raise InputError(
                f"{path}: tendon {name}: expected the joints {' and '.join(joints)}, got {', '.join(found)}"
            )
        for one, expected in zip(wraps, coefficients, strict=True):
            if expected is not None and one.coef != expected:
                raise InputError(
                    f"{path}: tendon {name}: expected the coefficient {expected:g} of {one.target.name}, got {one.coef:g}"
                )


_STATES = (
    (0.3, 0.28, 0.0021, 4.0, 3.5, 0.05),
    (-57.1, -57.12, -0.5719, -30.0, -31.0, -0.2),
    (160.0, 160.01, 1.6, 0.2, 9.0, 0.4),
)
"""States in which a model is checked: positions and velocities of rotor, wave generator (of a ratio of 100) and link."""
_CLOSE = 1e-6


def check_motion(model: mujoco.MjModel, record: np.ndarray, path: Path, locked: float = 0.0) -> None:
    """Compare a built model's accelerations with the equations of motion of its description.

    Whatever acts in an MJCF and has no place in the equations shows here, whichever element it comes from; so does the
    torque that the sensor reads about the joint's axis.

    Args:
      model: of `plant.build`; record: its parameters, shape (1,); path: of its MJCF, for messages; locked: inertia that
        locks the rotor [kg·m²].
    """
    p = record[0]
    h = model.opt.timestep
    data = mujoco.MjData(model)
    memory = data.plugin_state
    current_at = int(model.actuator_actadr[model.actuator("motor").id])
    torque_at = int(model.sensor("torque").adr[0])
    for numbers in _STATES:
        theta, velocity = np.array(numbers[:3]), np.array(numbers[3:])
        # Torsions are those of a ratio of 100; of another the same.
        theta[LINK] += theta[WAVE_GENERATOR] * (1.0 / p["N"] - 0.01)
        bristle, dahl, current = 0.3 * p["Fc"] / p["s0"] if p["s0"] > 0 else 0.0, 0.0, 0.2 * p["current_limit"]
        data.qpos[:3], data.qvel[:3], data.act[:] = theta, velocity, 0.0
        if model.nv > FLEXIBLE:
            data.qpos[FLEXIBLE], data.qvel[FLEXIBLE] = 1e-3, 0.02
        memory[MEMORY : MEMORY + model.nv] = data.qvel
        if p["hysteresis_torque"] != 0:
            dahl = 0.3 * p["hysteresis_extent"]
        memory[BRISTLE], memory[DAHL] = bristle, dahl
        if current_at >= 0:
            data.act[current_at], data.ctrl[0] = current, 0.0
        else:
            data.ctrl[0] = p["Kt"] * current
        with native.quiet():
            mujoco.mj_forward(model, data)
        state, t, g = at_positions(theta, velocity, velocity, bristle, dahl, 0.0, h, memory[TEMPERATURE], p)
        b = dynamics.balance_with(state, t, g, p)
        drive = float(data.actuator_force[model.actuator("motor").id])  # its current, within a step, is MuJoCo's own
        force, inertia = _expected(b, drive, data, p, h, locked)
        expected = np.linalg.solve(inertia, force)
        error = inertia @ (data.qacc - expected)
        scale = (
            np.abs(force) + abs(b.wave_generator_torque) + np.r_[0.0, 0.0, np.full(model.nv - 2, abs(b.load) + p["Mg"])]
        )
        wrong = np.flatnonzero(~(np.abs(error) <= _CLOSE * scale + 1e-12))
        if len(wrong):
            name = model.joint(int(wrong[0])).name
            raise InputError(
                f"{path}: something in it acts that the joint's description does not state: {name} accelerates by "
                f"{data.qacc[wrong[0]]:.6g} rad/s², expected {expected[wrong[0]]:.6g} rad/s²"
            )
        # The torque that the sensor reads about y, against the axis: what moves link and hanging part against their weight.
        through = p["Jl"] * data.qacc[LINK] - b.gravity
        if model.nv > FLEXIBLE:
            through += laws.flexible_inertia(p) * data.qacc[FLEXIBLE]
        reading = data.sensordata[torque_at + 1]
        if not abs(reading + through) <= 1e-3 * (abs(through) + abs(b.load)):
            raise InputError(
                f"{path}: sensor torque: expected {-through:.6g} N·m about its y, the joint's axis, got {reading:.6g} N·m"
            )


def _expected(
    b: Any, drive: float, data: mujoco.MjData, p: np.void, h: float, locked: float
) -> tuple[np.ndarray, np.ndarray]:
    """Generalised forces and inertia matrix of the joint's coordinates, with the plant's corrections of order h²."""
    force = np.array([b.on_rotor + drive, b.on_wave_generator, b.on_link])
    inertia = np.diag([p["Jm"] + locked, p["Jw"], p["Jl"]])
    reduced = reduced_inertia(p)
    more = h**2 / 12 * p["K1"] / reduced * p["df"] * b.torsion_rate
    force[WAVE_GENERATOR] -= more * b.ratio
    force[LINK] += more
    across = np.array([0.0, 1.0 / p["N"], -1.0])
    inertia += (
        h**2 / 12 * (p["K1"] + p["df"] ** 2 / reduced) * np.diag(across**2)
    )  # MuJoCo has no entry across branches
    if data.qpos.size > FLEXIBLE:
        hanging = laws.flexible_inertia(p)
        force = np.append(force, -laws.flexible_torque(data.qpos[FLEXIBLE], data.qvel[FLEXIBLE], p))
        whole = np.zeros((4, 4))
        whole[:3, :3] = inertia
        whole[LINK, FLEXIBLE] = whole[FLEXIBLE, LINK] = whole[FLEXIBLE, FLEXIBLE] = hanging
        inertia = whole
    return force, inertia
