"""Torques as arrows around the joint's axis, and pushes as forces at the link's tip."""

from __future__ import annotations

import numpy as np
import rerun as rr

from ..style import EXTERNAL
from .recording import is_new, rgb

DEGREES_PER_TORQUE = 12.0  # length of the torque arrows around the axis [°/(N·m)]
FORCE_SCALE = 0.012  # length of the arrow of the external force at the link's tip [m/N]
_LARGEST_ARC = 300.0  # °
_ARC_POINTS = 25


def send_arc(
    stream: rr.RecordingStream,
    path: str,
    time: list[rr.TimeColumn],
    torque: np.ndarray,
    radius: float,
    front: float,
    axis: np.ndarray,
    color: str,
) -> None:
    """Send a torque, shape (f,) [N·m], as a curved arrow around the joint's right-handed axis that begins above it;
    `radius`, `front`: of the arc, and its position on the axis [m]."""
    up = np.array([0.0, 0.0, 1.0])
    side, place = np.cross(axis, up), front * axis
    swept = np.radians(np.clip(DEGREES_PER_TORQUE * torque, -_LARGEST_ARC, _LARGEST_ARC))
    head = np.sign(swept) * np.minimum(np.abs(swept), 0.22)
    angles = np.linspace(0, 1, _ARC_POINTS) * (swept - head)[:, None]

    def at(angle: np.ndarray) -> np.ndarray:
        return radius * (np.cos(angle)[..., None] * up + np.sin(angle)[..., None] * side) + place

    strips = at(angles).astype(np.float32)  # (f, points, 3): one array, not one object per frame
    point = f"{path}/head"
    if is_new(stream, path, color):
        stream.log(path, rr.LineStrips3D.from_fields(colors=[rgb(color)], radii=[0.003]), static=True, strict=True)
        stream.log(point, rr.Arrows3D.from_fields(colors=[rgb(color)], radii=[0.007]), static=True, strict=True)
    stream.send_columns(path, time, rr.LineStrips3D.columns(strips=strips), strict=True)
    begin, end = at(swept - head), at(swept)
    arrows = rr.Arrows3D.columns(origins=begin.astype(np.float32), vectors=(end - begin).astype(np.float32))
    stream.send_columns(point, time, arrows, strict=True)


def send_push(
    stream: rr.RecordingStream, time: list[rr.TimeColumn], torque: np.ndarray, tips: np.ndarray, axis: np.ndarray
) -> None:
    """Send the external torque as a force at the link's tip."""
    arm = tips - np.outer(tips @ axis, axis)
    length = np.linalg.norm(arm, axis=1, keepdims=True)
    direction = np.cross(axis, arm) / np.maximum(length, 1e-9)
    vectors = FORCE_SCALE * (torque[:, None] / np.maximum(length, 1e-9)) * direction
    if is_new(stream, "scene/external"):
        looks = rr.Arrows3D.from_fields(colors=[rgb(EXTERNAL)], radii=[0.007])
        stream.log("scene/external", looks, static=True, strict=True)
    columns = rr.Arrows3D.columns(origins=(tips - vectors).astype(np.float32), vectors=vectors.astype(np.float32))
    stream.send_columns("scene/external", time, columns, strict=True)
