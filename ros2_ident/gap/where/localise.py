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

from ros2_ident.arrays import Above, Array, Below
from ros2_ident.gap.bootstrap import averages, length_of
from ros2_ident.gap.coordinates import Coordinate, coordinates, Motion, Parity, PHASES, phases
from ros2_ident.gap.noise_floor import Floor
from ros2_ident.gap.spectrum import find_peak, motion_band
from ros2_ident.gates.asked import Event
from ros2_ident.gates.scale import MOSTLY
from ros2_ident.identify.hidden import BLOCKS
from ros2_ident.search.noise import correlation_time

# False findings among the findings, in the mean: the convention.
LEVEL = 0.05
# Sign changes thrown: the least chance they can tell, one in so many, is below the level over all
# coordinates of seven drives, 200.
_FLIPS = 3999
# What explains less than this, as RMS over the floor, is of no matter, however certain. By hand.
LEAST = 0.2
# A coordinate with this share leads: what it leaves is taken for the noise. By hand.
_LEADING = 0.4
# The regions that hold this share of what is explained are named. By hand.
_MOST = 0.75
# Phases that hold this share of it, and so many times their share of the time, are named. By hand.
_MAINLY, _DENSER = 0.5, 1.5


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
    if keep.sum() < 10 * BLOCKS:
        return None
    mean, weight = mean[keep], weight[keep]
    at = (np.flatnonzero(keep) * stride + stride // 2).astype(np.int64)
    value = mean * np.sqrt(weight)
    block, widen = blocks_of(mean, at, cycle, row.size)
    explainable = float(value @ value) - noise**2 * value.size
    least = (LEAST * noise) ** 2 * float(weight.sum())
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
    length = length_of(memory, stride, size, cycle)
    block = np.unique((at // length).astype(np.int64), return_inverse=True)[1]
    # What neighbouring blocks have in common is lost with the coin: their part of the variance.
    return block, 1.0 / (1.0 - min(0.5 * (memory - 1.0) * stride / length, 1.0 / 3.0))


def orthonormal(columns: Array, weight: Array) -> Array:
    """Return an orthonormal basis of weighted columns, without the constant."""
    root = np.sqrt(weight)[:, None]
    weighted = columns * root
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
        return [orthonormal(coordinate.columns, weight)]
    groups = range(0, coordinate.columns.shape[1], coordinate.pick)
    return [orthonormal(coordinate.columns[:, g : g + coordinate.pick], weight) for g in groups]


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
            # Not `@`: the library's threads cost more than they bring here.
            drawn = np.einsum('fn,nb->fb', signs, parts)
            chance = np.maximum(chance, widen * (drawn**2).sum(axis=1))
            if square > observed:
                observed, best = square, basis
        p_value = (1.0 + float((chance >= observed).sum())) / (1.0 + chance.size)
        expected = float(chance.mean())
        gain = max(0.0, observed - expected)
        out.append((gain / max(explainable - expected, gain, 1e-300), p_value, best))
    return out


@dataclass(frozen=True)
class Region:
    """A part of a coordinate.

    Attributes:
        low: Lower end; minus infinity where it reaches to the coordinate's end.
        high: Upper end likewise.
        unit: Unit of both.
        labels: The parts' names where the coordinate has no numbers.
    """

    low: Below = -math.inf
    high: Above = math.inf
    unit: str = ''
    labels: tuple[str, ...] = ()


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
        likely: Whether it explains most on a drive with a large gap, and is not certain.
        parity: Whether the residual changes sign with the direction of motion.
        unit: Unit of the gap.
        phase: Phase of the motion in which most of it lies; empty for none.
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
    likely: bool = False
    parity: Parity = ''
    unit: str = ''
    phase: str = ''
    value: float = math.nan
    events: tuple[Event, ...] = ()
    commanded: bool = True

    @property
    def coordinate(self) -> str:
        """Name of the coordinate with its parity."""
        return f'{self.along}, {self.parity}' if self.parity else self.along


def localise(
    motion: Motion,
    residual: Array,
    floor: Floor,
    *,
    seed: int = 0,
) -> tuple[Finding, ...]:
    """Find the coordinates that explain the gap.

    Args:
        motion: What the drives did, from `coordinates.motion_of`.
        residual: (D, K) measured less simulated effort, NaN where there is no sample.
        floor: Noise floor of the D drives.
        seed: Seed of the coin.

    Returns:
        The findings: the drive with the largest gap first, then what explains most of it. Where a
        drive with a large gap has none, what explains most is added, as not certain.

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
        found += _drive(motion, d, coarse, noise, generator)
        found += _swing(motion, d, residual[d], noise, coarse)
    # They are fractions of the flips: a tie with the level passes, however it is rounded.
    ranked = np.sort([f.p_value for f in found])
    false = ranked * (ranked.size / np.arange(1, ranked.size + 1))
    most = ranked[false <= LEVEL * (1.0 + 1e-9)].max(initial=-1.0)
    certain = [f for f in found if f.p_value <= most and f.over_floor >= LEAST]
    settled = {f.drive for f in certain}
    for drive in (name for name in motion.drives if name not in settled):
        best = max((f for f in found if f.drive == drive), key=lambda f: f.statistic, default=None)
        # One that leads a large gap is told where none is certain among so many.
        if best and min(best.over_floor / LEAST, best.statistic / _LEADING) >= 1.0:
            certain += [replace(best, likely=True)] if best.p_value <= LEVEL else []
    size = np.sqrt(np.nanmean(residual**2, axis=1)) / floor.per_drive
    gap = dict(zip(motion.drives, size.tolist(), strict=True))
    return tuple(sorted(certain, key=lambda f: (f.likely, -gap[f.drive], -f.over_floor)))


def _drive(
    motion: Motion,
    d: int,
    coarse: Coarse,
    noise: float,
    generator: np.random.Generator,
) -> list[Finding]:
    root = np.sqrt(coarse.weight)
    offset = Coordinate('offset', 'even', '', np.ones((root.size, 1)), np.empty((0, 2)))
    one = root[:, None] / np.linalg.norm(root)
    centred = coarse.value - one[:, 0] * float(one[:, 0] @ coarse.value)
    every = [c for c in (offset, *coordinates(motion, d, coarse.at)) if c.columns.size]
    bases = [[one], *(bases_of(c, coarse.weight) for c in every[1:])]
    moving = phases(motion.velocity[d], motion.acceleration[d])[coarse.at]
    values = [coarse.value, *([centred] * (len(every) - 1))]
    block, widen = coarse.block, coarse.widen
    signs = generator.choice(np.array([-1.0, 1.0]), (_FLIPS, int(block.max()) + 1))
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
        signs = generator.choice(np.array([-1.0, 1.0]), (_FLIPS, int(block.max()) + 1))
    found = tested(values, bases, block, widen, signs, coarse.explainable)
    leading = max((f for f in found if f[1] <= LEVEL), default=(0.0, 1.0, one), key=lambda f: f[0])
    out = []
    for coordinate, value, (share, p_value, basis) in zip(every, values, found, strict=True):
        fitted = basis @ (basis.T @ value)
        left = value - leading[2] @ (leading[2].T @ value)
        beyond = float(((basis.T @ left) ** 2).sum()) - noise**2 * basis.shape[1]
        size = math.sqrt(share * coarse.explainable / float(coarse.weight.sum()))
        region = region_of(coordinate, fitted / root, coarse.weight, noise)
        power = np.bincount(moving, fitted**2, len(PHASES)).astype(float)
        time = np.bincount(moving, coarse.weight, len(PHASES)).astype(float)
        mean = np.average(fitted / root, weights=coarse.weight)
        out.append(
            Finding(
                motion.drives[d], coordinate.name, region, share, p_value, size, size / noise,
                max(0.0, beyond / coarse.explainable), parity=coordinate.parity,
                unit=motion.unit, phase=phase_of(power, time),
                value=float(mean) if coordinate is offset else math.nan,
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
            peak.size, peak.size / noise, share, unit=motion.unit, value=peak.frequency,
        )
    ]  # fmt: skip


def region_of(coordinate: Coordinate, fitted: Array, weight: Array, noise: float) -> Region:
    """Return where along a coordinate a fitted residual lies.

    Args:
        fitted: (T,) part of the residual that it explains, in the effort's unit.
        weight: (T,) samples that each entry stands for.
        noise: Noise floor.
    """
    if coordinate.pick:
        columns = coordinate.columns / np.linalg.norm(coordinate.columns, axis=0)
        power = ((columns.T @ fitted) ** 2).reshape(-1, coordinate.pick).sum(axis=1)
        order = float(coordinate.place[coordinate.pick * int(np.argmax(power)), 0])
        return Region(order, order, coordinate.unit)
    if coordinate.name in ('offset', 'recent acceleration'):
        return Region()
    inside = np.abs(coordinate.columns) > 0.0
    if coordinate.labels and coordinate.name != 'phase':
        size = np.abs((coordinate.columns / coordinate.columns.std(axis=0)).T @ fitted)
        return Region(labels=(coordinate.labels[int(np.argmax(size))],))
    if coordinate.labels:
        held = dict(zip(coordinate.labels, (weight * fitted**2) @ inside, strict=True))
        names = sorted(held, key=lambda name: -held[name])
        most = np.cumsum([held[name] for name in names]) >= _MOST * sum(held.values())
        return Region(labels=tuple(names[: 1 + int(np.argmax(most))]))
    counts = np.array([float(weight[c].sum()) for c in inside.T])
    pairs = zip(np.sign(coordinate.columns).T, inside.T, strict=True)
    means = np.array([float(np.average((fitted * s)[c], weights=weight[c])) for s, c in pairs])
    power = np.maximum(counts * means**2 - noise**2, 0.0)
    return _narrowest(coordinate, power)


def phase_of(power: Array, time: Array) -> str:
    """Return the phase that holds most of it; empty where none holds much more than its time.

    Args:
        power: (P,) what is explained in each phase.
        time: (P,) samples in each phase.
    """
    total, whole = float(power.sum()), float(time.sum())
    if total <= 0.0:
        return ''
    held, lasts = power / total, time / whole
    top = int(np.argmax(held))
    return PHASES[top] if held[top] >= max(_MAINLY, _DENSER * lasts[top]) else ''


def _narrowest(coordinate: Coordinate, power: Array) -> Region:
    """Return the shortest region that holds most of the power (B,)."""
    total = np.concatenate([[0.0], np.cumsum(power)])
    size = len(power)
    best = (size, 0.0, 0, size - 1)
    for first in range(size if total[-1] > 0.0 else 0):
        enough = np.flatnonzero(total[first + 1 :] - total[first] >= _MOST * total[-1])
        if enough.size:
            last = first + int(enough[0])
            best = min(best, (last - first, -(total[last + 1] - total[first]), first, last))
    first, last = best[2:]
    # A region as wide as most of the coordinate is all of it.
    if last - first + 1 > MOSTLY * size:
        return Region()
    low = coordinate.place[first, 0] if first else -math.inf
    high = coordinate.place[last, 1] if first == 0 or last < size - 1 else math.inf
    return Region(float(low), float(high), coordinate.unit)
