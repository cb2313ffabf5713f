"""Which causes are effects and which are imperfections: the sum over all combinations, one by one."""

from __future__ import annotations

from itertools import combinations, product

import numpy as np
import pytest

from flexspline.diagnosis.search.posterior import _combined


@pytest.mark.parametrize("draw", range(20))
def test_combinations_are_summed(draw, rng):
    n = int(rng.integers(1, 6))
    effect, imperfection = rng.normal(0.0, 5.0, (2, n))
    pairs = np.zeros((n, n))
    for i, j in combinations(range(n), 2):
        pairs[i, j] = -rng.exponential(5.0) * (rng.random() < 0.4)
    weights, shares = [], np.zeros(n)
    for small in product([False, True], repeat=n):
        both = sum(pairs[i, j] for i, j in combinations(range(n), 2) if small[i] and small[j])
        weights.append(np.exp(np.where(small, imperfection, effect).sum() + both))
        shares += weights[-1] * ~np.array(small)
    total, found = _combined(effect, imperfection, pairs)
    assert total == pytest.approx(np.log(sum(weights)))
    np.testing.assert_allclose(found, shares / sum(weights))
