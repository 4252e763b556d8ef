# SPDX-License-Identifier: Apache-2.0
"""Localisation of a gap: the coordinate of the motion that the residual follows, and the region.

For each drive and coordinate the residual is averaged over regions of it, or a line is fitted. The
share of the explainable gap that this explains is compared with what it would be by chance: the
residual is cut into blocks longer than its memory and each block's sign is thrown by a coin. What
is coherent from block to block is lost then; what is coherent within a block is not.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
import math

import numpy as np
from numpy.typing import NDArray
from scipy.stats import false_discovery_control

from ros2_ident.arrays import Array
from ros2_ident.gap.blocks import averages, FEWEST
from ros2_ident.gap.coordinates import (
    Coordinate,
    coordinates,
    Motion,
    Parity,
    PHASES,
    phases,
    places,
)
from ros2_ident.gap.facts import Event
from ros2_ident.gap.floor import Floor
from ros2_ident.gap.region import concentration, phase_of, Region, region_of, Trend
from ros2_ident.gap.spectrum import find_peak, motion_band
from ros2_ident.identify.hidden import SETTLE
from ros2_ident.search.noise import correlation_time

# Sign changes thrown.
_FLIPS = 3999
# False findings among the findings, in the mean.
LEVEL = 0.05
# What explains less than this, as RMS over the floor, is of no matter, however certain; nor is a
# place whose share of a gap is above its share of the time by less.
MATERIAL = 0.2
# A coordinate with this share leads: what it leaves is taken for the noise. Where none is certain
# among so many, one that leads is told, if it would be certain by itself.
_LEADING = 0.4
# A block is so many times as long as the residual's memory.
_TIMES = 12.0


@dataclass(frozen=True)
class Coarse:
    """A drive's residual on the coarse grid.

    Attributes:
        at: (T,) cycles.
        value: (T,) mean residual times the root of `weight`.
        weight: (T,) samples averaged.
        block: (T,) number of the block.
        explainable: Sum of squares above the noise, at least what matters.
        widen: Factor on what chance gives, for the memory that reaches across blocks.
    """

    at: NDArray[np.int64]
    value: Array
    weight: Array
    block: NDArray[np.int64]
    explainable: float
    widen: float


def coarse_of(row: Array, cycle: float, noise: float) -> Coarse | None:
    """Return the means of a residual over short stretches; None where there are too few.

    Args:
        row: (K,) residual, NaN where there is no sample.
        cycle: Time from column to column, s.
        noise: The drive's noise floor.
    """
    stride, mean, weight = averages(row, cycle)
    keep = weight > 0.0
    if keep.sum() < 10 * FEWEST:
        return None
    mean, weight = mean[keep], weight[keep]
    at = (np.flatnonzero(keep) * stride + stride // 2).astype(np.int64)
    value = mean * np.sqrt(weight)
    block, widen = blocks_of(mean, at, cycle, row.size)
    explainable = float(value @ value) - noise**2 * value.size
    least = (MATERIAL * noise) ** 2 * float(weight.sum())
    return Coarse(at, value, weight, block, max(explainable, least), widen)


def blocks_of(
    mean: Array, at: NDArray[np.int64], cycle: float, size: int
) -> tuple[NDArray[np.int64], float]:
    """Return the number of each value's block (T,), and the factor `Coarse.widen`.

    Args:
        mean: (T,) residual on the coarse grid.
        at: (T,) cycles.
        cycle: Time of a cycle, s.
        size: Cycles of the log.
    """
    stride = float(np.median(np.diff(at)))
    memory = correlation_time(mean)
    length = max(SETTLE / cycle, _TIMES * memory * stride)
    length = max(1.0, min(length, size / FEWEST))
    block = np.unique((at // length).astype(np.int64), return_inverse=True)[1]
    # What neighbouring blocks have in common is lost with the coin: their part of the variance.
    return block, 1.0 / (1.0 - min(0.5 * (memory - 1.0) * stride / length, 1.0 / 3.0))


def orthonormal(columns: Array, weight: Array, constant: bool) -> Array:
    """Return an orthonormal basis of weighted columns, without the constant unless asked for."""
    root = np.sqrt(weight)[:, None]
    weighted = columns * root
    if not constant:
        one = root / np.linalg.norm(root)
        weighted = weighted - one * (one * weighted).sum(axis=0)
    weighted = weighted / np.maximum(np.sqrt((weighted**2).sum(axis=0)), 1e-300)
    # By the small Gram matrix: a decomposition of the long one would wake the library's threads.
    size, turn = np.linalg.eigh(np.einsum('tb,tc->bc', weighted, weighted))
    keep = size > 1e-8 * max(float(size.max(initial=0.0)), 1e-300)
    kept: Array = np.einsum('tb,bc->tc', weighted, turn[:, keep] / np.sqrt(size[keep]))
    return kept


def bases_of(coordinate: Coordinate, weight: Array) -> list[Array]:
    """Return one basis, or one for each group of columns where only the best group counts."""
    if coordinate.pick is None:
        return [orthonormal(coordinate.columns, weight, False)]
    groups = range(0, coordinate.columns.shape[1], coordinate.pick)
    return [
        orthonormal(coordinate.columns[:, g : g + coordinate.pick], weight, False) for g in groups
    ]


def tested(
    values: Sequence[Array],
    bases: Sequence[Sequence[Array]],
    block: NDArray[np.int64],
    widen: float,
    signs: Array,
    explainable: float,
) -> list[tuple[float, float, Array]]:
    """Return for each coordinate its share, its p-value and the basis that explains most."""
    out = []
    for value, groups in zip(values, bases, strict=True):
        observed, chance, best = -1.0, np.zeros(len(signs)), groups[0]
        for basis in groups:
            parts = np.zeros((signs.shape[1], basis.shape[1]))
            np.add.at(parts, block, basis * value[:, None])
            square = float((parts.sum(axis=0) ** 2).sum())
            chance = np.maximum(chance, widen * (thrown(signs, parts) ** 2).sum(axis=1))
            if square > observed:
                observed, best = square, basis
        p_value = (1.0 + float((chance >= observed).sum())) / (1.0 + chance.size)
        expected = float(chance.mean())
        gain = max(0.0, observed - expected)
        out.append((gain / max(explainable - expected, gain, 1e-300), p_value, best))
    return out


def thrown(signs: Array, parts: Array) -> Array:
    """Return signs @ parts, without the library's threads: they cost more than they bring here."""
    out: Array = np.einsum('fn,nb->fb', signs, parts)
    return out


