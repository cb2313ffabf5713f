"""A part of `python -m benchmarks.reliability`: inputs made at random are used, or refused in one line."""

from __future__ import annotations

import secrets
from collections import Counter

import pytest

from benchmarks import fuzzing


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
