# SPDX-License-Identifier: Apache-2.0
"""Where a gap lies in time: instants at which a drive is far from the model, and only then."""

from collections.abc import Sequence
from dataclasses import replace
import math

import numpy as np
from numpy.typing import NDArray
import scipy

from ros2_ident.arrays import Array, highest
from ros2_ident.gap.noise_floor import Floor
from ros2_ident.gap.where.localise import Finding, Region
from ros2_ident.gates.asked import Asked, Event
from ros2_ident.gates.instants import peaks_of, robust_fit, robust_size
from ros2_ident.gates.scale import STANDS_OUT
from ros2_ident.models import FullModel
from ros2_ident.search.jacobian import Box
from ros2_ident.search.least_squares import Point
from ros2_ident.search.noise import correlation_time


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
    measured = model.measured
    there = ~np.isnan(measured)
    box = Box.of(low, high)
    at = Point.at(model.residuals, box, box.inside(theta))
    ends = np.cumsum(there.sum(axis=1))[:-1]
    left = np.split(robust_fit(-at.jacobian, at.residual, 1e-300, ends)[1], ends)
    out = [
        found
        for d, (row, seen) in enumerate(zip(left, there, strict=True))
        if (found := _of_drive(model, d, row, np.flatnonzero(seen), float(floor.per_drive[d])))
    ]
    return sorted(out, key=lambda f: -f.over_floor)


def not_asked(
    asked: Sequence[Sequence[Asked]], floor: Floor, model: FullModel
) -> tuple[Finding, ...]:
    """Return effort that was not commanded, the first recording's first.

    Args:
        asked: How drives make the efforts that they are asked for, by recording.
        floor: Noise floor of the drives compared.
        model: Of any recording.
    """
    out = []
    for found in (x for recording in asked for x in recording if x.pushes):
        d = model.places.index(found.drive)
        of_effort = model.outputs[d].quantity == 'effort'
        noise = float(floor.per_drive[d]) if of_effort else 0.0
        share, size, top = found.share, found.size, found.certain
        out.append(_finding(found.pushes, share, size, noise, top, found.count, model.effort_unit))
    return tuple(replace(f, commanded=False) for f in out)


def _finding(
    events: tuple[Event, ...], share: float, size: float, noise: float, top: float,
    count: float, unit: str,
) -> Finding:  # fmt: skip
    """Return the finding of a drive's events, by share, RMS, and the highest of `count`."""
    chance = min(1.0, 2.0 * count * float(scipy.special.ndtr(-top)))
    return Finding(
        events[0].drive, 'instants', Region(), share, chance,
        size, size / noise if noise else math.inf, share, unit=unit, value=top,
        events=events,
    )  # fmt: skip


def _of_drive(
    model: FullModel, d: int, row: Array, at: NDArray[np.intp], noise: float
) -> Finding | None:
    if row.size < 10:
        return None
    apart = row - np.median(row)
    usual = max(robust_size(row), noise)
    step = float(np.median(np.diff(at))) * model.cycle
    peaks = peaks_of(apart, STANDS_OUT * usual, step)
    if peaks is None:
        return None
    height, inside = np.abs(apart), peaks.inside
    share = float((apart[inside] ** 2).sum() / (apart**2).sum())
    size = math.sqrt(float((apart[inside] ** 2).sum()) / row.size)
    count = row.size / max(correlation_time(row), 1.0)
    top, drive = float(height[peaks.at].max()) / usual, model.places[d]
    # What pushes a drive its motor need not make: the log holds less than the motion asks for.
    pushes = tuple(
        Event(drive, 1, _instant(height, p, at, model.cycle), float(-apart[p])) for p in peaks.at
    )
    return _finding(pushes, share, size, noise, top, count, model.outputs[d].unit)


def _instant(height: Array, peak: int, at: NDArray[np.intp], cycle: float) -> float:
    """Return when a peak is highest, s."""
    part = highest(height, peak)
    beside = at[peak + 1] - at[peak] if part > 0.0 else at[peak] - at[peak - 1]
    return float((at[peak] + part * beside) * cycle)
