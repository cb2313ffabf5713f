"""A part of `python -m benchmarks reliability`: inputs made at random are used, or refused in one line."""

from __future__ import annotations

import json
import os
import secrets
import subprocess
import sys
import time
from collections import Counter

import numpy as np
import pytest

from benchmarks import fuzzing
from benchmarks.full_disk import full_disk
from benchmarks.reliability import memory, peak


def test_inputs_made_at_random_are_used_or_refused_in_one_line():
    """Each is made of (seed, number): `fuzzing.one(seed, number)` makes it again."""
    seed = secrets.randbelow(2**31)
    print(f"seed {seed}")
    outcomes: Counter[str] = Counter()
    for number in range(80):
        _, became, failure = fuzzing.one(
            seed, number, ("joint", "scenario", "arm", "study", "layout", "mjcf", "messages")
        )
        outcomes[became] += 1
        assert failure is None, (seed, failure)
    assert outcomes["refused"] > 10


@pytest.mark.slow
def test_tables_made_at_random_are_used_or_refused_in_one_line():
    seed = secrets.randbelow(2**31)
    print(f"seed {seed}")
    for number in range(400):
        _, _, failure = fuzzing.one(seed, number)
        assert failure is None, (seed, failure)


def held_by(found):
    if found is None:
        pytest.skip("no C compiler, or not Linux")
    done, wrong = found
    assert wrong == []
    return done


def refused_until_there_is_room(name, step):
    """Every call but the last met the full disk. That all writes are counted is among what `full_disk` looks at."""
    done = held_by(full_disk([name], step))
    assert set(done) == {f"{name}, refused", f"{name}, done"} and done[f"{name}, done"] == 1
    assert done[f"{name}, refused"] > 4


def test_a_full_disk_at_every_fifth_write_of_import_is_one_line_and_nothing_half_written():
    refused_until_there_is_room("import", 5)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "step"),
    [
        ("import", 1), ("estimate", 1), *(pytest.param(*each, marks=pytest.mark.long) for each in
        (("run", 2), ("sweep", 1), ("diagnose", 3))),
    ],
)  # fmt: skip
def test_a_full_disk_at_any_write_is_one_line_and_nothing_half_written(name, step):
    refused_until_there_is_room(name, step)


def test_a_programs_memory_is_its_own():
    """Not that of the process which asks: 320 MB are held here, first beside a small program, then beside one of 300 MB."""
    ours = np.ones(40_000_000)
    size, _, error = peak([sys.executable, "-c", "x = bytearray(0)"])
    assert not error and size < 60
    size, _, error = peak([sys.executable, "-c", "x = b'1' * 300_000_000"])
    assert not error and 300 < size < 360
    assert peak([sys.executable, "-c", "raise SystemExit('no')"])[2] == "no"
    assert ours.nbytes == 320_000_000


@pytest.mark.slow
@pytest.mark.long
def test_an_hour_at_1_khz_fits_into_600_mb():
    """`check` and `estimate` with three filters (`python -m benchmarks reliability memory`)."""
    for name, megabytes, _ in memory(1.0, ("check", "estimate")):
        assert megabytes < 600, name


@pytest.mark.slow
@pytest.mark.long
@pytest.mark.parametrize("name", ["02/free.yaml", "02"])
def test_a_diagnosis_is_the_same_for_any_number_of_threads(shared, tmp_path, name):
    """To the byte, with one and two threads in every library: one recording, and three with their regions."""
    measurement = shared / "data" / "examples" / "toleranced" / name
    found = []
    for threads in ("1", "2"):
        names = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")
        words = ["diagnose", str(measurement), "--no-report", "--out", str(tmp_path / threads)]
        done = subprocess.run(
            [sys.executable, "-m", "flexspline", *words],
            env={**os.environ, **dict.fromkeys(names, threads)}, capture_output=True, text=True, timeout=900,
        )  # fmt: skip
        assert done.returncode == 0, done.stderr
        found.append([(tmp_path / threads / file).read_bytes() for file in ("diagnosis.json", "joint.yaml")])
    assert found[0] == found[1]
    told = json.loads(found[0][0])
    assert told["regions"] and told["estimation"]["regions"]


@pytest.mark.slow
def test_the_benchmark_ends_by_the_clock():
    """It counts what was answered until then. Starting two interpreters takes seconds by itself."""
    begin = time.monotonic()
    words = [sys.executable, "-m", "benchmarks", "reliability", "fuzz", "nonsense", "--minutes", "0.5"]
    done = subprocess.run(words, capture_output=True, text=True, timeout=300)
    assert time.monotonic() - begin < 45
    assert done.stdout.count("answered in time") == 2, done.stderr
