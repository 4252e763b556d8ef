# SPDX-License-Identifier: Apache-2.0
"""The loop around a search: slices, budgets, progress, cancel."""

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
import math
import time
from typing import Any

import numpy as np

from ros2_ident.arrays import Array
from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.search.evaluators import AtOnce, Batch, Cancel, Evaluate, Queue
from ros2_ident.search.genetic import GeneticSearch, StopReason
from ros2_ident.search.operators import Flags
from ros2_ident.search.packing import Packing, Work

# How long to wait for a slice before looking at cancel event and budget again, s.
_LOOK = 0.05
# Candidates of a first generation before some are given up. The limit is taken anew after twice as
# many, and so on, and after so many at the latest: the more are on their way together, the fewer
# vectors hold those that are left.
_FIRST_LIMIT, _NEXT_LIMIT = 32, 256
# Slices by which the time to go is estimated. The first of a run is none of them: it may compile.
_RECENT = 8


@dataclass(frozen=True)
class Budget:
    """What a search may cost; None is without limit.

    Attributes:
        evaluations: Candidates.
        generations: Generations, counted from the search's first.
        seconds: Wall time of this call, s.
    """

    evaluations: int | None = None
    generations: int | None = None
    seconds: float | None = None

    def __post_init__(self) -> None:
        for name in ('evaluations', 'generations', 'seconds'):
            value = getattr(self, name)
            if value is not None and not value > 0:
                raise IdentError(
                    ErrorCode.BAD_VALUES,
                    f'the budget of {name} is {value}; give a number above 0 or none',
                )


@dataclass(frozen=True)
class Progress:
    """A search seen from outside at one instant.

    Attributes:
        generation: Generation being evaluated, from 1.
        generations: The last one by settings and budget.
        evaluations: Candidates evaluated so far.
        budget: Candidates the search will evaluate at most.
        best_cost: Lowest cost so far, inf before a candidate converged.
        best_theta: (N,) its parameters, physical units; NaN before a candidate converged.
        spread: Largest standard deviation of the survivors over the parameters, in box widths.
        elapsed: Wall time of this call so far, s.
        each: Wall time a candidate takes at present, s; NaN before the second slice.
        eta: Wall time still to go, s; NaN before the second slice.
    """

    generation: int
    generations: int
    evaluations: int
    budget: int
    best_cost: float
    best_theta: Array
    spread: float
    elapsed: float
    each: float
    eta: float


@dataclass(frozen=True)
class SearchResult:
    """What a search found.

    Attributes:
        theta: (N,) best parameters, physical units; NaN where every candidate diverged.
        cost: Their cost, inf where every candidate diverged.
        survivors: (P, N) last survivors by rising cost, physical units.
        survivor_costs: (P,) their costs.
        evaluations: Candidates evaluated, over all calls on this search.
        generations: Generations completed.
        best_costs: Best cost after each generation completed in this call.
        stop: Why the search ended; `stop.value` is a sentence.
        seconds: Wall time of this call, s.
    """

    theta: Array
    cost: float
    survivors: Array
    survivor_costs: Array
    evaluations: int
    generations: int
    best_costs: tuple[float, ...]
    stop: StopReason
    seconds: float


class Slicer:
    """Chooses how many candidates to evaluate between two looks at the cancel event.

    Args:
        target: Wall time a slice shall take, s.
        first: Candidates of the first slice.
        lot: Candidates that are evaluated in the time of one; slices are multiples of it.
    """

    def __init__(self, target: float = 0.05, first: int = 16, lot: int = 1) -> None:
        self._target = target
        self._lot = lot
        self.size = max(lot, first)

    def note(self, count: int, seconds: float) -> None:
        """Learn from `count` candidates that took `seconds`; grows at most eightfold."""
        fitting = self._target / max(seconds / count, 1e-9)
        lots = int(min(fitting, 8.0 * self.size)) // self._lot
        self.size = self._lot * max(1, lots)


