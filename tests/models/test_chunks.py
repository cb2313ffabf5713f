"""Large arrays: in files, out of memory when they are not used, with the same content."""

from __future__ import annotations

import re
import time
from pathlib import Path

import numpy as np
import pytest

from flexspline.models import chunks


def resident():
    """Memory of this process [MB]."""
    status = Path("/proc/self/status")
    if not status.is_file():
        pytest.skip("expected Linux")
    return int(re.search(r"VmRSS:\s+(\d+)", status.read_text())[1]) / 1000


def test_a_large_array_leaves_memory_and_keeps_its_content():
    before = resident()
    some = [chunks.large(5_000_000) for _ in range(4)]
    for i, values in enumerate(some):
        values[:] = i
        values[-1] = np.nan
    time.sleep(10 * chunks._EVERY)
    assert resident() < before + 80  # of 160 MB
    for i, values in enumerate(some):
        assert (values[:-1] == i).all() and np.isnan(values[-1])
    copied = chunks.kept(some[3].reshape(2, -1)[:, ::-1])
    assert copied.flags.c_contiguous and np.array_equal(copied, some[3].reshape(2, -1)[:, ::-1], equal_nan=True)


def test_without_room_for_files_it_stays_in_memory(monkeypatch):
    def full(*given):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(chunks.os, "posix_fallocate", full)
    values = chunks.large(1000, 1000)
    assert values.shape == (1000, 1000) and values.flags.owndata