@dataclass(frozen=True)
class Finding:
    """One coordinate that a drive's residual follows.

    Attributes:
        drive: Name.
        along: Name of the coordinate; `frequency`, or `instants` for bursts.
        region: Where along it.
        statistic: Share of the drive's explainable gap that it explains, corrected for chance.
        p_value: Probability of as much by chance, before the correction for many coordinates.
        size: RMS that it explains [`unit`].
        over_floor: The same over the drive's noise floor.
        beyond: Share that it still explains once the drive's leading coordinate is taken out.
        significant: Whether it holds after the correction for many coordinates, and matters.
        likely: Whether it explains most on a drive with a large gap, and is not certain.
        by_size: Whether it is where the residual is large, whatever its sign.
        parity: Whether the residual changes sign with the direction of motion.
        unit: Unit of the gap.
        trend: Whether the residual grows along the coordinate.
        phase: Phase of the motion in which most of it lies; empty for none.
        time: Share of the time that the region takes; NaN where that is not compared.
        value: Mean of an offset [`unit`], frequency of a swing [Hz], or the highest burst over
            the residual elsewhere.
        events: Bursts: what pushed the drive, or effort that was not commanded.
        commanded: False where `events` are effort that was not commanded.
    """

    drive: str
    along: str
    region: Region
    statistic: float
    p_value: float
    size: float
    over_floor: float
    beyond: float
    significant: bool
    likely: bool = False
    by_size: bool = False
    parity: Parity = ''
    unit: str = ''
    trend: Trend = ''
    phase: str = ''
    time: float = math.nan
    value: float = math.nan
    events: tuple[Event, ...] = ()
    commanded: bool = True

    @property
    def coordinate(self) -> str:
        """Name of the coordinate with its parity, or as one by which the size differs."""
        if self.by_size and not self.events:
            return f'size by {self.along}'
        return f'{self.along}, {self.parity}' if self.parity else self.along