class _Run:
    """One call of `minimise`: the clock, the counts and the best so far."""

    def __init__(
        self,
        search: GeneticSearch,
        low: Array,
        high: Array,
        budget: Budget,
        on_progress: Callable[[Progress], None] | None,
        clock: Callable[[], float],
        interval: float,
    ) -> None:
        self.search = search
        self.low = low[None]
        self.width = (high - low)[None]
        self.budget = budget
        self.on_progress = on_progress
        self.clock = clock
        self.interval = interval
        self.start = clock()
        self.reported = -math.inf
        self.told = -math.inf  # when the last slice came back
        self.recent: deque[tuple[int, float]] = deque(maxlen=_RECENT)  # candidates, s
        self.first = True
        self.done = search.evaluations  # told, plus those of the running generation
        self.best_cost = search.best_cost
        self.best_point = search.best_point
        s = search.settings
        self.generations = min(s.generations, budget.generations or s.generations)
        planned = s.initial_population + (self.generations - 1) * s.survivors * s.children
        self.limit = min(planned, budget.evaluations or planned)

    def physical(self, points: Array) -> Array:
        """Return points of the cube, (S, N), in physical units, eq. 4."""
        count = len(points)
        if count > len(self.low):
            # Laid out in full: where numpy has to repeat a short row, it takes rows one by one.
            self.low = np.repeat(self.low[:1], count, axis=0)
            self.width = np.repeat(self.width[:1], count, axis=0)
        return self.low[:count] + points * self.width[:count]

    @property
    def elapsed(self) -> float:
        return self.clock() - self.start

    def spent(self) -> StopReason | None:
        """Return which budget allows no further candidate."""
        b = self.budget
        if b.evaluations is not None and self.done >= b.evaluations:
            return StopReason.EVALUATIONS
        return StopReason.SECONDS if self.late else None

    def allows(self, count: int) -> bool:
        """Return whether the budget of evaluations has room for so many candidates."""
        return self.budget.evaluations is None or self.done + count <= self.budget.evaluations

    @property
    def late(self) -> bool:
        """Whether the budget of seconds is spent."""
        return self.budget.seconds is not None and self.elapsed >= self.budget.seconds

    @property
    def each(self) -> float:
        """Wall time a candidate takes at present, s."""
        count = sum(n for n, _ in self.recent)
        return sum(seconds for _, seconds in self.recent) / count if count else math.nan

    def note(self, points: Array, costs: Array, seconds: float) -> None:
        self.done += len(points)
        if not self.first:
            self.recent.append((len(points), seconds))
        self.first = False
        best = int(costs.argmin())
        lowest = float(costs[best])
        if math.isnan(lowest):  # the least of an array with NaN in it
            raise IdentError(
                ErrorCode.BAD_VALUES,
                'evaluate returned NaN; a diverged candidate has to cost inf, '
                'and a NaN in the data has to be left out of the cost',
            )
        if lowest < self.best_cost:
            self.best_cost = lowest
            self.best_point = points[best].copy()

    def report(self, *, last: bool = False) -> None:
        if self.on_progress is None:
            return
        elapsed = self.elapsed
        if not last and elapsed - self.reported < self.interval:
            return
        self.reported = elapsed
        eta = self.each * max(self.limit - self.done, 0)
        if self.budget.seconds is not None:
            eta = min(eta, max(self.budget.seconds - elapsed, 0.0))
        self.on_progress(
            Progress(
                generation=self.search.generation,
                generations=self.generations,
                evaluations=self.done,
                budget=self.limit,
                best_cost=self.best_cost,
                best_theta=self.physical(self.best_point[None])[0],
                spread=self.search.spread,
                elapsed=elapsed,
                each=self.each,
                eta=0.0 if last else eta,
            )
        )


def _checked(costs: Any, count: int) -> Array:
    told = np.asarray(costs, dtype=np.float64)
    if told.shape != (count,):
        raise IdentError(
            ErrorCode.BAD_VALUES,
            f'evaluate returned the shape {told.shape} for {count} candidates; '
            'it has to return one cost for each',
        )
    return told


def _bounds(low: Any, high: Any, dimension: int) -> tuple[Array, Array]:
    """Return the box as arrays (N,), or refuse it."""
    bottom = np.array(low, dtype=np.float64)
    top = np.array(high, dtype=np.float64)
    if bottom.shape != (dimension,) or top.shape != (dimension,):
        raise IdentError(
            ErrorCode.BAD_VALUES,
            f'the bounds have the shapes {bottom.shape} and {top.shape}; '
            f'the search has {dimension} parameter(s)',
        )
    if not (np.isfinite(bottom).all() and np.isfinite(top).all() and (bottom < top).all()):
        raise IdentError(
            ErrorCode.BAD_VALUES,
            'every lower bound has to be finite and below its finite upper bound; correct the box',
        )
    return bottom, top


