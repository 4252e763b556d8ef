# SPDX-License-Identifier: Apache-2.0
"""Bounded least squares: Gauss and Newton's steps, damped where they gain less than foreseen.

Reference:
    Levenberg 1944; Marquardt 1963. Bounds: Stark and Parker, Computational Statistics 10, 1995.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property
from itertools import islice
import math

import numpy as np
import scipy

from ros2_ident.arrays import Array
from ros2_ident.search.jacobian import (
    Box,
    COARSE_STEP,
    diverged,
    finite_differences,
    Known,
    mean_squares,
    Residuals,
    Slopes,
    slopes_near,
)

# A step of Gauss and Newton is taken where it gains this share of what a linear model would.
_AS_FORESEEN = 0.5
# Gains of twice the logarithm of the posterior below this are lost in finite differences.
_RESOLVED = 1e-3
# Damping factors tried together where it is not, relative to the last one that helped (a batch of
# eight takes little longer than one); the first and the least of these, and the one beyond which
# nothing helps.
_LADDER = np.array([1e-3, 1e-2, 0.1, 0.3, 1.0, 3.0, 30.0, 1e3])
_FIRST_DAMPING, _LEAST_DAMPING, _MOST_DAMPING = 1e-2, 1e-9, 1e6
# What may be anywhere between 0 and 1 has this standard deviation about one half.
BOX_DEVIATION = math.sqrt(1.0 / 12.0)


@dataclass(eq=False)
class Point:
    """Point of a fit: its residual, and the Jacobian once it is asked for.

    Attributes:
        residuals: (S, N) physical -> (S, R), not finite for a diverged candidate.
        unit: (N,) parameters in shares of the box.
        residual: (R,) residual there.
        step: Step of the finite differences, see there.
        near: Slopes at another point, which may hold here: see `slopes_near`; None where the
            residual is linear in no parameter.
    """

    residuals: Residuals
    box: Box
    unit: Array
    residual: Array
    step: float | None = COARSE_STEP
    near: Slopes | None = None

    @classmethod
    def at(
        cls, residuals: Residuals, box: Box, unit: Array, near: Slopes | None = None
    ) -> 'Point':
        """Return the point at (N,) shares of the box."""
        return cls(residuals, box, unit, residuals(box.physical(unit)[None])[0], near=near)

    def moved(self, units: Array) -> list['Point']:
        """Return the points at (S, N) shares of the box, evaluated together."""
        pairs = zip(units, self.residuals(self.box.physical(units)), strict=True)
        near = None if self.near is None else self.slopes
        return [Point(self.residuals, self.box, *pair, self.step, near) for pair in pairs]

    @property
    def theta(self) -> Array:
        """(N,) parameters, physical units."""
        return self.box.physical(self.unit)

    @cached_property
    def loss(self) -> float:
        """Mean square of the residual, inf where it diverged."""
        return float(mean_squares(self.residual[None])[0])

    @cached_property
    def jacobian(self) -> Array:
        """(R, N) derivative of the residual by shares of the box; 0 where it diverged."""
        return self.slopes.columns

    @cached_property
    def slopes(self) -> Slopes:
        """The Jacobian, and what of it may hold elsewhere."""
        given = self.residuals, self.unit, self.residual, self.box
        none = np.zeros(self.unit.size, dtype=bool)
        if diverged(self.residual):
            return Slopes(np.zeros((self.residual.size, self.unit.size)), none)
        if self.near is None:
            return Slopes(finite_differences(*given, step=self.step), none)
        return slopes_near(*given, self.step, self.near)


def within_box(rows: Array, wanted: Array, unit: Array) -> tuple[Array, float]:
    """Return the (N,) shares of a box that a linear model leads to, and its least sum of squares.

    Args:
        rows: (M, N) of the model of a step.
        wanted: (M,) values that the step is to give.
        unit: (N,) shares of the box where it begins.
    """
    bounds = -unit - 1e-15, 1.0 - unit + 1e-15
    found = scipy.optimize.lsq_linear(rows, wanted, bounds, method='bvls')
    return np.clip(unit + found.x, 0.0, 1.0), 2.0 * float(found.cost)


class _Objective:
    """Objective of a fit, in units of what a point leaves, and its linear model there.

    With a prior it is minus twice the logarithm of the posterior, but for a constant: each
    parameter has the mean and the variance of its box. What the data determine hardly feels it;
    what they leave open stays in the middle. What else is known of the parameters counts in any
    case. The residual is taken as white noise.

    Reference:
        Maximum a posteriori: Gelman et al. (2013), Bayesian Data Analysis, section 13.1.
    """

    def __init__(self, point: Point, prior: bool) -> None:
        self.point, unit = point, point.unit
        # A square of the residual counts one over its unit squared.
        self.certainty = 1.0 / point.loss
        self.box = np.eye(unit.size if prior else 0, unit.size) / BOX_DEVIATION
        self.known = point.box.known or Known(np.empty((0, unit.size)), unit)
        rows = np.column_stack([point.jacobian, -point.residual])
        # The triangular factor has the minimum of the whole.
        self.triangle = np.asarray(np.linalg.qr(math.sqrt(self.certainty) * rows, mode='r'))

    def __call__(self, point: Point) -> float:
        """Return its value at a point."""
        aside = np.append(self.box @ (point.unit - 0.5), self.known.residual(point.unit))
        return self.certainty * point.loss * point.residual.size + float(aside @ aside)

    def least(self, damping: float = 0.0) -> tuple[Array, float]:
        """Return the (N,) shares of the box of the linear model's minimum, and its value.

        Damping holds them where they are, by a share of the columns' squares.
        """
        return within_box(*self._model(damping), self.point.unit)

    def tries(self, damping: float) -> list[Array]:
        """Return points (N,) worth a try: that minimum, and the way to it without a box, cut.

        Far from a minimum the cut step may lead into another valley, where the fit is better.
        """
        rows, wanted = self._model(damping)
        unit = self.point.unit
        push = -rows.T @ wanted
        free = ~(((unit <= 0.0) & (push > 0.0)) | ((unit >= 1.0) & (push < 0.0)))
        cut = unit.copy()
        cut[free] += np.linalg.lstsq(rows[:, free], wanted, rcond=None)[0]
        if ((cut >= 0.0) & (cut <= 1.0)).all():
            return [cut]
        return [np.clip(cut, 0.0, 1.0), within_box(rows, wanted, unit)[0]]

    def _model(self, damping: float) -> tuple[Array, Array]:
        """Return the rows (M, N) of a step's linear model, and what they are to give (M,)."""
        unit, slopes = self.point.unit, self.triangle[:, :-1]
        held = math.sqrt(damping) * np.diag(np.linalg.norm(slopes, axis=0))
        known = self.known
        wanted = [
            self.triangle[:, -1], self.box @ (0.5 - unit), -known.residual(unit),
            np.zeros(unit.size),
        ]  # fmt: skip
        return np.vstack([slopes, self.box, known.rows, held]), np.concatenate(wanted)


