# SPDX-License-Identifier: Apache-2.0
"""Signals of long logs as the few numbers a page holds: thinned, in whole numbers of two bytes."""

from collections.abc import Sequence
import math
from typing import Any

import numpy as np
import numpy.typing as npt

from ros2_ident.report.signals import Curves

# Seconds that a whole number of the time axis stands for.
TICK = 1e-5
# The whole number that stands for no sample.
NOTHING = -32768
# A simulation this many times beyond the measured range is drawn at that edge.
BEYOND = 10.0
# Room between recordings, as a share of their whole length.
GAP = 0.02
# A curve breaks where its next sample is so many times later than usual, and by so many s.
LATE, LATE_SECONDS = 10.0, 0.02
# The worst moments that are offered, and the length of one as a share of all of the time.
MOMENTS, MOMENT = 3, 0.02

Numbers = npt.NDArray[np.float64]


def extremes(rows: npt.NDArray[Any], stretches: int) -> npt.NDArray[np.int64]:
    """Return which columns hold the least and the largest of each row in each stretch, in order.

    Args:
        rows: (R, T) values, NaN for none.
        stretches: Into how many stretches of equal length T is cut, about; all columns where that
            leaves one column each.
    """
    count = rows.shape[1]
    length = max(1, math.ceil(count / max(1, stretches)))
    if length == 1:
        return np.arange(count)
    padded = np.full((len(rows), math.ceil(count / length) * length), np.nan)
    padded[:, :count] = rows
    parts = padded.reshape(len(rows), -1, length)
    first = np.arange(parts.shape[1]) * length
    nothing = np.isnan(parts)
    least = np.where(nothing, np.inf, parts).argmin(axis=2) + first
    most = np.where(nothing, -np.inf, parts).argmax(axis=2) + first
    return np.unique(np.concatenate([least.ravel(), most.ravel()]))


def kept(recording: Curves, most: int) -> npt.NDArray[np.int64]:
    """Return the samples (of T) that the page keeps: all, or the extremes of each stretch."""
    rows = np.concatenate([recording.measured, *recording.simulated, recording.tracking])
    count = rows.shape[1]
    return np.arange(count) if count <= most else extremes(rows, most // (2 * len(rows)))


def scale(first: npt.NDArray[Any], *others: npt.NDArray[Any]) -> tuple[float, float]:
    """Return offset and step of the whole numbers of curves that share an axis."""
    there = [part for x in (first, *others) if (part := x[np.isfinite(x)]).size]
    if not there:
        return 0.0, 1.0
    low, high = float(there[0].min()), float(there[0].max())
    room = BEYOND * max(high - low, 1e-9)
    low = max(min(float(x.min()) for x in there), low - room)
    high = min(max(float(x.max()) for x in there), high + room)
    return 0.5 * (low + high), max(high - low, 1e-9) / 65000.0


def coded(values: npt.NDArray[Any], offset: float, step: float) -> npt.NDArray[np.int16]:
    """Return curves in whole numbers."""
    codes = np.clip(np.round((values - offset) / step), -32500, 32500)
    return np.where(np.isfinite(codes), codes, NOTHING).astype(np.int16)


def joined(
    recordings: Sequence[Curves], rows: Sequence[npt.NDArray[np.int64]]
) -> tuple[Numbers, list[int], list[float]]:
    """Return times (T,) of all recordings in a row, where each ends, and when each starts."""
    room = GAP * sum(float(r.time[-1] - r.time[0]) for r in recordings)
    times, starts, end = [], [], -room
    for recording, at in zip(recordings, rows, strict=True):
        start = end + room
        times.append(recording.time[at] + start)
        starts.append(start)
        end = float(times[-1][-1])
    return np.concatenate(times), [int(n) for n in np.cumsum([t.size for t in times])], starts


def breaks(time: Numbers, there: npt.NDArray[np.bool_], bounds: Sequence[int]) -> list[int]:
    """Return the rows before which a curve breaks: a recording ends, or samples are missing.

    Args:
        time: (T,) s.
        there: (T,) where the curve has a sample.
        bounds: Rows at which recordings end, the last one T.
    """
    rows = np.flatnonzero(there)
    if rows.size < 2:
        return list(bounds)
    steps = np.diff(time[rows])
    late = max(LATE * float(np.median(steps)), LATE_SECONDS)
    return sorted({*bounds, *(int(r) for r in rows[1:][steps > late])})


def worst_moments(time: Numbers, residual: Numbers) -> list[tuple[float, float, int]]:
    """Return start, end and drive of the stretches with the largest residual, the worst first.

    Args:
        time: (T,) s.
        residual: (D, T) in units that compare between drives, NaN for none.
    """
    squares = np.nan_to_num(residual**2)
    span = max(MOMENT * float(time[-1] - time[0]), 1e-9)
    total = np.concatenate([np.zeros((len(squares), 1)), squares.cumsum(axis=1)], axis=1)
    first = np.searchsorted(time, time - 0.5 * span)
    last = np.searchsorted(time, time + 0.5 * span, side='right')
    power = total[:, last] - total[:, first]
    out: list[tuple[float, float, int]] = []
    free = np.ones(time.size, dtype=bool)
    while len(out) < MOMENTS and free.any():
        there = np.where(free, power, -1.0)
        drive, row = np.unravel_index(int(there.argmax()), there.shape)
        if there[drive, row] <= 0.0:
            break
        # The stretch with the most, and in it the largest of all.
        part = squares[drive, first[row] : last[row]]
        middle = float(time[first[row] + int(part.argmax())])
        out.append((middle - span, middle + span, int(drive)))
        free &= np.abs(time - middle) > 2.0 * span
    return out
