"""Check of a measurement before a diagnosis: its contents, its mistakes, and the causes that it can show."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from typing import Any

from ..estimator.conditioning import Coarse, coarser, condition
from ..models import causes
from ..models.errors import InputWarning
from ..models.files import plain
from ..models.joint import Joint
from ..models.recording import Measurement
from .data import coverage
from .data.mistakes import Mistake, find_mistakes, mended_if_possible
from .doubts import doubts
from .regression import Regression, regressions


@dataclass(frozen=True)
class Check:
    """Contents of a measurement, its mistakes, and the causes that it can show.

    Attributes:
      measurement: the measurement. joint: the description that it is compared with.
      corrected: the measurement without its mistakes; None if they cannot be corrected.
      mistakes: in the data, with their corrections.
      recordings: rates, gaps, ranges and motion of each recording.
      missing: channels that no recording has. coarse: channels that are coarser than described.
      balances: the comparisons that a diagnosis makes. regressions: plain regressions of friction and stiffness.
      can_show: causes that are detectable, unless the parameter tolerances mask them.
      undetermined: other causes, with the reason.
    """

    measurement: Measurement
    joint: Joint
    corrected: Measurement | None
    mistakes: tuple[Mistake, ...]
    recordings: tuple[coverage.RecordingSummary, ...]
    missing: tuple[str, ...]
    coarse: tuple[Coarse, ...]
    balances: tuple[coverage.Balance, ...]
    regressions: tuple[Regression, ...]
    can_show: tuple[str, ...]
    undetermined: dict[str, str]

    def __repr__(self) -> str:
        parts = (
            f"Check({self.measurement.name!r} of {self.joint.name}, recordings: {len(self.recordings)}",
            f"  mistakes: {', '.join(dict.fromkeys(m.name for m in self.mistakes)) or 'none'}",
            f"  missing channels: {', '.join(self.missing) or 'none'}",
            f"  can show: {', '.join(self.can_show) or 'no cause'}",
            f"  cannot show: {len(self.undetermined)} causes)",
        )
        return "\n".join(parts)

    def to_json(self) -> dict[str, Any]:
        """Return plain data, as `flexspline check --json` prints them."""
        return plain(
            {
                "measurement": self.measurement.name, "joint": self.joint.name, "mistakes": self.mistakes,
                "fixed": self.measurement.fixed, "recordings": self.recordings, "missing": self.missing, "coarser": self.coarse,
                "balances": self.balances, "regressions": self.regressions, "can_show": self.can_show,
                "undetermined": self.undetermined,
            }
        )  # fmt: skip


def check(measurement: Measurement, joint: Joint) -> Check:
    """Check a measurement against a joint's description. If its mistakes can be corrected, the rest is of the corrected data.

    Warns:
      InputWarning: a load, a drive or a stiffness that the torques contradict, a motor torque that does not match the motor
        current, a noisy sensor.
    """
    mistakes = find_mistakes(measurement, joint)
    corrected = mended_if_possible(measurement, joint, mistakes)
    data = measurement if corrected is None else corrected
    conditioned = [condition(recording, joint) for recording in data.recordings]
    pairs = zip(data.recordings, conditioned, strict=True)
    summaries = [coverage.summarise(recording, joint, one) for recording, one in pairs]
    reasons = coverage.undetermined(data, joint, summaries)
    found = Check(
        measurement, joint, corrected, tuple(mistakes), tuple(summaries), tuple(coverage.missing_columns(data)),
        coarser(data.recordings, joint), coverage.balances(data), regressions(data, joint, conditioned),
        tuple(name for name in causes.of(joint) if name not in reasons), reasons,
    )  # fmt: skip
    load, others = doubts(data, joint, conditioned)
    for text in (*(f"{measurement.name}: {text}" for text in load), *others):
        warnings.warn(text, InputWarning, stacklevel=2)
    return found
