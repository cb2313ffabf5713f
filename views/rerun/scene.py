"""The joint in 3D: bodies in motion, torques as arrows around the joint's axis, pushes as forces at the link's tip."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import mujoco
import numpy as np
import rerun as rr

from ..style import EXTERNAL
from .recording import TIMELINE, is_new, rgb

if TYPE_CHECKING:
    from ...scenarios.run import Run

FRAME_RATE = 50.0  # poses of the 3D scene per second
DEGREES_PER_TORQUE = 12.0  # length of the torque arrows around the axis [°/(N·m)]
FORCE_SCALE = 0.012  # length of the arrow of the external force at the link's tip [m/N]
_LARGEST_ARC = 300.0  # °
_ARC_POINTS = 25


def reach(model: mujoco.MjModel) -> float:
    """Return the distance of the link's tip from the axis [m]; 0.4 for a model without the site `tip`."""
    site = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SITE, "tip")
    return max(float(np.linalg.norm(model.site_pos[site][[0, 2]])), 0.2) if site >= 0 else 0.4


class Scene:
    """A joint in 3D below an entity path."""

    def __init__(self, stream: rr.RecordingStream, place: str, model: mujoco.MjModel):
        self._stream, self._place, self._model = stream, place, model
        self._axis: np.ndarray = model.jnt_axis[model.joint("link").id]

    def send_run(self, run: Run, torques: Mapping[str, tuple[np.ndarray, str]], pushed: bool = False) -> None:
        """Send the joint's bodies with the motion of a run or a stretch of one, and torques, as of `send_torques` but of
        all samples; `pushed`: whether there is an external torque."""
        frames = thin_frames(run.time)
        if not len(frames):
            return
        time = [rr.TimeColumn(TIMELINE, duration=run.time[frames])]
        angles = np.column_stack(
            [run.truth(f"{name}_position")[frames] for name in ("motor", "wave_generator", "link")]
        )
        tips = self.send_bodies(time, angles, run.scenario.mount(run.joint).gravity_moment == 0)
        self.send_torques(time, {name: (x[frames], color) for name, (x, color) in torques.items()})
        if tips is not None and pushed:
            self._send_push(time, run.external_torque[frames], tips)

    def send_bodies(self, time: list[rr.TimeColumn], angles: np.ndarray, bare: bool = False) -> np.ndarray | None:
        """Send the joint's bodies; return the positions of the site `tip` [m], shape (f, 3), if there is one.

        Args:
          angles: of rotor and wave generator [rad, motor side] and link [rad], shape (f, 3).
          bare: without a link its geoms are lines.
        """
        new = is_new(self._stream, self._place)
        if new:
            self._stream.log(self._place, rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True, strict=True)
        positions, rotations, tips = _poses(self._model, angles)
        for body in range(1, self._model.nbody):
            name = self._model.body(body).name or f"body_{body}"
            path = f"{self._place}/{name}"
            if new:
                send_geoms(self._stream, self._model, body, path, bare and name == "link")
            columns = rr.Transform3D.columns(translation=positions[:, body], quaternion=rotations[:, body])
            self._stream.send_columns(path, time, columns, strict=True)
        return tips

    def send_torques(self, time: list[rr.TimeColumn], torques: Mapping[str, tuple[np.ndarray, str]]) -> None:
        """Send torques [N·m], shape (f,) each, by name with their colours, as curved arrows around the axis with increasing
        radius, at `torque_<name>`. The axis is right-handed, and an arrow begins above it."""
        model, axis, up = self._model, self._axis, np.array([0.0, 0.0, 1.0])
        side, front = np.cross(axis, up), _front(model, axis) * axis
        for i, (name, (torque, color)) in enumerate(torques.items()):
            radius = (1 + 0.16 * i) * (2.2 * model.geom_size[:, 0].max() if model.ngeom else 0.1)
            swept = np.radians(np.clip(DEGREES_PER_TORQUE * torque, -_LARGEST_ARC, _LARGEST_ARC))
            head = np.sign(swept) * np.minimum(np.abs(swept), 0.22)
            angles = np.column_stack([np.linspace(0, 1, _ARC_POINTS) * (swept - head)[:, None], swept])[..., None]
            arcs = radius * (np.cos(angles) * up + np.sin(angles) * side) + front  # (f, points, 3)
            path = f"{self._place}/torque_{name}"
            if is_new(self._stream, path, color):
                looks = rr.LineStrips3D.from_fields(colors=[rgb(color)], radii=[0.003])
                self._stream.log(path, looks, static=True, strict=True)
            strips = arcs[:, :-1].astype(np.float32)  # one array, not one object per frame
            self._stream.send_columns(path, time, rr.LineStrips3D.columns(strips=strips), strict=True)
            self._send_arrows(f"{path}/head", time, arcs[:, -2], arcs[:, -1] - arcs[:, -2], color)

    def _send_push(self, time: list[rr.TimeColumn], torque: np.ndarray, tips: np.ndarray) -> None:
        """Send the external torque as a force at the link's tip."""
        arm = tips - np.outer(tips @ self._axis, self._axis)
        length = np.linalg.norm(arm, axis=1, keepdims=True)
        direction = np.cross(self._axis, arm) / np.maximum(length, 1e-9)
        vectors = FORCE_SCALE * (torque[:, None] / np.maximum(length, 1e-9)) * direction
        self._send_arrows(f"{self._place}/external", time, tips - vectors, vectors, EXTERNAL)

    def _send_arrows(
        self, path: str, time: list[rr.TimeColumn], origins: np.ndarray, vectors: np.ndarray, color: str
    ) -> None:
        if is_new(self._stream, path, color):
            looks = rr.Arrows3D.from_fields(colors=[rgb(color)], radii=[0.007])
            self._stream.log(path, looks, static=True, strict=True)
        arrows = rr.Arrows3D.columns(origins=origins.astype(np.float32), vectors=vectors.astype(np.float32))
        self._stream.send_columns(path, time, arrows, strict=True)


