# SPDX-License-Identifier: Apache-2.0
"""Noise and model error in a residual, told apart by what can be predicted.

    r = -J d - S a + n,    a_i ~ N(0, tau^2 + tau_i^2),    n ~ AR(p) of each place

J is the derivative of the residual by the parameters, whose error d has the box as its prior. The
columns of S are what the model may lack: what effects would change, functions of the motion. How
large they are is what maximises the evidence: tau of all, and a tau_i of its own for the few of
which the evidence is so many times larger that it outweighs their choice among all. Size and
colour of the noise are those of what is left, with what the coefficients' uncertainty hides of it
put back (expectation maximisation).
Nothing of either has to be known. The evidence says how well each sample is predicted by
those before it; what it is not clear about counts only where it comes true on blocks left out.
How far the parameters may be off is drawn with the sizes unknown, each its own (horseshoe prior).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import scipy

from ros2_ident.arrays import NORMAL
from ros2_ident.search.noise import levinson, NoiseModel, products, Run, Whitening
from ros2_ident.search.operators import Array

# What is added to a scaled precision that rounding has made indefinite; what the rows add to that
# of a prior is rounding below this share of it.
_ROUNDED = 1e-10
# Times that the noise and what is predicted are estimated in turn, and how many draws of the
# coefficients show what their uncertainty hides of the noise.
_TURNS, _DRAWS = 2, 8
# Blocks are left out in so many folds.
_FOLDS = 4
# Of a column of which the parameters imitate all but this share (RMS), the motion cannot tell
# whether it is there: then a parameter is known as one that may stand for it as well. By hand.
OWN = 0.05
# Share of what the rows hold from which on coefficients may well follow noise, and from which on
# they do: they took more than they left. By hand.
_MUCH, _MOST = 0.25, 0.5
# Logarithm of the evidence that chance alone may gain.
_CHANCE = 3.0
# From here on it is clear that something is predicted.
_CLEAR = 30.0
# Sizes tried, as shares of the residual: every fourth, then those about the best. And how many
# times single columns get their own before that of all is looked for again.
SIZES = np.logspace(-5.0, 1.5, 66)
_EVERY, _ROUNDS = 4, 4
# Draws of the sizes that the parameters' certainty is of, and as many before them as do not count:
# on 120 simulated axes 1000 give the same, 2026-11-28.
_DRAWN, _SKIPPED = 300, 100


class Certainty(NamedTuple):
    """How far parameters may be off where a model lacks something.

    Attributes:
        shift: (N,) how far they move, in shares of their box, where what is missing may take its
            part of the residual.
        covariance: (N, N) in shares of their box, with what is missing unknown.
    """

    shift: Array
    covariance: Array


@dataclass(frozen=True)
class Evidence:
    """Evidence of a residual: noise, missing effects, and parameters.

    Attributes:
        noise: (P,) the noise of each place.
        rms: (P,) root mean square of the residual.
        rest: (P,) the same of what is left of it.
        unseen: (P,) the same of what is left of blocks that were left out.
        gain: Logarithm of the evidence that something is missing over that for nothing.
        left: (R,) residual less all that is predicted.
        tell: Returns what `parameters` keeps: most never ask, and it takes hundreds of draws.
    """

    noise: tuple[NoiseModel, ...]
    rms: Array
    rest: Array
    unseen: Array
    gain: float
    left: Array
    tell: Callable[[], 'Certainty']

    @cached_property
    def parameters(self) -> 'Certainty':
        """How certain the parameters are."""
        return self.tell()

    @property
    def floor(self) -> Array:
        """(P,) root mean square of what nothing predicts."""
        return self.rest if self.gain > _CLEAR else self.unseen

    @property
    def predicted(self) -> Array:
        """(P,) root mean square of what is predicted."""
        return np.sqrt(np.maximum(self.rms**2 - self.floor**2, 0.0))

    def with_rows(self, jacobian: Array, residual: Array | float = 0.0) -> 'Evidence':
        """Return it with further rows that what is missing does not change, of noise 1.

        Args:
            jacobian: (L, N) their derivative by the parameters' shares of their box.
            residual: (L,) their residual; 0 where the parameters are the best of these rows, too.
        """

        def tell() -> Certainty:
            shift, covariance = self.parameters
            before = np.linalg.pinv(covariance, hermitian=True)
            known = before + jacobian.T @ jacobian
            covariance = np.asarray(np.linalg.pinv(known, hermitian=True), dtype=np.float64)
            push = before @ shift - np.broadcast_to(residual, len(jacobian)) @ jacobian
            return Certainty(covariance @ push, covariance)

        return replace(self, tell=tell)

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
        width, (shift, covariance) = high - low, self.parameters
        middle = theta + shift * width
        half = NORMAL * np.sqrt(np.maximum(np.diag(covariance), 0.0)) * width
        # The box is what is known beforehand; where it begins at zero, nothing is less.
        return (
            np.maximum(
                np.fmin(least, np.maximum(middle - half, low)), np.where(low, -np.inf, 0.0)
            ),
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
        Inverse Problems 30; one size by MacKay (1992), Neural Computation 4; sizes of single
        columns by Tipping and Faul (2003), AISTATS 9.
    """
    columns, limit, _ = of_one_size(jacobian, missing, most)
    scale = float(np.sqrt(np.mean(residual**2))) or 1.0
    data = Rows(residual, columns, runs, limit, scale)
    found = data.found(len(jacobian.T), blocks)
    place = np.concatenate([np.full(run.stop - run.start, run.place) for run in runs])
    rms = _rms(residual, place)
    unseen = data.unseen(found, blocks)
    # With what a fit takes from the noise put back.
    hidden = _rms(np.sqrt(np.mean(found.spread**2, axis=1)), place)
    rest = np.hypot(_rms(found.left, place), hidden)
    sums = found.sums
    # Rows that were left out of the sums tell as much as those in them.
    whole = Sums(sums.normal / share, sums.gradient / share, limit)
    # A prediction that makes it worse is none.
    return Evidence(
        found.noise,
        rms,
        np.minimum(rms, rest),
        np.minimum(rms, _rms(unseen, place)),
        found.gain,
        found.left,
        partial(whole.parameters, found.sizes, scale),
    )


