# SPDX-License-Identifier: Apache-2.0
"""Where a refinement starts from, and who evaluates: held against plain loops."""

import threading

import numpy as np
import pytest

from ros2_ident.errors import IdentError
from ros2_ident.lanes import WIDTH
from ros2_ident.search.evaluators import AtOnce, dealt, ThreadedEvaluator, Threads
from ros2_ident.search.operators import kronecker, latin_hypercube
from ros2_ident.search.packing import Packing
from ros2_ident.search.starts import APART, distinct_starts

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
def test_starts_are_the_best_ones_that_lie_apart(count):
    for seed in range(10):
        candidates, costs, best = drawn(seed)
        found = distinct_starts(
            best, candidates, costs.copy(), np.ones(60, bool), WIDE, count, None, NEVER
        )
        np.testing.assert_array_equal(found, plainly(best, candidates, costs, count))


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


def test_a_stop_takes_what_is_known():
    candidates, costs, best = drawn(1)
    exact = np.zeros(60, bool)
    exact[:30] = True
    stop = threading.Event()
    stop.set()
    found = distinct_starts(best, candidates, costs.copy(), exact, WIDE, 4, None, stop)
    assert len(found) == 4 and (found[0] == best).all()


# ---------------------------------------------------------------------- the first generation


@pytest.mark.parametrize('dimension', [1, 2, 5])
def test_a_lattice_is_a_shift_and_multiples_of_the_golden_ratios_kin(dimension):
    points = kronecker(50, dimension, np.random.default_rng(7))
    shift = np.random.default_rng(7).random(dimension)
    root = max(np.roots([1.0] + [0.0] * (dimension - 1) + [-1.0, -1.0]).real)
    steps = np.outer(np.arange(1, 51), root ** -np.arange(1.0, dimension + 1.0))
    np.testing.assert_allclose(points, (shift + steps) % 1.0, atol=1e-12)


def test_a_latin_hypercube_is_drawn_from_the_searchs_own_generator():
    one, same, other = (latin_hypercube(9, 3, np.random.default_rng(s)) for s in (1, 1, 2))
    np.testing.assert_array_equal(one, same)
    assert (one != other).any()


# ---------------------------------------------------------------------- who evaluates


@pytest.mark.parametrize('count', [1, 7, 8, 9, 16, 17, 40, 100])
@pytest.mark.parametrize('parts', [1, 2, 3, 8])
def test_whole_vectors_are_dealt_in_turn(count, parts):
    hands = dealt(count, parts)
    vectors = -(-count // WIDTH)
    assert len(hands) == min(parts, vectors)
    for hand, rows in enumerate(hands):
        expected = [i for i in range(count) if i // WIDTH % len(hands) == hand]
        assert rows.tolist() == expected


def test_nobody_is_left_without_a_hand():
    assert [rows.tolist() for rows in dealt(0, 3)] == [[]]


@pytest.mark.parametrize(
    ('threads', 'count', 'sizes'),
    [
        (1, 40, [40]),
        (3, 8, [8]),  # one vector is not worth another thread
        (3, 9, [1, 8]),
        (3, 40, [8, 16, 16]),
        (2, 40, [16, 24]),
    ],
)
def test_threads_share_the_candidates_and_put_them_back(threads, count, sizes):
    seen, told = [], []

    def evaluate(theta, limit, stop):
        seen.append(len(theta))
        told.append((limit, stop))
        return theta * 2.0

    theta = np.random.default_rng(0).random((count, 3))
    with ThreadedEvaluator(evaluate, threads, limited=True) as evaluator:
        np.testing.assert_array_equal(evaluator(theta, 5.0, bool), 2.0 * theta)
    assert sorted(seen) == sizes
    assert set(told) == {(5.0, bool)}
    with ThreadedEvaluator(lambda theta: theta[:, 0], threads) as plain:
        np.testing.assert_array_equal(plain(theta), theta[:, 0])
        assert not plain.limited


def test_threads_are_as_many_as_are_asked_for():
    with pytest.raises(IdentError, match='threads is 0; give at least 1'):
        ThreadedEvaluator(len, 0)
    names = set()

    def evaluate(theta):
        names.add(threading.current_thread().name)
        threads.wait(10.0)  # all of them are here at once
        return theta[:, 0]

    threads = threading.Barrier(3)
    with ThreadedEvaluator(evaluate, 3) as evaluator:
        evaluator(np.zeros((24, 1)))
    assert len(names) == 3
    # They end with the context.
    assert not names & {t.name for t in threading.enumerate()} - {'MainThread'}


def test_a_functions_result_is_there_at_once():
    plain = AtOnce(lambda theta: theta.sum(axis=1))
    assert (plain.ahead, plain.limited) == (0, False)
    batch = plain.submit(np.ones((2, 3)), 1.0, bool)
    assert batch.wait(0.0) is True and batch.result().tolist() == [3.0, 3.0]
    seen = []

    def heeds(*arguments):
        seen.append(arguments[1:])
        return arguments[0]

    heeds.limited = True
    AtOnce(heeds).submit(np.ones((1, 1)), 7.0, bool)
    assert AtOnce(heeds).limited and seen == [(7.0, bool)]


def test_tasks_are_methods_of_the_subject_in_their_order():
    class Subject:
        def power(self, base, exponent):
            return base**exponent

    with Threads(2).tasks(Subject()) as run:
        assert list(run('power', [(2, 3), (3, 2), (5, 1)])) == [8, 9, 5]
    with Threads(2).open(_Objective()) as evaluators:
        assert evaluators.lot == 2 * WIDTH
        assert evaluators.costs(np.ones((3, 2)), 1.5, bool).tolist() == [1.5] * 3
        assert evaluators.residuals(np.ones((3, 2))).shape == (3, 2)


class _Objective:
    def costs(self, theta, limit, stop):
        return np.full(len(theta), limit)

    def residuals(self, theta):
        return theta


# ---------------------------------------------------------------------- packing


@pytest.mark.parametrize('count', [1, 128, 129, 300])
def test_packed_values_find_their_places_again(count):
    points = np.random.default_rng(3).random((count, 2))
    packing = Packing(points, lambda part: np.round(9.0 * part[:, 0]))
    packed = packing.packed(points)
    np.testing.assert_array_equal(packing.drawn(packed), points)
    few = np.random.default_rng(4).permutation(count)[:20]
    np.testing.assert_array_equal(packed[packing.places(few)], points[few])
    # In parts, and of equal work the one that was drawn first.
    expected = [
        begin + np.argsort(np.round(9.0 * points[begin : begin + 128, 0]), kind='stable')
        for begin in range(0, count, 128)
    ]
    np.testing.assert_array_equal(packed, points[np.concatenate(expected)])
    plain = Packing(points, None)
    assert plain.packed(points) is plain.drawn(points) is plain.places(points) is points
