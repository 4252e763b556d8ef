# SPDX-License-Identifier: Apache-2.0
"""The genetic algorithm's core: its equations, repeatability, errors."""

from dataclasses import replace
import math

from hypothesis import given
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st
import numpy as np
import pytest
from scipy.special import ndtr

from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.search import (
    GeneticSearch,
    GeneticSettings,
    StopReason,
)
from ros2_ident.search.operators import (
    gaussian_root,
    laplace,
    normal,
    select,
)

SMALL = GeneticSettings(initial_population=64, survivors=4, children=4, generations=12)


def rough(points):
    """Return a cost with many local minima; the lowest one at 0.3."""
    return ((points - 0.3) ** 2 + 0.01 * np.sin(60.0 * (points - 0.3)) ** 2).sum(axis=1)


def run(search, generations=None, cost=rough):
    told = []
    while search.stop_reason is None and (generations is None or len(told) < generations):
        points = search.ask()
        told.append(points.copy())
        search.tell(cost(points))
    return told


# eqs. 5 and 6


@pytest.mark.parametrize(
    ('law', 'beyond', 'variance'),
    [
        (gaussian_root, lambda a: np.exp(-(a**2)), 1.0),
        (laplace, lambda a: np.exp(-a), 2.0),
        (normal, lambda a: 2.0 * ndtr(-a), 1.0),
    ],
)
def test_mutation_follows_its_analytic_law(law, beyond, variance):
    steps = law(np.random.default_rng(0).random(200_000))
    for a in (0.05, 0.3, 1.0, 1.7):
        # Five standard deviations of a binomial share.
        assert np.mean(np.abs(steps) > a) == pytest.approx(beyond(a), abs=5 * 0.5 / 447)
    assert np.mean(steps > 0) == pytest.approx(0.5, abs=0.006)
    assert steps.var() == pytest.approx(variance, rel=0.02)


@pytest.mark.parametrize('law', ['gaussian_root', 'laplace', 'normal'])
def test_mutation_scale_is_that_of_eq_6(law):
    settings = GeneticSettings(200, 1, 5000, 4, 0.5, mutation=law)
    search = GeneticSearch(2, settings, seed=3)
    # Only the first generation's most central one ever survives: every later one is worse.
    first = np.linalg.norm(search.ask() - 0.5, axis=1)
    costs = iter([first, *(np.full(5000, 1e3 + g) for g in range(3))])
    spreads = []
    while search.stop_reason is None:
        points = search.ask()
        if search.generation > 1:
            spreads.append(np.median(np.abs(points - search.survivors[0])[:, 0]))
        search.tell(next(costs))
    # Generations 3 and 4 have xi^1 and xi^2; their medians are not clipped.
    assert spreads[1] / spreads[2] == pytest.approx(2.0, rel=0.1)


# eqs. 7 to 9


@given(
    seed=st.integers(0, 10**6),
    count=st.integers(1, 60),
    survivors=st.integers(1, 12),
    distance=st.sampled_from([0.0, 0.05, 0.2, 0.5, 1.2]),
    dimension=st.integers(1, 3),
)
@hypothesis_settings(max_examples=150, deadline=None)
def test_selection_is_eq_7_by_brute_force(seed, count, survivors, distance, dimension):
    rng = np.random.default_rng(seed)
    points = np.round(rng.random((count, dimension)), 1)  # makes copies and equal costs
    costs = np.round(points.sum(axis=1), 1)
    costs[rng.random(count) < 0.2] = math.inf
    taken = []
    for i in sorted(range(count), key=lambda i: (costs[i], i)):
        far = all(np.sum((points[i] - points[j]) ** 2) > distance**2 for j in taken)
        if far and math.isfinite(costs[i]) and len(taken) < survivors:
            taken.append(i)
    assert select(points, costs, survivors, distance).tolist() == taken


# the run as a whole


def test_simulations_are_those_of_table_4():
    assert GeneticSettings().evaluations == 1024 + 11 * 8 * 8
    search = GeneticSearch(5, GeneticSettings(), seed=0)
    assert sum(len(points) for points in run(search)) == 1728
    assert search.evaluations == 1728
    assert search.stop_reason is StopReason.GENERATIONS


@pytest.mark.parametrize('first', ['uniform', 'kronecker'])
def test_same_seed_same_run(first):
    settings = replace(SMALL, first_generation=first)
    one, other = (np.concatenate(run(GeneticSearch(3, settings, seed=7))) for _ in range(2))
    np.testing.assert_array_equal(one, other)
    third = np.concatenate(run(GeneticSearch(3, settings, seed=8)))
    assert not np.array_equal(one[:64], third[:64])


def test_stagnation_stops():
    search = GeneticSearch(2, replace(SMALL, stagnation_generations=3), seed=0)
    told = run(search, cost=lambda p: np.ones(len(p)))
    assert search.stop_reason is StopReason.STAGNATION
    assert len(told) == 4
    assert 'stagnation_generations' in StopReason.STAGNATION.value


# infinities and refusals


def test_diverged_candidates_never_survive():
    search = GeneticSearch(2, SMALL, seed=0)
    points = search.ask()
    costs = np.full(len(points), math.inf)
    costs[5] = 1.0
    search.tell(costs)
    np.testing.assert_array_equal(search.survivors, points[5:6])
    assert len(search.ask()) == 4


@pytest.mark.parametrize(
    ('costs', 'text'),
    [
        (np.full(64, math.nan), 'candidate 0 is nan; give inf for a diverged candidate'),
        (np.full(64, -math.inf), 'candidate 0 is -inf; give inf for a diverged candidate'),
        (np.zeros(63), 'give one number for each of the 64 candidates'),
    ],
)
def test_unusable_costs_are_refused(costs, text):
    search = GeneticSearch(2, SMALL)
    search.ask()
    with pytest.raises(IdentError, match=text) as caught:
        search.tell(costs)
    assert caught.value.code == ErrorCode.BAD_VALUES
    assert search.evaluations == 0


@pytest.mark.parametrize(
    ('change', 'text'),
    [
        ({'survivors': 0}, 'survivors is 0; give a whole number of at least 1'),
        ({'children': 2.5}, 'children is 2.5; give a whole number'),
        ({'range_reduction': 1.1}, 'range_reduction is 1.1; give a number above 0 and at most 1'),
        ({'min_distance': -1.0}, 'min_distance is -1.0; give a number of at least 0'),
        ({'mutation': 'cauchy'}, "'cauchy'; give one of gaussian_root, laplace, normal"),
        ({'first_generation': 'grid'}, "first_generation is 'grid'; give one of kronecker"),
        ({'first_step': 1.1}, 'first_step is 1.1; give a number above 0 and at most 1'),
        ({'stagnation_generations': -1}, 'give a whole number, 0 for never'),
    ],
)
def test_unusable_settings_are_refused(change, text):
    with pytest.raises(IdentError, match=text):
        GeneticSettings(**change)


def test_eqs_8_and_9_bound_the_distance():
    GeneticSearch(2, replace(SMALL, min_distance=1.4))
    with pytest.raises(IdentError, match='below 1, the diagonal'):
        GeneticSearch(1, replace(SMALL, min_distance=1.0))
    with pytest.raises(IdentError, match='below 1.414, the diagonal'):
        GeneticSearch(2, replace(SMALL, min_distance=1.5))
    with pytest.raises(IdentError, match='at least one parameter'):
        GeneticSearch(0)
    with pytest.raises(IdentError, match='seed is -1'):
        GeneticSearch(1, seed=-1)
