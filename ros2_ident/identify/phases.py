# SPDX-License-Identifier: Apache-2.0
"""One identification, phase after phase: genetic algorithm, refinement, confidence."""

import time

import numpy as np

from ros2_ident.identify.outcome import Found
from ros2_ident.identify.problem import Array, Problem
from ros2_ident.identify.settings import IdentifyProgress, IdentifySettings, OnProgress
from ros2_ident.search import (
    Budget,
    finite_differences,
    GeneticSearch,
    Intervals,
    intervals,
    minimise,
    Progress,
    refine,
    Refinement,
    SearchResult,
    StopReason,
)
from ros2_ident.search.evaluators import Cancel, Evaluators
from ros2_ident.search.jacobian import Box
from ros2_ident.search.operators import Flags

# The part of a budget that is kept for the refinement.
REFINEMENT_SHARE = 0.3
# Starts of the refinement differ in at least one parameter by this part of the box.
APART = 0.1
# A residual this close to the effort's own noise leaves nothing to search for.
DOWN_TO_NOISE = 1.2
# Jacobians a refinement takes, for the estimate of the time to go.
USUAL_STEPS = 12


class _Either:
    """A cancel event and a deadline as one."""

    def __init__(self, cancel: Cancel | None, deadline: float | None) -> None:
        self._cancel = cancel
        self._deadline = deadline

    @property
    def cancelled(self) -> bool:
        return self._cancel is not None and self._cancel.is_set()

    def is_set(self) -> bool:
        return self.cancelled or (
            self._deadline is not None and time.monotonic() >= self._deadline
        )


