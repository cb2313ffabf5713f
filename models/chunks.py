"""Long series in parts, large arrays in files instead of memory, and freed memory returned to the operating system (glibc)."""

from __future__ import annotations

import ctypes
import math
import mmap
import os
import shutil
import sys
import tempfile
import threading
import time
import weakref
from collections.abc import Iterator
from contextlib import suppress
from typing import Any

import numpy as np

BLOCK = 1 << 16  # samples of a long series per part: they fit a processor's cache


def parts(count: int, block: int = BLOCK) -> Iterator[slice]:
    """Yield the parts of a series of `count` samples, each of `block`, the last of the rest."""
    return (slice(begin, min(begin + block, count)) for begin in range(0, count, block))


_LARGE = 1 << 22  # bytes from which an array of `large` is in a file: nine minutes at 1 kHz
_EVERY = 0.03  # s
_mapped: weakref.WeakSet[mmap.mmap] = weakref.WeakSet()
_lock = threading.Lock()


def large(*shape: int) -> np.ndarray:
    """Return a float64 array of undefined content.

    A large one is in an unnamed temporary file, if there is room, and in memory only where it was used in the last
    `_EVERY` seconds. A program that is killed leaves nothing.
    """
    size = 8 * math.prod(shape)
    if size >= _LARGE and size < shutil.disk_usage(tempfile.gettempdir()).free:
        with suppress(OSError, AttributeError), tempfile.TemporaryFile() as file:  # AttributeError: not on this system
            os.posix_fallocate(file.fileno(), 0, size)  # a full disk would end the program later
            pages = mmap.mmap(file.fileno(), size)
            with _lock:
                if not _mapped:
                    threading.Thread(target=_release, daemon=True).start()
                _mapped.add(pages)
            return np.frombuffer(pages).reshape(shape)
    return np.empty(shape)


def kept(values: np.ndarray) -> np.ndarray:
    """Return a copy as an array of `large`."""
    found = large(*values.shape)
    found[...] = values
    return found


def _release() -> None:
    """Take the arrays of `large` out of memory, again and again; they return from their files where they are used."""
    while True:
        with _lock:
            if not _mapped:
                return
            for pages in _mapped:
                pages.madvise(mmap.MADV_DONTNEED)
        time.sleep(_EVERY)


_TRIM_THRESHOLD, _MMAP_THRESHOLD = -1, -3  # of mallopt(3)
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
