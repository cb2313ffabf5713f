"""Estimators beside signals that are still being made: a stretch at a time, to the bit what they say of the whole."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ..models.errors import InputError
from .errors import FilterDiverged
from .estimator import (
    CausalEstimator,
    KnownJoint,
    Posterior,
    blank_samples,
    fill_samples,
    go_on,
    interval_of,
)


class OnlineSamples:
    """What estimators read of signals that fill up: records of `models.step.SAMPLE`, shape (n,), with and without the command.

    Args of the constructor:
      time: of all samples [s], shape (n,). columns: channels, shape (n,) each, that somebody fills. joint: what is known.
    """

    def __init__(self, time: np.ndarray, columns: Mapping[str, np.ndarray], joint: KnownJoint):
        self.time, self.columns, self.joint = time, columns, joint
        self._records = {reads_command: blank_samples(time, joint) for reads_command in (False, True)}

    def fill(self, part: slice) -> None:
        """Take up the channels' samples of a stretch."""
        for reads_command, records in self._records.items():
            fill_samples(records, self.columns, part, reads_command)

    def of(self, estimator: CausalEstimator) -> np.ndarray:
        """The records that an estimator reads."""
        return self._records[estimator.reads_command]


class OnlineEstimate:
    """An estimator that goes along with signals.

    Attributes:
      estimator: the estimator.
    """

    def __init__(self, estimator: CausalEstimator, samples: OnlineSamples):
        """Begin before the first sample.

        Raises:
          InputError: a channel that is missing.
        """
        for name in estimator.needs:
            if name not in samples.columns:
                raise InputError(
                    f"estimator {estimator.name!r}: expected a channel {name!r}, got {sorted(samples.columns)}"
                )
        self.estimator, self._samples = estimator, samples
        self._step = estimator.step(samples.joint, interval_of(samples.time))
        self._arrays = self._step.arrays()
        self._history = np.zeros((len(samples.time), len(estimator.outputs)))

    def advance(self, part: slice) -> Posterior:
        """What the estimator says of the next stretch, whose samples have been filled.

        Raises:
          FilterDiverged: an estimate that is no longer finite.
        """
        records, time = self._samples.of(self.estimator)[part], self._samples.time
        failed, status = go_on(self._arrays, records, self._history[part])
        if failed < len(records):
            at = part.start + failed
            reason = self.estimator.reason(status, self._history[max(at - 1, 0)])
            raise FilterDiverged(self.estimator.name, at, float(time[at]), reason)
        return self.so_far(part)

    def so_far(self, part: slice) -> Posterior:
        """What it said of a stretch."""
        columns = dict(zip(self.estimator.outputs, self._history[part].T.copy(), strict=True))
        return self.estimator.posterior(self._samples.time[part], columns)