def descent(start: Point, tolerance: float, *, prior: bool = False) -> Iterator[Point]:
    """Yield ever better points until none is found.

    Args:
        start: Where it begins.
        tolerance: Relative decrease of the objective, by its linear model, that counts as none.
        prior: Whether parameters are as probable everywhere in their box before, see `_Objective`.
            Then steps of Gauss and Newton come first: it begins near the end.
    """
    point, damping = start, _FIRST_DAMPING
    while 0.0 < point.loss < math.inf:
        objective = _Objective(point, prior)
        now = objective(point)
        if prior:
            aim, least = objective.least()
            foreseen = now - least
            if foreseen <= tolerance * now:
                return
            (trial,) = point.moved(aim[None])
            gain = now - objective(trial)
            if gain > _AS_FORESEEN * foreseen:
                yield (point := trial)
                continue
            if foreseen <= _RESOLVED:
                if gain > 0.0:
                    yield trial
                return
        while damping <= _MOST_DAMPING:
            aims = [(x, factor) for factor in _LADDER for x in objective.tries(factor * damping)]
            trials = point.moved(np.array([x for x, _ in aims]))
            losses = [objective(x) for x in trials]
            best = int(np.argmin(losses))
            if losses[best] < now:
                break
            damping *= 1e4
        else:
            return
        damping = max(_LEAST_DAMPING, float(damping * aims[best][1]))
        yield (point := trials[best])
        if now - losses[best] <= tolerance * now:
            return


def least_squares(
    residuals: Residuals,
    start: Array,
    low: Array,
    high: Array,
    *,
    iterations: int = 12,
    tolerance: float = 1e-6,
    stopped: Callable[[], bool] = lambda: False,
    known: Known | None = None,
    near: Slopes | None = None,
) -> Point:
    """Minimise the mean square of a residual vector within a box.

    Args:
        residuals: (S, N) candidates to (S, R) residuals, not finite where one diverged.
        start: (N,) start.
        low: (N,) lower bounds.
        high: (N,) upper bounds.
        iterations: Most iterations.
        tolerance: As of `descent`.
        stopped: Asked once an iteration; ends the fit with the best so far.
        known: As of `Box`.
        near: As of `Point`.

    Returns:
        The best point found, never worse than the start.
    """
    box = Box.of(low, high, known)
    best = Point.at(residuals, box, box.inside(start), near)
    better = islice(descent(best, tolerance), iterations)
    while not stopped() and (point := next(better, None)):
        best = point
    return best
