# SPDX-License-Identifier: Apache-2.0
"""Local refinement: bounded least squares on the residual vector from several starts.

Of fits that the data cannot tell apart it ends at the most probable one, given the box.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
import enum
import math
from typing import Any

import numpy as np

from ros2_ident.arrays import Array
from ros2_ident.errors import ErrorCode
from ros2_ident.search.evaluators import Cancel
from ros2_ident.search.jacobian import Box, finite_differences, Known, Residuals
from ros2_ident.search.journal import digest_of, Journal, Within
from ros2_ident.search.least_squares import descent, Point


class RefineStatus(enum.Enum):
    """How a refinement ended; the value is the sentence for the user."""

    CONVERGED = 'The refinement converged.'
    EVALUATIONS = 'The refinement spent its evaluations before it converged; allow more of them.'
    DIVERGED = (
        'The simulation diverges at the start of the refinement; start it from a better candidate.'
    )
    CANCELLED = 'The refinement was cancelled; the result is the best found until then.'


@dataclass(frozen=True)
class StartOutcome:
    """Result of one start.

    Attributes:
        start: (N,) where it began, physical units.
        theta: (N,) where it ended.
        cost: RMS of the residual vector there, inf where the start diverged.
        evaluations: Candidates it took.
        status: How it ended.
    """

    start: Array
    theta: Array
    cost: float
    evaluations: int
    status: RefineStatus


@dataclass(frozen=True)
class Refinement:
    """The best of all starts.

    Attributes:
        theta: (N,) parameters, physical units; NaN where every start diverged.
        cost: RMS of the residual vector, its unit; inf where every start diverged.
        residual: (R,) residual vector at theta; empty where every start diverged.
        jacobian: (R, N) its derivative by theta, by central differences.
        evaluations: Candidates of all starts and of the final Jacobian.
        status: How the best start ended; CANCELLED where a cancel kept others from it.
        starts: What became of each start, in their order.
    """

    theta: Array
    cost: float
    residual: Array
    jacobian: Array
    evaluations: int
    status: RefineStatus
    starts: tuple[StartOutcome, ...]


class _Stop(Exception):
    """Leaves the iterations where no further candidate may be evaluated."""

    def __init__(self, status: RefineStatus) -> None:
        super().__init__()
        self.status = status


@dataclass(eq=False)
class _Start:
    """One start: counts, remembers the best point, asks for permission before each call."""

    residuals: Residuals
    box: Box
    unit: Array
    limit: int
    cancel: Cancel | None
    journal: Journal = field(default_factory=Journal)
    key: bytes = b''
    evaluations: int = 0

    def __post_init__(self) -> None:
        self.best = Point(self.evaluate, self.box, self.unit, np.full(1, math.inf), step=None)

    @property
    def cost(self) -> float:
        """RMS of the residual at the best point, inf for none."""
        return math.sqrt(self.best.loss)

    @property
    def improbability(self) -> float:
        """Minus twice the logarithm of the posterior there, but for a constant; inf for none."""
        best = self.best
        return best.residual.size * math.log(max(best.loss, 1e-300)) + self.box.aside(best.unit)

    def evaluate(self, theta: Array) -> Array:
        """Return (S, R) residuals of (S, N) physical candidates."""
        if self.cancel is not None and self.cancel.is_set():
            raise _Stop(RefineStatus.CANCELLED)
        if self.evaluations + len(theta) > self.limit:
            raise _Stop(RefineStatus.EVALUATIONS)
        self.evaluations += len(theta)
        return self._checked(theta)

    def _checked(self, theta: Array) -> Array:
        """Evaluate residuals (S, R); refuse a wrong shape or NaN."""
        told = np.ascontiguousarray(self.residuals(theta), dtype=np.float64)
        if told.ndim != 2 or len(told) != len(theta):
            raise ErrorCode.BAD_VALUES.error(
                f'residuals returned the shape {told.shape} for {len(theta)} candidates; '
                'it has to return one row for each'
            )
        if np.isnan(told).any():
            raise ErrorCode.BAD_VALUES.error(
                'residuals returned NaN; leave out samples that were not measured, '
                'and return inf for a diverged candidate'
            )
        return told

    def solve(self, tolerance: float) -> RefineStatus:
        """Go from the start to the end, or to where an earlier run of the same start ended."""
        what = 'start', self.key, self.unit, self.limit, tolerance
        ways: list[RefineStatus] = [x for x in RefineStatus if x is not RefineStatus.CANCELLED]
        wanted = {
            'point': Within(self.unit.shape, 0.0, 1.0),
            'cost': Within((), 0.0),
            'evaluations': Within((), 0, self.limit, int),
            'status': Within((), 0, len(ways) - 1, int),
        }
        kept = self.journal.get(wanted, *what)
        if kept is not None:
            residual = self._checked(self.box.physical(kept['point'])[None])[0]
            ended = replace(self.best, unit=kept['point'], residual=residual)
            if math.sqrt(ended.loss) == kept['cost']:
                self.best, self.evaluations = ended, kept['evaluations']
                return ways[int(kept['status'])]
        status = self._solve(tolerance)
        if status is not RefineStatus.CANCELLED:
            ends = {'point': self.best.unit, 'cost': self.cost, 'evaluations': self.evaluations}
            self.journal.put({**ends, 'status': ways.index(status)}, *what)
        return status

    def _solve(self, tolerance: float) -> RefineStatus:
        """Go to the most probable point."""
        try:
            (self.best,) = self.best.moved(self.unit[None])
            if not math.isfinite(self.cost):
                return RefineStatus.DIVERGED
            for better in descent(self.best, tolerance, prior=True):
                self.best = better
        except _Stop as stop:
            return stop.status
        return RefineStatus.CONVERGED


def refine(
    residuals: Callable[[Array], Array],
    starts: Any,
    low: Any,
    high: Any,
    *,
    cancel: Cancel | None = None,
    max_evaluations: int = 400,
    total_evaluations: int | None = None,
    tolerance: float = 1e-10,
    good_enough: float = 0.0,
    journal: Journal | None = None,
    key: str = '',
    known: Known | None = None,
) -> Refinement:
    """Refine several candidates and keep the most probable.

    Args:
        residuals: (S, N) in physical units -> (S, R); a diverged candidate's row is inf.
        starts: (B, N) candidates, the best first; copies are started once.
        low: (N,) lower bounds, physical units.
        high: (N,) upper bounds, physical units.
        cancel: Looked at before every call of `residuals`.
        max_evaluations: Candidates for each start.
        total_evaluations: Candidates for all starts and the final Jacobian; None for no limit.
        tolerance: Relative change of cost or parameters that counts as converged.
        good_enough: RMS of the residual below which the remaining starts are left out.
        journal: Gets the end of every start; what an earlier run has put there is not worked out
            again.
        key: Of the residuals, to tell them apart from others in the journal.
        known: As of `Box`.

    Returns:
        The best of all starts.

    Raises:
        IdentError: BAD_VALUES where starts, bounds or residuals are unusable.
    """
    box = Box.of(low, high, known)
    first = np.atleast_2d(np.array(starts, dtype=np.float64))
    if first.size == 0 or first.shape[1] != len(box.low) or not np.isfinite(first).all():
        raise ErrorCode.BAD_VALUES.error(
            f'the starts have the shape {first.shape}; give at least one row of '
            f'{len(box.low)} finite parameters'
        )
    outcomes: list[StartOutcome] = []
    best: _Start | None = None
    status = RefineStatus.DIVERGED
    left = math.inf if total_evaluations is None else total_evaluations - 2 * len(box.low)
    _, kept = np.unique(first, axis=0, return_index=True)
    for row in first[np.sort(kept)]:
        limit = int(min(max_evaluations, left))
        key_of = digest_of(key, low, high)
        start = _Start(
            residuals, box, box.inside(row), limit, cancel, journal or Journal(), key_of
        )
        ended = start.solve(tolerance)
        outcomes.append(StartOutcome(row, start.best.theta, start.cost, start.evaluations, ended))
        if best is None or start.improbability < best.improbability:
            best, status = start, ended
        if ended is RefineStatus.CANCELLED:
            status = ended
            break
        left -= start.evaluations
        if best.cost < good_enough or left < 1:
            break
    assert best is not None
    theta, residual = np.full(len(box.low), math.nan), np.empty(0)
    jacobian = np.empty((0, len(box.low)))
    evaluations = sum(outcome.evaluations for outcome in outcomes)
    if math.isfinite(best.cost):
        theta, residual = best.best.theta, best.best.residual
        # It belongs to the answer even after a cancel: one more batch, then it is over.
        counted = _Start(residuals, box, best.best.unit, 10**9, None)
        jacobian = finite_differences(
            counted.evaluate, best.best.unit, residual, box, central=True
        )
        jacobian /= box.width
        evaluations += counted.evaluations
    return Refinement(theta, best.cost, residual, jacobian, evaluations, status, tuple(outcomes))
