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
from ros2_ident.errors import ErrorCode
from ros2_ident.search.evaluators import Cancel, Evaluate
from ros2_ident.search.genetic import checked_costs, GeneticSearch, StopReason
from ros2_ident.search.jacobian import Box
from ros2_ident.search.operators import Flags, Index

# (S, N) candidates in the unit cube -> (S,) how much work each of them is.
Work = Callable[[Array], Any]
# Sorted by work in parts, so that a budget that ends within a generation leaves no corner of the
# box out; so many are looked at in one go: what a model makes of a candidate takes some kB.
PART = 128
_BLOCK = 64 * PART
# Candidates of a first generation before some are given up. The limit is taken anew after twice as
# many, and so on, and after so many at the latest: the more are on their way together, the fewer
# vectors hold those that are left.
_FIRST_LIMIT, _NEXT_LIMIT = 32, 256
# Candidates between two looks at the cancel event where the evaluator does not look itself.
_SLICE = 16
# Slices by which the time to go is estimated. The first of a run is none of them: it may compile.
_RECENT = 8
# Least time between two reports, s.
_INTERVAL = 0.1


@dataclass(frozen=True)
class Budget:
    """Budget of a search; None is without limit.

    Attributes:
        evaluations: Candidates.
        seconds: Wall time of this call, s.
    """

    evaluations: int | None = None
    seconds: float | None = None

    def __post_init__(self) -> None:
        for name in ('evaluations', 'seconds'):
            value = getattr(self, name)
            if value is not None and not value > 0:
                raise ErrorCode.BAD_VALUES.error(
                    f'the budget of {name} is {value}; give a number above 0 or none'
                )


@dataclass(frozen=True)
class Progress:
    """A search, or the fit that it is part of, seen from outside at one instant.

    Attributes:
        phase: `search` for the genetic algorithm, `refinement` after it, and where the fit is an
            identification's, `intervals` while what the model may lack is weighed.
        generation: Generation being evaluated, or start being refined; from 1.
        generations: The last one, or the number of starts.
        evaluations: Candidates evaluated so far, all phases.
        budget: Candidates that will be evaluated at most, a refinement's as usual.
        best_cost: Lowest cost so far, inf before a candidate converged.
        best_theta: (N,) best parameters so far, physical units; NaN before one converged.
        spread: Largest standard deviation of the survivors over the parameters, in box widths.
        elapsed: Wall time so far, s.
        eta: Wall time still to go, s; NaN where unknown.
        each: Wall time a candidate takes at present, s; NaN where unknown.
        unit: Unit of the cost; empty where unknown.
        names: (N,) parameters; empty where unknown.
    """

    phase: str
    generation: int
    generations: int
    evaluations: int
    budget: int
    best_cost: float
    best_theta: Array
    spread: float
    elapsed: float
    eta: float
    each: float = math.nan
    unit: str = ''
    names: tuple[str, ...] = ()


OnProgress = Callable[[Progress], None]


@dataclass(frozen=True)
class SearchResult:
    """Result of a search.

    Attributes:
        theta: (N,) best parameters, physical units; NaN where every candidate diverged.
        cost: Their cost, inf where every candidate diverged.
        survivors: (P, N) last survivors by rising cost, physical units.
        survivor_costs: (P,) their costs.
        evaluations: Candidates evaluated, over all calls on this search.
        generations: Generations completed.
        best_costs: Best cost after each generation completed in this call.
        stop: Why the search ended; `stop.value` is a sentence.
    """

    theta: Array
    cost: float
    survivors: Array
    survivor_costs: Array
    evaluations: int
    generations: int
    best_costs: tuple[float, ...]
    stop: StopReason


class _Generation:
    """A generation while it is evaluated.

    Attributes:
        points: (S, N) as they were drawn, in the unit cube.
        theta: (S, N) in physical units.
        order: (S,) in which they are evaluated.
        costs: (S,) of the `done` first ones in that order, or lower bounds.
        exact: (S,) where it is the cost.
        done: How many are evaluated.
    """

    def __init__(self, points: Array, theta: Array, order: Index) -> None:
        self.points, self.theta, self.order = points, theta, order
        self.costs: Array = np.empty(len(points))
        self.exact: Flags = np.ones(len(points), dtype=bool)
        self.done = 0

    @property
    def rows(self) -> Index:
        """Those that are evaluated."""
        return self.order[: self.done]


