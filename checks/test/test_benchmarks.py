# SPDX-License-Identifier: Apache-2.0
"""The comparisons' own arithmetic: what counts as found, what is timed, how ratios are made."""

from dataclasses import replace

import numpy as np
import pytest

from checks.benchmarks import economy, measure
from checks.benchmarks.kernel import Hooked, synthetic


def task(noise=0.0):
    """A bowl with its minimum at (2, 3), of which only the first coordinate is judged."""
    truth = np.array([2.0, 3.0])

    def residuals(theta):
        return theta - truth + noise

    def cost_of(row):
        return float(np.sqrt(np.mean(row**2)))

    return economy.Task(
        ('a', 'b'),
        np.array([0.0, 0.0]),
        np.array([5.0, 5.0]),
        truth,
        np.array([True, False]),
        lambda theta: np.sqrt(np.mean(residuals(theta) ** 2, axis=1)),
        residuals,
        cost_of,
        1e-6,
    )


def test_found_is_where_the_best_stays_within_one_percent():
    watched = economy.Watched(task(), 100)
    watched.costs(np.array([[1.0, 3.0], [2.01, 0.0], [2.001, 1.0]]))
    assert watched.reached == np.inf  # the best so far is the first
    watched.costs(np.array([[2.015, 2.5]]))
    assert watched.reached == 4
    watched.costs(np.array([[2.03, 2.9]]))  # better by cost, and out again
    assert watched.reached == np.inf
    watched.residuals(np.array([[0.0, 0.0], [2.0, 3.0]]))
    assert watched.reached == 7
    assert watched.count == 7


def test_a_method_ends_with_its_budget():
    trial = economy.attempt(economy.evolution, task(), 0, 500)
    assert 0 < trial.simulations <= 500


@pytest.mark.parametrize('seed', range(3))
def test_ours_counts_the_differences_of_its_refinement(seed):
    bowl = task()
    seen = 0

    def counted(function):
        def call(theta):
            nonlocal seen
            seen += len(theta)
            return function(theta)

        return call

    watched = replace(bowl, costs=counted(bowl.costs), residuals=counted(bowl.residuals))
    trial = economy.attempt(economy.ours(economy.FEW), watched, seed, 1000)
    assert trial.simulations == seen
    assert economy.FEW.evaluations < trial.simulations < 100
    assert trial.reached <= trial.simulations


def test_jobs_are_timed_in_turns_and_by_their_share():
    order, now = [], 0.0

    def job(name, seconds):
        def run():
            nonlocal now
            order.append(name)
            now += seconds

        return run

    times = measure.interleaved(
        {'slow': job('slow', 6.0), 'fast': job('fast', 1.0)}, 2, lambda: now, {'slow': 2}
    )
    assert order == ['slow', 'fast'] * 3  # the first of each is not timed
    assert times['slow'].seconds == (3.0, 3.0)
    assert measure.ratio(times['slow'], times['fast']) == '3 (3)'


def test_noise_is_how_far_the_median_lies_above_the_minimum():
    timing = measure.Timing((1.0, 1.5, 9.0))
    assert (timing.median, timing.least, timing.noise) == (1.5, 1.0, 0.5)


def test_the_kernel_that_is_timed_with_hooks_has_them():
    plain = synthetic(1.0)
    flags = [model._kernel[2][3] for model in (plain, Hooked(plain.machine, plain.data))]
    assert flags[0] is None and not flags[1].any()
