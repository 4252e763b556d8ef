# SPDX-License-Identifier: Apache-2.0
"""Candidates that cannot survive are given up, and nothing else changes by that."""

from dataclasses import replace
from functools import cache
import math

from identify_cases import (
    axis,
    axis_bag,
    axis_data,
    QUICK,
    recording_of,
    tripod,
    tripod_bag,
)
import numpy as np
import pytest

from ros2_ident.identify.data import gather
from ros2_ident.identify.run import identify
from ros2_ident.identify.setup import problem_of
from ros2_ident.search import (
    GeneticSearch,
    GeneticSettings,
    minimise,
)

LOW, HIGH = [0.0] * 3, [1.0] * 3
SETTINGS = GeneticSettings(initial_population=300, survivors=8, children=6, generations=8)


def cost(theta):
    """Return the cost of a curve with many valleys; a corner of the box diverges."""
    value = ((theta - 0.4) ** 2).sum(axis=1) + 0.05 * np.sin(40.0 * theta).sum(axis=1) + 0.2
    return np.where(theta[:, 0] > 0.9, np.inf, value)


class Bounded:
    """The cost; above the limit a lower bound of it, `share` of the way from there to the cost."""

    limited = True

    def __init__(self, share):
        self.share = share
        self.given_up = 0

    def __call__(self, theta, limit=math.inf, stop=None):
        whole = cost(theta)
        if limit == math.inf:
            return whole
        self.given_up += int((whole > limit).sum())
        least = np.nextafter(limit, np.inf)
        to = np.where(np.isfinite(whole), whole, limit + 1.0)
        bound = np.clip(limit + self.share * (to - limit), least, np.maximum(to, least))
        return np.where(whole > limit, bound, whole)


def five_kinds(points):
    """Return how much work candidates are, five different numbers."""
    return np.floor(5 * points[:, 1])


def searched(evaluate, settings, seed, **more):
    """Return the search at its end, and what it found."""
    search = GeneticSearch(3, settings, seed)
    found = minimise(evaluate, search, low=LOW, high=HIGH, **more)
    return search, found


def assert_same(one, other):
    """Assert that two searches went the same way to the bit."""
    (search, found), (search_2, found_2) = one, other
    for key in ('survivors', 'survivor_costs', 'best_point'):
        assert getattr(search, key).tobytes() == getattr(search_2, key).tobytes(), key
    assert found.best_costs == found_2.best_costs
    assert found.theta.tobytes() == found_2.theta.tobytes()
    assert found.evaluations == found_2.evaluations


@pytest.mark.parametrize('work', [None, five_kinds])
@pytest.mark.parametrize('share', [0.0, 0.5, 1.0])
@pytest.mark.parametrize('distance', [0.0, 0.3, 0.8])
def test_the_same_candidates_survive(work, share, distance):
    settings = replace(SETTINGS, min_distance=distance)
    for seed in range(10):
        evaluate = Bounded(share)
        assert_same(
            searched(evaluate, settings, seed, work=work),
            searched(cost, settings, seed),
        )
        assert evaluate.given_up or distance == 0.8


# ---------------------------------------------------------------- the simulations


@cache
def problems():
    """Return problems of every kernel, one of several segments among them."""
    whole = recording_of(axis_bag())
    half = whole.between(whole.begin, whole.begin + 2_000_000_000)
    return {
        'axis': problem_of(axis(), axis_data()),
        'axis, two segments': problem_of(axis(), gather([whole, half], axis())),
        'tripod': problem_of(tripod(), gather([recording_of(tripod_bag())], tripod())),
    }


@pytest.mark.parametrize('name', ['axis', 'axis, two segments', 'tripod'])
def test_above_the_limit_a_cost_is_a_lower_bound(name):
    problem = problems()[name]
    rng = np.random.default_rng(4)
    theta = problem.low + (problem.high - problem.low) * rng.random((75, len(problem.low)))
    theta[7] = np.nan  # diverges
    costs = problem.costs(theta)
    assert costs[7] == np.inf
    for share in (0.0, 0.1, 0.5, 0.98):
        for limit in (float(np.quantile(costs, share)), 0.999 * float(np.quantile(costs, share))):
            bounds = problem.costs(theta, limit)
            below = costs <= limit
            assert np.array_equal(bounds <= limit, below)
            assert np.array_equal(bounds[below], costs[below])
            assert (bounds <= costs).all()
            # What ends just above the limit may have come there with its last samples only.
            assert share > 0.5 or (bounds[costs < np.inf] < costs[costs < np.inf]).any()
            alone = np.concatenate([problem.costs(row[None], limit) for row in theta])
            assert np.array_equal(alone, bounds)


def test_the_parameters_are_the_same_to_the_bit():
    settings = replace(QUICK, genetic=replace(QUICK.genetic, initial_population=256))
    whole, given_up = (
        identify(axis(), axis_data(), settings=replace(settings, give_up=give_up), seed=1)
        for give_up in (False, True)
    )
    assert given_up.theta.tobytes() == whole.theta.tobytes()
    assert given_up.parameters == whole.parameters
    assert given_up.cost == whole.cost
    assert given_up.evaluations == whole.evaluations
    kept = np.isfinite(given_up.history.costs)
    assert np.array_equal(given_up.history.costs[kept], whole.history.costs[kept])
    assert kept.sum() < np.isfinite(whole.history.costs).sum()
