# SPDX-License-Identifier: Apache-2.0
"""From data to identified parameters: genetic algorithm, refinement, intervals, and words."""

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field

import numpy as np

from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.models import EffectAt, Machine
from ros2_ident.outcome import assemble, Found
from ros2_ident.problem import Array, chosen_drives, Data, gather, Problem
from ros2_ident.problem import read_problem as read_problem
from ros2_ident.recording import Dataset, Recording
from ros2_ident.result import Identification
from ros2_ident.search import (
    Budget,
    finite_differences,
    GeneticSearch,
    GeneticSettings,
    intervals,
    Intervals,
    minimise,
    Progress,
    refine,
    Refinement,
    SearchResult,
    StopReason,
    ThreadedEvaluator,
)
from ros2_ident.search.driver import Cancel
from ros2_ident.search.jacobian import Box
from ros2_ident.threads import processors

# The part of a budget that is kept for the refinement.
REFINEMENT_SHARE = 0.3
# Starts of the refinement differ in at least one parameter by this part of the box.
APART = 0.1
# A residual this close to the effort's own noise leaves nothing to search for.
DOWN_TO_NOISE = 1.2
# Jacobians a refinement takes, for the estimate of the time to go.
USUAL_STEPS = 12


@dataclass(frozen=True)
class IdentifySettings:
    """How to search.

    Attributes:
        genetic: The genetic algorithm; Table 4 of Ludwig and Gerstmayr (2011) by default.
        budget: What the whole run may cost, refinement included.
        refine: Whether to refine the genetic algorithm's result locally.
        starts: Most candidates to refine, the best and good ones far from it; the rest is left out
            once one has reached the noise of the effort.
        refine_evaluations: Most candidates for each start; 60 Jacobians by default.
        level: Probability that an interval covers the truth.
        cutoff: Low-pass of recorded motion where it drives the model [Hz].
        threads: Threads that simulate; one for each processor by default. Does not change the result.
    """

    genetic: GeneticSettings = field(default_factory=GeneticSettings)
    budget: Budget = field(default_factory=Budget)
    refine: bool = True
    starts: int = 4
    refine_evaluations: int | None = None
    level: float = 0.95
    cutoff: float = 100.0
    threads: int | None = None

    def __post_init__(self) -> None:
        for name, low in (('starts', 1), ('refine_evaluations', 1), ('threads', 1)):
            value = getattr(self, name)
            if value is not None and not (isinstance(value, int) and value >= low):
                raise IdentError(
                    ErrorCode.INVALID_GOAL, f'{name} is {value!r}; give a whole number of at least {low}'
                )
        if not 0.0 < self.level < 1.0:
            raise IdentError(
                ErrorCode.INVALID_GOAL, f'level is {self.level}; give a probability between 0 and 1'
            )


@dataclass(frozen=True)
class IdentifyProgress:
    """An identification seen from outside at one instant.

    Attributes:
        phase: `search` for the genetic algorithm, `refinement` after it.
        generation: Generation being evaluated, or start being refined; from 1.
        generations: The last one, or the number of starts.
        evaluations: Candidates simulated so far, both phases.
        budget: Candidates that will be simulated at most, the refinement's as usual.
        best_cost: Lowest cost so far, inf before a candidate converged.
        unit: Its unit.
        names: (N,) parameters.
        best_theta: (N,) best parameters so far, physical units.
        spread: Largest standard deviation of the survivors over the parameters, in box widths.
        elapsed: Wall time so far, s.
        eta: Wall time still to go, s; NaN where unknown.
    """

    phase: str
    generation: int
    generations: int
    evaluations: int
    budget: int
    best_cost: float
    unit: str
    names: tuple[str, ...]
    best_theta: Array
    spread: float
    elapsed: float
    eta: float


OnProgress = Callable[[IdentifyProgress], None]
Measured = Data | Dataset | Sequence[Dataset] | Sequence[Recording]


def identify(
    machine: Machine,
    data: Measured,
    *,
    drives: Sequence[str] | None = None,
    fixed: Mapping[str, float] | None = None,
    bounds: Mapping[str, tuple[float, float]] | None = None,
    effects: Sequence[EffectAt] = (),
    settings: IdentifySettings | None = None,
    seed: int = 0,
    cancel: Cancel | None = None,
    on_progress: OnProgress | None = None,
) -> Identification:
    """Identify the parameters of a machine.

    Same machine, data, settings and seed give the same parameters to the bit, whatever the number of
    threads, unless a budget of seconds or a cancel cuts the run.

    Args:
        machine: What is known of the machine, and the box of what is not.
        data: From `read_problem` or `gather`, or data sets or recordings; several are one problem.
        drives: Drives whose effort is compared and whose parameters are free; all where None.
        fixed: Parameters to hold at a value [their units]: `drive_1.gear_stiffness`, or
            `gear_stiffness` for every drive.
        bounds: (low, high) instead of the machine file's, by the same names.
        effects: Effects beside the nominal physics.
        settings: How to search.
        seed: Of the random generator.
        cancel: A `threading.Event` or the like; the best so far is kept.
        on_progress: Called from this thread at most ten times a second.

    Returns:
        The parameters with intervals, and how it ended in words.

    Raises:
        IdentError: INVALID_GOAL, UNKNOWN_PARAMETER, NO_DATA, MISSING_STREAM, BAD_VALUES or
            UNKNOWN_MODEL, before anything is simulated.
    """
    settings = settings or IdentifySettings()
    if not isinstance(seed, int) or seed < 0:
        raise IdentError(ErrorCode.INVALID_GOAL, f'seed is {seed!r}; give a whole number of at least 0')
    measured = _as_data(machine, data, drives)
    problem = Problem(
        machine, measured, drives=drives, fixed=fixed, bounds=bounds, effects=effects, cutoff=settings.cutoff
    )
    search = GeneticSearch(len(problem.parameters), settings.genetic, seed)
    threads = settings.threads or processors()
    with (
        ThreadedEvaluator(problem.costs, threads) as costs,
        ThreadedEvaluator(problem.residuals, threads) as residuals,
    ):
        run = _Run(problem, settings, search, costs, residuals, cancel, on_progress)
        found = run.solve()
    return assemble(problem, found, seed, _plain(settings))


