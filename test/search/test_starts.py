# SPDX-License-Identifier: Apache-2.0
"""Where a refinement starts from, and who evaluates: held against plain loops."""

import threading

import numpy as np
import pytest

from ros2_ident.search.refine import APART, distinct_starts

WIDE = np.array([10.0, 2.0])
NEVER = threading.Event()


def plainly(best, candidates, costs, count):
    """Return the best and, by rising cost, what is apart from all taken before."""
    taken = [best]
    for row in np.argsort(costs, kind='stable'):
        far = [(np.abs(candidates[row] - one) / WIDE).max() > APART for one in taken]
        if len(taken) < count and np.isfinite(costs[row]) and all(far):
            taken.append(candidates[row])
    return np.array(taken)


def drawn(seed, size=60):
    rng = np.random.default_rng(seed)
    candidates = rng.random((size, 2)) * WIDE
    costs = rng.integers(0, 30, size).astype(float)  # some are equal
    costs[rng.random(size) < 0.1] = np.inf
    return candidates, costs, candidates[int(costs.argmin())]


@pytest.mark.parametrize('count', [1, 2, 4, 40])
def test_costs_that_are_bounds_are_found_out_as_far_as_they_matter(count):
    spared = 0
    for seed in range(20):
        candidates, costs, best = drawn(seed)
        rng = np.random.default_rng(100 + seed)
        exact = rng.random(60) < 0.5
        told = np.where(exact, costs, np.minimum(costs, 40.0) * rng.random(60))
        asked = []

        def evaluate(theta, limit, asked=asked, costs=costs, candidates=candidates):
            rows = [int(np.flatnonzero((candidates == one).all(axis=1))[0]) for one in theta]
            asked.extend(rows)
            # Above the limit any bound above it will do.
            return np.where(costs[rows] > limit, (limit + 0.5), costs[rows])

        bound, known = told.copy(), exact.copy()
        found = distinct_starts(best, candidates, bound, known, WIDE, count, evaluate, NEVER)
        np.testing.assert_array_equal(found, plainly(best, candidates, costs, count))
        assert not exact[asked].any(), 'what is known is not simulated again'
        spared += int((~known).sum())
        assert (known >= exact).all()
        np.testing.assert_array_equal(bound[known], costs[known])
        if count == 1:
            assert not asked
    assert spared > 0 or count == 40
