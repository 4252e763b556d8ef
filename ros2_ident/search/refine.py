# SPDX-License-Identifier: Apache-2.0
"""Local refinement: bounded least squares on the residual vector from several starts.

Of fits that the data cannot tell apart it ends at the most probable one, given the box.

Reference:
    Levenberg 1944; Marquardt 1963.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
import enum
import math
from typing import Any

import numpy as np
from scipy.optimize import lsq_linear

from ros2_ident.arrays import Array
from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.search.evaluators import Cancel
from ros2_ident.search.jacobian import Box, finite_differences, Residuals
from ros2_ident.search.journal import digest_of, Journal, Within

# A step of Gauss and Newton is taken where it gains this share of what a linear model would.
_AS_FORESEEN = 0.5
# Gains of twice the logarithm of the posterior below this are lost in finite differences.
_RESOLVED = 1e-3
# Damping factors tried together where it is not, relative to the last one that helped; the first
# and the least of these, and the one beyond which nothing helps.
_LADDER = np.array([1e-3, 1e-2, 0.1, 0.3, 1.0, 3.0, 30.0, 1e3])
_FIRST_DAMPING, _LEAST_DAMPING, _MOST_DAMPING = 1e-2, 1e-9, 1e6
# What may be anywhere between 0 and 1 has this standard deviation about one half.
BOX_DEVIATION = math.sqrt(1.0 / 12.0)


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


def _rms(residual: Array) -> float:
    return float(np.sqrt(np.mean(residual**2)))


class _Stop(Exception):
    """Leaves the iterations where no further candidate may be evaluated."""

    def __init__(self, status: RefineStatus) -> None:
        super().__init__()
        self.status = status


@dataclass(eq=False)
class _Start:
    """One start: counts, remembers the best point, asks for permission before each call.

    Least squares with what a box tells before, a normal prior with its mean and variance.
    Parameters are shares of their box. What the data determine hardly feels it; what they leave
    open stays in the middle. The residual at the best point is taken as white noise.

    Reference:
        Maximum a posteriori: Gelman et al. (2013), Bayesian Data Analysis, section 13.1.
    """

    residuals: Residuals
    box: Box
    point: Array
    limit: int
    cancel: Cancel | None
    journal: Journal = field(default_factory=Journal)
    key: bytes = b''
    evaluations: int = 0
    cost: float = math.inf
    residual: Array = field(default_factory=lambda: np.empty(0))
    certainty: float = 0.0

    def evaluate(self, theta: Array) -> Array:
        """Return (S, R) residuals of (S, N) physical candidates."""
        if self.cancel is not None and self.cancel.is_set():
            raise _Stop(RefineStatus.CANCELLED)
        if self.evaluations + len(theta) > self.limit:
            raise _Stop(RefineStatus.EVALUATIONS)
        self.evaluations += len(theta)
        return self._told(theta)

    def _told(self, theta: Array) -> Array:
        """Evaluate residuals (S, R); refuse a wrong shape or NaN."""
        told = np.ascontiguousarray(self.residuals(theta), dtype=np.float64)
        if told.ndim != 2 or len(told) != len(theta):
            raise IdentError(
                ErrorCode.BAD_VALUES,
                f'residuals returned the shape {told.shape} for {len(theta)} candidates; '
                'it has to return one row for each',
            )
        if np.isnan(told).any():
            raise IdentError(
                ErrorCode.BAD_VALUES,
                'residuals returned NaN; leave out samples that were not measured, '
                'and return inf for a diverged candidate',
            )
        return told

    def loss(self, unit: Array, residual: Array) -> float:
        """Return minus twice the logarithm of the posterior, but for a constant."""
        aside = (unit - 0.5) / BOX_DEVIATION
        return self.certainty * float(residual @ residual) + float(aside @ aside)

    def least(self, jacobian: Array, damping: float = 0.0) -> tuple[Array, float]:
        """Return the (N,) parameters of the least loss by a (R, N) Jacobian, and that loss.

        Damping holds them where they are, by a share of the columns' squares.
        """
        unit = self.point
        both = math.sqrt(self.certainty) * np.column_stack([jacobian, -self.residual])
        # The triangular factor has the minimum of the whole.
        triangle = np.asarray(np.linalg.qr(both, mode='r'))
        rows = [triangle[:, :-1], np.eye(unit.size) / BOX_DEVIATION]
        wanted = [triangle[:, -1], (0.5 - unit) / BOX_DEVIATION]
        if damping:
            rows.append(np.diag(math.sqrt(damping) * np.linalg.norm(rows[0], axis=0)))
            wanted.append(np.zeros(unit.size))
        found = lsq_linear(
            np.concatenate(rows),
            np.concatenate(wanted),
            (-unit - 1e-15, 1.0 - unit + 1e-15),
            method='bvls',
        )
        return np.clip(unit + found.x, 0.0, 1.0), 2.0 * float(found.cost)

    def jac(self) -> Array:
        """Return (R, N) the derivative at the best point by the cube's coordinates."""
        return finite_differences(self.evaluate, self.point, self.residual, self.box)

    def solve(self, tolerance: float) -> RefineStatus:
        """Go from the start to the end, or to where an earlier run of the same start ended."""
        what = 'start', self.key, self.point, self.limit, tolerance
        ways: list[RefineStatus] = [x for x in RefineStatus if x is not RefineStatus.CANCELLED]
        wanted = {
            'point': Within(self.point.shape, 0.0, 1.0),
            'cost': Within((), 0.0),
            'evaluations': Within((), 0, self.limit, int),
            'status': Within((), 0, len(ways) - 1, int),
        }
        kept = self.journal.get(wanted, *what)
        if kept is not None and self._stands(kept['point'], kept['cost']):
            self.evaluations = kept['evaluations']
            return ways[int(kept['status'])]
        status = self._solve(tolerance)
        if status is not RefineStatus.CANCELLED:
            ended = {'cost': self.cost, 'evaluations': self.evaluations}
            self.journal.put({'point': self.point, **ended, 'status': ways.index(status)}, *what)
        return status

    def _stands(self, point: Array, cost: float) -> bool:
        """Take a point up where its cost comes out again; return whether it does."""
        residual = self._told(self.box.physical(point)[None, :])[0]
        if _rms(residual) != cost:
            return False
        self.point, self.cost, self.residual = point, cost, residual
        return True

    def _solve(self, tolerance: float) -> RefineStatus:
        """Go to the most probable point: by Gauss and Newton, damped where that fails."""
        try:
            self._keep(self.point, self.evaluate(self.box.physical(self.point)[None])[0])
            if not np.isfinite(self.residual).all():
                return RefineStatus.DIVERGED
            damping: float = _FIRST_DAMPING
            jacobian: Array | None = None
            while self.cost > 0.0 and damping <= _MOST_DAMPING:
                jacobian = self.jac() if jacobian is None else jacobian
                # What a square of the residual counts, one over its unit squared.
                self.certainty = len(self.residual) / float(self.residual @ self.residual)
                loss = self.loss(self.point, self.residual)
                there, least = self.least(jacobian)
                if loss - least <= tolerance * loss:
                    break
                now = self.evaluate(self.box.physical(there)[None])[0]
                if loss - self.loss(there, now) > _AS_FORESEEN * (loss - least):
                    # The most probable point may leave a little more than the best fit.
                    self._keep(there, now)
                    jacobian = None
                    continue
                if loss - least <= _RESOLVED:
                    if _rms(now) < self.cost:
                        self._keep(there, now)
                    break
                # So many candidates at once take the time of one.
                tried = [self.least(jacobian, factor)[0] for factor in _LADDER * damping]
                values = self.evaluate(self.box.physical(np.array(tried)))
                losses = [self.loss(*one) for one in zip(tried, values, strict=True)]
                best = int(np.argmin(losses))
                if not losses[best] < loss:
                    damping *= 1e4
                    continue
                damping = max(_LEAST_DAMPING, float(damping * _LADDER[best]))
                self._keep(tried[best], values[best])
                jacobian = None
                if loss - losses[best] <= tolerance * loss:
                    break
        except _Stop as stop:
            return stop.status
        return RefineStatus.CONVERGED

    def _keep(self, unit: Array, residual: Array) -> None:
        """Take a point for the best."""
        self.cost = _rms(residual)
        self.point, self.residual = unit.copy(), residual


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
) -> Refinement:
    """Refine several candidates and keep the best.

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

    Returns:
        The best of all starts.

    Raises:
        IdentError: BAD_VALUES where starts, bounds or residuals are unusable.
    """
    box = Box.of(low, high)
    first = np.atleast_2d(np.array(starts, dtype=np.float64))
    if first.size == 0 or first.shape[1] != len(box.low) or not np.isfinite(first).all():
        raise IdentError(
            ErrorCode.BAD_VALUES,
            f'the starts have the shape {first.shape}; give at least one row of '
            f'{len(box.low)} finite parameters',
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
        theta = box.physical(start.point)
        outcomes.append(StartOutcome(row, theta, start.cost, start.evaluations, ended))
        if best is None or start.cost < best.cost:
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
        theta, residual = box.physical(best.point), best.residual
        # It belongs to the answer even after a cancel: one more batch, then it is over.
        counted = _Start(residuals, box, best.point, 10**9, None)
        jacobian = finite_differences(counted.evaluate, best.point, residual, box, central=True)
        jacobian /= box.width
        evaluations += counted.evaluations
    return Refinement(theta, best.cost, residual, jacobian, evaluations, status, tuple(outcomes))
