"""Comparison of the plant with independent solutions of the joint's equations."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np

from ..models.errors import InputError
from ..models.joint import Joint
from ..models.joint_parts import Mounting
from ..models.tables import read_table
from . import native, plant
from .plugin import LINK, MEMORY, transmission_at

CLOSED_LOOP = {"no_load": "no_load", "link_sweep": "link", "external_push": "link"}
"""Reference file: the mounting that it was made with."""
LIMITS = {"torsion": 0.005, "joint_torque": 0.003, "motor_current": 0.005}
"""Largest RMS difference, relative to the reference's standard deviation."""
LOOP_LIMITS = {"torsion loop": 0.01, "width at zero torque": 0.02}
"""Largest difference of the locked-rotor loop: RMS relative to its torsion range; width relative to the width."""
_COLUMNS = (
    "position_command", "velocity_command", "external_torque", "motor_position", "link_position", "motor_current",
    "joint_torque",
)  # fmt: skip
_GAIN, _DAMPING = 8.0, 0.08  # A/rad, A·s/rad: the reference's controller
_PERIOD = 0.001
_LOCKED = Mounting(inertia=0.05, gravity_moment=0.0)
_LEAST_WIDTH_TORQUE = 0.5  # N·m: the loop's width is read off where |Tf| is below this


@dataclass(frozen=True)
class Difference:
    """One line of the verification: what, relative difference, limit."""

    file: str
    channel: str
    relative: float
    limit: float

    @property
    def passed(self) -> bool:
        """Whether the difference is within its limit."""
        return bool(self.relative <= self.limit)


@native.quiet()
def verify(folder: Path, joint: Joint, timestep: float = plant.TIMESTEP) -> list[Difference]:
    """Drive the plant as the reference files of a folder describe (`no_load.parquet`, `link_sweep.parquet`,
    `external_push.parquet`, `locked_rotor.parquet`), with the joint that they were solved for, and compare. Raises
    `InputError`: a file or a column is missing, or a timestep of which no whole number is 1 ms."""
    if not 0 < timestep <= _PERIOD or abs(_PERIOD / timestep - round(_PERIOD / timestep)) > 1e-6:
        raise InputError(f"timestep: expected a whole fraction of {_PERIOD:g} s, got {timestep:g} s")
    differences = []
    for name, mounting in CLOSED_LOOP.items():
        reference = _read(folder / f"{name}.parquet", _COLUMNS)
        ours = closed_loop(joint, joint.mount(mounting), reference, timestep)
        torsion = reference["motor_position"] / joint.numbers["N"].value - reference["link_position"]
        for channel, limit in LIMITS.items():
            theirs = torsion if channel == "torsion" else reference[channel]
            relative = float(np.sqrt(np.mean((ours[channel] - theirs) ** 2)) / np.std(theirs))
            differences.append(Difference(name, channel, relative, limit))
    reference = _read(folder / "locked_rotor.parquet", ("external_torque", "link_position", "flexspline_torque"))
    link, torque = locked_rotor(joint, reference["external_torque"], timestep)
    theirs = reference["link_position"]
    relative = float(np.sqrt(np.mean((link - theirs) ** 2)) / np.ptp(theirs))
    differences.append(Difference("locked_rotor", "torsion loop", relative, LOOP_LIMITS["torsion loop"]))
    width = loop_width(theirs, reference["flexspline_torque"])
    relative = abs(loop_width(link, torque) - width) / width
    differences.append(
        Difference("locked_rotor", "width at zero torque", relative, LOOP_LIMITS["width at zero torque"])
    )
    return differences


