"""The looks of a joint: bodies and axes of its MJCF, without dynamics."""

from __future__ import annotations

import mujoco

from ..models.errors import InputError, refusing
from ..models.joint import Joint
from ..models.mjcf import check_mjcf
from . import native

JOINTS = ("rotor", "wave_generator", "link")  # the joints of every joint's MJCF, in this order


def shape(joint: Joint) -> mujoco.MjModel:
    """Return the joint's bodies and axes of its MJCF, for looks and places only. Raises `InputError`: an MJCF that
    cannot be read, names files outside its folder, or is not a joint's; one line."""
    path = joint.mjcf
    check_mjcf(path)
    with refusing(f"{path}: not a readable MJCF"), native.quiet():
        model = mujoco.MjModel.from_xml_path(str(path))
    names = [model.joint(i).name for i in range(model.njnt)]
    if tuple(names) != JOINTS:
        raise InputError(
            f"{path}: expected the joints {', '.join(JOINTS)} in this order, got {', '.join(names) or 'none'}"
        )
    return model
