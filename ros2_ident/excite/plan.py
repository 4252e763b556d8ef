# SPDX-License-Identifier: Apache-2.0
"""The search for the motion that determines parameters best."""

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
import math
from typing import Literal

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
# Rounds in which a motion shrinks until its simulation keeps to the limits, and how far below.
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


@dataclass(frozen=True, eq=False)
class Excitation:
    """A motion and what it will tell.

    Attributes:
        loads: The largest share of a limit that set-points or machine take, by quantity; the
            machine with the parameters that are expected, and a quarter lower and higher.
        values: (N,) at which the information was worked out.
        wanted: (N,) which of them were to be determined.
        half_widths: (N,) half the 95 % intervals that a log will give at best.
        chance: (N,) the same of a motion of the same frequencies and limits with the middling one
            of random coefficients.
    """

    planned: Moved
    loads: Mapping[str, float]
    courses: Courses
    parameters: tuple[Parameter, ...]
    values: Array
    wanted: npt.NDArray[np.bool_]
    half_widths: Array
    chance: Array
    evaluations: int
    stop: str


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
    names: Sequence[str] = (),
    *,
    criterion: Literal['d', 'worst'] = 'd',
    seed: int = 0,
    settings: GeneticSettings = SEARCH,
    budget: Budget | None = None,
    threads: int = 1,
    on_progress: Callable[[Progress], None] | None = None,
) -> Excitation:
    """Return the motion that determines parameters best, within the limits of its courses.

    Args:
        names: Parameters to determine, all if empty; `gear_stiffness` is that of every drive.
        criterion: `d` for the smallest volume of their joint confidence region (D-optimality), the
            others unknown as well; `worst` for the smallest of the largest intervals, in widths of
            the boxes.

    Raises:
        IdentError: UNKNOWN_PARAMETER for a strange name, DIVERGED where the machine runs away
            whatever it is asked to do.
    """
    wanted = sensitivity.meant(names or [p.name for p in sensitivity.parameters])
    short = replace(courses, series=replace(courses.series, periods=1, rest=_SHORT_REST))
    dimension = short.dimension
    first: list[tuple[Array, Array]] = []

    def note(points: Array, costs: Array, _: npt.NDArray[np.bool_]) -> None:
        if not first:
            first.append((points.copy(), costs.copy()))

    def cost(point: Array) -> float:
        """Return how badly a motion determines the parameters: the logarithm of a variance."""
        try:
            planned = short.motion(point)
            shown = sensitivity.of(planned)
        except IdentError:
            return math.inf
        covariance = shown.covariance[np.ix_(wanted, wanted)]
        if criterion == 'd':
            told = float(np.linalg.slogdet(covariance)[1]) / len(covariance)
        else:
            told = math.log(float(np.diag(covariance).max()))
        # Scaling the motion down to its limits would cost as much information.
        over = max(largest(courses.limits, planned, shown.moved).values())
        return told + 2.0 * math.log(max(over, 1.0))

    with ThreadPoolExecutor(threads) as pool:
        found = minimise(
            lambda points: np.array(list(pool.map(cost, points))),
            GeneticSearch(dimension, settings, seed),
            low=np.zeros(dimension),
            high=np.ones(dimension),
            budget=budget or Budget(),
            on_progress=on_progress,
            on_generation=note,
        )
    if not math.isfinite(found.cost):
        raise ErrorCode.DIVERGED.error(
            'the simulation diverges in every motion that was tried; give other parameters with '
            '--set, or lower limits'
        )
    points, costs = first[0]
    middling = points[np.argsort(costs)[len(costs) // 2]]
    planned, shown, loads = scaled(courses, sensitivity, found.theta)
    return Excitation(
        planned=planned,
        loads=loads,
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
) -> tuple[Moved, Shown, dict[str, float]]:
    """Return the largest motion of a point that keeps to the limits when it is simulated, too.

    Returns:
        The set-points, what they show, and the largest shares of the limits that they and the
        machine take, also where its parameters are other ones (`Sensitivity.elsewhere`).
    """
    share = 1.0
    for _ in range(_ROUNDS):
        planned = courses.motion(point, share)
        shown, others = sensitivity.of(planned), sensitivity.elsewhere(planned)
        loads = largest(courses.limits, planned, shown.moved, *others)
        if max(loads.values()) <= 1.0:
            break
        share *= _BELOW / max(loads.values())
    return planned, shown, loads
