"""Sensors from outside this package: a channel beside those that every joint has, which a plugin's estimators may read.

What one reads follows from the true signals, after the fact: neither the drive nor the estimator that is fed back knows of it.
Runs, their recordings and measured recordings have it as a column; diagnosis leaves it alone.
"""

from __future__ import annotations

import re
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from typing import Any, ClassVar

import numpy as np

from . import plugins
from .errors import InputError
from .signals import CHANNELS, Channel

_NAME = re.compile(r"[a-z][a-z0-9_]*")


class Sensor(ABC):
    """A sensor: what it is called, in which unit it reads, and how.

    Attributes:
      name: of its channel, and so of its column.
      unit: SI.
      description: for people.
    """

    name: ClassVar[str]
    unit: ClassVar[str]
    description: ClassVar[str] = ""

    @abstractmethod
    def read(self, time: np.ndarray, truth: Mapping[str, np.ndarray], rng: np.random.Generator) -> np.ndarray:
        """What it reads.

        Args:
          time: of the samples [s], shape (n,).
          truth: true signals by name (`sim.loop.TRUTH`, and `external_torque`), shape (n,) each, SI.
          rng: its noise; of the run's seed and the sensor's name alone.

        Returns:
          Readings, shape (n,), finite.
        """


def names() -> tuple[str, ...]:
    """Names of all sensors that plugins offer."""
    return tuple(_offered())


def get(name: str) -> Sensor:
    """A sensor.

    Raises:
      InputError: one that is none, or does not keep what one promises.
    """
    where = f"sensor {name!r} of {origin(name).name}"
    given: Any = _offered()[name].get()
    sensor = given() if isinstance(given, type) and issubclass(given, Sensor) else given
    if not isinstance(sensor, Sensor):
        raise InputError(f"{where}: expected a flexspline.models.own_sensors.Sensor, got {type(sensor).__name__}")
    if sensor.name != name or not _NAME.fullmatch(name):
        raise InputError(f"{where}: name: expected {_NAME.pattern}, as it is offered, got {sensor.name!r}")
    if not isinstance(getattr(sensor, "unit", None), str):
        raise InputError(f"{where}: unit: expected a text, got none")
    return sensor


def origin(name: str) -> plugins.Origin:
    """Where the sensor of that name comes from."""
    return _offered()[name].origin


def channel(name: str) -> Channel | None:
    """A channel of any joint, or that of a plugin's sensor; none where there is no such channel."""
    if name in CHANNELS or name not in _offered():
        return CHANNELS.get(name)
    sensor = get(name)
    return Channel(name, sensor.unit, sensor.description)


def readings(
    time: np.ndarray, truth: Mapping[str, np.ndarray], stream: Callable[[str], np.random.Generator]
) -> dict[str, np.ndarray]:
    """What all sensors of plugins read, shape (n,) each, by channel.

    Args:
      time: of the samples [s], shape (n,).
      truth: true signals by name, shape (n,) each.
      stream: random numbers of a name.

    Raises:
      InputError: readings of another shape, or that are not finite.
    """
    found = {}
    for name in names():
        values = np.asarray(get(name).read(time, truth, stream(f"sensor {name}")), float)
        where = f"sensor {name!r} of {origin(name).name}"
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
