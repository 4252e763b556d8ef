# SPDX-License-Identifier: Apache-2.0
"""How well the data fix each parameter: intervals and correlations."""

from collections.abc import Sequence
from dataclasses import dataclass
import math

import numpy as np
import scipy

from ros2_ident.arrays import Array
from ros2_ident.errors import ErrorCode
from ros2_ident.search.jacobian import Known
from ros2_ident.search.noise import fit_noise, NoiseModel, weighted_normal_matrix
from ros2_ident.search.operators import Flags

# Box-scaled columns smaller than this against the largest do not act on the data at all.
INSENSITIVE = 1e-9
# Unit-length columns whose smallest singular value is below this cannot be told apart.
COLLINEAR = 1e-6
# A parameter takes part in such a direction from this component on.
TAKES_PART = 1e-3
# Closer to a bound than this, in box widths, is at the bound.
AT_BOUND = 1e-6


@dataclass(frozen=True)
class Intervals:
    """Confidence of an estimate.

    Attributes:
        half_width: (N,) half widths of the confidence intervals, physical units; inf where the
            data do not fix the parameter at all.
        low: (N,) lower ends, theta - half_width; not clipped to the box.
        high: (N,) upper ends.
        correlation: (N, N) correlations of the estimates; NaN beside a parameter that is not
            fixed.
        at_bound: For each parameter '', 'lower' or 'upper'.
    """

    half_width: Array
    low: Array
    high: Array
    correlation: Array
    at_bound: tuple[str, ...]


def intervals(
    jacobian: Array,
    residual: Array,
    theta: Array,
    low: Array,
    high: Array,
    *,
    series: Sequence[int] | None = None,
    level: float = 0.95,
    known: Known | None = None,
) -> Intervals:
    """Return confidence intervals that allow for autocorrelated residuals.

    The estimate's covariance is (J'J)^-1 J'RJ (J'J)^-1, with R the residuals' covariance under an
    autoregressive model of each series whose order is chosen by BIC. At order 0, white noise, and
    one series it is the classical sigma^2 (J'J)^-1. Directions that the scaled Jacobian's singular
    value decomposition shows not to act on the data are left out, and their parameters' intervals
    are infinite.

    Args:
        jacobian: (R, N) derivative of the residual by theta, physical units, finite.
        residual: (R,) residual at theta, finite.
        theta: (N,) estimate.
        low: (N,) lower bounds of the box.
        high: (N,) upper bounds of the box.
        series: Lengths of the time series that follow one another in the residual vector, one for
            each output and segment; None for a single one.
        level: Probability that an interval covers the truth.
        known: What is known of shares of the box beforehand, as the fit counted it: rows more,
            with the mean square of the residual as their variance.

    Returns:
        The intervals.

    Raises:
        IdentError: NO_DATA where there are not more residuals than parameters.

    Reference:
        Seber and Wild (2003), Nonlinear Regression, sections 2.1 and 6.2; Newey and West (1987),
        Econometrica 55, for the sandwich.
    """
    count, dimension = jacobian.shape
    if count <= dimension:
        raise ErrorCode.NO_DATA.error(
            f'{count} residuals cannot tell the confidence of {dimension} parameters; '
            'record more samples'
        )
    width = np.asarray(high, dtype=np.float64) - np.asarray(low, dtype=np.float64)
    scaled = jacobian * width
    beforehand = np.empty((0, dimension)) if known is None else known.rows
    beforehand = beforehand * np.sqrt(np.mean(residual**2))
    inverse, loose, rank = _inverse(np.concatenate([scaled, beforehand]))
    # J'RJ over all series; the factor makes up for the degrees of freedom that the fit took.
    freedom = count / (count - rank)
    models: list[NoiseModel] = []
    middle = np.mean(residual**2) * beforehand.T @ beforehand
    start = 0
    for length in (count,) if series is None else filter(None, series):
        part = slice(start, start + length)
        model = fit_noise(residual[part])
        middle += freedom * weighted_normal_matrix(scaled[part], model)
        models.append(model)
        start += length
    covariance = inverse @ middle @ inverse
    effective = sum(m.effective_samples for m in models)
    quantile = float(scipy.special.stdtrit(max(effective - rank, 1.0), 0.5 + 0.5 * level))
    error = np.sqrt(np.maximum(np.diag(covariance), 0.0)) * width
    error[loose] = math.inf
    half = quantile * error
    return Intervals(
        half_width=half,
        low=theta - half,
        high=theta + half,
        correlation=_correlation(covariance if covariance.any() else inverse, loose),
        at_bound=tuple(
            'lower' if p <= AT_BOUND else 'upper' if p >= 1.0 - AT_BOUND else ''
            for p in (theta - np.asarray(low)) / width
        ),
    )


def even_weights(residual: Array, series: Sequence[int], outputs: int) -> Array:
    """Return the (R,) weights by which each output's part of a residual (R,) is of one size.

    The largest is left as it is, and what is 0 throughout.

    Args:
        series: As of `intervals`, those of all outputs after each other, segment by segment.
        outputs: How many outputs there are.

    Reference:
        Seber and Wild (2003), Nonlinear Regression, section 2.8.
    """
    output = np.repeat(np.arange(len(series)) % outputs, series)
    count = np.bincount(output, minlength=outputs)
    sizes = np.sqrt(np.bincount(output, residual**2, outputs) / np.maximum(count, 1))
    weights: Array = np.divide(sizes.max(), sizes, np.ones(outputs), where=sizes > 0.0)
    return weights[output]


def _inverse(scaled: Array) -> tuple[Array, Flags, int]:
    """Return the pseudo-inverse of J'J, who is not fixed by the data (N,), and the rank."""
    dimension = scaled.shape[1]
    length = np.sqrt(np.einsum('rn,rn->n', scaled, scaled))
    deaf = length <= INSENSITIVE * length.max(initial=0.0)
    unit = np.where(deaf, 1.0, length)
    # Columns of equal length: a weak parameter is the noise's matter, only a twin is the rank's.
    # The triangular factor has the singular values of the whole.
    triangle = np.linalg.qr(np.where(deaf, 0.0, scaled / unit), mode='r')
    _, values, directions = np.linalg.svd(triangle, full_matrices=True)
    values = np.concatenate((values, np.zeros(dimension - len(values))))
    fixed = values > COLLINEAR * values.max(initial=0.0)
    loose = (np.abs(directions[~fixed]) > TAKES_PART).any(axis=0) | deaf
    kept = directions[fixed] / values[fixed][:, None]
    inverse = (kept.T @ kept) / np.outer(unit, unit)
    return inverse, loose, int(fixed.sum())


def _correlation(covariance: Array, loose: Flags) -> Array:
    error = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    known = ~loose & (error > 0.0)
    safe = np.where(known, error, 1.0)
    correlation: Array = np.clip(covariance / np.outer(safe, safe), -1.0, 1.0)
    correlation[~known, :] = math.nan
    correlation[:, ~known] = math.nan
    np.fill_diagonal(correlation, 1.0)
    return correlation