@dataclass(eq=False)
class _Run:
    """One call of `minimise`: the clock, the counts and the best so far."""

    evaluate: Evaluate
    search: GeneticSearch
    box: Box
    budget: Budget
    on_progress: OnProgress | None
    cancel: Cancel | None
    give_up: bool
    work: Work | None

    def __post_init__(self) -> None:
        search, budget = self.search, self.budget
        self.stoppable = bool(getattr(self.evaluate, 'limited', False))
        self.limited = self.give_up and self.stoppable
        self.start = time.monotonic()
        self.reported = -math.inf
        self.recent: deque[tuple[int, float]] = deque(maxlen=_RECENT)  # candidates, s
        self.first = True
        self.said: StopReason | None = None
        self.done = search.evaluations  # told, plus those of the running generation
        self.best_cost = search.best_cost
        self.best_point = search.best_point
        planned = search.settings.evaluations
        self.limit = min(planned, budget.evaluations or planned)

    @property
    def elapsed(self) -> float:
        return time.monotonic() - self.start

    def stopped(self) -> bool:
        """Return whether to leave off what is being evaluated; several threads may ask."""
        seconds = self.budget.seconds
        if self.cancel is not None and self.cancel.is_set():
            self.said = self.said or StopReason.CANCELLED
        elif seconds is not None and self.elapsed >= seconds:
            self.said = self.said or StopReason.SECONDS
        return self.said is not None

    @property
    def left(self) -> int | None:
        """Candidates that the budget still allows; None for any number."""
        whole = self.budget.evaluations
        return None if whole is None else max(0, whole - self.done)

    @property
    def each(self) -> float:
        """Wall time a candidate takes at present, s."""
        count = sum(n for n, _ in self.recent)
        return sum(seconds for _, seconds in self.recent) / count if count else math.nan

    def costs(self, theta: Array, limit: float = math.inf) -> Array | None:
        """Evaluate candidates (S, N), or lower bounds above a limit; None where cut off."""
        more = (limit, self.stopped) if self.stoppable else ()
        told = checked_costs(self.evaluate(theta, *more), len(theta))
        return None if self.said else told

    def note(self, points: Array, costs: Array, seconds: float) -> None:
        self.done += len(points)
        if not self.first:
            self.recent.append((len(points), seconds))
        self.first = False
        best = int(costs.argmin())
        if costs[best] < self.best_cost:
            self.best_cost, self.best_point = float(costs[best]), points[best].copy()

    def report(self, *, last: bool = False) -> None:
        if self.on_progress is None:
            return
        elapsed = self.elapsed
        if not last and elapsed - self.reported < _INTERVAL:
            return
        self.reported = elapsed
        eta = self.each * max(self.limit - self.done, 0)
        if self.budget.seconds is not None:
            eta = min(eta, max(self.budget.seconds - elapsed, 0.0))
        self.on_progress(
            Progress(
                phase='search',
                generation=self.search.generation,
                generations=self.search.settings.generations,
                evaluations=self.done,
                budget=self.limit,
                best_cost=self.best_cost,
                best_theta=self.box.physical(self.best_point),
                spread=self.search.spread,
                elapsed=elapsed,
                eta=0.0 if last else eta,
                each=self.each,
            )
        )

    def order(self, points: Array) -> Index:
        """Return the (S,) order of candidates that fills the vector lanes.

        Candidates that take the same number of integration steps share a vector of lanes. The
        order matters to the time only: a search draws and selects as without.
        """
        part = np.arange(len(points))
        if self.work is None:
            return part
        found = []
        for begin in range(0, len(points), _BLOCK):
            if self.stopped():
                return part
            found.append(np.asarray(self.work(points[begin : begin + _BLOCK])))
        return np.asarray(np.lexsort((np.concatenate(found), part // PART)))

    def all(self, found: _Generation) -> StopReason | None:
        """Evaluate a generation; return why it was cut off, None where it was not."""
        count = len(found.points)
        limit, until = math.inf, count
        while found.done < count:
            if self.limited and found.done in (0, until):
                # At numbers that do not depend on the slices, nor does then what is given up.
                limit = self.search.limit(found.points[found.rows], found.costs[found.rows])
                few = max(found.done, _FIRST_LIMIT) if found.done or limit == math.inf else count
                until = min(count, found.done + min(few, _NEXT_LIMIT))
            if self.stopped():
                return self.said
            if self.left == 0:
                return StopReason.EVALUATIONS
            size = min(until - found.done, _NEXT_LIMIT if self.stoppable else _SLICE)
            size = size if self.left is None else min(size, self.left)
            rows = found.order[found.done : found.done + size]
            before = time.monotonic()
            told = self.costs(found.theta[rows], limit)
            if told is None:
                return self.said
            found.costs[rows] = told
            if self.limited:
                found.exact[rows] = (told <= limit) | (told == math.inf)
            found.done += size
            self.note(found.points[rows], told, time.monotonic() - before)
            self.report()
        return self.settle(found) if self.limited else None

    def take_up(self, found: _Generation, costs: Array, exact: Flags) -> StopReason | None:
        """Take up what an earlier run found of a generation; return as `all`."""
        found.costs[found.order] = costs
        found.exact[:] = False  # believed of those only that do not survive
        stop = self.settle(found)
        if stop is None:
            found.exact[found.order] |= exact
            found.done = len(costs)
            self.done += found.done
        return stop

    def settle(self, found: _Generation) -> StopReason | None:
        """Evaluate to the end who would survive by a lower bound of its cost; return as `all`."""
        while True:
            doubtful = self.search.in_doubt(found.costs, found.exact)
            if not doubtful.size:
                return None
            told = self.costs(found.theta[doubtful])
            if told is None:
                return self.said
            found.costs[doubtful] = told
            found.exact[doubtful] = True


def minimise(
    evaluate: Evaluate,
    search: GeneticSearch,
    *,
    low: Any,
    high: Any,
    budget: Budget | None = None,
    on_progress: OnProgress | None = None,
    on_generation: Callable[[Array, Array, Flags], None] | None = None,
    cancel: Cancel | None = None,
    known: Callable[[Array], tuple[Array, Flags] | None] | None = None,
    give_up: bool = True,
    work: Work | None = None,
) -> SearchResult:
    """Run a search to its end, its budget's end, or until it is cancelled.

    A generation that was cut off by a budget or the cancel event is not told to the search: its
    candidates count for the best so far, and a later call on the same search repeats them.

    Args:
        evaluate: (S, N) in physical units -> (S,) costs, inf for a diverged candidate. The costs
            must not depend on how the candidates are cut into slices. Where it has an attribute
            `limited`, it gets all arguments of `evaluators.Objective.costs`, and candidates that
            cannot survive are not evaluated to the end. The survivors are the same.
        search: What proposes candidates; is advanced.
        low: (N,) lower bounds, physical units.
        high: (N,) upper bounds, physical units.
        budget: What the search may cost.
        on_progress: Called at most ten times a second, and once at the end, from this thread.
        on_generation: Called after each generation, and after one that was cut off, with its
            candidates (S, N), physical units, their costs (S,) as far as they were evaluated, and
            where (S,) that is the cost and not a lower bound of it.
        cancel: Looked at between slices, and meanwhile where `evaluate` is `limited`.
        known: Gets the candidates of a generation (S, N), physical units, and returns costs (S,)
            of an earlier run, and where (S,) that is the cost; None where there are none. Those
            of survivors are computed again.
        give_up: Whether a `limited` evaluate gets limits.
        work: (S, N) in the unit cube -> (S,) how much work each candidate is; those that are alike
            are then evaluated side by side. The result is the same.

    Returns:
        The best so far and why the search ended.

    Raises:
        IdentError: BAD_VALUES where the bounds or costs are unusable.
    """
    box = Box.of(low, high)
    if len(box.low) != search.dimension:
        raise ErrorCode.BAD_VALUES.error(
            f'the bounds have the shape {box.low.shape}; '
            f'the search has {search.dimension} parameter(s)'
        )
    run = _Run(evaluate, search, box, budget or Budget(), on_progress, cancel, give_up, work)
    best_costs: list[float] = []
    completed = search.generation - (0 if search.stop_reason else 1)
    stop = search.stop_reason
    while stop is None:
        points = search.ask()
        found = _Generation(points, box.physical(points), run.order(points))
        room = run.left is None or len(points) <= run.left
        before = known(found.theta[found.order]) if known and room else None
        if before is not None and not run.stopped():
            stop = run.take_up(found, *before)
        else:
            stop = run.all(found)
        if on_generation is not None and found.done:
            rows = found.rows
            on_generation(found.theta[rows], found.costs[rows], found.exact[rows])
        if stop is not None:
            break
        search.tell(found.costs)
        if search.best_cost < run.best_cost:
            run.best_cost, run.best_point = search.best_cost, search.best_point
        completed += 1
        best_costs.append(search.best_cost)
        stop = search.stop_reason
    run.report(last=True)
    return SearchResult(
        theta=box.physical(run.best_point),
        cost=run.best_cost,
        survivors=box.physical(search.survivors),
        survivor_costs=search.survivor_costs.copy(),
        evaluations=run.done,
        generations=completed,
        best_costs=tuple(best_costs),
        stop=stop,
    )
