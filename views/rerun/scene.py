"""The joint in 3D: bodies in motion, and torques."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import mujoco
import numpy as np
import rerun as rr

from ..style import TRUTH, main_filter
from .arrows import send_arc, send_push
from .recording import TIMELINE, is_new

if TYPE_CHECKING:
    from ...scenarios.run import Run

FRAME_RATE = 50.0  # poses of the 3D scene per second


def reach(model: mujoco.MjModel) -> float:
    """Return the distance of the link's tip from the axis [m]; 0.4 for a model without the site `tip`."""
    site = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SITE, "tip")
    return max(float(np.linalg.norm(model.site_pos[site][[0, 2]])), 0.2) if site >= 0 else 0.4


def send_scene(
    stream: rr.RecordingStream, run: Run, model: mujoco.MjModel, colors: Mapping[str, str], pushed: bool
) -> None:
    """Send the joint's bodies with the motion of a run or a stretch of one, and its torques as arrows; `pushed`:
    whether there is an external torque."""
    frames = thin_frames(run.time)
    if not len(frames):
        return
    time = [rr.TimeColumn(TIMELINE, duration=run.time[frames])]
    angles = np.column_stack([run.truth(f"{name}_position")[frames] for name in ("motor", "wave_generator", "link")])
    bare = run.scenario.mount(run.joint).gravity_moment == 0
    tips = send_bodies(stream, "scene", time, angles, model, bare)
    main = main_filter(colors)
    torques = {"true": (run.truth("joint_torque")[frames], TRUTH), main: (run.estimate(main)[frames], colors[main])}
    send_torques(stream, "scene", time, torques, model)
    if tips is not None and pushed:
        send_push(stream, time, run.external_torque[frames], tips, _axis(model))


def send_bodies(
    stream: rr.RecordingStream,
    place: str,
    time: list[rr.TimeColumn],
    angles: np.ndarray,
    model: mujoco.MjModel,
    bare: bool = False,
) -> np.ndarray | None:
    """Send the joint's bodies below an entity path; return the positions of the site `tip` [m], shape (f, 3), if there
    is one. `angles`: of rotor and wave generator [rad, motor side] and link [rad], shape (f, 3); `bare`: without a link
    its geoms are lines."""
    new = is_new(stream, place)
    if new:
        stream.log(place, rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True, strict=True)
    positions, rotations, tips = _poses(model, angles)
    for body in range(1, model.nbody):
        name = model.body(body).name or f"body_{body}"
        if new:
            send_geoms(stream, model, body, f"{place}/{name}", bare and name == "link")
        columns = rr.Transform3D.columns(translation=positions[:, body], quaternion=rotations[:, body])
        stream.send_columns(f"{place}/{name}", time, columns, strict=True)
    return tips


def send_torques(
    stream: rr.RecordingStream,
    place: str,
    time: list[rr.TimeColumn],
    torques: Mapping[str, tuple[np.ndarray, str]],
    model: mujoco.MjModel,
) -> None:
    """Send torques [N·m], shape (f,) each, by name with their colours, as curved arrows around the axis with increasing
    radius, at `torque_<name>` below an entity path."""
    axis = _axis(model)
    radius = 2.2 * model.geom_size[:, 0].max() if model.ngeom else 0.1
    front = _front(model, axis)
    for i, (name, (torque, color)) in enumerate(torques.items()):
        send_arc(stream, f"{place}/torque_{name}", time, torque, (1 + 0.16 * i) * radius, front, axis, color)


def _axis(model: mujoco.MjModel) -> np.ndarray:
    """Axis of the joint, shape (3,)."""
    axis: np.ndarray = model.jnt_axis[model.joint("link").id]
    return axis


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
        common: dict[str, Any] = {"quaternions": [rotation], "colors": [color[:3]], "fill_mode": fill}
        shape: rr.AsComponents
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
            continue  # planes and height fields are not part of the joint
        stream.log(f"{path}/{model.geom(geom).name or f'geom_{geom}'}", shape, static=True, strict=True)


def _mesh(model: mujoco.MjModel, geom: int, color: Sequence[int]) -> rr.Mesh3D:
    mesh = model.geom_dataid[geom]
    vertices = slice(model.mesh_vertadr[mesh], model.mesh_vertadr[mesh] + model.mesh_vertnum[mesh])
    faces = slice(model.mesh_faceadr[mesh], model.mesh_faceadr[mesh] + model.mesh_facenum[mesh])
    matrix = np.empty(9)
    mujoco.mju_quat2Mat(matrix, model.geom_quat[geom])
    points = model.mesh_vert[vertices] @ matrix.reshape(3, 3).T + model.geom_pos[geom]
    return rr.Mesh3D(vertex_positions=points, triangle_indices=model.mesh_face[faces], albedo_factor=list(color))
