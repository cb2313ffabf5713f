"""Estimators on signals that are still being simulated: part by part, with the results of the whole to the bit."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ..models.errors import InputError
from .estimator import CausalEstimator, KnownJoint, Posterior, blank_samples, fill_samples, interval_of


class OnlineSamples:
    """The estimators' records of signals in progress, `models.step.SAMPLE`, shape (n,), with and without the command.
    The caller fills the channels `columns`, shape (n,) each, at all times [s]."""

    def __init__(self, time: np.ndarray, columns: Mapping[str, np.ndarray], joint: KnownJoint):
        self.time, self.columns, self.joint = time, columns, joint
        self._records = {reads_command: blank_samples(time, joint) for reads_command in (False, True)}

    def fill(self, part: slice) -> None:
        """Take the channels' samples of a part."""
        for reads_command, records in self._records.items():
            fill_samples(records, self.columns, part, reads_command)

    def of(self, estimator: CausalEstimator) -> np.ndarray:
        """Return the records that an estimator reads."""
        return self._records[estimator.reads_command]


class OnlineEstimate:
    """An estimator that follows signals in progress."""

    def __init__(self, estimator: CausalEstimator, samples: OnlineSamples):
        """Start before the first sample. Raises `InputError`: a missing channel."""
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
        """Return the posterior of the next part, whose samples have been filled. Raises `FilterDiverged`: an estimate
        that is not finite."""
        records, history = self._samples.of(self.estimator)[part], self._history
        before = history[max(part.start - 1, 0)]
        self.estimator.advance(self._arrays, records, history[part], part.start, self._samples.time[part], before)
        return self.so_far(part)

    def so_far(self, part: slice) -> Posterior:
        """Return the posterior of a part so far."""
        columns = dict(zip(self.estimator.outputs, self._history[part].T.copy(), strict=True))
        return self.estimator.posterior(self._samples.time[part], columns)
