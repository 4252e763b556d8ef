# SPDX-License-Identifier: Apache-2.0
"""Levenberg-Marquardt for many small fits of one big simulation.

A batch of eight candidates costs what one costs, so each iteration tries eight damping factors at
once.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ros2_ident.arrays import Array

# Damping factors tried in one iteration, relative to the last one accepted.
_LADDER = np.array([1e-3, 1e-2, 0.1, 0.3, 1.0, 3.0, 30.0, 1e3])
_STEP = 1e-4
# A residual beyond this, in its own unit, is on its way to infinity: its square would overflow.
DIVERGED = 1e100


@dataclass(frozen=True)
class LocalFit:
    """Where a fit ended.

    Attributes:
        theta: (N,) parameters.
        unit: (N,) the same in shares of their box, from which residual and Jacobian follow.
        residual: (R,) weighted residual there.
        jacobian: (R, N) its derivative by the parameters in shares of their box.
        loss: Mean square of the residual.
    """

    theta: Array
    unit: Array
    residual: Array
    jacobian: Array
    loss: float


def difference_jacobian(
    evaluate: Callable[[Array], Array], unit: Array, low: Array, span: Array
) -> tuple[Array, Array]:
    """Return residual (R,) and forward-difference Jacobian (R, N) at a point of the unit cube.

    A column is zero where the neighbour diverges: it says nothing of the slope.
    """
    step = np.where(unit < 0.5, _STEP, -_STEP)
    points = np.vstack([unit, unit + np.diag(step)])
    values = evaluate(low + span * points)
    there = (np.abs(values[1:]) < DIVERGED).all(axis=1, keepdims=True)
    with np.errstate(invalid='ignore'):  # a base that diverges has no slope either
        changes = np.where(there, values[1:], values[0]) - values[0]
    return values[0], (changes / step[:, None]).T


def fit_at(evaluate: Callable[[Array], Array], unit: Array, low: Array, high: Array) -> LocalFit:
    """Return the fit that ends at (N,) shares of the box."""
    span = high - low
    residual, jacobian = difference_jacobian(evaluate, unit, low, span)
    loss = float(_losses(residual[None])[0])
    return LocalFit(low + span * unit, unit, residual, jacobian, loss)


def _losses(values: Array) -> Array:
    """Return (S,) mean squares of residuals (S, R); inf where one diverged or is about to."""
    there = (np.abs(values) < DIVERGED).all(axis=1)
    losses = np.full(len(values), np.inf)
    losses[there] = np.mean(values[there] ** 2, axis=1)
    return losses


def local_fit(
    evaluate: Callable[[Array], Array],
    start: Array,
    low: Array,
    high: Array,
    *,
    iterations: int = 12,
    tolerance: float = 1e-4,
    stopped: Callable[[], bool] | None = None,
) -> LocalFit:
    """Minimise the mean square of a weighted residual vector within a box.

    Args:
        evaluate: (S, N) candidates to (S, R) weighted residuals, inf where one diverged.
        start: (N,) start.
        low: (N,) lower bounds.
        high: (N,) upper bounds.
        iterations: Most iterations.
        tolerance: Relative decrease of the mean square below which the fit has converged.
        stopped: Asked once an iteration; ends the fit with the best so far.

    Returns:
        The best point found, never worse than the start.

    Reference:
        Levenberg 1944; Marquardt 1963; the bounds by projection and by freezing parameters that
        push outwards.
    """
    span = high - low
    at = fit_at(evaluate, np.clip((start - low) / span, 0.0, 1.0), low, high)
    damping = 1e-2
    for _ in range(iterations):
        if not np.isfinite(at.loss) or (stopped is not None and stopped()):
            break
        gradient, hessian = at.jacobian.T @ at.residual, at.jacobian.T @ at.jacobian
        free = ~(((at.unit <= 0.0) & (gradient > 0.0)) | ((at.unit >= 1.0) & (gradient < 0.0)))
        scale = np.maximum(np.diag(hessian), 1e-12 * np.diag(hessian).max() + 1e-300)
        trials = np.repeat(at.unit[None], len(_LADDER), axis=0)
        for i, factor in enumerate(_LADDER * damping):
            matrix = (hessian + np.diag(factor * scale))[np.ix_(free, free)]
            trials[i, free] -= np.linalg.lstsq(matrix, gradient[free], rcond=None)[0]
        np.clip(trials, 0.0, 1.0, out=trials)
        losses = _losses(evaluate(low + span * trials))
        best = int(np.argmin(losses))
        if not losses[best] < at.loss:
            if damping > 1e6:
                break
            damping *= 1e4
            continue
        damping = max(1e-9, damping * _LADDER[best])
        gain = (at.loss - losses[best]) / at.loss
        at = fit_at(evaluate, trials[best], low, high)
        if gain < tolerance:
            break
    return at
