# SPDX-License-Identifier: Apache-2.0
"""One fit, phase after phase: genetic algorithm, refinement, confidence.

Identification, diagnosis, the paper's experiments and the fleet all fit by this.
"""

from dataclasses import asdict, dataclass, field, replace
from functools import partial
import time
from typing import ClassVar, Protocol

import numpy as np
import numpy.typing as npt

from ros2_ident.arrays import Array, rms
from ros2_ident.errors import ErrorCode
from ros2_ident.search.driver import Budget, minimise, OnProgress, Progress, SearchResult
from ros2_ident.search.evaluators import (
    Cancel,
    Evaluate,
    Objective,
    ThreadedEvaluator,
    Threads,
    Workers,
)
from ros2_ident.search.genetic import GeneticSearch, GeneticSettings, StopReason
from ros2_ident.search.jacobian import Box, finite_differences, Known
from ros2_ident.search.journal import Journal, Within
from ros2_ident.search.operators import Flags
from ros2_ident.search.refine import refine, Refinement, RefineStatus
from ros2_ident.search.uncertainty import even_weights, Intervals, intervals
from ros2_ident.threads import free_memory

# The part of a budget that is kept for the refinement.
REFINEMENT_SHARE = 0.3
# A residual this close to the effort's own noise leaves nothing to search for.
DOWN_TO_NOISE = 1.2
# Jacobians a refinement takes, for the estimate of the time to go.
USUAL_STEPS = 12
# Jacobians' worth of candidates that a start may take at most.
JACOBIANS = 60
# What a candidate costs that is simulated to its end, over one of the search: most are given up.
WHOLE = 5.0
# Starts differ in at least one parameter by this part of the box.
_APART = 0.1
# Least time between two reports of a refinement, s.
_INTERVAL = 0.1
# Copies of a candidate's numbers that a search holds at once, and bytes beside them, measured.
_COPIES, _BESIDE = 4, 100


class Solvable(Objective, Protocol):
    """Problem to fit: an objective with a box; shapes as for `Objective`.

    Attributes:
        names: (N,) names of the parameters.
        low: (N,) lower ends of the box, physical units.
        high: (N,) upper ends.
        unit: Unit of the cost.
        noise: Standard deviation of the residual's noise as stated; 0 where it is not.
        series: Lengths of the time series that follow one another in the residual.
        outputs: How many outputs they are of, the series of all after each other.
        key: Digest of what the fit depends on besides settings and seed.
    """

    low: Array
    high: Array
    unit: str
    series: tuple[int, ...]
    outputs: int

    @property
    def names(self) -> tuple[str, ...]:
        """The N names."""
        ...

    @property
    def noise(self) -> float:
        """Stated noise."""
        ...

    @property
    def key(self) -> str:
        """Digest of the problem."""
        ...

    def work(self, points: Array) -> npt.NDArray[np.int64]:
        """Return (S,) how much work candidates (S, N) in the unit cube are."""
        ...

    def cost_of(self, residual: Array) -> float:
        """Return the cost that belongs to one residual vector (R,)."""
        ...


@dataclass(frozen=True)
class FitSettings:
    """How to fit.

    Attributes:
        genetic: The genetic algorithm; Table 4 of Ludwig and Gerstmayr (2011) by default.
        budget: What the whole run may cost, refinement included.
        refine: Whether to refine the genetic algorithm's result locally.
        starts: Most candidates to refine, the best and good ones far from it; the rest is left out
            once one has reached the noise of the outputs.
        level: Probability that an interval covers the truth.
        give_up: Whether to leave off simulating candidates of the genetic algorithm as soon as
            they cost too much to survive. The result is the same; their costs are not known then.
    """

    genetic: GeneticSettings = field(default_factory=GeneticSettings)
    budget: Budget = field(default_factory=Budget)
    refine: bool = True
    starts: int = 4
    level: float = 0.95
    give_up: bool = True
    # Whole numbers of at least 1, or None where that is a default.
    counts: ClassVar[tuple[str, ...]] = ('starts',)

    def __post_init__(self) -> None:
        for name in self.counts:
            value = getattr(self, name)
            if value is not None and not (isinstance(value, int) and value >= 1):
                raise ErrorCode.INVALID_GOAL.error(
                    f'{name} is {value!r}; give a whole number of at least 1'
                )
        if not 0.0 < self.level < 1.0:
            raise ErrorCode.INVALID_GOAL.error(
                f'level is {self.level}; give a probability between 0 and 1'
            )


