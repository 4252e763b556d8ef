# SPDX-License-Identifier: Apache-2.0
"""Changes between two sides of a residual, told from all that both have in common.

    r = -J d - S a - D Z g - Z e_l + n,    a ~ N(0, sizes^2),    e_l ~ N(0, usual^2)

J and S are as in `evidence`; d and a are the same on both sides, so they cancel. D keeps the rows
of one side; Z are the columns of everything that may have changed, those of J among them. Each log
l has a deviation e_l of its own, as far as that is known beforehand. Whitened by the noise that
all columns leave of each log by itself, and with d, a and e integrated out, the changes have the
information G and the score h: one factorisation for all of them.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
import math
from typing import Any

import numpy as np
import numpy.typing as npt
import scipy

from ros2_ident.search.evidence import of_one_size, OWN, Rows, SIZES, Sums
from ros2_ident.search.noise import NoiseModel, Run, Whitening
from ros2_ident.search.operators import Array

Mask = npt.NDArray[np.bool_]
# Less than this share of a column is rounding.
_ROUNDED = 1e-9


@dataclass(frozen=True)
class Logs:
    """Rows of several logs, in turn.

    Attributes:
        rows: Rows of each log.
        after: (L,) whether a log is of the side after.
        pair: (L,) logs of one number have their model error and parameters in common.
        fold: (R,) with which part a row is left out; each part has both sides.
    """

    rows: tuple[slice, ...]
    after: Mask
    pair: npt.NDArray[np.int64]
    fold: npt.NDArray[np.int64]


@dataclass(frozen=True)
class Changes:
    """Q changes by the rows.

    Attributes:
        information: (Q, Q) G; by multiples of the columns as given.
        score: (Q,) h.
        kept: Columns that are changes already; all others are told beside them.
        alike: Information and score where logs deviate by nothing.
        inflation: (Q,) by how much the scatter from log to log raises a change's variance.
        freedom: (Q,) degrees of freedom of that variance; inf where nothing scatters.
        scatter: The same, where a side has one log by its parts.
        by_itself: (Q,) variance of a change between the sides that has no cause.
        noise: The noise of each place.
        common: (R, C) columns of what the model lacks on both sides, of one size.
        sizes: (C,) standard deviations of their coefficients.
        limit: (C,) the largest.
        alone: (R, V) columns by which logs deviate, one standard deviation.
        scattering: (R, K) the same of those kept, as several logs of a side tell it.
        folds: Information and score of each part left out, and of all others; by multiples of
            columns of one size.
        both: (N + C, N + C + Q) of each pair of logs, precision of what both sides have in common
            and its products with the changes.
        own: (Q,) which of these columns is the change on both sides; -1 for none.
        scale: RMS of the residual.
    """

    information: Array
    score: Array
    kept: tuple[int, ...]
    alike: tuple[Array, Array]
    inflation: Array
    freedom: Array
    scatter: tuple[Array, Array]
    by_itself: Array
    noise: tuple[NoiseModel, ...]
    common: Array
    sizes: Array
    limit: Array
    alone: Array
    scattering: Array
    folds: list[tuple[Array, ...]]
    both: list[Array]
    own: npt.NDArray[np.int64]
    scale: float

    def of(self, columns: Sequence[int], *, alike: bool = False) -> tuple[Array, Array, float]:
        """Return estimate (k,) and covariance (k, k) of some changes, and their gain.

        The gain is twice the fall of the logarithm of the likelihood, less what it has by the
        scatter of few logs; 0 where none of the columns has information of its own.

        Args:
            columns: The changes.
            alike: Whether to take the logs of one side as alike.
        """
        information, score = self.alike if alike else (self.information, self.score)
        at, kept = list(columns), list(self.kept)
        own, told = information[np.ix_(at, at)], score[at]
        each = np.diag(own)
        scale = 1.0 / np.sqrt(np.maximum(each, max(_ROUNDED**2 * float(each.max()), 1e-300)))
        if kept:
            beside = information[np.ix_(kept, [*at])], score[kept]
            across = np.linalg.solve(
                information[np.ix_(kept, kept)] + np.eye(len(kept)), np.column_stack(beside)
            )
            own = own - beside[0].T @ across[:, :-1]
            told = told - beside[0].T @ across[:, -1]
        values, vectors = np.linalg.eigh(own * np.outer(scale, scale))
        shown = values > _ROUNDED
        if not shown.any():
            return np.zeros(len(at)), np.full((len(at), len(at)), np.inf), 0.0
        # What does not show of several stays, and is not known.
        values = np.maximum(values, _ROUNDED)
        covariance = np.outer(scale, scale) * ((vectors / values) @ vectors.T)
        found = scale * ((vectors * (shown / values)) @ (vectors.T @ (scale * told)))
        gain = max(0.0, float(found @ told))
        if alike:
            return -found, covariance, gain
        factor = float(self.inflation[at].max())
        covariance = covariance * factor + np.diag(self.by_itself[at])
        return -found, covariance, self.among_logs(gain, at)

    def shown(self, columns: Sequence[int], price: float) -> Array:
        """Return (k,) the coefficients that are named in half of all cases like this one.

        On both sides the same is left open: it explains a part of a change that is in no fit.

        Args:
            columns: The changes.
            price: Evidence that is asked for.
        """
        at = list(columns)
        first = len(self.both[0]) - self.sizes.size
        own = np.unique(self.own[at][self.own[at] >= first])
        less = (self.sizes[own - first] ** -2.0 - self.limit[own - first] ** -2.0)[:, None]
        information = self.information.copy()
        for sums in self.both:
            known = np.linalg.solve(sums[:, : len(sums)], np.eye(len(sums))[:, own])
            across = known.T @ sums[:, len(sums) :]
            left = np.eye(own.size) - less * known[own]
            information -= across.T @ np.linalg.solve(left, less * across)
        covariance = replace(self, information=information).of(at)[1]
        noise = (np.diag(covariance) - self.by_itself[at]) * (
            self.scatter[0][at] / self.inflation[at].max()
        )
        total = noise + self.by_itself[at]
        share = np.divide(noise, total, out=np.ones_like(total), where=total < np.inf)
        freedom = np.minimum(self.scatter[1][at] / share**2, 1e9)
        errors = [shown_from(price, x) for x in freedom.tolist()]
        return np.asarray(errors * np.sqrt(total))

    def among_logs(self, gain: float, columns: Sequence[int]) -> float:
        """Return a gain less what it has by the scatter of few logs."""
        at = list(columns)
        return as_normal(gain / float(self.inflation[at].max()), float(self.freedom[at].min()))

    def half_widths(self) -> Array:
        """Return (K,) half the 95 % intervals of those kept, whose box is known beforehand."""
        covariance, freedom = self.beside()
        half = np.sqrt(np.diag(covariance))
        return np.asarray(-half * scipy.special.stdtrit(freedom, 0.025), np.float64)

    def beyond(self, estimate: Array, sizes: Sequence[int]) -> float:
        """Return the gain of some of those kept over differing as they do by themselves.

        Args:
            estimate: (k,) these.
            sizes: (k,) which of all that are kept.
        """
        at, (covariance, freedom) = list(sizes), self.beside()
        gain = estimate @ np.linalg.solve(covariance[np.ix_(at, at)], estimate)
        return as_normal(float(gain), 1.0 / float(np.mean(1.0 / freedom[at])))

    def beside(self) -> tuple[Array, Array]:
        """Return covariance (K, K) and freedom (K,) of those kept, whose box is known before."""
        at = list(self.kept)
        wide = np.sqrt(self.scatter[0][at])
        covariance = np.linalg.inv(self.information[np.ix_(at, at)] + np.eye(len(at)))
        total: Array = np.asarray(covariance * np.outer(wide, wide), dtype=np.float64)
        share = np.diag(total) / (np.diag(total) + self.by_itself[at])
        total = total + np.diag(self.by_itself[at])
        return total, np.asarray(np.minimum(self.scatter[1][at] / share**2, 1e9))

    def unseen(self, columns: Sequence[int] | None = None) -> float:
        """Return what changes gain on parts left out, as the others tell them.

        Twice the logarithm of the likelihood.

        Args:
            columns: The changes; all, each of its most probable size, where None.
        """
        gain, at = 0.0, list(columns or ())
        for information, score, others, told in self.folds:
            own = np.zeros(len(told))
            if columns is None:
                sums = Sums(others, told, np.full(len(told), np.inf))
                own = sums.solve(sums.sizes(self.scale)[0])
            else:
                own[at] = np.linalg.lstsq(others[np.ix_(at, at)], told[at], rcond=None)[0]
            gain += float(2.0 * own @ score - own @ information @ own)
        return gain


def as_normal(gain: float, freedom: float) -> float:
    """Return the square of as many standard errors as are as probable of a normal number.

    Reference:
        Wallace (1959), Annals of Mathematical Statistics 30(4), 1121: a bound from below, which
        no tail is too thin for.
    """
    if math.isinf(freedom):
        return gain
    return _share(freedom) * freedom * math.log1p(gain / freedom)


def _share(freedom: float) -> float:
    return ((8.0 * freedom + 1.0) / (8.0 * freedom + 3.0)) ** 2


def evidence_of(gain: float, count: int) -> float:
    """Return by how much the evidence grows with `count` numbers of the most probable size.

    Args:
        gain: Twice the fall of the logarithm of the likelihood.
        count: Numbers.
    """
    return 0.5 * (gain - count - count * math.log(gain / count)) if gain > count else 0.0


def shown_from(price: float, freedom: float = math.inf) -> float:
    """Return how many standard errors a change has to have for its evidence to be the price."""
    most = 9.0 + 9.0 * price
    gain = scipy.optimize.brentq(lambda gain: evidence_of(gain, 1) - price, 1.0, most)
    if math.isinf(freedom):
        return math.sqrt(gain)
    return float(np.sqrt(freedom * np.expm1(gain / (_share(freedom) * freedom))))


def weigh_changes(
    residual: Array,
    jacobian: Array,
    missing: Array,
    others: Array,
    changed: npt.NDArray[np.int64],
    runs: Sequence[Run],
    blocks: npt.NDArray[np.int64],
    logs: Logs,
    *,
    most: Array,
    usual: Array,
    alone: Mask,
    side: Mask,
    kept: Sequence[int] = (),
    known: tuple[Array, Array] | None = None,
) -> Changes:
    """Weigh what may have changed from one side to the other.

    Args:
        residual: (R,) measured less simulated, one fit of both sides.
        jacobian: (R, N) its derivative by the parameters' shares of their box.
        missing: (R, C) what the model may lack on both sides.
        others: (R, E) columns that are no part of what both sides lack.
        changed: (Q,) what may have changed: which of all these columns.
        runs: As of `evidence.weigh`.
        blocks: (R,) likewise.
        logs: Which rows are of which log.
        most: (C,) as of `evidence.weigh`.
        usual: (Q,) standard deviation of a change from log to log that is known beforehand; inf
            where nothing is.
        alone: (Q,) whether that is of the change alone, and not beside all others.
        side: (Q,) whether a change is on the side after; else on the side before.
        kept: Columns of `changed` that did change.
        known: Rows (L, N') of what is known of the first parameters beforehand, and by how much
            (L,) the fit is off it.

    Reference:
        Scatter from log to log: random effects of DerSimonian and Laird (1986), Controlled
        Clinical Trials 7; degrees of freedom by Satterthwaite (1946), Biometrics Bulletin 2.
    """
    nuisance, limit, size = of_one_size(jacobian, missing, most)
    common = nuisance[:, jacobian.shape[1] :]
    scale = float(np.sqrt(np.mean(residual**2))) or 1.0
    data = Rows(residual, nuisance, runs, limit, scale)
    noise = _noise(data, jacobian.shape[1], blocks, logs)
    # Once each, whichever it is: a column of what both sides lack may have changed, too.
    white = np.concatenate([jacobian.T, missing.T, others.T])
    rms = np.sqrt(np.mean(white**2, axis=1))
    unit = np.divide(1.0, rms, out=np.zeros_like(rms), where=rms > 0.0)
    white *= unit[:, None]
    size = np.concatenate([np.ones(jacobian.shape[1]), size, np.zeros(others.shape[1])])
    factor = np.divide(rms, size, out=np.zeros_like(rms), where=size > 0.0)
    seen, rms = _Seen(np.flatnonzero(size), changed, factor), rms[changed]
    usually = np.where(
        (rms > 0.0) & ~alone, np.minimum(usual * np.maximum(rms, 1e-300), SIZES[-1] * scale), 0
    )
    deviates, at = usually > 0.0, np.array(kept, dtype=np.int64)
    apart, moved = white[changed[deviates]].T * usually[deviates], white[changed[at]].T
    whiten = Whitening(runs, noise)
    white, right = whiten(white), whiten(residual)
    cells = []
    for log, after, pair in zip(logs.rows, logs.after, logs.pair, strict=True):
        for fold in np.unique(logs.fold[log]):
            there = log.start + np.flatnonzero(logs.fold[log] == fold)
            rows = white.take(there, axis=1)
            sums = np.column_stack([rows @ rows.T, rows @ right[there]])
            cells.append(_Cell(int(log.start), int(pair), int(fold), side == after, sums))
    first = nuisance.shape[1]
    whole = seen.told(np.sum([cell.sums for cell in cells], axis=0))[:first]
    prior = np.zeros((first, first + 1))
    if known is not None:
        rows = np.pad(known[0][:, : jacobian.shape[1]], ((0, 0), (0, limit.size)))
        prior = rows.T @ np.column_stack([rows, known[1]])
    told = whole[:, :first] + prior[:, :-1], whole[:, -1] + prior[:, -1]
    sizes = Sums(*told, limit).sizes(scale)[0]
    prior[:, :-1] += np.diag(np.concatenate([np.ones(jacobian.shape[1]), sizes**-2.0]))
    # Variance of the difference of two sides' means, in that of a log.
    between = sum(1.0 / np.sum(logs.after == side) for side in (False, True))

    parts: list[tuple[Array, ...]] = []
    for fold in sorted({cell.fold for cell in cells}):
        both = [[c for c in cells if (c.fold == fold) is own] for own in (True, False)]
        parts.append(tuple(x for own in both for x in _reduced(own, seen, prior, usually)[:2]))
    # Several logs tell how each suspect scatters; the parts of one a side that of what is in the
    # fit, for of another law they tell its form, too.
    several, groups = len(logs.rows) > 2, dict[tuple[int, int], list[_Cell]]()
    for cell in cells:
        groups.setdefault((cell.log, 0 if several else cell.fold), []).append(cell)
    of_each = partial(_scatter, list(groups.values()), seen, prior)
    inflation, freedom = np.ones(len(rms)), np.full(len(rms), np.inf)
    spread = np.zeros(at.size)
    if several:
        found = of_each(usually, np.arange(len(rms)))
        inflation, freedom = found.moderated
        spread = np.sqrt(found.variance[at]) * ~alone[at]
        if spread.any():
            # What changed differs from log to log by so much beside all else, too.
            usually[at], own = np.hypot(usually[at], spread), freedom[at]
            inflation, freedom = of_each(usually, np.arange(len(rms))).moderated
            freedom[at] = own
        scatter = inflation, freedom
    else:
        scatter = of_each(usually, np.arange(len(rms))).alone
    of_all = [_reduced(cells, seen, prior, x) for x in (usually, 0.0 * usually)]
    (own, score), alike = [(g * np.outer(rms, rms), h * rms) for g, h, _ in of_all]
    factor = np.append(np.ones(first), rms)
    on_both = [x * factor for x in of_all[0][2]]
    number = np.full(white.shape[0], -1)
    number[seen.common] = np.arange(first)
    by_itself = np.where(alone, between * usual**2, 0.0)
    return Changes(
        own, score, tuple(kept), alike, inflation, freedom, scatter, by_itself, noise,
        common, sizes, limit, apart, (moved * spread)[:, spread > 0.0], parts, on_both,
        number[changed], scale,
    )  # fmt: skip


def _noise(
    whole: Rows, count: int, blocks: npt.NDArray[np.int64], logs: Logs
) -> tuple[NoiseModel, ...]:
    """Return the noise that all columns leave of each log by itself, the first of parameters."""
    left, spread = [], []
    for log in logs.rows:
        own = [run for run in whole.runs if log.start <= run.start < log.stop]
        runs = [Run(run.start - log.start, run.stop - log.start, run.place) for run in own]
        one = Rows(whole.residual[log], whole.columns[log], runs, whole.limit, whole.scale)
        found = one.found(count, blocks[log])
        left.append(found.left)
        spread.append(found.spread)
    return whole.noise(np.concatenate(left), np.concatenate(spread))


@dataclass(frozen=True)
class _Cell:
    """Products of the whitened rows of one part of one log.

    Attributes:
        log: Which log.
        fold: Which part.
        there: (Q,) which changes are on its side.
        sums: (M, M + 1) products of all columns, and with the residual.
    """

    log: int
    pair: int
    fold: int
    there: Mask
    sums: Array


@dataclass(frozen=True)
class _Seen:
    """Which columns are common to both sides, and which may have changed.

    Attributes:
        common: (N + C,) of the parameters, and of what the model lacks.
        changed: (Q,) of changes.
        size: (M,) what is common, in columns of RMS 1.
    """

    common: npt.NDArray[np.int64]
    changed: npt.NDArray[np.int64]
    size: Array

    def told(self, sums: Array) -> Array:
        """Return the products of what is common, then of changes, from those of all (M, M + 1)."""
        rows = np.concatenate([self.common, self.changed])
        factor = np.concatenate([self.size[self.common], np.ones(self.changed.size)])
        found: Array = sums[np.ix_(rows, np.append(rows, -1))]
        return found * np.outer(factor, np.append(factor, 1.0))


def _reduced(
    cells: Sequence[_Cell], seen: _Seen, prior: Array, deviation: Array
) -> tuple[Array, Array, list[Array]]:
    """Return G (Q, Q) and h (Q,), with what is common or of one log alone integrated out.

    And of each pair the products (N + C, N + C + Q) of what is common, the changes beside it.

    Args:
        cells: Parts of logs.
        seen: Which columns are which.
        prior: (N + C, N + C + 1) precision of what is common, and its push.
        deviation: (Q,) standard deviation of a change from log to log.
    """
    first, count = len(prior), len(deviation)
    found, pairs = np.zeros((count, count + 1)), list[Array]()
    for pair in dict.fromkeys(cell.pair for cell in cells):
        normal = np.hstack([prior[:, :-1], np.zeros((first, count)), prior[:, -1:]])
        alike = [cell for cell in cells if cell.pair == pair]
        for log in dict.fromkeys(cell.log for cell in alike):
            of_log = [cell for cell in alike if cell.log == log]
            sums, there = _of_log(of_log, seen, deviation), of_log[0].there
            keep = np.concatenate([np.ones(first, dtype=bool), there, [True]])
            normal += sums[:first] * keep
            found += sums[first:, first:] * np.outer(there, keep[first:])
        half = _half(normal[:, :first], normal[:, first:])
        found -= half[:, :-1].T @ half
        pairs.append(normal[:, :-1])
    return found[:, :-1], found[:, -1], pairs


def _of_log(cells: Sequence[_Cell], seen: _Seen, deviation: Array) -> Array:
    """Return products of parts of one log, by how much it differs anyway integrated out."""
    sums, own = seen.told(np.sum([c.sums for c in cells], axis=0)), np.flatnonzero(deviation)
    at = seen.common.size + own
    # Scaled by the deviations, which may be as wide as nothing known.
    sides = sums[at] * deviation[own, None]
    half = _half(np.eye(own.size) + sides[:, at] * deviation[own], sides)
    return np.asarray(sums - half[:, :-1].T @ half)


def _half(precision: Array, sides: Array) -> Array:
    """Return (m, M + 1), products of whose columns integrating out takes from those of sides."""
    scale: Any = np.diag(precision) ** -0.5
    scaled = precision * np.outer(scale, scale) + _ROUNDED * np.eye(len(precision))
    factor = scipy.linalg.cholesky(scaled, lower=True)
    return np.asarray(scipy.linalg.solve_triangular(factor, scale[:, None] * sides, lower=True))


@dataclass(frozen=True)
class _Scatter:
    """By how much K changes differ within a side.

    Attributes:
        more: (K,) by how much that raises the variance of a change between the sides.
        free: (K,) degrees of freedom it is known with.
        square: (K,) sum of squares of the deviations, in their standard errors by noise alone.
        variance: (K,) of what a change is off its side's by.
    """

    more: Array
    free: Array
    square: Array
    variance: Array

    @property
    def alone(self) -> tuple[Array, Array]:
        """(K,) by how much a change's variance is larger, and its freedom, as each tells it."""
        return _inflated(self.more, self.free)

    @property
    def moderated(self) -> tuple[Array, Array]:
        """The same where all changes tell how much is usual, as well as each its own.

        Few logs show little of one alone; where a single log of a side shows it they show nothing.

        Reference:
            Smyth (2004), Statistical Applications in Genetics and Molecular Biology 3(1), 3.
        """
        own = self.free > 0.5
        if own.sum() < 3:
            return self.alone
        half = 0.5 * self.free[own]
        # By hand: a thousandth of the noise's variance is as good as none, which has no logarithm.
        told = np.log(np.maximum(self.square[own] / self.free[own], 1e-3))
        told = told - scipy.special.digamma(half) + np.log(half)
        excess = float(np.var(told, ddof=1)) - float(np.mean(scipy.special.polygamma(1, half)))
        # Half the freedom that all tell it with; 1e6 where they are alike.
        all_told = 1e6
        if excess > 1.0 / all_told:
            all_told = scipy.optimize.brentq(
                lambda x: float(scipy.special.polygamma(1, x)) - excess, 1e-4, 2e6
            )
        usual = math.exp(np.mean(told) + scipy.special.digamma(all_told) - math.log(all_told))
        free = self.free * own
        total = (2.0 * all_told * usual + free * (1.0 + self.more)) / (2.0 * all_told + free)
        return _inflated(np.maximum(total - 1.0, 0.0), 2.0 * all_told + free)


def _inflated(more: Array, free: Array) -> tuple[Array, Array]:
    """Return how much larger a variance is, and its freedom, of a share known with `free`."""
    share = np.maximum(more / (1.0 + more), 1e-9)
    return 1.0 + more, np.where(more > 1e-9, free / share**2, np.inf)


def _scatter(
    groups: Sequence[Sequence[_Cell]],
    seen: _Seen,
    prior: Array,
    deviation: Array,
    which: npt.NDArray[np.int64],
) -> _Scatter:
    """Return the scatter within a side of each change (K,).

    In each group a change is off that of its side by an amount of its own, all of one variance.

    Args:
        groups: Parts of logs that belong together.
        seen: As of `_reduced`.
        prior: Likewise.
        deviation: Likewise.
        which: (K,) the changes.
    """
    only = np.union1d(np.flatnonzero(deviation), which)
    seen, deviation = replace(seen, changed=seen.changed[only]), deviation[only]
    first, own = len(prior), len(prior) + np.searchsorted(only, which)
    count, many = which.size, len(groups)
    information, score = np.zeros((count, many, many)), np.zeros((count, many))
    for pair in dict.fromkeys(cells[0].pair for cells in groups):
        at = [i for i, cells in enumerate(groups) if cells[0].pair == pair]
        each = [_of_log(groups[i], seen, deviation) for i in at]
        normal = prior + np.sum([x[:first, [*range(first), -1]] for x in each], axis=0)
        half = _half(normal[:, :-1], np.hstack([*(x[:first, own] for x in each), normal[:, -1:]]))
        taken = half[:, :-1].reshape(first, len(at), count).transpose(2, 1, 0)
        score[:, at] = np.array([x[own, -1] for x in each]).T - taken @ half[:, -1]
        information[np.ix_(range(count), at, at)] = -taken @ np.swapaxes(taken, 1, 2)
        information[:, at, at] += np.array([x[own, own] for x in each]).T
    values, vectors = np.linalg.eigh(information)
    # What all groups have in common goes to what both sides lack.
    shown = values > OWN**2 * np.maximum(values[:, -1:], 1e-300)
    values, turned = values * shown, np.swapaxes(vectors, 1, 2)
    there = np.stack([cells[0].there[which] for cells in groups], axis=1)
    sides = turned @ np.stack([np.ones(there.shape), there], axis=2)
    back = np.swapaxes(sides, 1, 2)
    push, means = (turned @ score[..., None])[..., 0] * shown, values[..., None] * sides
    known, wide, mean = back @ means, np.swapaxes(means, 1, 2) @ means, back @ push[..., None]
    least = np.linalg.pinv(known, rcond=OWN**2, hermitian=True)
    free = shown.sum(axis=1) - np.einsum('qij,qji->q', least, known)
    among = values.sum(axis=1) - np.einsum('qij,qji->q', least, wide)
    excess = np.sum(push**2 / np.maximum(values, 1e-300), axis=1) - free
    excess -= np.einsum('qia,qij,qja->q', mean, least, mean)
    variance = np.where(free > 0.5, np.maximum(excess, 0.0), 0.0) / np.maximum(among, 1e-300)
    more = variance * wide[:, 1, 1] / np.maximum(known[:, 1, 1], 1e-300)
    return _Scatter(more, free, excess + free, variance)
