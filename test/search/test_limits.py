# SPDX-License-Identifier: Apache-2.0
"""Candidates that cannot survive are given up, and nothing else changes by that."""

from dataclasses import replace
from functools import cache

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
from ros2_ident.identify.problem import problem_of
from ros2_ident.identify.run import identify

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


@pytest.mark.parametrize('distance', [0.0, 0.05, 0.3])
def test_the_parameters_are_the_same_to_the_bit(distance):
    genetic = replace(QUICK.genetic, initial_population=256, min_distance=distance)
    settings = replace(QUICK, genetic=genetic)
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
