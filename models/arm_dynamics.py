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
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path

import mujoco
import numpy as np

from .arm import ArmSpec, Load, carried_at
from .arm_model import compiled, put_payloads, read, weigh, written
from .errors import InputError, nearest
from .joint import shipped
from .joint_parts import Mounting
from .motion import differentiated

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
            if int(model.jnt_type[i]) not in (int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE)):
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
        if int(model.jnt_type[self._joint]) != int(mujoco.mjtJoint.mjJNT_HINGE):
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
      mjcf: of the arm, as of `arm_model.written`, with these joints only, by `names`.
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
