# SPDX-License-Identifier: Apache-2.0
"""How many simulations methods need until what they hold best stays within 1 % of the truth.

All methods see the same costs or residuals of the same simulator, which counts every candidate,
those of finite differences included. "Best" is by cost, as a user would judge; from the simulation
on after which the best candidate never leaves the 1 % again, the truth counts as found.
"""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, redirect_stdout
from dataclasses import dataclass
import io
import time

import numpy as np
from scipy.optimize import differential_evolution

from checks.paper.tripod_runs import FRICTION
from checks.reference.tripod import simulate_tripod
from ros2_ident.identify.data import Data
from ros2_ident.identify.problem import problem_of
from ros2_ident.models import Machine
from ros2_ident.recording import Dataset
from ros2_ident.search import GeneticSearch, GeneticSettings, minimise, refine, ThreadedEvaluator
from ros2_ident.search.jacobian import Box, finite_differences
from ros2_ident.search.operators import select
from ros2_ident.simulate.motions import Motion
from ros2_ident.threads import processors

Array = np.ndarray
WITHIN = 0.01
TABLE_4 = GeneticSettings()
# Enough of the box for a start in the right valley; the refinement does the rest.
FEW = GeneticSettings(
    initial_population=24,
    survivors=6,
    children=2,
    generations=3,
    range_reduction=0.5,
    first_step=0.2,
    first_generation='kronecker',
)


class Spent(Exception):
    """The budget is spent."""


@dataclass(frozen=True)
class Task:
    """A parameter identification with a known truth.

    Attributes:
        names: (N,) parameters.
        low: (N,) lower bounds.
        high: (N,) upper bounds.
        truth: (N,) true values.
        judged: (N,) whether the data determine the parameter within 1 %.
        costs: (S, N) -> (S,).
        residuals: (S, N) -> (S, R).
        cost_of: (R,) -> cost of one residual vector.
        noise: RMS of the residual at the truth.
    """

    names: tuple[str, ...]
    low: Array
    high: Array
    truth: Array
    judged: Array
    costs: Callable[[Array], Array]
    residuals: Callable[[Array], Array]
    cost_of: Callable[[Array], float]
    noise: float


@dataclass(frozen=True)
class Trial:
    """One run of a method.

    Attributes:
        reached: Simulations after which the best stays within 1 %; inf where it never does.
    """

    reached: float
    simulations: int
    seconds: float


class Watched:
    """Counts a task's simulations and follows the best candidate."""

    def __init__(self, task: Task, budget: int) -> None:
        self.task = task
        self.budget = budget
        self.count = 0
        self.best = np.inf
        self.reached = np.inf

    def costs(self, theta: Array) -> Array:
        """Return (S,) costs."""
        self._take(len(theta))
        told = self.task.costs(theta)
        self._look(theta, told)
        return told

    def residuals(self, theta: Array) -> Array:
        """Return (S, R) residuals."""
        self._take(len(theta))
        told = self.task.residuals(theta)
        self._look(theta, [self.task.cost_of(row) for row in told])
        return told

    def unit(self, points: Array) -> Array:
        """Return the costs (S,) of points (S, N) in the unit cube."""
        return self.costs(self.task.low + points * (self.task.high - self.task.low))

    def _take(self, count: int) -> None:
        if self.count + count > self.budget:
            raise Spent
        self.count += count

    def _look(self, theta: Array, costs: Sequence[float] | Array) -> None:
        first = self.count - len(theta)
        for i, cost in enumerate(costs):
            if not cost < self.best:
                continue
            self.best = float(cost)
            error = np.abs(theta[i] / self.task.truth - 1.0)[self.task.judged]
            if (error > WITHIN).any():
                self.reached = np.inf
            elif not np.isfinite(self.reached):
                self.reached = float(first + i + 1)


def genetic(settings: GeneticSettings) -> Callable[[Watched, int], None]:
    """Return the paper's genetic algorithm alone."""

    def run(watched: Watched, seed: int) -> None:
        task = watched.task
        search = GeneticSearch(len(task.low), settings, seed)
        minimise(watched.costs, search, low=task.low, high=task.high)

    return run


def ours(
    settings: GeneticSettings,
    *,
    starts: int = 12,
    distance: float = 0.1,
    tolerance: float = 1e-4,
    most: int = 180,
) -> Callable[[Watched, int], None]:
    """Return a genetic algorithm with a refinement after it, as `identify` does.

    Args:
        starts: Most candidates that are refined; the others are left out once one has reached the
            noise.
        distance: What the starts are apart, in box widths.
        tolerance: Relative change that ends a refinement.
    """

    def run(watched: Watched, seed: int) -> None:
        task = watched.task
        seen: list[tuple[Array, Array]] = []

        def costs(theta: Array) -> Array:
            told = watched.costs(theta)
            seen.append((theta, told))
            return told

        search = GeneticSearch(len(task.low), settings, seed)
        minimise(costs, search, low=task.low, high=task.high)
        candidates = np.concatenate([theta for theta, _ in seen])
        told = np.concatenate([cost for _, cost in seen])
        box = Box.of(task.low, task.high)
        refine(
            watched.residuals,
            candidates[select(box.inside(candidates), told, starts, distance)],
            task.low,
            task.high,
            max_evaluations=most,
            total_evaluations=max(1, watched.budget - watched.count),
            tolerance=tolerance,
            good_enough=1.05 * task.noise,
        )

    return run


