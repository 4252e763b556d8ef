# SPDX-License-Identifier: Apache-2.0
"""The size beyond which a logged effort does not go, by the flat tops that a limit leaves."""

import numpy as np
from scipy.ndimage import uniform_filter1d

from ros2_ident.arrays import Array
from ros2_ident.gates.scale import FEWEST
from ros2_ident.search.noise import correlation_time, fast_noise

# Samples of a mean that tells where a top is.
_MEAN = 9
# A stretch is at the top where such a mean is within so many deviations of the highest one, and
# seen as far as it has not fallen by so many.
_BAND, _NEAR = 2.0, 12.0
# Of so many stretches, the longest, each is looked at; its flat part begins in the first third.
_STRETCHES, _CORNERS = 5, 7


def flat_top(effort: Array, noise: float = 0.0) -> float | None:
    """Return the size beyond which an effort does not go, None where it has no flat top.

    A stretch at the top is flat where a constant with a kink at either end tells its course, and
    that before and after, better than a smooth course does, by the Bayesian information criterion
    (Schwarz 1978). An instant will do. A motion of constant acceleration has flat tops, too: what
    this returns is where to look, not a finding.

    Args:
        effort: (K,) effort, NaN at cycles without a sample.
        noise: Least standard deviation of its noise; what neighbours differ by says more.
    """
    logged = effort[np.isfinite(effort)]
    if logged.size < FEWEST:
        return None
    noise = max(noise, fast_noise(logged))
    found = [
        level
        for sign in (1.0, -1.0)
        for first, last in _stretches(sign * logged, noise, float(np.abs(logged).max()))
        if (level := _level(sign * logged, first, last, noise)) is not None
    ]
    top = max(found, default=0.0)
    near = [level for level in found if level > top - _BAND * noise]
    return float(np.mean(near)) if near else None


def highest(effort: Array) -> float:
    """Return the size of an effort (K,) where it stays at its top, 0 where it never does."""
    logged = effort[np.isfinite(effort)]
    if logged.size < FEWEST:
        return 0.0
    size = float(np.abs(logged).max())
    means = (
        float(sign * logged[a:b].mean())
        for sign in (1.0, -1.0)
        for a, b in _stretches(sign * logged, fast_noise(logged), size)[:1]
    )
    return max(means, default=0.0)


def _stretches(row: Array, noise: float, size: float) -> list[tuple[int, int]]:
    """Return the longest stretches at a row's top, each as its first sample and its end."""
    mean = uniform_filter1d(row, _MEAN, mode='nearest')
    top = float(mean.max())
    if top < 0.5 * size:
        return []
    there = np.concatenate([[False], mean >= top - _BAND * noise, [False]])
    ends = np.flatnonzero(np.diff(there.astype(int))).reshape(-1, 2)
    longest = sorted(ends.tolist(), key=lambda e: e[0] - e[1])[:_STRETCHES]
    return [(a, b) for a, b in longest if b - a >= _MEAN]


def _level(row: Array, first: int, last: int, noise: float) -> float | None:
    """Return the height at which a stretch of a row is flat, None where it is not."""
    length = last - first
    low = np.flatnonzero(row < row[first:last].mean() - _NEAR * noise)
    fell, falls = low[low < first], low[low >= last]
    begin = max(first - length, int(fell[-1]) + 1 if fell.size else 0)
    end = min(last + length, int(falls[0]) if falls.size else row.size)
    if (begin, end) == (first, last):
        return None
    part, time = row[begin:end], np.linspace(-1.0, 1.0, end - begin)
    inset = np.linspace(0, length // 3, _CORNERS).astype(int)
    kinked = [_kinked(time, first + a - begin, last - b - begin) for a in inset for b in inset]
    left, level, rest = min((_left(x, part) for x in kinked), key=lambda fit: fit[0])
    # The smooth course that a flat one is held against has as many numbers.
    smooth = _left(np.vander(time, kinked[0].shape[1]), part)[0]
    gain = part.size / correlation_time(rest) * np.log(smooth / max(left, 1e-300))
    # Where it begins and ends are two numbers more.
    return level if smooth > left and gain > 2.0 * np.log(part.size) else None


def _kinked(time: Array, first: int, last: int) -> Array:
    """Return (T, 5) columns: a constant, and parabolas before `first` and from `last` on."""
    before = np.minimum(time - time[first], 0.0)
    after = np.maximum(time - time[min(last, time.size - 1)], 0.0)
    return np.stack([np.ones_like(time), before, before**2, after, after**2], axis=1)


def _left(columns: Array, part: Array) -> tuple[float, float, Array]:
    """Return the sum of squares that a fit leaves, its first number, and what is left."""
    numbers = np.linalg.lstsq(columns, part, rcond=None)[0]
    rest = part - columns @ numbers
    return float(rest @ rest), float(numbers[0]), rest
