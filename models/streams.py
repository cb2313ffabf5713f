"""Long series in parts."""

from __future__ import annotations

from collections.abc import Iterator

BLOCK = 1 << 16
"""Samples of a long series per part: they fit a processor's cache."""


def parts(count: int, block: int = BLOCK, least: int = 2) -> Iterator[slice]:
    """Yield the parts of a series of `count` samples, each of `block`; the last includes a rest of fewer than
    `least`."""
    begin = 0
    while begin < count:
        end = count if count - begin - block < least else begin + block
        yield slice(begin, end)
        begin = end
