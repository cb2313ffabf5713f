"""How well a joint's description predicts a measurement. Nothing is fitted.

The described joint is driven with the measured motion (`fit.replay`); what its sensors should then have read stands beside what
they read, at the samples of the recording. Errors are taken in motion: at rest friction may be anything up to its level.

Every simulated channel has a 95 % band, in which the channel without its sensor's noise lies if the description is right about
itself: the root of the sum of squares of

* what the description leaves open: changes along its independent directions (`models.uncertainty`),
* what a diagnosis found that it cannot hold (`Uncertainty.discrepancy`), the more the further beyond the range of validity,
* what the noise of the measured motion makes of the simulation, from noise replicates; at rest, friction's own level.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ..models import laws
from ..models.joint import Joint
from ..models.recording import Measurement, Recording
from ..models.signals import CHANNELS
from ..models.uncertainty import directions
from .data.mistakes import Mistake, find_mistakes
from .data.segments import BALANCES, CURRENT, LINK, STEP, TORQUE, Segment, segments
from .fit.replay import _readings, parallel, transmission

SIGMAS = 1.96
"""Standard deviations of a 95 % band."""
BINS = 4
"""Regions into which the range of angle, speed and load is cut."""
FEWEST = 20
"""Samples in motion that a region must have."""


@dataclass(frozen=True)
class ChannelError:
    """Error of a simulated channel in motion: rms, and what sensors' noise alone would leave, both in `unit`; share of the
    samples whose reading lies in the band widened by the sensor's own noise; number of samples."""

    rms: float
    noise: float
    unit: str
    inside: float
    samples: int

    def to_json(self) -> dict[str, Any]:
        """As it stands in `validation.json`."""
        return {"rms": self.rms, "noise": self.noise, "unit": self.unit, "inside": self.inside, "samples": self.samples}


@dataclass(frozen=True)
class ValidationRegion:
    """RMS error of every channel in motion in a part of the range of a variable.

    Attributes:
      by: angle, speed, load or direction.
      low, high, unit: of the variable; of direction the sign of the velocity.
      samples: in motion.
      rms: by channel, in its unit.
      beyond: share of the samples that lie beyond the joint's range of validity.
    """

    by: str
    low: float
    high: float
    unit: str
    samples: int
    rms: dict[str, float]
    beyond: float

    def to_json(self) -> dict[str, Any]:
        """As it stands in `validation.json`."""
        return {
            "by": self.by, "from": self.low, "to": self.high, "unit": self.unit, "samples": self.samples, "rms": self.rms,
            "beyond": self.beyond,
        }  # fmt: skip


@dataclass(frozen=True)
class Channels:
    """One recording measured and simulated; n samples, not finite where nothing could be simulated.

    Attributes:
      name: of the recording.
      time: shape (n,) [s].
      measured, simulated, deviation: by channel, shape (n,); the last is half a band over `SIGMAS`.
      moving: which samples count, shape (n,), bool.
      units: by channel.
    """

    name: str
    time: np.ndarray
    measured: dict[str, np.ndarray]
    simulated: dict[str, np.ndarray]
    deviation: dict[str, np.ndarray]
    moving: np.ndarray
    units: dict[str, str]

    @property
    def columns(self) -> dict[str, np.ndarray]:
        """All columns as they are written: `time`, and of every channel `<channel>`, `<channel>_simulated`, `_low`, `_high`."""
        found = {"time": self.time}
        for name, values in self.measured.items():
            half = SIGMAS * self.deviation[name]
            found[name] = values
            found[f"{name}_simulated"] = self.simulated[name]
            found[f"{name}_low"], found[f"{name}_high"] = self.simulated[name] - half, self.simulated[name] + half
        return found

    @property
    def column_units(self) -> dict[str, str]:
        """Unit of every one of `columns`."""
        found = {"time": "s"}
        for name, unit in self.units.items():
            found |= {f"{name}{end}": unit for end in ("", "_simulated", "_low", "_high")}
        return found


@dataclass(frozen=True)
class Validation:
    """How well a description predicts a measurement.

    Attributes:
      joint: its name.
      residual: by channel.
      regions: by angle, speed, load and direction.
      beyond: shares of the samples in motion beyond the joint's range of validity, by variable; empty where there are none.
      mistakes: in the data.
      recordings: measured and simulated channels.
    """

    joint: str
    residual: dict[str, ChannelError]
    regions: tuple[ValidationRegion, ...]
    beyond: dict[str, float]
    mistakes: tuple[Mistake, ...] = ()
    recordings: tuple[Channels, ...] = field(default=(), repr=False)

    def to_json(self) -> dict[str, Any]:
        """What `validation.json` holds."""
        return {
            "joint": self.joint,
            "residual": {name: error.to_json() for name, error in self.residual.items()},
            "regions": [region.to_json() for region in self.regions],
            "beyond": self.beyond,
            "mistakes": [m.to_json() for m in self.mistakes],
            "recordings": [r.name for r in self.recordings],
        }


def validate(measurement: Measurement, joint: Joint) -> Validation:
    """Hold a joint's description against a measurement.

    Args:
      measurement: recordings of the joint.
      joint: its description.
    """
    recordings, parts = [], []
    for recording in measurement.recordings:
        channels, inside = _simulated(recording, joint)
        recordings.append(channels)
        parts += inside
    return Validation(
        joint=joint.name,
        residual=_residual(recordings, parts, joint),
        regions=tuple(_regions(parts, joint)),
        beyond=_beyond(parts, joint),
        mistakes=find_mistakes(measurement, joint),
        recordings=tuple(recordings),
    )
