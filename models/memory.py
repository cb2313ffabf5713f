"""What the C library does with the memory of arrays that are no longer there."""

from __future__ import annotations

import ctypes
import sys

_TRIM_THRESHOLD, _MMAP_THRESHOLD = -1, -3  # of mallopt(3)
_LARGE = 4 << 20
_KEPT = 64 << 20


def give_back_large_arrays() -> None:
    """Let arrays of 4 MB and more go back to the system as soon as they are freed, where that can be asked for (glibc).

    By itself it comes to keep those of up to 32 MB, of which an hour's recording makes a hundred: they stay where they are needed
    no more, and what lies between them does not fit the next.
    """
    if not sys.platform.startswith("linux"):
        return
    try:
        mallopt = ctypes.CDLL(None).mallopt
    except (OSError, AttributeError):
        return
    mallopt(_MMAP_THRESHOLD, _LARGE)
    mallopt(_TRIM_THRESHOLD, _KEPT)


def give_back_free_pages() -> None:
    """Give back to the system the heap's pages that nothing lies on any more, where that can be asked for (glibc), and what Arrow
    keeps of the tables that it has read, which it would give back in time."""
    if "pyarrow" in sys.modules:
        sys.modules["pyarrow"].default_memory_pool().release_unused()
    if not sys.platform.startswith("linux"):
        return
    try:
        ctypes.CDLL(None).malloc_trim(0)
    except (OSError, AttributeError):
        return
