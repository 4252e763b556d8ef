# SPDX-License-Identifier: Apache-2.0
"""A residual's autocorrelation as an autoregressive model, and what it does to least squares."""

from collections.abc import Sequence
from dataclasses import dataclass
import math

import numpy as np

from ros2_ident.arrays import Array

MOST_COEFFICIENTS = 20
# Points of a spectral density, for sums over it.
_SPECTRUM = 1 << 14


@dataclass(frozen=True)
class NoiseModel:
    """r_t = sum_k a_k r_(t-k) + e_t with white e.

    Attributes:
        coefficients: (p,) a_1..a_p; none for white noise.
        variance: Variance of r, its unit squared.
        innovation: Variance of e.
        samples: Length of the series.
    """

    coefficients: Array
    variance: float
    innovation: float
    samples: int

    @property
    def score(self) -> float:
        """BIC: minus twice the logarithm of the likelihood, and what its numbers cost."""
        if self.innovation <= 0.0:
            return -math.inf
        cost = (self.coefficients.size + 1) * math.log(max(self.samples, 1))
        return self.samples * math.log(self.innovation) + cost

    @property
    def effective_samples(self) -> float:
        """Samples of white noise whose mean would be as certain; at most those there are."""
        if self.variance <= 0.0:
            return float(self.samples)
        # Variance of the mean: spectral density at zero frequency over the number of samples.
        at_zero = self.innovation / (1.0 - float(self.coefficients.sum())) ** 2
        return self.samples * min(1.0, self.variance / at_zero)

    @property
    def independent_squares(self) -> float:
        """Share of the samples whose squares, were they independent, would tell as much."""
        # Squares of a Gaussian process correlate by the square of its own correlation; the sum of
        # these over all lags is the mean square of its spectral density over the squared mean.
        whitening = np.fft.rfft(np.concatenate(([1.0], -self.coefficients)), _SPECTRUM)
        density = 1.0 / np.abs(whitening) ** 2
        return float(np.mean(density) ** 2 / np.mean(density**2))

    def scaled(self, factor: float) -> 'NoiseModel':
        """Return noise of the same colour whose standard deviation is `factor` times this one."""
        square = factor**2
        return NoiseModel(
            self.coefficients, square * self.variance, square * self.innovation, self.samples
        )


def fit_noise(*series: Array) -> NoiseModel:
    """Fit an autoregressive model whose order has the lowest BIC.

    Args:
        series: Each (..., R) a time series of the same noise; one or more. Products of rows are
            added up.

    Returns:
        The model; of order 0 where the series look white or are too short to tell.

    Reference:
        Levinson-Durbin recursion: Brockwell and Davis (1991), Time Series: Theory and Methods,
        section 5.2; order by Schwarz (1978), Annals of Statistics 6.
    """
    return levinson(*products(*series))


