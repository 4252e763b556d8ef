# SPDX-License-Identifier: Apache-2.0
"""Statistics of residuals from contiguous blocks: sizes, differences and shares, with intervals.

Residuals are autocorrelated, so samples may not be drawn one by one. Blocks that start anywhere in
the log are drawn instead, the same for every residual compared, so that what they share cancels.
"""

from collections.abc import Sequence
from dataclasses import dataclass
import math

import numpy as np
import numpy.typing as npt
import scipy

from ros2_ident.arrays import Array
from ros2_ident.gap.noise_floor import Floor
from ros2_ident.gates.scale import STEP
from ros2_ident.identify.hidden import BLOCKS, SETTLE
from ros2_ident.search.noise import correlation_time


@dataclass(frozen=True)
class Interval:
    """A number with its confidence interval.

    Attributes:
        value: Estimate.
        low: Lower end.
        high: Upper end.
    """

    value: float
    low: float
    high: float


def block_length(rows: Array, cycle: float) -> int:
    """Return a block length from the autocorrelation of the residual and of its square.

    Args:
        rows: (D, K) residual, NaN where there is no sample.
        cycle: Time from column to column, s.

    Returns:
        Length in cycles, see `length_of`.

    Reference:
        Integrated autocorrelation time with a self-consistent window: Sokal (1997), Monte Carlo
        Methods in Statistical Mechanics, section 3.
    """
    count = rows.shape[1]
    # A coarse grid is enough and holds no NaN where samples come every few cycles.
    longest = 1.0
    for values in (*rows, *rows**2):
        stride, coarse, weight = averages(values, cycle)
        longest = max(longest, correlation_time(coarse[weight > 0.0]))
    return int(length_of(longest, stride, count, cycle))


def length_of(time: float, stride: float, count: int, cycle: float) -> float:
    """Return the block length of a series whose error of a mean's variance is least, in cycles.

    At least the settling time, and at most what leaves the log `BLOCKS` blocks.

    Args:
        time: Autocorrelation time of the series, samples; its colour is taken for that of a
            first-order process.
        stride: Cycles from sample to sample.
        count: Cycles of the log.
        cycle: Time of a cycle, s.

    Reference:
        Politis and White (2004), Econometric Reviews 23(1), with the correction of Patton, Politis
        and White (2009), 28(4): (2 G^2 / D)^(1/3) n^(1/3), G and D of a first-order process.
    """
    # Autocorrelation from sample to sample: the time is (1 + r) / (1 - r).
    r = (time - 1.0) / (time + 1.0)
    best = stride * (math.sqrt(6.0 * count / stride) * r / (1.0 - r**2)) ** (2.0 / 3.0)
    return float(max(1.0, min(max(SETTLE / cycle, best), count / BLOCKS)))


def averages(values: Array, cycle: float) -> tuple[int, Array, Array]:
    """Return a number of columns, their means and how many of each are no NaN."""
    stride = max(1, round(STEP / cycle))
    size = values.size // stride * stride
    parts = values[:size].reshape(-1, stride)
    there = np.isfinite(parts)
    number = there.sum(axis=1).astype(float)
    return stride, np.where(there, parts, 0.0).sum(axis=1) / np.maximum(number, 1.0), number


