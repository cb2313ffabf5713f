"""The masses and joints of an arm: read from an MJCF or a URDF, reduced to some of its hinges, and written."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ElementTree
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path

import mujoco
import numpy as np

from .arm import ArmPayload
from .errors import InputError, nearest, read_text, refusing
from .mjcf import check_mjcf, xml_root
from .parameters import GRAVITY

_GRAVITY_SLACK = 0.02
_HINGE, _SLIDE = int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE)
_COMMENTS = re.compile(r"<!--.*?-->|<\?.*?\?>", re.DOTALL)


def read(path: Path) -> mujoco.MjModel:
    """Return the model of an MJCF, or of a URDF without its looks: their meshes may be missing. Raises `InputError`: a
    file that cannot be read, or whose gravity is another; one line."""
    text = read_text(path, "an MJCF or URDF file")
    urdf = _COMMENTS.sub("", text).lstrip().startswith("<robot")
    if urdf:
        root = xml_root(path, text, "a URDF")
        for link in root.iter("link"):
            for look in [one for one in link if one.tag in ("visual", "collision")]:
                link.remove(look)
        text = ElementTree.tostring(root, encoding="unicode")
    else:
        check_mjcf(path)
    with refusing(f"{path}: not a readable MJCF or URDF"):
        spec = mujoco.MjSpec.from_string(text) if urdf else mujoco.MjSpec.from_file(str(path))
    return compiled(spec, path)


def compiled(spec: mujoco.MjSpec, path: Path) -> mujoco.MjModel:
    """Return a model with its masses only; `path`: for messages. Raises `InputError`."""
    spec.compiler.fusestatic = False  # payloads name bodies
    flags = int(spec.option.disableflags)
    with refusing(f"{path}: not a readable MJCF or URDF"):
        model = spec.compile()
    if flags & int(mujoco.mjtDisableBit.mjDSBL_GRAVITY):
        raise InputError(f"{path}: option.flag.gravity: expected gravity, which is disabled")
    strength = float(np.linalg.norm(model.opt.gravity))
    if abs(strength - GRAVITY) > _GRAVITY_SLACK * GRAVITY:
        raise InputError(f"{path}: option.gravity: expected {GRAVITY} m/s² in some direction, got {strength:g} m/s²")
    model.dof_armature[:] = 0.0
    model.tendon_armature[:] = 0.0
    return model


def written(model: mujoco.MjModel, kept: Collection[int] | None = None, q: np.ndarray | None = None) -> str:
    """Return masses and joints of a model, as the text of an MJCF without looks and files; `kept`: joints that remain,
    all by default; the others are fixed at their positions in q, shape (nq,)."""
    m = model
    kept = range(m.njnt) if kept is None else kept
    fixed = [j for j in range(m.njnt) if j not in kept]
    data = mujoco.MjData(m)
    if q is not None:
        data.qpos[:] = q
    mujoco.mj_kinematics(m, data)
    root = ElementTree.Element("mujoco", model="arm")
    ElementTree.SubElement(root, "compiler", angle="radian", autolimits="true")
    ElementTree.SubElement(root, "option", gravity=numbers(m.opt.gravity))
    bodies = [ElementTree.SubElement(root, "worldbody")]
    for i in range(1, m.nbody):
        name = {"name": m.body(i).name} if m.body(i).name else {}
        pos, quat = m.body_pos[i], m.body_quat[i]
        if i in m.jnt_bodyid[fixed]:
            pos, quat = _within(data, i, int(m.body_parentid[i]))
        body = ElementTree.SubElement(bodies[m.body_parentid[i]], "body", name, pos=numbers(pos), quat=numbers(quat))
        bodies.append(body)
        for j in range(m.body_jntadr[i], m.body_jntadr[i] + m.body_jntnum[i]):
            if j in kept:
                kind = "hinge" if int(m.jnt_type[j]) == _HINGE else "slide"
                ElementTree.SubElement(
                    body, "joint", name=m.joint(j).name, type=kind, pos=numbers(m.jnt_pos[j]), axis=numbers(m.jnt_axis[j]),
                    ref=numbers(m.qpos0[m.jnt_qposadr[j]]),
                )  # fmt: skip
        if m.body_mass[i] > 0.0:
            ElementTree.SubElement(
                body, "inertial", pos=numbers(m.body_ipos[i]), quat=numbers(m.body_iquat[i]),
                mass=numbers(m.body_mass[i]), diaginertia=numbers(m.body_inertia[i]),
            )  # fmt: skip
        for k in np.flatnonzero(m.site_bodyid == i):
            if m.site(k).name:
                places = {"pos": numbers(m.site_pos[k]), "quat": numbers(m.site_quat[k])}
                ElementTree.SubElement(body, "site", places, name=m.site(k).name)
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode") + "\n"


def reduced(
    path: Path, hinges: Sequence[str], positions: Mapping[str, float], where: str
) -> tuple[str, np.ndarray, list[str]]:
    """Return an MJCF of the masses of an arm with some hinges of a model, these hinges' ranges, and what they lose.

    Args:
      path: of the MJCF or URDF.
      hinges: that move, by name; each the only joint of its body.
      positions: of other joints [rad], [m], by name; those without one are held where the model has them.
      where: start of messages about names.

    Returns:
      The text, as of `written`; ranges, shape (hinges, 2) [rad], infinite without limits; what is lost, in words.

    Raises:
      InputError: a file that is no model, other names or joints than that, a closed chain; one line.
    """
    model = read(path)
    names = [model.joint(i).name for i in range(model.njnt)]
    turning = [name for name, kind in zip(names, model.jnt_type, strict=True) if int(kind) == _HINGE and name]
    for i, name in enumerate(hinges):
        if name not in turning:
            other = f", got {name!r}, which is another kind of joint" if name in names else f", got {name!r}"
            hint = nearest(name, turning) if name not in names else ""
            raise InputError(f"{where}: arm.{i}.name: expected a hinge of {path}, one of {turning}{other}{hint}")
        joint = model.joint(name)
        many = int(model.body_jntnum[model.jnt_bodyid[joint.id]])
        if many > 1:
            raise InputError(
                f"{where}: arm.{i}.name: expected a hinge that is the only joint of its body in {path}, got {name!r}, whose "
                f"body has {many}"
            )
        if joint.stiffness[0] != 0.0:
            raise InputError(
                f"{where}: arm.{i}.name: expected a hinge without a spring in {path}, got {name!r} with stiffness "
                f"{joint.stiffness[0]:g} (a joint's description can have a cable spring)"
            )
    kept = [model.joint(name).id for name in hinges]
    _check_open(model, set(kept), path)
    q = model.qpos0.copy()
    held = [n for n, kind in zip(names, model.jnt_type, strict=True) if int(kind) in (_HINGE, _SLIDE) and n]
    held = [name for name in held if name not in hinges]
    for name, value in positions.items():
        if name not in held:
            raise InputError(
                f"{where}: positions.{name}: expected a joint of {path} without an entry in `arm`, one of {held}, got "
                f"{name!r}{nearest(name, held)}"
            )
        low, high = _range(model, name)
        if not low <= value <= high:
            raise InputError(
                f"{where}: positions.{name}: expected {low:g} to {high:g}, its range in {path}, got {value:g}"
            )
        q[model.joint(name).qposadr[0]] = value
    return written(model, kept, q), np.array([_range(model, name) for name in hinges]), _replaced(model, hinges)


def put_payloads(spec: mujoco.MjSpec, payloads: Sequence[ArmPayload], where: str) -> list[mujoco.MjsBody]:
    """Add payloads to an arm, as of `written`, as bodies without mass; `weigh` sets it. Return the bodies. Raises
    `InputError`: a payload's body does not exist; `where`: start of the message."""
    added = []
    for i, one in enumerate(payloads):
        site, body, place = spec.site(one.body), spec.body(one.body), np.array(one.position)
        if site is not None:
            body, turned = site.parent, np.zeros(3)
            mujoco.mju_rotVecQuat(turned, place, site.quat)
            place = site.pos + turned
        if body is None:
            names = [other.name for other in (*spec.bodies[1:], *spec.sites) if other.name]
            raise InputError(
                f"{where}payloads.{i}.body: expected a body or site of the arm, one of {names}, got {one.body!r}"
                f"{nearest(one.body, names)}"
            )
        added.append(body.add_body(name=f"payload_{i}", pos=place))
        added[-1].explicitinertial, added[-1].ipos = True, [0.0] * 3
    return added


