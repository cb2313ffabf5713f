from __future__ import annotations
from dataclasses import dataclass
@dataclass(frozen=True)
class LateColumn:
    column: str
    seconds: float
    recordings: tuple[int, ...]
    confidence: float
def late_columns(recordings, joint):
    return ()
