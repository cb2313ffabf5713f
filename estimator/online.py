"""Estimators beside signals that are still being made: a stretch at a time, to the bit what they say of the whole.

Those of the whole are kept (`OnlineEstimate`), or go with their stretch where they are too many (`PassingEstimate`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from ..models.errors import InputError
from ..models.signals import Signals
from .errors import FilterDiverged
from .estimator import (
    CausalEstimator,
    KnownJoint,
    Posterior,
    blank_samples,
    fill_samples,
    go_on,
    interval_of,
    part_samples,
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


class PassingSamples:
    """What estimators read of signals of which no more than a stretch is held: records of `models.step.SAMPLE`."""

    def __init__(self, joint: KnownJoint):
        """Before the first stretch; `joint`: what is known."""
        self._joint = joint
        self._last: _Sample | None = None
        self._records: dict[bool, np.ndarray] = {}
        self.time = np.empty(0)

    def take(self, signals: Signals) -> None:
        """Take up the signals of the next stretch."""
        self.time, before = signals.time, self._last
        if before is None:
            self._joint = (
                replace(self._joint, start=float(signals.time[0])) if self._joint.start is None else self._joint
            )
        else:
            columns = {name: np.concatenate([before[name], values]) for name, values in signals.columns.items()}
            signals = Signals(np.concatenate([before.time, signals.time]), columns)
        part = slice(len(signals.time) - len(self.time), len(signals.time))
        self._records = {told: part_samples(signals, self._joint, part, told) for told in (False, True)}
        end = len(signals.time)
        self._last = _Sample(signals.time[end - 1 :], {name: x[end - 1 :] for name, x in signals.columns.items()})

    def of(self, estimator: CausalEstimator) -> np.ndarray:
        """The records that an estimator reads of the stretch."""
        return self._records[estimator.reads_command]


@dataclass(frozen=True)
class _Sample:
    """The last sample of a stretch; shape (1,) each."""

    time: np.ndarray
    columns: Mapping[str, np.ndarray]

    def __getitem__(self, name: str) -> np.ndarray:
        return self.columns[name]


class PassingEstimate:
    """An estimator that goes along with signals and keeps nothing of what it said."""

    def __init__(self, estimator: CausalEstimator, joint: KnownJoint, interval: float):
        """Begin before the first sample; `interval`: median time between samples [s] (`estimator.sample_interval`)."""
        self.estimator = estimator
        self._arrays = estimator.step(joint, interval).arrays()
        self._outputs, self._done = len(estimator.outputs), 0
        self._last = np.zeros(self._outputs)

    def advance(self, samples: PassingSamples) -> Posterior:
        """What the estimator says of the stretch that was taken up last.

        Raises:
          FilterDiverged: an estimate that is no longer finite.
        """
        records = samples.of(self.estimator)
        history = np.zeros((len(records), self._outputs))
        failed, status = go_on(self._arrays, records, history)
        if failed < len(records):
            reason = self.estimator.reason(status, history[failed - 1] if failed else self._last)
            raise FilterDiverged(self.estimator.name, self._done + failed, float(samples.time[failed]), reason)
        self._done, self._last = self._done + len(records), history[-1]
        return self.estimator.posterior(samples.time, dict(zip(self.estimator.outputs, history.T.copy(), strict=True)))