def minimise(
    evaluate: Evaluate | Queue,
    search: GeneticSearch,
    *,
    low: Any,
    high: Any,
    budget: Budget | None = None,
    on_progress: Callable[[Progress], None] | None = None,
    on_generation: Callable[[Array, Array, Flags], None] | None = None,
    cancel: Cancel | None = None,
    known: Callable[[Array], tuple[Array, Flags] | None] | None = None,
    slice_seconds: float = 0.05,
    lot: int = 1,
    interval: float = 0.1,
    give_up: bool = True,
    work: Work | None = None,
    clock: Callable[[], float] = time.monotonic,
) -> SearchResult:
    """Run a search to its end, its budget's end, or until it is cancelled.

    A generation that was cut off by a budget or the cancel event is not told to the search: its
    candidates count for the best so far, and a later call on the same search repeats them.

    Args:
        evaluate: (S, N) in physical units -> (S,) costs, inf for a diverged candidate; or a queue
            to elsewhere that does the same. The costs must not depend on how the candidates are
            cut into slices. Where it is `limited`, candidates that cannot survive are not
            evaluated to the end: see `evaluators.Objective.costs`. The survivors are the same.
        search: What proposes candidates; is advanced.
        low: (N,) lower bounds, physical units.
        high: (N,) upper bounds, physical units.
        budget: What the search may cost.
        on_progress: Called at most every `interval`, and once at the end, from this thread.
        on_generation: Called after each generation, and after one that was cut off, with its
            candidates (S, N), physical units, their costs (S,) as far as they were evaluated, and
            where (S,) that is the cost and not a lower bound of it.
        cancel: Looked at between slices, and while a queue is waited for.
        known: Gets the candidates of a generation (S, N), physical units, and returns costs (S,)
            of an earlier run, and where (S,) that is the cost; None where there are none. Those
            of survivors are computed again.
        slice_seconds: Wall time a slice shall take, s; the sizes adapt to it.
        lot: Candidates that are evaluated in the time of one (vector lanes times threads); slices
            are multiples of it.
        interval: Least time between two reports, s.
        give_up: Whether a `limited` evaluate gets limits.
        work: (S, N) in the unit cube -> (S,) how much work each candidate is; those that are alike
            are then evaluated side by side. The result is the same.
        clock: Seconds that never step back.

    Returns:
        The best so far and why the search ended.

    Raises:
        IdentError: BAD_VALUES where the bounds or costs are unusable.
    """
    bottom, top = _bounds(low, high, search.dimension)
    run = _Run(search, bottom, top, budget or Budget(), on_progress, clock, interval)
    slicer = Slicer(slice_seconds, lot=lot)
    queue = evaluate if isinstance(evaluate, Queue) else AtOnce(evaluate)
    limited = give_up and queue.limited
    best_costs: list[float] = []
    completed = search.generation - (0 if search.stop_reason else 1)
    stop = search.stop_reason
    while stop is None:
        if completed >= run.generations:
            stop = StopReason.GENERATIONS
            break
        points = search.ask()
        packing = Packing(points, work, _Stop(run, cancel))
        points = packing.packed(points)
        found = _Generation(points, run.physical(points), limited, packing)
        before = known(found.theta) if known and run.allows(len(points)) else None
        if before is not None and not _Stop(run, cancel)():
            stop = _take_up(queue, found, run, cancel, *before)
        else:
            stop = _evaluate_generation(queue, found, run, slicer, cancel)
            if stop is None and limited:
                stop = _settle_doubts(queue, found, run, cancel)
        if on_generation is not None and found.done:
            here = slice(found.done)
            on_generation(found.theta[here], found.costs[here], found.exact[here])
        if stop is not None:
            break
        search.tell(packing.drawn(found.costs))
        if search.best_cost < run.best_cost:
            run.best_cost, run.best_point = search.best_cost, search.best_point
        completed += 1
        best_costs.append(search.best_cost)
        stop = search.stop_reason
    run.report(last=True)
    return SearchResult(
        theta=run.physical(run.best_point[None])[0],
        cost=run.best_cost,
        survivors=run.physical(search.survivors),
        survivor_costs=search.survivor_costs.copy(),
        evaluations=run.done,
        generations=completed,
        best_costs=tuple(best_costs),
        stop=stop,
        seconds=run.elapsed,
    )


