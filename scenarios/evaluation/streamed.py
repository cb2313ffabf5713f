"""The measures of `metrics` for a run that is too long to be held: from its tables, column by column, part after part.

What they give is to the bit what `metrics.Reference` gives of the whole. The tables are read twice for each estimate: a standard
deviation needs its mean first. Where the motion is steady, and where a delay is measured, is kept as bits.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ...models.streams import BLOCK, PairwiseSum, aligned, gradients, moving_means, parts
from . import metrics

Column = Callable[[], Iterator[np.ndarray]]
"""Reads a column from its start on: its parts in order."""


@dataclass(frozen=True)
class StreamedReference:
    """What estimates of one run are measured against (`metrics.Reference`).

    Attributes:
      truth, reading, raw, external_torque: of `metrics.Reference`, read anew each time they are called.
      count: samples of each.
      dt: sample period [s].
      transient: time at the start that is left out [s].
    """

    truth: Column
    reading: Column
    raw: Column
    external_torque: Column
    count: int
    dt: float
    transient: float

    @cached_property
    def first(self) -> int:
        """The first sample after the transient."""
        return first_after(self.transient, self.count, self.dt)

    @cached_property
    def events(self) -> list[tuple[int, int]]:
        """The pushes after the transient."""
        edges: list[int] = []
        before, at = False, 0
        for torque in self.external_torque():
            active = np.concatenate([[before], torque != 0])
            edges += (at + np.flatnonzero(active[1:] != active[:-1])).tolist()
            before, at = bool(active[-1]), at + len(torque)
        edges += [at] if before else []
        found = zip(edges[::2], edges[1::2], strict=True)
        return [(a, b) for a, b in found if metrics.is_push(a, b, self.dt) and a >= self.first]

    def during(self, begin: int, end: int) -> np.ndarray:
        """Where the delay is measured, from a sample to another, shape (end − begin,), bool."""
        if not self.events:
            return np.arange(begin, end) >= self.first
        found = np.zeros(end - begin, dtype=bool)
        for a, b in self.events:
            found[max(a - begin, 0) : max(metrics.end_of(b, self.dt) - begin, 0)] = True
        return found

    @cached_property
    def _calm(self) -> tuple[list[np.ndarray], int]:
        """Where the motion is steady: bits of parts of `BLOCK` samples; how many there are."""
        width = metrics.window(self.dt)
        rates = gradients(moving_means(self.truth(), width, self.count), self.dt)
        fast = ((np.abs(rate) > metrics.STEADY_RATE).astype(float) for rate in rates)
        bits, held, count, at = [], np.empty(0, dtype=bool), 0, 0
        for share in moving_means(fast, 2 * width, self.count):
            calm = (np.arange(at, at + len(share)) >= self.first) & (share < 0.5 / (2 * width))
            count, at = count + int(np.count_nonzero(calm)), at + len(share)
            held = np.concatenate([held, calm])
            while len(held) >= BLOCK:
                bits.append(np.packbits(held[:BLOCK]))
                held = held[BLOCK:]
        return [*bits, np.packbits(held)], count

    def calm(self) -> Iterator[np.ndarray]:
        """Where the motion is steady, bool."""
        bits, _ = self._calm
        left = self.count
        for packed in bits:
            yield np.unpackbits(packed, count=min(left, BLOCK)).astype(bool)
            left -= min(left, BLOCK)

    @cached_property
    def swing(self) -> float:
        """By how much the true torque changes where the delay is measured [N·m]; NaN where that is at less than two samples."""
        low, high, count, at = np.inf, -np.inf, 0, 0
        for truth in self.truth():
            there = truth[self.during(at, at + len(truth))]
            at, count = at + len(truth), count + len(there)
            if len(there):
                low, high = min(low, float(there.min())), max(high, float(there.max()))
        return high - low if count >= 2 else np.nan

    @cached_property
    def raw_noise(self) -> float:
        """Noise of the raw compliance model [N·m]."""
        return self._noise(self.raw)

    def _fast_errors(self, estimate: Column) -> Iterator[np.ndarray]:
        """The error's part that is faster than the window, in steady state."""

        def errors() -> Iterator[np.ndarray]:
            return (a - b for a, b in aligned(estimate(), self.truth()))

        means = moving_means(errors(), metrics.window(self.dt), self.count)
        return ((e - mean)[calm] for e, mean, calm in aligned(errors(), means, self.calm()))

    def _noise(self, estimate: Column) -> float:
        """`metrics.noise` of an estimate."""
        _, count = self._calm
        if count < 2:
            return float("nan")
        mean = _mean(self._fast_errors(estimate), count)
        return float(np.sqrt(_mean(((e - mean) ** 2 for e in self._fast_errors(estimate)), count)))

    def prepare(self) -> None:
        """Find once what the measures of every estimate need."""
        for name in ("first", "events", "_calm", "swing", "raw_noise"):
            getattr(self, name)

    def evaluate(self, estimate: Column) -> dict[str, float | None]:
        """All measures of one estimate [N·m], read anew each time it is called (`metrics.Reference.evaluate`)."""
        n, first, dt = self.count, self.first, self.dt
        square, to_sensor = PairwiseSum(n - first), PairwiseSum(n - first)
        largest, at = -np.inf, 0
        shifts = metrics.Shifts(dt, n) if self.swing >= metrics.LEAST_SWING else None
        responses: list[float] = []
        waiting = iter(self.events)
        event = next(waiting, None)
        reach = metrics.reach(dt)
        since, estimated, true = 0, np.empty(0), np.empty(0)  # what is held, from the sample `since` on
        for values, truth, reading in aligned(estimate(), self.truth(), self.reading()):
            kept = slice(max(first - at, 0), None)
            e = (values - truth)[kept]
            if len(e):
                square.add(e**2)
                to_sensor.add((values - reading)[kept] ** 2)
                largest = float(np.maximum(largest, np.max(np.abs(e))))
            at += len(truth)
            estimated, true = np.concatenate([estimated, values]), np.concatenate([true, truth])
            if shifts is not None:
                shifts.add(estimated, true, since, self.during)
            while event is not None and event[1] <= at:
                time = metrics.response(estimated, true, dt, event[0] - since, event[1] - since)
                responses += [] if time is None else [time]
                event = next(waiting, None)
            gone = max(len(true) - reach, 0)
            since, estimated, true = since + gone, estimated[gone:], true[gone:]
        own_noise = self._noise(estimate)
        lag = None if shifts is None else shifts.delay
        response = metrics.mean_response(np.array(responses))
        return {
            "rms": float(np.sqrt(square.value / (n - first))),
            "max": largest,
            "rms_to_sensor": float(np.sqrt(to_sensor.value / (n - first))),
            "noise": metrics.finite(own_noise),
            "noise_ratio": metrics.finite(own_noise / self.raw_noise) if self.raw_noise > 0 else None,
            "delay_ms": None if lag is None else 1e3 * lag,
            "response_ms": None if response is None else 1e3 * response,
            "missed": metrics.share_missed(np.array(responses)),
        }


def first_after(transient: float, count: int, dt: float) -> int:
    """The first sample after the transient [s], of `count` that are `dt` apart [s]."""
    for part in parts(count):
        kept = np.arange(part.start, part.stop) * dt >= transient
        if kept.any():
            return part.start + int(np.argmax(kept))
    return count


def _mean(stream: Iterator[np.ndarray], count: int) -> float:
    total = PairwiseSum(count)
    for values in stream:
        total.add(values)
    return total.value / count
