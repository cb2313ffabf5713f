"""What people get wrong in their data, each named with the change that mends it: before any physics."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from ...models.joint import Joint
from ...models.recording import Measurement


@dataclass(frozen=True)
class Mistake:
    """A mistake in the data.

    Attributes:
      name: `unit`, `sign`, `gear_ratio`, `swapped`, `late`, `wrapped`, `velocity`, `angle_zero`, `stuck`, `glitch`, `clipped`.
      column: that has it; empty where it is no single one's.
      recording: name of the recording that has it; empty where all have.
      description: for people.
      confidence: probability of it.
      factor: that mends the column (of `gear_ratio`: that mends N). seconds: by which the column is late. offset: that mends it, added.
      rows: of the table that have it, from 0.
      severe: whether it makes physics meaningless.
    """

    name: str
    column: str
    recording: str
    description: str
    confidence: float
    factor: float | None = None
    seconds: float | None = None
    offset: float | None = None
    rows: tuple[int, ...] | None = None
    severe: bool = True

    def to_json(self) -> dict[str, Any]:
        """As it stands in `diagnosis.json`."""
        data: dict[str, Any] = {"name": self.name}
        for key in ("column", "recording"):
            if getattr(self, key):
                data[key] = getattr(self, key)
        for key in ("factor", "seconds", "offset"):
            if getattr(self, key) is not None:
                data[key] = float(f"{getattr(self, key):.6g}")
        if self.rows is not None:
            data["rows"] = list(self.rows)
        return data | {"description": self.description, "confidence": round(self.confidence, 3)}


def find_mistakes(measurement: Measurement, joint: Joint) -> tuple[Mistake, ...]:
    """Mistakes in a measurement of a joint."""
    return ()