class _Stop:
    """Whether to leave off a batch that is being evaluated; may be asked by several threads.

    Attributes:
        said: Why, from the first time on that it was.
    """

    def __init__(self, run: _Run, cancel: Cancel | None) -> None:
        self._run = run
        self._cancel = cancel
        self.said: StopReason | None = None

    def __call__(self) -> bool:
        if self._cancel is not None and self._cancel.is_set():
            self.said = self.said or StopReason.CANCELLED
        elif self._run.late:
            self.said = self.said or StopReason.SECONDS
        return self.said is not None


class _Generation:
    """A generation while it is evaluated.

    Attributes:
        points: (S, N) in the unit cube.
        theta: (S, N) in physical units.
        costs: (S,) of the first `done` of them, or lower bounds.
        exact: (S,) where it is the cost.
        done: How many are evaluated.
        limited: Whether candidates above a limit are given up.
        packing: The order they stand in.
    """

    def __init__(self, points: Array, theta: Array, limited: bool, packing: Packing) -> None:
        self.packing = packing
        self.points = points
        self.theta = theta
        self.costs: Array = np.empty(len(points))
        self.exact: Flags = np.ones(len(points), dtype=bool)
        self.done = 0
        self.limited = limited


def _evaluate_generation(
    queue: Queue, found: _Generation, run: _Run, slicer: Slicer, cancel: Cancel | None
) -> StopReason | None:
    """Evaluate a generation; return why it was cut off, None where it was not."""
    points = found.points
    waiting: deque[tuple[Array, float, Batch]] = deque()
    sent = 0
    limit, until = math.inf, len(points)
    stop = _Stop(run, cancel)
    while found.done < len(points):
        if found.limited and found.done in (0, until):
            # At numbers that do not depend on the slices, nor does then what is given up.
            here = slice(found.done)
            limit = run.search.limit(points[here], found.costs[here])
            few = max(found.done, _FIRST_LIMIT) if found.done or limit == math.inf else len(points)
            until = min(len(points), found.done + min(few, _NEXT_LIMIT))
        ended = StopReason.CANCELLED if cancel is not None and cancel.is_set() else run.spent()
        if ended is not None:
            for *_, batch in waiting:
                batch.drop()
            return ended
        while sent < until and len(waiting) <= queue.ahead:
            size = until - sent if found.limited else min(slicer.size, until - sent)
            if run.budget.evaluations is not None:
                size = min(size, run.budget.evaluations - run.done - (sent - found.done))
            if size < 1:
                break
            part = found.theta[sent : sent + size]
            before = run.clock()
            waiting.append((part, before, queue.submit(part, limit, stop)))
            sent += len(part)
        part, before, batch = waiting[0]
        if not batch.wait(_LOOK):
            continue
        waiting.popleft()
        told = _checked(batch.result(), len(part))
        if stop.said:
            return stop.said
        now = run.clock()
        took = now - max(before, run.told)
        slicer.note(len(part), took)
        run.told = now
        here = slice(found.done, found.done + len(part))
        found.costs[here] = told
        if found.limited:
            found.exact[here] = (told <= limit) | (told == math.inf)
        found.done += len(part)
        run.note(points[here], told, took)
        run.report()
    return None


def _take_up(
    queue: Queue, found: _Generation, run: _Run, cancel: Cancel | None, costs: Array, exact: Flags
) -> StopReason | None:
    """Take up what an earlier run found of a generation; return as `_evaluate_generation`."""
    found.costs[:], found.exact[:] = costs, False  # believed of those only that do not survive
    stop = _settle_doubts(queue, found, run, cancel)
    if stop is None:
        found.exact |= exact
        found.done = len(found.costs)
        run.done += found.done
    return stop


def _settle_doubts(
    queue: Queue, found: _Generation, run: _Run, cancel: Cancel | None
) -> StopReason | None:
    """Evaluate to the end who would survive by a lower bound of its cost; return as above."""
    stop = _Stop(run, cancel)
    while True:
        drawn = found.packing.drawn
        doubtful = found.packing.places(
            run.search.in_doubt(drawn(found.costs), drawn(found.exact))
        )
        if not doubtful.size:
            return None
        batch = queue.submit(found.theta[doubtful], stop=stop)
        while not batch.wait(_LOOK):
            if stop():
                batch.drop()
                return stop.said
        told = _checked(batch.result(), len(doubtful))
        if stop.said:
            return stop.said
        found.costs[doubtful] = told
        found.exact[doubtful] = True