def localise(
    motion: Motion,
    residual: Array,
    floor: Floor,
    *,
    seed: int = 0,
    flips: int = _FLIPS,
) -> tuple[Finding, ...]:
    """Find the coordinates that explain the gap.

    Args:
        motion: What the drives did, from `coordinates.motion_of`.
        residual: (D, K) measured less simulated effort, NaN where there is no sample.
        floor: Noise floor of the D drives.
        seed: Seed of the coin.
        flips: How often it is thrown.

    Returns:
        The findings: the drive with the largest gap first, then what explains most of it. Where a
        drive with a large gap has none, what explains most is added, as not significant.

    Reference:
        Sign flips: Wu (1986), Annals of Statistics 14, the wild bootstrap; in blocks: Shao (2010),
        Journal of the American Statistical Association 105. False discovery rate: Benjamini and
        Hochberg (1995), Journal of the Royal Statistical Society B 57.
    """
    found: list[Finding] = []
    for d in range(len(residual)):
        generator = np.random.default_rng((seed, d))
        noise = float(floor.per_drive[d])
        coarse = coarse_of(residual[d], motion.cycle, noise)
        if coarse is None:
            continue
        found += _drive(motion, d, coarse, noise, flips, generator)
        found += _swing(motion, d, residual[d], noise, coarse)
    # They are fractions of the flips: a tie with the level passes, however it is rounded.
    chance = false_discovery_control([f.p_value for f in found]) if found else ()
    found = [
        replace(
            f,
            significant=bool(p <= LEVEL * (1.0 + 1e-9))
            and f.over_floor >= MATERIAL
            # A place where the gap is large has to stand out from the rest of the time.
            and not (f.by_size and f.statistic < MATERIAL),
        )
        for f, p in zip(found, chance, strict=True)
    ]
    found += _likely(found, motion.drives)
    size = np.sqrt(np.nanmean(residual**2, axis=1)) / floor.per_drive
    gap = dict(zip(motion.drives, size.tolist(), strict=True))
    found.sort(key=lambda f: (-f.significant, -gap[f.drive], -f.over_floor))
    return tuple(f for f in found if f.significant or f.likely)


def _likely(found: list[Finding], drives: Sequence[str]) -> list[Finding]:
    """Return what explains most on drives with a large gap where no coordinate is certain."""
    out = []
    for drive in drives:
        means = [f for f in found if f.drive == drive and not f.by_size]
        best = max(means, key=lambda f: f.statistic, default=None)
        if best is None or any(f.significant for f in means):
            continue
        large = best.over_floor >= MATERIAL and best.statistic >= _LEADING
        if large and best.p_value <= LEVEL:
            found.remove(best)
            out.append(replace(best, likely=True))
    return out


