# SPDX-License-Identifier: Apache-2.0
"""Weighted least squares in one step, for residuals that are linear in all parameters.

The inverse dynamic identification model of robotics (Gautier, Janot, Vandanjon, IEEE TCST 21(2),
2013): what the recorded motion asks is linear in inertias and friction. The motion comes filtered
from the model; here both sides pass the same low-pass, are decimated, and every output counts by
the noise that it leaves.
"""

from collections.abc import Callable
from functools import partial
import time

import numpy as np
import scipy

from ros2_ident.arrays import Array, rms
from ros2_ident.errors import ErrorCode
from ros2_ident.search.driver import SearchResult
from ros2_ident.search.fit import Fitted, Solvable
from ros2_ident.search.genetic import StopReason
from ros2_ident.search.jacobian import Known
from ros2_ident.search.uncertainty import even_weights, intervals

# Step to either side, in box widths, and what of it may be curved.
_STEP, _CURVED = 0.25, 1e-6
# What acts by less than this against the largest may as well be rounding errors.
_ACTS = 1e-7
# Rounds in which the weights follow the residuals.
_ROUNDS = 3
# What the data do not show stays in the middle of its box: by so much of a column's length.
_STAYS = 1e-9
# A series shorter than this many samples after decimation is left as it is.
_SHORT = 40


def solve(
    problem: Solvable, decimation: int = 10, level: float = 0.95, known: Known | None = None
) -> Fitted:
    """Fit a problem that is linear in its parameters.

    Of its box only this counts: what cannot be below zero there does not get there.

    Args:
        problem: What to fit.
        decimation: Samples of which one is kept, behind a low-pass without phase.
        level: Probability that an interval covers the truth.
        known: What is known of shares of the box beforehand.

    Returns:
        The estimate, `ga` holding it without a generation, with intervals.

    Raises:
        IdentError: INVALID_GOAL naming the parameters that do not act linearly, DIVERGED where
            the middle of the box cannot be simulated.
    """
    begin = time.monotonic()
    middle = 0.5 * (problem.low + problem.high)
    left, slopes = _rows(problem, middle)
    rows, series = _decimated(np.column_stack([left, slopes]), problem.series, decimation)
    kept, columns = rows[:, 0], rows[:, 1:]
    lowest = np.where(problem.low >= 0.0, 0.0, -np.inf)
    width = problem.high - problem.low
    beforehand = np.empty((0, len(middle) + 1))
    if known is not None:
        off = known.residual(np.full(len(middle), 0.5))
        beforehand = np.column_stack([known.rows / width, -off])
    weigh = partial(even_weights, series=series, outputs=problem.outputs)
    change, weights = _solved(kept, columns, weigh, lowest - middle, beforehand)
    theta = np.maximum(middle + change, lowest)
    residual = left + slopes @ change
    cost = problem.cost_of(residual)
    found = SearchResult(theta, cost, theta[None], np.array([cost]), 0, 0, (), StopReason.SOLVED)
    certain = intervals(
        columns * weights[:, None],
        (kept + columns @ change) * weights,
        theta,
        problem.low,
        problem.high,
        series=series,
        level=level,
        known=known,
    )
    return Fitted(
        ga=found,
        refined=None,
        theta=theta,
        residual=residual,
        intervals=certain,
        cancelled=False,
        left_out=False,
        evaluations=2 * len(theta) + 1,
        seconds=time.monotonic() - begin,
        candidates=np.empty((0, len(theta))),
        costs=np.empty(0),
        generations=np.empty(0, dtype=np.int64),
    )


def _rows(problem: Solvable, middle: Array) -> tuple[Array, Array]:
    """Return residual (R,) and slopes (R, N) in the middle, by a step to either side."""
    step = _STEP * (problem.high - problem.low)
    sides = np.concatenate([middle + np.diag(step), middle - np.diag(step), middle[None]])
    values = problem.residuals(sides)
    if not np.isfinite(values).all():
        raise ErrorCode.DIVERGED.error(
            'a candidate in the middle of the bounds diverges; narrow them in the machine file'
        )
    up, down, left = values[: len(step)], values[len(step) : -1], values[-1]
    curved = np.abs(up + down - 2.0 * left).max(axis=1)
    span = np.abs(up - down).max(axis=1)
    # What does not act leaves rounding errors, which are neither straight nor bent.
    acts = span > _ACTS * span.max()
    bent = acts & (curved > _CURVED * span)
    slopes = ((up - down) / (2.0 * step[:, None])).T * acts
    # Parameters that multiply each other are straight one by one, not together.
    together = problem.residuals((middle + step)[None])[0] - left - slopes @ step
    if bent.any() or np.abs(together).max() > _CURVED * np.abs(slopes * step).max():
        names = [n for n, b in zip(problem.names, bent, strict=True) if b]
        raise ErrorCode.INVALID_GOAL.error(
            f'{", ".join(names) or "some of the parameters multiply each other and"} '
            f'{"do" if len(names) != 1 else "does"} not act linearly on the effort; hold '
            'them with --fix NAME=VALUE, or leave out --method algebraic'
        )
    return left, slopes


def _decimated(rows: Array, series: tuple[int, ...], factor: int) -> tuple[Array, tuple[int, ...]]:
    """Return rows (R, C) through a low-pass without phase, one of `factor` kept, and lengths."""
    parts = []
    for part in np.split(rows, np.cumsum(series)[:-1]):
        long = factor > 1 and len(part) >= _SHORT * factor
        parts.append(scipy.signal.decimate(part, factor, axis=0) if long else part)
    return np.concatenate(parts), tuple(len(part) for part in parts)


def _solved(
    residual: Array,
    slopes: Array,
    weigh: Callable[[Array], Array],
    lowest: Array,
    beforehand: Array,
) -> tuple[Array, Array]:
    """Return the (N,) step from the middle, at least `lowest`, and the (R,) weights behind it.

    What is known beforehand are rows (L, N + 1) of steps and what they give, of noise 1.
    """
    weights = np.ones(len(residual))
    change, noise = np.zeros(slopes.shape[1]), 0.0
    for _ in range(_ROUNDS):
        weighted = slopes * weights[:, None]
        scale = np.linalg.norm(weighted, axis=0)
        scale[scale == 0.0] = 1.0
        # The triangular factor has the minimum of the whole.
        both = np.column_stack([weighted / scale, -residual * weights])
        triangle = np.asarray(np.linalg.qr(both, mode='r'))
        known = noise * beforehand
        columns = [triangle[:, :-1], known[:, :-1] / scale, _STAYS * np.eye(len(scale))]
        wanted = np.concatenate([triangle[:, -1], known[:, -1], np.zeros(len(scale))])
        bounds = lowest * scale, np.inf
        found = scipy.optimize.lsq_linear(np.vstack(columns), wanted, bounds, method='bvls')
        change = found.x / scale
        left = residual + slopes @ change
        weights = weigh(left)
        noise = rms(left * weights)
    return change, weights
