# SPDX-License-Identifier: Apache-2.0
"""Instants at which a series stands out: where they are, how wide, and when there are none."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
import scipy

from ros2_ident.arrays import Array, MEDIAN

# A peak sinks by this share of what makes it stand out before the next one. By hand.
_SINKS = 0.5
# One that lasts longer, s, or all of them together a larger share of the series, are no instants,
# and what comes more often belongs to the motion. By hand.
LONGEST, SHARE, _MOST = 1.0, 0.25, 4
# Where a weight is half, in deviations: Holland and Welsch's 2.385, at which nothing but 5 % of
# the certainty is lost with normal values, made a round number. Rounds in which what stands out
# loses its weight: by hand.
_HALF, _ROUNDS = 2.0, 15


@dataclass(frozen=True)
class Peaks:
    """Instants at which a series stands out.

    Attributes:
        at: (P,) indices of the highest values.
        inside: (T,) whether a value belongs to a peak: higher than half of it.
    """

    at: NDArray[np.intp]
    inside: NDArray[np.bool_]


def peaks_of(apart: Array, least: ArrayLike, step: float, small: float = 0.0) -> Peaks | None:
    """Find where a series stands out, if that is at instants.

    Args:
        apart: (T,) the series about its middle.
        least: What stands out, one number or (T,).
        step: Time from value to value, s.
        small: Peaks below this share of the highest are passed over.

    Returns:
        The peaks; None where there is none, or where they are many, long, or halves of a swing.
    """
    height = np.abs(apart)
    prominence = _SINKS * float(np.min(least))
    at, _ = scipy.signal.find_peaks(height, height=least, prominence=prominence)
    at = at[height[at] >= small * height[at].max()] if at.size else at
    if not 0 < at.size <= _MOST:
        return None
    width, _, first, last = scipy.signal.peak_widths(height, at)
    if (step * width > LONGEST).any() or width.sum() > SHARE * apart.size:
        return None
    if swings(at, width, np.sign(apart[at])):
        return None
    inside = np.zeros(apart.size, dtype=bool)
    for a, b in zip(first, last, strict=True):
        inside[int(a) : int(b) + 2] = True
    return Peaks(at, inside)


def swings(at: NDArray[np.intp], width: Array, sign: Array) -> bool:
    """Whether two follow each other as the halves of a swing do, to both sides.

    Those of a sine are a third of its period wide at half their height, and half of it apart.
    """
    near = np.diff(at) < width[1:] + width[:-1]
    return bool((near & (sign[1:] != sign[:-1])).any())


def robust_size(values: Array) -> float:
    """Return the standard deviation of values that do not stand out."""
    return float(np.median(np.abs(values - np.median(values)))) / MEDIAN if values.size else 0.0


def robust_fit(
    columns: Array, values: Array, least: float, ends: Sequence[int] | NDArray[np.intp] = ()
) -> tuple[Array, Array]:
    """Return the solution (C,) and the residual (T,) of a fit robust to values that stand out.

    Args:
        columns: (T, C).
        values: (T,) what they are to make, series after series.
        least: Least standard deviation of what is left.
        ends: Where a series ends and another begins, each with a size of its own.
    """
    scale = np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
    weight = np.ones_like(values)
    for _ in range(_ROUNDS):
        system = columns / scale * weight[:, None]
        solution = np.linalg.lstsq(system, values * weight, rcond=1e-9)[0] / scale
        left = values - columns @ solution
        parts = np.split(left, ends)
        sizes = [max(robust_size(part), least) for part in parts]
        weight = np.concatenate(
            [robust_weights(x, size) / size for x, size in zip(parts, sizes, strict=True)]
        )
    return solution, left


def robust_weights(values: Array, size: float) -> Array:
    """Return the roots of Cauchy's weights of values of a size, half at two of it.

    Reference:
        Holland and Welsch, Communications in Statistics A 6(9), 1977.
    """
    out: Array = 1.0 / np.sqrt(1.0 + (values / (_HALF * size)) ** 2)
    return out
