"""What acts on a scenario's joint over time, a part after the other: to the bit what it is as a whole."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from ..models import streams
from ..sim.loop import CONTROL_PERIOD
from ..sim.sensors import jittered, stream
from .scenario import Scenario, Walk


class Acting(NamedTuple):
    """What acts at n control ticks, shape (n,) each.

    Attributes:
      position, velocity: of the link, commanded [rad], [rad/s].
      external_torque: on the link [N·m]. temperature: of the gear [°C].
      tip_force: tangential force [N] that the external torque comes from.
    """

    position: np.ndarray
    velocity: np.ndarray
    external_torque: np.ndarray
    temperature: np.ndarray
    tip_force: np.ndarray


class Course:
    """What acts on a scenario's joint from the start on."""

    def __init__(self, scenario: Scenario):
        """Before the first tick."""
        self._scenario, self._done = scenario, 0
        self._walks = {
            i: Walk(scenario.seed, d.start, sum(int(np.count_nonzero(d.acts(time))) for time in _times(scenario.ticks)))
            for i, d in enumerate(scenario.disturbances)
            if d.kind == "walk"
        }

    def next(self, ticks: int) -> Acting:
        """What acts at so many further ticks."""
        scenario = self._scenario
        time = np.arange(self._done, self._done + ticks) * CONTROL_PERIOD
        self._done += ticks
        external, force = np.zeros_like(time), np.zeros_like(time)
        for i, d in enumerate(scenario.disturbances):
            if i not in self._walks and not (d.start <= time[-1] and time[0] <= d.start + d.duration):
                continue
            torque = d.signal(time, scenario.seed, self._walks.get(i))
            external = external + torque
            if d.lever > 0.0:
                force = force + torque / d.lever
        return Acting(*scenario.commands(time), external, scenario.temperature.signal(time), force)


def ever_pushed(scenario: Scenario) -> bool:
    """Whether there is ever a torque on the link."""
    course = Course(scenario)
    parts = streams.parts(scenario.ticks)
    return bool(scenario.disturbances) and any(np.any(course.next(p.stop - p.start).external_torque) for p in parts)


class Stamps:
    """Time stamps of a scenario's samples [s], as `sim.sensors.time_stamps` makes them."""

    def __init__(self, scenario: Scenario):
        """Before the first sample."""
        self._jitter, self._rng, self._done = scenario.jitter, stream(scenario.seed, "jitter"), 0
        self._step = streams.median(lambda: _differences(_times(scenario.ticks))) if self._jitter else 0.0

    def next(self, ticks: int) -> np.ndarray:
        """Those of so many further samples, shape (ticks,)."""
        time = np.arange(self._done, self._done + ticks) * CONTROL_PERIOD
        self._done += ticks
        return jittered(time, self._jitter, self._rng, self._step) if self._jitter else time


def interval(scenario: Scenario) -> float:
    """Median time between time stamps [s], to the nanosecond (`estimator.sample_interval`)."""

    def stamps() -> Iterator[np.ndarray]:
        found = Stamps(scenario)
        return _differences(found.next(part.stop - part.start) for part in streams.parts(scenario.ticks))

    return round(streams.median(stamps), 9)


def _times(ticks: int) -> Iterator[np.ndarray]:
    for part in streams.parts(ticks):
        yield np.arange(part.start, part.stop) * CONTROL_PERIOD


def _differences(series: Iterator[np.ndarray]) -> Iterator[np.ndarray]:
    last = np.empty(0)
    for values in series:
        yield np.diff(np.concatenate([last, values]))
        last = values[-1:]
