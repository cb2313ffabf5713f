"""Detection of wrong estimates from their own outputs, without a reference: torques beyond the gear, innovations far
beyond their variance, a large variance of the torque itself. All limits are far from a working estimator.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

GEAR = 5.0  # torque [rated torques] below which every strain wave gear ratchets
NIS = 25.0  # mean NIS over a second: innovations five times as large as estimated
UNSURE = 0.1
"""An estimator's own standard deviation [rated torques] of an estimate that says nothing; working ones have less than 0.01."""
SETTLING = 1.0  # time [s] after the start that is not checked


class Watch:
    """Checks the outputs of an estimator, in blocks."""

    def __init__(self, rated_torque: float, names: Sequence[str]):
        """`rated_torque`: of the joint [N·m]; `names`: of the outputs, in order; `torque` is one."""
        self._rated, self._names = rated_torque, tuple(names)
        self._pairs = [
            (i, self._names.index(name.replace("innovation", "innovation_variance", 1)))
            for i, name in enumerate(self._names)
            if name.startswith("innovation") and name.replace("innovation", "innovation_variance", 1) in self._names
        ]
        self._largest, self._start = 0.0, math.nan
        self._variance, self._samples = 0.0, 0
        self._sums, self._counts = np.zeros(0), np.zeros(0)

    def add(self, time: np.ndarray, out: np.ndarray) -> None:
        """Add samples: times [s], shape (n,); outputs, shape (n, outputs)."""
        if math.isnan(self._start):
            self._start = float(time[0])
        since = time - self._start
        settled = since >= SETTLING
        if not settled.any():
            return
        rows = out[settled]
        self._largest = max(self._largest, float(np.max(np.abs(rows[:, self._names.index("torque")]))))
        if "variance" in self._names:
            self._variance += float(np.sum(rows[:, self._names.index("variance")]))
            self._samples += len(rows)
        second = np.floor(since[settled]).astype(np.int64)
        more = max(int(second[-1]) + 1 - len(self._counts), 0)
        self._sums, self._counts = np.pad(self._sums, (0, more)), np.pad(self._counts, (0, more))
        for e, S in self._pairs:
            nis = np.divide(rows[:, e] ** 2, rows[:, S], out=np.zeros(len(rows)), where=rows[:, S] > 0)
            self._sums += np.bincount(second, nis, len(self._sums)) / len(self._pairs)
        self._counts += np.bincount(second, minlength=len(self._counts))

    @property
    def reason(self) -> str | None:
        """Why the estimate is not to be trusted; None if there is no reason."""
        if self._largest > GEAR * self._rated:
            return f"torque of {self._largest:.3g} N·m, more than {GEAR:g} times the gear's rated {self._rated:g} N·m"
        enough = self._counts > 0.5 * np.max(self._counts, initial=1.0)
        worst = float(np.max(self._sums[enough] / self._counts[enough], initial=0.0))
        if worst > NIS:
            return f"innovations {math.sqrt(worst):.3g} times as large as it believes, over a second"
        deviation = math.sqrt(self._variance / max(self._samples, 1))
        if deviation > UNSURE * self._rated:
            return f"its own standard deviation is {deviation:.3g} N·m, of a rated torque of {self._rated:g} N·m"
        return None