def _front(model: mujoco.MjModel, axis: np.ndarray) -> float:
    """Position on the axis [m] in front of all geoms."""
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    faces = [0.0]
    for geom in range(model.ngeom):
        along = data.geom_xmat[geom].reshape(3, 3).T @ axis
        center, half = model.geom_aabb[geom][:3], model.geom_aabb[geom][3:]
        faces.append(float(data.geom_xpos[geom] @ axis + along @ center + np.abs(along) @ half))
    return max(faces) + 0.015


def thin_frames(time: np.ndarray) -> np.ndarray:
    """Return the indices of the samples of the 3D scene, the same for a stretch and for the whole run."""
    period = float(time[1] - time[0])
    step = max(round(1.0 / FRAME_RATE / period), 1)
    return np.arange(-round(float(time[0]) / period) % step, len(time), step)


def _poses(model: mujoco.MjModel, angles: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray | None]:
    """Positions (f, bodies, 3) [m], quaternions x y z w (f, bodies, 4), and positions of the site `tip`, if any."""
    data = mujoco.MjData(model)
    positions = np.empty((len(angles), model.nbody, 3))
    rotations = np.empty((len(angles), model.nbody, 4))
    has_tip = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SITE, "tip") >= 0
    tips = np.empty((len(angles), 3))
    for i, at in enumerate(angles):
        data.qpos[:3] = at
        mujoco.mj_kinematics(model, data)
        positions[i], rotations[i] = data.xpos, data.xquat[:, [1, 2, 3, 0]]
        if has_tip:
            tips[i] = data.site("tip").xpos
    return positions, rotations, tips if has_tip else None


def send_geoms(stream: rr.RecordingStream, model: mujoco.MjModel, body: int, path: str, lines: bool = False) -> None:
    """Send a body's geoms as primitives or meshes in the body's frame; as lines if `lines`, or if transparent."""
    kinds = mujoco.mjtGeom
    for geom in range(model.body_geomadr[body], model.body_geomadr[body] + model.body_geomnum[body]):
        kind, size = kinds(int(model.geom_type[geom])), model.geom_size[geom]
        material = model.geom_matid[geom]
        rgba = model.mat_rgba[material] if material >= 0 else model.geom_rgba[geom]
        color = [round(255 * float(c)) for c in rgba]
        position = model.geom_pos[geom]
        rotation = model.geom_quat[geom][[1, 2, 3, 0]]
        # A transparent housing is drawn as lines, to show its content.
        solid = color[3] == 255 and not lines
        fill = rr.components.FillMode.Solid if solid else rr.components.FillMode.DenseWireframe
        matrix = np.empty(9)
        mujoco.mju_quat2Mat(matrix, model.geom_quat[geom])
        common: dict[str, Any] = {"quaternions": [rotation], "colors": [color[:3]], "fill_mode": fill}
        shape: rr.AsComponents
        if kind == kinds.mjGEOM_CYLINDER:
            shape = rr.Cylinders3D(lengths=[2 * size[1]], radii=[size[0]], centers=[position], **common)
        elif kind == kinds.mjGEOM_CAPSULE:
            begin = position - size[1] * matrix.reshape(3, 3)[:, 2]  # Rerun's capsule starts at its first end
            shape = rr.Capsules3D(lengths=[2 * size[1]], radii=[size[0]], translations=[begin], **common)
        elif kind == kinds.mjGEOM_BOX:
            shape = rr.Boxes3D(half_sizes=[size], centers=[position], **common)
        elif kind in (kinds.mjGEOM_SPHERE, kinds.mjGEOM_ELLIPSOID):
            half = size if kind == kinds.mjGEOM_ELLIPSOID else np.full(3, size[0])
            shape = rr.Ellipsoids3D(half_sizes=[half], centers=[position], **common)
        elif kind == kinds.mjGEOM_MESH:
            mesh = model.mesh(model.geom_dataid[geom])
            vertices = slice(mesh.vertadr[0], mesh.vertadr[0] + mesh.vertnum[0])
            faces = slice(mesh.faceadr[0], mesh.faceadr[0] + mesh.facenum[0])
            points = model.mesh_vert[vertices] @ matrix.reshape(3, 3).T + position
            shape = rr.Mesh3D(vertex_positions=points, triangle_indices=model.mesh_face[faces], albedo_factor=color)
        else:
            continue  # planes and height fields are not part of the joint
        stream.log(f"{path}/{model.geom(geom).name or f'geom_{geom}'}", shape, static=True, strict=True)
