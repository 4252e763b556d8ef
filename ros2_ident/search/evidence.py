# SPDX-License-Identifier: Apache-2.0
"""Noise and model error in a residual, told apart by what can be predicted.

    r = -J d - S a + n,    a ~ N(0, tau^2 I),    n ~ AR(p) of each place

J is the derivative of the residual by the parameters, whose error d has the box as its prior. The
columns of S are what the model may lack: what effects would change, functions of the motion. How
large they are, tau, is what maximises the evidence; size and colour of the noise are those of what
is left. Nothing of either has to be known. The evidence says how well each sample is predicted by
those before it; what it is not clear about counts only where it comes true on blocks left out.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.linalg import cho_solve, cholesky, LinAlgError, solve_triangular

from ros2_ident.search.noise import fit_noise, NoiseModel, Run, Whitening
from ros2_ident.search.operators import Array

# What is added to a scaled precision that rounding has made indefinite.
_ROUNDED = 1e-10
# Half a 95 % interval in standard deviations.
_NORMAL = 1.96
# Times that the noise and what is predicted are estimated in turn.
_TURNS = 3
# Blocks are left out in so many folds.
_FOLDS = 4
# Columns of which the parameters imitate all but this share say nothing of their own.
_OWN = 1e-3
# Logarithm of the evidence that chance alone may gain.
_CHANCE = 3.0
# From here on it is clear that something is predicted.
_CLEAR = 30.0
# Sizes tried, as shares of the residual.
_SIZES = np.logspace(-5.0, 1.5, 66)


@dataclass(frozen=True)
class Evidence:
    """What a residual shows of noise, of what is missing, and of the parameters.

    Attributes:
        noise: (P,) the noise of each place.
        rms: (P,) root mean square of the residual.
        rest: (P,) the same of what is left of it.
        unseen: (P,) the same of what is left of blocks that were left out.
        size: tau: RMS of what a single column may add to the residual.
        gain: Logarithm of the evidence for that size over that for none.
        shift: (N,) how far the parameters move, in shares of their box, where what is missing may
            take its part of the residual.
        covariance: (N, N) of the parameters, in shares of their box, with what is missing unknown.
        left: (R,) residual less all that is predicted.
    """

    noise: tuple[NoiseModel, ...]
    rms: Array
    rest: Array
    unseen: Array
    size: float
    gain: float
    shift: Array
    covariance: Array
    left: Array

    @property
    def floor(self) -> Array:
        """(P,) root mean square of what nothing predicts."""
        return self.rest if self.gain > _CLEAR else self.unseen

    @property
    def predicted(self) -> Array:
        """(P,) root mean square of what is predicted."""
        return np.sqrt(np.maximum(self.rms**2 - self.floor**2, 0.0))

    def ends(
        self, theta: Array, low: Array, high: Array, least: Array, most: Array
    ) -> tuple[Array, Array]:
        """Return the ends of 95 % intervals that allow for what the model may lack.

        Args:
            theta: (N,) the estimate.
            low: (N,) lower ends of the box.
            high: (N,) upper ends.
            least: (N,) lower ends of the intervals for noise alone; these are held as well.
            most: (N,) upper ends.
        """
        width = high - low
        middle = theta + self.shift * width
        half = _NORMAL * np.sqrt(np.maximum(np.diag(self.covariance), 0.0)) * width
        # The box is what is known beforehand.
        return (
            np.fmin(least, np.maximum(middle - half, low)),
            np.fmax(most, np.minimum(middle + half, high)),
        )


def weigh(
    residual: Array,
    jacobian: Array,
    missing: Array,
    runs: Sequence[Run],
    blocks: npt.NDArray[np.int64],
    *,
    most: Array | None = None,
    share: float = 1.0,
) -> Evidence:
    """Weigh what a residual shows.

    Args:
        residual: (R,) measured less simulated.
        jacobian: (R, N) its derivative by the parameters' shares of their box.
        missing: (R, C) what may be missing in the model; scaled here to columns of one size.
        runs: The rows in order; the P places of their noise are 0 to P - 1.
        blocks: (R,) number of the block a row is left out with.
        most: (C,) how many times a column of `missing` may be there, one standard deviation; no
            limit where None.
        share: Share of all rows that these are: the others tell as much.

    Returns:
        The evidence.

    Reference:
        Kennedy and O'Hagan (2001), J. R. Statist. Soc. B 63; Brynjarsdottir and O'Hagan (2014),
        Inverse Problems 30; size by MacKay (1992), Neural Computation 4.
    """
    scaled, limit = _of_one_size(jacobian, missing, most)
    columns = np.hstack([jacobian, scaled])
    scale = float(np.sqrt(np.mean(residual**2))) or 1.0
    # A weak ridge for a first look: what it leaves is hardly more than the noise.
    ridge = 1e-6 * len(residual) * np.eye(columns.shape[1])
    left = residual - columns @ np.linalg.solve(
        columns.T @ columns + ridge, columns.T @ residual
    )
    for _ in range(_TURNS):
        noise = _noise(left, runs, scale)
        whiten = Whitening(runs, noise)
        white, right = whiten(columns.T).T, whiten(residual)
        sums = _Sums(white.T @ white, white.T @ right, limit)
        size, gain = sums.size(scale)
        left = residual - columns @ sums.solve(size)
    unseen = np.empty_like(residual)
    for fold in range(_FOLDS):
        out = blocks % _FOLDS == fold
        others = _Sums(
            sums.normal - white[out].T @ white[out],
            sums.gradient - white[out].T @ right[out],
            limit,
        )
        unseen[out] = residual[out] - columns[out] @ others.solve(size)
    # Rows that were left out of the sums tell as much as those in them.
    whole = _Sums(sums.normal / share, sums.gradient / share, limit)
    shift, covariance = whole.parameters(size)
    place = np.concatenate([np.full(run.stop - run.start, run.place) for run in runs])
    rms = _rms(residual, place)
    # What a fit takes from the noise is put back.
    taken = np.einsum('rc,rc->r', columns @ sums.covariance(size), columns)
    rest: Array = np.hypot(_rms(left, place), _rms(np.sqrt(taken), place))
    # A prediction that makes it worse is none.
    return Evidence(
        noise,
        rms,
        np.minimum(rms, rest),
        np.minimum(rms, _rms(unseen, place)),
        size,
        gain,
        shift,
        covariance,
        left,
    )


class _Sums:
    """Normal equations of parameters and of what is missing, rows whitened.

    Args:
        normal: (N + C, N + C) products of the columns.
        gradient: (N + C,) products of columns and residual.
        limit: (C,) largest size of each column of what is missing.
    """

    def __init__(self, normal: Array, gradient: Array, limit: Array) -> None:
        self.normal, self.gradient, self.limit = normal, gradient, limit
        self.count = len(normal) - len(limit)

    def size(self, scale: float) -> tuple[float, float]:
        """Return the size of what is missing that has most evidence, and the gain over none."""
        sizes = scale * _SIZES
        none, *gains = (self._evidence(size) for size in (sizes[0], *sizes))
        best = int(np.argmax(gains))
        gain = gains[best] - none
        # What chance gains is no evidence that anything is missing.
        return float(sizes[best if gain > _CHANCE else 0]), gain

    def _evidence(self, size: float) -> float:
        """Return the logarithm of the evidence for a size, but for a constant."""
        factor, scale = self._factor(size)
        half = solve_triangular(factor, self.gradient * scale, lower=True)
        deviation = np.minimum(size, self.limit)
        volume = np.sum(np.log(np.diag(factor) / scale)) + np.sum(np.log(deviation))
        return float(0.5 * half @ half - volume)

    def solve(self, size: float) -> Array:
        """Return (N + C,) the most probable coefficients."""
        factor, scale = self._factor(size)
        out: Array = scale * cho_solve((factor, True), scale * self.gradient)
        return out

    def parameters(self, size: float) -> tuple[Array, Array]:
        """Return (N,) how far the parameters move, and (N, N) their covariance."""
        own = slice(0, self.count)
        return -self.solve(size)[own], self.covariance(size)[own, own]

    def covariance(self, size: float) -> Array:
        """Return (N + C, N + C) the covariance of the coefficients."""
        factor, scale = self._factor(size)
        out: Array = scale[:, None] * cho_solve((factor, True), np.diag(scale))
        return out

    def _factor(self, size: float) -> tuple[Array, Array]:
        """Return the lower Cholesky factor of the precision, scaled to ones on its diagonal."""
        deviation = np.minimum(size, self.limit)
        prior = np.concatenate([np.ones(self.count), deviation**-2.0])
        precision = self.normal + np.diag(prior)
        scale: Array = np.diag(precision) ** -0.5
        precision *= np.outer(scale, scale)
        try:
            return cholesky(precision, lower=True), scale
        except LinAlgError:
            # More columns than samples, and rounding took the prior from those that are alike.
            return cholesky(precision + _ROUNDED * np.eye(len(scale)), lower=True), scale


def _of_one_size(jacobian: Array, missing: Array, most: Array | None) -> tuple[Array, Array]:
    """Return (R, C') columns of RMS 1 once the parameters have imitated what they can.

    And (C',) how many times each may be there.
    """
    basis = np.linalg.qr(jacobian)[0]
    whole = np.einsum('rc,rc->c', missing, missing)
    own = whole - np.sum((basis.T @ missing) ** 2, axis=0)
    keep = own > np.maximum(_OWN**2 * whole, 1e-300)
    rms = np.sqrt(own[keep] / len(missing))
    limit = np.full(rms.size, np.inf) if most is None else most[keep] * rms
    return missing[:, keep] / rms, limit


def _noise(left: Array, runs: Sequence[Run], scale: float) -> tuple[NoiseModel, ...]:
    count = 1 + max(run.place for run in runs)
    rows: list[list[Array]] = [[] for _ in range(count)]
    for run in runs:
        rows[run.place].append(left[run.start : run.stop])
    found = [fit_noise(*series) for series in rows]
    # A residual that is predicted wholly has no noise to divide by.
    least = (1e-9 * scale) ** 2
    return tuple(
        m if m.variance > least else NoiseModel(np.empty(0), least, least, m.samples)
        for m in found
    )


def _rms(values: Array, place: npt.NDArray[np.int64]) -> Array:
    number = np.maximum(np.bincount(place), 1)
    out: Array = np.sqrt(np.bincount(place, values**2) / number)
    return out
