# SPDX-License-Identifier: Apache-2.0
"""Up to which frequency a recorded motion tells what efforts it asks for.

The acceleration of a position that is read with an error s, at a rate f and below a frequency B,
is wrong by s (2 pi)^2 sqrt(2 B^5 / (5 f)), and the effort that an inertia asks for by as much
times the inertia. The noise of a logged effort grows only with sqrt(B).
"""

import math

import numpy as np

from ros2_ident.errors import IdentError
from ros2_ident.recording.align import align
from ros2_ident.recording.dataset import Dataset
from ros2_ident.recording.grid import sample_period
from ros2_ident.recording.motion import fill_gaps
from ros2_ident.recording.smooth import low_pass, ROOM, smooth_motion
from ros2_ident.recording.streams import FloatArray, Recording, Stream

# The highest band, as a share of the rate, and the lowest, Hz.
_HIGHEST, LOWEST = 0.1, 3.0
# What readings of the position ask for may be this share of the effort's noise, or this share of
# how the effort varies: no log of an effort is better than that.
_OF_NOISE, _OF_EFFORT = 1.0 / 3.0, 1e-3
# Step from one band that is tried to the next.
_STEP = 0.95
# Frequency below which an inertia is looked for, Hz; and samples that it takes.
_SLOW, _FEWEST = 5.0, 200


def told_band(states: Stream) -> float:
    """Return the frequency below which motion tells efforts, Hz.

    Args:
        states: Positions and efforts of some joints; without efforts a tenth of the rate.

    Returns:
        Where the worst joint's readings ask for a third of the noise of its effort, or for a
        thousandth of the effort if that is more; at most a tenth of the rate.
    """
    period = sample_period(states.stamp)
    highest = _HIGHEST / period
    if states.position is None or states.effort is None:
        return highest
    try:
        data = align(Recording(states), states.names, period, need=())
    except IdentError:
        return highest
    return min(_of_joint(data, d, highest) for d in range(len(data.names)))


def _of_joint(data: Dataset, d: int, highest: float) -> float:
    """Return the band of one joint, the highest where nothing is known of it."""
    if data.position is None or data.effort is None:
        return highest
    position, effort = data.position[d], data.effort[d]
    if min(np.isfinite(position).sum(), np.isfinite(effort).sum()) < _FEWEST:
        return highest
    inertia = _inertia(position, effort, data.cycle)
    read = inertia * (2.0 * math.pi) ** 2 * _fast(position, data.cycle)
    noise, least = _fast(effort, data.cycle), _OF_EFFORT * float(np.nanstd(effort))
    band = highest
    while band > LOWEST:
        asked = read * math.sqrt(0.4 * band**5 * data.cycle)
        if asked <= max(_OF_NOISE * noise * math.sqrt(2.0 * band * data.cycle), least):
            break
        band *= _STEP
    return band


def _fast(row: FloatArray, cycle: float) -> float:
    """Return the standard deviation of the white noise that the fastest part of a row shows."""
    filled = fill_gaps(row)
    rest = filled - low_pass(filled[None], cycle, ROOM / cycle)[0]
    return float(np.std(rest)) / math.sqrt(1.0 - 2.0 * ROOM)


def _inertia(position: FloatArray, effort: FloatArray, cycle: float) -> float:
    """Return how the slow effort of a joint grows with its own acceleration."""
    cutoff = min(_SLOW, _HIGHEST / cycle)
    try:
        place, speed, change = (x[0] for x in smooth_motion(position[None], cycle, cutoff))
    except IdentError:
        return 0.0
    still = 0.02 * float(np.abs(speed).max())
    if still <= 0.0:
        return 0.0
    columns = [change, np.tanh(speed / still), speed, np.sin(place), np.cos(place)]
    system = np.stack([*columns, np.ones_like(place)], axis=1)
    slow = low_pass(fill_gaps(effort)[None], cycle, cutoff)[0]
    return abs(float(np.linalg.lstsq(system, slow, rcond=1e-9)[0][0]))