@dataclass(frozen=True)
class _Found:
    """Result of one start of the noise; see `Rows.weighed`."""

    noise: tuple[NoiseModel, ...]
    sums: 'Sums'
    parts: list[tuple[Array, Array]]
    sizes: Array
    gain: float
    evidence: float
    left: Array
    spread: Array


@dataclass(frozen=True)
class Rows:
    """A residual (R,) and columns (R, N + C) of what may be in it; see `weigh`."""

    residual: Array
    columns: Array
    runs: Sequence[Run]
    limit: Array
    scale: float

    def first_noise(self) -> tuple[NoiseModel, ...]:
        """Return the noise by a first look: what a weak ridge leaves is hardly more than it."""
        columns, residual = self.columns, self.residual
        ridge = 1e-6 * len(residual) * np.eye(columns.shape[1])
        return self.noise(
            residual - columns @ np.linalg.solve(columns.T @ columns + ridge, columns.T @ residual)
        )

    def found(self, count: int, blocks: npt.NDArray[np.int64]) -> _Found:
        """Return noise and coefficients, the first `count` columns being of parameters."""
        found, residual = self.weighed(self.first_noise(), blocks), self.residual
        taken = found.sums.taken(found.sizes) / len(residual)
        if taken > _MUCH:
            # As many columns as rows follow any noise: then all of it may be noise.
            own = self.columns[:, :count]
            plain = self.noise(residual - own @ np.linalg.lstsq(own, residual, rcond=None)[0])
            if taken > _MOST:
                return self.weighed(plain, blocks)
            if self.plain(plain, count) > found.evidence:
                return max(found, self.weighed(plain, blocks), key=lambda one: one.evidence)
        return found

    def weighed(self, noise: tuple[NoiseModel, ...], blocks: npt.NDArray[np.int64]) -> _Found:
        """Estimate noise and coefficients in turn, from a noise to start with."""
        columns, count = self.columns, self.columns.shape[1]
        drawn = np.random.default_rng(0).standard_normal((count, _DRAWS))
        folds = [blocks % _FOLDS == fold for fold in range(_FOLDS)]
        for _ in range(_TURNS):
            whiten = Whitening(self.runs, noise)
            white, right = whiten(columns.T), whiten(self.residual)
            rows = ((white.take(np.flatnonzero(out), axis=1), right[out]) for out in folds)
            parts = [(own @ own.T, own @ against) for own, against in rows]
            normal, gradient = (np.sum(x, axis=0) for x in zip(*parts, strict=True))
            sums = Sums(normal, gradient, self.limit)
            sizes, gain, evidence = sums.sizes(self.scale)
            evidence -= 0.5 * float(right @ right) + whiten.volume
            left = self.residual - columns @ sums.solve(sizes)
            spread = columns @ sums.draws(sizes, drawn)
            noise = self.noise(left, spread)
        return _Found(noise, sums, parts, sizes, gain, evidence, left, spread)

    def unseen(self, found: _Found, blocks: npt.NDArray[np.int64]) -> Array:
        """Return (R,) what is left of blocks that are predicted by the others."""
        out = np.empty_like(self.residual)
        for fold, (normal, gradient) in enumerate(found.parts):
            own, sums = blocks % _FOLDS == fold, found.sums
            others = Sums(sums.normal - normal, sums.gradient - gradient, self.limit)
            out[own] = self.residual[own] - self.columns[own] @ others.solve(found.sizes)
        return out

    def plain(self, noise: tuple[NoiseModel, ...], count: int) -> float:
        """Return the evidence where the first `count` columns and noise are all there is."""
        whiten = Whitening(self.runs, noise)
        white, right = whiten(self.columns[:, :count].T).T, whiten(self.residual)
        sums = Sums(white.T @ white, white.T @ right, np.empty(0))
        return sums.evidence(np.empty(0)) - 0.5 * float(right @ right) - whiten.volume

    def noise(self, left: Array, spread: Array | None = None) -> tuple[NoiseModel, ...]:
        """Return the noise of each place: one for all where that is the more probable.

        Args:
            left: (R,) what is left.
            spread: (R, M) draws of what the coefficients' uncertainty hides.
        """
        count = 1 + max(run.place for run in self.runs)
        rows: list[list[Array]] = [[] for _ in range(count)]
        both = left[None]
        if spread is not None:
            both = np.vstack([left, spread.T / math.sqrt(spread.shape[1])])
        for run in self.runs:
            rows[run.place].append(both[:, run.start : run.stop])
        told = [products(*series) for series in rows]
        found = [levinson(*one) for one in told]
        if count > 1 and len({sums.size for sums, _ in told}) == 1:
            of_all = np.sum([sums for sums, _ in told], axis=0)
            together = levinson(of_all, sum(number for _, number in told))
            if together.score < sum(m.score for m in found):
                found = [together] * count
        # A residual that is predicted wholly has no noise to divide by.
        least = (1e-9 * self.scale) ** 2
        return tuple(
            m if m.variance > least else NoiseModel(np.empty(0), least, least, m.samples)
            for m in found
        )


