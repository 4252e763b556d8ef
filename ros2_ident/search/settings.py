# SPDX-License-Identifier: Apache-2.0
"""How to fit, and how far a fit has come."""

from collections.abc import Callable
from dataclasses import dataclass, field

from ros2_ident.arrays import Array
from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.search.driver import Budget
from ros2_ident.search.genetic import GeneticSettings


@dataclass(frozen=True)
class FitSettings:
    """How to fit.

    Attributes:
        genetic: The genetic algorithm; Table 4 of Ludwig and Gerstmayr (2011) by default.
        budget: What the whole run may cost, refinement included.
        refine: Whether to refine the genetic algorithm's result locally.
        starts: Most candidates to refine, the best and good ones far from it; the rest is left out
            once one has reached the noise of the outputs.
        refine_evaluations: Most candidates for each start; 60 Jacobians by default.
        level: Probability that an interval covers the truth.
        give_up: Whether to leave off simulating candidates of the genetic algorithm as soon as
            they cost too much to survive. The result is the same; their costs are not known then.
    """

    genetic: GeneticSettings = field(default_factory=GeneticSettings)
    budget: Budget = field(default_factory=Budget)
    refine: bool = True
    starts: int = 4
    refine_evaluations: int | None = None
    level: float = 0.95
    give_up: bool = True

    def __post_init__(self) -> None:
        for name in ('starts', 'refine_evaluations'):
            value = getattr(self, name)
            if value is not None and not (isinstance(value, int) and value >= 1):
                raise IdentError(
                    ErrorCode.INVALID_GOAL,
                    f'{name} is {value!r}; give a whole number of at least 1',
                )
        if not 0.0 < self.level < 1.0:
            raise IdentError(
                ErrorCode.INVALID_GOAL,
                f'level is {self.level}; give a probability between 0 and 1',
            )


@dataclass(frozen=True)
class FitProgress:
    """A fit seen from outside at one instant.

    Attributes:
        phase: `search` for the genetic algorithm, `refinement` after it, and where the fit is an
            identification's, `intervals` while what the model may lack is weighed.
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


OnProgress = Callable[[FitProgress], None]
