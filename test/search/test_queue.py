# SPDX-License-Identifier: Apache-2.0
"""The loop around the search where candidates are evaluated elsewhere, and how it cuts them."""

import math
import threading

import numpy as np
import pytest

from ros2_ident.search import Budget, GeneticSearch, GeneticSettings, minimise, StopReason
from ros2_ident.search.evaluators import Queue

LOW, HIGH = [10.0, -2.0], [20.0, 2.0]
SETTINGS = GeneticSettings(initial_population=100, survivors=5, children=4, generations=6)
PLANNED = 100 + 5 * 20


def cost(theta):
    return ((theta - [13.0, 0.5]) ** 2).sum(axis=1)


def search():
    return GeneticSearch(2, SETTINGS, 3)


class Clock:
    """Time that stands still until it is moved."""

    def __init__(self):
        self.now = 0.0

    def __call__(self):
        return self.now


class Elsewhere(Queue):
    """Evaluates while somebody waits: each batch is back after so many looks."""

    def __init__(self, ahead, looks=1, clock=None, each=0.0, on_look=None):
        self.ahead, self.looks = ahead, looks
        self.clock, self.each, self.on_look = clock, each, on_look
        self.out, self.most, self.sizes, self.dropped = 0, 0, [], 0

    def submit(self, theta, limit=math.inf, stop=None):
        self.out += 1
        self.most = max(self.most, self.out)
        self.sizes.append(len(theta))
        return Away(self, theta)


class Away:
    """A batch on its way."""

    def __init__(self, queue, theta):
        self.queue, self.theta, self.left = queue, theta, queue.looks

    def wait(self, seconds):
        assert 0.0 < seconds < 1.0
        self.left -= 1
        if self.queue.on_look is not None:
            self.queue.on_look()
        if self.left <= 0 and self.queue.clock is not None:
            self.queue.clock.now += self.queue.each * len(self.theta)
        return self.left <= 0

    def result(self):
        assert self.left <= 0, 'nobody waited for it'
        self.queue.out -= 1
        return cost(self.theta)

    def drop(self):
        self.queue.dropped += 1


@pytest.mark.parametrize('ahead', [0, 1, 3])
def test_so_many_batches_are_sent_ahead_and_the_result_is_the_same(ahead):
    queue = Elsewhere(ahead, looks=3)
    found = minimise(queue, search(), low=LOW, high=HIGH, clock=Clock(), lot=4)
    plain = minimise(cost, search(), low=LOW, high=HIGH)
    np.testing.assert_array_equal(found.theta, plain.theta)
    np.testing.assert_array_equal(found.survivors, plain.survivors)
    assert found.best_costs == plain.best_costs
    assert found.evaluations == sum(queue.sizes) == PLANNED
    assert queue.most == ahead + 1 and queue.out == 0


@pytest.mark.parametrize('count', [1, 40, 117, 199])
def test_a_budget_of_candidates_counts_those_on_their_way(count):
    queue = Elsewhere(3)
    budget = Budget(evaluations=count)
    found = minimise(queue, search(), low=LOW, high=HIGH, budget=budget, clock=Clock())
    assert sum(queue.sizes) == found.evaluations == count
    assert found.stop is StopReason.EVALUATIONS and queue.dropped == 0


def test_what_is_on_its_way_is_dropped_with_a_cancel_and_when_time_is_up():
    event = threading.Event()
    looks = []

    def cancels():
        looks.append(1)
        if len(looks) == 5:
            event.set()

    queue = Elsewhere(2, looks=4, on_look=cancels)
    found = minimise(queue, search(), low=LOW, high=HIGH, cancel=event, clock=Clock())
    assert found.stop is StopReason.CANCELLED and len(looks) == 5
    assert queue.dropped == queue.out == 3
    clock = Clock()
    queue = Elsewhere(2, clock=clock, each=0.1)
    budget = Budget(seconds=1.5)
    found = minimise(queue, search(), low=LOW, high=HIGH, budget=budget, clock=clock)
    assert found.stop is StopReason.SECONDS
    assert found.evaluations == 16 and found.seconds == pytest.approx(1.6)
    assert queue.dropped == queue.out > 0
