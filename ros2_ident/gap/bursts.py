# SPDX-License-Identifier: Apache-2.0
"""At which instants something acts on a drive that neither the model nor its motion repeats."""

import math

import numpy as np
from numpy.typing import NDArray
from scipy.signal import find_peaks, peak_widths
from scipy.special import ndtr
from scipy.stats import median_abs_deviation

from ros2_ident.gap.floor import Floor
from ros2_ident.gap.localise import Finding
from ros2_ident.gap.wording import figure, percent
from ros2_ident.models import FullModel
from ros2_ident.search.levenberg import difference_jacobian
from ros2_ident.search.noise import correlation_time

Array = NDArray[np.float64]

# A burst stands out by so many standard deviations of what is left elsewhere, and sinks by half of
# that before the next one.
_STANDS_OUT, _SINKS = 5.0, 0.5
# One that lasts longer, s, or all of them together a larger share of the log, are no bursts.
_LONGEST, _SHARE = 1.0, 0.25
# What comes more often on a drive belongs to its motion.
_MOST = 4
# Rounds in which what stands out loses its weight, and where half of it is gone, in deviations.
_ROUNDS, _HALF = 15, 2.0


def bursts(model: FullModel, low: Array, high: Array, theta: Array, floor: Floor) -> list[Finding]:
    """Find the instants at which a drive's effort is far from the model, and only then.

    A push would bend the fit, so it is repeated without what stands out: weights of Cauchy's
    distribution, to first order about the fit (Holland and Welsch, Communications in Statistics
    A 6(9), 1977).

    Args:
        model: One recording.
        low: (N,) lower ends of the box.
        high: (N,) upper ends.
        theta: (N,) the nominal fit.
        floor: Noise floor of the drives compared.

    Returns:
        One finding for each drive that has bursts, the largest first.
    """
    span = high - low
    measured = model.measured
    there = ~np.isnan(measured)
    residual, slopes = difference_jacobian(model.residuals, (theta - low) / span, low, span)
    ends = np.cumsum(there.sum(axis=1))[:-1]
    left = np.split(_robust(residual, slopes, ends), ends)
    out = [
        found
        for d, (row, seen) in enumerate(zip(left, there, strict=True))
        if (found := _of_drive(model, d, row, np.flatnonzero(seen), float(floor.per_drive[d])))
    ]
    return sorted(out, key=lambda f: -f.over_floor)


def _robust(residual: Array, slopes: Array, ends: NDArray[np.int64]) -> Array:
    """Return (R,) the residual of a fit that counts little what stands out."""
    left = residual
    for _ in range(_ROUNDS):
        weight = np.concatenate([_weights(part) for part in np.split(left, ends)])
        scale = np.maximum(np.linalg.norm(slopes * weight[:, None], axis=0), 1e-300)
        columns = slopes * (weight[:, None] / scale)
        step = np.linalg.lstsq(columns, -residual * weight, rcond=1e-8)[0] / scale
        left = residual + slopes @ step
    return left


def _weights(part: Array) -> Array:
    """Return the roots of the weights of one series."""
    size = max(_size(part), 1e-300)
    out: Array = 1.0 / (size * np.sqrt(1.0 + (part / (_HALF * size)) ** 2))
    return out


def _size(part: Array) -> float:
    """Return the standard deviation of what does not stand out."""
    return float(median_abs_deviation(part, scale='normal')) if part.size else 0.0


def _of_drive(
    model: FullModel, d: int, row: Array, at: NDArray[np.intp], noise: float
) -> Finding | None:
    if row.size < 10:
        return None
    apart = row - np.median(row)
    usual = max(_size(row), noise)
    height = np.abs(apart)
    least = _STANDS_OUT * usual
    peaks, _ = find_peaks(height, height=least, prominence=_SINKS * least)
    if not 0 < peaks.size <= _MOST:
        return None
    step = float(np.median(np.diff(at))) * model.cycle
    width, _, first, last = peak_widths(height, peaks)
    if (step * width > _LONGEST).any() or width.sum() > _SHARE * row.size:
        return None
    if _swings(peaks, width, np.sign(apart[peaks])):
        return None
    inside = np.zeros(row.size, dtype=bool)
    for a, b in zip(first, last, strict=True):
        inside[int(a) : int(b) + 2] = True
    share = float((apart[inside] ** 2).sum() / (apart**2).sum())
    size = math.sqrt(float((apart[inside] ** 2).sum()) / row.size)
    count = row.size / max(correlation_time(row), 1.0)
    highest = float(height[peaks].max())
    drive, unit = model.places[d], model.outputs[d].unit
    # What pushes a drive its motor need not make: the log holds less than the motion asks for.
    said = [
        f'{_instant(height, p, at, model.cycle):.2f} s ({figure(float(-apart[p]), "+")} {unit})'
        for p in peaks
    ]
    text = (
        f'{drive}: as if pushed at {", ".join(said)}; up to {highest / usual:.2g} times what is '
        f'left elsewhere, {percent(share)} of it all'
    )
    return Finding(
        drive, 'instants', ', '.join(said), share,
        min(1.0, 2.0 * count * float(ndtr(-highest / usual))),
        text, size, size / noise if noise else math.inf, share, True,
    )  # fmt: skip


def _swings(peaks: NDArray[np.intp], width: Array, sign: Array) -> bool:
    """Whether two follow each other as the halves of a swing do, to both sides.

    Those of a sine are a third of its period wide at half their height, and half of it apart.
    """
    near = np.diff(peaks) < width[1:] + width[:-1]
    return bool((near & (sign[1:] != sign[:-1])).any())


def _instant(height: Array, peak: int, at: NDArray[np.intp], cycle: float) -> float:
    """Return when a peak is highest, s, by a parabola through it and its neighbours."""
    before, top, after = height[peak - 1 : peak + 2]
    bend = before - 2.0 * top + after
    part = 0.5 * (before - after) / bend if bend < 0.0 else 0.0
    beside = at[peak + 1] - at[peak] if part > 0.0 else at[peak] - at[peak - 1]
    return float((at[peak] + part * beside) * cycle)
