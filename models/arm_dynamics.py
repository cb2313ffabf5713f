"""The load on a joint of an arm: inertia, weight and torque of other joints' motion, from an MJCF or a URDF.

MuJoCo's inverse dynamics of the arm give the torque of one joint (Featherstone's recursive Newton–Euler algorithm),

    τ = M_jj(q) θ'' + Σ_o M_jo(q) q_o'' + c_j(q, q') + g_j(q),

and this project's joint has Jl θl'' = Ts − Mg sin(θl + gravity angle) + τext. While the other joints o are at rest,
M_jj is constant, c_j is zero and the weight of a rigid tree about a fixed axis is a sine of the joint's angle: the
arm is exactly a `Mounting`. While they move, inertia is an array, and the rest is a known torque on the link in
addition to the weight of that mounting: a `Load`.

That holds for any axes and any tree. Angles are the model's: its zero is the joint's zero, its axis the positive
direction, and `gravity_angle` is the angle of the weight. Only masses, inertias and gravity of the model count. Its
dampings, armatures, actuators and limits do not: the joint's description has the drive.

Masses and joints of an arm are read from an MJCF or a URDF, reduced to some of its hinges, and written.
"""

from __future__ import annotations

import math
import re
import xml.etree.ElementTree as ElementTree
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path

import mujoco
import numpy as np

from .arm import ArmPayload, ArmSpec, Load, carried_at
from .errors import InputError, nearest, read_text, refusing
from .joint import shipped
from .joint_parts import Mounting
from .mjcf import check_mjcf, xml_root
from .motion import differentiated
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


STILL = 1e-3  # range of an angle [rad] within which another joint of the arm is at rest
_WEIGHTLESS = 1e-9  # N·m


