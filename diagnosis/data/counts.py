"""How coarse a log's readings are: its own steps and rates, where the description says finer ones.

A link encoder of 16 bits that is described with 20 makes noise of the torsion that no replicate has, which looks like a
resonance; so does a torque sensor whose readings are held for ten samples.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ...estimator.held import FEWEST, HELD, held_for
from ...models.joint import AnalogSpec, EncoderSpec, Joint
from ...models.recording import Recording
from ...models.signals import CHANNELS
from .sampling import SETTINGS as SAMPLING

_CHANNELS = ("motor_position", "link_position", "motor_current", "joint_torque")
_NEAR = 20  # steps: changes of so many at most are looked at
_OFF = 0.1  # of a step: changes that are so near a whole number of steps
_SHARE = 0.98  # of the changes that must be whole numbers of steps
_COARSER = 1.5  # times the described step


@dataclass(frozen=True)
class Coarse:
    """A column whose readings are coarser than described: in steps [its unit], or read anew at a rate [Hz]."""

    column: str
    what: str
    found: float
    described: float

    @property
    def text(self) -> str:
        """For people."""
        if self.what == "rate":
            return f"{self.column} is read anew at {self.found:.4g} Hz, described: {self.described:.4g} Hz"
        was = f"{self.described:.3g}" if self.described else "none"
        return f"{self.column} comes in steps of {self.found:.3g} {CHANNELS[self.column].unit}, described: {was}"


def step_of(reading: np.ndarray) -> float:
    """Step of a reading, shape (n,), of which all its changes are whole numbers, in its unit; 0 where it comes in none."""
    change = np.abs(np.diff(reading))
    change = change[change > 1e-12 * max(float(np.ptp(reading)), 1e-300)]
    if len(change) < FEWEST:
        return 0.0
    step = float(np.percentile(change, 1))
    steps = change[change < _NEAR * step] / step
    whole = float(np.mean(np.abs(steps - np.round(steps)) < _OFF))
    return step if whole > _SHARE else 0.0


def rate_of(time: np.ndarray, reading: np.ndarray, resolution: float = 0.0) -> float:
    """Rate [Hz] at which a reading, shape (n,), that is held for a number of samples is read anew; 0 where it is not held so.

    Args:
      resolution: of an encoder, in its unit.
    """
    if resolution:
        samples = held_for(reading, resolution)
    else:
        apart = np.diff(np.flatnonzero(np.diff(reading) != 0.0))
        samples = int(np.median(apart)) if len(apart) >= FEWEST else 1
        samples = samples if float(np.mean(apart == samples)) > HELD else 1
    return 1.0 / (samples * float(np.median(np.diff(time)))) if samples >= 2 else 0.0


def coarser(recordings: Sequence[Recording], joint: Joint, wrong: Collection[str] = ()) -> tuple[Coarse, ...]:
    """Columns that are coarser in all recordings than the joint's description says, without those that are `wrong`."""
    found = []
    for name in _CHANNELS:
        there = [r for r in recordings if name in r and name not in wrong]
        spec = joint.sensors.of(CHANNELS[name])
        steps = [step_of(r[name]) for r in there]
        if not steps or not isinstance(spec, EncoderSpec | AnalogSpec):
            continue
        described = spec.resolution if isinstance(spec, EncoderSpec) else spec.step
        # Finer steps are none beside an analog sensor's noise.
        least = 0.0 if isinstance(spec, EncoderSpec) else spec.noise
        if min(steps) > max(_COARSER * described, least):
            found.append(Coarse(name, "step", min(steps), described))
        if isinstance(spec, EncoderSpec) or spec.noise:  # without noise a reading may well stay the same
            resolution = spec.resolution if isinstance(spec, EncoderSpec) else 0.0
            rates = [rate_of(r.time, r[name], resolution) for r in there if np.count_nonzero(np.diff(r[name])) > FEWEST]
            if rates and 0.0 < min(rates) and max(rates) < SAMPLING.slower * spec.rate:
                found.append(Coarse(name, "rate", max(rates), spec.rate))
    return tuple(found)


_FEWEST_COUNTS = 2
"""Of an encoder in a turn, as a description has them."""


def as_logged(joint: Joint, recordings: Sequence[Recording], wrong: Collection[str] = ()) -> Joint:
    """The joint with sensors as coarse as a log's readings are; the same where the description has it right.

    Columns that are `wrong`, in another unit say, tell nothing of their sensor.
    """
    changed: dict[str, Any] = {}
    for one in coarser(recordings, joint, wrong):
        channel = CHANNELS[one.column]
        spec = changed.get(channel.sensor, joint.sensors.of(channel))
        new: dict[str, Any] = {one.what: one.found}
        if isinstance(spec, EncoderSpec) and one.what == "step":
            new = {"counts": max(round(2 * np.pi / one.found), _FEWEST_COUNTS), "bits": None}
        changed[channel.sensor] = spec.model_copy(update=new)
    return joint.model_copy(update={"sensors": joint.sensors.model_copy(update=changed)}) if changed else joint
