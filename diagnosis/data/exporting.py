"""Recordings as MCAP files, for viewers and robots: messages of ROS 2, which bring their definitions with them.

| topic | message |
|---|---|
| `/joint_states` | `sensor_msgs/JointState`: `motor` (motor side) and `link` if measured, an arm's other joints |
| `/wrench` | `geometry_msgs/WrenchStamped`, the measured axes |
| `/temperature` | `sensor_msgs/Temperature` |
| `/CHANNEL` | `std_msgs/Float64`: motor current [A], torques [N·m], command [rad] |

Times are those of the recording, from 1 January 1970 on. The file's metadata `flexspline` says what its YAML file does.
"""

from __future__ import annotations

import json
from pathlib import Path

from ...models.errors import InputError
from ...models.files import write_into_place
from ...models.recording import Recording
from ...models.signals import WRENCH
from .log import needing
from .messages import DEFINITIONS

_LAST = 2.0**31  # s, of a stamp
_JOINTS = {"motor_position": "motor", "link_position": "link"}


def write_mcap(recording: Recording, path: Path) -> None:
    """Write a recording as an MCAP file.

    Raises:
      InputError: the packages are not installed, times before 1970 or past 2038, or the file cannot be written.
    """
    with needing("packages mcap and mcap-ros2-support", "writing MCAP", "mcap"):
        from mcap_ros2.writer import Writer
    if recording.time[0] < 0 or recording.time[-1] >= _LAST:
        raise InputError(
            f"{recording.source or recording.name}: time: expected 0 s to {_LAST:g} s, which messages can say, got "
            f"{recording.time[0]:g} s to {recording.time[-1]:g} s"
        )
    columns = dict(recording.columns)
    angles = {name: columns.pop(channel) for channel, name in _JOINTS.items() if channel in columns}
    angles |= recording.arm.positions if recording.arm is not None else {}
    wrench = {name: columns.pop(name) for name in WRENCH if name in columns}
    temperature = columns.pop("temperature", None)
    with write_into_place(path) as temporary, temporary.open("wb") as stream, Writer(stream) as writer:
        kinds = {kind: writer.register_msgdef(kind, text) for kind, text in DEFINITIONS.items()}

        def write(topic: str, kind: str, at: int, **fields: object) -> None:
            writer.write_message(topic, kinds[kind], fields, at, at)

        for k, seconds in enumerate(recording.time):
            at = round(1e9 * float(seconds))
            stamp = {"stamp": {"sec": at // 10**9, "nanosec": at % 10**9}, "frame_id": ""}
            positions = [float(values[k]) for values in angles.values()]
            write(
                "/joint_states", "sensor_msgs/msg/JointState", at,
                header=stamp, name=list(angles), position=positions, velocity=[], effort=[],
            )  # fmt: skip
            if wrench:
                axes = {name: float(wrench[name][k]) if name in wrench else 0.0 for name in WRENCH}
                parts = {what: {a: axes[f"{what}_{a}"] for a in "xyz"} for what in ("force", "torque")}
                write("/wrench", "geometry_msgs/msg/WrenchStamped", at, header=stamp, wrench=parts)
            if temperature is not None:
                write(
                    "/temperature", "sensor_msgs/msg/Temperature", at,
                    header=stamp, temperature=float(temperature[k]), variance=0.0,
                )  # fmt: skip
            for name, values in columns.items():
                write(f"/{name}", "std_msgs/msg/Float64", at, data=float(values[k]))
        known = {"joint": recording.joint, "description": recording.description, "external_torque": recording.external}
        spec = None if recording.arm is None else recording.arm.spec.model_dump()
        load = {"link": recording.link.model_dump_json()} if spec is None else {"arm": json.dumps(spec)}
        writer.add_metadata("flexspline", known | load)