def closed_loop(
    joint: Joint, mounting: Mounting, reference: dict[str, np.ndarray], timestep: float
) -> dict[str, np.ndarray]:
    """Run the reference's controller on exact states: `torsion` [rad], `joint_torque` [N·m], `motor_current` [A].

    The current is `8 (N q_d − θm) + 0.08 (N q_d' − θm')` A, clipped, and held over each 1 ms, as is the external
    torque.
    """
    record = joint.record(mounting)
    p = record[0]
    model = plant.build(joint, mounting, timestep=timestep, ideal_current=True)
    data = mujoco.MjData(model)
    plant.start(model, data)
    substeps = round(_PERIOD / timestep)
    position, velocity, external = (reference[k] for k in ("position_command", "velocity_command", "external_torque"))
    n = len(position)
    theta, omega, current = np.zeros((n, 3)), np.zeros((n, 3)), np.zeros(n)
    memory = plant.memory(model, data)
    body = model.body("link").id
    last_current = last_external = 0.0
    for k in range(n):
        theta[k] = data.qpos
        before = data.qvel.copy()
        # Velocities belong to the middle of the steps: the controller's is extrapolated by half a step.
        now = 1.5 * before[0] - 0.5 * memory[MEMORY]
        i = _GAIN * (p["N"] * position[k] - theta[k, 0]) + _DAMPING * (p["N"] * velocity[k] - now)
        current[k] = min(max(i, -p["current_limit"]), p["current_limit"])
        data.ctrl[0] = p["Kt"] * 0.5 * (current[k] + last_current)
        data.xfrc_applied[body, 4] = -0.5 * (external[k] + last_external)
        mujoco.mj_step(model, data)
        omega[k] = 0.5 * (before + data.qvel)
        data.ctrl[0] = p["Kt"] * current[k]
        data.xfrc_applied[body, 4] = -external[k]
        if substeps > 1:
            mujoco.mj_step(model, data, nstep=substeps - 1)
        last_current, last_external = current[k], external[k]
    torque = np.array([transmission_at(q, w, 0.0, p).flexspline_torque for q, w in zip(theta, omega, strict=True)])
    return {
        "torsion": theta[:, 0] / p["N"] - theta[:, LINK],
        "joint_torque": torque - p["bl"] * omega[:, LINK],
        "motor_current": current,
    }


def locked_rotor(joint: Joint, external: np.ndarray, timestep: float) -> tuple[np.ndarray, np.ndarray]:
    """Load the link slowly with a locked rotor and no kinematic error: link angle [rad] and flexspline torque [N·m]."""
    record = joint.record(_LOCKED)
    p = record[0]
    p["amplitude"] = 0.0
    model = plant.build(joint, _LOCKED, timestep=timestep, record=record, ideal_current=True, locked_rotor=True)
    data = mujoco.MjData(model)
    plant.start(model, data)
    substeps = round(_PERIOD / timestep)
    body = model.body("link").id
    link, torque = np.zeros(len(external)), np.zeros(len(external))
    for k, tau in enumerate(external):
        link[k] = data.qpos[LINK]
        torque[k] = transmission_at(data.qpos[:3], data.qvel[:3], 0.0, p).flexspline_torque
        data.xfrc_applied[body, 4] = -tau
        mujoco.mj_step(model, data, nstep=substeps)
    return link, torque


def loop_width(link: np.ndarray, torque: np.ndarray) -> float:
    """Return half the width [rad] of the torsion–torque loop at zero torque, by straight lines through its branches."""
    rising = np.gradient(torque) > 0
    near = np.abs(torque) < _LEAST_WIDTH_TORQUE
    begin = len(torque) // 4  # the virgin curve belongs to no branch
    later = np.arange(len(torque)) >= begin
    crossings = [np.polyfit(torque[near & later & side], link[near & later & side], 1)[1] for side in (rising, ~rising)]
    return float(abs(crossings[0] - crossings[1]) / 2)


def _read(path: Path, columns: tuple[str, ...]) -> dict[str, np.ndarray]:
    if path.exists() and not path.is_file():  # a pipe, which may never end
        raise InputError(f"{path}: cannot read a reference solution: not a file")
    if not path.exists():
        raise InputError(f"{path}: expected a reference solution, found no such file")
    found, _ = read_table(path)
    for column in columns:
        if column not in found:
            raise InputError(f"{path}: expected a column {column!r}, got {', '.join(found)}")
        values = found[column]
        if values.dtype.kind not in "fiu" or len(values) < 2 or not np.isfinite(values).all():
            raise InputError(f"{path}: column {column!r}: expected two or more finite numbers, got others")
    return {column: found[column].astype(np.float64) for column in columns}
