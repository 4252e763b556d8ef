# SPDX-License-Identifier: Apache-2.0
"""The genetic algorithm of Ludwig and Gerstmayr (2011), section 2, as an ask/tell core.

No objective, clock, thread or print: the caller evaluates what `ask` returns and tells
the costs. Everything happens in the unit cube; bounds in physical units are the driver's business.
"""

from dataclasses import dataclass
import enum
import math
from typing import Any

import numpy as np

from ros2_ident.arrays import Array
from ros2_ident.errors import ErrorCode
from ros2_ident.search.operators import FIRST_GENERATIONS, Flags, Index, mutate, MUTATIONS, select

# Relative decrease of the best cost that counts as improvement.
_IMPROVES = 1e-6
_refuse = ErrorCode.BAD_VALUES.error


class StopReason(enum.Enum):
    """Why a search ended; the value is the sentence for the user."""

    GENERATIONS = 'All generations are done.'
    STAGNATION = (
        'The best cost has stopped improving; '
        'raise stagnation_generations, or set it to 0, to go on for longer.'
    )
    EVALUATIONS = 'The budget of evaluations is spent; give more of them to search further.'
    SECONDS = 'The budget of seconds is spent; give more of them to search further.'
    CANCELLED = 'The search was cancelled; the result is the best found until then.'
    SOLVED = 'Solved in one step by weighted least squares; nothing was searched.'


@dataclass(frozen=True)
class GeneticSettings:
    """The settings of Tables 2 and 4; the last three are ours and by default switched off.

    Attributes:
        initial_population: Candidates of the first generation.
        survivors: Most candidates that become parents, |S|.
        children: Children of each parent.
        generations: Generations, the first one included, N_g.
        range_reduction: xi in ]0, 1]; the mutation shrinks with xi^(g-1), eq. 6.
        min_distance: d_min,0; survivors keep d_min,0 xi^(g-1) apart, eq. 7. Where fewer than
            `survivors` candidates do so, fewer survive and the next generation is smaller.
        mutation: `gaussian_root` (eq. 5 with its root), `laplace` (without) or `normal` (as its
            text says).
        first_step: Factor on xi^(g-1) in eq. 6; 1 in the paper, where the first children are
            spread over the whole box. A tenth lets them search the surroundings of their parents
            at once.
        first_generation: `uniform` (eq. 4) or `kronecker` (fills the box more evenly with the same
            number of candidates).
        stagnation_generations: Stop after this many generations without improvement; 0 for never.
    """

    initial_population: int = 1024
    survivors: int = 8
    children: int = 8
    generations: int = 12
    range_reduction: float = 0.5
    min_distance: float = 0.0
    mutation: str = 'gaussian_root'
    first_step: float = 1.0
    first_generation: str = 'uniform'
    stagnation_generations: int = 0

    def __post_init__(self) -> None:
        for name in ('initial_population', 'survivors', 'children', 'generations'):
            if not (isinstance(getattr(self, name), int) and getattr(self, name) >= 1):
                raise _refuse(
                    f'{name} is {getattr(self, name)!r}; give a whole number of at least 1'
                )
        if not (isinstance(self.stagnation_generations, int) and self.stagnation_generations >= 0):
            raise _refuse(
                f'stagnation_generations is {self.stagnation_generations!r}; '
                'give a whole number, 0 for never'
            )
        for name, fits, wanted in (
            ('range_reduction', 0.0 < self.range_reduction <= 1.0, 'above 0 and at most 1'),
            ('first_step', 0.0 < self.first_step <= 1.0, 'above 0 and at most 1'),
            ('min_distance', 0.0 <= self.min_distance < math.inf, 'of at least 0'),
        ):
            if not fits:
                raise _refuse(f'{name} is {getattr(self, name)}; give a number {wanted}')
        for name, known in (('mutation', MUTATIONS), ('first_generation', FIRST_GENERATIONS)):
            if getattr(self, name) not in known:
                raise _refuse(
                    f'{name} is {getattr(self, name)!r}; give one of {", ".join(sorted(known))}'
                )

    @property
    def evaluations(self) -> int:
        """Most candidates a whole run evaluates."""
        return self.initial_population + (self.generations - 1) * self.survivors * self.children


