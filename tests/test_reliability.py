"""A part of `python -m benchmarks.reliability`: inputs made at random are used, or refused in one line."""

from __future__ import annotations

import secrets
from collections import Counter

import pytest

from benchmarks import fuzzing
from benchmarks.full_disk import full_disk


def test_inputs_made_at_random_are_used_or_refused_in_one_line():
    """Each is made of (seed, number): `fuzzing.one(seed, number)` makes it again."""
    seed = secrets.randbelow(2**31)
    print(f"seed {seed}")
    outcomes: Counter[str] = Counter()
    for number in range(60):
        _, became, failure = fuzzing.one(seed, number, ("joint", "scenario", "study", "layout", "mjcf"))
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


def test_a_full_disk_at_every_fifth_write_of_import_is_one_line_and_nothing_half_written():
    assert held_by(full_disk(["import"], 5))["import, refused"] > 4


@pytest.mark.slow
@pytest.mark.parametrize(("name", "step"), [("import", 1), ("estimate", 1), ("run", 2), ("sweep", 1), ("diagnose", 9)])
def test_a_full_disk_at_any_write_is_one_line_and_nothing_half_written(name, step):
    assert held_by(full_disk([name], step))[f"{name}, refused"] > 4
