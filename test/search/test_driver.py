# SPDX-License-Identifier: Apache-2.0
"""The loop around the search: budgets, slices, cancel, progress, threads."""


import numpy as np
import pytest

from ros2_ident.search import (
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


def test_an_error_in_a_thread_reaches_the_caller():
    def broken(theta):
        raise ValueError('broken')

    with ThreadedEvaluator(broken, 2) as evaluate, pytest.raises(ValueError, match='broken'):
        evaluate(np.zeros((40, 2)))
