# SPDX-License-Identifier: Apache-2.0
"""Finite differences of a residual vector, all columns in one batch."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from ros2_ident.arrays import Array
from ros2_ident.errors import ErrorCode
from ros2_ident.search.operators import Index

Residuals = Callable[[Array], Array]

# Fractions of a parameter's scale. Forward: sqrt(eps) with room for a simulation's own rounding;
# central: the cube root of eps.
FORWARD_STEP = 1e-7
CENTRAL_STEP = 1e-5
LARGEST_STEP = 1e-3
# Part of the box where a simulation that sticks and slips is smooth on average only.
COARSE_STEP = 1e-4
# A step over which what is linear is compared, for the least of the columns, and the most by which
# those of large ones are smaller: rounding is then below 1e-8 of each. What is no line is off by
# the step's own size.
_LINE_STEP, _LINE_RATIO, _LINE_ERROR = 1e-3, 1e-4, 1e-6
# A residual beyond this, in its own unit, is on its way to infinity: its square would overflow.
DIVERGED = 1e100


def diverged(values: Array) -> npt.NDArray[np.bool_]:
    """Return whether residual vectors (..., R) are of no use: not finite, or too large."""
    return np.asarray(~(np.abs(values) < DIVERGED).all(axis=-1))


def mean_squares(rows: Array) -> Array:
    """Return the mean square of each residual vector (S, R); inf where it diverged."""
    there = ~diverged(rows)
    out = np.full(len(rows), np.inf)
    out[there] = np.mean(rows[there] ** 2, axis=1)
    return out


@dataclass(frozen=True)
class Known:
    """Normal distribution that is known of shares of a box beforehand.

    Attributes:
        rows: (L, N) of which the products with a deviation from the mean are of size 1.
        mean: (N,) mean.
    """

    rows: Array
    mean: Array

    def residual(self, unit: Array) -> Array:
        """Return (L,) by how many standard deviations shares (N,) of the box are off."""
        return np.asarray(self.rows @ (unit - self.mean))


@dataclass(frozen=True)
class Box:
    """The box of the search.

    Attributes:
        low: (N,) lower bounds, physical units.
        width: (N,) upper less lower bounds.
        known: What is known of the parameters beside it; None for nothing.
    """

    low: Array
    width: Array
    known: Known | None = None

    @classmethod
    def of(cls, low: Any, high: Any, known: Known | None = None) -> 'Box':
        """Return the box between two corners, or refuse them."""
        bottom = np.atleast_1d(np.array(low, dtype=np.float64))
        top = np.atleast_1d(np.array(high, dtype=np.float64))
        if bottom.shape != top.shape or bottom.ndim != 1:
            raise ErrorCode.BAD_VALUES.error('the bounds have to be two lists of finite numbers')
        if not ((-np.inf < bottom) & (bottom < top) & (top < np.inf)).all():
            raise ErrorCode.BAD_VALUES.error(
                'every lower bound has to be finite and below its finite upper bound; correct the '
                'box'
            )
        return cls(bottom, top - bottom, known)

    def aside(self, unit: Array) -> float:
        """Return minus twice the logarithm of what else is known of a point, but for a constant.

        Args:
            unit: (N,) shares of the box.
        """
        off = np.empty(0) if self.known is None else self.known.residual(unit)
        return float(off @ off)

    def wider(self, low: float, high: float) -> 'Box':
        """Return it with a parameter more, of which nothing else is known."""
        known = self.known
        if known is not None:
            known = Known(np.pad(known.rows, ((0, 0), (0, 1))), np.append(known.mean, 0.5))
        ends = np.append(self.low, low), np.append(self.low + self.width, high)
        return Box.of(*ends, known)

    def physical(self, unit: Array) -> Array:
        """Return points (..., N) of the unit cube in physical units."""
        return self.low + unit * self.width

    def inside(self, theta: Array) -> Array:
        """Return physical points (..., N) in the unit cube, clipped to it."""
        return np.clip((theta - self.low) / self.width, 0.0, 1.0)


def finite_differences(
    residuals: Residuals,
    unit: Array,
    residual: Array,
    box: Box,
    *,
    central: bool = False,
    step: float | None = None,
    columns: Index | None = None,
) -> Array:
    """Return the derivative of a residual vector by the cube's coordinates.

    A step that would leave the box goes the other way (forward), or shrinks to a one-sided
    difference (central). One that is not stated follows the parameter's size, and a column whose
    change drowns in rounding is repeated with a thousandfold step. A column whose neighbours
    diverge on both sides is zero.

    Args:
        residuals: (S, N) physical -> (S, R), inf for a diverged candidate.
        unit: (N,) point in the unit cube.
        residual: (R,) residuals there, finite.
        central: Central differences instead of forward ones.
        step: Part of the box.
        columns: Coordinates that it is wanted of; all where None. The others are zero.

    Returns:
        (R, N) finite.
    """
    # A parameter's scale is its magnitude, at least a thousandth and at most the whole of its box:
    # a stiffness of 1e2 in a box up to 3e5 gets a step that is small for 1e2.
    scales = np.clip(np.abs(box.physical(unit)) / box.width, 1e-3, 1.0)
    width = (CENTRAL_STEP if central else FORWARD_STEP) * scales
    if step is not None:
        width = np.full(len(unit), step)
    columns = np.arange(len(unit)) if columns is None else columns
    jacobian = np.zeros((residual.size, len(unit)))
    scale = float(np.abs(residual).max(initial=0.0))
    while columns.size:
        change, found = _differences(residuals, unit, residual, box, width, columns, central)
        jacobian[:, columns] = found
        # Rounding of the residual is at least eps times its size; the change has to stand well
        # above.
        drowned = (change > 0.0) & (change < 1e4 * np.finfo(np.float64).eps * scale)
        drowned &= width[columns] * 1e3 <= LARGEST_STEP
        columns = columns[drowned]
        width[columns] *= 1e3
    return jacobian


class Slopes(NamedTuple):
    """Derivative of a residual vector by shares of a box, at a point.

    Attributes:
        columns: (R, N) the derivative.
        lasting: (N,) whether a column is the same at other points, as far as was seen.
    """

    columns: Array
    lasting: npt.NDArray[np.bool_]


def slopes_near(
    residuals: Residuals, unit: Array, residual: Array, box: Box, step: float | None, near: Slopes
) -> Slopes:
    """Return the derivative at a point, with columns of another point where these hold.

    Where the residual is linear in most parameters, one candidate in place of one for each tells
    that it is: off in all of them, by random parts. A product is checked so without being made:
    Freivalds, IFIP Congress 1977.

    Args:
        residuals: As of `finite_differences`, and so are the point, its box and the step.
        near: That of the other point, of the first of the parameters; the rest are new.
    """
    lasting = np.pad(near.lasting, (0, len(unit) - len(near.lasting)))
    if _are_lines(residuals, unit, residual, box, near):
        found = finite_differences(
            residuals, unit, residual, box, step=step, columns=np.flatnonzero(~lasting)
        )
        found[:, lasting] = near.columns[:, near.lasting]
    else:
        found = finite_differences(residuals, unit, residual, box, step=step)
    before = near.columns
    same = found[:, : before.shape[1]]
    sizes = np.linalg.norm(before, axis=0)
    lasting[: len(sizes)] = np.linalg.norm(same - before, axis=0) <= _LINE_ERROR * sizes
    return Slopes(found, lasting)


def _are_lines(residuals: Residuals, unit: Array, residual: Array, box: Box, near: Slopes) -> bool:
    """Return whether the columns of another point that last hold at this one, all together."""
    at = np.flatnonzero(near.lasting)
    slopes = near.columns[:, at]
    sizes = np.linalg.norm(slopes, axis=0)
    if not sizes.any():
        return False
    least = sizes[sizes >= _LINE_RATIO * sizes.max()].min()
    by = _LINE_STEP * np.clip(least / np.maximum(sizes, least), _LINE_RATIO, 1.0)
    by *= np.random.default_rng(0).uniform(0.5, 1.0, by.size)
    by[unit[at] > 0.5] *= -1.0
    moved = unit.copy()
    moved[at] += by
    change = residuals(box.physical(moved)[None])[0] - residual
    return bool(np.linalg.norm(change - slopes @ by) <= _LINE_ERROR * np.linalg.norm(sizes * by))


def _differences(
    residuals: Residuals,
    unit: Array,
    residual: Array,
    box: Box,
    width: Array,
    columns: Index,
    central: bool,
) -> tuple[Array, Array]:
    """Return the largest change of each column (C,), and the columns (R, C)."""
    fits = (unit + width <= 1.0)[columns]
    ahead = np.where(fits, width[columns], -width[columns])
    behind = np.zeros(len(columns))
    if central:
        behind[fits & ((unit - width)[columns] >= 0.0)] = -1.0
        behind *= width[columns]
    # One batch for all: the point itself stands where there is no second side.
    two_sided = np.flatnonzero(behind)
    moved = _moved(
        residuals,
        unit,
        box,
        np.concatenate((columns, columns[two_sided])),
        np.concatenate((ahead, behind[two_sided])),
    )
    first = moved[: len(columns)]
    second = np.tile(residual, (len(columns), 1))
    second[two_sided] = moved[len(columns) :]
    lost = np.flatnonzero(diverged(first) & (behind == 0.0))
    if lost.size:
        # Diverged on the only side: try the other one.
        ahead[lost] *= -1.0
        first[lost] = _moved(residuals, unit, box, columns[lost], ahead[lost])
    first_ok, second_ok = ~diverged(first), ~diverged(second)
    first[~first_ok] = residual
    second[~second_ok] = residual
    span = np.where(first_ok, ahead, 0.0) - np.where(second_ok, behind, 0.0)
    difference = first - second
    change = np.abs(difference).max(axis=1, initial=0.0)
    slope = difference / np.where(span == 0.0, 1.0, span)[:, None]
    return change, slope.T


def _moved(residuals: Residuals, unit: Array, box: Box, columns: Index, by: Array) -> Array:
    """Return (C, R) residuals with one coordinate moved in each row."""
    points = np.repeat(unit[None, :], len(columns), axis=0)
    points[np.arange(len(columns)), columns] = np.clip(unit[columns] + by, 0.0, 1.0)
    return np.array(residuals(box.physical(points)), dtype=np.float64)
