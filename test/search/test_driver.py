# SPDX-License-Identifier: Apache-2.0
"""The loop around the search: budgets, slices, cancel, progress, threads."""

from dataclasses import FrozenInstanceError
import math
import threading

import numpy as np
import pytest

from ros2_ident.errors import IdentError
from ros2_ident.search import (
    Budget,
    GeneticSearch,
    GeneticSettings,
    minimise,
    StopReason,
    ThreadedEvaluator,
)

LOW, HIGH = [10.0, -2.0], [20.0, 2.0]
SETTINGS = GeneticSettings(initial_population=100, survivors=5, children=4, generations=10)


def cost(theta):
    return ((theta - [13.0, 0.5]) ** 2).sum(axis=1)


class Clock:
    """Time that passes by `step` with every look."""

    def __init__(self, step):
        self.now, self.step = 0.0, step

    def __call__(self):
        self.now += self.step
        return self.now


def search(seed=0):
    return GeneticSearch(2, SETTINGS, seed)


def test_finds_the_minimum_in_physical_units():
    result = minimise(cost, search(), low=LOW, high=HIGH)
    np.testing.assert_allclose(result.theta, [13.0, 0.5], atol=0.05)
    assert result.cost == cost(result.theta[None, :])[0]
    assert result.stop is StopReason.GENERATIONS
    assert result.evaluations == 100 + 9 * 20
    assert result.generations == 10
    assert len(result.best_costs) == 10
    assert list(result.best_costs) == sorted(result.best_costs, reverse=True)
    np.testing.assert_allclose(cost(result.survivors), result.survivor_costs)


@pytest.mark.parametrize('count', [1, 17, 100, 101, 150])
def test_budget_of_evaluations_is_kept_to_the_candidate(count):
    seen = []

    def counted(theta):
        seen.append(theta)
        return cost(theta)

    result = minimise(counted, search(), low=LOW, high=HIGH, budget=Budget(evaluations=count))
    tried = np.concatenate(seen)
    assert len(tried) == result.evaluations == count
    assert result.stop is StopReason.EVALUATIONS
    assert result.cost == cost(tried).min()


def test_budget_of_seconds():
    clock = Clock(0.0)

    def slow(theta):
        clock.now += 0.005 * len(theta)
        return cost(theta)

    result = minimise(slow, search(), low=LOW, high=HIGH, budget=Budget(seconds=0.5), clock=clock)
    assert result.stop is StopReason.SECONDS
    assert 0.5 <= result.seconds < 0.6
    assert math.isfinite(result.cost)


def test_cancel_keeps_the_best_so_far():
    event = threading.Event()
    seen = []

    def counted(theta):
        seen.append(theta)
        if len(seen) == 3:
            event.set()
        return cost(theta)

    result = minimise(counted, search(), low=LOW, high=HIGH, cancel=event)
    assert result.stop is StopReason.CANCELLED
    assert len(seen) == 3
    assert result.cost == cost(np.concatenate(seen)).min()


def test_progress_is_throttled_frozen_and_ends_complete():
    seen = []
    clock = Clock(0.01)
    result = minimise(
        cost, search(), low=LOW, high=HIGH, on_progress=seen.append, interval=0.2, clock=clock
    )
    times = np.diff([p.elapsed for p in seen[:-1]])
    assert (times >= 0.2).all()
    last = seen[-1]
    assert last.evaluations == last.budget == result.evaluations
    assert last.generation == last.generations == 10
    assert last.eta == 0.0
    assert last.best_cost == result.cost
    np.testing.assert_array_equal(last.best_theta, result.theta)
    with pytest.raises(FrozenInstanceError):
        last.eta = 1.0


@pytest.mark.parametrize(
    ('arguments', 'text'),
    [
        ({'low': [0.0], 'high': [1.0]}, r'the search has 2 parameter\(s\)'),
        ({'low': [0.0, 1.0], 'high': [1.0, 1.0]}, 'below its finite upper bound'),
        ({'low': [0.0, -math.inf], 'high': [1.0, 1.0]}, 'below its finite upper bound'),
    ],
)
def test_unusable_bounds_are_refused(arguments, text):
    with pytest.raises(IdentError, match=text):
        minimise(cost, search(), **arguments)


def test_an_error_in_a_thread_reaches_the_caller():
    def broken(theta):
        raise ValueError('broken')

    with ThreadedEvaluator(broken, 2) as evaluate, pytest.raises(ValueError, match='broken'):
        evaluate(np.zeros((40, 2)))