def exudyn_genetic(watched: Watched, seed: int) -> None:
    """Run Exudyn's genetic algorithm on our simulator; it asks for one candidate at a time."""
    from checks.benchmarks.exudyn_models import genetic_optimization

    task = watched.task

    def objective(parameters: dict[str, float]) -> float:
        return float(watched.costs(np.array([[parameters[name] for name in task.names]]))[0])

    bounds = {
        name: (low, high) for name, low, high in zip(task.names, task.low, task.high, strict=True)
    }
    genetic_optimization(objective, bounds, seed, 1)


def evolution(watched: Watched, seed: int) -> None:
    """Run SciPy's differential evolution, all candidates of a generation at once."""
    task = watched.task
    differential_evolution(
        lambda points: watched.unit(points.T),
        [(0.0, 1.0)] * len(task.low),
        rng=np.random.default_rng(seed),
        maxiter=10**6,
        tol=0.0,
        atol=0.0,
        polish=False,
        vectorized=True,
        updating='deferred',
    )


def covariance_adaptation(watched: Watched, seed: int) -> None:
    """Run pycma; where it has converged, again with twice the population until the budget ends."""
    import cma

    dimension = len(watched.task.low)
    rng = np.random.default_rng(seed)
    population = 4 + int(3 * np.log(dimension))
    while True:
        search = cma.CMAEvolutionStrategy(
            rng.random(dimension),
            0.3,
            {
                'bounds': [0.0, 1.0],
                'popsize': population,
                'seed': int(rng.integers(1, 2**31)),
                'verbose': -9,
            },
        )
        while not search.stop():
            points = search.ask()
            costs = watched.unit(np.array(points))
            search.tell(points, np.where(np.isfinite(costs), costs, 1e6).tolist())
        population *= 2


def attempt(method: Callable[[Watched, int], None], task: Task, seed: int, budget: int) -> Trial:
    """Run a method once."""
    watched = Watched(task, budget)
    before = time.perf_counter()
    try:
        with redirect_stdout(io.StringIO()):
            method(watched, seed)
    except Spent:
        pass
    return Trial(watched.reached, watched.count, time.perf_counter() - before)


@contextmanager
def tripod_task(machine: Machine, motion: Motion, noise: float, seed: int) -> Iterator[Task]:
    """Open a tripod with three equal drives: Table 3's five parameters, all three torques.

    Args:
        noise: Standard deviation of the logged torque, N m.
    """
    rng = np.random.default_rng([2011, seed])
    truth = _truth(machine, rng)
    log = simulate_tripod(machine, {**truth, **FRICTION}, motion.position, motion.velocity)
    effort = np.full(log.effort.shape, np.nan)
    effort[:, ::2] = log.effort[:, ::2] + noise * rng.standard_normal(log.effort[:, ::2].shape)
    dataset = Dataset(
        machine.drives, log.cycle, 0, motion.position, motion.velocity, None, None, effort
    )
    problem = problem_of(machine, Data((dataset,)), fixed=FRICTION)
    names = tuple(truth)
    columns = np.array([names.index(p.name.split('.')[-1]) for p in problem.parameters])
    bounds = np.array([machine.bounds[name][:2] for name in names])
    true = np.array(list(truth.values()))
    with (
        ThreadedEvaluator(problem.costs, processors()) as costs,
        ThreadedEvaluator(problem.residuals, processors()) as residuals,
    ):
        wide = true[columns][None]
        box = Box.of(bounds[:, 0], bounds[:, 1])
        residual = problem.residuals(wide)[0]
        jacobian = finite_differences(
            lambda theta: residuals(theta[:, columns]),
            box.inside(true),
            residual,
            box,
            central=True,
        )
        jacobian = jacobian / box.width
        error = noise * np.sqrt(np.diag(np.linalg.inv(jacobian.T @ jacobian)))
        yield Task(
            names,
            bounds[:, 0],
            bounds[:, 1],
            true,
            1.96 * error <= WITHIN * true,
            lambda theta: costs(theta[:, columns]),
            lambda theta: residuals(theta[:, columns]),
            problem.cost_of,
            float(np.sqrt(np.mean(residual**2))),
        )


def _truth(machine: Machine, rng: np.random.Generator) -> dict[str, float]:
    """Draw parameters from the inner part of the box, where real machines lie."""
    inner = {
        'measurement_delay': (0.1, 0.5),
        'gear_stiffness': (0.35, 0.9),
        'gear_damping_ratio': (0.1, 0.5),
        'tool_mass': (0.1, 0.9),
        'drive_inertia': (0.1, 0.9),
    }
    truth = {}
    for name, (begin, end) in inner.items():
        low, high, _ = machine.bounds[name]
        truth[name] = low + rng.uniform(begin, end) * (high - low)
    return truth
