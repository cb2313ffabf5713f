"""Return freed memory to the operating system (glibc)."""

from __future__ import annotations

import ctypes
import sys
from typing import Any

_TRIM_THRESHOLD, _MMAP_THRESHOLD = -1, -3  # of mallopt(3)
_LARGE = 4 << 20
_KEPT = 64 << 20


def give_back_large_arrays() -> None:
    """Let arrays of 4 MB and more return to the system as soon as they are freed.

    glibc keeps those of up to 32 MB, a hundred of them for an hour's recording, and gaps between them do not fit the
    next.
    """
    if (mallopt := _of_glibc("mallopt")) is not None:
        mallopt(_MMAP_THRESHOLD, _LARGE)
        mallopt(_TRIM_THRESHOLD, _KEPT)


def give_back_free_pages() -> None:
    """Return the heap's free pages, and Arrow's free memory, to the system."""
    if "pyarrow" in sys.modules:
        sys.modules["pyarrow"].default_memory_pool().release_unused()
    if (trim := _of_glibc("malloc_trim")) is not None:
        trim(0)


def _of_glibc(name: str) -> Any:
    """Return a function of the C library; None if that is another."""
    try:
        return getattr(ctypes.CDLL(None), name) if sys.platform.startswith("linux") else None
    except (OSError, AttributeError):
        return None