@dataclass(frozen=True, eq=False)
class Fitted:
    """Result of a fit.

    Attributes:
        ga: The genetic algorithm's result.
        refined: The refinement's, or None.
        theta: (N,) the estimate, physical units; NaN where every candidate diverged.
        residual: (R,) residual there; empty where every candidate diverged.
        intervals: Confidence of the estimate, or None.
        cancelled: Whether the run was cancelled.
        left_out: Whether a refinement was asked for and not begun.
        evaluations: Candidates simulated.
        seconds: Wall time, s.
        candidates: (E, N) candidates of the genetic algorithm.
        costs: (E,) their costs; inf where one diverged or was given up.
        generations: (E,) their generations.
    """

    ga: SearchResult
    refined: Refinement | None
    theta: Array
    residual: Array
    intervals: Intervals | None
    cancelled: bool
    left_out: bool
    evaluations: int
    seconds: float
    candidates: Array
    costs: Array
    generations: npt.NDArray[np.int64]


def fit(
    problem: Solvable,
    settings: FitSettings | None = None,
    seed: int = 0,
    *,
    cancel: Cancel | None = None,
    on_progress: OnProgress | None = None,
    workers: Workers | None = None,
    journal: Journal | None = None,
    first: Array | None = None,
    known: Known | None = None,
    even: bool = False,
) -> Fitted:
    """Fit a problem.

    Same problem, settings and seed give the same result to the bit, wherever evaluated, unless a
    budget of seconds or a cancel cuts the run.

    Args:
        problem: What to fit.
        settings: How.
        seed: Of the random generator.
        cancel: A `threading.Event` or the like; the best so far is kept.
        on_progress: Called from this thread at most ten times a second.
        workers: Who evaluates; threads of this process, one for each processor, where None.
        journal: Gets every generation and the end of every start of the refinement; a fit of the
            same problem, settings and seed goes on from it, with the same result to the bit.
        first: (N,) a candidate of the first generation, physical units.
        known: What is known of the parameters beside their box; the refinement counts it.
        even: Whether the refinement goes on with each output weighted by the size of what it
            leaves, which has to be noise more than a difference of the recordings.

    Returns:
        The estimate with what is known of it.

    Raises:
        IdentError: INVALID_GOAL where the candidates would not fit into the memory, or as the
            workers.
    """
    settings = settings or FitSettings()
    _require_memory(settings, len(problem.low))
    workers = workers or Threads()
    with (
        workers.open(problem, cancel) as costs,
        ThreadedEvaluator(problem.residuals, workers.count) as residuals,
    ):
        return _Fit(
            problem, settings, seed, costs, residuals, cancel, on_progress, journal or Journal(),
            first, known, even,
        ).solve()  # fmt: skip


def _require_memory(settings: FitSettings, dimension: int) -> None:
    """Refuse a search whose candidates do not fit into the memory, before anything is simulated.

    Raises:
        IdentError: INVALID_GOAL with what it would take.
    """
    count = settings.genetic.evaluations
    if settings.budget.evaluations is not None:
        drawn = max(settings.genetic.initial_population, settings.budget.evaluations)
        count = min(count, drawn)
    needed, free = count * (_COPIES * 8 * dimension + _BESIDE), free_memory()
    if needed > free:
        raise ErrorCode.INVALID_GOAL.error(
            f'{count} candidates of {dimension} parameters would take about '
            f'{needed / 2**30:.3g} GiB of memory, and {free / 2**30:.3g} GiB are free (at 1000 a '
            f'second they would also take {count / 3.6e6:.3g} h); lower initial_population or '
            'generations'
        )


