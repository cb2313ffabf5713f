"""Measuring wall and core time: warm-up, repeats, medians; functions in this process and whole commands."""

from __future__ import annotations

import os
import resource
import subprocess
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np


@dataclass(frozen=True)
class Timing:
    """Wall times of repeated runs, and the time that a core was busy with them [s], with all threads and processes."""

    seconds: tuple[float, ...]
    busy: tuple[float, ...]

    @property
    def median(self) -> float:
        """Median [s]."""
        return float(np.median(self.seconds))

    @property
    def core(self) -> float:
        """Median of the cores' time [s]: what the wall time of one thread would be with the machine to itself."""
        return float(np.median(self.busy))

    def __str__(self) -> str:
        spread = f"of {len(self.seconds)}: {min(self.seconds):.3f} to {max(self.seconds):.3f} s"
        return f"{self.median:.3f} s ({spread}; {self.core:.3f} s of a core)"


def measure(function: Callable[[], Any], repeats: int = 5) -> Timing:
    """Run once to warm up, then `repeats` times."""
    return alternately({"": function}, repeats)[""]


def alternately(functions: Mapping[str, Callable[[], object]], repeats: int = 5) -> dict[str, Timing]:
    """Time functions in turns, after a warm-up, so that what else the machine does falls on all of them."""
    found: dict[str, list[tuple[float, float]]] = {name: [] for name in functions}
    for function in functions.values():
        function()
    for _ in range(repeats):
        for name, function in functions.items():
            begin, core = time.perf_counter(), _core()
            function()
            found[name].append((time.perf_counter() - begin, _core() - core))
    return {name: Timing(tuple(w for w, _ in s), tuple(c for _, c in s)) for name, s in found.items()}


def program(words: Sequence[str], cwd: str | os.PathLike[str] | None = None) -> Callable[[], None]:
    """A program as a function, whose output is thrown away.

    Raises:
        CalledProcessError: it ends with another code than 0.
    """
    return lambda: _call(words, cwd)


def _call(words: Sequence[str], cwd: str | os.PathLike[str] | None) -> None:
    subprocess.run(words, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, cwd=cwd)


def _core() -> float:
    """Time that cores have been busy with this process and the ended ones that it started [s]."""
    children = resource.getrusage(resource.RUSAGE_CHILDREN)
    return time.process_time() + children.ru_utime + children.ru_stime


def verdict(met: bool) -> str:
    """How a target is reported."""
    return "met" if met else "missed"