class BlockBootstrap:
    """Resamples several residuals of the same recordings in the same blocks.

    Args:
        residuals: J residuals to be compared, each (D, K); NaN where there is no sample. Several
            recordings of one machine go side by side along K.
        cycle: Time from column to column, s.
        count: Resamples.
        seed: Seed of the resampling.
        starts: Columns at which a recording begins, besides the first; blocks do not reach across.

    Attributes:
        squares: (J, D) mean squares.
        drawn: (count, J, D) mean squares of the resamples.
        length: Block length in cycles.

    Reference:
        Moving blocks: Künsch (1989), Annals of Statistics 17(3); Lahiri (2003), Resampling Methods
        for Dependent Data, section 2.
    """

    def __init__(
        self,
        residuals: Sequence[Array],
        cycle: float,
        *,
        count: int = 1000,
        seed: int = 0,
        starts: Sequence[int] = (),
    ) -> None:
        rows = np.stack(residuals)
        self.length = block_length(residuals[0], cycle)
        there = np.isfinite(rows)
        size = rows.shape[2]
        table = np.empty((2, *rows.shape[:2], size + 1))
        table[..., 0] = 0.0
        np.cumsum(np.where(there, rows, 0.0) ** 2, axis=2, out=table[0, ..., 1:])
        np.cumsum(there, axis=2, out=table[1, ..., 1:])
        self.squares = _ratio(table[..., -1])
        first = np.concatenate(
            [
                np.arange(a, max(a + 1, b - self.length + 1))
                for a, b in zip((0, *starts), (*starts, size), strict=True)
            ]
        )
        last = np.minimum(first + self.length, size)
        # (2, J, D, starts) sums of a block at each start, gathered for all resamples at once
        number = max(2, math.ceil(size / self.length))
        generator = np.random.default_rng(seed)
        pick = generator.integers(0, first.size, (count, number))
        flat = table.reshape(-1, size + 1)
        total = np.empty((count, len(flat)))
        for j, series in enumerate(flat):
            total[:, j] = np.take(series[last] - series[first], pick).sum(axis=1)
        self.drawn = _ratio(np.moveaxis(total.reshape(count, 2, *rows.shape[:2]), 1, 0))
        cuts = np.linspace(0, size, number + 1).astype(int)
        parts = np.diff(table[..., cuts], axis=-1)
        # (number, J, D) with one block left out, for the acceleration of the intervals
        self.left_out = np.moveaxis(_ratio(table[..., -1:] - parts), -1, 0)
        self.number = number
        self._seed = seed

    def rms(self, which: int = 0) -> Interval:
        """Return the RMS of a residual, by its number, over all drives."""

        def size(means: Array) -> Array:
            out: Array = np.sqrt(means[..., which, :].mean(axis=-1))
            return out

        return self._bounds(float(size(self.squares)), size(self.drawn), size(self.left_out))

    def above(self, floor: Floor, before: int, after: int) -> npt.NDArray[np.bool_]:
        """Return (D,) which drives show a gap before or after; all where none does."""
        worst = np.maximum(self.squares[before], self.squares[after])
        shown: npt.NDArray[np.bool_] = worst > floor.high**2
        return shown if shown.any() else ~shown

    def share_closed(
        self, before: int, after: int, floor: Floor, drive: int | None = None
    ) -> Interval:
        """Return the share of the explainable gap that closed, 1 - (E1^2 - F^2)/(E0^2 - F^2).

        Args:
            before: Number of the residual with the effect missing (E0).
            after: Number of the residual with it in the model (E1).
            floor: The noise floor F; its uncertainty goes into the interval.
            drive: Number of a drive; where None all that show a gap before or after, for what the
                others add is the error of their floor.

        Returns:
            The share, at most 1: what is less than the floor is the floor's uncertainty. NaN where
            nothing above the floor is there to be explained.
        """
        pick = np.arange(len(floor.per_drive)) if drive is None else np.array([drive])
        if drive is None:
            pick = np.flatnonzero(self.above(floor, before, after))
        generator = np.random.default_rng((self._seed, 1))
        noise = (floor.draw(len(self.drawn), generator)[:, pick] ** 2).mean(axis=1)
        fixed = float((floor.per_drive[pick] ** 2).mean())

        def share(means: Array, under: Array | float) -> Array:
            one = means[..., before, pick].mean(axis=-1) - under
            two = means[..., after, pick].mean(axis=-1) - under
            with np.errstate(divide='ignore', invalid='ignore'):
                out: Array = np.where(one > 0.0, np.minimum(1.0 - two / one, 1.0), math.nan)
            return out

        return self._bounds(
            float(share(self.squares, fixed)), share(self.drawn, noise),
            share(self.left_out, fixed),
        )  # fmt: skip

    def _bounds(self, value: float, drawn: Array, left_out: Array) -> Interval:
        """Return the 95 % interval, bias-corrected and accelerated, widened for few blocks.

        Reference:
            Efron (1987), Journal of the American Statistical Association 82.
        """
        drawn = drawn[np.isfinite(drawn)]
        # Guards by hand: resamples that tell an end, shares of them that tell a bias, and a bend.
        if not math.isfinite(value) or drawn.size < 20:
            return Interval(value, math.nan, math.nan)
        below = (np.sum(drawn < value) + 0.5 * np.sum(drawn == value)) / drawn.size
        bias = float(scipy.special.ndtri(np.clip(below, 0.02, 0.98)))
        pull = left_out[np.isfinite(left_out)]
        pull = pull.mean() - pull if pull.size else np.zeros(1)
        spread = float((pull**2).sum()) ** 1.5
        bend = float((pull**3).sum()) / (6.0 * spread) if spread > 0.0 else 0.0
        # Few blocks know their own scatter badly: as Student's t beside the normal distribution.
        wide = float(scipy.special.stdtrit(self.number - 1, 0.975))
        wide *= math.sqrt(self.number / (self.number - 1.0))
        ends = []
        for z in (-wide, wide):
            shifted = bias + z
            at = bias + shifted / max(0.2, 1.0 - bend * shifted)
            ends.append(float(np.quantile(drawn, float(scipy.special.ndtr(at)))))
        return Interval(value, min(ends[0], value), max(ends[1], value))


def _ratio(table: Array) -> Array:
    """Return sums of squares over numbers of samples, NaN where there are none."""
    with np.errstate(divide='ignore', invalid='ignore'):
        out: Array = np.where(table[1] > 0, table[0] / table[1], math.nan)
    return out