# For costs with many narrow minima side by side: more parents with fewer children, who look around
# their parents instead of all over the box. Measured on the belt drive, see docs/search.md.
MANY_MINIMA = GeneticSettings(
    initial_population=500,
    survivors=40,
    children=4,
    generations=12,
    range_reduction=0.8,
    min_distance=0.05,
    first_step=0.05,
    first_generation='kronecker',
)


def checked_costs(costs: Any, count: int) -> Array:
    """Return the costs (S,) of `count` candidates.

    Raises:
        IdentError: BAD_VALUES where they are not one for each, or hold NaN or -inf.
    """
    told = np.asarray(costs, dtype=np.float64)
    if told.shape != (count,):
        raise _refuse(
            f'costs have the shape {told.shape}; give one number for each of the {count} '
            'candidates'
        )
    # The least of an array with NaN in it is NaN.
    if not told[told.argmin()] > -math.inf:
        wrong = int(np.flatnonzero(~(told > -math.inf))[0])
        raise _refuse(
            f'the cost of candidate {wrong} is {told[wrong]}; give inf for a diverged candidate, '
            'and leave a NaN in the data out of the cost'
        )
    return told


class GeneticSearch:
    """Mutation and selection without crossover.

    Example:
        >>> search = GeneticSearch(2, GeneticSettings(initial_population=256), seed=1)
        >>> while search.stop_reason is None:
        ...     points = search.ask()
        ...     search.tell(((points - 0.3) ** 2).sum(axis=1))
        >>> bool(search.best_cost < 1e-5)
        True

    Args:
        dimension: Number of parameters N.
        settings: The algorithm's settings.
        seed: Of PCG64; same seed and costs, same candidates to the bit.
        start: (N,) a candidate of the first generation, in the unit cube.

    Raises:
        IdentError: BAD_VALUES where dimension, seed or min_distance (eqs. 8 and 9) do not fit.
    """

    def __init__(
        self,
        dimension: int,
        settings: GeneticSettings | None = None,
        seed: int = 0,
        start: Array | None = None,
    ) -> None:
        self._start = start
        self.settings = settings if settings is not None else GeneticSettings()
        if dimension < 1:
            raise _refuse(f'dimension is {dimension}; a search needs at least one parameter')
        if seed < 0:
            raise _refuse(f'seed is {seed}; give a whole number of at least 0')
        # Eqs. 8 and 9: beyond the cube's diagonal no second survivor could exist.
        if self.settings.min_distance >= math.sqrt(dimension):
            raise _refuse(
                f'min_distance is {self.settings.min_distance}; for {dimension} parameter(s) '
                f'give a number below {math.sqrt(dimension):.4g}, the diagonal of the unit cube'
            )
        self.dimension = dimension
        self.seed = seed
        self.generation = 1
        self.evaluations = 0
        self.best_cost = math.inf
        self.best_point: Array = np.full(dimension, math.nan)
        self.survivors: Array = np.empty((0, dimension))
        self.survivor_costs: Array = np.empty(0)
        self._population: Array | None = None
        self._finished = False
        self._stagnant = 0
        self._rng = np.random.Generator(np.random.PCG64(seed))

    @property
    def stop_reason(self) -> StopReason | None:
        """Why the search has ended, None while it has not."""
        if self._finished:
            return StopReason.GENERATIONS
        limit = self.settings.stagnation_generations
        if limit and self._stagnant >= limit:
            return StopReason.STAGNATION
        return None

    @property
    def spread(self) -> float:
        """Largest standard deviation of the survivors over the parameters, in box widths."""
        return float(self.survivors.std(axis=0).max()) if len(self.survivors) else math.inf

    def ask(self) -> Array:
        """Return the candidates of the present generation.

        Returns:
            (S, N) in the unit cube, read-only; the same array until `tell`.

        Raises:
            IdentError: BAD_VALUES after the search has ended.
        """
        if self.stop_reason is not None:
            raise _refuse('the search has ended; start another one to ask for more candidates')
        if self._population is None:
            self._population = self._draw()
            self._population.flags.writeable = False
        return self._population

    def _draw(self) -> Array:
        s = self.settings
        if self.generation == 1:
            draw = FIRST_GENERATIONS[s.first_generation]
            points: Array = draw(s.initial_population, self.dimension, self._rng)
            points[:1] = points[:1] if self._start is None else self._start
            return points
        if not len(self.survivors):
            # Everything diverged so far: there is no parent to start from, so try new places.
            return self._rng.random((s.survivors * s.children, self.dimension))
        # Eq. 6 with g the parents' generation: the first children spread over the whole box.
        scale = s.first_step * s.range_reduction ** (self.generation - 2)
        return mutate(self.survivors, s.children, scale, s.mutation, self._rng)

    def limit(self, points: Array, costs: Array) -> float:
        """Return a cost above which a candidate of the present generation hardly survives.

        It is the last survivor's if no more candidates came; inf while there is room for more.

        Args:
            points: (S, N) in the unit cube, those of the generation that are evaluated already.
            costs: (S,) theirs.
        """
        _, pool, chosen = self._selected(points, costs)
        return float(pool[chosen[-1]]) if len(chosen) == self.settings.survivors else math.inf

    def in_doubt(self, costs: Array, exact: Flags) -> Index:
        """Return who survives although only a lower bound of its cost is known.

        Otherwise `tell` selects the same survivors as with all costs known: the others
        would be selected among even later, and are too near to better ones or too late already.

        Args:
            costs: (S,) of the candidates asked for, in their order, or lower bounds of them.
            exact: (S,) where it is the cost.

        Returns:
            (P,) indices of the candidates, whose costs have to be had before `tell`.
        """
        if exact.all():
            return np.empty(0, dtype=np.intp)
        assert self._population is not None
        chosen = self._selected(self._population, costs)[2]
        drawn: Index = chosen[chosen >= len(self.survivors)] - len(self.survivors)
        return drawn[~exact[drawn]]

    def _selected(self, points: Array, costs: Array) -> tuple[Array, Array, Index]:
        """Return previous survivors and candidates, their costs, and who survives, section 2.2."""
        both = np.concatenate((self.survivors, points))
        pool = np.concatenate((self.survivor_costs, costs))
        s = self.settings
        distance = s.min_distance * s.range_reduction ** (self.generation - 1)  # eq. 7
        return both, pool, select(both, pool, s.survivors, distance)

    def tell(self, costs: Any) -> None:
        """Select the survivors of the present generation and go on to the next.

        Args:
            costs: (S,) of the candidates asked for, in their order; inf for a diverged one.

        Raises:
            IdentError: BAD_VALUES where the costs do not fit the candidates, or hold NaN or -inf.
        """
        if self._population is None:
            raise _refuse('tell was called before ask; ask for candidates first')
        points = self._population
        told = checked_costs(costs, len(points))
        both, pool, chosen = self._selected(points, told)
        self.survivors, self.survivor_costs = both[chosen], pool[chosen]
        self.evaluations += len(told)
        if len(self.survivors):
            cost, needed = float(self.survivor_costs[0]), self.best_cost
            if math.isfinite(needed):
                needed -= _IMPROVES * abs(needed)
            self._stagnant = 0 if cost < needed else self._stagnant + 1
            if cost < self.best_cost:
                self.best_cost, self.best_point = cost, self.survivors[0].copy()
        self._population = None
        if self.generation == self.settings.generations:
            self._finished = True
        else:
            self.generation += 1
