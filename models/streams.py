"""Series too long to be held, a part at a time: sums, means and medians that are to the bit what NumPy makes of the whole."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator

import numpy as np

BLOCK = 1 << 16
"""Samples of a long series that are in hand at a time: what is made of them fits a processor's cache, and a second of work is
many of them."""
_CHUNK = 1 << 12  # values that NumPy sums at once; a power of two above its own 128
_BINS = 1 << 12


def parts(count: int, block: int = BLOCK, least: int = 2) -> Iterator[slice]:
    """The parts of a series of so many samples, each of `block`; the last takes up a rest of fewer than `least`."""
    begin = 0
    while begin < count:
        end = count if count - begin - block < least else begin + block
        yield slice(begin, end)
        begin = end


class PairwiseSum:
    """The sum of float64 that come in pieces: `numpy.sum` of all, which adds the sums of halves, to the bit."""

    def __init__(self, count: int):
        """Begin; `count`: of all values that will come."""
        self._plan = _plan(count)
        self._next = next(self._plan, 0)
        self._rest = np.empty(0)
        self._sums: list[float] = []

    def add(self, values: np.ndarray) -> None:
        """Take up the next values, shape (n,)."""
        rest = np.concatenate([self._rest, values]) if len(self._rest) else np.ascontiguousarray(values)
        at = 0
        while 0 < self._next <= len(rest) - at:
            self._sums.append(float(np.sum(rest[at : at + self._next])))
            at += self._next
            for step in self._plan:
                if step:
                    self._next = step
                    break
                last = self._sums.pop()
                self._sums[-1] += last
            else:
                self._next = 0
        self._rest = rest[at:].copy()

    @property
    def value(self) -> float:
        """The sum, once all values have come."""
        return self._sums[0] if self._sums else 0.0


def _plan(count: int) -> Iterator[int]:
    """How NumPy adds up so many numbers: how many to sum next, and 0 where the last two sums are added."""
    if count <= _CHUNK:
        if count:
            yield count
        return
    half = count // 2
    half -= half % 8
    yield from _plan(half)
    yield from _plan(count - half)
    yield 0


def aligned(*streams: Iterable[np.ndarray]) -> Iterator[tuple[np.ndarray, ...]]:
    """Streams of the same values' count in pieces of the same length."""
    iterators = [iter(stream) for stream in streams]
    pieces: list[np.ndarray] = [np.empty(0)] * len(iterators)
    while True:
        for i, iterator in enumerate(iterators):
            while not len(pieces[i]):
                found = next(iterator, None)
                if found is None:
                    return
                pieces[i] = found
        n = min(len(piece) for piece in pieces)
        yield tuple(piece[:n] for piece in pieces)
        pieces = [piece[n:] for piece in pieces]


def moving_means(stream: Iterable[np.ndarray], width: int, count: int) -> Iterator[np.ndarray]:
    """Centred mean over `width` samples, shorter at the ends, of `count` samples that come in pieces; later than these."""
    half = width // 2
    total, first = np.zeros(1), 0  # sums up to a sample, from this one on
    come = gone = 0
    for values in stream:
        more = np.cumsum(values) if come == 0 else np.cumsum(np.concatenate([total[-1:], values]))[1:]
        total, come = np.concatenate([total, more]), come + len(values)
        end = count if come == count else come - half
        if end <= gone:
            continue
        at = np.arange(gone, end)
        low, high = np.clip(at - half, 0, count), np.clip(at + half + 1, 0, count)
        yield (total[high - first] - total[low - first]) / (high - low)
        gone = end
        kept = max(gone - half, 0)
        total, first = total[kept - first :], kept


def gradients(stream: Iterable[np.ndarray], dt: float) -> Iterator[np.ndarray]:
    """`numpy.gradient` of samples `dt` apart, three or more, that come in pieces; a sample later than these."""
    held, begun = np.empty(0), False
    for values in stream:
        held = np.concatenate([held, values])
        if len(held) < 3:
            continue
        inner = (held[2:] - held[:-2]) / (2.0 * dt)
        yield inner if begun else np.concatenate([[(held[1] - held[0]) / dt], inner])
        held, begun = held[-2:], True
    yield np.array([(held[-1] - held[-2]) / dt])


def median(stream: Callable[[], Iterable[np.ndarray]]) -> float:
    """`numpy.median` of finite values that come in pieces, as often as they are asked for (`stream`)."""
    low, high, count = np.inf, -np.inf, 0
    for values in stream():
        if len(values):
            low, high, count = min(low, values.min()), max(high, values.max()), count + len(values)
    wanted = [(count - 1) // 2, count // 2]
    if not low < high:
        return float(low)
    edges = np.linspace(low, high, _BINS + 1)[1:-1]
    filled = np.zeros(_BINS, dtype=np.int64)
    for values in stream():
        filled += np.bincount(np.searchsorted(edges, values, side="right"), minlength=_BINS)
    below = np.concatenate([[0], np.cumsum(filled)])
    inside = sorted({int(np.searchsorted(below, rank, side="right")) - 1 for rank in wanted})
    found: dict[float, int] = {}
    for values in stream():
        bins = np.searchsorted(edges, values, side="right")
        for value, times in zip(*np.unique(values[np.isin(bins, inside)], return_counts=True), strict=True):
            found[float(value)] = found.get(float(value), 0) + int(times)
    each = np.array(sorted(found))
    upto = below[inside[0]] + np.cumsum([found[value] for value in each.tolist()])
    # Between two bins that hold the middle there is none that holds any.
    middle = [each[np.searchsorted(upto, rank, side="right")] for rank in wanted]
    return float(np.mean(middle))