def _as_data(machine: Machine, data: Measured, drives: Sequence[str] | None) -> Data:
    if isinstance(data, Data):
        return data
    if isinstance(data, Dataset):
        return Data((data,))
    datasets = [x for x in data if isinstance(x, Dataset)]
    recordings = [x for x in data if isinstance(x, Recording)]
    if datasets and not recordings:
        return Data(tuple(datasets))
    chosen_drives(machine, drives)
    return gather(recordings, machine, drives)


def _plain(settings: IdentifySettings) -> dict[str, object]:
    plain = asdict(settings)
    # Does not change the result, so files of one and of two threads are the same.
    plain.pop('threads')
    return plain


class _Either:
    """A cancel event and a deadline as one."""

    def __init__(self, cancel: Cancel | None, deadline: float | None) -> None:
        self._cancel = cancel
        self._deadline = deadline

    @property
    def cancelled(self) -> bool:
        return self._cancel is not None and self._cancel.is_set()

    def is_set(self) -> bool:
        return self.cancelled or (self._deadline is not None and time.monotonic() >= self._deadline)


class _Run:
    """One identification: the phases, and what is noted on the way."""

    def __init__(
        self,
        problem: Problem,
        settings: IdentifySettings,
        search: GeneticSearch,
        costs: Callable[[Array], Array],
        residuals: Callable[[Array], Array],
        cancel: Cancel | None,
        on_progress: OnProgress | None,
    ) -> None:
        self.problem = problem
        self.settings = settings
        self.search = search
        self.costs = costs
        self.residuals = residuals
        self.cancel = cancel
        self.on_progress = on_progress
        self.names = tuple(p.name for p in problem.parameters)
        self.candidates: list[Array] = []
        self.told: list[Array] = []
        self.generations: list[int] = []
        jacobian = len(self.names) + 1
        self.usual = settings.starts * USUAL_STEPS * jacobian if settings.refine else 0
        self.per_start = settings.refine_evaluations or 60 * jacobian
        # Compile, or read from the cache, before the clock runs.
        problem.costs(0.5 * (problem.low + problem.high)[None, :])
        self.start = time.monotonic()

    @property
    def elapsed(self) -> float:
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
            evaluations=ga.evaluations + (refined.evaluations if refined else 0) + extra,
            seconds=self.elapsed,
            candidates=np.concatenate(self.candidates) if self.candidates else np.empty((0, len(self.names))),
            costs=np.concatenate(self.told) if self.told else np.empty(0),
            generations=np.array(self.generations, dtype=np.int64),
        )

    # ------------------------------------------------------------------ genetic algorithm

    def _search(self) -> SearchResult:
        budget = self.settings.budget
        kept = 1.0 - REFINEMENT_SHARE if self.settings.refine else 1.0
        return minimise(
            self._evaluate,
            self.search,
            low=self.problem.low,
            high=self.problem.high,
            budget=Budget(
                evaluations=max(1, int(kept * budget.evaluations)) if budget.evaluations else None,
                generations=budget.generations,
                seconds=kept * budget.seconds if budget.seconds else None,
            ),
            cancel=self.cancel,
            on_progress=self._report_search if self.on_progress else None,
        )

    def _evaluate(self, theta: Array) -> Array:
        costs = self.costs(theta)
        self.candidates.append(theta)
        self.told.append(costs)
        self.generations += [self.search.generation] * len(theta)
        return costs

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

    def _starts(self, ga: SearchResult) -> Array:
        """Return (B, N) the best candidate and the best ones that lie apart from it and each other."""
        candidates, costs = np.concatenate(self.candidates), np.concatenate(self.told)
        width = self.problem.high - self.problem.low
        chosen = [ga.theta]
        # Candidates of equal cost keep the order in which they were drawn.
        for row in np.argsort(costs, kind='stable'):
            if len(chosen) == self.settings.starts or not np.isfinite(costs[row]):
                break
            if all((np.abs(candidates[row] - other) / width).max() > APART for other in chosen):
                chosen.append(candidates[row])
        return np.array(chosen)

    def _refine(self, ga: SearchResult) -> Refinement | None:
        budget = self.settings.budget
        starts = self._starts(ga)
        limit = self.per_start
        if budget.evaluations is not None:
            # The last Jacobian comes on top.
            left = budget.evaluations - ga.evaluations - 2 * len(self.names)
            starts = starts[: max(1, left // (USUAL_STEPS * (len(self.names) + 1)))]
            limit = min(limit, left // len(starts))
        deadline = None if budget.seconds is None else self.start + budget.seconds
        stop = _Either(self.cancel, deadline)
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
            good_enough=DOWN_TO_NOISE * self.problem.machine.effort_noise,
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

    def __init__(self, run: _Run, ga: SearchResult, starts: int) -> None:
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
