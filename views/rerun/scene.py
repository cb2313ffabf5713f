"""The joint in 3D: its bodies with their motion, torques as arrows around the axis, pushes as forces at the link's tip."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import mujoco
import numpy as np
import rerun as rr

from ...models.errors import InputError
from ..style import EXTERNAL, TRUTH, filter_colors, main_filter
from .recording import TIMELINE, rgb

if TYPE_CHECKING:
    from ...models.joint import Joint
    from ...scenarios.run import Run

FRAME_RATE = 50.0
"""Poses of the 3D scene per second."""
DEGREES_PER_TORQUE = 12.0
"""Length of the torque arrows around the axis [°/(N·m)]."""
FORCE_SCALE = 0.012
"""Length of the arrow of the external force at the link's tip [m/N]."""
_LARGEST_ARC = 300.0  # °
_ARC_POINTS = 25


def shape_of(joint: Joint) -> mujoco.MjModel:
    """The joint's bodies and axes as its MJCF has them: for looks and places only, its dynamics are not the joint's.

    Raises:
      InputError: an MJCF that cannot be read.
    """
    try:
        return mujoco.MjModel.from_xml_path(str(joint.mjcf))
    except ValueError as error:
        raise InputError(f"{joint.mjcf}: not a readable MJCF: {' '.join(str(error).split())}") from error


def reach(model: mujoco.MjModel) -> float:
    """Distance of the link's tip from the axis [m]; 0.4 for a model without the site `tip`."""
    site = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SITE, "tip")
    return max(float(np.linalg.norm(model.site_pos[site][[0, 2]])), 0.2) if site >= 0 else 0.4


def send_scene(stream: rr.RecordingStream, run: Run, model: mujoco.MjModel) -> None:
    """Send the joint's bodies with their motion, and the torques as arrows."""
    stream.log("scene", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True, strict=True)
    frames = thin_frames(run.time)
    time = [rr.TimeColumn(TIMELINE, duration=run.time[frames])]
    positions, rotations, tips = _poses(model, run, frames)
    for body in range(1, model.nbody):
        name = model.body(body).name or f"body_{body}"
        # A bare joint has no link: its geoms are drawn as lines, as a pointer.
        pointer = name == "link" and run.joint.mount(run.scenario.mounting or None).gravity_moment == 0
        send_geoms(stream, model, body, f"scene/{name}", pointer)
        columns = rr.Transform3D.columns(translation=positions[:, body], quaternion=rotations[:, body])
        stream.send_columns(f"scene/{name}", time, columns, strict=True)
    names = [s.name for s in run.settings]
    main = main_filter(names)
    axis = model.jnt_axis[model.joint("link").id]
    radius = 2.2 * model.geom_size[:, 0].max() if model.ngeom else 0.1
    front = _front(model, axis)
    _send_arc(stream, "scene/torque_true", time, run.truth("joint_torque")[frames], radius, front, axis, TRUTH)
    color = filter_colors(names)[main]
    _send_arc(stream, f"scene/torque_{main}", time, run.estimate(main)[frames], 1.16 * radius, front, axis, color)
    if tips is not None and np.any(run.external_torque):
        _send_push(stream, time, run.external_torque[frames], tips, axis)


def _front(model: mujoco.MjModel, axis: np.ndarray) -> float:
    """Place on the axis [m] just before all geoms, where nothing hides an arrow."""
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    faces = [0.0]
    for geom in range(model.ngeom):
        along = data.geom_xmat[geom].reshape(3, 3).T @ axis
        center, half = model.geom_aabb[geom][:3], model.geom_aabb[geom][3:]
        faces.append(float(data.geom_xpos[geom] @ axis + along @ center + np.abs(along) @ half))
    return max(faces) + 0.015


def thin_frames(time: np.ndarray) -> np.ndarray:
    """Indices of the samples that the 3D scene shows."""
    step = max(round(1.0 / FRAME_RATE / float(time[1] - time[0])), 1)
    return np.arange(0, len(time), step)


def _poses(model: mujoco.MjModel, run: Run, frames: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray | None]:
    """Positions (f, bodies, 3) [m], quaternions x y z w (f, bodies, 4), and positions of the site `tip`, if any."""
    data = mujoco.MjData(model)
    state = np.column_stack([run.truth(f"{name}_position")[frames] for name in ("motor", "wave_generator", "link")])
    positions = np.empty((len(frames), model.nbody, 3))
    rotations = np.empty((len(frames), model.nbody, 4))
    has_tip = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SITE, "tip") >= 0
    tips = np.empty((len(frames), 3)) if has_tip else None
    for i, angles in enumerate(state):
        data.qpos[:3] = angles
        mujoco.mj_kinematics(model, data)
        positions[i], rotations[i] = data.xpos, data.xquat[:, [1, 2, 3, 0]]
        if has_tip:
            tips[i] = data.site("tip").xpos
    return positions, rotations, tips


