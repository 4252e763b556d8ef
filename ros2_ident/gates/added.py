# SPDX-License-Identifier: Apache-2.0
"""Is effort added to what a drive's control law asks for, and if so: when, and how much?

What the controller saw and what came of it are both in the log, so no machine is in this. Gains
are free, for those stated may be off by a little.
"""

from dataclasses import replace
import math

import numpy as np
from numpy.typing import NDArray
import scipy

from ros2_ident.arrays import Array
from ros2_ident.gates import scale
from ros2_ident.gates.asked import Asked, Event, is_limited
from ros2_ident.gates.instants import LONGEST, robust_fit, robust_size, SHARE, swings
from ros2_ident.gates.law import Law
from ros2_ident.gates.signals import Fit, signals_of
from ros2_ident.models import Machine
from ros2_ident.recording import Dataset


def added_to(machine: Machine, data: Dataset, law: Law, recording: int = 1) -> Asked | None:
    """Find effort that a control law did not ask for.

    Returns:
        What was added, from start to end; None where nothing was, or where what the law leaves is
        not that of instants.
    """
    signals = signals_of(machine, data, law.drive)
    if signals is None or math.isfinite(law.limit):
        return None
    fit, cycle = Fit(signals), signals.cycle
    # What was added may have bent the delays, too.
    lates = np.array([[0.0, 0.0], [law.effort_delay, law.command_delay]]) / cycle
    noise = max(machine.effort_noise, 1e-9 * float(np.ptp(signals.effort)), 1e-300)
    rows = [robust_fit(*fit.system(late), noise)[1] for late in lates]
    left = min(rows, key=lambda row: float(np.log1p((row / noise) ** 2).sum()))
    every = np.zeros(signals.position.size)
    every[signals.index] = left
    width = max(1, round(scale.STEP / cycle))
    mean = scipy.ndimage.uniform_filter1d(every, width)
    usual = max(robust_size(mean[signals.index]), noise / math.sqrt(width))
    inside, found = _parts(mean, scale.STANDS_OUT * usual, width)
    if not found or is_limited(signals.effort, left, np.full(left.size, usual)):
        return None
    rest = float(np.sqrt(np.mean(mean[~inside] ** 2)))
    square = float(every[inside] @ every[inside])
    share = square / float(every @ every)
    first, last, size = np.array(found).T
    top = float(np.abs(size).max()) / max(usual, rest)
    few = (last - first).max() * cycle <= LONGEST and inside.mean() <= SHARE
    swing = swings(0.5 * (first + last), last - first, np.sign(size))
    if not few or swing or share < scale.MOSTLY or top < scale.STANDS_OUT:
        return None
    drive = law.drive
    pushes = tuple(Event(drive, recording, a * cycle, s, b * cycle) for a, b, s in found)
    rms, count = math.sqrt(square / left.size), left.size / width
    return Asked(drive, law.effort_delay, math.nan, usual, pushes, share, rms, top, count)


def without(data: Dataset, added: Asked) -> Dataset:
    """Return a recording without the efforts of a drive while others were added to them."""
    assert data.effort is not None
    effort, row = np.array(data.effort), data.names.index(added.drive)
    for event in added.pushes:
        # A cycle more on either side: the log may lie between two.
        first, last = round(event.time / data.cycle) - 1, round(event.end / data.cycle) + 2
        effort[row, max(first, 0) : last] = np.nan
    return replace(data, effort=effort)


def _parts(
    mean: Array, least: float, width: int
) -> tuple[NDArray[np.bool_], list[tuple[int, int, float]]]:
    """Return where a series (T,) stands out, and begin, end and size of each part.

    A part is what is higher than half its middle value: a mean over `width` passes half of a step
    where that is.
    """
    height, found = np.abs(mean), list[tuple[int, int, float]]()
    inside = np.zeros(mean.size, dtype=bool)
    for part in scipy.ndimage.find_objects(scipy.ndimage.label(height > least)[0]):
        size = float(np.median(mean[part]))
        high = np.flatnonzero(height[part] > 0.5 * abs(size)) + part[0].start
        inside[part] = True
        if high[-1] - high[0] >= width:
            found.append((int(high[0]), int(high[-1]) + 1, size))
    return inside, found
