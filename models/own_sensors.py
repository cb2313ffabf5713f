"""Sensors of plugins: additional channels for a plugin's estimators.

Their readings follow from the true signals of a run, afterwards: neither the drive nor the estimator in the loop uses
them. Runs, their recordings and measured recordings have them as columns; diagnosis ignores them.
"""

from __future__ import annotations

import re
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from typing import ClassVar

import numpy as np

from . import plugins
from .errors import InputError
from .signals import CHANNELS, Channel

_NAME = re.compile(r"[a-z][a-z0-9_]*")


class Sensor(ABC):
    """A sensor: name, unit and reading law.

    Attributes:
      name: of its channel and column.
      unit: SI.
      description: in words.
    """

    name: ClassVar[str]
    unit: ClassVar[str]
    description: ClassVar[str] = ""

    @abstractmethod
    def read(self, time: np.ndarray, truth: Mapping[str, np.ndarray], rng: np.random.Generator) -> np.ndarray:
        """Return its readings.

        Args:
          time: of the samples [s], shape (n,).
          truth: true signals by name (`sim.loop.TRUTH`, and `external_torque`), shape (n,) each, SI.
          rng: its noise, by the run's seed and the sensor's name alone.

        Returns:
          Readings, shape (n,), finite.
        """


def names() -> tuple[str, ...]:
    """Return the names of all sensors of plugins."""
    return tuple(_offered())


def get(name: str) -> Sensor:
    """Return a sensor. Raises `InputError`: not a sensor, or one that does not follow its interface."""
    return plugins.made(_offered()[name], Sensor, _check)


def _check(sensor: Sensor) -> None:
    if not _NAME.fullmatch(sensor.name):
        raise InputError(f"name: expected {_NAME.pattern}, got {sensor.name!r}")
    if not isinstance(getattr(sensor, "unit", None), str):
        raise InputError("unit: expected a text, got none")


def origin(name: str) -> plugins.Origin:
    """Return the origin of the sensor of that name."""
    return _offered()[name].origin


def channel(name: str) -> Channel | None:
    """Return a channel of any joint or of a plugin's sensor; None if there is none."""
    if name in CHANNELS or name not in _offered():
        return CHANNELS.get(name)
    sensor = get(name)
    return Channel(name, sensor.unit, sensor.description)


def readings(
    time: np.ndarray, truth: Mapping[str, np.ndarray], stream: Callable[[str], np.random.Generator]
) -> dict[str, np.ndarray]:
    """Return the readings of all sensors of plugins, shape (n,) each, by channel. `time`, `truth`: as of `Sensor.read`;
    `stream`: random numbers of a name. Raises `InputError`: readings of another shape, or that are not finite."""
    found = {}
    for name in names():
        values = np.asarray(get(name).read(time, truth, stream(f"sensor {name}")), float)
        where = _offered()[name].where
        if values.shape != time.shape:
            raise InputError(f"{where}: expected readings of shape {time.shape}, got {values.shape}")
        if not np.isfinite(values).all():
            raise InputError(
                f"{where}: expected finite readings, got {np.count_nonzero(~np.isfinite(values))} that are not"
            )
        found[name] = values
    return found


def _offered() -> dict[str, plugins.Offer]:
    return plugins.offers("sensors", CHANNELS)