class Run:
    """One identification: the phases, and what is noted on the way."""

    def __init__(
        self,
        problem: Problem,
        settings: IdentifySettings,
        search: GeneticSearch,
        evaluators: Evaluators,
        cancel: Cancel | None,
        on_progress: OnProgress | None,
    ) -> None:
        self.problem = problem
        self.settings = settings
        self.search = search
        self.evaluators = evaluators
        self.residuals = evaluators.residuals
        self.cancel = cancel
        self.on_progress = on_progress
        self.names = tuple(p.name for p in problem.parameters)
        self.candidates: list[Array] = []
        self.told: list[Array] = []
        self.exact: list[Flags] = []
        self.generations: list[int] = []
        jacobian = len(self.names) + 1
        self.usual = settings.starts * USUAL_STEPS * jacobian if settings.refine else 0
        self.per_start = settings.refine_evaluations or 60 * jacobian
        problem.prepare()  # before the clock runs
        self.start = time.monotonic()

    @property
    def elapsed(self) -> float:
        """Wall time since the start, s."""
        return time.monotonic() - self.start

    def solve(self) -> Found:
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
                jacobian = self._jacobian(theta, residual)
                extra += 2 * len(theta)
        return Found(
            ga=ga,
            refined=refined,
            theta=theta,
            residual=residual,
            intervals=self._intervals(theta, residual, jacobian),
            cancelled=self.cancel is not None and self.cancel.is_set(),
            left_out=self.settings.refine and refined is None,
            evaluations=ga.evaluations + (refined.evaluations if refined else 0) + extra,
            seconds=self.elapsed,
            candidates=np.concatenate(self.candidates)
            if self.candidates
            else np.empty((0, len(self.names))),
            costs=np.where(np.concatenate(self.exact), np.concatenate(self.told), np.inf)
            if self.told
            else np.empty(0),
            generations=np.array(self.generations, dtype=np.int64),
        )

    # ------------------------------------------------------------------ genetic algorithm

    def _search(self) -> SearchResult:
        budget = self.settings.budget
        kept = 1.0 - REFINEMENT_SHARE if self.settings.refine else 1.0
        return minimise(
            self.evaluators.costs,
            self.search,
            low=self.problem.low,
            high=self.problem.high,
            budget=Budget(
                evaluations=self._share(kept),
                generations=budget.generations,
                seconds=kept * budget.seconds if budget.seconds else None,
            ),
            cancel=self.cancel,
            lot=self.evaluators.lot,
            on_generation=self._note,
            give_up=self.settings.give_up,
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

    def _report_search(self, progress: Progress) -> None:
        assert self.on_progress is not None
        later = self.usual * progress.elapsed / max(1, progress.evaluations)
        left = self.settings.budget.seconds
        eta = progress.eta + later
        self.on_progress(
            IdentifyProgress(
                phase='search',
                generation=progress.generation,
                generations=progress.generations,
                evaluations=progress.evaluations,
                budget=progress.budget + self.usual,
                best_cost=progress.best_cost,
                unit=self.problem.unit,
                names=self.names,
                best_theta=progress.best_theta,
                spread=progress.spread,
                elapsed=self.elapsed,
                eta=eta if left is None else min(eta, max(0.0, left - self.elapsed)),
            )
        )

    # ------------------------------------------------------------------ refinement

    def _starts(self, ga: SearchResult, stop: Cancel) -> Array:
        """Return (B, N) the best candidate and the best that lie apart from it and each other."""
        candidates, costs = np.concatenate(self.candidates), np.concatenate(self.told)
        exact = np.concatenate(self.exact)
        width = self.problem.high - self.problem.low

        def apart(from_: Array) -> Flags:
            far: Flags = (np.abs(candidates - from_) / width).max(axis=1) > APART
            return far

        beside_best = apart(ga.theta)

        def chosen(among: Array) -> list[int]:
            rows: list[int] = []
            free = beside_best & np.isfinite(among)
            while len(rows) < self.settings.starts - 1 and free.any():
                # Of candidates of equal cost the one that was drawn first.
                rows.append(int(np.where(free, among, np.inf).argmin()))
                free &= apart(candidates[rows[-1]])
            return rows

        # Some costs are lower bounds only. Those that may matter are found out as far as they do.
        known = chosen(np.where(exact, costs, np.inf))
        limit = float(costs[known[-1]]) if len(known) == self.settings.starts - 1 > 0 else np.inf
        rows = np.flatnonzero(beside_best & ~exact & (costs <= limit))
        while len(rows) and not stop.is_set():
            costs[rows] = self.problem.costs(candidates[rows], limit, stop.is_set)
            exact[rows] = costs[rows] <= limit
            rows = np.array([row for row in chosen(costs) if not exact[row]], dtype=np.intp)
            limit = np.inf
        return np.array([ga.theta, *candidates[chosen(costs)]])

    def _refine(self, ga: SearchResult) -> Refinement | None:
        budget = self.settings.budget
        deadline = None if budget.seconds is None else self.start + budget.seconds
        stop = _Either(self.cancel, deadline)
        starts = self._starts(ga, stop)
        limit = self.per_start
        if budget.evaluations is not None:
            # The last Jacobian comes on top.
            left = budget.evaluations - ga.evaluations - 2 * len(self.names)
            starts = starts[: max(1, left // (USUAL_STEPS * (len(self.names) + 1)))]
            limit = min(limit, left // len(starts))
        if limit < 1 or stop.is_set():
            return None
        watched = _Watched(self, ga, len(starts))
        return refine(
            watched.residuals,
            starts,
            self.problem.low,
            self.problem.high,
            cancel=stop,
            max_evaluations=limit,
            good_enough=DOWN_TO_NOISE * self.problem.noise,
        )

    # ------------------------------------------------------------------ confidence

    def _jacobian(self, theta: Array, residual: Array) -> Array:
        box = Box.of(self.problem.low, self.problem.high)
        unit = box.inside(theta)
        return finite_differences(self.residuals, unit, residual, box, central=True) / box.width

    def _intervals(self, theta: Array, residual: Array, jacobian: Array) -> Intervals | None:
        if not len(jacobian) or not np.isfinite(residual).all():
            return None
        p = self.problem
        return intervals(
            jacobian, residual, theta, p.low, p.high, series=p.series, level=self.settings.level
        )


class _Watched:
    """The residuals, with reports on the way."""

    INTERVAL = 0.1

    def __init__(self, run: Run, ga: SearchResult, starts: int) -> None:
        self.run = run
        self.ga = ga
        self.starts = starts
        self.evaluations = 0
        self.best_cost = ga.cost
        self.best_theta = ga.theta
        self.began = self.reported = time.monotonic()

    def residuals(self, theta: Array) -> Array:
        out = self.run.residuals(theta)
        self.evaluations += len(theta)
        if self.run.on_progress is None:
            return out
        if len(theta) == 1:
            cost = self.run.problem.cost_of(out[0])
            if cost < self.best_cost:
                self.best_cost, self.best_theta = cost, theta[0].copy()
        now = time.monotonic()
        if now - self.reported >= self.INTERVAL:
            self.reported = now
            self._report(now)
        return out

    def _report(self, now: float) -> None:
        assert self.run.on_progress is not None
        usual = self.run.usual * self.starts // self.run.settings.starts
        share = usual / self.starts
        eta = (now - self.began) / self.evaluations * max(0, usual - self.evaluations)
        seconds = self.run.settings.budget.seconds
        if seconds is not None:
            eta = min(eta, max(0.0, seconds - self.run.elapsed))
        self.run.on_progress(
            IdentifyProgress(
                phase='refinement',
                generation=min(self.starts, 1 + int(self.evaluations / share)),
                generations=self.starts,
                evaluations=self.ga.evaluations + self.evaluations,
                budget=self.ga.evaluations + max(usual, self.evaluations),
                best_cost=self.best_cost,
                unit=self.run.problem.unit,
                names=self.run.names,
                best_theta=self.best_theta,
                spread=self.run.search.spread,
                elapsed=self.run.elapsed,
                eta=eta,
            )
        )