class Sums:
    """Normal equations of parameters and of what is missing, rows whitened.

    Args:
        normal: (N + C, N + C) products of the columns.
        gradient: (N + C,) products of columns and residual.
        limit: (C,) largest size of each column of what is missing.

    Sizes (C,) are standard deviations of their coefficients.
    """

    def __init__(self, normal: Array, gradient: Array, limit: Array) -> None:
        self.normal, self.gradient, self.limit = normal, gradient, limit
        self.count = len(normal) - len(limit)

    def sizes(self, scale: float) -> tuple[Array, float, float]:
        """Return (C,) the most probable sizes of what is missing, the gain over none, evidence."""
        none, own = np.minimum(scale * SIZES[0], self.limit), np.zeros(len(self.limit))
        size, evidence = self._of_all(own, scale * SIZES)
        least = self.evidence(none)
        if not evidence - least > _CHANCE:
            # What chance gains is no evidence that anything is missing.
            return none, evidence - least, least
        for _ in range(_ROUNDS):
            common = np.minimum(size, self.limit)
            sizes = self._own(np.hypot(common, own), common)
            further = np.sqrt(np.maximum(sizes**2 - common**2, 0.0))
            if np.array_equal(further, own):
                break
            own = further
            size, evidence = self._of_all(own, scale * SIZES[scale * SIZES <= size])
        return np.minimum(np.hypot(size, own), self.limit), evidence - least, evidence

    def _of_all(self, own: Array, tried: Array) -> tuple[float, float]:
        """Return the most probable size of all beside those (C,) of their own, and its evidence.

        Args:
            own: (C,) sizes of single columns.
            tried: Sizes to try: every fourth, then those about the best.
        """
        evidence = {}

        def best(sizes: Array) -> int:
            for size in sizes.tolist():
                if size not in evidence:
                    evidence[size] = self.evidence(np.minimum(np.hypot(size, own), self.limit))
            return int(np.searchsorted(tried, max(sizes.tolist(), key=lambda x: evidence[x])))

        first = max(0, best(tried[::-_EVERY]) - _EVERY + 1)
        last = best(tried[first : first + 2 * _EVERY - 1])
        return float(tried[last]), evidence[float(tried[last])]

    def _own(self, sizes: Array, common: Array) -> Array:
        """Return (C,) sizes, some of them now their own, from sizes and those `common` to all.

        One at a time, by the evidence that its best size has beside the others as they are. That
        it is this one and no other has to be paid for.
        """
        own = slice(self.count, None)
        covariance, mean = self.covariance(sizes), self.solve(sizes)
        square, least = sizes**2, price_of(sizes.size)
        for _ in range(sizes.size):
            spread = np.diag(covariance)[own]
            # What the rows and the other coefficients say of one: precision, and its mean by that.
            precision = np.maximum(1.0 / spread - 1.0 / square, _ROUNDED / square)
            told = mean[own] / spread
            best = np.clip((told**2 / precision - 1.0) / precision, common**2, self.limit**2)
            gain = _of_one(best, told, precision) - _of_one(square, told, precision)
            gain[precision <= _ROUNDED / square] = 0.0
            i = int(np.argmax(gain))
            if not gain[i] > least:
                break
            change = 1.0 / best[i] - 1.0 / square[i]
            column = covariance[:, self.count + i]
            factor = change / (1.0 + change * column[self.count + i])
            mean = mean - factor * mean[self.count + i] * column
            covariance = covariance - factor * np.outer(column, column)
            square[i] = best[i]
        return np.asarray(np.sqrt(square))

    def evidence(self, sizes: Array) -> float:
        """Return the logarithm of the evidence for sizes, but for what is the noise's alone."""
        factor, scale = self._factor(sizes)
        half = scipy.linalg.solve_triangular(factor, self.gradient * scale, lower=True)
        volume = np.sum(np.log(np.diag(factor) / scale)) + np.sum(np.log(sizes))
        return float(0.5 * half @ half - volume)

    def solve(self, sizes: Array) -> Array:
        """Return (N + C,) the most probable coefficients."""
        factor, scale = self._factor(sizes)
        return np.asarray(scale * scipy.linalg.cho_solve((factor, True), scale * self.gradient))

    def parameters(self, sizes: Array, scale: float) -> Certainty:
        """Return how certain the parameters are.

        Most columns are not there, a few may be large, and which they are is not known: so their
        sizes have the horseshoe prior, and are drawn in turn with the coefficients.

        Args:
            sizes: (C,) sizes to begin with.
            scale: Of the size of all: half of it is expected below.

        Reference:
            Carvalho, Polson and Scott (2010), Biometrika 97; drawn as by Makalic and Schmidt
            (2016), IEEE Signal Processing Letters 23.
        """
        own, rng = slice(0, self.count), np.random.default_rng(0)
        if not (self.count and sizes.size):
            return Certainty(-self.solve(sizes)[own], self.covariance(sizes)[own, own])

        def drawn(shape: float, rate: Array) -> Array:
            return np.asarray(rate / rng.gamma(shape, size=np.shape(rate)))

        common = np.asarray(np.mean(sizes**2) / scale**2)
        local = (sizes / scale) ** 2 / common
        means, inner = [], []
        for _ in range(_SKIPPED + _DRAWN):
            factor, unit = self._factor(np.minimum(scale * np.sqrt(common * local), self.limit))
            mean = unit * scipy.linalg.cho_solve((factor, True), unit * self.gradient)
            half = scipy.linalg.solve_triangular(factor, np.diag(unit)[:, own], lower=True)
            means.append(mean[own])
            inner.append(half.T @ half)
            spread = scipy.linalg.solve_triangular(
                factor, rng.standard_normal(len(mean)), lower=True, trans='T'
            )
            square = ((mean + unit * spread)[self.count :] / scale) ** 2
            local = drawn(1.0, 1.0 / drawn(1.0, 1.0 + 1.0 / local) + square / (2.0 * common))
            common = drawn(
                (len(local) + 1) / 2,
                1.0 / drawn(1.0, 1.0 + 1.0 / common) + np.sum(square / local) / 2.0,
            )
        known = np.array(means[_SKIPPED:])
        covariance = np.mean(inner[_SKIPPED:], axis=0) + np.cov(known.T, bias=True)
        return Certainty(-known.mean(axis=0), covariance)

    def taken(self, sizes: Array) -> float:
        """Return how many of the coefficients the rows decide, and not their prior."""
        root = np.concatenate([np.ones(self.count), sizes])
        told = np.linalg.eigvalsh(self.normal * np.outer(root, root))
        return float(np.sum(told[told > 0.0] / (1.0 + told[told > 0.0])))

    def draws(self, sizes: Array, drawn: Array) -> Array:
        """Return (N + C, M) deviations of the coefficients from standard normal numbers."""
        factor, scale = self._factor(sizes)
        found = scipy.linalg.solve_triangular(factor, drawn, lower=True, trans='T')
        return np.asarray(scale[:, None] * found)

    def covariance(self, sizes: Array) -> Array:
        """Return (N + C, N + C) the covariance of the coefficients."""
        factor, scale = self._factor(sizes)
        return np.asarray(scale[:, None] * scipy.linalg.cho_solve((factor, True), np.diag(scale)))

    def _factor(self, sizes: Array) -> tuple[Array, Array]:
        """Return the lower Cholesky factor of the precision, scaled to ones on its diagonal."""
        prior = np.concatenate([np.ones(self.count), sizes**-2.0])
        precision = self.normal + np.diag(prior)
        scale: Array = np.diag(precision) ** -0.5
        precision *= np.outer(scale, scale)
        try:
            return scipy.linalg.cholesky(precision, lower=True), scale
        except np.linalg.LinAlgError:
            # More columns than samples, and rounding took the prior from those that are alike.
            precision = precision + _ROUNDED * np.eye(len(scale))
            return scipy.linalg.cholesky(precision, lower=True), scale


