# SPDX-License-Identifier: Apache-2.0
"""The loop around the search where candidates are evaluated elsewhere, and how it cuts them."""

import math
import threading

import numpy as np
import pytest

from ros2_ident.errors import IdentError
from ros2_ident.search import Budget, GeneticSearch, GeneticSettings, minimise, StopReason
from ros2_ident.search.driver import _Run, _Stop, Slicer
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


def test_an_ended_search_is_left_as_it_is():
    ended = search()
    whole = minimise(cost, ended, low=LOW, high=HIGH)
    again = minimise(None, ended, low=LOW, high=HIGH)
    assert (again.stop, again.generations) == (StopReason.GENERATIONS, 6)
    assert again.best_costs == () and again.evaluations == PLANNED
    np.testing.assert_array_equal(again.theta, whole.theta)
    # One that had its budget of generations goes on where another allows more.
    part = search()
    assert minimise(cost, part, low=LOW, high=HIGH, budget=Budget(generations=2)).generations == 2
    still = minimise(None, part, low=LOW, high=HIGH, budget=Budget(generations=2))
    assert (still.stop, still.generations) == (StopReason.GENERATIONS, 2)
    rest = minimise(cost, part, low=LOW, high=HIGH)
    assert rest.generations == 6 and len(rest.best_costs) == 4
    np.testing.assert_array_equal(rest.theta, whole.theta)


def test_why_a_batch_is_left_off_is_what_came_first():
    event, clock = threading.Event(), Clock()
    bounds = np.array(LOW), np.array(HIGH)
    run = _Run(search(), *bounds, Budget(seconds=5.0), None, clock, 0.1)
    stop = _Stop(run, event)
    assert not stop() and stop.said is None
    event.set()
    assert stop() and stop.said is StopReason.CANCELLED
    clock.now = 9.0
    event.clear()
    assert stop() and stop.said is StopReason.CANCELLED
    late = _Stop(run, None)
    assert late() and late.said is StopReason.SECONDS


# ---------------------------------------------------------------------- slices


@pytest.mark.parametrize(
    ('lot', 'count', 'seconds', 'size'),
    [
        (1, 16, 0.1, 8),  # half as many in half the time
        (1, 16, 1e-12, 128),  # at most eightfold
        (3, 16, 1e-12, 126),
        (8, 16, 0.05, 16),
        (8, 16, 0.04, 16),  # twenty would fit, two lots are sixteen
        (8, 16, 1.0, 8),  # never less than a lot
        (1, 16, 10.0, 1),
        (1, 16, 0.0, 128),
    ],
)
def test_a_slice_takes_its_time(lot, count, seconds, size):
    slicer = Slicer(0.05, lot=lot)
    assert slicer.size == 16
    slicer.note(count, seconds)
    assert slicer.size == size
    assert Slicer(lot=40).size == 40


def test_slices_take_the_time_that_is_asked_for():
    clock, sizes = Clock(), []

    def steady(theta):
        sizes.append(len(theta))
        clock.now += 0.01 * len(theta)
        return cost(theta)

    minimise(steady, search(), low=LOW, high=HIGH, clock=clock, slice_seconds=0.4, lot=10)
    assert sizes == [16, 40, 40, 4] + [20] * 5


# ---------------------------------------------------------------------- progress


def test_the_time_to_go_forgets_what_is_long_past():
    clock, told = Clock(), []
    seconds = iter([9.0] + [0.1] * 3 + [0.02] * 1000)

    def speeds_up(theta):
        clock.now += next(seconds) * len(theta)
        return cost(theta)

    minimise(
        speeds_up,
        search(),
        low=LOW,
        high=HIGH,
        clock=clock,
        slice_seconds=0.2,
        interval=0.0,
        on_progress=told.append,
    )
    # After the first slice three slow ones; of eight slices none of them counts, of nine one.
    assert told[10].each > 0.02 * 1.01
    late = told[11]
    assert late.each == pytest.approx(0.02)
    assert late.eta == pytest.approx(0.02 * (PLANNED - late.evaluations))
    assert told[1].each == pytest.approx(0.1)
    assert [p.generation for p in told] == sorted(p.generation for p in told)
    assert told[-1].each == pytest.approx(0.02)


def test_a_report_tells_the_best_so_far_and_no_more_time_than_is_left():
    clock, told = Clock(), []
    seen = []

    def slow(theta):
        clock.now += 0.5 * len(theta)
        seen.append(theta)
        return cost(theta)

    budget = Budget(seconds=50.0)
    minimise(
        slow,
        search(),
        low=LOW,
        high=HIGH,
        budget=budget,
        clock=clock,
        interval=0.0,
        on_progress=told.append,
    )
    for count, progress in enumerate(told[:-1], 1):
        tried = np.concatenate(seen[:count])
        assert progress.evaluations == len(tried)
        assert progress.best_cost == cost(tried).min()
        np.testing.assert_allclose(progress.best_theta, tried[cost(tried).argmin()])
        assert progress.budget == PLANNED
        if count > 1:
            assert progress.eta == pytest.approx(50.0 - progress.elapsed)
    assert told[-1].eta == 0.0


def test_reports_keep_their_distance_but_the_last_one_comes():
    clock, told = Clock(), []

    def timed(theta):
        clock.now += 0.01 * len(theta)
        return cost(theta)

    more = {'low': LOW, 'high': HIGH, 'clock': clock, 'on_progress': told.append}
    minimise(timed, search(), interval=0.25, slice_seconds=0.01, **more)
    times = np.array([p.elapsed for p in told])
    assert times[0] == pytest.approx(0.16)  # the first comes at once
    np.testing.assert_allclose(np.diff(times[:-1]), 0.25)
    assert times[-1] == pytest.approx(2.0)
    told.clear()
    clock.now = 0.0
    minimise(timed, search(), slice_seconds=0.01, **more)  # a tenth of a second where not said
    np.testing.assert_allclose(np.diff([p.elapsed for p in told[:-1]]), 0.1, atol=0.011)


@pytest.mark.parametrize('value', [-1, 0])
def test_a_budget_of_nothing_is_refused(value):
    for name in ('evaluations', 'generations', 'seconds'):
        with pytest.raises(IdentError, match=f'the budget of {name} is {value}'):
            Budget(**{name: value})
