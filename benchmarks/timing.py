"""Measuring wall time: warm-up, repeats, medians."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np


@dataclass(frozen=True)
class Timing:
    """Wall times of repeated runs, and the time that this process had a core for them [s]."""

    seconds: tuple[float, ...]
    busy: tuple[float, ...]

    @property
    def median(self) -> float:
        """Median [s]."""
        return float(np.median(self.seconds))

    @property
    def core(self) -> float:
        """Median of the core's time [s]: what the wall time would be with the machine to itself."""
        return float(np.median(self.busy))

    def __str__(self) -> str:
        spread = f"of {len(self.seconds)}: {min(self.seconds):.3f} to {max(self.seconds):.3f} s"
        return f"{self.median:.3f} s ({spread}; {self.core:.3f} s of a core)"


def measure(function: Callable[[], Any], repeats: int = 5) -> Timing:
    """Run once to warm up, then `repeats` times."""
    function()
    seconds, busy = [], []
    for _ in range(repeats):
        begin, core = time.perf_counter(), time.process_time()
        function()
        seconds.append(time.perf_counter() - begin)
        busy.append(time.process_time() - core)
    return Timing(tuple(seconds), tuple(busy))


def verdict(met: bool) -> str:
    """How a target is reported."""
    return "met" if met else "missed"
