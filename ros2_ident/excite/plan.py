# SPDX-License-Identifier: Apache-2.0
"""The search for the motion that determines parameters best."""

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
import math

import numpy as np
import numpy.typing as npt

from ros2_ident.arrays import Array
from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.excite.course import Courses
from ros2_ident.excite.information import Sensitivity, Shown
from ros2_ident.excite.limits import Limits, Moved
from ros2_ident.machine.machine import Parameter
from ros2_ident.search import Budget, GeneticSearch, GeneticSettings, minimise
from ros2_ident.search.driver import Progress

# Rest before the one period that is simulated in the search, s.
_SHORT_REST = 0.05
# Rounds in which the motion shrinks until what is simulated keeps to the limits, and how far it
# stays below them.
_ROUNDS, _BELOW = 8, 0.999
# Small steps that shrink slowly: a motion has dozens of numbers, and each helps a little.
SEARCH = GeneticSettings(
    initial_population=256,
    survivors=8,
    children=8,
    generations=60,
    range_reduction=0.95,
    first_step=0.2,
    mutation='normal',
)


@dataclass(frozen=True)
class Wish:
    """Purpose of a motion: the parameters to determine.

    Attributes:
        names: Parameters, `gear_stiffness` meaning that of every drive; all where empty.
        criterion: `d` for the smallest volume of their joint confidence region (D-optimality), the
            others unknown as well; `worst` for the smallest of the largest intervals, in widths of
            the boxes.
        seed: Of the search.
        settings: Of the search.
        budget: What the search may cost.
        threads: Motions that are simulated at a time.
    """

    names: tuple[str, ...] = ()
    criterion: str = 'd'
    seed: int = 0
    settings: GeneticSettings = SEARCH
    budget: Budget = field(default_factory=Budget)
    threads: int = 1


@dataclass(frozen=True, eq=False)
class Excitation:
    """A motion and what it will tell.

    Attributes:
        planned: Its set-points.
        shown: What the machine does, and the information in its log.
        others: What it does with parameters a quarter lower and higher than expected.
        courses: What it was chosen from, with machine and limits.
        parameters: The N parameters.
        values: (N,) at which the information was worked out.
        wanted: (N,) which of them were to be determined.
        half_widths: (N,) half the 95 % intervals that a log will give at best.
        chance: (N,) the same of a motion of the same frequencies and limits with the middling one
            of random coefficients.
        evaluations: Motions simulated.
        stop: Why the search ended.
    """

    planned: Moved
    shown: Shown
    others: tuple[Moved, ...]
    courses: Courses
    parameters: tuple[Parameter, ...]
    values: Array
    wanted: npt.NDArray[np.bool_]
    half_widths: Array
    chance: Array
    evaluations: int
    stop: str

    @property
    def loads(self) -> dict[str, float]:
        """The largest share of a limit that set-points or simulated machine take, by quantity."""
        return largest(self.courses.limits, self.planned, self.shown.moved, *self.others)


def largest(limits: Limits, *motions: Moved) -> dict[str, float]:
    """Return the largest share of a limit that any drive takes in any of the motions."""
    out: dict[str, float] = {}
    for motion in motions:
        for name, rows in limits.loads(motion).items():
            out[name] = max(out.get(name, 0.0), float(rows.max()))
    return out


