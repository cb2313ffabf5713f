"""Measuring wall time: warm-up, repeats, medians."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np


@dataclass(frozen=True)
class Timing:
    """Wall times of repeated runs [s]."""

    seconds: tuple[float, ...]

    @property
    def median(self) -> float:
        """Median [s]."""
        return float(np.median(self.seconds))

    def __str__(self) -> str:
        return f"{self.median:.3f} s (of {len(self.seconds)}: {min(self.seconds):.3f} to {max(self.seconds):.3f} s)"


def measure(function: Callable[[], Any], repeats: int = 5) -> Timing:
    """Run once to warm up, then `repeats` times."""
    function()
    seconds = []
    for _ in range(repeats):
        begin = time.perf_counter()
        function()
        seconds.append(time.perf_counter() - begin)
    return Timing(tuple(seconds))


def verdict(met: bool) -> str:
    """How a target is reported."""
    return "met" if met else "missed"
