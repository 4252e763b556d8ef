# SPDX-License-Identifier: Apache-2.0
"""The phases of a fit, on a problem of two numbers: what each may cost, what it leaves behind."""

from dataclasses import replace
import math

import numpy as np
import pytest

from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.search import fit as module
from ros2_ident.search import ThreadedEvaluator
from ros2_ident.search.evaluators import Threads
from ros2_ident.search.fit import fit, FitSettings
from ros2_ident.search.genetic import GeneticSettings

TIME = np.linspace(0.0, 1.0, 80)
TRUTH = np.array([3.0, 2000.0])
GENETIC = GeneticSettings(initial_population=60, survivors=4, children=4, generations=4)
PLANNED = 60 + 3 * 16


class Oscillation:
    """A decaying oscillation with a little noise; counts what is simulated."""

    low, high = np.array([0.0, 100.0]), np.array([10.0, 1e4])
    names = ('decay', 'stiffness')
    unit = 'N'
    noise = 0.0
    series = (50, 30)
    outputs = 1
    key = 'oscillation'

    def __init__(self):
        error = 1e-3 * np.random.default_rng(1).normal(size=TIME.size)
        self.measured = self.model(TRUTH[None])[0] + error
        self.simulated, self.asked = 0, []

    def model(self, theta):
        return np.exp(-theta[:, :1] * TIME) * np.cos(np.sqrt(theta[:, 1:]) * TIME)

    def prepare(self):
        pass

    def work(self, points):
        return np.zeros(len(points), dtype=np.int64)

    def costs(self, theta, limit=math.inf, stop=None):
        return np.sqrt(np.mean(self.residuals(theta) ** 2, axis=1))

    def residuals(self, theta):
        self.simulated += len(theta)
        self.asked.append(len(theta))
        return self.measured - self.model(theta)

    def cost_of(self, residual):
        return float(np.sqrt(np.mean(residual**2)))


def run(problem=None, *, seed=3, workers=None, **settings):
    """Fit in this thread, with settings and what `fit` takes besides."""
    known = {'cancel', 'on_progress', 'journal'}
    more = {k: settings.pop(k) for k in known & settings.keys()}
    chosen = FitSettings(**{'genetic': GENETIC, 'give_up': False, **settings})
    return fit(problem or Oscillation(), chosen, seed, workers=Threads(1), **more)


@pytest.fixture(scope='module')
def whole():
    problem = Oscillation()
    return problem, run(problem)


def test_every_candidate_is_counted_and_kept(whole):
    problem, found = whole
    assert found.evaluations == problem.simulated
    assert found.ga.evaluations == PLANNED == len(found.candidates) == len(found.costs)
    assert np.bincount(found.generations).tolist() == [0, 60, 16, 16, 16]
    kept = Oscillation().costs(found.candidates)
    np.testing.assert_array_equal(found.costs, kept)
    assert len(found.ga.best_costs) == 4
    assert (found.cancelled, found.left_out) == (False, False)
    assert 0.0 < found.seconds < 60.0


def test_an_error_in_a_thread_reaches_the_caller():
    def broken(theta):
        raise ValueError('broken')

    with ThreadedEvaluator(broken, 2) as evaluate, pytest.raises(ValueError, match='broken'):
        evaluate(np.zeros((40, 2)))


# ---------------------------------------------------------------------- limits


def test_a_large_search_says_what_it_would_take(monkeypatch):
    monkeypatch.setattr(module, 'free_memory', lambda: 2**30)
    huge = replace(GENETIC, initial_population=36_000_000, generations=1)
    with pytest.raises(IdentError, match='5.5 GiB of memory, and 1 GiB are free ') as caught:
        run(genetic=huge)
    assert 'take 10 h' in caught.value.message
    assert caught.value.code is ErrorCode.INVALID_GOAL