def excite(
    courses: Courses,
    sensitivity: Sensitivity,
    wish: Wish | None = None,
    *,
    on_progress: Callable[[Progress], None] | None = None,
) -> Excitation:
    """Return the motion that determines parameters best, within the limits of its courses.

    Args:
        courses: The motions to choose from.
        sensitivity: The machine at the parameters that are expected.
        wish: What is to be determined, and how to search.
        on_progress: Called now and then from this thread.

    Raises:
        IdentError: UNKNOWN_PARAMETER or INVALID_GOAL for a wish that cannot be met, DIVERGED where
            the machine runs away whatever it is asked to do.
    """
    wish = wish or Wish()
    wanted = _wanted(wish, sensitivity.parameters)
    one = replace(courses.series, periods=1, rest=_SHORT_REST)
    cost = _Cost(replace(courses, series=one), sensitivity, wanted, wish)
    dimension = cost.courses.dimension
    first: list[tuple[Array, Array]] = []

    def note(points: Array, costs: Array, _: npt.NDArray[np.bool_]) -> None:
        if not first:
            first.append((points.copy(), costs.copy()))

    with ThreadPoolExecutor(wish.threads) as pool:
        found = minimise(
            lambda points: np.array(list(pool.map(cost, points))),
            GeneticSearch(dimension, wish.settings, wish.seed),
            low=np.zeros(dimension),
            high=np.ones(dimension),
            budget=wish.budget,
            on_progress=on_progress,
            on_generation=note,
        )
    if not math.isfinite(found.cost):
        raise IdentError(
            ErrorCode.DIVERGED,
            'the simulation diverges in every motion that was tried; give other parameters with '
            '--set, or lower limits',
        )
    points, costs = first[0]
    middling = points[np.argsort(costs)[len(costs) // 2]]
    planned, shown, others = scaled(courses, sensitivity, found.theta)
    return Excitation(
        planned=planned,
        shown=shown,
        others=others,
        courses=courses,
        parameters=sensitivity.parameters,
        values=sensitivity.values,
        wanted=wanted,
        half_widths=sensitivity.half_widths(shown),
        chance=sensitivity.half_widths(scaled(courses, sensitivity, middling)[1]),
        evaluations=found.evaluations,
        stop=found.stop.value,
    )


def scaled(
    courses: Courses, sensitivity: Sensitivity, point: Array
) -> tuple[Moved, Shown, tuple[Moved, ...]]:
    """Return the largest motion of a point that keeps to the limits when it is simulated, too.

    Returns:
        The set-points, what they show, and what the machine makes of them where its parameters are
        other ones (`Sensitivity.elsewhere`).
    """
    share = 1.0
    for _ in range(_ROUNDS):
        planned = courses.motion(point, share)
        shown, others = sensitivity.of(planned), sensitivity.elsewhere(planned)
        load = max(largest(courses.limits, planned, shown.moved, *others).values())
        if load <= 1.0:
            break
        share *= _BELOW / load
    return planned, shown, others


@dataclass(frozen=True, eq=False)
class _Cost:
    """How badly a motion determines the parameters: the logarithm of a variance."""

    courses: Courses
    sensitivity: Sensitivity
    wanted: npt.NDArray[np.bool_]
    wish: Wish

    def __call__(self, point: Array) -> float:
        try:
            planned = self.courses.motion(point)
            shown = self.sensitivity.of(planned)
        except IdentError:
            return math.inf
        covariance = shown.covariance[np.ix_(self.wanted, self.wanted)]
        if self.wish.criterion == 'd':
            told = float(np.linalg.slogdet(covariance)[1]) / len(covariance)
        else:
            told = math.log(float(np.diag(covariance).max()))
        # Scaling the motion down to its limits would cost as much information.
        over = max(largest(self.courses.limits, planned, shown.moved).values())
        return told + 2.0 * math.log(max(over, 1.0))


def _wanted(wish: Wish, parameters: Sequence[Parameter]) -> npt.NDArray[np.bool_]:
    """Return (N,) which parameters are meant.

    Raises:
        IdentError: INVALID_GOAL for an unknown criterion, UNKNOWN_PARAMETER for a strange name.
    """
    if wish.criterion not in ('d', 'worst'):
        raise IdentError(
            ErrorCode.INVALID_GOAL, f'no criterion is called {wish.criterion}; use d or worst'
        )
    names = [{p.name, p.name.rpartition('.')[2]} for p in parameters]
    for name in wish.names:
        if not any(name in both for both in names):
            raise IdentError(
                ErrorCode.UNKNOWN_PARAMETER,
                f'{name!r} is no parameter that is looked for; choose from '
                f'{", ".join(p.name for p in parameters)}',
            )
    return np.array([not wish.names or not both.isdisjoint(wish.names) for both in names])
