"""Long series, a part at a time."""

from __future__ import annotations

from collections.abc import Iterator

BLOCK = 1 << 16
"""Samples of a long series that are in hand at a time: what is made of them fits a processor's cache, and a second of work is
many of them."""


def parts(count: int, block: int = BLOCK, least: int = 2) -> Iterator[slice]:
    """The parts of a series of so many samples, each of `block`; the last takes up a rest of fewer than `least`."""
    begin = 0
    while begin < count:
        end = count if count - begin - block < least else begin + block
        yield slice(begin, end)
        begin = end