def products(*series: Array) -> tuple[Array, int]:
    """Return (p + 1,) sums of products of samples 0 to p apart, and the number of samples.

    Args:
        series: As for `fit_noise`.
    """
    count = sum(row.shape[-1] for row in series)
    most = min(MOST_COEFFICIENTS, count // 10)
    # The mean stays in: the model is to explain every sample, a constant offset included.
    sums = [
        sum(
            float(np.vdot(row[..., : row.shape[-1] - k], row[..., k:]))
            for row in series
            if row.shape[-1] > k
        )
        for k in range(most + 1)
    ]
    return np.array(sums), count


def levinson(sums: Array, count: int) -> NoiseModel:
    """Return the autoregressive model of the lowest BIC by what `products` returned."""
    covariance = sums / max(count, 1)
    variance = float(covariance[0])
    plain = NoiseModel(np.empty(0), variance, variance, count)
    most = len(covariance) - 1
    if variance <= 0.0 or most < 1:
        return plain
    best, best_score = plain, 0.0
    coefficients = np.empty(0)
    innovation = variance
    for order in range(1, most + 1):
        lagged = covariance[1:order][::-1]
        reflection = (covariance[order] - float(coefficients @ lagged)) / innovation
        coefficients = np.append(coefficients - reflection * coefficients[::-1], reflection)
        innovation *= 1.0 - reflection**2
        if innovation <= 1e-12 * variance:
            break
        score = count * np.log(innovation / variance) + order * np.log(count)
        if score < best_score:
            best = NoiseModel(coefficients.copy(), variance, innovation, count)
            best_score = score
    return best


@dataclass(frozen=True)
class Run:
    """Rows of a residual that follow one another in time without a gap.

    Attributes:
        start: First row.
        stop: Row after the last.
        place: Whose noise they have.
    """

    start: int
    stop: int
    place: int


class Whitening:
    """Turns rows with coloured noise into rows whose noise is white and of variance 1.

    The first rows of a run have no past: they are divided by the noise's standard deviation.

    Args:
        runs: All rows, run after run.
        models: The noise of each place.

    Attributes:
        volume: What the noise's size and its numbers cost of the logarithm of the evidence.

    Reference:
        Generalised least squares by prewhitening: Seber and Wild (2003), Nonlinear Regression,
        section 6.2.
    """

    def __init__(self, runs: Sequence[Run], models: Sequence[NoiseModel]) -> None:
        self.scale: Array = np.empty(runs[-1].stop if runs else 0)
        self._coloured: list[tuple[slice, Array, float]] = []
        numbers = sum(m.coefficients.size + 1 for m in {id(m): m for m in models}.values())
        self.volume = 0.5 * numbers * math.log(max(self.scale.size, 1))
        for run in runs:
            model = models[run.place]
            self.scale[run.start : run.stop] = model.variance**-0.5
            order = model.coefficients.size
            first = min(run.stop - run.start, order)
            rest = run.stop - run.start - first
            self.volume += 0.5 * first * math.log(model.variance)
            self.volume += 0.5 * rest * math.log(model.innovation)
            if rest and order:
                taps = np.concatenate(([1.0], -model.coefficients)) / np.sqrt(model.innovation)
                self._coloured.append((slice(run.start, run.stop), taps[::-1], order))

    def __call__(self, rows: Array) -> Array:
        """Return (R,) or (S, R) rows whitened."""
        out: Array = rows * self.scale
        for row, white in zip(np.atleast_2d(rows), np.atleast_2d(out), strict=True):
            for where, taps, order in self._coloured:
                white[where][order:] = np.correlate(row[where], taps, 'valid')
        return out


def weighted_normal_matrix(jacobian: Array, model: NoiseModel) -> Array:
    """Return J' R J, R the covariance matrix of the noise.

    R is never formed: its spectrum is that of the autoregressive model, and the products are sums
    over frequencies of the zero-padded columns.

    Args:
        jacobian: (R, N) rows in the order of the time series.
        model: The noise.

    Returns:
        (N, N) symmetric, positive semidefinite.
    """
    if not model.coefficients.size:
        return model.variance * (jacobian.T @ jacobian)
    length = 1 << int(np.ceil(np.log2(2 * len(jacobian))))
    columns = np.fft.rfft(jacobian, length, axis=0)
    whitening = np.fft.rfft(np.concatenate(([1.0], -model.coefficients)), length)
    density = model.innovation / np.abs(whitening) ** 2
    # A real transform keeps half the frequencies; all but the first and last stand for two.
    density[1:-1] *= 2.0
    return np.asarray(np.real((columns.conj() * density[:, None]).T @ columns) / length)


def correlation_time(values: Array) -> float:
    """Return how many samples of a series tell as much as one independent one (at least 1).

    Args:
        values: (T,) a series without NaN.
    """
    size = values.size
    centred = values - values.mean() if size else values
    if size < 8 or not centred.any():
        return 1.0
    spectrum = np.abs(np.fft.rfft(centred, 2 * size)) ** 2
    correlation = np.fft.irfft(spectrum)[: size // 2]
    total = 2.0 * np.cumsum(correlation / correlation[0]) - 1.0
    enough = np.arange(total.size) >= 5.0 * total
    window = int(np.argmax(enough)) if enough.any() else total.size - 1
    return max(1.0, float(total[window]))