def weigh(bodies: Sequence[mujoco.MjsBody], payloads: Sequence[ArmPayload], carried: Sequence[bool]) -> None:
    """Set the masses of payloads, of `put_payloads`: their own while they are carried, else none."""
    for body, one, on in zip(bodies, payloads, carried, strict=True):
        body.mass, body.inertia = one.mass * on, [one.inertia * on] * 3


def _replaced(model: mujoco.MjModel, hinges: Sequence[str]) -> list[str]:
    """Return what a model has on hinges that the joints of an arm replace."""
    found, kinds = [], (int(mujoco.mjtTrn.mjTRN_JOINT), int(mujoco.mjtTrn.mjTRN_JOINTINPARENT))
    for name in hinges:
        joint = model.joint(name)
        mine = [
            i for i in range(model.nu) if model.actuator_trntype[i] in kinds and model.actuator_trnid[i, 0] == joint.id
        ]
        found += [f"actuator {model.actuator(i).name or i}" for i in mine]
        found += [f"{what} of joint {name}" for what in ("damping", "frictionloss") if np.any(getattr(joint, what))]
    return found


def _range(model: mujoco.MjModel, name: str) -> tuple[float, float]:
    joint = model.joint(name)
    return (float(joint.range[0]), float(joint.range[1])) if model.jnt_limited[joint.id] else (-np.inf, np.inf)


