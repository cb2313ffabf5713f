"""Sums, means and medians of what comes in pieces are to the bit those of the whole."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest

from flexspline.models import streams
from flexspline.scenarios.evaluation.metrics import moving_mean

LENGTHS = [3, 8, 127, 128, 129, 1000, 4096, 4097, 12_345, 100_003, (1 << 18) + 13]


@pytest.fixture
def rng():
    seed = int(np.random.SeedSequence().generate_state(1)[0])
    print(f"seed {seed}")
    return np.random.default_rng(seed)


def pieces(x: np.ndarray, rng: np.random.Generator) -> Iterator[np.ndarray]:
    at = 0
    while at < len(x):
        size = int(rng.integers(1, max(len(x) // 3, 2)))
        yield x[at : at + size]
        at += size


@pytest.mark.parametrize("n", LENGTHS)
def test_a_sum_of_pieces_is_numpys(n, rng):
    x = rng.standard_normal(n)
    for chosen in (np.ones(n, dtype=bool), rng.random(n) < 0.6):
        found = streams.PairwiseSum(int(np.count_nonzero(chosen)))
        for values, there in streams.aligned(pieces(x, rng), pieces(chosen, rng)):
            found.add(values[there])
        assert found.value == float(np.sum(x[chosen]))


@pytest.mark.parametrize("n", LENGTHS)
def test_means_gradients_and_medians_of_pieces_are_those_of_the_whole(n, rng):
    x = rng.standard_normal(n)
    for width in (1, 2, 200, 401):
        found = np.concatenate(list(streams.moving_means(pieces(x, rng), width, n)))
        assert np.array_equal(found, moving_mean(x, width))
    assert np.array_equal(np.concatenate(list(streams.gradients(pieces(x, rng), 0.001))), np.gradient(x, 0.001))
    for values in (x, np.round(x), np.diff(np.arange(n + 1) * 0.001), np.ones(n)):
        assert streams.median(lambda values=values: pieces(values, rng)) == np.median(values)


def test_parts_leave_no_rest_that_is_too_short():
    assert [(p.start, p.stop) for p in streams.parts(10, 4)] == [(0, 4), (4, 8), (8, 10)]
    assert [(p.start, p.stop) for p in streams.parts(9, 4)] == [(0, 4), (4, 9)]
    assert list(streams.parts(0, 4)) == []
