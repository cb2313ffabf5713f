"""Signals by name: every channel of a joint's sensors, a log or a command, with its unit.

A sensor's channel is one entry here, with its field of `joint_parts.Sensors` (noise, delay, rate), and its reading law in
`models.dynamics.readings`. Recordings, the simulated sensors and run folders take the channels from here.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, fields, is_dataclass, replace
from typing import Any, TypeVar

import numpy as np

from .errors import InputError, nearest
from .parameters import floats


@dataclass(frozen=True)
class Channel:
    """A channel."""

    name: str  # of its column
    unit: str  # SI; positions of the motor on the motor side, of the link on the output side
    description: str  # in words
    sensor: str = ""  # field of `joint_parts.Sensors` with its noise; empty without a sensor (time, commands)
    at_step: bool = False  # whether its value depends on forces that are known only after the plant's step


_AXES = "xyz"
_ALL = (
    Channel("time", "s", "time of the sample"),
    Channel("motor_position", "rad", "motor encoder, motor side", "motor_encoder"),
    Channel("link_position", "rad", "link encoder, output side", "link_encoder"),
    Channel("motor_current", "A", "motor current", "motor_current"),
    Channel("motor_torque", "N·m", "motor torque as the drive reports it, motor side", "motor_torque"),
    Channel("joint_torque", "N·m", "torque that the joint gives the link, about the joint axis", "joint_torque", True),
    Channel("temperature", "°C", "temperature of gear or motor", "temperature"),
    *(Channel(f"force_{a}", "N", f"force along {a} in the sensor's frame", "wrench", True) for a in _AXES),
    *(Channel(f"torque_{a}", "N·m", f"torque about {a} in the sensor's frame", "wrench", True) for a in _AXES),
    Channel("position_command", "rad", "commanded link position"),
    Channel("external_torque", "N·m", "torque on the link that was known"),
)
CHANNELS: dict[str, Channel] = {channel.name: channel for channel in _ALL}  # all channels by name

SENSED: tuple[str, ...] = tuple(c.name for c in _ALL if c.sensor)  # channels of sensors, in the order of `READINGS`
POSITIONS: tuple[str, ...] = ("motor_position", "link_position")  # a recording has at least one of these
DRIVING: tuple[str, ...] = ("motor_current", "motor_torque", "joint_torque")
"""A recording has at least one of these, for the size of the torques."""
WRENCH: tuple[str, ...] = tuple(c.name for c in _ALL if c.sensor == "wrench")
"""Axes of the force/torque sensor; the joint's axis is its y, and positive torque about it drives the link backwards."""

READINGS = floats(*SENSED)
"""Readings of all sensors at one instant, as a record for compiled code."""


@dataclass(frozen=True)
class Signals(Mapping[str, np.ndarray]):
    """Time and channels by name, shape (n,) each, float64, SI. Raises `InputError`: shapes that differ, values that are
    not finite, time that does not increase."""

    time: np.ndarray  # [s], increasing; not necessarily even, nor from zero
    # channels by name (`CHANNELS`, or a further name such as `current_command`)
    columns: Mapping[str, np.ndarray] = field(default_factory=dict)

    def __post_init__(self) -> None:
        time = np.ascontiguousarray(self.time, dtype=np.float64)
        if time.ndim != 1 or len(time) < 2 or not bool(np.all(np.diff(time) > 0)):
            raise InputError("signals: time: expected two or more increasing times [s]")
        found = {}
        for name, given in self.columns.items():
            values = np.ascontiguousarray(given, dtype=np.float64)
            if values.shape != time.shape or not np.isfinite(values).all():
                raise InputError(f"signals: {name}: expected finite numbers, shape {time.shape}, got {values.shape}")
            found[name] = values
        object.__setattr__(self, "time", time)
        object.__setattr__(self, "columns", found)

    def __getitem__(self, name: str) -> np.ndarray:
        if name not in self.columns:
            raise InputError(
                f"signals: expected a channel {name!r}, got {sorted(self.columns)}{nearest(name, self.columns)}"
            )
        return self.columns[name]

    def get(self, name: str, default: Any = None) -> Any:
        """Return the channel, or the default."""
        return self.columns.get(name, default)

    def __contains__(self, name: object) -> bool:
        return name in self.columns

    def __iter__(self) -> Iterator[str]:
        return iter(self.columns)

    def __len__(self) -> int:
        return len(self.columns)

    def part(self, samples: slice | np.ndarray) -> Signals:
        """Return the same channels at some of the samples."""
        return at_samples(self, samples)

    def without(self, *names: str) -> Signals:
        """Return the signals without some channels."""
        return Signals(self.time, {name: values for name, values in self.columns.items() if name not in names})

    def with_columns(self, **columns: np.ndarray) -> Signals:
        """Return the signals with further channels, or others of the same name."""
        return Signals(self.time, {**self.columns, **columns})


Sampled = TypeVar("Sampled")


def at_samples(record: Sampled, samples: slice | np.ndarray, **others: Any) -> Sampled:
    """Return a dataclass with its arrays, also those in mappings by name and in dataclasses inside it, shape (n, …) each, at
    some of the samples; `others`: fields with another value."""
    found: dict[str, Any] = {}
    for name, value in ((f.name, getattr(record, f.name)) for f in fields(record)):  # type: ignore[arg-type]
        if isinstance(value, np.ndarray):
            found[name] = value[samples]
        elif isinstance(value, Mapping):
            found[name] = {key: x[samples] for key, x in value.items()}
        elif is_dataclass(value):
            found[name] = at_samples(value, samples)
    return replace(record, **found | others)  # type: ignore[type-var]