@dataclass(eq=False)
class _Fit:
    """One fit: the phases, and what is noted on the way; a `Cancel` of its refinement."""

    problem: Solvable
    settings: FitSettings
    seed: int
    costs: Evaluate
    residuals: Evaluate
    cancel: Cancel | None
    on_progress: OnProgress | None
    journal: Journal
    first: Array | None
    known: Known | None
    even: bool

    def __post_init__(self) -> None:
        problem, settings = self.problem, self.settings
        self.names = problem.names
        self.candidates: list[Array] = [np.empty((0, len(self.names)))]
        self.told: list[Array] = [np.empty(0)]
        self.exact: list[Flags] = [np.empty(0, dtype=bool)]
        self.generations: list[int] = []
        jacobian = len(self.names) + 1
        self.usual = settings.starts * USUAL_STEPS * jacobian if settings.refine else 0
        self.per_start = JACOBIANS * jacobian
        start = self.first
        if start is not None:
            start = (start - problem.low) / (problem.high - problem.low)
        self.search = GeneticSearch(len(self.names), settings.genetic, self.seed, start)
        self.new = True
        self.key = 'generation', problem.key, self.seed, asdict(settings.genetic)
        self.weights = np.ones(1)
        problem.prepare()  # before the clock runs
        self.start = time.monotonic()

    @property
    def elapsed(self) -> float:
        """Wall time since the start, s."""
        return time.monotonic() - self.start

    def is_set(self) -> bool:
        """Return whether to end: cancelled, or out of time."""
        cancelled = self.cancel is not None and self.cancel.is_set()
        seconds = self.settings.budget.seconds
        return cancelled or (seconds is not None and self.elapsed >= seconds)

    def solve(self) -> Fitted:
        """Run the phases."""
        ga = self._search()
        refined = None
        if self.settings.refine and np.isfinite(ga.cost) and ga.stop is not StopReason.CANCELLED:
            refined = self._refine(ga)
        theta, residual, jacobian = ga.theta, np.empty(0), np.empty((0, len(self.names)))
        extra = 0
        if refined is not None and np.isfinite(refined.cost):
            theta, residual, jacobian = refined.theta, refined.residual, refined.jacobian
        elif np.isfinite(ga.cost):
            # A cancel is answered at once: one simulation for the residual, no intervals.
            residual = self.residuals(theta[None, :])[0]
            extra = 1
            if ga.stop is not StopReason.CANCELLED:
                box = Box.of(self.problem.low, self.problem.high)
                unit = box.inside(theta)
                slopes = finite_differences(self.residuals, unit, residual, box, central=True)
                jacobian = slopes / box.width
                extra += 2 * len(theta)
        return Fitted(
            ga=ga,
            refined=refined,
            theta=theta,
            residual=residual,
            intervals=self._intervals(theta, residual, jacobian),
            cancelled=self.cancel is not None and self.cancel.is_set(),
            left_out=self.settings.refine and refined is None,
            evaluations=ga.evaluations + (refined.evaluations if refined else 0) + extra,
            seconds=self.elapsed,
            candidates=np.concatenate(self.candidates),
            costs=np.where(np.concatenate(self.exact), np.concatenate(self.told), np.inf),
            generations=np.array(self.generations, dtype=np.int64),
        )

    # ------------------------------------------------------------------ genetic algorithm

    def _search(self) -> SearchResult:
        budget = self.settings.budget
        kept = 1.0 - REFINEMENT_SHARE if self.settings.refine else 1.0
        return minimise(
            self.costs,
            self.search,
            low=self.problem.low,
            high=self.problem.high,
            budget=Budget(
                evaluations=self._share(kept),
                seconds=kept * budget.seconds if budget.seconds else None,
            ),
            cancel=self.cancel,
            on_generation=self._note,
            known=self._known,
            give_up=self.settings.give_up,
            work=self.problem.work,
            on_progress=self._report_search if self.on_progress else None,
        )

    def _share(self, kept: float) -> int | None:
        """Return the evaluations that the search may take of the whole run's."""
        whole = self.settings.budget.evaluations
        if whole is None:
            return None
        # The last Jacobian, for the intervals, has its own.
        return max(1, min(int(kept * whole), whole - 2 * len(self.names) - 1))

    def _note(self, theta: Array, costs: Array, exact: Flags) -> None:
        self.candidates.append(theta)
        self.told.append(costs)
        self.exact.append(exact)
        self.generations += [self.search.generation] * len(theta)
        if self.new and len(theta) == len(self.search.ask()):
            self.journal.put({'costs': costs, 'exact': exact}, *self.key, theta)

    def _known(self, theta: Array) -> tuple[Array, Flags] | None:
        """Return costs of a generation (S, N) that an earlier run of the same fit has left."""
        count = (len(theta),)
        wanted = {'costs': Within(count, 0.0), 'exact': Within(count, kind=bool)}
        kept = self.journal.get(wanted, *self.key, theta)
        self.new = kept is None
        return None if kept is None else (kept['costs'], kept['exact'])

    def _report_search(self, progress: Progress) -> None:
        eta = progress.eta + WHOLE * self.usual * progress.each
        self.tell(replace(progress, budget=progress.budget + self.usual, eta=eta))

    def tell(self, progress: Progress) -> None:
        """Say how far the fit is, no longer to go than the budget allows."""
        assert self.on_progress is not None
        eta, seconds, elapsed = progress.eta, self.settings.budget.seconds, self.elapsed
        if seconds is not None:
            eta = min(eta, max(0.0, seconds - elapsed))
        unit, names = self.problem.unit, self.names
        self.on_progress(replace(progress, unit=unit, names=names, elapsed=elapsed, eta=eta))

    # ------------------------------------------------------------------ refinement

    def _starts(self, ga: SearchResult) -> Array:
        """Return (B, N) the best candidate and the best that lie apart from it and each other.

        Some costs are lower bounds only; those that matter are found out as far as they do.
        """
        count, width = self.settings.starts, self.problem.high - self.problem.low
        if count < 2:
            return ga.theta[None]
        candidates, costs = np.concatenate(self.candidates), np.concatenate(self.told)
        exact = np.concatenate(self.exact)

        def apart(point: Array) -> Flags:
            return np.asarray((np.abs(candidates - point) / width).max(axis=1) > _APART)

        beside_best = apart(ga.theta)

        def chosen(among: Array) -> list[int]:
            rows: list[int] = []
            free = beside_best & np.isfinite(among)
            while len(rows) < count - 1 and free.any():
                # Of candidates of equal cost the one that was drawn first.
                rows.append(int(np.where(free, among, np.inf).argmin()))
                free &= apart(candidates[rows[-1]])
            return rows

        known = chosen(np.where(exact, costs, np.inf))
        limit = float(costs[known[-1]]) if len(known) == count - 1 else np.inf
        rows = np.flatnonzero(beside_best & ~exact & (costs <= limit))
        while len(rows) and not self.is_set():
            costs[rows] = self.problem.costs(candidates[rows], limit, self.is_set)
            exact[rows] = costs[rows] <= limit
            rows = np.array([row for row in chosen(costs) if not exact[row]], dtype=np.intp)
            limit = np.inf
        return np.array([ga.theta, *candidates[chosen(costs)]])

    def _refine(self, ga: SearchResult) -> Refinement | None:
        budget = self.settings.budget
        starts = self._starts(ga)
        limit = self.per_start
        if budget.evaluations is not None:
            # The last Jacobian comes on top.
            left = budget.evaluations - ga.evaluations - 2 * len(self.names)
            starts = starts[: max(1, left // (USUAL_STEPS * (len(self.names) + 1)))]
            limit = min(limit, left // len(starts))
        if limit < 1 or self.is_set():
            return None
        residuals, key = self._watched(ga, len(starts)), self.problem.key
        refined = partial(
            refine, low=self.problem.low, high=self.problem.high, cancel=self,
            journal=self.journal, known=self.known,
        )  # fmt: skip
        found = refined(
            residuals, starts, max_evaluations=limit, key=key,
            good_enough=DOWN_TO_NOISE * self.problem.noise,
        )  # fmt: skip
        if budget.evaluations is not None:
            limit = min(limit, left - found.evaluations)
        if not self.even or found.status is not RefineStatus.CONVERGED or limit < 1:
            return found
        # What an output leaves says how much its samples tell, those of a wrist beside a shoulder.
        weights = even_weights(found.residual, self.problem.series, self.problem.outputs)
        if not np.ptp(weights):
            return found
        again = refined(
            lambda theta: residuals(theta) * weights, found.theta, max_evaluations=limit,
            key=f'{key} weighted',
        )  # fmt: skip
        count = found.evaluations + again.evaluations
        if again.status is not RefineStatus.CONVERGED:
            return replace(found, evaluations=count)
        self.weights, residual = weights, again.residual / weights
        return replace(
            again, residual=residual, jacobian=again.jacobian / weights[:, None],
            cost=rms(residual), evaluations=count, starts=found.starts,
        )  # fmt: skip

    def _watched(self, ga: SearchResult, starts: int) -> Evaluate:
        """Return the residuals, with reports on the way."""
        if self.on_progress is None:
            return self.residuals
        usual = self.usual * starts // self.settings.starts
        best, theta_best, count = ga.cost, ga.theta, 0
        began = reported = time.monotonic()

        def residuals(theta: Array) -> Array:
            nonlocal best, theta_best, count, reported
            out = self.residuals(theta)
            count += len(theta)
            cost = self.problem.cost_of(out[0]) if len(theta) == 1 else best
            if cost < best:
                best, theta_best = cost, theta[0].copy()
            now = time.monotonic()
            if now - reported < _INTERVAL:
                return out
            reported = now
            self.tell(
                Progress(
                    phase='refinement',
                    generation=min(starts, 1 + int(count * starts / usual)),
                    generations=starts,
                    evaluations=ga.evaluations + count,
                    budget=ga.evaluations + max(usual, count),
                    best_cost=best,
                    best_theta=theta_best,
                    spread=self.search.spread,
                    elapsed=0.0,
                    eta=(now - began) / count * max(0, usual - count),
                )
            )
            return out

        return residuals

    # ------------------------------------------------------------------ confidence

    def _intervals(self, theta: Array, residual: Array, jacobian: Array) -> Intervals | None:
        if not len(jacobian) or not np.isfinite(residual).all():
            return None
        p = self.problem
        rows, left = jacobian * self.weights[:, None], residual * self.weights
        return intervals(
            rows, left, theta, p.low, p.high, series=p.series, level=self.settings.level,
            known=self.known,
        )  # fmt: skip