def _drive(
    motion: Motion,
    d: int,
    coarse: Coarse,
    noise: float,
    flips: int,
    generator: np.random.Generator,
) -> list[Finding]:
    root = np.sqrt(coarse.weight)
    offset = Coordinate('offset', 'even', '', np.ones((root.size, 1)), np.full((1, 2), np.nan))
    one = root[:, None] / np.linalg.norm(root)
    centred = coarse.value - one[:, 0] * float(one[:, 0] @ coarse.value)
    every = [offset, *coordinates(motion, d, coarse.at)]
    bases = [[one], *(bases_of(c, coarse.weight) for c in every[1:])]
    moving = phases(motion.velocity[d], motion.acceleration[d])[coarse.at]
    values = [coarse.value, *([centred] * (len(every) - 1))]
    block, widen = coarse.block, coarse.widen
    signs = generator.choice(np.array([-1.0, 1.0]), (flips, int(block.max()) + 1))
    sizes = _sizes(motion, d, coarse, noise, signs)
    fits = [
        max(((float(((g.T @ v) ** 2).sum()), i) for i, g in enumerate(groups)))
        for v, groups in zip(values, bases, strict=True)
    ]
    first = max(range(len(fits)), key=lambda i: fits[i][0])
    basis = bases[first][fits[first][1]]
    if fits[first][0] - noise**2 * basis.shape[1] >= _LEADING * coarse.explainable:
        # The memory of what the leading coordinate leaves is that of the noise: its own is the
        # effect's, and blocks that long would hide what repeats within them.
        left = values[first] - basis @ (basis.T @ values[first])
        block, widen = blocks_of(left / root, coarse.at, motion.cycle, motion.position.shape[1])
        signs = generator.choice(np.array([-1.0, 1.0]), (flips, int(block.max()) + 1))
    found = tested(values, bases, block, widen, signs, coarse.explainable)
    leading = max((f for f in found if f[1] <= LEVEL), default=(0.0, 1.0, one), key=lambda f: f[0])
    out = sizes
    for coordinate, value, (share, p_value, basis) in zip(every, values, found, strict=True):
        fitted = basis @ (basis.T @ value)
        left = value - leading[2] @ (leading[2].T @ value)
        beyond = float(((basis.T @ left) ** 2).sum()) - noise**2 * basis.shape[1]
        size = math.sqrt(share * coarse.explainable / float(coarse.weight.sum()))
        region, trend = region_of(coordinate, fitted / root, coarse.weight, noise)
        power = np.bincount(moving, fitted**2, len(PHASES)).astype(float)
        time = np.bincount(moving, coarse.weight, len(PHASES)).astype(float)
        mean = np.average(fitted / root, weights=coarse.weight)
        out.append(
            Finding(
                motion.drives[d], coordinate.name, region, share, p_value, size, size / noise,
                max(0.0, beyond / coarse.explainable), False, parity=coordinate.parity,
                unit=motion.unit, trend=trend, phase=phase_of(power, time),
                value=float(mean) if coordinate is offset else math.nan,
            )
        )  # fmt: skip
    return out


def _sizes(
    motion: Motion, d: int, coarse: Coarse, noise: float, signs: Array
) -> list[Finding]:
    """Look where the gap is large, whatever its sign: impacts and ringing have none."""
    power = coarse.value**2 - noise**2
    total = float(power.sum())
    if total < (MATERIAL * noise) ** 2 * float(coarse.weight.sum()):
        return []
    centred = power - power.mean()
    number = signs.shape[1]
    size = math.sqrt(total / float(coarse.weight.sum()))
    out = []
    for coordinate in places(motion, d, coarse.at):
        inside = np.abs(coordinate.columns) > 0.0
        time = inside.sum(axis=0).astype(float)
        parts = np.zeros((number, time.size))
        np.add.at(parts, coarse.block, inside * centred[:, None])
        observed = float((parts.sum(axis=0) ** 2 / time).sum())
        chance = (thrown(signs, parts) ** 2 / time).sum(axis=1)
        p_value = (1.0 + float((chance >= observed).sum())) / (1.0 + chance.size)
        region, held, lasts = concentration(coordinate, inside.T @ power, time)
        share = min(1.0, max(0.0, held - lasts))
        out.append(
            Finding(
                motion.drives[d], coordinate.name, region, share, p_value,
                size * math.sqrt(share), size * math.sqrt(share) / noise, share, False,
                by_size=True, unit=motion.unit, time=lasts,
            )
        )  # fmt: skip
    return out


def _swing(motion: Motion, d: int, row: Array, noise: float, coarse: Coarse) -> list[Finding]:
    peak = find_peak(row, motion.cycle, noise, motion_band(motion.acceleration[d], motion.cycle))
    if peak is None:
        return []
    share = min(1.0, peak.size**2 * float(coarse.weight.sum()) / coarse.explainable)
    return [
        Finding(
            motion.drives[d], 'frequency', Region(peak.low, peak.high, 'Hz'), share, peak.p_value,
            peak.size, peak.size / noise, share, False, unit=motion.unit, value=peak.frequency,
        )
    ]  # fmt: skip