def _check_open(model: mujoco.MjModel, moving: set[int], path: Path) -> None:
    """Refuse constraints between moving joints: inverse dynamics of a tree do not have them."""
    before = [set[int]()]  # moving joints before each body, with its own
    for i in range(1, model.nbody):
        own = range(model.body_jntadr[i], model.body_jntadr[i] + model.body_jntnum[i])
        before.append(before[model.body_parentid[i]] | moving.intersection(own))
    joint, tendon = int(mujoco.mjtEq.mjEQ_JOINT), int(mujoco.mjtEq.mjEQ_TENDON)
    for k in np.flatnonzero(model.eq_active0):
        kind, pair = int(model.eq_type[k]), (int(model.eq_obj1id[k]), int(model.eq_obj2id[k]))
        if kind == joint:
            closed = not moving.isdisjoint(pair)
        elif kind == tendon:
            closed = True
        else:
            bodies = pair
            if int(model.eq_objtype[k]) == int(mujoco.mjtObj.mjOBJ_SITE):
                bodies = (int(model.site_bodyid[pair[0]]), int(model.site_bodyid[pair[1]]))
            closed = before[bodies[0]] != before[bodies[1]]
        if closed:
            name = model.equality(k).name or f"{k}"
            raise InputError(
                f"{path}: equality {name}: expected a tree of joints, got a constraint on a joint of `arm`"
            )


def _within(data: mujoco.MjData, body: int, parent: int) -> tuple[np.ndarray, np.ndarray]:
    """Return place and orientation of a body in its parent."""
    back, pos, quat = np.zeros(4), np.zeros(3), np.zeros(4)
    mujoco.mju_negQuat(back, data.xquat[parent])
    mujoco.mju_rotVecQuat(pos, data.xpos[body] - data.xpos[parent], back)
    mujoco.mju_mulQuat(quat, back, data.xquat[body])
    return pos, quat


def numbers(values: Sequence[float] | np.ndarray | float) -> str:
    """Return numbers as an attribute of an MJCF, to the bit."""
    return " ".join(repr(float(x)) for x in np.atleast_1d(values))