class Arm:
    """An arm, in the MJCF or URDF `path`, and one joint of it; `others`: names of the other joints."""

    def __init__(self, spec: ArmSpec, source: Path | str):
        """Read the MJCF or URDF in the folder `source`, or shipped; or else `source` is the text of an MJCF, and `spec.model`
        its name in messages. Raises `InputError`: no such file or joint, or not an arm of hinges and slides under gravity;
        one line."""
        if isinstance(source, Path):
            path = _find(spec.model, source)
            model = read(path)
        else:
            path = Path(spec.model)
            model = compiled(mujoco.MjSpec.from_string(source), path)
        self.spec, self.path, self._model = spec, path, model
        for i in range(model.njnt):
            if int(model.jnt_type[i]) not in (_HINGE, _SLIDE):
                raise InputError(
                    f"{path}: joint {model.joint(i).name}: expected an arm of hinges and slides, got another kind"
                )
        self._plants: dict[tuple[bool, ...], tuple[mujoco.MjModel, mujoco.MjData]] = {}
        self._carrying((True,) * len(spec.payloads))  # checks them
        names = [model.joint(i).name for i in range(model.njnt)]
        if spec.joint not in names:
            raise InputError(
                f"{path}: arm.joint: expected one of {names}, got {spec.joint!r}{nearest(spec.joint, names)}"
            )
        self._joint = names.index(spec.joint)
        self._diagonal = int(model.M_rowadr[self._joint] + model.M_rownnz[self._joint] - 1)
        if int(model.jnt_type[self._joint]) != _HINGE:
            raise InputError(f"{path}: arm.joint: expected a hinge, {spec.joint!r} is another kind of joint")
        self.others = tuple(name for name in names if name != spec.joint)
        for name in spec.positions:
            self._at(name, "arm.positions")

    def _carrying(self, carried: tuple[bool, ...]) -> tuple[mujoco.MjModel, mujoco.MjData]:
        """Return the arm with some of its payloads."""
        if carried not in self._plants:
            spec = mujoco.MjSpec.from_string(self.mjcf())
            weigh(put_payloads(spec, self.spec.payloads, f"{self.path}: arm."), self.spec.payloads, carried)
            model = compiled(spec, self.path)
            self._plants[carried] = model, mujoco.MjData(model)
        return self._plants[carried]

    def mounting(self, positions: Mapping[str, float] | None = None) -> Mounting:
        """Return the mounting of the joint without payloads while the others are at rest at `positions` [rad] (by default
        those of the YAML)."""
        q = self._pose(positions or {})
        weight = []
        for angle in (0.0, 0.5 * math.pi):
            q[self._joint] = angle
            still = np.zeros((1, len(q)))
            (inertia,), (torque,) = self._dynamics(q[None], still, still, (False,) * len(self.spec.payloads))
            weight.append(float(torque))
        if inertia <= 0.0:
            raise InputError(f"{self.path}: arm.joint: expected masses that {self.spec.joint!r} moves, got none")
        # Mg sin(θ + γ) at 0 and a quarter turn.
        moment = math.hypot(*weight)
        if moment < _WEIGHTLESS:  # a vertical axis
            return Mounting(inertia=float(inertia), gravity_moment=0.0)
        return Mounting(inertia=float(inertia), gravity_moment=moment, gravity_angle=math.atan2(*weight))

    def of(
        self,
        time: np.ndarray,
        position: np.ndarray,
        positions: Mapping[str, np.ndarray],
        parts: tuple[slice, ...],
        stamps: np.ndarray | None = None,
    ) -> tuple[Mounting, Load | None]:
        """Return mounting and load of a recording; only a mounting if the other joints are at rest without payloads.

        Args:
          time, position: of the joint, shape (n,) each [s], [rad]; `positions`: of other joints, by name.
          parts: samples between gaps.
          stamps: to which the times of payloads belong, shape (n,) [s]; `time` by default.
        """
        carried = carried_at(self.spec.payloads, time if stamps is None else stamps)
        for name in positions:
            self._at(name, "column")
        mounting = self.mounting({name: float(np.median(angle)) for name, angle in positions.items()})
        if all(float(np.ptp(angle)) <= STILL for angle in positions.values()) and not np.any(carried):
            return mounting, None
        q = np.tile(self._pose({}), (len(time), 1))
        v, a = np.zeros_like(q), np.zeros_like(q)
        for name, angle in {self.spec.joint: position, **positions}.items():
            i = self._joint if name == self.spec.joint else self._at(name, "column")
            for part in parts:
                q[part, i], v[part, i], a[part, i] = differentiated(time[part], angle[part])
        q[:, self._joint] = position
        own = a[:, self._joint].copy()
        a[:, self._joint] = 0.0  # τ without inertia times the joint's own acceleration
        inertia, torque = np.zeros(len(time)), np.zeros(len(time))
        for state in np.unique(carried, axis=1).T:
            at = np.flatnonzero(np.all(carried.T == state, axis=1))
            inertia[at], torque[at] = self._dynamics(q[at], v[at], a[at], tuple(state.tolist()))
        weight = mounting.gravity_moment * np.sin(position + mounting.gravity_angle)
        return mounting, Load(inertia, weight - torque, own)

    def mjcf(self) -> str:
        """Return its masses and joints, as the text of an MJCF without looks and files."""
        return written(self._model)

    def _at(self, name: str, where: str) -> int:
        if name not in self.others:
            raise InputError(
                f"{self.path}: {where}: expected another joint of the arm, one of {list(self.others)}, got {name!r}"
                f"{nearest(name, self.others)}"
            )
        return int(self._model.joint(name).qposadr[0])

    def _pose(self, positions: Mapping[str, float]) -> np.ndarray:
        q = self._model.qpos0.copy()
        for name, angle in {**self.spec.positions, **positions}.items():
            q[self._at(name, "arm.positions")] = angle
        return q

    def _dynamics(
        self, q: np.ndarray, v: np.ndarray, a: np.ndarray, carried: tuple[bool, ...]
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the inertia about the joint's axis [kg·m²] and the torque τ [N·m], shape (n,), of positions, velocities,
        accelerations, shape (n, nv), with the payloads that are `carried`."""
        m, d = self._carrying(carried)
        found = np.zeros((len(q), 2))
        qpos, qvel, qacc, mass, force, at = d.qpos, d.qvel, d.qacc, d.M, d.qfrc_inverse, self._joint
        for k in range(len(q)):
            qpos[:], qvel[:], qacc[:] = q[k], v[k], a[k]
            mujoco.mj_inverse(m, d)
            found[k] = mass[self._diagonal], force[at]
        return found[:, 0], found[:, 1]


def _find(name: str, folder: Path) -> Path:
    path = folder / name
    if path.is_file():
        if not path.resolve().is_relative_to(folder.resolve()):
            raise InputError(f"arm.model: expected an MJCF or URDF file in {folder}, got {name!r}")
        return path
    if "/" not in name and "\\" not in name and shipped(name).is_file():
        return shipped(name)
    raise InputError(f"{path}: arm.model: expected an MJCF or URDF file, no such file {name!r}")


def external_torques(mjcf: str, names: Sequence[str], angles: np.ndarray, torques: np.ndarray) -> np.ndarray:
    """Return the torque on each joint of pure torques on the links about their own axes, shape (n, joints) [N·m].

    Args:
      mjcf: of the arm, as of `written`, with these joints only, by `names`.
      angles: of the joints, shape (n, joints) [rad]; torques: on their links, shape (n, joints) [N·m].
    """
    model = mujoco.MjModel.from_xml_string(mjcf)
    data, found = mujoco.MjData(model), np.zeros_like(torques)
    at, turned = [model.joint(name).id for name in names], np.zeros((3, model.nv))
    for k in np.flatnonzero(np.any(torques != 0.0, axis=1)):
        data.qpos[at] = angles[k]
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        for joint, torque in zip(at, torques[k], strict=True):
            mujoco.mj_jacBody(model, data, None, turned, model.jnt_bodyid[joint])
            found[k] += (torque * data.xaxis[joint] @ turned)[at]
    return found