def send_geoms(stream: rr.RecordingStream, model: mujoco.MjModel, body: int, path: str, lines: bool = False) -> None:
    """Send a body's geoms as primitives or meshes in the body's frame; as lines if asked for, or if transparent."""
    kinds = mujoco.mjtGeom
    for geom in range(model.body_geomadr[body], model.body_geomadr[body] + model.body_geomnum[body]):
        kind, size = kinds(int(model.geom_type[geom])), model.geom_size[geom]
        material = model.geom_matid[geom]
        rgba = model.mat_rgba[material] if material >= 0 else model.geom_rgba[geom]
        color = [round(255 * float(c)) for c in rgba]
        position = model.geom_pos[geom]
        rotation = model.geom_quat[geom][[1, 2, 3, 0]]
        # A housing that one can look into is drawn as lines: what moves inside is the point.
        solid = color[3] == 255 and not lines
        fill = rr.components.FillMode.Solid if solid else rr.components.FillMode.DenseWireframe
        common = {"quaternions": [rotation], "colors": [color[:3]], "fill_mode": fill}
        if kind == kinds.mjGEOM_CYLINDER:
            shape = rr.Cylinders3D(lengths=[2 * size[1]], radii=[size[0]], centers=[position], **common)
        elif kind == kinds.mjGEOM_CAPSULE:
            matrix = np.empty(9)
            mujoco.mju_quat2Mat(matrix, model.geom_quat[geom])
            begin = position - size[1] * matrix.reshape(3, 3)[:, 2]  # Rerun's capsule starts at its first end
            shape = rr.Capsules3D(lengths=[2 * size[1]], radii=[size[0]], translations=[begin], **common)
        elif kind == kinds.mjGEOM_BOX:
            shape = rr.Boxes3D(half_sizes=[size], centers=[position], **common)
        elif kind in (kinds.mjGEOM_SPHERE, kinds.mjGEOM_ELLIPSOID):
            half = size if kind == kinds.mjGEOM_ELLIPSOID else np.full(3, size[0])
            shape = rr.Ellipsoids3D(half_sizes=[half], centers=[position], **common)
        elif kind == kinds.mjGEOM_MESH:
            shape = _mesh(model, geom, color)
        else:
            continue  # planes and height fields are scenery
        stream.log(f"{path}/{model.geom(geom).name or f'geom_{geom}'}", shape, static=True, strict=True)


def _mesh(model: mujoco.MjModel, geom: int, color: Sequence[int]) -> rr.Mesh3D:
    mesh = model.geom_dataid[geom]
    vertices = slice(model.mesh_vertadr[mesh], model.mesh_vertadr[mesh] + model.mesh_vertnum[mesh])
    faces = slice(model.mesh_faceadr[mesh], model.mesh_faceadr[mesh] + model.mesh_facenum[mesh])
    matrix = np.empty(9)
    mujoco.mju_quat2Mat(matrix, model.geom_quat[geom])
    points = model.mesh_vert[vertices] @ matrix.reshape(3, 3).T + model.geom_pos[geom]
    return rr.Mesh3D(vertex_positions=points, triangle_indices=model.mesh_face[faces], albedo_factor=list(color))


def _send_arc(
    stream, path: str, time: list, torque: np.ndarray, radius: float, front: float, axis: np.ndarray, color: str
) -> None:
    """Send a torque as a curved arrow around the joint's axis that begins above it.

    Args:
      torque: shape (f,) [N·m].
      radius, front: of the arc, and its place on the axis [m].
      axis: of the joint: positive torque turns about it by the right hand.
      color: `#RRGGBB`.
    """
    up = np.array([0.0, 0.0, 1.0])
    side, front = np.cross(axis, up), front * axis
    swept = np.radians(np.clip(DEGREES_PER_TORQUE * torque, -_LARGEST_ARC, _LARGEST_ARC))
    head = np.sign(swept) * np.minimum(np.abs(swept), 0.22)
    angles = np.linspace(0, 1, _ARC_POINTS) * (swept - head)[:, None]

    def at(angle: np.ndarray) -> np.ndarray:
        return radius * (np.cos(angle)[..., None] * up + np.sin(angle)[..., None] * side) + front

    strips = at(angles).astype(np.float32)  # (f, points, 3): one array, not one object per frame
    stream.log(path, rr.LineStrips3D.from_fields(colors=[rgb(color)], radii=[0.003]), static=True, strict=True)
    stream.send_columns(path, time, rr.LineStrips3D.columns(strips=strips), strict=True)
    begin, end = at(swept - head), at(swept)
    point = f"{path}/head"
    stream.log(point, rr.Arrows3D.from_fields(colors=[rgb(color)], radii=[0.007]), static=True, strict=True)
    arrows = rr.Arrows3D.columns(origins=begin.astype(np.float32), vectors=(end - begin).astype(np.float32))
    stream.send_columns(point, time, arrows, strict=True)


def _send_push(stream, time: list, torque: np.ndarray, tips: np.ndarray, axis: np.ndarray) -> None:
    """Send the external torque as the force at the link's tip that makes it."""
    arm = tips - np.outer(tips @ axis, axis)
    length = np.linalg.norm(arm, axis=1, keepdims=True)
    direction = np.cross(axis, arm) / np.maximum(length, 1e-9)
    vectors = FORCE_SCALE * (torque[:, None] / np.maximum(length, 1e-9)) * direction
    stream.log(
        "scene/external", rr.Arrows3D.from_fields(colors=[rgb(EXTERNAL)], radii=[0.007]), static=True, strict=True
    )
    columns = rr.Arrows3D.columns(origins=(tips - vectors).astype(np.float32), vectors=vectors.astype(np.float32))
    stream.send_columns("scene/external", time, columns, strict=True)