def price_of(choices: int) -> float:
    """Return the evidence that choosing the best among so many may gain by chance."""
    return max(_CHANCE, math.log(max(choices, 1)))


def _of_one(square: Array, told: Array, precision: Array) -> Array:
    """Return (C,) the evidence of single coefficients by the squares of their sizes."""
    more = 1.0 + square * precision
    return np.asarray(0.5 * (told**2 * square / more - np.log(more)))


def of_one_size(jacobian: Array, missing: Array, most: Array | None) -> tuple[Array, Array, Array]:
    """Return (R, N + C') columns of parameters, then of RMS 1 what is missing.

    That is their size once the parameters have imitated what they can; and (C',) how many times
    each may be there, and (C,) the size of each; 0 where all of it is imitated.
    """
    count = jacobian.shape[1]
    basis, columns = np.linalg.qr(jacobian)[0], missing.T
    whole = np.einsum('cr,cr->c', columns, columns)
    own = whole - np.sum((columns @ basis) ** 2, axis=1)
    keep = own > np.maximum(OWN**2 * whole, 1e-300)
    size = np.sqrt(np.where(keep, own, 0.0) / len(missing))
    rms = size[keep]
    limit = np.full(rms.size, np.inf) if most is None else most[keep] * rms
    # A column's samples lie side by side: whitening and products go along them.
    out = np.empty((count + rms.size, len(missing)))
    out[:count] = jacobian.T
    np.divide(columns[keep], rms[:, None], out=out[count:])
    return out.T, limit, size


def _rms(values: Array, place: npt.NDArray[np.int64]) -> Array:
    number = np.maximum(np.bincount(place), 1)
    return np.asarray(np.sqrt(np.bincount(place, values**2) / number))
